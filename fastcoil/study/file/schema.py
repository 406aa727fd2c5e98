"""The JSON Schema of study files, with which an editor completes and checks one as it is written.

It is derived from the tables that the reader itself uses: the models of ``tables``, the parameters, the functions that
make days.  The reader refuses more than the schema can express; any other number in a table of parameters may be one of
an estimator or a law of the study's own.
"""

import inspect
import math
from collections.abc import Iterable, Mapping
from typing import get_type_hints

from pydantic import TypeAdapter

from fastcoil.design.tuning_plan import may_be_searched
from fastcoil.loops.assignment import MEANING, WORD
from fastcoil.loops.boundary.conditions import CONDITIONS
from fastcoil.loops.plan import RUN_LIMITS
from fastcoil.loops.presets import PRESETS
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.model.user_rules import KINDS
from fastcoil.study.file.loop import LONGEST_AXIS
from fastcoil.study.file.sampling import CHOICE, DISTRIBUTIONS, LARGEST_SAMPLE, METHODS
from fastcoil.study.file.spec import BOUNDARY_KINDS
from fastcoil.study.file.tables import Schema, StudyFile, whole

_NUMBER: Schema = {"type": "number"}
_VALUES: Schema = {"type": "array", "minItems": 1, "uniqueItems": True}


def study_schema() -> Schema:
    """JSON Schema (draft 2020-12) of a study file, as a dict that ``json.dumps`` takes."""
    found = StudyFile.model_json_schema()
    loop: Schema = {
        "preset": {"enum": list(PRESETS), "default": "paper_like", "description": "where the defaults come from"},
        "include": {**_VALUES, "items": {"type": "string"}, "description": "files that `fastcoil fit` wrote"},
        WORD: {"type": "boolean", "default": False, "description": f"true stands for {MEANING}"},
    }
    sample: Schema = {
        "method": {"enum": list(METHODS), "description": "how the samples fill the space"},
        "size": whole(1, LARGEST_SAMPLE, "number of samples"),
        "seed": whole(*RUN_LIMITS["seed"]) | {"default": 0},
    }
    constants = {name: _ref(name) for name in PARAMETERS}
    swept = {name: {"anyOf": [{**_VALUES, "items": _ref(name)}, _ref("spacing")]} for name in PARAMETERS}
    drawn = {name: _ref("drawn") | {"description": p.text} for name, p in PARAMETERS.items()}
    case = _table(constants, own=_NUMBER)
    found["properties"] |= {
        "loop": _table(loop | constants, own=_NUMBER),
        "sweep": _table(swept, own={"anyOf": [{**_VALUES, "items": _NUMBER}, _ref("spacing")]}),
        "cases": {"additionalProperties": {"type": "object", "minProperties": 1, "additionalProperties": case}},
        "sample": _table(sample | drawn, required=["method", "size"], own=_ref("drawn")),
        "boundary": {"anyOf": [_day(kind) for kind in BOUNDARY_KINDS]},
    }
    search = found["$defs"]["TuneTable"]["properties"]["search"]
    search["properties"] = {n: _list_of([_ref(n), _ref(n)]) for n, p in PARAMETERS.items() if may_be_searched(p)}
    found["$defs"] |= {name: _admissible(parameter) for name, parameter in PARAMETERS.items()} | {
        "spacing": _one_of(dict.fromkeys(("linspace", "geomspace"), [_NUMBER, _NUMBER, whole(1, LONGEST_AXIS)])),
        "drawn": _one_of({kind: [_NUMBER] * len(names) for kind, (names, _) in DISTRIBUTIONS.items()}),
    }
    found["$defs"]["drawn"]["properties"][CHOICE] = _VALUES
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **found, "title": "fastcoil study"}


def _table(properties: Mapping[str, Schema], required: Iterable[str] = (), own: Schema | bool = False) -> Schema:
    """A table with these keys; any other is like ``own``, or wrong."""
    return {
        "type": "object", "properties": dict(properties), "required": list(required), "additionalProperties": own,
    }  # fmt: skip


def _one_of(lists: Mapping[str, list[Schema]]) -> Schema:
    """A table with one of these keys, each with a list of exactly these items."""
    return _table({name: _list_of(items) for name, items in lists.items()}) | {"minProperties": 1, "maxProperties": 1}


def _list_of(items: list[Schema]) -> Schema:
    return {"type": "array", "prefixItems": items, "items": False, "minItems": len(items)}


def _ref(name: str) -> Schema:
    return {"$ref": f"#/$defs/{name}"}


def _admissible(parameter: Parameter) -> Schema:
    """Values of a parameter, its meaning, unit and default."""
    unit = "" if parameter.unit in ("", "1") else f" [{parameter.unit}]"
    schema: Schema = {"description": parameter.text + unit}
    if parameter.is_word:
        words: Schema = {"enum": list(parameter.choices)}
        schema |= {"anyOf": [words, {"type": "string", "pattern": ":"}]} if parameter.name in KINDS else words
    else:
        schema["type"] = "integer" if parameter.whole else "number"
    if not math.isinf(parameter.lower):
        schema["exclusiveMinimum" if parameter.open_lower else "minimum"] = parameter.lower
    if not math.isinf(parameter.upper):
        schema["exclusiveMaximum" if parameter.open_upper else "maximum"] = parameter.upper
    return schema if parameter.default is None else schema | {"default": parameter.default}


def _day(kind: str) -> Schema:
    """The arguments of a kind of boundary: their annotations, and the bounds of conditions."""
    make = BOUNDARY_KINDS[kind]
    hints, arguments = get_type_hints(make), inspect.signature(make).parameters
    properties: dict[str, Schema] = {"kind": {"const": kind}}
    for name in arguments:
        properties[name] = TypeAdapter(hints[name]).json_schema()
        if name in CONDITIONS and hints[name] in (float, float | None):
            bounds = _admissible(CONDITIONS[name])
            properties[name] |= {word: bounds[word] for word in bounds if word not in ("type", "default")}
    needed = [name for name, argument in arguments.items() if argument.default is argument.empty]
    if kind != next(iter(BOUNDARY_KINDS)):
        needed.append("kind")
    return _table(properties, needed)

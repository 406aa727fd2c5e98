"""The JSON Schema of study files, with which an editor completes and checks one as it is written.

It is derived from the tables that the reader itself uses: the models of ``tables``, the parameters, the functions that
make days.  The reader may refuse a file that the schema accepts, since a schema cannot express every rule.  The
parameters of a study's own estimators and laws stand in another file: where a study names one, any other name may be
one of its parameters; where it names none, no other name is right.
"""

import inspect
import math
from collections.abc import Iterable, Mapping
from typing import Any, get_args, get_type_hints

from pydantic import TypeAdapter

from fastcoil.design.tuning_plan import may_be_searched
from fastcoil.loops.assignment import FORBIDDEN_DIMS, MEANING, WORD
from fastcoil.loops.boundary.conditions import CONDITIONS
from fastcoil.loops.boundary.days import DESIGNS
from fastcoil.loops.plan import RUN_LIMITS
from fastcoil.loops.presets import PRESETS
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.model.user_rules import KINDS
from fastcoil.study.file.loop import LONGEST_AXIS
from fastcoil.study.file.sampling import (
    CHOICE,
    DESIGN_DIM,
    DISTRIBUTIONS,
    LARGEST_SAMPLE,
    METHODS,
    POWERS_OF_TWO,
    SAMPLE_DIM,
)
from fastcoil.study.file.spec import BOUNDARY_KINDS
from fastcoil.study.file.tables import Schema, StudyFile, list_of, whole

NAME = r"[^\W\d]\w*"
FUNCTION: Schema = {"type": "string", "pattern": rf"^{NAME}(\.{NAME})*:{NAME}$"}
_OWN = "own parameter"  # not the name of a parameter
_ABOVE_0 = {("loguniform", "lowest"), ("truncnorm", "standard deviation")}


def study_schema() -> Schema:
    """JSON Schema (draft 2020-12) of a study file, as a dict that ``json.dumps`` takes."""
    found = StudyFile.model_json_schema()
    found["properties"] |= {
        "loop": _with_own(_loop_words() | {n: _ref(n) for n in PARAMETERS}, _ref(_OWN)),
        "sweep": _with_own({n: _axis(p) for n, p in PARAMETERS.items()}, _swept(_OWN)),
        "cases": _cases(),
        "sample": _sample(),
        "boundary": _boundary(),
        "run": _ref("RunTable"),
        "tune": _ref("TuneTable"),
        "tariff": _ref("TariffTable"),
    }
    found["$defs"]["RunTable"]["properties"]["reduce"] = FUNCTION
    tune = found["$defs"]["TuneTable"]["properties"]
    tune["search"] |= {"properties": {n: _bounds(n) for n in _searchable()}, "additionalProperties": _bounds(_OWN)}
    tune["holdout"] = {"anyOf": [{"type": "array", "items": {"type": "integer"}, "minItems": 1}, _boundary()]}
    found["$defs"] |= {
        **{name: _admissible(p) for name, p in PARAMETERS.items()},
        _OWN: {"type": "number", "description": "parameter of an estimator or a law of the study's own"},
        **{kind: _spacing(kind) for kind in ("linspace", "geomspace")},
        **{kind: _distribution(kind) for kind in DISTRIBUTIONS},
    }
    known = {table: _only(found["properties"][table]["properties"]) for table in ("loop", "sweep", "sample")}
    known["cases"] = {"additionalProperties": {"additionalProperties": _only(PARAMETERS)}}
    known["tune"] = {"properties": {"search": _only(_searchable())}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **found,
        "title": "fastcoil study",
        "if": _names_a_rule(),
        "else": {"properties": known},
    }


def _table(properties: Mapping[str, Schema], required: Iterable[str] = (), **more: Any) -> Schema:
    """A table with these keys and no other."""
    required = list(required)
    return {
        "type": "object", "properties": dict(properties), "required": required, "additionalProperties": False, **more,
    }  # fmt: skip


def _with_own(properties: Mapping[str, Schema], own: Schema, **more: Any) -> Schema:
    """A table that may also have parameters of the study's own rules, each like ``own``."""
    return _table(properties, **{"propertyNames": {"pattern": f"^{NAME}$"}, "additionalProperties": own, **more})


def _only(names: Iterable[str]) -> Schema:
    return {"propertyNames": {"enum": list(names)}}


def _ref(name: str) -> Schema:
    """The values of a parameter, defined once for all tables."""
    return {"$ref": f"#/$defs/{name}"}


def _has(name: str, value: Schema) -> Schema:
    return {"properties": {name: value}, "required": [name]}


def _names_a_rule() -> Schema:
    """Whether an estimator or a law is ``module:function``, in whichever table."""

    def rule(value: Schema) -> Schema:
        return {"anyOf": [_has(kind, value) for kind in KINDS]}

    listed = {"contains": FUNCTION}
    no_case = {"additionalProperties": {"additionalProperties": {"not": rule(FUNCTION)}}}
    places = {
        "loop": rule(FUNCTION), "sweep": rule(listed), "cases": {"not": no_case}, "sample": rule(_has(CHOICE, listed)),
    }  # fmt: skip
    return {"anyOf": [_has(table, value) for table, value in places.items()]}


def _admissible(parameter: Parameter) -> Schema:
    """Values of a parameter, its meaning, unit and default."""
    unit = "" if parameter.unit in ("", "1") else f" [{parameter.unit}]"
    schema: Schema = {"description": parameter.text + unit}
    if parameter.name in KINDS:
        schema["anyOf"] = [{"enum": list(parameter.choices)}, FUNCTION]
    elif parameter.is_word:
        schema["enum"] = list(parameter.choices)
    else:
        schema["type"] = "integer" if parameter.whole else "number"
    if not math.isinf(parameter.lower):
        schema["exclusiveMinimum" if parameter.open_lower else "minimum"] = parameter.lower
    if not math.isinf(parameter.upper):
        schema["exclusiveMaximum" if parameter.open_upper else "maximum"] = parameter.upper
    return schema if parameter.default is None else schema | {"default": parameter.default}


def _loop_words() -> dict[str, Schema]:
    return {
        "preset": {"enum": list(PRESETS), "default": "paper_like", "description": "where the defaults come from"},
        "include": {
            "type": "array", "items": {"type": "string"}, "description": "files that `fastcoil fit` wrote",
        },
        WORD: {"type": "boolean", "default": False, "description": f"true stands for {MEANING}"},
    }  # fmt: skip


def _values(name: str) -> Schema:
    return {"type": "array", "items": _ref(name), "minItems": 1, "uniqueItems": True}


def _axis(parameter: Parameter) -> Schema:
    return _values(parameter.name) if parameter.is_word else _swept(parameter.name)


def _swept(name: str) -> Schema:
    return {"anyOf": [_values(name), _ref("linspace"), _ref("geomspace")]}


def _spacing(kind: str) -> Schema:
    end: Schema = {"type": "number"} | ({"exclusiveMinimum": 0} if kind == "geomspace" else {})
    ends = ({**end, "description": f"{place} value"} for place in ("first", "last"))
    return _table({kind: list_of([*ends, whole(1, LONGEST_AXIS, "number of values")])}, [kind])


def _cases() -> Schema:
    case = _with_own({n: _ref(n) for n in PARAMETERS}, _ref(_OWN))
    taken = sorted({SAMPLE_DIM, DESIGN_DIM, *PARAMETERS, *FORBIDDEN_DIMS})
    return {
        "type": "object",
        "description": "named alternatives along dimensions of their own",
        "propertyNames": {"pattern": f"^{NAME}$", "not": {"enum": taken}},
        "additionalProperties": {"type": "object", "minProperties": 1, "additionalProperties": case},
    }


def _sample() -> Schema:
    settings: dict[str, Schema] = {
        "method": {"enum": list(METHODS), "description": "how the samples fill the space"},
        "size": whole(1, LARGEST_SAMPLE, "number of samples"),
        "seed": whole(*RUN_LIMITS["seed"]) | {"default": 0},
    }
    sampled = {n: _chosen(n) if p.is_word or p.whole else _drawn(n) for n, p in PARAMETERS.items()}
    powers = [2**k for k in range(LARGEST_SAMPLE.bit_length())]
    return _with_own(
        settings | sampled,
        _drawn(_OWN),
        required=["method", "size"],
        description=f"parameters drawn together along the dimension {SAMPLE_DIM}",
        **{
            "not": _only(settings),
            "if": {"properties": {"method": {"enum": list(POWERS_OF_TWO)}}},
            "then": {"properties": {"size": {"enum": powers}}},
        },
    )


def _chosen(name: str) -> Schema:
    return _table({CHOICE: _values(name)}, [CHOICE])


def _drawn(name: str) -> Schema:
    return {"anyOf": [*map(_ref, DISTRIBUTIONS), _chosen(name)]}


def _distribution(kind: str) -> Schema:
    arguments = [
        {"type": "number", "description": name} | ({"exclusiveMinimum": 0} if (kind, name) in _ABOVE_0 else {})
        for name in DISTRIBUTIONS[kind].arguments
    ]
    return _table({kind: list_of(arguments)}, [kind])


def _searchable() -> list[str]:
    """The parameters that a tuning may choose."""
    return [name for name, parameter in PARAMETERS.items() if may_be_searched(parameter)]


def _bounds(name: str) -> Schema:
    return list_of(_ref(name) | {"description": end} for end in ("lowest", "highest"))


def _boundary() -> Schema:
    """Which arguments are known and needed depends on the kind."""
    kind = {"enum": list(BOUNDARY_KINDS), "default": "paper_day", "description": "which kind of day"}
    by_kind = []
    for name, make in BOUNDARY_KINDS.items():
        signature, hints = inspect.signature(make).parameters, get_type_hints(make)
        arguments = {n: _annotated(n, hints[n], p.default) for n, p in signature.items()}
        required = [n for n, p in signature.items() if p.default is p.empty]
        chosen: Schema = {"properties": {"kind": {"const": name}}}
        if name != kind["default"]:
            chosen["required"] = ["kind"]
        what = (inspect.getdoc(make) or "").partition("\n")[0]
        table = _table({"kind": {"const": name}} | arguments, required, description=what)
        by_kind.append({"if": chosen, "then": table})
    description = "what acts on the coil, second by second"
    return {"type": "object", "description": description, "properties": {"kind": kind}, "allOf": by_kind}


def _annotated(name: str, hint: Any, default: Any) -> Schema:
    """An argument of a boundary: its annotation, and its bounds if it is one of ``CONDITIONS``."""
    if set(get_args(hint) or [hint]) - {type(None)} == {float} and name in CONDITIONS:
        schema = _admissible(CONDITIONS[name])
        schema.pop("default", None)
    elif hint is Any:
        schema = {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}
    elif name == "mode":
        schema = {"enum": list(DESIGNS)}
    else:
        found = TypeAdapter(hint).json_schema()
        schema = {"anyOf": [kind for kind in found.get("anyOf", [found]) if kind != {"type": "null"}]}
    if default is None or default is inspect.Parameter.empty:
        return schema
    return schema | {"default": list(default) if isinstance(default, tuple) else default}

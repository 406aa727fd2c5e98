"""What the JSON Schema of study files is made of: objects and lists, the values of a parameter, the kinds of days.

The JSON Schema of study files, with which an editor completes and checks one as it is written.

It is derived from the tables that the reader itself uses.  The reader may refuse a file that the schema accepts, since
a schema cannot express every rule.  The parameters of a study's own estimators and laws stand in another file, so that
where a study names one, any other name may be one of its parameters; where it names none, no other name is right.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, get_args, get_type_hints

from pydantic import TypeAdapter

from fastcoil.design.measures import COUNTED, MARGIN, MEAN, NO_GOALS, NOW
from fastcoil.design.search_space import may_be_searched
from fastcoil.design.tuning_plan import EVALUATIONS, MOST_EVALUATIONS, OBJECTIVE, QUANTILE
from fastcoil.loops.assignment import FORBIDDEN_DIMS, MEANING, WORD
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.conditions import CONDITIONS
from fastcoil.loops.boundary.days import DESIGNS
from fastcoil.loops.plan import RUN_LIMITS
from fastcoil.loops.presets import PRESETS
from fastcoil.model.metric_table import TRACES
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.model.user_rules import KINDS
from fastcoil.study.analysis.cost import COP, COP_LIMITS, CURRENCY, DEAREST, LONGEST_CURRENCY, PRICES
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
from fastcoil.study.file.tables import RunTable, StudyFile, TariffTable, TuneTable

Schema = dict[str, Any]

NAME = r"[^\W\d]\w*"
FUNCTION: Schema = {"type": "string", "pattern": rf"^{NAME}(\.{NAME})*:{NAME}$"}
_SERIES: Schema = {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}


def table_of(properties: Mapping[str, Schema], required: Iterable[str] = (), **more: Any) -> Schema:
    """A table with these keys and no other."""
    named = {"required": list(required)} if required else {}
    return {"type": "object", "properties": dict(properties), "additionalProperties": False, **named, **more}


def list_of(items: Iterable[Schema]) -> Schema:
    """A list of exactly these items."""
    items = list(items)
    return {"type": "array", "prefixItems": items, "items": False, "minItems": len(items)}


def admissible(parameter: Parameter) -> Schema:
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


def reference_to(name: str) -> Schema:
    """The values of a parameter, defined once for all tables."""
    return {"$ref": f"#/$defs/{name}"}


def boundary_schema() -> Schema:
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
        by_kind.append(
            {"if": chosen, "then": table_of({"kind": {"const": name}} | arguments, required, **_summary(make))}
        )
    return {
        "type": "object",
        "description": "what acts on the coil, second by second",
        "properties": {"kind": kind},
        "allOf": by_kind,
    }


def _summary(make: Callable[..., Boundary]) -> Schema:
    return {"description": (inspect.getdoc(make) or "").partition("\n")[0]}


def _annotated(name: str, hint: Any, default: Any) -> Schema:
    """An argument of a boundary: its annotation, and its bounds if it is one of ``CONDITIONS``."""
    kinds = set(get_args(hint) or [hint]) - {type(None)}
    if kinds == {float} and name in CONDITIONS:
        schema = admissible(CONDITIONS[name])
        schema.pop("default", None)
    elif hint is Any:
        schema = dict(_SERIES)
    elif name == "mode":
        schema = {"enum": list(DESIGNS)}
    else:
        found = TypeAdapter(hint).json_schema()
        schema = {"anyOf": [kind for kind in found.get("anyOf", [found]) if kind != {"type": "null"}]}
    if default is None or default is inspect.Parameter.empty:
        return schema
    return schema | {"default": list(default) if isinstance(default, tuple) else default}


_OWN = "own parameter"
"""Not the name of a parameter."""
_ABOVE_0 = {("loguniform", "lowest"), ("truncnorm", "standard deviation")}


def study_schema() -> Schema:
    """JSON Schema (draft 2020-12) of a study file, as a dict that ``json.dumps`` takes."""
    tables = {
        "title": {"type": "string", "description": "what the study is called in summaries and figures"},
        "question": {"type": "string", "description": "what the study asks"},
        "loop": _with_own(_preset() | _parameters(), reference_to(_OWN), description="what all loops have in common"),
        "sweep": _with_own(
            {n: _axis(p) for n, p in PARAMETERS.items()}, _swept(_OWN), description="each on its own axis"
        ),
        "cases": _cases(),
        "sample": _sample(),
        "boundary": boundary_schema(),
        "run": _run(),
        "tune": _tune(),
        "tariff": _tariff(),
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "fastcoil study",
        "description": "Which loops are simulated on which days",
        **table_of(
            {name: tables[name] for name in StudyFile.model_fields},
            required=[name for name, field in StudyFile.model_fields.items() if field.is_required()],
        ),
        "if": _names_a_rule(),
        "else": {"properties": _without_own(tables)},
        "$defs": {name: admissible(p) for name, p in PARAMETERS.items()}
        | {_OWN: {"type": "number", "description": "parameter of an estimator or a law of the study's own"}}
        | {kind: _spacing(kind) for kind in ("linspace", "geomspace")}
        | {kind: _distribution(kind) for kind in DISTRIBUTIONS},
    }


def _with_own(properties: Mapping[str, Schema], own: Schema, **more: Any) -> Schema:
    """A table that may also have parameters of the study's own rules, each like ``own``."""
    return table_of(properties, **{"propertyNames": {"pattern": f"^{NAME}$"}, "additionalProperties": own, **more})


def _names_a_rule() -> Schema:
    """Whether an estimator or a law is ``module:function``, in whichever table."""
    listed = {"type": "array", "contains": FUNCTION}
    drawn = {"type": "object", "properties": {CHOICE: listed}, "required": [CHOICE]}
    constant = _has_rule(FUNCTION)
    no_case = {"additionalProperties": {"additionalProperties": {"not": constant}}}
    named = {
        "loop": constant,
        "sweep": _has_rule(listed),
        "cases": {"not": no_case},
        "sample": _has_rule(drawn),
    }
    return {"anyOf": [_has(table, has_rule) for table, has_rule in named.items()]}


def _has_rule(value: Schema) -> Schema:
    return {"anyOf": [_has(kind, value) for kind in KINDS]}


def _has(name: str, value: Schema) -> Schema:
    return {"properties": {name: value}, "required": [name]}


def _without_own(tables: Mapping[str, Schema]) -> dict[str, Schema]:
    """The tables with the names that they know, and no other."""
    case = {"properties": dict.fromkeys(PARAMETERS, True), "additionalProperties": False}
    known = {
        name: {"properties": dict.fromkeys(tables[name]["properties"], True), "additionalProperties": False}
        for name in ("loop", "sweep", "sample")
    }
    searched = {"properties": dict.fromkeys(_searchable(), True), "additionalProperties": False}
    known["tune"] = {"properties": {"search": searched}}
    return known | {"cases": {"additionalProperties": {"additionalProperties": case}}}


def _parameters() -> dict[str, Schema]:
    return {name: reference_to(name) for name in PARAMETERS}


def _preset() -> dict[str, Schema]:
    files = {"type": "array", "items": {"type": "string"}, "description": "files that `fastcoil fit` wrote"}
    preset = {"enum": list(PRESETS), "default": "paper_like", "description": "where the defaults come from"}
    converged = {"type": "boolean", "default": False, "description": f"true stands for {MEANING}"}
    return {"preset": preset, "include": files, WORD: converged}


def _values(name: str) -> Schema:
    return {"type": "array", "items": reference_to(name), "minItems": 1, "uniqueItems": True}


def _axis(parameter: Parameter) -> Schema:
    return _values(parameter.name) if parameter.is_word else _swept(parameter.name)


def _swept(name: str) -> Schema:
    return {"anyOf": [_values(name), reference_to("linspace"), reference_to("geomspace")]}


def _spacing(kind: str) -> Schema:
    end: Schema = {"type": "number"} | ({"exclusiveMinimum": 0} if kind == "geomspace" else {})
    count = {"type": "integer", "minimum": 1, "maximum": LONGEST_AXIS, "description": "number of values"}
    ends = (end | {"description": "first value"}, end | {"description": "last value"})
    return table_of({kind: list_of([*ends, count])}, required=[kind])


def _cases() -> Schema:
    case = _with_own(_parameters(), reference_to(_OWN))
    taken = sorted({SAMPLE_DIM, DESIGN_DIM, *PARAMETERS, *FORBIDDEN_DIMS})
    return {
        "type": "object",
        "description": "named alternatives along dimensions of their own",
        "propertyNames": {"pattern": f"^{NAME}$", "not": {"enum": taken}},
        "additionalProperties": {"type": "object", "minProperties": 1, "additionalProperties": case},
    }


def _sample() -> Schema:
    powers = [2**k for k in range(LARGEST_SAMPLE.bit_length())]
    settings: dict[str, Schema] = {
        "method": {"enum": list(METHODS), "description": "how the samples fill the space"},
        "size": {"type": "integer", "minimum": 1, "maximum": LARGEST_SAMPLE, "description": "number of samples"},
        "seed": _limited("seed") | {"default": 0},
    }
    return _with_own(
        settings | {name: _sampled(p) for name, p in PARAMETERS.items()},
        _drawn(_OWN),
        required=["method", "size"],
        description=f"parameters drawn together along the dimension {SAMPLE_DIM}",
        **{
            "not": {"propertyNames": {"enum": list(settings)}},
            "if": {"properties": {"method": {"enum": list(POWERS_OF_TWO)}}},
            "then": {"properties": {"size": {"enum": powers}}},
        },
    )


def _sampled(parameter: Parameter) -> Schema:
    return _chosen(parameter.name) if parameter.is_word or parameter.whole else _drawn(parameter.name)


def _chosen(name: str) -> Schema:
    return table_of({CHOICE: _values(name)}, required=[CHOICE])


def _drawn(name: str) -> Schema:
    return {"anyOf": [*map(reference_to, DISTRIBUTIONS), _chosen(name)]}


def _distribution(kind: str) -> Schema:
    arguments = [
        {"type": "number", "description": name} | ({"exclusiveMinimum": 0} if (kind, name) in _ABOVE_0 else {})
        for name in DISTRIBUTIONS[kind].arguments
    ]
    return table_of({kind: list_of(arguments)}, required=[kind])


def _run() -> Schema:
    numbers = {name: _limited(name) | {"default": RunTable.model_fields[name].default} for name in RUN_LIMITS}
    others: dict[str, Schema] = {
        "traces": {"type": "array", "items": {"enum": list(TRACES)}, "uniqueItems": True},
        "carry_over": {"type": "boolean", "default": False, "description": "each day begins as the one before ended"},
        "reduce": FUNCTION,
        "predict": {"type": "boolean", "default": False, "description": "add what theory predicts of the hunting"},
    }
    known = numbers | others
    return table_of(
        {name: known[name] for name in RunTable.model_fields},
        description="how to run, not what",
        dependentRequired={"reduce": ["traces"]},
    )


def _searchable() -> list[str]:
    """The parameters that a tuning may choose."""
    return [name for name, parameter in PARAMETERS.items() if may_be_searched(parameter)]


def _tune() -> Schema:
    def bounds(name: str) -> Schema:
        return list_of(
            [reference_to(name) | {"description": "lowest"}, reference_to(name) | {"description": "highest"}]
        )

    share: Schema = {"anyOf": [{"type": "number", "exclusiveMinimum": 0, "maximum": 1}, {"const": MEAN}]}
    most: Schema = {"anyOf": [{"type": "number"}, {"const": NOW}]}
    limit: Schema = {"anyOf": [*most["anyOf"], list_of([most, share])]}
    known: dict[str, Schema] = {
        "search": {
            "type": "object",
            "description": "what may be chosen: [lowest, highest] by parameter",
            "minProperties": 1,
            "properties": {name: bounds(name) for name in _searchable()},
            "additionalProperties": bounds(_OWN),
        },
        "objective": {"enum": [name for name in COUNTED if name not in NO_GOALS], "default": OBJECTIVE},
        "quantile": share | {"default": QUANTILE, "description": "share of valves and days whose value counts"},
        "limits": table_of(dict.fromkeys((*COUNTED, MARGIN), limit), description="upper limits by metric"),
        "holdout": {"anyOf": [{"type": "array", "items": {"type": "integer"}, "minItems": 1}, boundary_schema()]},
        "evaluations": {"type": "integer", "minimum": 1, "maximum": MOST_EVALUATIONS, "default": EVALUATIONS},
    }
    return table_of(
        {name: known[name] for name in TuneTable.model_fields},
        required=["search"],
        description="what `fastcoil tune` chooses for all valves and days",
    )


def _tariff() -> Schema:
    low, high = COP_LIMITS
    prices: dict[str, Schema] = {
        name: {"type": "number", "minimum": 0, "maximum": DEAREST, "description": meaning}
        for name, (meaning, _) in PRICES.items()
    }
    others: dict[str, Schema] = {
        "cop": {"type": "number", "minimum": low, "maximum": high, "default": COP, "description": "of the chiller"},
        "electric_heat": {"type": "boolean", "default": False, "description": "heating coils also pay for demand"},
        "currency": {"type": "string", "minLength": 1, "maxLength": LONGEST_CURRENCY, "default": CURRENCY},
        "baseline": {
            "type": "object",
            "description": "dim and label of the loops to compare with; those without backlash by default",
            "additionalProperties": {"type": ["number", "string"]},
        },
    }
    known = prices | others
    return table_of(
        {name: known[name] for name in TariffTable.model_fields},
        required=PRICES,
        description="prices: the summary of a run then says what backlash costs a year",
    )


def _limited(name: str) -> Schema:
    low, high = RUN_LIMITS[name]
    return {"type": "integer", "minimum": low} | ({} if high is None else {"maximum": high})

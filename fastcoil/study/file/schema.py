"""The JSON Schema of study files, with which an editor completes and checks one as it is written.

It is derived from the tables that the reader itself uses.  The reader may refuse a file that the schema accepts, since
a schema cannot express every rule.  The parameters of a study's own estimators and laws stand in another file, so that
where a study names one, any other name may be one of its parameters; where it names none, no other name is right.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastcoil.design.tuning.measures import COUNTED, MARGIN, MEAN, NO_GOALS, NOW
from fastcoil.design.tuning.plan import EVALUATIONS, MOST_EVALUATIONS, OBJECTIVE, QUANTILE
from fastcoil.design.tuning.space import may_be_searched
from fastcoil.loops.assignment import FORBIDDEN_DIMS, MEANING, WORD
from fastcoil.loops.plan import RUN_LIMITS
from fastcoil.loops.presets import PRESETS
from fastcoil.model.metric_table import TRACES
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.model.user_rules.rule import KINDS
from fastcoil.study.analysis.tariff import COP, COP_LIMITS, CURRENCY, DEAREST, LONGEST_CURRENCY, PRICES
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
from fastcoil.study.file.schema_parts import (
    FUNCTION,
    NAME,
    Schema,
    admissible,
    boundary_schema,
    list_of,
    reference_to,
    table_of,
)
from fastcoil.study.file.tables import RunTable, StudyFile, TariffTable, TuneTable

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
    """A table that may have parameters of the study's own rules, too, each like ``own``."""
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
        "predict": {"type": "boolean", "default": False, "description": "add what theory foretells of the hunting"},
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
        "electric_heat": {"type": "boolean", "default": False, "description": "heating coils pay for demand, too"},
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

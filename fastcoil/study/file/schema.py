"""The JSON Schema of study files, with which an editor completes names, shows what they mean and marks wrong values.

It is valid for Draft 4, which Taplo reads (the engine behind most TOML extensions), and for Draft 2020-12 alike.  What
only the reader can know, such as parameters of a study's own rules, is left to the reader.
"""

import inspect
import json
import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from fastcoil.design.tuning_plan import plan_tuning
from fastcoil.loops.presets import PRESETS
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.model.user_rules import RULE_KINDS
from fastcoil.study.analysis.cost import Tariff
from fastcoil.study.file.loop import SPACINGS
from fastcoil.study.file.sample import DISTRIBUTION_KINDS as KINDS_OF_SAMPLE
from fastcoil.study.file.sample import DISTRIBUTIONS, METHODS
from fastcoil.study.file.spec import BOUNDARY_KINDS
from fastcoil.study.file.tables import StudyFile

SCHEMA_FILE = "fastcoil.schema.json"
SCHEMA_DIRECTIVE = f"#:schema {SCHEMA_FILE}\n"
_NUMBER_SCHEMA, _NUMBERS_SCHEMA = {"type": "number"}, {"type": "array", "items": {"type": "number"}}


def schema_text() -> str:
    """The schema as JSON, for a file beside the studies whose first line names it."""
    whole = StudyFile.model_json_schema()
    whole["$defs"] |= {"Spaced": _spacing_schema(), "Drawn": _distribution_schema()}
    tables, run = whole["properties"], whole["$defs"]["RunTable"]["properties"]
    parameter_schemas = {name: _parameter_schema(parameter) for name, parameter in PARAMETERS.items()}
    include = {"type": "array", "items": {"type": "string"}, "description": "files that `fastcoil fit` wrote"}
    loops = {"preset": {"enum": list(PRESETS)}, "include": include}
    tables["loop"] = _table_schema(loops | parameter_schemas, "the same for all loops")
    tables["sweep"] = _table_schema(
        {n: _axis_schema(value) for n, value in parameter_schemas.items()}, "each on an axis of its own"
    )
    tables["cases"]["additionalProperties"]["additionalProperties"] = _table_schema(
        parameter_schemas, "one of the named alternatives"
    )
    tables["sample"] = _table_schema(_sample_properties(), "drawn together")
    arguments: dict[str, Any] = {
        name: {} for make in BOUNDARY_KINDS.values() for name in inspect.signature(make).parameters
    }
    tables["boundary"] = _table_schema({"kind": {"enum": list(BOUNDARY_KINDS)}} | arguments, "what acts on the coil")
    run["traces"]["items"] = {"enum": list(TRACES)}
    whole["$defs"]["PrecisionTable"]["properties"]["metric"] = {"enum": list(METRICS)}
    tuning_parameters = inspect.signature(plan_tuning).parameters.values()
    tuning_names = [each.name for each in tuning_parameters if each.kind is each.KEYWORD_ONLY and each.name not in run]
    tables["tune"] = _table_schema({name: {} for name in tuning_names}, "what `fastcoil tune` chooses", closed=True)
    prices: dict[str, Any] = {each.name: {} for each in fields(Tariff)} | {"baseline": {"type": "object"}}
    tables["tariff"] = _table_schema(prices, "prices", closed=True)
    return (
        json.dumps(_drop_nulls_and_titles(whole) | {"title": "A study of fastcoil"}, indent=1, ensure_ascii=False)
        + "\n"
    )


def _table_schema(properties: Mapping[str, Any], text: str, *, closed: bool = False) -> dict[str, Any]:
    return {"type": "object", "description": text, "properties": properties, "additionalProperties": not closed}


def _parameter_schema(parameter: Parameter) -> dict[str, Any]:
    """One parameter; an open bound counts as closed, for the drafts write it in two ways."""
    unit = "" if parameter.unit in ("", "1") else f", {parameter.unit}"
    schema: dict[str, Any] = {"description": f"{parameter.text}{unit} ({parameter.bounds})"}
    if parameter.name in RULE_KINDS:  # or a rule of one's own
        return schema | {"anyOf": [{"enum": list(parameter.choices)}, {"type": "string", "pattern": ":"}]}
    if parameter.is_word:
        return schema | {"enum": list(parameter.choices)}
    bounds = {"minimum": parameter.lower, "maximum": parameter.upper}
    return schema | _NUMBER_SCHEMA | {name: bound for name, bound in bounds.items() if math.isfinite(bound)}


def _axis_schema(value: Mapping[str, Any]) -> dict[str, Any]:
    list_schema = {"type": "array", "items": value, "minItems": 1}
    return {"description": value["description"], "anyOf": [list_schema, {"$ref": "#/$defs/Spaced"}]}


def _spacing_schema() -> dict[str, Any]:
    ends_and_count = _NUMBERS_SCHEMA | {"minItems": 3, "maxItems": 3}
    return _table_schema(dict.fromkeys(SPACINGS, ends_and_count), "first, last, count", closed=True)


def _sample_properties() -> dict[str, Any]:
    distributions = {
        name: {"description": p.text, "allOf": [{"$ref": "#/$defs/Drawn"}]} for name, p in PARAMETERS.items()
    }
    size, seed = {"type": "integer", "minimum": 1}, {"type": "integer"}
    pairs = {"type": "array", "description": "pairs with their rank correlation"}
    return {"method": {"enum": list(METHODS)}, "size": size, "seed": seed, "correlation": pairs} | distributions


def _distribution_schema() -> dict[str, Any]:
    argument_schemas = {
        name: _NUMBERS_SCHEMA | {"description": ", ".join(names)} for name, (names, _) in DISTRIBUTIONS.items()
    }
    return _table_schema(
        {name: {} for name in (*KINDS_OF_SAMPLE, "column")} | argument_schemas, "a distribution", closed=True
    )


def _drop_nulls_and_titles(node: Any) -> Any:
    """Without what TOML cannot hold (null), and without titles that only repeat a key."""
    if isinstance(node, list):
        return [_drop_nulls_and_titles(each) for each in node if each != {"type": "null"}]
    if not isinstance(node, dict):
        return node
    kept = {name: each for name, each in node.items() if not (name == "title" and isinstance(each, str))}
    return {name: _drop_nulls_and_titles(each) for name, each in kept.items() if each is not None}

"""The JSON Schema of study files, with which an editor completes names, shows what they mean and marks wrong values.

It is valid for Draft 4, which Taplo reads (the engine behind most TOML extensions), and for Draft 2020-12 alike.  What
only the reader can know, such as parameters of user-defined rules, is left to the reader.
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
from fastcoil.study.file.sample import DISTRIBUTION_KINDS, DISTRIBUTIONS, METHODS
from fastcoil.study.file.spec import BOUNDARY_KINDS
from fastcoil.study.file.tables import StudyFile

SCHEMA_FILE = "fastcoil.schema.json"
SCHEMA_DIRECTIVE = f"#:schema {SCHEMA_FILE}\n"
_NUMBER = {"type": "number"}
_NUMBERS = {"type": "array", "items": _NUMBER}


def schema_text() -> str:
    """Return the schema as JSON, for a file beside the studies whose first line names it."""
    whole = StudyFile.model_json_schema()
    whole["$defs"] |= {"Spaced": _spacing_schema(), "Drawn": _distribution_schema()}
    tables, run = whole["properties"], whole["$defs"]["RunTable"]["properties"]
    schemas = {name: _parameter_schema(parameter) for name, parameter in PARAMETERS.items()}
    include = {"type": "array", "items": {"type": "string"}, "description": "files that `fastcoil fit` wrote"}
    loops = {"preset": {"enum": list(PRESETS)}, "include": include}
    tables["loop"] = _table_schema(loops | schemas, "the same for all loops")
    axes = {name: _axis_schema(schema) for name, schema in schemas.items()}
    tables["sweep"] = _table_schema(axes, "each on an axis of its own")
    cases = _table_schema(schemas, "one of the named alternatives")
    tables["cases"]["additionalProperties"]["additionalProperties"] = cases
    tables["sample"] = _table_schema(_sample_properties(), "drawn together")
    names = dict.fromkeys(name for make in BOUNDARY_KINDS.values() for name in inspect.signature(make).parameters)
    boundary = {"kind": {"enum": list(BOUNDARY_KINDS)}} | {name: {} for name in names}
    tables["boundary"] = _table_schema(boundary, "what acts on the coil")
    run["traces"]["items"] = {"enum": list(TRACES)}
    whole["$defs"]["PrecisionTable"]["properties"]["metric"] = {"enum": list(METRICS)}
    options = inspect.signature(plan_tuning).parameters.values()
    tune: dict[str, Any] = {o.name: {} for o in options if o.kind is o.KEYWORD_ONLY and o.name not in run}
    tables["tune"] = _table_schema(tune, "what `fastcoil tune` chooses", closed=True)
    prices: dict[str, Any] = {price.name: {} for price in fields(Tariff)} | {"baseline": {"type": "object"}}
    tables["tariff"] = _table_schema(prices, "prices", closed=True)
    schema = _drop_nulls_and_titles(whole) | {"title": "A study of fastcoil"}
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def _table_schema(properties: Mapping[str, Any], text: str, *, closed: bool = False) -> dict[str, Any]:
    return {"type": "object", "description": text, "properties": properties, "additionalProperties": not closed}


def _parameter_schema(parameter: Parameter) -> dict[str, Any]:
    """Return the schema of a parameter; an open bound counts as closed, since the drafts write it in two ways."""
    unit = "" if parameter.unit in ("", "1") else f", {parameter.unit}"
    schema: dict[str, Any] = {"description": f"{parameter.text}{unit} ({parameter.bounds})"}
    if parameter.name in RULE_KINDS:  # or a user-defined rule
        return schema | {"anyOf": [{"enum": list(parameter.choices)}, {"type": "string", "pattern": ":"}]}
    if parameter.is_word:
        return schema | {"enum": list(parameter.choices)}
    bounds = {"minimum": parameter.lower, "maximum": parameter.upper}
    return schema | _NUMBER | {name: bound for name, bound in bounds.items() if math.isfinite(bound)}


def _axis_schema(value: Mapping[str, Any]) -> dict[str, Any]:
    list_schema = {"type": "array", "items": value, "minItems": 1}
    return {"description": value["description"], "anyOf": [list_schema, {"$ref": "#/$defs/Spaced"}]}


def _spacing_schema() -> dict[str, Any]:
    ends_and_count = _NUMBERS | {"minItems": 3, "maxItems": 3}
    return _table_schema(dict.fromkeys(SPACINGS, ends_and_count), "first, last, count", closed=True)


def _sample_properties() -> dict[str, Any]:
    drawn = {"allOf": [{"$ref": "#/$defs/Drawn"}]}
    parameters = {name: {"description": parameter.text, **drawn} for name, parameter in PARAMETERS.items()}
    size, seed = {"type": "integer", "minimum": 1}, {"type": "integer"}
    pairs = {"type": "array", "description": "pairs with their rank correlation"}
    return {"method": {"enum": list(METHODS)}, "size": size, "seed": seed, "correlation": pairs} | parameters


def _distribution_schema() -> dict[str, Any]:
    kinds: dict[str, Any] = {name: {} for name in (*DISTRIBUTION_KINDS, "column")}
    kinds |= {name: _NUMBERS | {"description": ", ".join(names)} for name, (names, _) in DISTRIBUTIONS.items()}
    return _table_schema(kinds, "a distribution", closed=True)


def _drop_nulls_and_titles(node: Any) -> Any:
    """Drop what TOML cannot hold (null), and titles that only repeat a key."""
    if isinstance(node, list):
        return [_drop_nulls_and_titles(item) for item in node if item != {"type": "null"}]
    if not isinstance(node, dict):
        return node
    kept = {name: item for name, item in node.items() if not (name == "title" and isinstance(item, str))}
    return {name: _drop_nulls_and_titles(item) for name, item in kept.items() if item is not None}

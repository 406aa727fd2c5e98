"""What the JSON Schema of study files is made of: objects and lists, the values of a parameter, the kinds of days."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, get_args, get_type_hints

from pydantic import TypeAdapter

from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.conditions import CONDITIONS
from fastcoil.loops.boundary.days import DESIGNS
from fastcoil.model.parameter_table import Parameter
from fastcoil.model.user_rules.rule import KINDS
from fastcoil.study.file.boundary import BOUNDARY_KINDS

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

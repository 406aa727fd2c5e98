"""Parameters of a loop as keywords: the table in the docstring of ``Loop``; the stub beside this is for checkers."""

import inspect
from typing import Any, TypedDict, TypeVar

from fastcoil.loops.assignment import CONVERGED_KEYWORD, CONVERGED_TEXT
from fastcoil.model.parameter_table import PARAMETERS

PresetName = Any
Keywords = TypedDict("Keywords", dict.fromkeys((CONVERGED_KEYWORD, *PARAMETERS), Any), total=False)  # type: ignore[misc]
Class = TypeVar("Class", bound=type)


def describe_parameters(cls: Class) -> Class:
    """Put the table of parameters into the docstring of a class, in place of ``{parameters}``."""
    rows = [("name", "unit", "default", "meaning")]
    for p in PARAMETERS.values():
        default = "" if p.default is None else str(p.default) if p.is_word else f"{p.default:g}"
        rows.append((p.name, "" if p.unit == "1" else p.unit, default, p.text))
    rows.append((CONVERGED_KEYWORD, "", "False", f"True stands for {CONVERGED_TEXT}"))
    widths = [*(max(map(len, column)) for column in list(zip(*rows, strict=True))[:3]), len("meaning")]
    border = "  ".join("=" * width for width in widths)
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    table = "\n".join([border, lines[0], border, *lines[1:], border])
    cls.__doc__ = cls.__doc__ and inspect.cleandoc(cls.__doc__).replace("{parameters}", table)  # None with python -OO
    return cls

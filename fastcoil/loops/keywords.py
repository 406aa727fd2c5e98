"""The parameters of a loop as keywords, in signatures and help; for type checkers they are in the stub beside this.

Parameters that a user's rule brings are passed as ``loop.assign(**{"gain": 0.5})``.
"""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, TypedDict, TypeVar

from fastcoil.loops.assignment import CONVERGED_KEYWORD, CONVERGED_TEXT
from fastcoil.model.parameter_table import INTEGER_PARAMETERS, PARAMETERS

PresetName = Any
Keywords = TypedDict("Keywords", dict.fromkeys((CONVERGED_KEYWORD, *PARAMETERS), Any), total=False)  # type: ignore[misc]

Function = TypeVar("Function", bound=Callable[..., Any])
Class = TypeVar("Class", bound=type)


class _Unchanged:
    """Stands in a signature for the value that a parameter has already."""

    def __repr__(self) -> str:
        return "unchanged"


UNCHANGED = _Unchanged()


def take_parameters(defaults: Mapping[str, object]) -> Callable[[Function], Function]:
    """Show ``**values`` of a method as one keyword for each parameter, with these defaults."""

    def decorate(method: Function) -> Function:
        signature = inspect.signature(method)
        positional = [p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        keywords = [inspect.Parameter(n, inspect.Parameter.KEYWORD_ONLY, default=v) for n, v in defaults.items()]
        method.__signature__ = signature.replace(parameters=[*positional, *keywords])  # type: ignore[attr-defined]
        return method

    return decorate


def describe_parameters(cls: Class) -> Class:
    """Put the list of parameters into the docstring of a class, before its examples."""
    if cls.__doc__ is None:  # python -OO
        return cls
    text, heading, examples = inspect.cleandoc(cls.__doc__).partition("Examples\n")
    lines = ["Parameters", "----------"]
    for p in PARAMETERS.values():
        type_name = "str" if p.is_word else "int" if p.name in INTEGER_PARAMETERS else "float"
        default = "optional" if p.default is None else f"default {p.default!r}"
        unit = "" if p.unit in ("", "1") else f" {p.unit}"
        lines += [f"{p.name} : {type_name}, {default}{unit}", f"    {p.text} ({p.bounds})."]
    lines += [f"{CONVERGED_KEYWORD} : bool, default False", f"    True stands for {CONVERGED_TEXT}."]
    cls.__doc__ = "\n".join([text.rstrip(), "", *lines, "", heading + examples])
    return cls

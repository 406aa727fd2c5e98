"""Checks of the arguments of public functions: numbers, names, the level of an interval.

Functions called ``…_problems`` return one sentence for each mistake, so that the caller can report all of them at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from numbers import Integral, Real
from typing import Any

from fastcoil.errors import InputError, shown


def is_number(value: Any) -> bool:
    """Whether ``value`` is one real number, of Python or numpy; True and False are not numbers."""
    return isinstance(value, Real) and not isinstance(value, bool)


def whole_number_problems(name: str, value: object, least: int, most: int | None = None) -> list[str]:
    """Return a sentence if ``value`` is not a whole number from ``least`` to ``most``, else nothing."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        return [f"{name} = {value!r}: give a whole number"]
    if int(value) < least or (most is not None and int(value) > most):
        return [f"{name} = {value}: must be at least {least}" + (f" and at most {most}" if most is not None else "")]
    return []


def level_problems(level: float) -> list[str]:
    """Return a sentence if ``level`` cannot be the level of an interval, else nothing."""
    valid = isinstance(level, Real) and 0.0 < float(level) < 1.0
    return [] if valid else [f"level = {shown(level)}: must be a number between 0 and 1, such as 0.95"]


def names_of(argument: str, given: str | Sequence[str]) -> list[str]:
    """Return one name or several as a list.

    Raises
    ------
    InputError
        If ``given``, the value of ``argument``, is empty, has a name twice or has something else than names.
    """
    names = [given] if isinstance(given, str) else list(given) if isinstance(given, Iterable) else [given]
    if not all(isinstance(name, str) for name in names):
        raise InputError(f"{argument} = {shown(given)}: must be a name or a list of names")
    if not names:
        raise InputError(f"{argument} is empty: give at least one name")
    twice = sorted({str(name) for name in names if names.count(name) > 1})
    if twice:
        raise InputError([f"{argument}: {name!r} is given more than once: give it once" for name in twice])
    return [str(name) for name in names]

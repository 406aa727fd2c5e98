"""Checks of the arguments that the functions on a result share: the result, names, the level of an interval."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from numbers import Real

import xarray as xr

from fastcoil.errors import InputError, shown


def check_result(ds: xr.Dataset) -> None:
    """Refuse what is no result of a study."""
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"ds is a {type(ds).__name__}: give a Dataset of fastcoil.simulate or open_study")
    if "status" not in ds:
        raise InputError("ds has no status: give a Dataset of fastcoil.simulate or open_study")


def names_of(what: str, given: str | Sequence[str]) -> list[str]:
    """One name or several as a list of them."""
    names = [given] if isinstance(given, str) else list(given) if isinstance(given, Iterable) else [given]
    if not all(isinstance(name, str) for name in names):
        raise InputError(f"{what} = {shown(given)}: must be a name or a list of names")
    if not names:
        raise InputError(f"{what} is empty: give at least one name")
    twice = sorted({str(name) for name in names if names.count(name) > 1})
    if twice:
        raise InputError([f"{what}: {name!r} is given more than once: give it once" for name in twice])
    return [str(name) for name in names]


def level_problems(level: float) -> list[str]:
    """What is wrong with the level of an interval."""
    valid = isinstance(level, Real) and 0.0 < float(level) < 1.0
    return [] if valid else [f"level = {shown(level)}: must be a number between 0 and 1, such as 0.95"]

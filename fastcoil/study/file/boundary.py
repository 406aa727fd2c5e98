"""Build the days on which a study is run from the table ``[boundary]``."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import constant_day, design_day, heating_day, paper_day
from fastcoil.loops.boundary.weather import weather_day
from fastcoil.loops.boundary.weather_year import weather_year
from fastcoil.study.file.tables import with_hints

BOUNDARY_KINDS: dict[str, Callable[..., Boundary]] = {
    "paper_day": paper_day,
    "constant_day": constant_day,
    "design_day": design_day,
    "heating_day": heating_day,
    "csv": Boundary.from_csv,
    "weather": weather_day,
    "weather_year": weather_year,
}


def build_boundary(table: Mapping[str, Any], folder: Path) -> Boundary:
    """Build the boundary of a study; ``paper_day`` of 8 h with seed 1 where the table is absent."""
    arguments = dict(table)
    kind = arguments.pop("kind", "paper_day")
    if not isinstance(kind, str) or kind not in BOUNDARY_KINDS:
        raise InputError(
            f"[boundary] kind = {shown(kind)}: unknown{nearest(str(kind), BOUNDARY_KINDS)}; "
            f"choose one of {', '.join(BOUNDARY_KINDS)}"
        )
    make = BOUNDARY_KINDS[kind]
    signature = inspect.signature(make).parameters
    problems = [
        f"[boundary] {name} is not an argument of {kind}{hint}; it takes {', '.join(signature)}"
        for name, hint in with_hints((name for name in arguments if name not in signature), signature)
    ]
    problems += [
        f"[boundary] {name} is missing: {kind} needs it"
        for name, p in signature.items()
        if p.default is p.empty and name not in arguments
    ]
    if problems:
        raise InputError(problems)
    if "path" in arguments:
        arguments["path"] = folder / str(arguments["path"])
    try:
        return make(**arguments)
    except InputError as error:
        raise InputError([f"[boundary] {p}" for p in error.problems]) from None

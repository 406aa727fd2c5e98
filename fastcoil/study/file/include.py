"""``[loop] include``: parameters from files of their own, such as those that ``fastcoil fit`` writes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fastcoil.base.errors import InputError, shown
from fastcoil.base.files import read_text
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.file.tables import known_parameters
from fastcoil.study.file.toml import parse_toml

_WHAT = "a file that `fastcoil fit` wrote, with a path from the study file's folder"
_LARGEST = 2**20
"""Bytes."""
_MOST_FILES = 100


def read_includes(loop: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Read the parameters in the files that ``include`` in a study's ``[loop]`` names.

    Paths start from ``folder``.  Only the ``[loop]`` of a file is read; its ``[fit]`` is documentation.

    Raises
    ------
    InputError
        With one sentence for each file that cannot be read or is no such file, and each parameter given twice.
    """
    names = loop.get("include", [])
    if not isinstance(names, list) or len(names) > _MOST_FILES or not all(isinstance(name, str) for name in names):
        example = 'such as ["valve.toml", "coil.toml"]'
        raise InputError(f"include = {shown(names)}: give a list of files, {_MOST_FILES} at most, {example}")
    found: dict[str, Any] = {}
    origin: dict[str, str] = {}
    problems: list[str] = []
    for name in names:
        try:
            parameters = _read_parameters(folder / name, name)
        except InputError as error:
            problems += error.problems
            continue
        problems += [
            f"include: {n} appears in {origin[n]} and in {name}: leave one out" for n in parameters if n in origin
        ]
        found |= parameters
        origin |= {n: name for n in parameters}
    if problems:
        raise InputError(problems)
    return found


def _read_parameters(path: Path, name: str) -> dict[str, Any]:
    try:
        tables = parse_toml(read_text(path, _WHAT, _LARGEST), name)
    except InputError as error:
        raise InputError([f"include: {problem}" for problem in error.problems]) from None
    loop = tables.get("loop")
    if not isinstance(loop, dict) or set(tables) - {"loop", "fit"}:
        raise InputError(
            f"include: {name} is no file that `fastcoil fit` wrote: it needs a table [loop], and may have [fit]"
        )
    problems: list[str] = []
    known = known_parameters(loop, problems)
    problems += [p for p in (PARAMETERS[key].problem(value) for key, value in known.items()) if p]
    if problems:
        raise InputError([f"include: {name}: {problem}" for problem in problems])
    return loop

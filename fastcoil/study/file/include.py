"""``[loop] include``: parameters from files of their own, such as those that ``fastcoil fit`` writes."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fastcoil.errors import InputError, shown
from fastcoil.parameter_table import PARAMETERS, check_name


def included(loop: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The parameters in the ``[loop]`` of the files that ``include`` of a study's ``[loop]`` names.

    Paths start from ``folder``.  Of a file only ``[loop]`` is read, ``[fit]`` is for people.

    Raises
    ------
    InputError
        With one sentence for each file that cannot be read, is no such file, or gives what another gives.
    """
    names = loop.get("include", [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(f'include = {shown(names)}: give a list of files, such as ["valve.toml", "coil.toml"]')
    found: dict[str, Any] = {}
    origin: dict[str, str] = {}
    problems: list[str] = []
    for name in names:
        try:
            parameters = _parameters(folder / name, name)
        except InputError as error:
            problems += error.problems
            continue
        problems += [
            f"include: {n} stands in {origin[n]} and in {name}: leave one out" for n in parameters if n in origin
        ]
        found |= parameters
        origin |= {n: name for n in parameters}
    if problems:
        raise InputError(problems)
    return found


def _parameters(path: Path, name: str) -> dict[str, Any]:
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(
            f"include: {name} cannot be read ({error.strerror}): paths start from the study file's folder"
        ) from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"include: {name} is not valid TOML: {error}") from None
    loop = tables.get("loop")
    if not isinstance(loop, dict) or set(tables) - {"loop", "fit"}:
        raise InputError(
            f"include: {name} is not what `fastcoil fit` writes: it needs a table [loop], and may have [fit]"
        )
    problems = []
    for key, value in loop.items():
        try:
            problem = PARAMETERS[check_name(key)].problem(value)
        except InputError as error:
            problem = str(error)
        if problem:
            problems.append(f"include: {name}: {problem}")
    if problems:
        raise InputError(problems)
    return loop

"""The files that a study reads, and where an archive has them, so that its relative paths lead to them again."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fastcoil.base.errors import InputError, shown
from fastcoil.study.archive.listing import HERE, INPUTS, is_safe
from fastcoil.study.file.source import Source
from fastcoil.study.file.spec import Study

_ELSEWHERE = f"{INPUTS}/elsewhere"


@dataclass
class Inputs:
    """Where the paths of a study start in its archive, its files by member, and those that it will not find there."""

    base: str
    files: dict[str, Path] = field(default_factory=dict)
    elsewhere: dict[str, str] = field(default_factory=dict)


def inputs_of(study: Study) -> Inputs:
    """Place the files of a study in its archive.

    A path that goes up from the study file does so in the archive, too: the study starts deep enough.  An absolute one
    is part of the study, and leads nowhere on another machine: its file is packed, and the README says where
    it must be.

    Raises
    ------
    InputError
        If the name of a file cannot be unpacked everywhere.
    """
    named = list(_named(study))
    if not named:
        return Inputs(HERE)
    up = max((_steps_up(name) for name, _ in named if _is_relocatable(name)), default=0)
    found = Inputs("/".join([INPUTS, *["study"] * up]))
    for name, path in named:
        if _is_relocatable(name):
            member = os.path.normpath(f"{found.base}/{name}")
        else:
            member = next(m for m in _free(path.name) if found.files.get(m, path) == path)
            found.elsewhere[name] = member
        if not is_safe(member):
            raise InputError(f"{shown(name)}: this name cannot be unpacked everywhere, rename the file and run again")
        found.files[member] = path
    return found


def _named(study: Study) -> Iterator[tuple[str, Path]]:
    """Each file as the study names it, and where it is."""
    tables = study.tables
    tune = tables.get("tune")
    for table in (tables.get("boundary"), tune.get("holdout") if isinstance(tune, dict) else None):
        if isinstance(table, dict) and "path" in table:
            yield _placed(table["path"], study.folder)
    for name in tables.get("loop", {}).get("include", []):
        yield _placed(name, study.folder)
    codes: list[Source] = [*study.rules.values(), *([study.reduction] if study.reduction else [])]
    for code in codes:
        module = code.name.partition(":")[0]
        yield f"{module.replace('.', '/')}.py", code.path


def _placed(name: Any, folder: Path) -> tuple[str, Path]:
    return str(name), folder / str(name)


def _is_relocatable(name: str) -> bool:
    """Whether a path is relative, and goes up only at its beginning."""
    parts = Path(name).parts
    return not os.path.isabs(name) and ".." not in parts[_steps_up(name) :]


def _steps_up(name: str) -> int:
    parts = Path(name).parts
    return next((k for k, part in enumerate(parts) if part != ".."), len(parts))


def _free(name: str) -> Iterator[str]:
    yield f"{_ELSEWHERE}/{name}"
    yield from (f"{_ELSEWHERE}/{k}/{name}" for k in range(2, 10_000))

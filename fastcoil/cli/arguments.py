"""Arguments of commands: paths, and scenarios given as ``--at backlash=0.07,tuning=fast``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from fastcoil.base.errors import InputError, shown
from fastcoil.base.files import require_usable


class UsablePath(click.ParamType):  # type: ignore[type-arg]
    """A valid path; it need not exist."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        if value == "":
            name = param.opts[-1] if param else "path"
            raise InputError(f"{name} is empty: give a path, such as . for the current folder")
        path = Path(value)
        require_usable(path, "give another path")
        return path


PATH = UsablePath()


def labels_of(at: str) -> dict[str, str]:
    """Parse ``NAME=LABEL,...`` into dimension → label."""
    pairs = _pairs(at)
    dims = [dim for dim, _ in pairs]
    twice = [f"--at: {shown(dim)} is given twice: give it once" for k, dim in enumerate(dims) if dim in dims[:k]]
    if twice:
        raise InputError(twice)
    return dict(pairs)


def all_labels_of(at: Sequence[str]) -> dict[str, list[str]]:
    """Parse ``NAME=LABEL`` arguments into name → list of labels; a name may be given several times."""
    found: dict[str, list[str]] = {}
    for name, label in _pairs(",".join(at)):
        found.setdefault(name, []).append(label)
    return found


def _pairs(at: str) -> list[tuple[str, str]]:
    from fastcoil.study.file.tables import LONGEST_KEY

    pairs = [item.split("=", 1) for item in re.split(",(?=[^,=]+=)", at) if item]
    if any(len(pair) != 2 for pair in pairs):
        raise InputError(f"--at {shown(at)}: give dimension=label, several of them separated by commas")
    long = [
        f"--at {shown(word)}: longer than any dimension or label" for word in sum(pairs, []) if len(word) > LONGEST_KEY
    ]
    if long:
        raise InputError(long)
    return [(dim.strip(), label.strip()) for dim, label in pairs]

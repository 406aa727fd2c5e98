"""Paths on the command line: one that no file can have is refused before anything else is looked at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fastcoil.base.errors import InputError
from fastcoil.base.files import require_usable


class UsablePath(click.ParamType):  # type: ignore[type-arg]
    """A path that a file or a folder could have; it need not exist."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        if value == "":
            name = param.opts[-1] if param else "path"
            raise InputError(f"{name} is empty: give a path, such as . for the current folder")
        path = Path(value)
        require_usable(path, "give another path")
        return path


PATH = UsablePath()

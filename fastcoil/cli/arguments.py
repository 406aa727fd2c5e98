"""Arguments of commands: paths, and lists of ``NAME=VALUE``."""

import functools
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from fastcoil.base.arguments import path_of, refuse
from fastcoil.base.errors import shown


class UsablePath(click.ParamType):  # type: ignore[type-arg]
    """A valid path; it need not exist."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        return path_of(param.opts[-1] if param else "path", value, "give a path, such as . for the current folder")


PATH = UsablePath()

with_scenario = click.option(
    "--at",
    multiple=True,
    metavar="NAME=LABEL",
    help="The scenario, such as backlash=0.07,day=3: a label for every dimension.",
)
"""Option of commands on one scenario; see ``labels_of``."""


def options(*of: Callable[..., Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A decorator that adds all of these options of click."""
    return lambda command: functools.reduce(lambda made, option: option(made), of, command)


def pairs(option: str, given: Sequence[str]) -> dict[str, str]:
    """Parse ``NAME=VALUE`` arguments into a mapping; each name once."""
    found: dict[str, str] = {}
    problems: list[str] = []
    for one in given:
        name, sign, value = (part.strip() for part in one.partition("="))
        if not sign:
            problems.append(f"{option} {one}: give NAME=VALUE")
        elif name in found:
            problems.append(f"{option}: {shown(name)} is given twice: give it once")
        found[name] = value
    refuse(problems)
    return found


def labels_of(at: Sequence[str]) -> dict[str, str]:
    """Parse ``--at backlash=0.07,tuning=fast`` into dimension → label."""
    return pairs("--at", _split(at))


def all_labels_of(option: str, at: Sequence[str]) -> dict[str, list[str]]:
    """As ``labels_of``, into name → list of labels; a name may be given several times."""
    found: dict[str, list[str]] = {}
    for one in _split(at):
        for name, label in pairs(option, [one]).items():
            found.setdefault(name, []).append(label)
    return found


def _split(at: Sequence[str]) -> list[str]:
    """The arguments, split at commas that begin another ``NAME=``."""
    return [item for item in re.split(",(?=[^,=]+=)", ",".join(at)) if item]

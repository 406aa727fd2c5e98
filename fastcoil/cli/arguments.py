"""Arguments of commands: paths, and lists of ``NAME=VALUE``."""

import functools
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from fastcoil.base.arguments import raise_problems, require_path
from fastcoil.base.errors import Problem, short_repr


class UsablePath(click.ParamType):  # type: ignore[type-arg]
    """Type of an option or argument that is a path, which need not exist."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        return require_path(param.opts[-1] if param else "path", value, "give a path, such as . for the current folder")


PATH = UsablePath()  # type of an argument of click

with_scenario = click.option(
    "--at", multiple=True, metavar="NAME=LABEL",
    help="The scenario, such as backlash=0.07,day=3: a label for every dimension.",
)  # fmt: skip
"""Decorator that adds the option ``--at``, the labels of one scenario, to a command; see ``parse_labels``."""


def combine_options(*decorators: Callable[..., Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Combine decorators that each add an option of click to one that adds them all."""
    return lambda command: functools.reduce(lambda decorated, decorate: decorate(decorated), decorators, command)


def parse_pairs(option: str, arguments: Sequence[str]) -> dict[str, str]:
    """Parse ``NAME=VALUE`` arguments into a mapping; each name once."""
    values: dict[str, str] = {}
    problems: list[str] = []
    for argument in arguments:
        name, sign, value = (part.strip() for part in argument.partition("="))
        if not sign:
            problems.append(Problem(f"{option} {argument}: give NAME=VALUE", option, "format"))
        elif name in values:
            problems.append(Problem(f"{option}: {short_repr(name)} is given twice: give it once", option, "duplicate"))
        values[name] = value
    raise_problems(problems)
    return values


def parse_labels(at: Sequence[str]) -> dict[str, str]:
    """Parse the arguments of ``--at``, such as ``backlash=0.07,tuning=fast``, into dimension → label."""
    return parse_pairs("--at", _split_pairs(at))


def parse_label_lists(option: str, at: Sequence[str]) -> dict[str, list[str]]:
    """Parse ``NAME=LABEL`` arguments into name → list of labels; a name may be given several times."""
    labels: dict[str, list[str]] = {}
    for pair in _split_pairs(at):
        for name, label in parse_pairs(option, [pair]).items():
            labels.setdefault(name, []).append(label)
    return labels


def _split_pairs(at: Sequence[str]) -> list[str]:
    """Split arguments such as ``a=1,b=2`` into pairs, at the commas before another ``NAME=``."""
    return [pair for pair in re.split(",(?=[^,=]+=)", ",".join(at)) if pair]

"""What the commands that read a log share: its options, pairs of names and values, and where they may write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import click

from fastcoil.base.errors import InputError
from fastcoil.base.files import exists, is_file, is_folder, may_be_file
from fastcoil.cli.paths import PATH


def with_reading_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the log and the options that say how it is read."""
    for option in (
        click.option(
            "--drop", is_flag=True, help="Leave out and count bad values, or bridge a single one, instead of refusing."
        ),
        click.option(
            "--jumps",
            default="refuse",
            show_default=True,
            help="Where time goes back: refuse the log, or split it there.",
        ),
        click.option("--max-gap", type=float, help="Longest step to bridge, s; three median steps by default."),
        click.option(
            "--time-format",
            metavar="PATTERN",
            help="How timestamp is written: '%d/%m/%Y %H:%M', excel or epoch; recognised by default.",
        ),
        click.option(
            "--unit", "units", multiple=True, metavar="NAME=UNIT", help="Unit of a column whose header has none."
        ),
        click.option(
            "--column", "columns", multiple=True, metavar="NAME=HEADER", help="Header of NAME, if it differs."
        ),
        click.argument("data", type=PATH),
    ):
        command = option(command)
    return command


def pairs(option: str, given: Sequence[str]) -> dict[str, str] | None:
    """``NAME=VALUE`` … as a mapping; None without any, which means the file's own names."""
    pairs = [one.partition("=") for one in given]
    wrong = [f"{option} {one}: give NAME=VALUE" for one, (_, sign, _) in zip(given, pairs, strict=True) if not sign]
    if wrong:
        raise InputError(wrong)
    return {name.strip(): value.strip() for name, _, value in pairs} or None


def require_writable(out: Path) -> None:
    """Refuse, before any work, a path that cannot be written, or that holds anything but an earlier fit."""
    from fastcoil.measured.fit.result import is_fit

    if out.suffix != ".toml" or not may_be_file(out):
        raise InputError(f"-o {out}: give a file NAME.toml in a folder that exists")
    if exists(out) and not is_fit(out):
        raise InputError(f"-o {out}: this file exists and is no fit, choose another name or delete it")
    figure = out.with_suffix(".png")
    if is_folder(figure):
        raise InputError(f"-o {out}: {figure}, the name of its figure, is a folder: choose another name")
    if is_file(figure) and not exists(out):
        raise InputError(f"-o {out}: {figure} exists and would be replaced, choose another name or delete it")

"""Output to the terminal, announcements of long or delicate work, and a check of environment variables."""

from __future__ import annotations

import contextlib
import io
import os
from typing import TYPE_CHECKING

import click

from fastcoil.base.errors import FastcoilError, InputError, shown
from fastcoil.base.text import printable

if TYPE_CHECKING:
    from fastcoil.study.file.own_code import Source

_LONGEST_LINE = 4000  # characters printed of one line


def say(*lines: object, err: bool = False) -> None:
    """Print each item on one line, with control characters escaped, to stdout or with ``err`` to stderr."""
    for line in lines:
        text = str(line)
        more = f"… ({len(text):,} characters)" if len(text) > _LONGEST_LINE else ""
        click.echo(printable(text[:_LONGEST_LINE]) + more, err=err)


def complain(error: FastcoilError) -> None:
    """Print the sentences of an error to stderr."""
    say(*(f"fastcoil: {sentence}" for sentence in str(error).split("\n")), err=True)


def announce_compilation(kernel: str = "emulate") -> None:
    """Announce the wait if a kernel has not been compiled."""
    from fastcoil.model.numerics.jit import is_compiled

    if not is_compiled(kernel):
        say("Compiling the kernels, once per installation: about 20 s …", err=True)


def run_own_code(what: str, source: Source) -> object:
    """Announce and import the module of a study's own function."""
    from fastcoil.study.workers.user_code import load

    function = source.name.partition(":")[2]
    say(f"This study runs its own code: {function} from {source.path.absolute()}.", err=True)
    printed = {False: io.StringIO(), True: io.StringIO()}
    try:
        with contextlib.redirect_stdout(printed[False]), contextlib.redirect_stderr(printed[True]):
            return load(what, source)
    finally:
        for err, text in printed.items():
            say(*text.getvalue().splitlines(), err=err)


_RANGES = {"NUMBA_NUM_THREADS": (1, 2**16), "SOURCE_DATE_EPOCH": (0, 253_402_300_799)}
"""Ranges of integers read by Numba and matplotlib; the last limit is the end of the year 9999."""


def check_environment() -> None:
    """Raise an `InputError` for environment variables that the libraries do not accept."""
    problems = []
    for name, (least, most) in _RANGES.items():
        value = os.environ.get(name, "")
        try:
            usable = not value or least <= int(value) <= most
        except ValueError:
            usable = False
        if not usable:
            problems.append(
                f"{name} = {shown(value)} in the environment: unset it, or give a whole number from {least} to {most}"
            )
    if problems:
        raise InputError(problems)

"""Output to the terminal, and a check of environment variables that would make a library fail on import."""

from __future__ import annotations

import os

import click

from fastcoil.base.errors import FastcoilError, InputError, shown
from fastcoil.base.text import printable

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

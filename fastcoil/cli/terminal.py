"""What reaches the terminal: every line that a command prints, and every mistake, goes through here."""

from __future__ import annotations

import click

from fastcoil.base.errors import FastcoilError
from fastcoil.base.text import printable

_LONGEST_LINE = 4000
"""Characters."""


def say(*lines: object, err: bool = False) -> None:
    """Print lines, a line each whatever is in them, to stdout or with ``err`` to stderr."""
    for line in lines:
        text = str(line)
        more = f"… ({len(text):,} characters)" if len(text) > _LONGEST_LINE else ""
        click.echo(printable(text[:_LONGEST_LINE]) + more, err=err)


def complain(error: FastcoilError) -> None:
    """Print the sentences of an error to stderr."""
    say(*(f"fastcoil: {sentence}" for sentence in str(error).split("\n")), err=True)

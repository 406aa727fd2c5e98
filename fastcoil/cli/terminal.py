"""What reaches the terminal: every line that a command prints, and every mistake, goes through here."""

from __future__ import annotations

import click

from fastcoil.errors import FastcoilError, InputError
from fastcoil.printable import printable

_MOST_MISTAKES = 20
"""A reader mends these first; the rest are counted."""
_LONGEST_LINE = 4000
"""Characters."""


def say(*lines: object, err: bool = False) -> None:
    """Print lines, a line each whatever is in them, to stdout or with ``err`` to stderr."""
    for line in lines:
        text = str(line)
        more = f"… ({len(text):,} characters)" if len(text) > _LONGEST_LINE else ""
        click.echo(printable(text[:_LONGEST_LINE]) + more, err=err)


def complain(error: FastcoilError) -> None:
    """Print the sentences of an error to stderr: the first ones, and how many more there are."""
    if isinstance(error, InputError):
        sentences, noun = error.problems, "mistake"
    else:
        sentences, noun = str(error).split("\n"), "line"
    say(*(f"fastcoil: {sentence}" for sentence in sentences[:_MOST_MISTAKES]), err=True)
    more = len(sentences) - _MOST_MISTAKES
    if more > 0:
        say(f"fastcoil: … and {more:,} more {noun}{'s' if more > 1 else ''}", err=True)

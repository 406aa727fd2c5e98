"""Output to the terminal, and announcements of long or delicate work."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from fastcoil.base.errors import FastcoilError
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
    from fastcoil.study.file.own_code import load

    function = source.name.partition(":")[2]
    say(f"This study runs its own code: {function} from {source.path.absolute()}.", err=True)
    return load(what, source)

"""Messages before long or delicate work: a kernel is compiled, a study runs its own code."""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
from typing import TYPE_CHECKING

import click

from fastcoil.cli.quick_start import OWN_PROCESS
from fastcoil.cli.terminal import say

if TYPE_CHECKING:
    from fastcoil.study.file.own_code import Source


def announce_compilation(kernel: str = "emulate") -> None:
    """Announce the wait if a kernel has not been compiled."""
    from fastcoil.model.numerics.jit import is_compiled

    if not is_compiled(kernel):
        say("Compiling the kernels, once per installation: about 20 s …", err=True)


COMPILE = "import os, fastcoil as fc; os.nice(10); fc.simulate(fc.Loop(), fc.paper_day(hours=1), n_jobs=1)"
"""Compiles the kernels that most studies need."""


def compile_meanwhile() -> None:
    """Compile the kernels in a detached process while the user edits a first study."""
    from fastcoil.model.numerics.jit import is_compiled

    if click.get_current_context().obj != OWN_PROCESS or is_compiled("emulate"):
        return
    quiet = subprocess.DEVNULL
    with contextlib.suppress(OSError):  # otherwise the first run compiles them
        # -P: do not import from the current folder
        subprocess.Popen(
            [sys.executable, "-P", "-c", COMPILE], stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
        )
        say("Compiling the kernels in the background, once per installation.", err=True)


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

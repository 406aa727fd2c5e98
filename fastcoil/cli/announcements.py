"""What is said before the work: a kernel is compiled, a study runs code of its own."""

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
    from fastcoil.study.file.source import Source


def announce_compilation(kernel: str = "emulate") -> None:
    """Announce the wait if a kernel is not compiled yet."""
    from fastcoil.model.numerics.jit import is_compiled

    if not is_compiled(kernel):
        say("Compiling the kernels, once per installation: about 20 s …", err=True)


COMPILE = "import os, fastcoil as fc; os.nice(10); fc.simulate(fc.Loop(), fc.paper_day(hours=1), n_jobs=1)"
"""Compiles what most studies need, unless it is compiled."""


def compile_meanwhile() -> None:
    """Compile the kernels while the user edits a first study, in a process that outlives this command."""
    from fastcoil.model.numerics.jit import is_compiled

    if click.get_current_context().obj != OWN_PROCESS or is_compiled("emulate"):
        return
    quiet = subprocess.DEVNULL
    with contextlib.suppress(OSError):  # the first run then compiles them
        # -P: nothing in the current folder is taken for a library
        subprocess.Popen(
            [sys.executable, "-P", "-c", COMPILE], stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
        )
        say("Compiling the kernels in the background, once per installation.", err=True)


def run_own_code(what: str, source: Source) -> object:
    """Run the module of a study's own function, and say so before."""
    from fastcoil.study.workers.load_user_module import load

    function = source.name.partition(":")[2]
    say(f"This study runs code of its own: {function} from {source.path.absolute()}.", err=True)
    printed = {False: io.StringIO(), True: io.StringIO()}
    try:
        with contextlib.redirect_stdout(printed[False]), contextlib.redirect_stderr(printed[True]):
            return load(what, source)
    finally:
        for err, text in printed.items():
            say(*text.getvalue().splitlines(), err=err)

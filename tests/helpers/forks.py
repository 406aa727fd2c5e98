"""Runs of studies in processes forked for them, see ``fork_server``."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from helpers.processes import child_environment

COMMAND_MODULES = ("fastcoil.cli.main", "fastcoil.study.analysis.summary", "fastcoil.study.maintenance",
            "fastcoil.deliver.figures.swept",
            "matplotlib.figure")  # fmt: skip
"""Modules that commands import."""
SERVER_SCRIPT = Path(__file__).with_name("fork_server.py")


@contextmanager
def fork_runner(*modules: str, **env: str) -> Iterator[Callable[..., tuple[int, int, str]]]:
    """Yield a function that runs a study in a forked process: exit code, number of file operations, output.

    modules: loaded before the fork; env: additions to the environment.
    """
    command = [sys.executable, str(SERVER_SCRIPT), *modules]
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=child_environment(**env), **pipes) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        assert server.stdout.readline() == "ready\n"

        def run(text: str, folder: Path, **order: Any) -> tuple[int, int, str]:
            log = folder.with_name("log")
            order |= {"text": text, "folder": str(folder), "log": str(log)}
            print(json.dumps(order), file=server.stdin, flush=True)
            code, operations = json.loads(server.stdout.readline())
            return code, operations, log.read_text()

        try:
            yield run
        finally:
            server.stdin.close()
            server.wait(timeout=60)

"""Process that forks runs of studies and reports how they ended; a fork costs milliseconds, an import seconds.

It starts no thread, so that a fork is safe, and loads the modules in its arguments.  Reads a JSON object per line:
{"text": …, "folder": …, "extend": …, "kill_before": n or null, "of": name of the operations that count (by default
all), "kill_after": seconds or null, "limits": {…}, "arguments": words of the command line, instead of a run by
``execute``}, and answers with the exit code of the child (negative: a signal) and the number of file operations that it
began.
"""

import importlib
import json
import os
import resource
import signal
import sys
import tempfile
import time
from concurrent.futures import Future
from pathlib import Path

from fastcoil.base.errors import FastcoilError
from fastcoil.loops.plan import Shard
from fastcoil.study import run as runner
from fastcoil.study.workers import Job, run_scenarios
from helpers.failing_files import NthOperation, intercept_operations
from helpers.studies import TRACED_STUDY, run, write_study

_MAX_SECONDS = 60


def run_order(order: dict, count_pipe: int) -> int:
    """Run as ordered; returns the exit code."""
    signal.alarm(_MAX_SECONDS)
    folder = Path(order["folder"])
    study = write_study(order["text"], folder)
    for name, limit in order.get("limits", {}).items():
        resource.setrlimit(getattr(resource, name), (limit, limit))
    if order.get("user"):
        os.setuid(order["user"])
    if order.get("unchecked"):  # as if others filled the disk meanwhile
        runner.check_disk = lambda *_, **__: None
    nth = NthOperation(order.get("kill_before") or 0, lambda: os.kill(os.getpid(), signal.SIGKILL))

    def before(name: str) -> None:
        if order.get("of", name) != name:
            return
        os.write(count_pipe, b".")
        nth(name)

    with intercept_operations(folder, before):
        if "arguments" in order:
            from fastcoil.__main__ import run as run_command

            sys.argv[1:] = order["arguments"]
            run_command()
        try:
            runner.execute(study, folder, n_jobs=1, extend=order.get("extend", False))
        except FastcoilError as error:
            print(error, file=sys.stderr)
            return error.exit_code
    return 0


class SerialPool:
    """A pool without threads."""

    n_workers = 1
    worker_errors: tuple = ()

    def __init__(self, job: Job) -> None:
        self.job = job

    def submit(self, shard: Shard) -> Future:
        future: Future = Future()
        future.set_result(run_scenarios(self.job, shard))
        return future

    def close(self) -> None:
        pass


def warm_up() -> None:
    """Load once, without threads, what the first run of a process loads."""
    make_pool = runner.make_pool
    runner.make_pool = lambda job, _: SerialPool(job)
    try:
        with tempfile.TemporaryDirectory() as folder:
            run(TRACED_STUDY, Path(folder) / "out")
    finally:
        runner.make_pool = make_pool


def main() -> None:
    """Serve until the input ends."""
    warm_up()
    for name in sys.argv[1:]:
        importlib.import_module(name)
    print("ready", flush=True)
    for line in sys.stdin:
        order = json.loads(line)
        reading, count_pipe = os.pipe()
        pid = os.fork()
        if not pid:
            os.close(reading)
            code = 1
            try:
                log = os.open(order["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
                os.dup2(log, 1)
                os.dup2(log, 2)
                code = run_order(order, count_pipe)
            except SystemExit as end:
                code = end.code or 0
            except BaseException:
                import traceback

                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(code)
        os.close(count_pipe)
        if order.get("kill_after") is not None:
            time.sleep(order["kill_after"])
            os.kill(pid, signal.SIGKILL)  # it is not reaped yet: no other process has its number
        with os.fdopen(reading, "rb") as pipe:
            n_operations = len(pipe.read())
        _, status = os.waitpid(pid, 0)
        print(json.dumps([os.waitstatus_to_exitcode(status), n_operations]), flush=True)
    os._exit(0)  # an orderly exit takes a second


if __name__ == "__main__":
    main()

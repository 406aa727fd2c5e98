"""``fastcoil`` and ``python -m fastcoil``."""

import os
import sys

# `python -m` looks for modules in the current folder first, where a rule of a study may be called csv.py
if __name__ == "__main__" and not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(__file__)):
    del sys.path[0]

import gc
import signal
import threading
import traceback

from fastcoil.base.errors import EXIT_BUG, EXIT_INTERRUPTED, EXIT_STORAGE, EXIT_TERMINATED
from fastcoil.cli.main import main
from fastcoil.cli.terminal import echo, guard_streams


def run() -> None:
    """Run the command line; exit with its code, or with that of a storage error if output was lost."""
    gc.set_threshold(300_000)  # imports make many objects that stay: scanning them again and again takes 0.3 s
    os.environ.setdefault("PYTHONSAFEPATH", "1")  # the same for workers
    stdout = guard_streams()
    code = _run_command()
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # nothing is left to undo, and waiting for workers ends without words
    loss = stdout.loss_reason()
    if loss is not None:
        echo(f"fastcoil: not all lines could be printed ({loss}); files were written as usual", err=True)
    if code in (EXIT_INTERRUPTED, EXIT_TERMINATED):
        _exit_without_waiting(code)
    netcdf = sys.modules.get("fastcoil.loops.netcdf")
    if netcdf is not None and netcdf.unclosed_files:  # the library would crash on them at interpreter exit
        _flush_and_exit(code)
    sys.exit(code or (EXIT_STORAGE if loss is not None else 0))


def _run_command() -> int:
    try:
        main()
    except SystemExit as system_exit:
        return system_exit.code if isinstance(system_exit.code, int) else 0 if system_exit.code is None else EXIT_BUG
    except Exception:
        echo(*traceback.format_exc().rstrip().split("\n"), err=True)
        return EXIT_BUG
    return 0


def _exit_without_waiting(code: int) -> None:
    """After an interrupt, do not wait for a thread in the middle of a shard."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threads = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    if not all(thread.daemon for thread in threads):
        _flush_and_exit(code)


def _flush_and_exit(code: int) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    run()

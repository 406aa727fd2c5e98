"""``fastcoil`` and ``python -m fastcoil``."""

import os
import signal
import sys
import threading

from fastcoil.cli.main import main
from fastcoil.errors import EXIT_INTERRUPTED, EXIT_TERMINATED


def run() -> None:
    """Run the command line.  After an interrupt, end at once: do not wait for a thread in the middle of a shard."""
    try:
        main()
    except SystemExit as end:
        if end.code in (EXIT_INTERRUPTED, EXIT_TERMINATED):
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # only the interpreter's shutdown is left to interrupt
            others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
            if not all(thread.daemon for thread in others):
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(end.code)
        raise


if __name__ == "__main__":
    run()

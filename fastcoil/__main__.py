"""``fastcoil`` and ``python -m fastcoil``."""

import os
import sys
import threading

from fastcoil.cli import main
from fastcoil.errors import EXIT_INTERRUPTED, EXIT_TERMINATED


def run() -> None:
    """Run the command line.  Interrupted, end at once: a thread in the middle of a shard would be waited for."""
    try:
        main()
    except SystemExit as end:
        waited_for = any(not thread.daemon for thread in threading.enumerate() if thread is not threading.main_thread())
        if waited_for and end.code in (EXIT_INTERRUPTED, EXIT_TERMINATED):
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code)
        raise


if __name__ == "__main__":
    run()

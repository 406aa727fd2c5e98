"""Reach a dask cluster: one at an address, or a new one on this machine that only this machine can reach."""

from __future__ import annotations

import asyncio
import concurrent.futures as cf
import contextlib
import ipaddress
import linecache
import logging
import signal
import sys
import warnings
from multiprocessing import resource_tracker
from typing import Any

from fastcoil.base.errors import FastcoilError, InputError
from fastcoil.loops.running import within

_WAIT_FOR_SCHEDULER = 10.0
"""Seconds."""


def start_local_cluster(n_workers: int) -> Any:
    """Start workers as processes of this machine.

    Raises
    ------
    InputError
        If they do not start, for the script that calls this starts them again in each of them.
    FastcoilError
        If they do not start for another reason.
    """
    from distributed import LocalCluster, SpecCluster

    class Patient(LocalCluster):  # type: ignore[misc]
        """A cluster that leaves it to the nannies to replace workers.

        15 s after a death the library closes a nanny whose worker is not there, also when it is because of a later
        death: whatever the next worker then runs is lost, and nobody replaces it.
        """

        def close(self, timeout: float | None = None) -> Any:
            # the library closes it as Python ends, too, also one that was interrupted before its workers had started
            with contextlib.suppress(Exception):
                return super().close(timeout)
            return None

        def _update_worker_status(self, op: str, msg: Any) -> None:
            super(SpecCluster, self)._update_worker_status(op, msg)

    # the dispatcher retries shards that kill, for it can halve them; no port that another cluster may have
    quiet = {"allowed_failures": 0, "dashboard": False, "dashboard_address": "127.0.0.1:0"}

    def start() -> Any:
        # threads and processes inherit it: Ctrl-C is for the thread that waits, and for no worker that still starts
        resource_tracker.ensure_running()  # which would set it back
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        return Patient(
            n_workers=n_workers,
            host="127.0.0.1",  # nobody on another machine can reach it
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            scheduler_kwargs=quiet,
        )

    try:
        return within(None, start)
    except KeyboardInterrupt:
        # what is still starting fails as the program ends
        logging.getLogger("asyncio").addFilter(lambda record: "never retrieved" not in record.getMessage())
        raise
    except RuntimeError as error:
        if _is_run_by_every_worker():
            raise InputError(
                f"the workers of a dask cluster on this machine do not start ({error}): call it in a script only under "
                "if __name__ == '__main__', or use the backend loky, which needs no such line"
            ) from None
        raise workers_missing(None, error) from None


def workers_missing(scheduler: str | None, error: Exception) -> FastcoilError:
    """The error where the workers of a cluster do not come, or die again and again."""
    if scheduler is not None:
        return InputError(
            f"the dask scheduler at {scheduler} has no workers, or one that does not answer: start one with "
            f"`dask worker {scheduler}`"
        )
    return FastcoilError(
        f"the workers of a dask cluster on this machine do not start ({str(error) or type(error).__name__}): they were "
        "killed, or lack memory; finished scenarios are kept, run the same command again, with fewer workers or the "
        "backend loky"
    )


def _is_run_by_every_worker() -> bool:
    """Whether this program is a script that starts a cluster again in each worker, which runs it as a module."""
    path = getattr(sys.modules.get("__main__"), "__file__", None)
    return bool(path) and "__main__" not in "".join(linecache.getlines(str(path)))


def connect(address: Any) -> Any:
    """A client of a cluster, or of the scheduler at an address.

    Raises
    ------
    InputError
        If no scheduler answers there.
    """
    import distributed

    try:
        if isinstance(address, str):
            with cf.ThreadPoolExecutor(1) as thread:  # in a notebook this thread has an event loop of its own
                thread.submit(lambda: asyncio.run(_check_answers(address))).result()
        client = distributed.Client(address, timeout=_WAIT_FOR_SCHEDULER, set_as_default=False)
    except Exception as error:  # the library may raise anything at a stranger's answer
        reason = str(error) or type(error).__name__
        raise InputError(
            f"no dask scheduler answers at {address!r} ({reason}): give the address it printed when it started, "
            "such as tcp://host:8786, and for tls:// dask's settings of the certificates"
        ) from None
    if isinstance(address, str) and not _is_guarded(address):
        warnings.warn(
            f"anyone who can reach the dask scheduler at {address}, or its workers, can run code as you: use tls:// on "
            "a network that you do not trust",
            stacklevel=2,
        )
    return client


def _is_guarded(address: str) -> bool:
    """Whether strangers are kept out, by certificates or because only this machine can reach the address."""
    protocol, _, place = address.rpartition("://")
    host = place.rpartition(":")[0].strip("[]")
    with contextlib.suppress(ValueError):
        return protocol == "tls" or host == "localhost" or ipaddress.ip_address(host).is_loopback
    return False


async def _check_answers(address: str) -> None:
    """Raise an exception if nobody speaks dask there; the client would wait forever for a silent partner."""
    from distributed import Security
    from distributed.comm import connect

    # certificates, from dask's own configuration
    options = Security().get_connection_args("client")
    comm = await asyncio.wait_for(connect(address, timeout=_WAIT_FOR_SCHEDULER, **options), _WAIT_FOR_SCHEDULER)
    comm.abort()

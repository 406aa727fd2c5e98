"""Whether a simulation fits into the memory and on the disk of this machine."""

from __future__ import annotations

import shutil
from pathlib import Path

from fastcoil.base.errors import InputError
from fastcoil.base.files import exists, storage_errors
from fastcoil.base.machine import available_memory, gib

_CURE = "sweep fewer values, ask for fewer traces or a longer trace_interval"


def check_memory(needed: int, n_scenarios: int) -> None:
    """Refuse results of ``needed`` bytes that do not fit into memory."""
    available = available_memory()
    if needed > available:
        raise InputError(
            f"{n_scenarios:,} scenarios need {gib(needed)} of memory, {gib(available)} are available: {_CURE}"
        )


def check_workers(alone: int, each: int, n_jobs: int) -> None:
    """Refuse ``n_jobs`` workers of ``each`` bytes that, with a run of ``alone`` bytes, do not fit into memory."""
    available = available_memory()
    if alone + n_jobs * each <= available:
        return
    fit = (available - alone) // each
    if fit < 1:
        raise InputError(
            f"the study needs {gib(alone + each)} of memory with one worker, {gib(available)} are available: {_CURE}"
        )
    raise InputError(
        f"{n_jobs} workers of {gib(each)} do not fit into the {gib(available)} of memory that are available, "
        f"of which the results need {gib(alone)}: use -j {fit}"
    )


def check_disk(needed: int, folder: Path) -> None:
    """Refuse results of ``needed`` bytes that do not fit where they are to be written; ``folder`` need not exist."""
    nearest_existing = next(p for p in [folder, *folder.absolute().parents] if exists(p))
    with storage_errors(nearest_existing, "read"):
        free = shutil.disk_usage(nearest_existing).free
    if needed > free:
        raise InputError(
            f"the study needs up to {gib(needed)} on disk, {gib(free)} are free in {nearest_existing}: "
            f"choose another folder, or {_CURE}"
        )

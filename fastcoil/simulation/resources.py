"""Whether a simulation fits into the memory and on the disk of this machine."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from fastcoil.errors import InputError

_CURE = "sweep fewer values, ask for fewer traces or a longer trace_interval"


def available_memory() -> int:
    """Bytes of memory that can be used without swapping."""
    try:
        fields = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        return int(fields["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):  # not Linux: take what the machine has
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def check_memory(needed: int, n_scenarios: int) -> None:
    """Refuse results of ``needed`` bytes that do not fit into memory."""
    available = available_memory()
    if needed > available:
        raise InputError(
            f"{n_scenarios:,} scenarios need {gib(needed)} of memory for their results, "
            f"{gib(available)} are available: {_CURE}"
        )


def check_disk(needed: int, folder: Path) -> None:
    """Refuse results of ``needed`` bytes that do not fit where they are to be written; ``folder`` need not exist."""
    nearest_existing = next(p for p in [folder, *folder.absolute().parents] if p.exists())
    free = shutil.disk_usage(nearest_existing).free
    if needed > free:
        raise InputError(
            f"the study needs up to {gib(needed)} on disk, {gib(free)} are free in {nearest_existing}: "
            f"choose another folder, or {_CURE}"
        )


def gib(n_bytes: float) -> str:
    """Bytes in words."""
    return f"{n_bytes / 2**30:,.1f} GiB" if n_bytes >= 2**30 else f"{n_bytes / 2**20:,.1f} MiB"

"""The version of fastcoil, and the available memory."""

import contextlib
import os
import resource
from collections.abc import Iterator
from pathlib import Path

from fastcoil.base.files import read_bytes

VERSION = "0.2.0"
"""Of fastcoil.  The package and `fastcoil --version` take it from here."""

PROC = Path("/proc")
CGROUPS = Path("/sys/fs/cgroup")
_LARGEST = 2**20  # bytes read from a file of /proc or /sys at most


def available_memory() -> int:
    """Bytes of memory that this process can use without swapping or being killed.

    The minimum of the machine's available memory, the remainder in the control group (v2) of this process and in each
    of its parents, and the limits on address space and data.  A limit that cannot be read is ignored.
    """
    return min([_of_machine(), *_of_groups(), *_of_process()])


def gib(n_bytes: float) -> str:
    """Format a number of bytes."""
    for size, unit in ((2**30, "GiB"), (2**20, "MiB"), (2**10, "KiB")):
        if n_bytes >= size or (unit == "MiB" and n_bytes >= 0.1 * size):
            return f"{n_bytes / size:,.1f} {unit}"
    return f"{n_bytes:.0f} bytes"


def _of_machine() -> int:
    available = _fields(PROC / "meminfo").get("MemAvailable:")
    if available is not None:
        return available * 1024
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")  # not Linux: the installed memory


def _of_groups() -> Iterator[int]:
    """Memory left in the control group of this process and in each of its parents."""
    for line in _text(PROC / "self" / "cgroup").splitlines():
        if not line.startswith("0::"):  # version 1
            continue
        # in a container, the path may lie outside the mount
        names = [name for name in line.removeprefix("0::").split("/") if name not in ("", ".", "..")]
        for mount in (CGROUPS, CGROUPS / "unified"):
            for depth in range(len(names), -1, -1):
                group = mount.joinpath(*names[:depth])
                bounds = [_number(group / limit) for limit in ("memory.max", "memory.high")]
                taken = _number(group / "memory.current")
                if taken is not None and any(bound is not None for bound in bounds):
                    reclaimable = _fields(group / "memory.stat").get("inactive_file", 0)
                    yield max(min(b for b in bounds if b is not None) - taken + reclaimable, 0)


def _of_process() -> Iterator[int]:
    used = _fields(PROC / "self" / "status")
    for name, size in (("RLIMIT_AS", "VmSize:"), ("RLIMIT_DATA", "VmData:")):
        limit, _ = resource.getrlimit(getattr(resource, name))
        if limit != resource.RLIM_INFINITY:
            yield max(limit - used.get(size, 0) * 1024, 0)


def _fields(path: Path) -> dict[str, int]:
    """First word of each line of a file → the integer after it."""
    found = {}
    for line in _text(path).splitlines():
        words = line.split()
        if len(words) > 1 and words[1].isdecimal():
            found[words[0]] = int(words[1])
    return found


def _number(path: Path) -> int | None:
    text = _text(path).strip()
    return int(text) if text.isdecimal() and len(text) < 30 else None


def _text(path: Path) -> str:
    """The text of a small file; empty if it cannot be read."""
    with contextlib.suppress(OSError, ValueError):
        if path.is_file():
            return read_bytes(path, _LARGEST).decode()
    return ""

"""Available memory, and the installed version of fastcoil."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from fastcoil.base.files import read_bytes

PROC = Path("/proc")
CGROUPS = Path("/sys/fs/cgroup")
_LARGEST = 2**20  # bytes read from a file of /proc or /sys at most
_V2 = (("memory.max", "memory.high"), "memory.current", "inactive_file")
_V1 = (("memory.limit_in_bytes",), "memory.usage_in_bytes", "total_inactive_file")
"""File names of the limits and of the usage, and the reclaimable field in ``memory.stat``."""


def available_memory() -> int:
    """Bytes of memory that this process can use without swapping or being killed.

    The minimum of the machine's available memory, the remainder in each control group (v2 and v1) of this process and
    its parents, and the limits on address space and data.  A limit that cannot be read is ignored.
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
    for line in _text(PROC / "self" / "cgroup").splitlines():
        number, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if number == "0" and not controllers:
            for mount in (CGROUPS, CGROUPS / "unified"):
                yield from _of_levels(mount, path, *_V2)
        elif "memory" in controllers.split(","):
            yield from _of_levels(CGROUPS / "memory", path, *_V1)


def _of_levels(mount: Path, path: str, limits: tuple[str, ...], used: str, reclaimable: str) -> Iterator[int]:
    """Memory left in a group and in each of its parents.  In a container, ``path`` may lie outside the mount."""
    names = [name for name in path.split("/") if name not in ("", ".", "..")]
    for depth in range(len(names), -1, -1):
        group = mount.joinpath(*names[:depth])
        bounds = [bound for bound in (_number(group / name) for name in limits) if bound is not None]
        taken = _number(group / used)
        if bounds and taken is not None:
            yield max(min(bounds) - taken + _fields(group / "memory.stat").get(reclaimable, 0), 0)


def _of_process() -> Iterator[int]:
    try:
        import resource
    except ImportError:  # not a Unix
        return
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


def package_version() -> str:
    """Version of fastcoil; ``unknown`` in a source tree that is not installed."""
    try:
        return version("fastcoil")
    except PackageNotFoundError:
        return "unknown"

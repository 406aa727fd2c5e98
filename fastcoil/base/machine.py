"""What this machine and installation offer: memory and version."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from fastcoil.base.files import read_bytes

PROC = Path("/proc")
CGROUPS = Path("/sys/fs/cgroup")
_LARGEST = 2**20
"""Bytes of a file there that are read."""
_V2 = (("memory.max", "memory.high"), "memory.current", "inactive_file")
_V1 = (("memory.limit_in_bytes",), "memory.usage_in_bytes", "total_inactive_file")
"""Names of the limits, of what is used, and of the reclaimable part of that in ``memory.stat``."""


def available_memory() -> int:
    """Bytes of memory that can be used without swapping, and without being killed for it.

    The least of what the machine has, what every control group (version 2 and 1) of this process and those above it
    leave, and what the limits on its address space and its data leave.  A limit that cannot be read is none.
    """
    return min([_of_machine(), *_of_groups(), *_of_process()])


def gib(n_bytes: float) -> str:
    """Bytes in words."""
    for size, unit in ((2**30, "GiB"), (2**20, "MiB"), (2**10, "KiB")):
        if n_bytes >= size or (unit == "MiB" and n_bytes >= 0.1 * size):
            return f"{n_bytes / size:,.1f} {unit}"
    return f"{n_bytes:.0f} bytes"


def _of_machine() -> int:
    available = _fields(PROC / "meminfo").get("MemAvailable:")
    if available is not None:
        return available * 1024
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")  # not Linux: take what the machine has


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
    """What a group and each of those above it leave.  In a container, ``path`` may lead out of what is mounted."""
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
    """First words of the lines of a file, and the whole numbers that follow them."""
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
    """The text of a small file; empty if there is none, or anything is odd about it."""
    with contextlib.suppress(OSError, ValueError):
        if path.is_file():  # a pipe would be waited for
            return read_bytes(path, _LARGEST).decode()
    return ""


def package_version() -> str:
    """Version of fastcoil; ``unknown`` in a source tree that is not installed."""
    try:
        return version("fastcoil")
    except PackageNotFoundError:
        return "unknown"

"""The version of fastcoil, and what the operating system offers: nothing else asks which one it runs on.

|                         | Linux                      | macOS            | Windows                              |
|-------------------------|----------------------------|------------------|--------------------------------------|
| lock of a folder        | ``flock``                  | ``flock``        | ``msvcrt`` (all by filelock)         |
| durable names           | folders flushed to disk    | the same         | left to NTFS, whose journal has them |
| an open file            | may be replaced            | the same         | after the reader has closed it       |
| a cache of this user    | owner and mode             | the same         | the rights of the home folder        |
| end from outside        | SIGTERM, SIGHUP            | the same         | SIGTERM, Ctrl-Break                  |
| memory left             | kernel, groups, limits     | what is built in | what the system calls available      |
| limits of a child       | time and memory            | time             | none but the patience of its parent  |
"""

import contextlib
import os
import shlex
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

VERSION = "1.0.0rc1"
"""Of fastcoil.  The package and `fastcoil --version` take it from here."""

IS_POSIX = hasattr(os, "fork")
"""Whether this is a Unix: Windows has no fork."""
INTERRUPTS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
"""Signals, besides Ctrl-C, that ask a command to end."""
READ = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"))
"""Flags to open a file as it is, without waiting for the other end of a pipe."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0)

PROC = Path("/proc")
CGROUPS = Path("/sys/fs/cgroup")
_LARGEST = 2**20  # bytes read from a file of /proc or /sys at most
_PATIENCE, _PAUSE = 2.0, 0.02  # seconds for which another program may have a file open; between two trials
_WAIT_FOR_PROCESS, _NO_LIMIT = 0x00100000, -1  # SYNCHRONIZE and INFINITE of Windows
Result = TypeVar("Result")


def patiently(change: Callable[[], Result]) -> Result:
    """Replace or remove a file; on Windows again and again for 2 s, as long as another program has it open."""
    end = time.monotonic() + (0.0 if IS_POSIX else _PATIENCE)
    while True:
        try:
            return change()
        except PermissionError:
            if time.monotonic() >= end:
                raise
        time.sleep(_PAUSE)


def sync(path: Path) -> None:
    """Flush a file or folder to the disk; of a folder, where it can be opened."""
    is_folder = path.is_dir()
    if is_folder and not IS_POSIX:
        return
    descriptor = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reserve(descriptor: int, size: int) -> None:
    """Make an open, empty file ``size`` bytes long; on Linux it has its room on the disk then."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, size)
    else:
        os.truncate(descriptor, size)


def is_foreign(found: os.stat_result) -> bool:
    """Whether a folder belongs to another user."""
    return IS_POSIX and found.st_uid != os.geteuid()


def is_open_to_others(found: os.stat_result) -> bool:
    """Whether other users may write into a folder."""
    return IS_POSIX and bool(found.st_mode & (stat.S_IWGRP | stat.S_IWOTH))


def command_line(words: Sequence[str]) -> str:
    """A command as the user would type it."""
    return shlex.join(words) if IS_POSIX else subprocess.list2cmdline(words)


def wait_for_end(parent: int) -> None:
    """Wait until the process that started this one has ended."""
    if sys.platform == "win32":  # where the number of a parent stays the same
        import _winapi

        _winapi.WaitForSingleObject(_winapi.OpenProcess(_WAIT_FOR_PROCESS, False, parent), _NO_LIMIT)
        return
    while os.getppid() == parent:
        time.sleep(0.5)


def limit_this_process(seconds: int, memory: int) -> None:
    """Limit the time it computes and the bytes it takes from now on, as far as the system keeps such limits."""
    if resource is None:
        return
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":  # elsewhere the limit is not kept, or counts what every process shares
        most = _fields(PROC / "self" / "status")["VmSize:"] * 1024 + memory
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def available_memory() -> int:
    """Bytes of memory that this process can use without swapping or being killed.

    The minimum of the machine's available memory, the remainder in the control group (v2) of this process and in each
    of its parents, and the limits on address space and data.  A limit that cannot be read is ignored.
    """
    return min([_of_machine(), *_of_groups(), *_of_process()])


def private_memory(process: str = "self") -> int:
    """Bytes of memory that a process has for itself; 0 where the system does not say it."""
    return _fields(PROC / process / "status").get("RssAnon:", 0) * 1024


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
    if IS_POSIX:  # not Linux: the installed memory
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    import ctypes

    windows: Any = ctypes
    status = (ctypes.c_uint64 * 8)(64)  # MEMORYSTATUSEX: its size and the load, then all and available memory, …
    windows.windll.kernel32.GlobalMemoryStatusEx(ctypes.byref(status))
    return status[2]


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
    if resource is None:
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
            with path.open("rb") as file:
                data = file.read(_LARGEST + 1)
            return data.decode() if len(data) <= _LARGEST else ""
    return ""

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
import math
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

IS_POSIX = hasattr(os, "fork")  # whether this is a Unix: Windows has no fork
TERMINATION_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
"""Signals, besides Ctrl-C, that ask a command to end."""
READ_FLAGS = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"))
"""Flags to open a file as it is, without waiting for the other end of a pipe."""
NO_FOLLOW_FLAG = getattr(os, "O_NOFOLLOW", 0)  # to open no file behind a symbolic link

PROC = Path("/proc")  # files of the kernel on processes and memory
CGROUPS = Path("/sys/fs/cgroup")  # and on control groups
_MAX_LOCKED_SECONDS = 2.0  # for which another program may have a file open
Result = TypeVar("Result")


def retry_while_locked(operation: Callable[[], Result]) -> Result:
    """Run a file operation; on Windows repeat it for 2 s while another program has the file open."""
    deadline = time.monotonic() + (0.0 if IS_POSIX else _MAX_LOCKED_SECONDS)
    while True:
        try:
            return operation()
        except PermissionError:
            if time.monotonic() >= deadline:
                raise
        time.sleep(0.02)


def flush_to_disk(path: Path) -> None:
    """Flush a file to the disk, or a folder where the system can open one."""
    is_folder = path.is_dir()
    if is_folder and not IS_POSIX:
        return
    descriptor = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reserve_disk_space(descriptor: int, size: int) -> None:
    """Make an open, empty file ``size`` bytes long; on Linux this reserves the space on the disk."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, size)
    else:
        os.truncate(descriptor, size)


def owned_by_other_user(status: os.stat_result) -> bool:
    """Whether a folder belongs to another user."""
    return IS_POSIX and status.st_uid != os.geteuid()


def is_writable_by_others(status: os.stat_result) -> bool:
    """Whether other users may write into a folder."""
    return IS_POSIX and bool(status.st_mode & (stat.S_IWGRP | stat.S_IWOTH))


def command_line(words: Sequence[str]) -> str:
    """Format a command as the user would type it."""
    return shlex.join(words) if IS_POSIX else subprocess.list2cmdline(words)


def wait_for_parent_exit(parent_id: int) -> None:
    """Wait until the process that started this one has ended."""
    if sys.platform == "win32":  # where the number of a parent stays the same
        import _winapi

        synchronize, infinite = 0x00100000, -1
        _winapi.WaitForSingleObject(_winapi.OpenProcess(synchronize, False, parent_id), infinite)
        return
    while os.getppid() == parent_id:
        time.sleep(0.5)


def limit_this_process(cpu_seconds: int, memory_bytes: int) -> None:
    """Limit processor time and further memory of this process, as far as the system keeps such limits."""
    if resource is None:
        return
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":  # elsewhere the limit is not kept, or counts what every process shares
        max_address_space = _read_integers(PROC / "self" / "status")["VmSize:"] * 1024 + memory_bytes
        resource.setrlimit(resource.RLIMIT_AS, (max_address_space, max_address_space))


def count_processors() -> int:
    """Return how many processors this process may use, by its affinity and the quota of its container."""
    n = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    n = min(n, 61) if sys.platform == "win32" else n  # the most processes that a pool waits for there
    quota = _read_integers(CGROUPS / "cpu.max").items()  # "200000 100000" or "max 100000"
    return max(1, math.ceil(min([n, *(int(time) / period for time, period in quota if time.isdecimal())])))


def available_memory() -> int:
    """Return the bytes that this process can use: the least that machine, control groups (v2) and limits leave it."""
    return min([_machine_memory(), *_control_group_memory(), *_address_space_left()])


def private_memory(process: str = "self") -> int:
    """Return the memory that a process shares with no other, bytes; 0 where the system does not say it."""
    return _read_integers(PROC / process / "status").get("RssAnon:", 0) * 1024


def format_bytes(n_bytes: float) -> str:
    """Format a number of bytes with the largest unit that suits, up to GiB."""
    for size, unit in ((2**30, "GiB"), (2**20, "MiB"), (2**10, "KiB")):
        if n_bytes >= size or (unit == "MiB" and n_bytes >= 0.1 * size):
            return f"{n_bytes / size:,.1f} {unit}"
    return f"{n_bytes:.0f} bytes"


def _machine_memory() -> int:
    """Return the available memory of the machine, bytes; the installed one where the system does not say it."""
    available = _read_integers(PROC / "meminfo").get("MemAvailable:")
    if available is not None:
        return available * 1024
    if IS_POSIX:  # not Linux: the installed memory
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    import ctypes

    windows: Any = ctypes
    status = (ctypes.c_uint64 * 8)(64)  # MEMORYSTATUSEX: its size and the load, then all and available memory, …
    windows.windll.kernel32.GlobalMemoryStatusEx(ctypes.byref(status))
    return status[2]


def _control_group_memory() -> Iterator[int]:
    """Yield the memory left in the control group of this process and in each of its parents."""
    paths = [line[3:] for line in _read_lines(PROC / "self" / "cgroup") if line.startswith("0::")]  # of version 2
    # in a container, the path may lie outside the mount
    names = [name for path in paths for name in path.split("/") if name not in ("", ".", "..")]
    for group in (CGROUPS.joinpath(*names[:depth]) for depth in range(len(names) + 1)):
        high, limit, used = (_read_integers(group / f"memory.{name}").get("") for name in ("high", "max", "current"))
        if used is not None and (limits := [n for n in (high, limit) if n is not None]):
            reclaimable = _read_integers(group / "memory.stat").get("inactive_file", 0)
            yield max(min(limits) - used + reclaimable, 0)


def _address_space_left() -> Iterator[int]:
    """Yield the bytes left of the limit on the address space, if there is one."""
    if resource is not None:
        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            yield max(limit - _read_integers(PROC / "self" / "status").get("VmSize:", 0) * 1024, 0)


def _read_integers(path: Path) -> dict[str, int]:
    """Read the numbers in a file of the kernel by the word before each; a line with a number only has the word ""."""
    pairs = [("", *words) if len(words) == 1 else words for words in map(str.split, _read_lines(path))]
    return {pair[0]: int(pair[1]) for pair in pairs if pair and pair[1].isdecimal()}


def _read_lines(path: Path) -> list[str]:
    """Read the lines of a file of the kernel; none if it cannot be read."""
    with contextlib.suppress(OSError, ValueError):
        return path.read_text(encoding="utf-8").splitlines()
    return []

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
TERMINATION_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
"""Signals, besides Ctrl-C, that ask a command to end."""
READ_FLAGS = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"))
"""Flags to open a file as it is, without waiting for the other end of a pipe."""
NO_FOLLOW_FLAG = getattr(os, "O_NOFOLLOW", 0)

PROC = Path("/proc")
CGROUPS = Path("/sys/fs/cgroup")
_MAX_SYSTEM_FILE_BYTES = 2**20  # bytes read from a file of /proc or /sys at most
_LOCKED_SECONDS, _RETRY_SECONDS = (
    2.0,
    0.02,
)  # seconds for which another program may have a file open; between two trials
_SYNCHRONIZE_ACCESS, _INFINITE_WAIT = 0x00100000, -1  # SYNCHRONIZE and INFINITE of Windows
Result = TypeVar("Result")


def retry_while_locked(operation: Callable[[], Result]) -> Result:
    """Replace or remove a file; on Windows again and again for 2 s, as long as another program has it open."""
    deadline = time.monotonic() + (0.0 if IS_POSIX else _LOCKED_SECONDS)
    while True:
        try:
            return operation()
        except PermissionError:
            if time.monotonic() >= deadline:
                raise
        time.sleep(_RETRY_SECONDS)


def flush_to_disk(path: Path) -> None:
    """Flush a file or folder to the disk; of a folder, where it can be opened."""
    is_folder = path.is_dir()
    if is_folder and not IS_POSIX:
        return
    descriptor = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reserve_disk_space(descriptor: int, size: int) -> None:
    """Make an open, empty file ``size`` bytes long; on Linux it has its room on the disk then."""
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
    """A command as the user would type it."""
    return shlex.join(words) if IS_POSIX else subprocess.list2cmdline(words)


def wait_for_parent_exit(parent_id: int) -> None:
    """Wait until the process that started this one has ended."""
    if sys.platform == "win32":  # where the number of a parent stays the same
        import _winapi

        _winapi.WaitForSingleObject(_winapi.OpenProcess(_SYNCHRONIZE_ACCESS, False, parent_id), _INFINITE_WAIT)
        return
    while os.getppid() == parent_id:
        time.sleep(0.5)


def limit_this_process(cpu_seconds: int, memory_bytes: int) -> None:
    """Limit the time it computes and the bytes it takes from now on, as far as the system keeps such limits."""
    if resource is None:
        return
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":  # elsewhere the limit is not kept, or counts what every process shares
        max_address_space = _read_integer_fields(PROC / "self" / "status")["VmSize:"] * 1024 + memory_bytes
        resource.setrlimit(resource.RLIMIT_AS, (max_address_space, max_address_space))


def available_memory() -> int:
    """Bytes of memory that this process can use without swapping or being killed.

    The minimum of the machine's available memory, the remainder in the control group (v2) of this process and in each
    of its parents, and the limits on address space and data.  A limit that cannot be read is ignored.
    """
    return min([_machine_memory(), *_control_group_memory(), *_process_memory()])


def private_memory(process: str = "self") -> int:
    """Bytes of memory that a process has for itself; 0 where the system does not say it."""
    return _read_integer_fields(PROC / process / "status").get("RssAnon:", 0) * 1024


def format_bytes(n_bytes: float) -> str:
    """Format a number of bytes."""
    for size, unit in ((2**30, "GiB"), (2**20, "MiB"), (2**10, "KiB")):
        if n_bytes >= size or (unit == "MiB" and n_bytes >= 0.1 * size):
            return f"{n_bytes / size:,.1f} {unit}"
    return f"{n_bytes:.0f} bytes"


def _machine_memory() -> int:
    available = _read_integer_fields(PROC / "meminfo").get("MemAvailable:")
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
    """Memory left in the control group of this process and in each of its parents."""
    for line in _read_small_text(PROC / "self" / "cgroup").splitlines():
        if not line.startswith("0::"):  # version 1
            continue
        # in a container, the path may lie outside the mount
        names = [name for name in line.removeprefix("0::").split("/") if name not in ("", ".", "..")]
        for mount in (CGROUPS, CGROUPS / "unified"):
            for depth in range(len(names), -1, -1):
                group = mount.joinpath(*names[:depth])
                limits = [_read_integer(group / file_name) for file_name in ("memory.max", "memory.high")]
                used = _read_integer(group / "memory.current")
                if used is not None and any(limit_bytes is not None for limit_bytes in limits):
                    reclaimable = _read_integer_fields(group / "memory.stat").get("inactive_file", 0)
                    yield max(
                        min(limit_bytes for limit_bytes in limits if limit_bytes is not None) - used + reclaimable, 0
                    )


def _process_memory() -> Iterator[int]:
    if resource is None:
        return
    used = _read_integer_fields(PROC / "self" / "status")
    for name, size in (("RLIMIT_AS", "VmSize:"), ("RLIMIT_DATA", "VmData:")):
        limit, _ = resource.getrlimit(getattr(resource, name))
        if limit != resource.RLIM_INFINITY:
            yield max(limit - used.get(size, 0) * 1024, 0)


def _read_integer_fields(path: Path) -> dict[str, int]:
    """First word of each line of a file → the integer after it."""
    fields = {}
    for line in _read_small_text(path).splitlines():
        words = line.split()
        if len(words) > 1 and words[1].isdecimal():
            fields[words[0]] = int(words[1])
    return fields


def _read_integer(path: Path) -> int | None:
    text = _read_small_text(path).strip()
    return int(text) if text.isdecimal() and len(text) < 30 else None


def _read_small_text(path: Path) -> str:
    """The text of a small file; empty if it cannot be read."""
    with contextlib.suppress(OSError, ValueError):
        if path.is_file():
            with path.open("rb") as file:
                data = file.read(_MAX_SYSTEM_FILE_BYTES + 1)
            return data.decode() if len(data) <= _MAX_SYSTEM_FILE_BYTES else ""
    return ""

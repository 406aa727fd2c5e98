"""System calls on the files of one folder, seen with ``failing_calls.c``: recorded, or made to fail."""

import ctypes
import faulthandler
import mmap
import os
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterator
from enum import IntFlag
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

SHORT = -1
"""In place of an error: half of the bytes are written, and said to be."""
ONCE, FROM_THEN_ON = range(2)
"""When calls fail: the n-th, or all from the n-th on."""
_SOURCE = Path(__file__).with_name("failing_calls.c")


class Call(IntFlag):
    """The calls that are seen, as in the library."""

    OPEN = 1
    WRITE = 2
    TRUNCATE = 4
    ALLOCATE = 8
    SYNC = 16
    RENAME = 32
    UNLINK = 64
    MKDIR = 128
    RMDIR = 256
    CLOSE = 512
    MARK = 1024


CHANGES = ~(Call.CLOSE | Call.MARK)
"""All that may fail."""


class Record(NamedTuple):
    """A call that was done.  file: its descriptor; offset: of what was written, or the new size, or the flags."""

    call: Call
    file: int
    offset: int
    first: bytes
    second: bytes

    @property
    def path(self) -> str:
        return os.fsdecode(self.first)


@cache
def why_not() -> str:
    """Why the calls cannot be seen here, empty if they can."""
    if os.uname().sysname != "Linux" or not hasattr(ctypes.CDLL(None), "gnu_get_libc_version"):
        return "only with Linux and the GNU C library"
    return "" if shutil.which("cc") else "no C compiler: cc"


def build(folder: Path) -> Path:
    """Compile the library into a folder."""
    path = folder / "failing_calls.so"
    words = ["cc", "-O1", "-Wall", "-Werror", "-U_FORTIFY_SOURCE", "-shared", "-fPIC", str(_SOURCE), "-o", str(path)]
    subprocess.run([*words, "-ldl", "-lpthread"], check=True, timeout=60)
    return path


def watch(order: dict[str, Any], seen: mmap.mmap) -> None:
    """Start to watch this process, into which the library is loaded.  seen: takes the number of calls, 8 bytes.

    order: {"folder": …, "record": file that takes them all}, or {"folder": …, "kinds": what counts, "nth": the one to
    fail, 0 for none, "reason": errno or SHORT, "often": ONCE, …}.
    """
    library = ctypes.CDLL(None)
    counter = ctypes.c_long.from_buffer(seen)
    faulthandler.enable()
    target = os.open(order["record"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC) if "record" in order else -1
    if "record" in order:
        _mark_progress(library)
    library.watch_calls(
        os.fsencode(os.path.realpath(order["folder"])),
        target,
        int(order.get("kinds", 0)),
        ctypes.c_long(order.get("nth", 0)),
        order.get("reason", 0),
        order.get("often", ONCE),
        ctypes.byref(counter),
    )


def _mark_progress(library: ctypes.CDLL) -> None:
    """Record also when the package reports scenarios as finished."""
    from fastcoil.study import run as runner

    execute = runner.execute

    def marked(*words: Any, progress: Callable[..., Callable[[int], None]] | None = None, **options: Any) -> Any:
        def start(*work: Any) -> Callable[[int], None]:
            advance = progress(*work) if progress else None

            def finished(n: int) -> None:
                library.mark(str(n).encode())
                if advance:
                    advance(n)

            return finished

        return execute(*words, progress=start, **options)

    runner.execute = marked


def read_records(path: Path) -> Iterator[Record]:
    """What was recorded."""
    data, head, k = path.read_bytes(), struct.Struct("=IiqII"), 0
    while k < len(data):
        call, file, offset, first, second = head.unpack_from(data, k)
        k += head.size
        yield Record(Call(call), file, offset, data[k : k + first], data[k + first : k + first + second])
        k += first + second

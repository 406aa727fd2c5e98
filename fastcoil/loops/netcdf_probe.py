"""Files without a recorded hash: of version 0.1, of a stranger, or of a folder that lost its ``run.json``.

Nobody knows whether they are damaged, and on damaged bytes the library may crash or hang, deaf to Ctrl-C.  A child
process reads them first.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from fastcoil.base.errors import IntegrityError
from fastcoil.base.files import storage_errors
from fastcoil.loops.stored_file import StoredFile

_READER = Path(__file__).with_name("netcdf_probe_reader.py")
_SECONDS, _BYTES_PER_SECOND = 30, 5e6
"""What reading may take: much more than it does."""
_MEMORY = 2**31
_passed: set[tuple[int, ...]] = set()
"""Files that were read to their end, by all that changes when they do."""


def try_reading(path: Path, cure: str) -> StoredFile:
    """Have a child process read a file to its end, once for each process, and give it with the hash of its bytes.

    cure: what to do if it is damaged.

    Raises
    ------
    IntegrityError
        If that fails, or does not end.
    StorageError
        If it cannot be tried.
    """
    file = StoredFile(path, (), cure)
    descriptor = file.hold()
    identity = descriptor.identity
    if identity in _passed:
        file.accepted = (descriptor.sha256(),)
        return file
    seconds = int(_SECONDS + identity[2] / _BYTES_PER_SECOND)
    words = [descriptor.number, seconds, _MEMORY, json.dumps([p for p in sys.path if p])]
    try:
        with storage_errors(path, "read by another process"):
            child = subprocess.run(
                [sys.executable, "-I", str(_READER), *map(str, words)],
                pass_fds=[descriptor.number],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                check=False,
                timeout=seconds,
            )
    except subprocess.TimeoutExpired:
        raise IntegrityError(f"{path} is damaged: reading it did not end in {seconds} s; {cure}") from None
    if child.returncode:
        said = child.stderr.decode(errors="replace").strip().splitlines()
        why = [f"the library ended with signal {-child.returncode}"] if child.returncode < 0 else said
        raise IntegrityError(f"{path} cannot be read as NetCDF ({why[-1]}); {cure}")
    file.accepted = (child.stdout.decode().strip(),)
    _passed.add(identity)
    return file

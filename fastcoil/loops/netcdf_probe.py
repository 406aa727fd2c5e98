"""The child process of ``trial``: reads every variable of a NetCDF file, and says which bytes these were.

Run by its path, with: number of the open file, seconds it may compute, bytes of memory it may take, ``sys.path`` as
JSON.  On damaged bytes the library may crash, fill the memory or never return.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import sys

_CHUNK = 2**20
_AT_ONCE = 2**20
"""Values."""


def main(number: int, seconds: int, memory: int, path: list[str]) -> None:
    """Read the file and print the SHA-256 of its bytes."""
    sys.path[:] = path
    import netCDF4

    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))  # should nobody wait for it any more
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":  # elsewhere the limit is not kept, or counts what every process shares
        with open("/proc/self/statm") as file:
            used = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + memory, used + memory))
    digest, at = hashlib.sha256(), 0
    while chunk := os.pread(number, _CHUNK, at):
        digest.update(chunk)
        at += len(chunk)
    with netCDF4.Dataset(f"/dev/fd/{number}") as file:
        file.set_auto_maskandscale(False)
        _ = {name: file.getncattr(name) for name in file.ncattrs()}
        for variable in file.variables.values():
            _ = {name: variable.getncattr(name) for name in variable.ncattrs()}
            rows = variable.shape[0] if variable.shape else 1
            step = max(1, _AT_ONCE * rows // max(1, variable.size))
            for start in range(0, rows, step):
                _ = variable[start : start + step] if variable.shape else variable[...]
    os.write(sys.stdout.fileno(), digest.hexdigest().encode())


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), json.loads(sys.argv[4]))

"""Read every variable of a NetCDF file: the child process of ``probe_file``.

Arguments: name of the file, limits of seconds and of bytes of memory, ``sys.path`` as JSON.
"""

import json
import sys


def main(name: str, seconds: int, memory: int, path: list[str]) -> None:
    """Read the file."""
    sys.path[:] = path
    import netCDF4

    from fastcoil.base.machine import limit_this_process

    limit_this_process(seconds, memory)  # in case the parent is gone
    with netCDF4.Dataset(name) as file:
        file.set_auto_maskandscale(False)
        _ = {name: file.getncattr(name) for name in file.ncattrs()}
        for variable in file.variables.values():
            _ = {name: variable.getncattr(name) for name in variable.ncattrs()}
            rows = variable.shape[0] if variable.shape else 1
            step = max(1, 2**20 * rows // max(1, variable.size))  # 2**20 values
            for start in range(0, rows, step):
                _ = variable[start : start + step] if variable.shape else variable[...]


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), json.loads(sys.argv[4]))

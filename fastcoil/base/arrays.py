"""Array types of the host layers, and arrays that take no memory; not in arguments.py, which must not load numpy."""

import tempfile
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.files import convert_os_errors
from fastcoil.base.machine import reserve_disk_space

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]
Index: TypeAlias = NDArray[np.int64]
MEMMAP_MIN_BYTES = 2**18  # size from which an array lies in a file


def allocate_on_disk(
    shape: tuple[int, ...], value: Any, dtype: np.dtype[Any], folder: Path | None = None
) -> NDArray[Any]:
    """Make an array, a large one in a nameless file in ``folder`` or that for temporary files, else in memory."""
    size = dtype.itemsize * int(np.prod(shape))
    if size < MEMMAP_MIN_BYTES:
        return np.full(shape, value, dtype)
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            reserve_disk_space(file.fileno(), size)  # on a full disk, a later write to the array would kill the process
            array: NDArray[Any] = np.memmap(file, dtype, "r+", shape=shape)
    except OSError:
        if folder is not None:
            with convert_os_errors(folder, "written"):
                raise
        array = np.zeros(shape, dtype)
    if value != 0:
        array[:] = value
    return array

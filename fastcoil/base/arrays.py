"""Array types of the host layers; not in arguments.py, which must not load numpy."""

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]
Index: TypeAlias = NDArray[np.int64]


def pieces_of(shape: tuple[int, ...], most: int) -> Iterator[tuple[slice, ...]]:
    """Cut an array, in C order, into blocks whose values are neighbours: of ``most`` values, or of a single one."""
    axis, inner = len(shape), 1
    while axis and inner * shape[axis - 1] <= most:
        axis -= 1
        inner *= shape[axis]
    whole = tuple(slice(0, n) for n in shape[axis:])
    if axis == 0:
        yield whole
        return
    n = shape[axis - 1]
    step = -(-n // -(-n // max(1, most // inner)))  # of equal length, as far as they can be
    for outer in np.ndindex(shape[: axis - 1]):
        for start in range(0, n, step):
            yield *(slice(k, k + 1) for k in outer), slice(start, min(start + step, n)), *whole

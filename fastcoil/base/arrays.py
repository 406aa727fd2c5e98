"""Array types of the host layers, and conversion of array-likes; not in arguments.py, which must not load numpy."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.errors import InputError, WrongType, shown

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]
Index: TypeAlias = NDArray[np.int64]

MOST_VALUES = 50_000_000
"""Upper limit of the size of an array argument, such as 1-s samples over all days."""


def array_of(name: str, value: Any, cure: str, kinds: str = "iuf") -> NDArray[Any]:
    """Convert an array-like to a numpy array whose dtype is one of ``kinds``; masked values become NaN.

    Raises
    ------
    InputError
        If it cannot be converted, or is a range of more than ``MOST_VALUES`` values.
    """
    if isinstance(value, range) and len(value) > MOST_VALUES:
        raise InputError(f"{name} = {shown(value)}: more than {MOST_VALUES:,} values, give fewer")
    try:
        if isinstance(value, np.ma.MaskedArray):
            value = np.ma.filled(value.astype(np.float64), np.nan)
        array = np.asarray(value)
    except Exception as error:  # a user's class may raise anything
        if isinstance(error, ValueError) and isinstance(value, (list, tuple)):
            raise InputError(f"{name} has rows of different length: give one length") from None
        raise InputError(WrongType(f"{name} = {shown(value)}: {cure}")) from None
    if array.dtype.kind not in kinds:
        raise InputError(WrongType(f"{name} = {shown(value)} is of type {_word(array.dtype)}: {cure}"))
    return array


def _word(dtype: np.dtype[Any]) -> str:
    """Name of a dtype for users; that of text would carry its length in bits."""
    return "text" if dtype.kind in "US" else dtype.name

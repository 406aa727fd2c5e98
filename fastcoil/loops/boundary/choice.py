"""Days chosen from a boundary, by position or by label, as xarray chooses them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arguments import is_number, plain
from fastcoil.base.arrays import Index, array_of
from fastcoil.base.errors import InputError, WrongType, shown


def positions(day: Any, n_days: int) -> Index | int:
    """Positions of days: of one, or of several by a slice, a list or flags.

    Raises
    ------
    InputError
        If there is no such day.
    """
    cure = f"give positions from 0 to {n_days - 1}, or a slice of them"
    if isinstance(day, slice):
        try:
            found = np.arange(n_days)[day]
        except (TypeError, ValueError):
            raise InputError(WrongType(f"day = {shown(day)}: {cure}")) from None
        return _some(found, day, cure)
    if is_number(day):
        k = float(plain(day))
        if not (-n_days <= k < n_days and k == int(k)):
            raise InputError(f"day = {shown(day)}: {cure}")
        return int(k) % n_days
    values = array_of("day", day, cure, "iub")
    if values.ndim != 1 or (values.dtype.kind == "b" and values.size != n_days):
        raise InputError(f"day = {shown(day)}: {cure}")
    if values.dtype.kind == "b":
        return _some(np.flatnonzero(values), day, cure)
    wrong = values[(values < -n_days) | (values >= n_days)]
    if wrong.size:
        raise InputError(f"day has {wrong[0]}: {cure}")
    return _some(values.astype(np.int64) % n_days, day, cure)


def positions_of(day: Any, labels: NDArray[np.int64]) -> Index | int:
    """Positions of days by their labels: of one, of several in a list, or of all from one to another in a slice.

    Raises
    ------
    InputError
        If there is no day of a label.
    """
    if isinstance(day, slice):
        if day.step is not None:
            raise InputError(f"day = {shown(day)}: leave out the step, or choose positions with isel")
        first = 0 if day.start is None else _place(day.start, labels)
        last = labels.size - 1 if day.stop is None else _place(day.stop, labels)
        return _some(np.arange(first, last + 1), day, "give the earlier label first")
    if is_number(day):
        return _place(day, labels)
    values = array_of("day", day, "give labels of days, or a slice of them", "iuf")
    if values.ndim != 1:
        raise InputError(f"day = {shown(day)}: give a label, a list of labels, or a slice of them")
    return _some(np.array([_place(label, labels) for label in values], dtype=np.int64), day, "give a label")


def _place(label: Any, labels: NDArray[np.int64]) -> int:
    found = np.flatnonzero(labels == plain(label)) if is_number(label) else np.zeros(0)
    if not found.size:
        known = f"{labels[0]} to {labels[-1]}, {labels.size} in all" if labels.size > 8 else shown(labels.tolist())
        raise InputError(f"day = {shown(plain(label))}: the boundary has no such day; it has {known}")
    return int(found[0])


def _some(found: Index, day: Any, cure: str) -> Index:
    if not found.size:
        raise InputError(f"day = {shown(day)} chooses no day: {cure}")
    if np.unique(found).size < found.size:
        raise InputError(f"day = {shown(day)} chooses a day twice: its label could stand for one only")
    return found

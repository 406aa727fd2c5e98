"""What makes the days of a stream: a user's function, or other days, replaced, picked or put together.

Each is called with the position of a day and gives its series.  Classes, not closures: they are sent to other
processes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, shown
from fastcoil.loops.boundary.series import Given

Days = Callable[[int], Mapping[str, Any]]


class Labelled:
    """Days that a user's function makes from their labels."""

    def __init__(self, make: Callable[[int], Mapping[str, Any]], day: NDArray[np.int64]) -> None:
        self._make, self._day = make, day

    def __call__(self, k: int) -> Mapping[str, Any]:
        label = int(self._day[k])
        try:
            return self._make(label)
        except InputError as error:
            raise InputError([f"day {label}: {problem}" for problem in error.problems]) from None
        except Exception as error:  # a user's function may raise anything
            raise InputError(f"make fails for day {label}, {shown(error)}: it must give the series of every day") from (
                error
            )


class Replaced:
    """Days of which some series are given; None goes back to the default."""

    def __init__(self, days: Days, given: Mapping[str, Given | None]) -> None:
        self._days, self._given = days, given

    def __call__(self, k: int) -> Mapping[str, Any]:
        return {**self._days(k), **{name: _row(one, k) for name, one in self._given.items()}}


class Picked:
    """Some of the days, by position."""

    def __init__(self, days: Days, at: Sequence[int]) -> None:
        self._days, self._at = days, at

    def __call__(self, k: int) -> Mapping[str, Any]:
        return self._days(self._at[k])


class OneAfterAnother:
    """The days of several, ``n_days`` of each."""

    def __init__(self, parts: Sequence[Days], n_days: Sequence[int]) -> None:
        self._parts, self._ends = parts, np.cumsum(n_days)

    def __call__(self, k: int) -> Mapping[str, Any]:
        part = int(np.searchsorted(self._ends, k, side="right"))
        return self._parts[part](k - int(self._ends[part - 1] if part else 0))


class EndToEnd:
    """Days of which each begins with that of the first and goes on with those of the others."""

    def __init__(self, parts: Sequence[Callable[[int], Mapping[str, Array]]]) -> None:
        self._parts = parts

    def __call__(self, k: int) -> Mapping[str, Array]:
        rows = [part(k) for part in self._parts]
        return {name: np.concatenate([one[name] for one in rows]) for name in rows[0]}


def _row(one: Given | None, k: int) -> Array | float | None:
    if one is None:
        return None
    values = one.values[k] if "day" in one.dims else one.values
    return values if values.ndim else float(values)

"""Where the samples of a boundary come from: arrays of all days, or days that are made when they are needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, WrongType, collecting, nearest, shown
from fastcoil.base.machine import available_memory, gib
from fastcoil.loops.boundary.air_flow import enabled_by, warn_of_stops
from fastcoil.loops.boundary.digest import LARGE, Survey, day_digest, days_digest, ranges, series_digest, survey
from fastcoil.loops.boundary.series import BOUNDARY_SERIES, Given, read, value_problems

Made = Mapping[str, Any]
"""Series of a day by name, as a user gives them."""
T = TypeVar("T", bound=np.generic)


class Source(Protocol):
    """The samples of a boundary.

    day: labels, (n_days,), read-only.  has_day_dim: whether results have a dim ``day``.
    """

    day: NDArray[np.int64]
    has_day_dim: bool
    n_steps: int
    is_streamed: bool

    def of_day(self, k: int) -> dict[str, Array]:
        """The series of a day by position, (n_steps,) each, read-only."""

    @property
    def series(self) -> dict[str, Array]:
        """The series of all days, (n_days, n_steps) each, read-only."""

    @property
    def extremes(self) -> dict[str, tuple[float, float]]:
        """Least and largest value of each series."""

    @property
    def sha256(self) -> str:
        """Digest of the labels and of every name and sample."""

    @property
    def day_sha256(self) -> list[str]:
        """Digest of each day."""


class Held:
    """Samples in memory: series by name, each (n_days, n_steps)."""

    is_streamed = False

    def __init__(self, series: Mapping[str, Array], day: NDArray[np.int64], has_day_dim: bool) -> None:
        self._series = {name: frozen(values) for name, values in series.items()}
        self.day, self.has_day_dim = frozen(day), has_day_dim
        self.n_steps = int(next(iter(self._series.values())).shape[1])

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for values in (self.day, *self._series.values()):  # a pickled array comes back writeable
            frozen(values)

    def of_day(self, k: int) -> dict[str, Array]:
        return {name: values[k] for name, values in self._series.items()}

    @property
    def series(self) -> dict[str, Array]:
        return dict(self._series)

    @cached_property
    def extremes(self) -> dict[str, tuple[float, float]]:
        return ranges(self._series)

    @cached_property
    def sha256(self) -> str:
        if self.day.size * self.n_steps <= LARGE:
            return series_digest(self._series, self.day, self.has_day_dim)
        return days_digest(self.day_sha256, self.day, self.n_steps, self.has_day_dim)

    @cached_property
    def day_sha256(self) -> list[str]:
        return [day_digest(label, self.of_day(k)) for k, label in enumerate(self.day.tolist())]


class Stream:
    """Days that are made, checked and forgotten; ``make`` gives the series of a day by position."""

    is_streamed = True

    def __init__(self, make: Callable[[int], Made], day: NDArray[np.int64], has_day_dim: bool, n_steps: int) -> None:
        self.make = make
        self.day, self.has_day_dim, self.n_steps = frozen(day), has_day_dim, n_steps
        self._survey: Survey | None = None

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        frozen(self.day)

    def of_day(self, k: int) -> dict[str, Array]:
        rows, _ = self._made(k)
        if self._survey is not None and day_digest(int(self.day[k]), rows) != self._survey.day_sha256[k]:
            raise InputError(
                f"make gives other samples for day {self.day[k]} than before: it must give the same each time, draw "
                "random numbers from a generator that is seeded with the label"
            )
        return rows

    @property
    def series(self) -> dict[str, Array]:
        shape = self.day.size, self.n_steps
        needed, available = 8 * len(BOUNDARY_SERIES) * shape[0] * shape[1], available_memory()
        if needed > available:
            raise InputError(
                f"series of {shape[0]} days of {self.n_steps:,} s take {gib(needed)} of memory, {gib(available)} are "
                "available: take a day at a time with of_day, or some days with isel"
            )
        whole = {name: np.empty(shape) for name in BOUNDARY_SERIES}
        for k in range(shape[0]):
            for name, values in self.of_day(k).items():
                whole[name][k] = values
        return {name: frozen(values) for name, values in whole.items()}

    @property
    def extremes(self) -> dict[str, tuple[float, float]]:
        return dict(self.survey.extremes)

    @property
    def sha256(self) -> str:
        return self.survey.sha256

    @property
    def day_sha256(self) -> list[str]:
        return list(self.survey.day_sha256)

    @property
    def is_surveyed(self) -> bool:
        """Whether all days have been looked at."""
        return self._survey is not None

    @property
    def survey(self) -> Survey:
        """What one pass over the days finds, made when it is first asked for."""
        if self._survey is None:
            days = map(self._made, range(self.day.size))
            found = survey(days, self.day, self.n_steps, self.has_day_dim)
            warn_of_stops(found.stopped)
            self._survey = found
        return self._survey

    def _made(self, k: int) -> tuple[dict[str, Array], int]:
        """The series of a day, and how many of its seconds are stopped for no air flows."""
        return checked_day(self.make(k), int(self.day[k]), self.n_steps)


def checked_day(made: Made, label: int, n_steps: int) -> tuple[dict[str, Array], int]:
    """One day as a user's function made it, as series of (n_steps,), and how many seconds have no air flow.

    Raises
    ------
    InputError
        With one sentence for each mistake, naming the day.
    """
    problems: list[str] = []
    if not isinstance(made, Mapping):
        cure = "give a mapping of series, such as a dict"
        raise InputError(WrongType(f"make gives a {type(made).__name__} for day {label}: {cure}"))
    for name in made:
        if name not in BOUNDARY_SERIES:
            known = ", ".join(BOUNDARY_SERIES)
            problems.append(
                f"make gives {shown(name)} for day {label}{nearest(str(name), BOUNDARY_SERIES)}: use {known}"
            )
    rows: dict[str, Array] = {}
    for name, series in BOUNDARY_SERIES.items():
        with collecting(problems, f"day {label}: "):
            one = read(series, made.get(name))
            if found := _size_problem(name, one, n_steps) or value_problems(series, one, np.asarray(label)):
                raise InputError(found)
            rows[name] = frozen(one.spread(1, n_steps)[0])
    if problems:
        raise InputError(problems)
    stopped = 0
    if made.get("enabled") is None:
        rows["enabled"], stopped = enabled_by(rows["m_a"])
        frozen(rows["enabled"])
    return rows, stopped


def _size_problem(name: str, given: Given, n_steps: int) -> list[str]:
    if "day" in given.dims:
        return [f"{name} has a dim day: give the samples of this day alone"]
    if "elapsed_time" in given.dims and given.values.size != n_steps:
        return [f"{name} has {given.values.size:,} samples where the day has {n_steps:,}: give one for each second"]
    return []


def frozen(values: NDArray[T]) -> NDArray[T]:
    """The array, read-only from now on."""
    values.flags.writeable = False
    return values

"""Where the samples of a boundary come from: arrays of all days, or days made on demand; their digests and ranges."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, WrongType, collecting, nearest, shown
from fastcoil.base.machine import available_memory, gib
from fastcoil.loops.boundary.series import (
    ADDED_SERIES,
    BOUNDARY_SERIES,
    Given,
    enabled_by,
    read,
    value_problems,
    warn_of_stops,
)

LARGE = 2**22
"""Samples of a series.  A boundary of more is hashed day by day, so that a stream of them needs no memory; one of fewer
series by series, as every boundary once was."""


class Survey(NamedTuple):
    """What one pass over the days finds.

    extremes: least and largest value by series.  sha256: of all; day_sha256: of each day.  stopped: seconds that are
    not enabled because no air flows.
    """

    extremes: dict[str, tuple[float, float]]
    sha256: str
    day_sha256: list[str]
    stopped: int = 0


def day_digest(label: int, rows: Mapping[str, Array]) -> str:
    """Hash of a day: of its label, and of its samples, second by second."""
    digest = hashlib.sha256(f"{label} ".encode())
    digest.update(np.stack([rows[name] for name in _hashed(rows)], axis=1).data)
    return digest.hexdigest()


def survey(
    days: Iterable[tuple[dict[str, Array], int]], labels: NDArray[np.int64], n_steps: int, has_day_dim: bool
) -> Survey:
    """One pass over the days: the series of each, and how many of its seconds are stopped."""
    small = labels.size * n_steps <= LARGE
    kept: dict[str, list[Array]] = {name: [] for name in BOUNDARY_SERIES}
    extremes: dict[str, tuple[float, float]] = {}
    found, stopped = [], 0
    for label, (rows, seconds) in zip(labels.tolist(), days, strict=True):
        stopped += seconds
        found.append(day_digest(label, rows))
        for name, (low, high) in ranges(rows).items():
            before = extremes.get(name, (low, high))
            extremes[name] = min(low, before[0]), max(high, before[1])
            if small:
                kept[name].append(rows[name])
    if small:
        held = {name: np.stack(one) for name, one in kept.items()}
        return Survey(extremes, series_digest(held, labels, has_day_dim), found, stopped)
    return Survey(extremes, days_digest(found, labels, n_steps, has_day_dim), found, stopped)


def ranges(series: Mapping[str, Array]) -> dict[str, tuple[float, float]]:
    """Least and largest value by series."""
    return {name: (float(values.min()), float(values.max())) for name, values in series.items()}


def series_digest(series: Mapping[str, Array], labels: NDArray[np.int64], has_day_dim: bool) -> str:
    """Hash of the day labels and of every name and sample, series by series, each (n_days, n_steps)."""
    n_steps = next(iter(series.values())).shape[1]
    digest = _begun(1, labels, n_steps, has_day_dim)
    for name in _hashed(series):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(series[name], dtype="<f8").data)
    return digest.hexdigest()


def days_digest(days: Iterable[str], labels: NDArray[np.int64], n_steps: int, has_day_dim: bool) -> str:
    """Hash of the day labels and of the hashes of all ``days``."""
    digest = _begun(2, labels, n_steps, has_day_dim)
    for one in days:
        digest.update(one.encode())
    return digest.hexdigest()


def _begun(version: int, labels: NDArray[np.int64], n_steps: int, has_day_dim: bool) -> hashlib._Hash:
    digest = hashlib.sha256(f"boundary {version} {has_day_dim} {labels.size} {n_steps}".encode())
    digest.update(labels.astype("<i8").tobytes())
    return digest


def _hashed(series: Mapping[str, Array]) -> list[str]:
    """The series that count; one that came later only where it does something, so that older digests hold."""
    return [
        name
        for name, values in series.items()
        if name not in ADDED_SERIES or not (values == BOUNDARY_SERIES[name].default).all()
    ]


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

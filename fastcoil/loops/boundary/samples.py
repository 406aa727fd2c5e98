"""The days of a boundary: the Dataset of all samples, or makers of days; digests and ranges of either."""

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from itertools import chain
from typing import Any, NamedTuple, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base.arguments import mapping_of, refuse, whole_of
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.base.machine import available_memory, gib
from fastcoil.logs.series import DIFFERENCE
from fastcoil.loops.boundary.series import (
    ADDED_SERIES,
    BOUNDARY_SERIES,
    SECONDS,
    Clock,
    Given,
    Times,
    read_series,
    series_of,
    warn_of_stops,
)
from fastcoil.loops.labelled import Course
from fastcoil.model.moist_air import MASS_RATIO, liquid_pressure

Made = Mapping[str, Any]  # series of a day by name, as a user gives them
Maker = Callable[[int], Made]  # makes a day from its position
LARGE = 2**22
"""Samples of a series.  A larger boundary is hashed day by day, so that a stream needs no memory; a smaller one series
by series."""


class Survey(NamedTuple):
    """Least and largest value by series, digests of all and of each day, and the dampest air, from one pass.

    dampest: relative humidity over pressure, 1/Pa, of the sample nearest to saturation, and this sample in words; what
    air can hold depends on the pressure, which only the loop knows.
    """

    extremes: dict[str, tuple[float, float]]
    sha256: str
    day_sha256: list[str]
    dampest: tuple[float, str]


class Samples:
    """Labelled days of series with their clock; immutable."""

    _ds: xr.Dataset
    """Labels and clock as coordinates, ``start`` only if it is known; the series unless a maker gives them."""
    _make: Maker | None
    _time_zone: str
    _by_air: bool

    @classmethod
    def of(cls, ds: xr.Dataset, *, make: Maker | None = None, time_zone: str = "", by_air: bool = False) -> Self:
        """A boundary of checked samples; ``by_air``: the air flow alone decides on ``enabled``."""
        self = cls.__new__(cls)
        self.__setstate__({"_ds": ds, "_make": make, "_time_zone": time_zone, "_by_air": by_air})
        return self

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for variable in self._ds.data_vars.values():  # a copied or pickled array is writeable
            frozen(variable.values)

    @property
    def is_streamed(self) -> bool:
        """Whether days are made on demand instead of held in memory."""
        return self._make is not None

    @property
    def day(self) -> NDArray[np.int64]:
        """Labels of the days, (n_days,), read-only."""
        return frozen(np.atleast_1d(self._ds["day"].values).astype(np.int64))

    @property
    def has_day_dim(self) -> bool:
        """Whether results have a dim ``day``."""
        return "day" in self._ds.dims

    @property
    def n_days(self) -> int:
        return int(self._ds.sizes.get("day", 1))

    @property
    def n_steps(self) -> int:
        """Number of 1-s steps."""
        return int(self._ds.sizes["elapsed_time"])

    @property
    def hours(self) -> float:
        return self.n_steps / 3600

    @property
    def start(self) -> Times | None:
        """Date and time of the first sample of each day, (n_days,) datetime64[s]; None if unknown."""
        return np.atleast_1d(self._ds["start"].values).astype(SECONDS) if "start" in self._ds.coords else None

    @property
    def time_zone(self) -> str:
        """The time zone of ``start``; blank if unknown."""
        return self._time_zone

    @property
    def clock_zone(self) -> str | None:
        """The time zone of ``start``, blank if it has none; None if nothing is known of the clock."""
        return self._time_zone or (None if self.start is None else "")

    @property
    def start_coordinate(self) -> xr.DataArray | None:
        """``start`` as a coordinate of results, along ``day`` if there is that dim; None if unknown."""
        return xr.DataArray(self._ds["start"].variable) if "start" in self._ds.coords else None

    @property
    def series(self) -> dict[str, Array]:
        """All series by name, each float64 (n_days, n_steps), read-only; all days of a stream are made for it."""
        if self._make is None:
            return {str(name): np.atleast_2d(values.values) for name, values in self._ds.data_vars.items()}
        needed, available = 8 * len(BOUNDARY_SERIES) * self.n_days * self.n_steps, available_memory()
        if needed > available:
            raise InputError(
                f"series of {self.n_days} days of {self.n_steps:,} s take {gib(needed)} of memory, {gib(available)} "
                "are available: take a day at a time with of_day, or some days with isel"
            )
        whole = {name: np.empty((self.n_days, self.n_steps)) for name in BOUNDARY_SERIES}
        for k in range(self.n_days):
            for name, values in self.of_day(k).items():
                whole[name][k] = values
        return {name: frozen(values) for name, values in whole.items()}

    def of_day(self, k: int) -> dict[str, Array]:
        """The series of one day by position, each float64 (n_steps,), read-only."""
        k = whole_of("k", k, 0, self.n_days - 1)
        rows, _ = self.made(k)
        if self._make is not None and self.is_surveyed and day_digest(int(self.day[k]), rows) != self.day_sha256[k]:
            raise InputError(
                f"make gives other samples for day {self.day[k]} than before: it must give the same each time, draw "
                "random numbers from a generator that is seeded with the label"
            )
        return rows

    def made(self, k: int) -> tuple[dict[str, Array], int]:
        """The series of a day, and how many of its seconds a stream finds to be off for want of air flow."""
        if self._make is None:
            return {name: values[k] for name, values in self.series.items()}, 0
        label, start = int(self.day[k]), None if self.start is None else self.start[k]
        known = Course(day=np.asarray(label), start=start, time_zone=self.clock_zone)
        return checked_day(self._make(k), self.n_steps, known)

    @property
    def is_surveyed(self) -> bool:
        """Whether ranges and digests are known: those of a stream take a pass over all its days."""
        return "_survey" in self.__dict__

    @property
    def extremes(self) -> dict[str, tuple[float, float]]:
        """Least and largest value of each series; a stream makes all its days for it, once."""
        return dict(self._survey.extremes)

    @property
    def sha256(self) -> str:
        """Digest of the day labels and of every name and sample; the clock does not count."""
        return self._survey.sha256

    @property
    def day_sha256(self) -> list[str]:
        """Digest of each day's label and samples."""
        return list(self._survey.day_sha256)

    @cached_property
    def _survey(self) -> Survey:
        small = self.n_days * self.n_steps <= LARGE
        extremes: dict[str, tuple[float, float]] = {}
        hashes, kept, stopped, damp = [], [], 0, (0.0, "")
        for k, label in enumerate(self.day.tolist()):
            rows, seconds = self.made(k)
            stopped += seconds
            hashes.append(day_digest(label, rows))
            damp = dampest(rows["T_a_in"], rows["W_a_in"], f" of day {label}" if self.has_day_dim else "", damp)
            for name, values in rows.items():
                low, high = extremes.get(name, (np.inf, -np.inf))
                extremes[name] = min(low, float(values.min())), max(high, float(values.max()))
            if small:
                kept.append(rows)
        warn_of_stops(stopped)
        if not small:
            return Survey(extremes, digest_of(self, 2, (one.encode() for one in hashes)), hashes, damp)
        of_kept = ((name, [rows[name] for rows in kept]) for name in hashed(extremes))
        named = ((name.encode(), np.stack(rows, dtype="<f8").data) for name, rows in of_kept)  # one at a time
        return Survey(extremes, digest_of(self, 1, chain.from_iterable(named)), hashes, damp)

    @property
    def dampest(self) -> tuple[float, str]:
        """The sample of entering air that is nearest to saturation, see ``Survey``."""
        return self._survey.dampest

    @property
    def extent(self) -> str:
        """Length, days and start: ``24 h x 3 days from 2023-07-01 00:00:00 (UTC-08:00)``."""
        text = f"{self.hours:g} h" + (f" x {self.n_days} days" if self.has_day_dim else "")
        if self.start is not None:
            text += f" from {str(self.start[0]).replace('T', ' ')}" + (f" ({self.time_zone})" if self.time_zone else "")
        return text

    def describe(self) -> str:
        """One line: the length, the days, and the range of every series that is not at its default."""
        found = []
        for name, (low, high) in self.own_extremes.items():
            unit = "" if BOUNDARY_SERIES[name].unit == "1" else f" {BOUNDARY_SERIES[name].unit}"
            found.append(f"{name} {low:.4g}{unit}" if low == high else f"{name} {low:.4g} to {high:.4g}{unit}")
        return f"{self.extent}: {', '.join(found)}"

    @property
    def own_extremes(self) -> dict[str, tuple[float, float]]:
        """The ranges of the series that are not at their default throughout."""
        return {n: ends for n, ends in self.extremes.items() if ends != (BOUNDARY_SERIES[n].default,) * 2}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Samples):
            return NotImplemented
        return self is other or (np.array_equal(self.day, other.day) and self.sha256 == other.sha256)

    def __hash__(self) -> int:
        return hash(self.sha256)

    @property
    def maker(self) -> Maker:
        """Makes its days again, for a stream of other days."""
        return self._make or self.of_day


def dataset_of(series: Mapping[str, Array], day: NDArray[Any], n_steps: int, clock: Clock) -> xr.Dataset:
    """The Dataset of a boundary: series, (n_days, n_steps) each; none of a stream."""
    dims, row = (("day",), slice(None)) if day.ndim else ((), 0)
    seconds = np.arange(float(n_steps))
    ds = xr.Dataset(
        variables_of({name: values[row] for name, values in series.items()}),
        {
            "elapsed_time": ("elapsed_time", seconds, {"units": "s", "long_name": "time since the start"}),
            "day": (dims, day.astype(np.int64), {"long_name": "label of the day"}),
        },
    )
    if clock.start is None:
        return ds
    attrs = {"long_name": "date and time at elapsed_time 0", "standard_name": "time"}
    attrs |= {"time_zone": clock.time_zone} if clock.time_zone else {}
    return ds.assign_coords(start=(dims, clock.start.astype("datetime64[ns]")[row], attrs))


def with_day_dim(ds: xr.Dataset) -> xr.Dataset:
    """The Dataset of a boundary with the dim ``day``."""
    clock = [name for name in ("start",) if name in ds.coords]
    return ds if "day" in ds.dims else ds.reset_coords(clock).expand_dims("day").set_coords(clock)


def variables_of(series: Mapping[str, Array]) -> dict[str, xr.Variable]:
    """Series, (n_days, n_steps) or (n_steps,), with dims, units and long names."""
    found = {}
    for name, values in series.items():
        of = BOUNDARY_SERIES[name]
        attrs = {"units": of.unit, "long_name": of.long_name}
        if of.units is DIFFERENCE:  # CF-1.11: a difference in K is not a temperature in K
            attrs["units_metadata"] = "temperature: difference"
        found[name] = xr.Variable(("day", "elapsed_time")[-values.ndim :], values, attrs)
    return found


# Makers are partial functions, not closures: they are sent to other processes.


def labelled_day(make: Callable[[int], Made], labels: NDArray[np.int64], k: int) -> Made:
    """A day that a user's function makes from its label."""
    label = int(labels[k])
    try:
        return make(label)
    except InputError as error:
        raise InputError([f"day {label}: {problem}" for problem in error.problems]) from None
    except Exception as error:  # a user's function may raise anything
        cure = "it must give the series of every day"
        raise InputError(f"make fails for day {label}, {shown(error)}: {cure}") from error


def replaced_day(make: Maker, given: Mapping[str, Given | None], k: int) -> Made:
    """A day of which some series are given; None goes back to the default."""
    return {**make(k), **{name: None if one is None else one.of_day(k) for name, one in given.items()}}


def picked_day(makers: Sequence[Maker], part: Index, at: Index, k: int) -> Made:
    """A day of others: of the ``part`` of each, the one ``at`` a position, both (n_days,)."""
    make: Maker = makers[part[k]]
    return make(int(at[k]))


def checked_day(made: Made, n_steps: int, known: Course) -> tuple[dict[str, Array], int]:
    """A day that was made as series of (n_steps,), and how many seconds have no air flow; mistakes name the day."""
    label = int(np.asarray(known.day))
    mapping_of(f"what make gives for day {label}", made, "give a mapping of series by name, such as a dict")
    unknown, names = [name for name in made if name not in BOUNDARY_SERIES], ", ".join(BOUNDARY_SERIES)
    refuse([f"make gives {shown(n)} for day {label}{nearest(n, BOUNDARY_SERIES)}: use {names}" for n in unknown])
    problems: list[str] = []
    series = {name: made.get(name) for name in BOUNDARY_SERIES}
    given, _ = read_series(series, problems, known=known._replace(n_steps=n_steps))
    refuse([f"day {label}: {problem}" for problem in problems])
    rows, stopped = series_of(given, 1, n_steps, by_air=made.get("enabled") is None)
    return {name: frozen(values[0]) for name, values in rows.items()}, stopped


def dampest(T: Array, W: Array, day: str, than: tuple[float, str]) -> tuple[float, str]:
    """``Survey.dampest`` of a day, (n_steps,) each, or ``than`` if that is nearer to saturation."""
    ratio = W / (MASS_RATIO + W)
    if ratio.max() / liquid_pressure(T.min()) <= than[0]:  # no sample can be nearer
        return than
    ratio = ratio / liquid_pressure(T)
    k = int(np.argmax(ratio))
    return max(than, (float(ratio[k]), f"W_a_in = {W[k]:.4g} at T_a_in = {T[k]:.4g} degC at second {k}{day}"))


def frozen(values: NDArray[Any]) -> NDArray[Any]:
    """The array, read-only from now on."""
    values.flags.writeable = False
    return values


def day_digest(label: int, rows: Mapping[str, Array]) -> str:
    """Hash of a day: of its label, and of its samples, second by second."""
    digest = hashlib.sha256(f"{label} ".encode())
    digest.update(np.stack([rows[name] for name in hashed(rows)], axis=1).data)
    return digest.hexdigest()


def digest_of(days: Samples, version: int, parts: Iterable[Any]) -> str:
    """Hash of the day labels and of the bytes of all parts."""
    digest = hashlib.sha256(f"boundary {version} {days.has_day_dim} {days.n_days} {days.n_steps}".encode())
    digest.update(days.day.astype("<i8").tobytes())
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def hashed(series: Mapping[str, Any]) -> list[str]:
    """The series, given by their values or ranges, that count; one of ``ADDED_SERIES`` only where it does something."""
    default = {name: BOUNDARY_SERIES[name].default for name in ADDED_SERIES}
    return [n for n, values in series.items() if n not in default or np.any(np.asarray(values) != default[n])]

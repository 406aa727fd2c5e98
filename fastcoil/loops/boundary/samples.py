"""Days of a boundary: the Dataset of all samples, or makers of days; digests and ranges of either."""

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from itertools import chain
from typing import Any, NamedTuple, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base.arguments import raise_problems, require_integer
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.base.machine import available_memory, format_bytes
from fastcoil.base.text import format_count
from fastcoil.logs.series import TEMPERATURE_DIFFERENCE
from fastcoil.loops.labelled import SeriesLabels
from fastcoil.model.moist_air import MASS_RATIO, liquid_saturation_pressure

from fastcoil.loops.boundary.series import (  # isort: skip
    ADDED_SERIES, BOUNDARY_SERIES, DATETIME_SECONDS, Clock, LabelledSeries, Times, complete_series, read_series,
    warn_of_no_air_flow,
)  # fmt: skip

DaySeries = Mapping[str, Any]  # unchecked series of a day by name
DayMaker = Callable[[int], DaySeries]  # makes a day from its position
LARGE_BOUNDARY_SAMPLES = 2**22
"""Samples of a series; a larger boundary is hashed day by day, without memory, a smaller one series by series."""


class SampleSummary(NamedTuple):
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
    _maker: DayMaker | None
    _time_zone: str
    _enabled_by_air: bool

    @classmethod
    def from_samples(
        cls, ds: xr.Dataset, *, make: DayMaker | None = None, time_zone: str, enabled_by_air: bool
    ) -> Self:
        """Return a boundary of checked samples; ``enabled_by_air``: the air flow alone decides on ``enabled``."""
        self = cls.__new__(cls)
        self.__setstate__({"_ds": ds, "_maker": make, "_time_zone": time_zone, "_enabled_by_air": enabled_by_air})
        return self

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for variable in self._ds.data_vars.values():  # a copied or pickled array is writeable
            freeze(variable.values)

    @property
    def is_streamed(self) -> bool:
        """Whether days are made on demand instead of held in memory."""
        return self._maker is not None

    @property
    def day(self) -> NDArray[np.int64]:
        """Labels of the days, (n_days,), read-only."""
        return freeze(np.atleast_1d(self._ds["day"].values).astype(np.int64))

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
        return np.atleast_1d(self._ds["start"].values).astype(DATETIME_SECONDS) if "start" in self._ds.coords else None

    @property
    def time_zone(self) -> str:
        """Time zone of ``start``; blank if unknown."""
        return self._time_zone

    @property
    def clock_zone(self) -> str | None:
        """Time zone of ``start``, blank if it has none; None if the clock is unknown."""
        return self._time_zone or (None if self.start is None else "")

    @property
    def start_coordinate(self) -> xr.DataArray | None:
        """``start`` as a coordinate of results, along ``day`` if there is that dim; None if unknown."""
        return xr.DataArray(self._ds["start"].variable) if "start" in self._ds.coords else None

    @property
    def series(self) -> dict[str, Array]:
        """All series by name, each float64 (n_days, n_steps), read-only; makes all days of a stream."""
        if self._maker is None:
            return {str(name): np.atleast_2d(values.values) for name, values in self._ds.data_vars.items()}
        needed, available = 8 * len(BOUNDARY_SERIES) * self.n_days * self.n_steps, available_memory()
        if needed > available:
            sizes = f"take {format_bytes(needed)} of memory, {format_bytes(available)} are available"
            cure = "take a day at a time with of_day, or some days with isel"
            raise InputError(f"series of {self.n_days} days of {self.n_steps:,} s {sizes}: {cure}", "series", "size")
        arrays = {name: np.empty((self.n_days, self.n_steps)) for name in BOUNDARY_SERIES}
        for k in range(self.n_days):
            for name, values in self.of_day(k).items():
                arrays[name][k] = values
        return {name: freeze(values) for name, values in arrays.items()}

    def of_day(self, k: int) -> dict[str, Array]:
        """Return the series of one day by position, each float64 (n_steps,), read-only."""
        k = require_integer("k", k, 0, self.n_days - 1)
        rows, _ = self.make_day(k)
        if self._maker is not None and self.has_summary and day_digest(int(self.day[k]), rows) != self.day_sha256[k]:
            cure = "it must give the same each time, draw random numbers from a generator that is seeded with the label"
            raise InputError(f"make gives other samples for day {self.day[k]} than before: {cure}", "make", "code")
        return rows

    def make_day(self, k: int) -> tuple[dict[str, Array], int]:
        """Return the series of a day and, of a stream, its number of seconds that are off because no air flows."""
        if self._maker is None:
            return {name: values[k] for name, values in self.series.items()}, 0
        label, start = int(self.day[k]), None if self.start is None else self.start[k]
        known_labels = SeriesLabels(day=np.asarray(label), start=start, time_zone=self.clock_zone)
        return read_day(self._maker(k), self.n_steps, known_labels)

    @property
    def has_summary(self) -> bool:
        """Whether ranges and digests are known: those of a stream take a pass over all its days."""
        return "_summary" in self.__dict__

    @property
    def extremes(self) -> dict[str, tuple[float, float]]:
        """Least and largest value of each series; makes all days of a stream, once."""
        return dict(self._summary.extremes)

    @property
    def sha256(self) -> str:
        """Digest of the day labels and of every name and sample; the clock does not count."""
        return self._summary.sha256

    @property
    def day_sha256(self) -> list[str]:
        """Digest of each day's label and samples."""
        return list(self._summary.day_sha256)

    @cached_property
    def _summary(self) -> SampleSummary:
        is_small = self.n_days * self.n_steps <= LARGE_BOUNDARY_SAMPLES
        extremes: dict[str, tuple[float, float]] = {}
        hashes, kept_rows, n_stopped, dampest = [], [], 0, (0.0, "")
        for k, label in enumerate(self.day.tolist()):
            rows, seconds = self.make_day(k)
            n_stopped += seconds
            hashes.append(day_digest(label, rows))
            place = f" of day {label}" if self.has_day_dim else ""
            dampest = dampest_sample(rows["T_a_in"], rows["W_a_in"], place, dampest)
            for name, values in rows.items():
                low, high = extremes.get(name, (np.inf, -np.inf))
                extremes[name] = min(low, float(values.min())), max(high, float(values.max()))
            if is_small:
                kept_rows.append(rows)
        warn_of_no_air_flow(n_stopped)
        if not is_small:
            return SampleSummary(extremes, boundary_digest(self, 2, map(str.encode, hashes)), hashes, dampest)
        named_bytes = (  # one at a time
            (name.encode(), np.stack([rows[name] for rows in kept_rows], dtype="<f8").data)
            for name in names_to_hash(extremes)
        )
        return SampleSummary(extremes, boundary_digest(self, 1, chain.from_iterable(named_bytes)), hashes, dampest)

    @property
    def dampest(self) -> tuple[float, str]:
        """Sample of entering air that is nearest to saturation, see ``SampleSummary``."""
        return self._summary.dampest

    @property
    def extent(self) -> str:
        """Length, days and start: ``24 h x 3 days from 2023-07-01 00:00:00 (UTC-08:00)``."""
        text = f"{self.hours:g} h" + (f" x {format_count(self.n_days, 'day')}" if self.has_day_dim else "")
        if self.start is not None:
            text += f" from {str(self.start[0]).replace('T', ' ')}" + (f" ({self.time_zone})" if self.time_zone else "")
        return text

    def describe(self) -> str:
        """Return one line: length, days, and the range of every series that is not at its default."""
        ranges = []
        for name, (low, high) in self.non_default_extremes.items():
            unit = "" if BOUNDARY_SERIES[name].unit == "1" else f" {BOUNDARY_SERIES[name].unit}"
            ranges.append(f"{name} {low:.4g}{unit}" if low == high else f"{name} {low:.4g} to {high:.4g}{unit}")
        return f"{self.extent}: {', '.join(ranges)}"

    @property
    def non_default_extremes(self) -> dict[str, tuple[float, float]]:
        """Ranges of the series that are not at their default throughout."""
        return {n: ends for n, ends in self.extremes.items() if ends != (BOUNDARY_SERIES[n].default,) * 2}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Samples):
            return NotImplemented
        return self is other or (np.array_equal(self.day, other.day) and self.sha256 == other.sha256)

    def __hash__(self) -> int:
        return hash(self.sha256)

    @property
    def maker(self) -> DayMaker:
        """Function that makes its days again, for a stream of other days."""
        return self._maker or self.of_day


def boundary_dataset(series: Mapping[str, Array], day: NDArray[Any], n_steps: int, clock: Clock) -> xr.Dataset:
    """Return the Dataset of a boundary: series, (n_days, n_steps) each; none of a stream."""
    dims, row = (("day",), slice(None)) if day.ndim else ((), 0)
    seconds = ("elapsed_time", np.arange(float(n_steps)), {"units": "s", "long_name": "time since the start"})
    labels = (dims, day.astype(np.int64), {"long_name": "label of the day"})
    variables = series_variables({name: values[row] for name, values in series.items()})
    ds = xr.Dataset(variables, {"elapsed_time": seconds, "day": labels})
    if clock.start is None:
        return ds
    attrs = {"long_name": "date and time at elapsed_time 0", "standard_name": "time"}
    attrs |= {"time_zone": clock.time_zone} if clock.time_zone else {}
    return ds.assign_coords(start=(dims, clock.start.astype("datetime64[ns]")[row], attrs))


def with_day_dim(ds: xr.Dataset) -> xr.Dataset:
    """Return the Dataset of a boundary with the dim ``day``."""
    clock = [name for name in ("start",) if name in ds.coords]
    return ds if "day" in ds.dims else ds.reset_coords(clock).expand_dims("day").set_coords(clock)


def series_variables(series: Mapping[str, Array]) -> dict[str, xr.Variable]:
    """Give series, (n_days, n_steps) or (n_steps,), their dims, units and long names."""
    variables = {}
    for name, values in series.items():
        definition = BOUNDARY_SERIES[name]
        attrs = {"units": definition.unit, "long_name": definition.long_name}
        if definition.units is TEMPERATURE_DIFFERENCE:  # CF-1.11: a difference in K is not a temperature in K
            attrs["units_metadata"] = "temperature: difference"
        variables[name] = xr.Variable(("day", "elapsed_time")[-values.ndim :], values, attrs)
    return variables


# Makers are partial functions, not closures: they are sent to other processes.


def make_labelled_day(make: Callable[[int], DaySeries], labels: NDArray[np.int64], k: int) -> DaySeries:
    """Call a user's function for the day of a label."""
    label = int(labels[k])
    try:
        return make(label)
    except InputError as error:
        raise InputError([problem.with_prefix(f"day {label}: ") for problem in error.problems]) from None
    except Exception as error:  # a user's function may raise anything
        sentence = f"make fails for day {label}, {short_repr(error)}: it must give the series of every day"
        raise InputError(sentence, "make", "code") from error


def replace_series(make: DayMaker, replacements: Mapping[str, LabelledSeries | None], k: int) -> DaySeries:
    """Make a day and replace some of its series; None goes back to the default."""
    return {**make(k), **{name: None if entry is None else entry.of_day(k) for name, entry in replacements.items()}}


def pick_day(makers: Sequence[DayMaker], maker_index: Index, position: Index, k: int) -> DaySeries:
    """Make day ``k`` by the maker ``maker_index[k]`` from its day ``position[k]``."""
    make: DayMaker = makers[maker_index[k]]
    return make(int(position[k]))


def read_day(day_series: DaySeries, n_steps: int, known_labels: SeriesLabels) -> tuple[dict[str, Array], int]:
    """Check a day, series of (n_steps,), and count the seconds without air flow; mistakes name the day."""
    label = int(np.asarray(known_labels.day))
    if not isinstance(day_series, Mapping) or not all(isinstance(name, str) for name in day_series):
        sentence = f"what make gives for day {label} = {short_repr(day_series)}"
        raise InputError(f"{sentence}: give a mapping of series by name, such as a dict", "make", "type")
    raise_problems([
        Problem(f"make gives {short_repr(name)} for day {label}{did_you_mean(name, BOUNDARY_SERIES)}: use "
                f"{', '.join(BOUNDARY_SERIES)}", name, "name")
        for name in day_series if name not in BOUNDARY_SERIES
    ])  # fmt: skip
    problems: list[str] = []
    series = {name: day_series.get(name) for name in BOUNDARY_SERIES}
    entries, _ = read_series(series, problems, known_labels=known_labels._replace(n_steps=n_steps))
    raise_problems([problem.with_prefix(f"day {label}: ") for problem in InputError(problems).problems])
    rows, n_stopped = complete_series(entries, 1, n_steps, enabled_by_air=day_series.get("enabled") is None)
    return {name: freeze(values[0]) for name, values in rows.items()}, n_stopped


def dampest_sample(T: Array, W: Array, day: str, dampest_so_far: tuple[float, str]) -> tuple[float, str]:
    """Return ``SampleSummary.dampest`` of a day, (n_steps,) each, or ``dampest_so_far`` if nearer to saturation."""
    ratio = W / (MASS_RATIO + W)
    if ratio.max() / liquid_saturation_pressure(T.min()) <= dampest_so_far[0]:  # no sample can be nearer
        return dampest_so_far
    ratio = ratio / liquid_saturation_pressure(T)
    k = int(np.argmax(ratio))
    return max(dampest_so_far, (float(ratio[k]), f"W_a_in = {W[k]:.4g} at T_a_in = {T[k]:.4g} degC at second {k}{day}"))


def freeze(values: NDArray[Any]) -> NDArray[Any]:
    """Make an array read-only."""
    values.flags.writeable = False
    return values


def day_digest(label: int, rows: Mapping[str, Array]) -> str:
    """Hash the label of a day and its samples, second by second."""
    digest = hashlib.sha256(f"{label} ".encode())
    digest.update(np.stack([rows[name] for name in names_to_hash(rows)], axis=1).data)
    return digest.hexdigest()


def boundary_digest(days: Samples, version: int, parts: Iterable[Any]) -> str:
    """Hash the day labels and the bytes of all parts."""
    digest = hashlib.sha256(f"boundary {version} {days.has_day_dim} {days.n_days} {days.n_steps}".encode())
    digest.update(days.day.astype("<i8").tobytes())
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def names_to_hash(series: Mapping[str, Any]) -> list[str]:
    """Return the names that count of series with values or ranges: ``ADDED_SERIES`` only if not at their default."""
    default = {name: BOUNDARY_SERIES[name].default for name in ADDED_SERIES}
    return [n for n, values in series.items() if n not in default or np.any(np.asarray(values) != default[n])]

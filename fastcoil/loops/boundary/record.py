"""``Boundary``: the series that act on the loop from outside, second by second."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base.arguments import argument_checks, collect_problems, raise_problems, require_instance, require_path
from fastcoil.base.errors import InputError, WrongTypeMessage, did_you_mean, short_repr
from fastcoil.logs import read_checked_log, warn_of_reading_notes
from fastcoil.logs.columns import ColumnSpec, check_reading_options
from fastcoil.logs.pieces import require_span_in_limits, require_whole_seconds, resample_at_seconds
from fastcoil.logs.series import HUMIDITY_COLUMNS
from fastcoil.loops.boundary.samples import (
    DayMaker,
    Samples,
    boundary_dataset,
    make_labelled_day,
    pick_day,
    replace_series,
    series_variables,
    with_day_dim,
)
from fastcoil.loops.boundary.series import (
    BOUNDARY_SERIES,
    Clock,
    Values,
    complete_series,
    hours_to_seconds,
    label_array,
    make_clock,
    read_series,
    require_condition,
    warn_of_no_air_flow,
)
from fastcoil.loops.labelled import SeriesLabels
from fastcoil.loops.labels import unit_in_words

_LOG_COLUMNS = ColumnSpec(
    required=("m_a", "T_a_in", HUMIDITY_COLUMNS, "T_w_in", "T_set"), optional=("noise", "enabled", "backlash_scale")
)
_HELD_SERIES = [name for name, series in BOUNDARY_SERIES.items() if series.hold]


class Boundary(Samples):
    """The series that act on the loop, in 1-s samples, on one day or several; immutable.

    Parameters
    ----------
    m_a, T_a_in, W_a_in, T_w_in, T_set
        Air flow [kg/s], temperature [degC] and humidity ratio [kg/kg dry air] of the entering air,
        temperature of the entering water [degC], set-point [degC].  `simulate` warns of
        air of more than 105 % relative humidity at the pressure of its loop.
    noise
        Recorded noise, added to the measured temperature every second [K]; none if left out.
    enabled
        1 where the loop is in operation, 0 where not.  If left out, it is 1 where air flows, and a warning states how
        long none does.
    backlash_scale
        What the backlash of every loop is multiplied by, such as 2 from the second at which a linkage comes loose; 1
        throughout if left out.
    day
        Labels of the days: distinct whole numbers from 0 to 2**32 - 1; 0, 1, 2, ... if left out.  They, not
        the order, seed the noise of a day.  One number labels a boundary without a dim ``day``.
    start
        Date and time of the first sample of each day, to the second; one is that of the first of consecutive days of
        24 h.  On the clock of ``time_zone``; a UTC offset that it has is taken as the zone.
    time_zone
        A name such as ``America/Los_Angeles``, or an offset such as ``UTC-08:00``; unknown if left out.

    Each series is a number, a 1-D array of 1-s samples, a 2-D array (day, second) or a DataArray with dims
    ``elapsed_time`` and/or ``day``; at least one must have samples, and all the same number.  A
    DataArray that declares ``units`` is converted from them.  All mistakes are raised together, in one
    `InputError`.
    """

    def __init__(
        self,
        *,
        m_a: Values,
        T_a_in: Values,
        W_a_in: Values,
        T_w_in: Values,
        T_set: Values,
        noise: Values = None,
        enabled: Values = None,
        backlash_scale: Values = None,
        day: Values = None,
        start: Values = None,
        time_zone: Values = None,
    ) -> None:
        series = {name: value for name, value in locals().items() if name in BOUNDARY_SERIES}
        problems: list[str] = []
        entries, common_labels = read_series(series, problems, day=day)
        labels, n_steps = np.asarray(common_labels.day), common_labels.n_steps
        if n_steps is None and not problems:
            problems.append("every series is a number: give at least one as 1-s samples, or use constant_day")
        clock = Clock()
        with collect_problems(problems):
            clock = make_clock(start, time_zone, labels, n_steps or 0, common_labels)
        raise_problems(list(dict.fromkeys(problems)))  # series that share a coordinate share its mistakes
        arrays, n_stopped = complete_series(entries, labels.size, n_steps or 0, enabled_follows_air=enabled is None)
        warn_of_no_air_flow(n_stopped)
        ds = boundary_dataset(arrays, labels, n_steps or 0, clock)
        self.__setstate__({"_ds": ds, "_make": None, "_time_zone": clock.time_zone, "_by_air": enabled is None})

    def __repr__(self) -> str:
        """For a terminal; a stream without known ranges shows how many days it has: making all takes too long."""
        stream_text = ", made day by day" if self.is_streamed else ""
        if self.is_streamed and not self.has_summary:
            return f"<fastcoil.Boundary {self.extent}{stream_text}>"
        lines = []
        for name, (low, high) in self.non_default_extremes.items():
            span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
            span = f"{span} {unit_in_words(BOUNDARY_SERIES[name].unit)}".rstrip()
            lines.append(f"  {name:<14} {span:<24} {BOUNDARY_SERIES[name].long_name}")
        return "\n".join([f"<fastcoil.Boundary {self.extent}{stream_text}, sha256 {self.sha256[:8]}>", *lines])

    def assign(self, **changes: Values) -> Boundary:
        """A copy with other series, labels or clock, each given as to `Boundary`; None takes one back to its default.

        Where ``enabled`` follows from the air flow, it is computed from the new one.
        """
        names = (*BOUNDARY_SERIES, "day", "start", "time_zone")
        unknown = [name for name in changes if name not in names]
        raise_problems([f"{name}{did_you_mean(name, names)}: use {', '.join(names)}" for name in unknown])
        by_air = changes["enabled"] is None if "enabled" in changes else self._by_air
        clock = {name: changes.get(name, getattr(self, name)) for name in ("start", "time_zone")}
        start = None if "start" in changes else self.start
        zone = None if {"start", "time_zone"} & changes.keys() else self.clock_zone
        known_labels = SeriesLabels(self.n_steps, None, self._ds["day"].values, 0.0, start, zone)
        problems: list[str] = []
        series = {name: changes[name] for name in BOUNDARY_SERIES if name in changes}
        entries, common_labels = read_series(series, problems, day=changes.get("day"), known_labels=known_labels)
        raise_problems(problems)
        replacements = {name: None if changes[name] is None else entry for name, entry in entries.items()}
        if by_air and "m_a" in changes:
            replacements["enabled"] = None
        make = partial(replace_series, self.maker, replacements) if replacements else self.maker
        changed = Boundary._stream(make, np.asarray(common_labels.day), self.n_steps, **clock, by_air=by_air)
        if self._make is not None:
            return changed
        if by_air and {"m_a", "enabled"} & changes.keys():
            warn_of_no_air_flow(int(np.count_nonzero(changed.series["enabled"] == 0.0)))
        return Boundary.of(changed.to_dataset(), time_zone=changed.time_zone, by_air=by_air)

    @classmethod
    def _stream(
        cls, make: DayMaker, day: NDArray[Any], n_steps: int, start: Any, time_zone: Any, by_air: bool = False
    ) -> Boundary:
        """Days that are made by position."""
        clock = make_clock(start, time_zone, day, n_steps)
        return cls.of(boundary_dataset({}, day, n_steps, clock), make=make, time_zone=clock.time_zone, by_air=by_air)

    def isel(self, day: Any) -> Boundary:
        """Some days by position: a number, which leaves no dim ``day``, a list, flags or a slice."""
        return self._chosen("isel", day)

    def sel(self, day: Any) -> Boundary:
        """Some days by label: one, which leaves no dim ``day``, a list, or a slice from one to another."""
        return self._chosen("sel", day)

    def _chosen(self, method: str, day: Any) -> Boundary:
        ds = with_day_dim(self._ds).assign_coords(position=("day", np.arange(self.n_days)))
        try:
            ds = getattr(ds, method)(day=day)
        except (KeyError, IndexError, TypeError, ValueError):
            labels_text = short_repr(self.day.tolist()) if self.n_days <= 8 else f"{self.day[0]} to {self.day[-1]}"
            cure = (
                f"give positions from 0 to {self.n_days - 1}" if method == "isel" else f"its labels are {labels_text}"
            )
            raise InputError(f"day = {short_repr(day)}: the boundary has no such day; {cure}") from None
        positions = ds["position"].values
        if not positions.size or np.unique(positions).size < positions.size:
            raise InputError(
                f"day = {short_repr(day)} chooses {'a day twice' if positions.size else 'no day'}: give each day once"
            )
        ds, make = ds.drop_vars("position"), None
        if self._make is not None and positions.ndim:
            make = partial(pick_day, [self._make], np.zeros_like(positions), positions)
        elif self._make is not None:
            ds = ds.assign(series_variables(self.of_day(int(positions))))
        return Boundary.of(ds, make=make, time_zone=self.time_zone, by_air=self._by_air)

    @staticmethod
    def concat(boundaries: Sequence[Boundary]) -> Boundary:
        """Put the days of boundaries together; streams give a stream.

        Days must have one length, distinct labels and one time zone, and a start all or none.
        """
        cure = "give a list of boundaries"
        if not isinstance(boundaries, (list, tuple)) or not boundaries:
            raise InputError(WrongTypeMessage(f"boundaries = {short_repr(boundaries)}: {cure}"))
        for i, boundary in enumerate(boundaries):
            require_instance(f"boundaries[{i}]", boundary, Boundary, cure)
        raise_problems(list(_joining_problems(boundaries)))
        zone, by_air = next(filter(None, (b.time_zone for b in boundaries)), ""), all(b._by_air for b in boundaries)
        is_streamed = any(boundary.is_streamed for boundary in boundaries)
        datasets = [
            boundary._ds.drop_vars(list(boundary._ds.data_vars)) if is_streamed else boundary._ds
            for boundary in boundaries
        ]
        datasets = [with_day_dim(ds) for ds in datasets]
        ds = xr.concat(datasets, "day", data_vars="minimal", coords="minimal", compat="override", join="exact")
        make = None
        if is_streamed:
            days = [(i, k) for i, boundary in enumerate(boundaries) for k in range(boundary.n_days)]
            make = partial(pick_day, [boundary.maker for boundary in boundaries], *np.array(days).T)
        return Boundary.of(ds, make=make, time_zone=zone, by_air=by_air)

    def to_dataset(self) -> xr.Dataset:
        """The series as a Dataset with dims (``day``,) ``elapsed_time``, units, long names, and ``start`` if known."""
        if self._make is None:
            return self._ds.copy(deep=True)
        return boundary_dataset(self.series, self._ds["day"].values, self.n_steps, Clock(self.start, self.time_zone))

    @classmethod
    def from_dataset(cls, ds: xr.Dataset) -> Boundary:
        """Inverse of `to_dataset`; ignores variables of other names.

        Strict: ``elapsed_time`` in steps of 1 s (from any start), and a ``units`` attribute on every series.
        """
        require_instance("ds", ds, xr.Dataset, "give a Dataset, as of to_dataset")
        problems = [
            f"{name} has no units attribute: set ds[{name!r}].attrs['units'] ({series.known_units})"
            for name, series in BOUNDARY_SERIES.items()
            if name in ds and "units" not in ds[name].attrs
        ]
        if "elapsed_time" in ds.dims and "elapsed_time" not in ds.coords:
            problems.append("elapsed_time has no coordinate: give ds['elapsed_time'] the seconds 0, 1, ...")
        raise_problems(problems)
        return cls(**{name: ds.get(name) for name in BOUNDARY_SERIES})

    @classmethod
    def from_days(
        cls,
        make: Callable[[int], Mapping[str, Any]],
        *,
        day: Values,
        hours: float,
        start: Any = None,
        time_zone: str | None = None,
    ) -> Boundary:
        """A stream: days that are made when they are needed, so that a year of seconds never lies in memory.

        Parameters
        ----------
        make
            Gives the series of a day from its label, by name, each a number or 1-D array of 1-s samples, as to
            `Boundary`.  It is called several times for each day and must give the same each time: seed random numbers
            with the label.  To run in several processes it must be a function of a module, or another object that can
            be pickled.
        day
            Labels of the days, as for `Boundary`.
        hours
            Length of each day, a whole number of seconds.
        start, time_zone
            As for `Boundary`.
        """
        with argument_checks() as check:
            if not callable(make):
                cure = "give a function that returns the series of the day of a label"
                check.problems.append(WrongTypeMessage(f"make = {short_repr(make)}: {cure}"))
            n_steps = check(hours_to_seconds, hours)
            labels = np.asarray(label_array(day, check.problems))
        maker = partial(make_labelled_day, make, np.atleast_1d(labels).astype(np.int64))
        days = cls._stream(maker, labels, n_steps, start, time_zone)
        days.of_day(0)
        return days

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        *,
        units: Mapping[str, str] | None = None,
        columns: Mapping[str, str] | None = None,
        constants: Mapping[str, float] | None = None,
        pressure: float = 101325.0,
        start: float = 0.0,
        hours: float | None = None,
        max_gap: float | None = None,
        time_format: str | None = None,
    ) -> Boundary:
        """Read the trend log of a building into 1-s samples.

        The header names each column and its unit: ``m_a [kg/s]``, ``T_a_in [degF]``; a volume flow of air is taken at
        1.2 kg/m3.  Time is ``elapsed_time [s]`` (min, h) or ``timestamp``; humidity is ``W_a_in``, ``RH_a_in`` or
        ``T_dp_in``.  Samples are 1 s apart or more; between them ``T_set`` and ``enabled``
        hold, the others run straight.  The boundary starts at the time of the ``timestamp``; its zone is known where
        they have a UTC offset, or count from 1970.

        Parameters
        ----------
        path
            A CSV file.  What is not self-evident about how it was read, such as the order of day and month, is said in
            a warning.
        units
            Units by series, for headers without one: ``{"T_a_in": "degF"}``.
        columns
            Headers by series, where they differ: ``{"T_a_in": "AHU1 MAT [degF]"}``.  Columns whose names mean nothing
            that is missing are then ignored.
        constants
            Numbers for series that the log lacks, in the units of `Boundary`; relative humidity as a fraction, dew
            point in degC.
        pressure
            Barometric pressure, for relative humidity and dew point [Pa].
        start, hours
            Hours from the first row to the first sample; how many hours to take, up to the last row if left out.
        max_gap
            Longest step to be bridged [s]; three times the median step if left out, and more in a log whose rows were
            written when a value changed; all its values hold until the next.
        time_format
            How ``timestamp`` is written: a pattern such as ``"%d/%m/%Y %H:%M"``, ``"excel"`` for serial days,
            ``"epoch"`` for seconds or milliseconds since 1970.  If left out it is recognised, or refused where two
            readings fit.
        """
        with argument_checks() as check:
            path = check(require_path, "path", path, "give the path of a CSV file")
            pressure = check(require_condition, "pressure", pressure)
            start = check(require_condition, "start", start)
            n_steps = None if hours is None else check(hours_to_seconds, hours)
            reading = check_reading_options(
                check, units=units, columns=columns, constants=constants, max_gap=max_gap, time_format=time_format,
                refuse_gaps=True,
            )  # fmt: skip
        log = read_checked_log(path, _LOG_COLUMNS, reading)
        require_whole_seconds(log.name, log.step)
        warn_of_reading_notes(log.name, log.notes)
        first_second, last_second = start * 3600, float(log.time[-1])
        if n_steps is None:
            require_span_in_limits(log.name, last_second - first_second, "give hours")
            n_steps = int(np.floor(last_second - first_second + 1e-6)) + 1
        if n_steps < 1 or first_second + n_steps - 1 > last_second + 1e-6:
            window_text = f"start = {start:g} h" + ("" if hours is None else f", hours = {hours:g}")
            raise InputError(f"{log.name}: {window_text} needs more than the {last_second:g} s of the log: lower it")
        seconds = np.minimum(first_second + np.arange(n_steps), last_second)
        values = {name: log.values[name] for name in BOUNDARY_SERIES if name in log.values}
        values["W_a_in"] = log.humidity_ratio(pressure)
        begins = None if log.start is None else log.start + np.timedelta64(round(float(seconds[0])), "s")
        series = resample_at_seconds(log.time, values, seconds, list(values) if log.change_of_value else _HELD_SERIES)
        return cls(**series, start=begins, time_zone=log.time_zone)


def _joining_problems(boundaries: Sequence[Boundary]) -> Iterator[str]:
    zones = sorted({boundary.time_zone for boundary in boundaries} - {""})
    if len(zones) > 1:
        yield f"the boundaries are in the time zones {' and '.join(zones)}: put together those of one"
    has_start = [boundary.start is not None for boundary in boundaries]
    if len(set(has_start)) > 1:
        yield (
            f"boundary {has_start.index(True)} has a start and boundary {has_start.index(False)} has none: give it one with "
            "assign(start=…), or assign(start=None) to the others"
        )
    first_length = boundaries[0].n_steps
    for i, boundary in enumerate(boundaries):
        if boundary.n_steps != first_length:
            yield f"boundary {i} lasts {boundary.n_steps:,} s, the first {first_length:,} s: give days of one length"
    labels, counts = np.unique(np.concatenate([boundary.day for boundary in boundaries]), return_counts=True)
    if counts.max() > 1:
        yield f"day label {labels[counts.argmax()]} appears twice: give each day its own label, as assign(day=7)"

"""``Boundary``: the series that act on the loop from outside, second by second."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base import arguments
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.logs import read_checked_log, warn_of_reading_notes
from fastcoil.logs.columns import ColumnSpec, check_reading_options
from fastcoil.logs.pieces import require_span_in_limits, require_whole_seconds, resample_at_seconds
from fastcoil.logs.series import HUMIDITY_COLUMNS
from fastcoil.loops.labelled import SeriesLabels
from fastcoil.loops.labels import unit_in_words

from fastcoil.loops.boundary.samples import (  # isort: skip
    DayMaker, Samples, boundary_dataset, make_labelled_day, pick_day, replace_series, series_variables, with_day_dim,
)  # fmt: skip
from fastcoil.loops.boundary.series import (  # isort: skip
    ADDED_SERIES, BOUNDARY_SERIES, Clock, Values, complete_series, hours_to_seconds, label_array, make_clock,
    read_series, require_condition, warn_of_no_air_flow,
)  # fmt: skip

_OPTIONAL_COLUMNS = ("noise", "enabled", *ADDED_SERIES)
_LOG_COLUMNS = ColumnSpec(required=("m_a", "T_a_in", HUMIDITY_COLUMNS, "T_w_in", "T_set"), optional=_OPTIONAL_COLUMNS)
_HELD_SERIES = [name for name, series in BOUNDARY_SERIES.items() if series.hold]


class Boundary(Samples):
    """Series that act on the loop, in 1-s samples, on one day or several; immutable.

    Each series is a number, a 1-D array of 1-s samples, a 2-D array (day, second) or a DataArray with dims
    ``elapsed_time`` and/or ``day``; at least one must have samples, and all the same number.  A DataArray with the
    attribute ``units`` is converted from them.  Other ways to make one: `from_csv`, `from_dataset`, `from_days`.

    Parameters
    ----------
    m_a, T_a_in, W_a_in, T_w_in, T_set
        Air flow [kg/s], temperature [degC] and humidity ratio [kg/kg dry air] of the entering air, temperature of the
        entering water [degC], set-point [degC].  `simulate` warns of air of more than 105 % relative humidity at the
        pressure of its loop.
    noise
        Recorded noise, added to the measured temperature every second [K]; none if left out.
    enabled
        1 where the loop is in operation, 0 where not.  By default 1 where air flows; a warning says how long none does.
    backlash_scale
        Factor of the backlash of every loop, such as 2 from the second at which a linkage comes loose; 1 by default.
    T_out, Q_room
        Outdoor temperature [degC] and heat gain [kW] of the room that a loop with ``room_capacity`` has; 0 by default.
    dp_ratio
        Pressure difference over valve and coil divided by that of the design; 1 by default.  The water flow goes with
        its root, that of a pressure-independent valve only below 1.
    day
        Labels of the days: distinct whole numbers from 0 to 2**32 - 1, by default 0, 1, 2, ...  They, not the order,
        seed the noise of a day.  One number labels a boundary without a dim ``day``.
    start
        Date and time of the first sample of each day, to the second, on the clock of ``time_zone``; one for all: that
        of the first of consecutive days of 24 h.  A UTC offset in it is taken as the zone.
    time_zone
        A name such as ``America/Los_Angeles``, or an offset such as ``UTC-08:00``; unknown by default.

    Raises
    ------
    InputError
        With one sentence for each value out of bounds, wrong unit, and length or label that does not fit.

    Examples
    --------
    >>> import fastcoil as fc
    >>> day = fc.Boundary(m_a=1.2, T_a_in=25.0, W_a_in=0.01, T_w_in=7.0, T_set=np.full(3600, 14.0))
    >>> day.assign(T_set=15.0, start="2024-07-01T08:00").describe()
    '1 h from 2024-07-01 08:00:00: m_a 1.2 kg s-1, T_a_in 25 degC, W_a_in 0.01, T_w_in 7 degC, T_set 15 degC'
    """

    def __init__(
        self, *, m_a: Values, T_a_in: Values, W_a_in: Values, T_w_in: Values, T_set: Values, noise: Values = None,
        enabled: Values = None, backlash_scale: Values = None, T_out: Values = None, Q_room: Values = None,
        dp_ratio: Values = None, day: Values = None, start: Values = None, time_zone: Values = None,
    ) -> None:  # fmt: skip
        series = {name: value for name, value in locals().items() if name in BOUNDARY_SERIES}
        problems: list[str] = []
        entries, common_labels = read_series(series, problems, day=day)
        labels, n_steps = np.asarray(common_labels.day), common_labels.n_steps
        if n_steps is None and not problems:
            sentence = "every series is a number: give at least one as 1-s samples, or use constant_day"
            problems.append(Problem(sentence, "m_a", "shape"))
        clock = Clock()
        with arguments.collect_problems(problems):
            clock = make_clock(start, time_zone, labels, n_steps or 0, common_labels)
        arguments.raise_problems(list(dict.fromkeys(problems)))  # series that share a coordinate share its mistakes
        arrays, n_stopped = complete_series(entries, labels.size, n_steps or 0, enabled_by_air=enabled is None)
        warn_of_no_air_flow(n_stopped)
        ds = boundary_dataset(arrays, labels, n_steps or 0, clock)
        state = {"_ds": ds, "_maker": None, "_time_zone": clock.time_zone, "_enabled_by_air": enabled is None}
        self.__setstate__(state)

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"

    def __repr__(self) -> str:
        """Show series and ranges; of a stream without known ranges only the extent: making all days takes too long."""
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
        """Return a copy with other series, labels or clock, each as for `Boundary`; None restores a default.

        Where ``enabled`` follows from the air flow, it is computed from the new one.
        """
        names = (*BOUNDARY_SERIES, "day", "start", "time_zone")
        extra = [name for name in changes if name not in names]
        sentences = (f"{name}{did_you_mean(name, names)}: use {', '.join(names)}" for name in extra)
        arguments.raise_problems([Problem(s, name, "name") for s, name in zip(sentences, extra, strict=True)])
        enabled_by_air = changes["enabled"] is None if "enabled" in changes else self._enabled_by_air
        clock = {name: changes.get(name, getattr(self, name)) for name in ("start", "time_zone")}
        start = None if "start" in changes else self.start
        zone = None if {"start", "time_zone"} & changes.keys() else self.clock_zone
        known_labels = SeriesLabels(self.n_steps, None, self._ds["day"].values, 0.0, start, zone)
        problems: list[str] = []
        series = {name: changes[name] for name in BOUNDARY_SERIES if name in changes}
        entries, common_labels = read_series(series, problems, day=changes.get("day"), known_labels=known_labels)
        arguments.raise_problems(problems)
        replacements = {name: None if changes[name] is None else entry for name, entry in entries.items()}
        if enabled_by_air and "m_a" in changes:
            replacements["enabled"] = None
        make = partial(replace_series, self.maker, replacements) if replacements else self.maker
        day = np.asarray(common_labels.day)
        changed = Boundary._stream(make, day, self.n_steps, **clock, enabled_by_air=enabled_by_air)
        if self._maker is not None:
            return changed
        if enabled_by_air and {"m_a", "enabled"} & changes.keys():
            warn_of_no_air_flow(int(np.count_nonzero(changed.series["enabled"] == 0.0)))
        return Boundary.from_samples(changed.to_dataset(), time_zone=changed.time_zone, enabled_by_air=enabled_by_air)

    @classmethod
    def _stream(
        cls, make: DayMaker, day: NDArray[Any], n_steps: int, start: Any, time_zone: Any, enabled_by_air: bool = False
    ) -> Boundary:
        """Return a stream of days that are made by position."""
        clock = make_clock(start, time_zone, day, n_steps)
        ds = boundary_dataset({}, day, n_steps, clock)
        return cls.from_samples(ds, make=make, time_zone=clock.time_zone, enabled_by_air=enabled_by_air)

    def isel(self, day: Any) -> Boundary:
        """Select days by position: a number, which drops the dim ``day``, a list, flags or a slice."""
        return self._select_days("isel", day)

    def sel(self, day: Any) -> Boundary:
        """Select days by label: one, which drops the dim ``day``, a list, or a slice of labels."""
        return self._select_days("sel", day)

    def _select_days(self, method: str, day: Any) -> Boundary:
        arguments.require_no_unit("day", day, "give days")
        ds = with_day_dim(self._ds).assign_coords(position=("day", np.arange(self.n_days)))
        try:
            ds = getattr(ds, method)(day=day)
        except (KeyError, IndexError, TypeError, ValueError):
            cure = f"give positions from 0 to {self.n_days - 1}"
            if method == "sel":
                labels = short_repr(self.day.tolist()) if self.n_days <= 8 else f"{self.day[0]} to {self.day[-1]}"
                cure = f"its labels are {labels}"
            sentence = f"day = {short_repr(day)}: the boundary has no such day; {cure}"
            raise InputError(sentence, "day", "name" if method == "sel" else "value") from None
        positions = ds["position"].values
        if not positions.size or np.unique(positions).size < positions.size:
            number, code = ("a day twice", "duplicate") if positions.size else ("no day", "missing")
            raise InputError(f"day = {short_repr(day)} chooses {number}: give each day once", "day", code)
        ds, make = ds.drop_vars("position"), None
        if self._maker is not None and positions.ndim:
            make = partial(pick_day, [self._maker], np.zeros_like(positions), positions)
        elif self._maker is not None:
            ds = ds.assign(series_variables(self.of_day(int(positions))))
        return Boundary.from_samples(ds, make=make, time_zone=self.time_zone, enabled_by_air=self._enabled_by_air)

    @staticmethod
    def concat(boundaries: Sequence[Boundary]) -> Boundary:
        """Join the days of boundaries; streams give a stream.

        Days must have one length, distinct labels and one time zone, and all of them a start or none.
        """
        cure = "give a list of boundaries"
        if not isinstance(boundaries, (list, tuple)) or not boundaries:
            raise InputError(f"boundaries = {short_repr(boundaries)}: {cure}", "boundaries", "type")
        for i, boundary in enumerate(boundaries):
            arguments.require_instance(f"boundaries[{i}]", boundary, Boundary, cure)
        arguments.raise_problems(list(_joining_problems(boundaries)))
        zone = next(filter(None, (b.time_zone for b in boundaries)), "")
        is_streamed = any(b.is_streamed for b in boundaries)
        datasets = [with_day_dim(b._ds.drop_vars(list(b._ds.data_vars)) if is_streamed else b._ds) for b in boundaries]
        ds = xr.concat(datasets, "day", data_vars="minimal", coords="minimal", compat="override", join="exact")
        make = None
        if is_streamed:
            days = [(i, k) for i, b in enumerate(boundaries) for k in range(b.n_days)]
            make = partial(pick_day, [b.maker for b in boundaries], *np.array(days).T)
        enabled_by_air = all(b._enabled_by_air for b in boundaries)
        return Boundary.from_samples(ds, make=make, time_zone=zone, enabled_by_air=enabled_by_air)

    def to_dataset(self) -> xr.Dataset:
        """Return the series as a Dataset over (``day``,) ``elapsed_time``, with units, long names, and ``start``."""
        if self._maker is None:
            return self._ds.copy(deep=True)
        return boundary_dataset(self.series, self._ds["day"].values, self.n_steps, Clock(self.start, self.time_zone))

    @classmethod
    def from_dataset(cls, ds: xr.Dataset) -> Boundary:
        """Return the boundary of a Dataset, the inverse of `to_dataset`; variables of other names are ignored.

        Raises
        ------
        InputError
            Unless ``elapsed_time`` has steps of 1 s (from any start) and every series an attribute ``units``.
        """
        arguments.require_instance("ds", ds, xr.Dataset, "give a Dataset, as of to_dataset")
        problems = [
            Problem(f"{n} has no units attribute: set ds[{n!r}].attrs['units'] ({series.known_units})", n, "unit")
            for n, series in BOUNDARY_SERIES.items()
            if n in ds and arguments.carried_unit(n, ds[n]) is None
        ]
        if "elapsed_time" in ds.dims and "elapsed_time" not in ds.coords:
            sentence = "elapsed_time has no coordinate: give ds['elapsed_time'] the seconds 0, 1, ..."
            problems.append(Problem(sentence, "elapsed_time", "missing"))
        arguments.raise_problems(problems)
        return cls(**{name: ds.get(name) for name in BOUNDARY_SERIES})

    @classmethod
    def from_days(
        cls, make: Callable[[int], Mapping[str, Any]], *, day: Values, hours: float, start: Any = None,
        time_zone: str | None = None,
    ) -> Boundary:  # fmt: skip
        """Return a stream: days are made when they are needed, so that a year of seconds is never in memory.

        Parameters
        ----------
        make
            Function that returns the series of a day from its label, by name, each a number or 1-D array of 1-s
            samples, as for `Boundary`.  It is called several times for each day and must return the same each time:
            seed random numbers with the label.  To run in several processes it must be picklable, such as a function of
            a module.
        day
            Labels of the days, as for `Boundary`.
        hours
            Length of each day [h], a whole number of seconds.
        start, time_zone
            As for `Boundary`.
        """
        with arguments.argument_checks() as check:
            if not callable(make):
                cure = "give a function that returns the series of the day of a label"
                check.problems.append(Problem(f"make = {short_repr(make)}: {cure}", "make", "type"))
            n_steps = check(hours_to_seconds, hours)
            labels = np.asarray(label_array(day, check.problems))
        maker = partial(make_labelled_day, make, np.atleast_1d(labels).astype(np.int64))
        days = cls._stream(maker, labels, n_steps, start, time_zone)
        days.of_day(0)
        return days

    @classmethod
    def from_csv(
        cls, path: str | Path, *, units: Mapping[str, str] | None = None, columns: Mapping[str, str] | None = None,
        constants: Mapping[str, float] | None = None, pressure: float = 101325.0, start: float = 0.0,
        hours: float | None = None, max_gap: float | None = None, time_format: str | None = None,
    ) -> Boundary:  # fmt: skip
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
        with arguments.argument_checks() as check:
            path = check(arguments.require_path, "path", path, "give the path of a CSV file")
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
            sentence = f"{log.name}: {window_text} needs more than the {last_second:g} s of the log: lower it"
            raise InputError(sentence, "start" if hours is None else "hours", "value")
        seconds = np.minimum(first_second + np.arange(n_steps), last_second)
        values = {name: log.values[name] for name in BOUNDARY_SERIES if name in log.values}
        values["W_a_in"] = log.humidity_ratio(pressure)
        begins = None if log.start is None else log.start + np.timedelta64(round(float(seconds[0])), "s")
        series = resample_at_seconds(log.time, values, seconds, list(values) if log.change_of_value else _HELD_SERIES)
        return cls(**series, start=begins, time_zone=log.time_zone)


def _joining_problems(boundaries: Sequence[Boundary]) -> Iterator[Problem]:
    zones = sorted({b.time_zone for b in boundaries} - {""})
    if len(zones) > 1:
        text = f"the boundaries are in the time zones {' and '.join(zones)}: put together those of one"
        yield Problem(text, "boundaries", "time")
    has_start = [b.start is not None for b in boundaries]
    if len(set(has_start)) > 1:
        text = f"boundary {has_start.index(True)} has a start and boundary {has_start.index(False)} has none"
        cure = "give it one with assign(start=…), or assign(start=None) to the others"
        yield Problem(f"{text}: {cure}", "boundaries", "time")
    first_length = boundaries[0].n_steps
    for i, b in enumerate(boundaries):
        if b.n_steps != first_length:
            text = f"boundary {i} lasts {b.n_steps:,} s, the first {first_length:,} s: give days of one length"
            yield Problem(text, "boundaries", "shape")
    labels, counts = np.unique(np.concatenate([b.day for b in boundaries]), return_counts=True)
    if counts.max() > 1:
        text = f"day label {labels[counts.argmax()]} appears twice: give each day its own label, as assign(day=7)"
        yield Problem(text, "boundaries", "duplicate")

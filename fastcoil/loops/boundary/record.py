"""The series that act on the loop from outside, second by second: entering air and water, set-point, noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arguments import checking, choice_of, instance_of, whole_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, WrongType, collecting, shown
from fastcoil.loops.boundary.clock import Clock, Times, clock_of
from fastcoil.loops.boundary.conversion import arguments_of, dataset_of
from fastcoil.loops.boundary.display import draw, extent, html_of, text_of
from fastcoil.loops.boundary.rearranged import (
    DIMS,
    Parts,
    joined,
    joining_problems,
    picked,
    positions,
    positions_of,
    replaced,
    rows_of,
    stream_of,
)
from fastcoil.loops.boundary.series import (
    BOUNDARY_SERIES,
    Given,
    Values,
    carried_labels,
    common_size,
    enabled_by,
    label_array,
    read,
    require_aligned,
    value_problems,
    warn_of_stops,
)
from fastcoil.loops.boundary.source import Held, Source, Stream

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure


def checked(series: Mapping[str, Values], day: Values, start: Values, time_zone: Values) -> Parts:
    """Samples and clock of a boundary; arguments as of `fastcoil.Boundary`, all series by name, None if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    problems: list[str] = []
    given: dict[str, Given] = {}
    for name, one in BOUNDARY_SERIES.items():
        with collecting(problems):
            given[name] = read(one, series[name])
    n_steps = common_size("elapsed_time", "samples", given, problems)
    n_days = common_size("day", "days", given, problems)
    if n_steps is None and not problems:
        problems.append("every series is a number: give at least one as 1-s samples, or use constant_day")
    labels = carried_labels(given, problems) if day is None else label_array(day, problems)
    if labels is None:
        labels = np.arange(n_days) if n_days else np.asarray(0)
    elif n_days is not None and labels.size != n_days:
        problems.append(f"day has {labels.size} labels for {n_days} days: give one label for each day")
    for name, values in given.items():
        problems += value_problems(BOUNDARY_SERIES[name], values, labels)
    shape, clock = (labels.size, n_steps or 0), Clock()
    with collecting(problems):
        clock = clock_of(start, time_zone, *shape)
    if problems:
        # Series that share a coordinate share its mistakes.
        raise InputError(list(dict.fromkeys(problems)))
    whole = {name: values.spread(*shape) for name, values in given.items()}
    by_air = series["enabled"] is None
    if by_air:
        whole["enabled"], stopped = enabled_by(whole["m_a"])
        warn_of_stops(stopped, stacklevel=4)
    return Parts(Held(whole, np.atleast_1d(labels).astype(np.int64), bool(n_days or labels.ndim)), clock, by_air)


class Samples:
    """The series, the labels and the clock of days; immutable."""

    _source: Source
    _clock: Clock
    _by_air: bool

    @classmethod
    def of(cls, source: Source, clock: Clock, by_air: bool = False) -> Self:
        """A boundary of checked samples; ``by_air``: whether the air flow alone decides on ``enabled``."""
        self = cls.__new__(cls)
        self._source, self._clock, self._by_air = source, clock, by_air
        return self

    @property
    def source(self) -> Source:
        """Where the samples come from."""
        return self._source

    @property
    def series(self) -> dict[str, Array]:
        """All series by name, each float64 (n_days, n_steps), read-only; all days of a stream are made for it."""
        return self._source.series

    def of_day(self, k: int) -> dict[str, Array]:
        """The series of one day by position, each float64 (n_steps,), read-only."""
        return self._source.of_day(whole_of("k", k, 0, self.n_days - 1))

    @property
    def extremes(self) -> dict[str, tuple[float, float]]:
        """Least and largest value of each series; a stream makes all its days for it, once."""
        return self._source.extremes

    @property
    def is_streamed(self) -> bool:
        """Whether days are made when they are needed, and not held in memory."""
        return self._source.is_streamed

    @property
    def day(self) -> NDArray[np.int64]:
        """Labels of the days, (n_days,), read-only."""
        return self._source.day

    @property
    def has_day_dim(self) -> bool:
        """Whether results have a dim ``day``."""
        return self._source.has_day_dim

    @property
    def start(self) -> Times | None:
        """Date and time of the first sample of each day, (n_days,) datetime64[s]; None if unknown."""
        return None if self._clock.start is None else self._clock.start.copy()

    @property
    def time_zone(self) -> str:
        """The time zone of ``start``; blank if unknown."""
        return self._clock.time_zone

    @property
    def clock(self) -> Clock:
        """``start`` and ``time_zone``."""
        return self._clock

    @property
    def n_days(self) -> int:
        return self.day.size

    @property
    def n_steps(self) -> int:
        """Number of 1-s steps."""
        return self._source.n_steps

    @property
    def hours(self) -> float:
        return self.n_steps / 3600

    @property
    def sha256(self) -> str:
        """Digest of the day labels and of every name and sample; the clock does not count."""
        return self._source.sha256

    @property
    def day_sha256(self) -> list[str]:
        """Digest of each day's label and samples."""
        return self._source.day_sha256

    def describe(self) -> str:
        """One line: the length, the days, and the range of every series that is not at its default."""
        found = []
        for name, (low, high) in self.extremes.items():
            unit = BOUNDARY_SERIES[name].unit
            if not low == high == BOUNDARY_SERIES[name].default:
                span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
                found.append(f"{name} {span}{'' if unit == '1' else ' ' + unit}")
        return f"{extent(self._source, self._clock)}: {', '.join(found)}"

    def __repr__(self) -> str:
        return text_of(self._source, self._clock)

    def _repr_html_(self) -> str:
        return html_of(self._source, self._clock)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Samples):
            return NotImplemented
        return self is other or (np.array_equal(self.day, other.day) and self.sha256 == other.sha256)

    def __hash__(self) -> int:
        return hash(self.sha256)

    @property
    def parts(self) -> Parts:
        """Samples, clock, and whether the air flow alone decides on ``enabled``."""
        return Parts(self._source, self._clock, self._by_air)


KEPT: Values = object()
"""A series that is not to be changed."""


class Boundary(Samples):
    """The series that act on the loop, in 1-s samples, on one day or several; immutable.

    Parameters
    ----------
    m_a, T_a_in, W_a_in, T_w_in, T_set
        Air flow [kg/s], temperature [degC] and humidity ratio [kg/kg dry air] of the entering air,
        temperature of the entering water [degC], set-point [degC].  ``W_a_in`` above saturation at ``T_a_in``
        is legal (mist): sensors report it, and the coil model takes any humidity ratio.
    noise
        Recorded noise, added to the measured temperature every second [K]; none if left out.
    enabled
        1 where the loop is in operation, 0 where not.  If left out, it is 1 where air flows, and a warning tells how
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
        series = {
            "m_a": m_a,
            "T_a_in": T_a_in,
            "W_a_in": W_a_in,
            "T_w_in": T_w_in,
            "T_set": T_set,
            "noise": noise,
            "enabled": enabled,
            "backlash_scale": backlash_scale,
        }
        self._source, self._clock, self._by_air = checked(series, day, start, time_zone)

    def assign(
        self,
        *,
        m_a: Values = KEPT,
        T_a_in: Values = KEPT,
        W_a_in: Values = KEPT,
        T_w_in: Values = KEPT,
        T_set: Values = KEPT,
        noise: Values = KEPT,
        enabled: Values = KEPT,
        backlash_scale: Values = KEPT,
        day: Values = KEPT,
        start: Values = KEPT,
        time_zone: Values = KEPT,
    ) -> Boundary:
        """A copy with other series, labels or clock, each given as to `Boundary`; None takes one back to its default.

        Where ``enabled`` follows from the air flow, it follows from a new one, too.
        """
        changes = {name: value for name, value in locals().items() if name != "self" and value is not KEPT}
        if "day" not in changes:
            require_aligned(changes, self.day)
        by_air = self._by_air if "enabled" not in changes else changes["enabled"] is None
        if isinstance(self._source, Stream):
            return Boundary.of(*replaced(self._source, self._clock, changes), by_air=by_air)
        kept: dict[str, Any] = rows_of(self._source)
        if self._by_air and "m_a" in changes:
            del kept["enabled"]
        kept |= {"day": self.day if self.has_day_dim else self.day[0], **self._clock._asdict()}
        changed = Boundary(**kept | changes)
        changed._by_air = by_air
        return changed

    def isel(self, day: Any) -> Boundary:
        """Some days by position: a number, which leaves no dim ``day``, a list, flags or a slice."""
        return Boundary.of(*picked(self.parts, positions(day, self.n_days)))

    def sel(self, day: Any) -> Boundary:
        """Some days by label: one, which leaves no dim ``day``, a list, or a slice from one to another."""
        return Boundary.of(*picked(self.parts, positions_of(day, self.day)))

    @staticmethod
    def concat(boundaries: Sequence[Boundary], dim: str = "day") -> Boundary:
        """Put boundaries together: their days, or with ``dim="elapsed_time"`` one after the other in time.

        Of streams it is a stream.  Days must be of one length, and each of its own label.  Hours must be of the same
        days, and where starts are known, each boundary must start when the one before ends.

        Raises
        ------
        InputError
            With one sentence for each thing that does not fit.
        """
        cure = "give a list of boundaries"
        if not isinstance(boundaries, (list, tuple)) or not boundaries:
            raise InputError(WrongType(f"boundaries = {shown(boundaries)}: {cure}"))
        with checking() as check:
            for i, one in enumerate(boundaries):
                check(instance_of, f"boundaries[{i}]", one, Boundary, cure)
        parts = [one.parts for one in boundaries]
        dim = choice_of("dim", dim, DIMS)
        if problems := joining_problems(parts, dim):
            raise InputError(problems)
        return Boundary.of(*joined(parts, dim))

    def plot(self) -> Figure:
        """The series over time, as a matplotlib ``Figure``; days that do not follow each other on top of each other."""
        return draw(self._source, self._clock)

    def to_dataset(self) -> xr.Dataset:
        """The series as a Dataset with dims (``day``,) ``elapsed_time``, units, long names, and ``start`` if known."""
        return dataset_of(self._source, self._clock)

    @classmethod
    def from_dataset(cls, ds: xr.Dataset) -> Boundary:
        """Inverse of `to_dataset`; ignores variables of other names.

        Strict: ``elapsed_time`` in steps of 1 s (from any start), and a ``units`` attribute on every series.
        """
        return cls(**arguments_of(ds))

    @classmethod
    def from_days(
        cls,
        make: Callable[[int], Mapping[str, Any]],
        *,
        day: Values,
        n_steps: int | None = None,
        hours: float | None = None,
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
        n_steps, hours
            Length of each day, in seconds or in hours; give one of them.
        start, time_zone
            As for `Boundary`.
        """
        return cls.of(*stream_of(make, day, n_steps, hours, start, time_zone))

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
            Headers by series, where they differ: ``{"T_a_in": "AHU1 MAT [degF]"}``.  Columns of other names are then
            ignored.
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

        Raises
        ------
        InputError
            With one sentence for each mistake in the file or the arguments: column, row, cure.
        """
        from fastcoil.loops.boundary.conversion import trend_log_series

        return cls(
            **trend_log_series(
                path,
                units=units,
                columns=columns,
                constants=constants,
                pressure=pressure,
                start=start,
                hours=hours,
                max_gap=max_gap,
                time_format=time_format,
            )
        )

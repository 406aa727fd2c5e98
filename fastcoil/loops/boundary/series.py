"""Input of a boundary and its checks: series, the clock of the days, numbers that describe a day.

All labels must agree.  A loop without air flow is off: these seconds count in no metric, and a warning says so.
"""

import warnings
from collections.abc import Collection, Iterable, Mapping
from datetime import UTC, date, datetime, timedelta
from itertools import islice
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from fastcoil.base import arguments
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.logs.series import COLUMNS, Series, count_suffix
from fastcoil.logs.timestamps import format_utc_offset, require_time_zone, time_zone_from_name
from fastcoil.model.moist_air import MASS_RATIO, liquid_saturation_pressure
from fastcoil.model.parameter_table import COVERED, PARAMETERS, Parameter

from fastcoil.loops.labelled import (  # isort: skip
    SeriesLabels, accepted_units, as_data_array, convert_units, label_mismatches, read_series_labels, to_bare_numbers,
)  # fmt: skip

Values: TypeAlias = Any
"""A series in an argument: a number, array-like or DataArray; checked at run time."""

ADDED_SERIES = (
    "backlash_scale",
    "T_out",
    "Q_room",
    "dp_ratio",
)  # count in a digest only where they differ from their default
_NAMES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set", "noise", "enabled", *ADDED_SERIES)
BOUNDARY_SERIES = {name: COLUMNS[name] for name in _NAMES}
"""Every series of a `Boundary` by name."""
LARGEST_DAY_LABEL = 2**32 - 1  # a label is one 32-bit word of the key of the noise


class LabelledSeries(NamedTuple):
    """One series as read: dims (of ``day``, ``elapsed_time``), values in the unit of the table, and labels."""

    dims: tuple[str, ...]
    values: Array
    labels: SeriesLabels

    def broadcast(self, n_days: int, n_steps: int) -> Array:
        shape = (n_days if "day" in self.dims else 1, n_steps if "elapsed_time" in self.dims else 1)
        # Adding 0.0 makes -0.0 a 0.0: equal series have equal bytes, hence equal digests.
        return np.broadcast_to(self.values.reshape(shape), (n_days, n_steps)) + 0.0

    def of_day(self, k: int) -> Array:
        return self.values[k] if "day" in self.dims else self.values


_NO_LABELS = SeriesLabels()


def read_series(
    values: Mapping[str, Values], problems: list[str], *, day: Values = None, known_labels: SeriesLabels = _NO_LABELS
) -> tuple[dict[str, LabelledSeries], SeriesLabels]:
    """Convert series to the units of the tables; return them and the labels and sizes common to all of them.

    Mistakes are added to ``problems``.  Labels of the series must agree with each other and with ``known_labels``;
    ``day`` replaces the labels of days.
    """
    series: dict[str, LabelledSeries] = {}
    for name, value in values.items():
        with arguments.collect_problems(problems):
            series[name] = _read_one(COLUMNS[name], value)
    for name, entry in series.items():
        if known_labels.time_zone and entry.labels.time_zone == "":  # is on the clock of the boundary
            series[name] = entry._replace(labels=entry.labels._replace(time_zone=None))
    if known_labels.day is not None:
        known_labels = known_labels._replace(n_days=known_labels.day.size)
    common = SeriesLabels()
    for field, text, cure, code in _LABEL_SENTENCES:
        known = getattr(known_labels, field)
        labels = ({} if known is None else {"the boundary": known}) | _labels_by_series(series, field)
        problems += label_mismatches(text, labels, cure, code)
        common = common._replace(**{field: next(iter(labels.values()), None)})
    day_labels = common.day if day is None else day
    if day_labels is not None:
        day_labels = label_array(day_labels, problems)
    if day is not None and day_labels is not None and known_labels.day is None:
        labels = {"day": day_labels} | _labels_by_series(series, "day")
        problems += label_mismatches("day {}", labels, "leave day out, or give bare arrays", "shape")
    if day_labels is None:
        day_labels = np.arange(common.n_days) if common.n_days else np.asarray(0)
    elif common.n_days is not None and day_labels.size != common.n_days:
        sentence = f"day has {day_labels.size} labels for {common.n_days} days: give one label for each day"
        problems.append(Problem(sentence, "day", "shape"))
    elif any("day" in entry.dims for entry in series.values()):
        day_labels = np.atleast_1d(day_labels)
    for name, entry in series.items():
        problems += _value_problems(COLUMNS[name], entry, day_labels)
    return series, common._replace(day=day_labels)


_LABEL_SENTENCES = (
    ("n_steps", "{} samples", "give every series the same number", "shape"),
    ("n_days", "{} days", "give every series the same number", "shape"),
    ("day", "day {}", "align them, or give bare arrays", "shape"),
    ("second", "its first sample at elapsed_time {} s", "align them, or drop_vars('elapsed_time')", "time"),
    ("start", "its first sample at {}", "align them, or give bare arrays", "time"),
    ("time_zone", "the time zone {}", "align them, or convert to one zone", "time"),
)
"""Labels of a ``SeriesLabels``: words for them, the cure and the code where they differ."""


def _labels_by_series(series: Mapping[str, LabelledSeries], field: str) -> dict[str, Any]:
    """Return one label of the series that have it, those with several days first."""
    labels = {name: label for name, entry in series.items() if (label := getattr(entry.labels, field)) is not None}
    return dict(sorted(labels.items(), key=lambda item: np.ndim(item[1]) == 0))


def complete_series(
    series: Mapping[str, LabelledSeries], n_days: int, n_steps: int, *, enabled_by_air: bool
) -> tuple[dict[str, Array], int]:
    """Return all series, (n_days, n_steps), and the number of samples that are off because no air flows."""
    arrays = {name: values.broadcast(n_days, n_steps) for name, values in series.items()}
    _require_air_below_saturation(arrays["T_a_in"], arrays["W_a_in"])
    if not enabled_by_air:
        return arrays, 0
    arrays["enabled"] = (arrays["m_a"] > 0.0).astype(np.float64)
    return arrays, int(np.count_nonzero(arrays["enabled"] == 0.0))


_MAX_RELATIVE_HUMIDITY = 1.05  # up to there air may be mist, or readings may be rounded


def _require_air_below_saturation(T: Array, W: Array) -> None:
    """Refuse air [degC, kg/kg] that is above saturation even at the least pressure that a loop may have."""
    vapour_pressure = PARAMETERS["pressure"].lower * W / (MASS_RATIO + W)
    if vapour_pressure.max() <= _MAX_RELATIVE_HUMIDITY * liquid_saturation_pressure(T.min()):  # no need to look closer
        return
    is_above = vapour_pressure > _MAX_RELATIVE_HUMIDITY * liquid_saturation_pressure(T)
    if is_above.any():
        day, second = np.unravel_index(int(np.argmax(is_above)), is_above.shape)
        place = f"W_a_in = {W[day, second]:.4g} kg/kg at T_a_in = {T[day, second]:.4g} degC at second {second}"
        cure = f"check the units of both, or give the values that belong together{count_suffix(int(is_above.sum()))}"
        raise InputError(f"{place} is above saturation at any pressure: {cure}", "W_a_in", "data")


def warn_of_no_air_flow(seconds: int) -> None:
    """Warn of the seconds that count in no metric because no air flows."""
    if seconds:
        sentence = f"m_a is 0 during {seconds / 3600:,.4g} h and enabled is left out"
        effect = "the loop is off there, and these hours count in no metric; give enabled to have it otherwise"
        warnings.warn(f"{sentence}: {effect}", stacklevel=3)


def label_array(day: Values, problems: list[str]) -> NDArray[Any] | None:
    """Convert day labels to an array; None, and a problem, if they are not distinct whole numbers."""
    cure = f"give whole numbers from 0 to {LARGEST_DAY_LABEL}, one a day"
    with arguments.collect_problems(problems):
        labels = arguments.require_array("day", day, cure)
        wide = labels.astype(np.float64)
        if labels.ndim > 1 or not labels.size or np.any((wide % 1 != 0) | (wide < 0) | (wide > LARGEST_DAY_LABEL)):
            raise InputError(f"day = {short_repr(day)}: {cure}", "day", "value")
        values, counts = np.unique(labels, return_counts=True)
        if counts.max() > 1:
            sentence = f"day label {values[counts.argmax()]} appears twice: give each day its own label"
            raise InputError(sentence, "day", "duplicate")
        return labels
    return None


def _read_one(series: Series, value: Values) -> LabelledSeries:
    if value is None:
        if series.default is None:
            sentence = f"{series.name} is missing: give the {series.long_name} ({series.known_units})"
            raise InputError(sentence, series.name, "missing")
        value = series.default
    array = as_data_array(series.name, value, "elapsed_time")
    if array is not None:
        labels = read_series_labels(series.name, array)
        dims = tuple(dim for dim in ("day", "elapsed_time") if dim in array.dims)
        _float_array(series, array.values)
        values = _float_array(series, convert_units(series.name, array.transpose(*dims), series.units))
        return LabelledSeries(dims, values, labels)
    values = _float_array(series, value)
    if values.ndim > 2:
        sentence = f"{series.name} has {values.ndim} dimensions: give (seconds) or (days, seconds)"
        raise InputError(sentence, series.name, "shape")
    sizes = dict(zip(("n_days", "n_steps")[2 - values.ndim :], values.shape, strict=True))
    return LabelledSeries(("day", "elapsed_time")[2 - values.ndim :], values, SeriesLabels(**sizes))


def _float_array(series: Series, value: Values) -> Array:
    values = arguments.require_array(series.name, value, "give numbers", "iufb" if series.whole else "iuf")
    if values.size == 0:
        raise InputError(f"{series.name} is empty: give at least one 1-s sample", series.name, "shape")
    with np.errstate(over="ignore"):  # a number that overflows is refused as infinite
        return values.astype(np.float64)


def _value_problems(series: Series, entry: LabelledSeries, labels: NDArray[Any]) -> list[Problem]:
    is_bad = series.is_bad(entry.values)
    if not is_bad.any():
        return []
    position = np.unravel_index(int(np.argmax(is_bad)), is_bad.shape)
    index_by_dim = dict(zip(entry.dims, position, strict=True))
    text = f" at second {index_by_dim['elapsed_time']}" if "elapsed_time" in index_by_dim else ""
    if "day" in index_by_dim:
        i = index_by_dim["day"]
        text += f" of day {labels[i] if labels.ndim and i < labels.size else i}"
    sentence = series.describe_bad_value(float(entry.values[position]), text, int(is_bad.sum()))
    return [Problem(sentence, series.name, "value")]


Times: TypeAlias = NDArray[np.datetime64]

DATETIME_SECONDS = np.dtype("datetime64[s]")
YEAR_RANGE = (1700, 2200)  # every file of results can hold the dates between
_CURE = "give a date and time such as '2024-07-01T08:00', one for each day or one for the first"


class Clock(NamedTuple):
    """Starts of the days, (n_days,), on the clock of a time zone; None and blank if unknown."""

    start: Times | None = None
    time_zone: str = ""


def make_clock(
    start: Any, time_zone: Any, day: NDArray[Any], n_steps: int, series_labels: SeriesLabels = _NO_LABELS
) -> Clock:
    """Return the clock of a boundary; one start is that of the first of consecutive days of 24 h.

    day: labels of its days.  series_labels: of its series; they stand in for what is not given, or must agree.
    """
    zone = require_time_zone("time_zone", time_zone)
    if start is None and series_labels.start is None:
        return Clock(None, zone)
    zones = {"time_zone": zone, "the first sample": require_time_zone("time_zone", series_labels.time_zone)}
    if start is None:
        start = series_labels.start
    elif hasattr(start, "to_numpy") and hasattr(start, "dtype"):  # of xarray or pandas
        array = as_data_array("start", start, "day") if hasattr(start, "dims") else None
        labels = {} if array is None or "day" not in array.coords else {"start": array["day"].values}
        arguments.raise_problems(label_mismatches("day {}", {"the boundary": day} | labels, "align them", "shape"))
        zones["start"] = require_time_zone("time_zone", getattr(start, "attrs", {}).get("time_zone"))
        start = start.to_numpy()
    zones = {name: item for name, item in zones.items() if item}
    arguments.raise_problems(label_mismatches("the time zone {}", zones, "convert to one zone", "time", "time_zone"))
    items = start if isinstance(start, (list, tuple)) or (isinstance(start, np.ndarray) and start.ndim) else [start]
    times = [_parse_time(item[()] if isinstance(item, np.ndarray) else item) for item in items]
    if len(times) not in (1, day.size):
        raise InputError(f"start has {len(times)} times for {day.size} days: {_CURE}", "start", "shape")
    zone = _resolve_zone(times, next(iter(zones.values()), ""))
    cure = f"clocks of {zone} are put forward over that time: give one that they show"
    arguments.raise_problems([
        Problem(f"start = {short_repr(str(time))}: {cure}", "start", "time")
        for time in times
        if time.tzinfo is None and _is_skipped_time(time, zone)
    ])  # fmt: skip
    starts = _round_to_seconds(np.array([time.replace(tzinfo=None) for time in times], dtype="datetime64[us]"))
    if series_labels.start is not None:
        start_times = {"start": starts, "the first sample": _round_to_seconds(np.atleast_1d(series_labels.start))}
        cure = "leave start out, or give bare arrays"
        arguments.raise_problems(label_mismatches("the time {}", start_times, cure, "time", "start"))
    if len(times) < day.size:
        if n_steps > 86400:
            sentence = f"start = {short_repr(start)}: days of {n_steps / 3600:g} h overlap, give one start for each"
            raise InputError(sentence, "start", "time")
        starts = starts[0] + np.arange(day.size) * np.timedelta64(86400, "s")
    return Clock(starts, zone)


def _round_to_seconds(times: Any) -> Times:
    return np.asarray((times.astype("datetime64[us]") + np.timedelta64(500_000, "us")).astype(DATETIME_SECONDS))


def is_clock_changed(time_zone: str, start: np.datetime64, n_steps: int) -> bool:
    """Whether clocks of the zone are changed within ``n_steps`` s of ``start``, or may show it twice."""
    zone = time_zone_from_name(time_zone or "UTC")
    first = cast(datetime, start.astype(DATETIME_SECONDS).item()).replace(tzinfo=zone)
    last = (first.astimezone(UTC) + timedelta(seconds=n_steps - 1)).astimezone(zone)
    return len({first.utcoffset(), first.replace(fold=1).utcoffset(), last.utcoffset()}) > 1


def _is_skipped_time(local: datetime, time_zone: str) -> bool:
    """Whether clocks of the zone never show a local time."""
    zone = time_zone_from_name(time_zone or "UTC")
    return local.replace(tzinfo=zone).astimezone(UTC).astimezone(zone).replace(tzinfo=None) != local


def _parse_time(value: Any) -> datetime:
    if not isinstance(value, (str, date, np.datetime64)):
        raise InputError(f"start = {short_repr(value)}: {_CURE}", "start", "type")
    try:
        time = datetime.fromisoformat(value.strip()) if isinstance(value, str) else value
    except ValueError:
        time = None
    if isinstance(time, np.datetime64):
        time = time.astype("datetime64[us]").item()  # None if it is not a time
    if isinstance(time, date) and not isinstance(time, datetime):
        time = datetime(time.year, time.month, time.day)
    if not isinstance(time, datetime) or not YEAR_RANGE[0] <= time.year <= YEAR_RANGE[1]:
        sentence = f"start = {short_repr(value)}: {_CURE}, of the years {YEAR_RANGE[0]} to {YEAR_RANGE[1]}"
        raise InputError(sentence, "start", "value")
    return time


def _resolve_zone(times: list[datetime], zone: str) -> str:
    """Return the zone, from the UTC offsets of the times if it is not given."""
    offsets = {time.utcoffset() for time in times}
    if offsets == {None}:
        return zone
    for time in times if zone else []:
        if time.replace(tzinfo=time_zone_from_name(zone)).utcoffset() != time.utcoffset():
            sentence = f"start = {short_repr(str(time))} has another UTC offset than {zone} at that time"
            raise InputError(f"{sentence}: give local times", "start", "conflict")
    zone_names = {getattr(time.tzinfo, "key", None) for time in times}
    if zone or (len(zone_names) == 1 and None not in zone_names):
        return zone or require_time_zone("the time zone of start", zone_names.pop())
    if len(offsets) > 1:
        sentence = "start has times of different UTC offsets, or some without: give local times, and time_zone"
        raise InputError(sentence, "start", "conflict")
    return format_utc_offset(round(cast(timedelta, offsets.pop()).total_seconds() / 60))


_CONDITION_BOUNDS: tuple[tuple[str, str, float, float], ...] = (  # names, unit, least and largest value
    ("relative_humidity outdoor_fraction RH_return", "1", 0.0, 1.0),
    ("W_return", "1", 0.0, 0.1),
    ("T_a_in T_design", "degC", -70.0, 60.0),
    ("T_wet_bulb", "degC", -40.0, 40.0),
    ("T_return", "degC", -20.0, 60.0),
    ("T_set", "degC", 0.0, 60.0),
    ("T_w_in", "degC", 0.5, 95.0),
    ("T_daily_range", "K", 0.0, 40.0),
    ("start_hour", "h", 0.0, 24.0),
    ("start", "h", 0.0, 8784.0),
    ("hours", "h", 0.0, 8760.0),
)
CONDITIONS = {
    name: Parameter(name, "boundary", unit, None, "", least, most, open_lower=name == "hours", theory=COVERED)
    for names, unit, least, most in _CONDITION_BOUNDS
    for name in names.split()
} | {"pressure": PARAMETERS["pressure"]}
"""The numbers that describe a day, each with its unit and bounds."""
_MAX_ITEMS = 1_000_000  # more days are a mistake, or an endless iterable


def require_condition(name: str, value: Any) -> Any:
    """Return a number that describes a day if it is within its bounds."""
    number = arguments.to_builtin(to_bare_numbers(name, value, accepted_units(CONDITIONS[name].unit)))
    if problem := CONDITIONS[name].problem(number):
        raise InputError(problem)
    return number


def hours_to_seconds(hours: float | None) -> int:
    """Convert ``hours`` to seconds; `InputError` if they are not a whole number of seconds."""
    hours = float(require_condition("hours", hours))
    seconds = round(hours * 3600)
    if abs(hours * 3600 - seconds) > 1e-6 or seconds < 1:
        raise InputError(f"hours = {hours:g}: give a whole number of seconds (n / 3600)", "hours", "value")
    return seconds


def require_items(name: str, value: object, cure: str) -> list[object]:
    """Return the items of an iterable, at most ``_MAX_ITEMS``."""
    arguments.require_no_unit(name, value, cure)
    if isinstance(value, str | bytes) or not isinstance(value, Iterable) or getattr(value, "ndim", 1) == 0:
        raise InputError(f"{name} = {short_repr(value)}: {cure}", name, "type")
    items = list(islice(value, _MAX_ITEMS + 1))
    if len(items) > _MAX_ITEMS:
        raise InputError(f"{name} has more than {_MAX_ITEMS:,} items: give fewer", name, "size")
    return items


def require_seeds(seed: object) -> list[int]:
    """Return the seeds of days: whole numbers, each once."""
    seed = arguments.to_builtin(seed)
    cure = f"give a whole number from 0 to {LARGEST_DAY_LABEL}, or several distinct ones"
    items = [seed] if isinstance(seed, int) else require_items("seed", seed, cure)
    seeds = [arguments.require_integer("seed", item, 0, LARGEST_DAY_LABEL, cure) for item in items]
    _require_distinct("seed", seeds, "a number", cure)
    return seeds


def days_of_year(name: str, value: object) -> list[int]:
    """Return distinct days of the year, 1 to 366."""
    items = require_items(name, value, "give a list of days of the year")
    days = [arguments.require_integer(name, item, 1, 366, "give whole numbers from 1 to 366") for item in items]
    _require_distinct(name, days, "a day", "give each day once")
    return days


def _require_distinct(name: str, items: Collection[object], noun: str, cure: str) -> None:
    """Raise `InputError` unless there is at least one item, and none twice."""
    if not items:
        raise InputError(f"{name} is empty: {cure}", name, "missing")
    if len(set(items)) < len(items):
        raise InputError(f"{name} has {noun} twice: {cure}", name, "duplicate")

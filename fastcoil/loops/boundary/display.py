"""A boundary as text, as a notebook card and as a figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index
from fastcoil.base.figures import BLUE, COLOURS, LINE_STYLES, apply_style
from fastcoil.base.results import Curves, Section, card
from fastcoil.loops.boundary.clock import DAY, Clock, Times
from fastcoil.loops.boundary.series import BOUNDARY_SERIES
from fastcoil.loops.boundary.source import Source, Stream
from fastcoil.loops.labels import unit_in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_CURVE_POINTS = 110
"""Of a curve, one a pixel."""
_DAYS = 5
"""So many days are drawn one over the other, spread over all of them."""
_LABELS = 8
_Ranges = Mapping[str, tuple[float, float]]


def extent(source: Source, clock: Clock) -> str:
    """Length, days and start: ``24 h x 3 days from 2023-07-01 00:00:00 (UTC-08:00)``."""
    text = f"{source.n_steps / 3600:g} h" + (f" x {source.day.size} days" if source.has_day_dim else "")
    if clock.start is not None:
        text += f" from {str(clock.start[0]).replace('T', ' ')}" + (f" ({clock.time_zone})" if clock.time_zone else "")
    return text


def text_of(source: Source, clock: Clock) -> str:
    """For a terminal; of a stream whose days nobody has looked at only how many they are."""
    if not _is_known(source):
        # what it takes to make and hash a year of days is too much for a look at it
        return f"<fastcoil.Boundary {extent(source, clock)}, made day by day>"
    made = ", made day by day" if source.is_streamed else ""
    ranges = source.extremes
    lines = [
        f"  {name:<14} {_range(name, ranges[name]):<24} {BOUNDARY_SERIES[name].long_name}" for name in _own(ranges)
    ]
    return "\n".join([f"<fastcoil.Boundary {extent(source, clock)}{made}, sha256 {source.sha256[:8]}>", *lines])


def html_of(source: Source, clock: Clock) -> str:
    """For a notebook: a row for each series, with a small curve; of a stream nobody has looked at, of its first day."""
    known, n = _is_known(source), source.day.size
    shown = [0] if source.is_streamed else [int(k) for k in np.unique(np.linspace(0, n - 1, min(n, _DAYS)).round())]
    days = [source.of_day(k) for k in shown]
    ranges = source.extremes if known else {k: (float(v.min()), float(v.max())) for k, v in days[0].items()}
    words = "of the first day" if source.is_streamed and n > 1 else _of_days(len(shown), n)
    rows = []
    for name in _own(ranges):
        curves = Curves.of([_thinned(day[name]).tolist() for day in days], f"{name} over time {words}".rstrip())
        rows.append((name, curves, _range(name, ranges[name]), BOUNDARY_SERIES[name].long_name))
    usual = [f"{name} = {BOUNDARY_SERIES[name].default:g}" for name in BOUNDARY_SERIES if name not in _own(ranges)]
    lines = [f"made day by day; ranges {'of all days' if known else words}"] if source.is_streamed and n > 1 else []
    sections = [Section("series", rows, f"curves {words}" if words else "", is_open=True)]
    if usual:
        sections.append(Section("not given", text="\n".join(usual)))
    facts = [("samples", f"{n} x {source.n_steps:,}, one a second" if n > 1 else f"{source.n_steps:,}, one a second")]
    if source.has_day_dim:
        listed = ", ".join(map(str, source.day[:_LABELS].tolist()))
        facts.append(("day", listed + (f", … {source.day[-1]}" if n > _LABELS else "")))
    if clock.start is not None:
        facts.append(("start", str(clock.start[0]).replace("T", " ")))
        facts.append(("time zone", clock.time_zone or "unknown"))
    facts += [("sha256", source.sha256)] if known else []
    sections.append(Section("about", facts))
    return card("fastcoil.Boundary", extent(source, clock), lines, sections)


def _of_days(shown: int, of: int) -> str:
    return "" if of == 1 else f"of all {of} days" if shown == of else f"of {shown} of {of} days"


def _is_known(source: Source) -> bool:
    return not isinstance(source, Stream) or source.is_surveyed


def _own(ranges: _Ranges) -> list[str]:
    """The series that are not at their default throughout."""
    return [name for name, (low, high) in ranges.items() if not low == high == BOUNDARY_SERIES[name].default]


def _range(name: str, ends: tuple[float, float]) -> str:
    low, high = ends
    span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
    return f"{span} {unit_in_words(BOUNDARY_SERIES[name].unit)}".rstrip()


def _thinned(values: Array) -> Array:
    """Values in as many equal pieces as a curve has points, their means; a step stays one."""
    if values.size <= _CURVE_POINTS:
        return values
    edges = np.linspace(0, values.size, _CURVE_POINTS, endpoint=False).astype(int)
    return np.asarray(np.add.reduceat(values, edges) / np.diff(np.append(edges, values.size)))


_TEMPERATURES = {"T_a_in": "entering air", "T_w_in": "entering water", "T_set": "set-point"}
_PANELS = {
    "m_a": ("air flow\n[kg/s]", 1.0),
    "W_a_in": ("humidity ratio\n[g/kg]", 1e3),
    "enabled": ("in operation\n[%]", 100.0),
    "noise": ("noise of the\nsensor [K]", 1.0),
    "backlash_scale": ("backlash\nscale", 1.0),
}
"""Label of the axis, and the factor to its unit."""
_ALWAYS = ("m_a", "W_a_in")
_POINTS = 1500
_STEPS = (2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600)
"""Seconds that a point may stand for."""
_HOUR, _HOURLY_FROM, _DAILY_FROM = 3600, 8, 61
"""Consecutive days from which on a point is an hour, or a day."""
_WIDTH, _HEIGHT, _ROW = 7.5, 2.2, 1.15
"""Inches: of the figure, of its temperatures, of another row."""


class Course(NamedTuple):
    """Each series over ``at``, (n_points,): mean, least and largest.  at: hours, or dates on the clock ``label`` names.

    of: what a point stands for; blank for a single second.
    """

    at: Any
    label: str
    mean: dict[str, Array]
    low: dict[str, Array]
    high: dict[str, Array]
    of: str


@apply_style()
def draw(source: Source, clock: Clock) -> Figure:
    """Temperatures, air flow and humidity; the other series where they do something."""
    from matplotlib.figure import Figure

    extremes = source.extremes
    rows = [n for n in _PANELS if n in _ALWAYS or extremes[n] != (BOUNDARY_SERIES[n].default,) * 2]
    course = _course(source, clock)
    heights = [_HEIGHT, *[_ROW] * len(rows)]
    figure = Figure(figsize=(_WIDTH, sum(heights) + 0.5), layout="constrained")
    panels = figure.subplots(len(heights), sharex=True, height_ratios=heights)
    for name, colour, style in zip(_TEMPERATURES, COLOURS, LINE_STYLES, strict=True):
        _curve(panels[0], course, name, 1.0, colour, style)
    panels[0].set_ylabel("temperature [°C]")
    panels[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(_TEMPERATURES), frameon=False)
    if course.of:
        panels[0].set_title(course.of, loc="right", fontsize=8)
    for axes, name in zip(panels[1:], rows, strict=True):
        label, factor = _PANELS[name]
        _curve(axes, course, name, factor, BLUE, "-")
        axes.set_ylabel(label)
        if name in ("m_a", "enabled"):
            axes.set_ylim(bottom=0.0)
    if np.asarray(course.at).dtype.kind == "M":
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

        locator = AutoDateLocator()  # type: ignore[no-untyped-call]
        panels[-1].xaxis.set_major_locator(locator)
        panels[-1].xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    panels[-1].set_xlabel(course.label)
    figure.align_ylabels(panels)
    return figure


def _curve(axes: Axes, course: Course, name: str, factor: float, colour: str, style: str) -> None:
    low, high = factor * course.low[name], factor * course.high[name]
    if course.of:
        axes.fill_between(course.at, low, high, color=colour, alpha=0.2, lw=0)
    axes.plot(course.at, factor * course.mean[name], color=colour, ls=style, label=_TEMPERATURES.get(name, name))


def _course(source: Source, clock: Clock) -> Course:
    start, n_days = clock.start, source.day.size
    if n_days == 1 or (start is not None and source.n_steps <= 86400 and bool((np.diff(start) == DAY).all())):
        return _in_time(source, clock)
    step = -(-source.n_steps // _POINTS)
    days = [_binned(source.of_day(k), step) for k in range(n_days)]
    mean, low, high = ({n: np.stack([day[i][n] for day in days]) for n in BOUNDARY_SERIES} for i in range(3))
    first, label = 0.0, "time since the start [h]"
    if start is not None:
        clocks = (start - start.astype("datetime64[D]")) / np.timedelta64(1, "h")
        if (clocks == clocks[0]).all():
            first, label = float(clocks[0]), "hour of the day"
    hours = first + np.arange(0, source.n_steps, step) / 3600
    return Course(
        hours,
        label,
        {name: values.mean(axis=0) for name, values in mean.items()},
        {name: values.min(axis=0) for name, values in low.items()},
        {name: values.max(axis=0) for name, values in high.items()},
        f"each point: mean and range of {n_days} days",
    )


def _in_time(source: Source, clock: Clock) -> Course:
    """A day, or days that follow each other."""
    n_days, n_steps = source.day.size, source.n_steps
    step, of = -(-n_steps * n_days // _POINTS), ""
    if n_days >= _HOURLY_FROM:
        step, of = (min(n_steps, _HOUR), "an hour") if n_days < _DAILY_FROM else (n_steps, "a day")
    elif step > 1:
        step = next((one for one in _STEPS if one >= step), step)
        of = f"{step} s" if step < 120 else f"{step / 60:g} min"
    days = [_binned(source.of_day(k), step) for k in range(n_days)]
    gap = n_days > 1 and step < n_steps < 86400
    mean, low, high = (
        {name: np.concatenate([_ended(day[i][name], gap) for day in days]) for name in BOUNDARY_SERIES}
        for i in range(3)
    )
    seconds: Index = np.arange(0, n_steps, step, dtype=np.int64)
    seconds = np.append(seconds, n_steps) if gap else seconds
    words = f"each point: mean and range of {of}" if of else ""
    if clock.start is None:
        return Course(seconds / 3600, "time since the start [h]", mean, low, high, words)
    zone = f" ({clock.time_zone})" if clock.time_zone else ""
    return Course(_dates(clock.start, seconds), f"date and time{zone}", mean, low, high, words)


def _dates(start: Times, seconds: Index) -> Times:
    return np.asarray(np.add.outer(start, seconds.astype("timedelta64[s]"))).ravel()


def _ended(values: Array, gap: bool) -> Array:
    """The values of a day, followed by a gap in the line."""
    return np.append(values, np.nan) if gap else values


def _binned(rows: dict[str, Array], step: int) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """Mean, least and largest value of every ``step`` seconds."""
    n = next(iter(rows.values())).size
    edges = np.arange(0, n, step)
    size = np.diff(np.append(edges, n))
    return (
        {name: np.add.reduceat(values, edges) / size for name, values in rows.items()},
        {name: np.minimum.reduceat(values, edges) for name, values in rows.items()},
        {name: np.maximum.reduceat(values, edges) for name, values in rows.items()},
    )

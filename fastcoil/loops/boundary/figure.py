"""The series of a boundary as a figure: in the course of time, or days on top of each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index
from fastcoil.base.figures import BLUE, COLOURS, LINE_STYLES, apply_style
from fastcoil.loops.boundary.clock import DAY, Clock, Times
from fastcoil.loops.boundary.series import BOUNDARY_SERIES
from fastcoil.loops.boundary.source import Source

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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

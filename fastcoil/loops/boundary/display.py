"""A boundary as text, as a notebook card and as a figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, COLOURS, LINE_STYLES, apply_style
from fastcoil.base.results import Curves, Section, card
from fastcoil.loops.boundary.clock import DAY
from fastcoil.loops.boundary.samples import Samples, not_at_default
from fastcoil.loops.boundary.series import BOUNDARY_SERIES
from fastcoil.loops.labels import unit_in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CURVE_POINTS = 110
"""Of a curve in a card, one a pixel."""
_DAYS = 5
"""Days drawn one over the other in a card, spread over all of them."""
_LABELS = 8


def text_of(days: Samples) -> str:
    """For a terminal; a stream without known ranges shows how many days it has."""
    if days.is_streamed and not days.is_surveyed:
        # making and hashing a year of days takes too long for a repr
        return f"<fastcoil.Boundary {days.extent}, made day by day>"
    made = ", made day by day" if days.is_streamed else ""
    lines = [
        f"  {name:<14} {_range(name, ends):<24} {BOUNDARY_SERIES[name].long_name}"
        for name, ends in not_at_default(days.extremes).items()
    ]
    return "\n".join([f"<fastcoil.Boundary {days.extent}{made}, sha256 {days.sha256[:8]}>", *lines])


def html_of(days: Samples) -> str:
    """For a notebook: a row for each series, with a small curve; of a stream without known ranges, of its first day."""
    known, n = not days.is_streamed or days.is_surveyed, days.n_days
    shown = [0] if days.is_streamed else [int(k) for k in np.unique(np.linspace(0, n - 1, min(n, _DAYS)).round())]
    drawn = [days.of_day(k) for k in shown]
    ranges = days.extremes if known else {k: (float(v.min()), float(v.max())) for k, v in drawn[0].items()}
    several = "" if n == 1 else f"of all {n} days" if len(shown) == n else f"of {len(shown)} of {n} days"
    words = "of the first day" if days.is_streamed and n > 1 else several
    rows, own = [], not_at_default(ranges)
    for name, ends in own.items():
        curves = Curves.of([_thinned(day[name]).tolist() for day in drawn], f"{name} over time {words}".rstrip())
        rows.append((name, curves, _range(name, ends), BOUNDARY_SERIES[name].long_name))
    usual = [f"{name} = {series.default:g}" for name, series in BOUNDARY_SERIES.items() if name not in own]
    lines = [f"made day by day; ranges {'of all days' if known else words}"] if days.is_streamed and n > 1 else []
    sections = [Section("series", rows, f"curves {words}" if words else "", is_open=True)]
    if usual:
        sections.append(Section("not given", text="\n".join(usual)))
    facts = [("samples", f"{n} x {days.n_steps:,}, one a second" if n > 1 else f"{days.n_steps:,}, one a second")]
    if days.has_day_dim:
        listed = ", ".join(map(str, days.day[:_LABELS].tolist()))
        facts.append(("day", listed + (f", … {days.day[-1]}" if n > _LABELS else "")))
    if days.start is not None:
        facts.append(("start", str(days.start[0]).replace("T", " ")))
        facts.append(("time zone", days.time_zone or "unknown"))
    facts += [("sha256", days.sha256)] if known else []
    sections.append(Section("about", facts))
    return card("fastcoil.Boundary", days.extent, lines, sections)


def _range(name: str, ends: tuple[float, float]) -> str:
    low, high = ends
    span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
    return f"{span} {unit_in_words(BOUNDARY_SERIES[name].unit)}".rstrip()


def _thinned(values: Array) -> Array:
    """Means of as many equal pieces as a curve has points; a step stays one."""
    if values.size <= _CURVE_POINTS:
        return values
    edges = np.linspace(0, values.size, _CURVE_POINTS, endpoint=False).astype(int)
    return np.asarray(np.add.reduceat(values, edges) / np.diff(np.append(edges, values.size)))


# --------------------------------------------------------------------------------------------------------- figure

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
    """Mean, least and largest of each series over ``at``, (3, n_points) by name.

    at: hours, or dates on the clock that ``label`` names.  of: what a point stands for; blank for a single second.
    """

    at: Any
    label: str
    series: Mapping[str, Array]
    of: str


@apply_style()
def draw(days: Samples) -> Figure:
    """Temperatures, air flow and humidity; the other series where they do something."""
    from matplotlib.figure import Figure

    rows = [name for name in _PANELS if name in _ALWAYS or name in not_at_default(days.extremes)]
    course = _course(days)
    heights = [_HEIGHT, *[_ROW] * len(rows)]
    figure = Figure(figsize=(_WIDTH, sum(heights) + 0.5), layout="constrained")
    panels = figure.subplots(len(heights), sharex=True, height_ratios=heights)
    for name, colour, style in zip(_TEMPERATURES, COLOURS, LINE_STYLES, strict=True):
        _curve(panels[0], course, name, 1.0, colour, style)
    panels[0].set_ylabel("temperature [°C]")
    panels[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(_TEMPERATURES), frameon=False)
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
    mean, low, high = factor * course.series[name]
    if course.of:
        axes.fill_between(course.at, low, high, color=colour, alpha=0.2, lw=0)
    axes.plot(course.at, mean, color=colour, ls=style, label=_TEMPERATURES.get(name, name))


def _course(days: Samples) -> Course:
    start = days.start
    if days.n_days == 1 or (start is not None and days.n_steps <= 86400 and bool((np.diff(start) == DAY).all())):
        return _in_time(days)
    step = -(-days.n_steps // _POINTS)
    binned = _binned(days, step)
    first, label = 0.0, "time since the start [h]"
    if start is not None:
        clocks = (start - start.astype("datetime64[D]")) / np.timedelta64(1, "h")
        if (clocks == clocks[0]).all():
            first, label = float(clocks[0]), "hour of the day"
    hours = first + np.arange(0, days.n_steps, step) / 3600
    over = {n: np.stack([v[:, 0].mean(0), v[:, 1].min(0), v[:, 2].max(0)]) for n, v in binned.items()}
    return Course(hours, label, over, f"each point: mean and range of {days.n_days} days")


def _in_time(days: Samples) -> Course:
    """A day, or days that follow each other."""
    n_days, n_steps, start = days.n_days, days.n_steps, days.start
    step, of = -(-n_steps * n_days // _POINTS), ""
    if n_days >= _HOURLY_FROM:
        step, of = (min(n_steps, _HOUR), "an hour") if n_days < _DAILY_FROM else (n_steps, "a day")
    elif step > 1:
        step = next((one for one in _STEPS if one >= step), step)
        of = f"{step} s" if step < 120 else f"{step / 60:g} min"
    seconds = np.arange(0, n_steps, step)
    binned = _binned(days, step)
    if n_days > 1 and step < n_steps < 86400:  # a gap in the line after each day
        seconds = np.append(seconds, n_steps)
        binned = {n: np.pad(v, ((0, 0), (0, 0), (0, 1)), constant_values=np.nan) for n, v in binned.items()}
    joined = {name: np.concatenate(list(values), axis=1) for name, values in binned.items()}
    words = f"each point: mean and range of {of}" if of else ""
    if start is None:
        return Course(seconds / 3600, "time since the start [h]", joined, words)
    zone = f" ({days.time_zone})" if days.time_zone else ""
    dates = np.add.outer(start, seconds.astype("timedelta64[s]")).ravel()
    return Course(dates, f"date and time{zone}", joined, words)


def _binned(days: Samples, step: int) -> dict[str, Array]:
    """Mean, least and largest value of every ``step`` seconds of each day, (n_days, 3, n_points) by name."""
    edges = np.arange(0, days.n_steps, step)
    size = np.diff(np.append(edges, days.n_steps))
    found: dict[str, list[Any]] = {name: [] for name in BOUNDARY_SERIES}
    for k in range(days.n_days):
        for name, values in days.of_day(k).items():
            low, high = (extreme.reduceat(values, edges) for extreme in (np.minimum, np.maximum))
            found[name].append((np.add.reduceat(values, edges) / size, low, high))
    return {name: np.array(of_days) for name, of_days in found.items()}

"""A boundary as text and as a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, COLOURS, LINE_STYLES, apply_style
from fastcoil.loops.boundary.clock import DAY
from fastcoil.loops.boundary.samples import Samples
from fastcoil.loops.boundary.series import BOUNDARY_SERIES
from fastcoil.loops.labels import unit_in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def text_of(days: Samples) -> str:
    """For a terminal; a stream without known ranges shows how many days it has: making all takes too long."""
    made = ", made day by day" if days.is_streamed else ""
    if days.is_streamed and not days.is_surveyed:
        return f"<fastcoil.Boundary {days.extent}{made}>"
    lines = [
        f"  {name:<14} {_range(name, *ends):<24} {BOUNDARY_SERIES[name].long_name}"
        for name, ends in days.own_extremes.items()
    ]
    return "\n".join([f"<fastcoil.Boundary {days.extent}{made}, sha256 {days.sha256[:8]}>", *lines])


def _range(name: str, low: float, high: float) -> str:
    span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
    return f"{span} {unit_in_words(BOUNDARY_SERIES[name].unit)}".rstrip()


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
_STEPS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 86400)  # seconds that a point may stand for
_WIDTH, _HEIGHT, _ROW = 7.5, 2.2, 1.15  # inches: of the figure, of its temperatures, of another row


@apply_style()
def draw(days: Samples) -> Figure:
    """Temperatures, air flow and humidity; the other series where they do something.

    Days that follow each other are drawn in time, others on top of each other, with mean and range.
    """
    from matplotlib.figure import Figure

    rows = [name for name in _PANELS if name in _ALWAYS or name in days.own_extremes]
    heights = [_HEIGHT, *[_ROW] * len(rows)]
    figure = Figure(figsize=(_WIDTH, sum(heights) + 0.5), layout="constrained")
    panels = figure.subplots(len(heights), sharex=True, height_ratios=heights)
    styles = {name: (panels[0], 1.0, *style) for name, *style in zip(_TEMPERATURES, COLOURS, LINE_STYLES, strict=True)}
    for axes, name in zip(panels[1:], rows, strict=True):
        label, factor = _PANELS[name]
        styles[name] = (axes, factor, BLUE, "-")
        axes.set_ylabel(label)

    at, label, of, series = _course(days)
    for name, (axes, factor, colour, style) in styles.items():
        mean, low, high = factor * series[name]
        if of:
            axes.fill_between(at, low, high, color=colour, alpha=0.2, lw=0)
        axes.plot(at, mean, color=colour, ls=style, label=_TEMPERATURES.get(name, name))
        if name in ("m_a", "enabled"):
            axes.set_ylim(bottom=0.0)
    panels[0].set_ylabel("temperature [°C]")
    panels[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(_TEMPERATURES), frameon=False)
    panels[0].set_title(f"each point: mean and range of {of}" if of else "", loc="right", fontsize=8)
    if at.dtype.kind == "M":
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

        locator = AutoDateLocator()  # type: ignore[no-untyped-call]
        panels[-1].xaxis.set_major_locator(locator)
        panels[-1].xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    panels[-1].set_xlabel(label)
    figure.align_ylabels(panels)
    return figure


def _course(days: Samples) -> tuple[NDArray[Any], str, str, dict[str, Array]]:
    """Hours or dates, the label of that axis, what a point stands for, and mean, least and largest of each series."""
    n_days, n_steps, start = days.n_days, days.n_steps, days.start
    follow = n_days == 1 or (start is not None and n_steps <= 86400 and bool((np.diff(start) == DAY).all()))
    shortest = n_steps * (n_days if follow else 1) / _POINTS
    step = min(next((one for one in _STEPS if one >= shortest), _STEPS[-1]), n_steps)
    of = (
        ""
        if step == 1
        else f"{step} s"
        if step < 120
        else f"{step / 60:g} min"
        if step < 3600
        else f"{step / 3600:g} h"
    )
    seconds = np.arange(0, n_steps, step)
    each = [{name: _binned(values, step) for name, values in days.of_day(k).items()} for k in range(n_days)]
    if not follow:
        stacked = {name: np.stack([day[name] for day in each], axis=1) for name in BOUNDARY_SERIES}
        over = {name: np.stack([v[0].mean(0), v[1].min(0), v[2].max(0)]) for name, v in stacked.items()}
        clocks = np.zeros(1) if start is None else (start - start.astype("M8[D]")) / np.timedelta64(1, "h")
        same = start is not None and bool((clocks == clocks[0]).all())
        hours = (clocks[0] if same else 0.0) + seconds / 3600
        return hours, "hour of the day" if same else "time since the start [h]", f"{n_days} days", over
    if n_days > 1 and step < n_steps < 86400:  # a gap in the line after each day
        seconds = np.append(seconds, n_steps)
        each = [{n: np.pad(v, ((0, 0), (0, 1)), constant_values=np.nan) for n, v in day.items()} for day in each]
    joined = {name: np.concatenate([day[name] for day in each], axis=1) for name in BOUNDARY_SERIES}
    if start is None:
        return seconds / 3600, "time since the start [h]", of, joined
    zone = f" ({days.time_zone})" if days.time_zone else ""
    return np.add.outer(start, seconds.astype("m8[s]")).ravel(), f"date and time{zone}", of, joined


def _binned(values: Array, step: int) -> Array:
    """Mean, least and largest value of every ``step`` seconds, (3, n_points)."""
    edges = np.arange(0, values.size, step)
    mean = np.add.reduceat(values, edges) / np.diff(np.append(edges, values.size))
    return np.stack([mean, np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)])

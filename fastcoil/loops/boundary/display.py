"""A boundary as text and as a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fastcoil.base.figures import BLUE, COLOURS, LINE_STYLES, apply_style
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
    "m_a": "air flow\n[kg/s]",
    "W_a_in": "humidity ratio\n[kg/kg]",
    "enabled": "in operation\n[1]",
    "noise": "noise of the\nsensor [K]",
    "backlash_scale": "backlash\nscale",
}
"""Series with a panel of their own, the first two always; label of the axis."""
_POINTS = 1500


@apply_style()
def draw(days: Samples) -> Figure:
    """Mean and range of all days over time: temperatures, air flow and humidity; other series where they differ."""
    from matplotlib.figure import Figure

    starts = np.arange(0, days.n_steps, -(-days.n_steps // _POINTS))
    size = np.diff(np.append(starts, days.n_steps))
    rows = [name for name in _PANELS if name in ("m_a", "W_a_in") or name in days.own_extremes]
    shown = [*_TEMPERATURES, *rows]
    total = dict.fromkeys(shown, np.zeros(starts.size))
    low, high = dict.fromkeys(shown, np.full(starts.size, np.inf)), dict.fromkeys(shown, np.full(starts.size, -np.inf))
    for k in range(days.n_days):
        series = days.of_day(k)
        for name in shown:
            total[name] = total[name] + np.add.reduceat(series[name], starts)
            low[name] = np.minimum(low[name], np.minimum.reduceat(series[name], starts))
            high[name] = np.maximum(high[name], np.maximum.reduceat(series[name], starts))

    figure = Figure(figsize=(7.5, 2.7 + 1.15 * len(rows)), layout="constrained")
    panels = figure.subplots(1 + len(rows), sharex=True, height_ratios=[2.0, *[1.0] * len(rows)])
    styles = {name: (panels[0], *style) for name, *style in zip(_TEMPERATURES, COLOURS, LINE_STYLES, strict=True)}
    styles |= {name: (axes, BLUE, "-") for name, axes in zip(rows, panels[1:], strict=True)}
    for name, (axes, colour, style) in styles.items():
        axes.fill_between(starts / 3600, low[name], high[name], color=colour, alpha=0.2, lw=0)
        mean = total[name] / (days.n_days * size)
        axes.plot(starts / 3600, mean, color=colour, ls=style, label=_TEMPERATURES.get(name, name))
        axes.set_ylabel(_PANELS.get(name, "temperature [°C]"))
    panels[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(_TEMPERATURES), frameon=False)
    panels[-1].set_xlabel("time since the start [h]")
    figure.align_ylabels(panels)
    return figure

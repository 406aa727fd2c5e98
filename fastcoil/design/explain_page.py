"""The page that draws an explanation: which gains hunt, and part of the day."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fastcoil.base.figures import BLUE, FAINT, GREY, RED, YELLOW, apply_style, wrapped
from fastcoil.design.advice import GAINS
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.design.prediction import Prediction, cycles_at
from fastcoil.loops.boundary import Boundary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH, _HEIGHT_OF_MAP, _HEIGHT_OF_DAY = 7.5, 3.7, 3.8  # inches
_DRAWN, _BEFORE = 5400, 600  # seconds that are drawn, and how many of them before the worst operating point
_SPAN, _TI_STEPS = 8.0, 60  # the map goes from the gains of now and the cures, divided by this, to as many times them
_LABEL = 0.85  # where on a contour its label is, as a share of its length
_CONTOURS = (0.4, HUNTS_ABOVE, 1.7)
_ON_WHITE = {"fc": "white", "ec": "none", "pad": 0.6}
_MARKS = {"lower_kp": ("v", "lower kp"), "longer_ti": (">", "longer ti"), "simc": ("s", "SIMC"),
    "simulated_gains": ("D", "found by simulation"),
}  # fmt: skip


@apply_style()
def draw(heading: str, boundary: Boundary, cures: xr.Dataset, best: int, prediction: Prediction | None) -> Figure:
    """Draw the page; where theory cannot tell, the day alone.

    cures: as of ``try_cures``.  best: index of the recommended one.
    """
    from matplotlib.figure import Figure

    heights = [_HEIGHT_OF_MAP, _HEIGHT_OF_DAY] if prediction is not None else [_HEIGHT_OF_DAY]
    fig = Figure(figsize=(_WIDTH, sum(heights)), layout="constrained")
    *above, below = fig.subplots(len(heights), squeeze=False, height_ratios=heights)[:, 0]
    middle = boundary.n_steps // 2
    if prediction is not None:
        _draw_gains(above[0], cures, prediction)
        middle = int(prediction.points.start[prediction.worst])
    _draw_day(below, cures, best, boundary, middle)
    fig.suptitle(wrapped(heading, _WIDTH - 0.3, 9.0), x=0.01, ha="left", fontsize=9)
    return fig


def _draw_gains(axes: Axes, cures: xr.Dataset, prediction: Prediction) -> None:
    """Which kp and ti hunt at the worst operating point; the margin goes with kp."""
    marked = np.flatnonzero(np.isin(cures["cure"], ("as_it_is", *GAINS)))
    own_kp, own_ti = (np.broadcast_to(cures.get(n, prediction.columns[n]), cures.sizes["cure"]) for n in ("kp", "ti"))
    times = np.geomspace(own_ti[marked].min() / _SPAN, own_ti[marked].max() * _SPAN, _TI_STEPS)
    swept = prediction.loop.assign(ti=("tuning", times))
    at_kp = cycles_at(swept, prediction.plants, np.array([prediction.worst])).margin[:, 0]
    low, high = own_kp[marked].min() / _SPAN, own_kp[marked].max() * _SPAN
    with np.errstate(divide="ignore"):
        limits = {level: own_kp[0] * level / at_kp for level in _CONTOURS}
    hunts = np.clip(limits[HUNTS_ABOVE], low, high)
    axes.fill_between(times, hunts, high, color=FAINT, lw=0, label=f"hunts (margin > {HUNTS_ABOVE:g})")
    for level, style in zip(_CONTOURS, (":", "-", ":"), strict=True):
        axes.plot(times, limits[level], color="black" if level == HUNTS_ABOVE else GREY, lw=1.2, ls=style)
        inside = np.flatnonzero((limits[level] > low * 1.2) & (limits[level] < high / 1.2))
        if inside.size:
            i = inside[int(_LABEL * inside.size)]
            axes.text(times[i], limits[level][i], f"{level:g}", fontsize=7, ha="center", va="center", bbox=_ON_WHITE)
    axes.plot(own_ti[0], own_kp[0], "o", color=RED, ms=7, label="as it is")
    for k in marked[1:]:
        mark, words = _MARKS[str(cures["cure"].values[k])]
        colour = BLUE if cures["hunting"][k] == 0 else YELLOW
        axes.plot(own_ti[k], own_kp[k], mark, ms=7, color=colour, mec="black", mew=0.6, ls="none", label=words)
    axes.set(xscale="log", yscale="log", xlim=(times[0], times[-1]), ylim=(low, high))
    axes.set(xlabel="integral time Ti [s]", ylabel="proportional gain Kp [1/K]")
    axes.set_title("Which gains hunt, by their margin", loc="left")
    axes.legend(loc="lower right", fontsize=7)


def _draw_day(axes: Axes, cures: xr.Dataset, best: int, boundary: Boundary, middle: int) -> None:
    """Part of the day as it is, and with the recommended cure."""
    t = cures["elapsed_time"].values
    start = max(0, min(middle - _BEFORE, boundary.n_steps - _DRAWN))
    seen = (t >= start) & (t < start + _DRAWN)
    hours = t[seen] / 3600.0
    axes.plot(hours, cures["T_sup"][0][seen], color=RED, lw=1.0, label="as it is")
    if best:
        axes.plot(hours, cures["T_sup"][best][seen], color=BLUE, lw=1.2, label=str(cures["words"].values[best]))
    T_set = boundary.series["T_set"][0][t[seen].astype(int)]
    axes.plot(hours, T_set, color="black", lw=0.9, ls="--", label="set-point")
    axes.set(xlabel="time from the start [h]", ylabel="supply air [°C]")
    axes.margins(x=0.0)
    axes.set_title("Simulated", loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)

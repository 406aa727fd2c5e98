"""``fc.plot.learning``: an estimate on its way to the true gap."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.base.figures import COLOURS, FAINT, LINE_STYLES, STYLE
from fastcoil.deliver.figures.place import in_style, legend_above, one_place, width_of
from fastcoil.deliver.figures.scenarios import interval_of, parameter_of, scenarios_of, traced
from fastcoil.loops.labels import quantity
from fastcoil.model.metric_table import SWITCH_BLOCK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_HOUR = 3600.0
_HEIGHT = 2.4


@in_style()
def learning(data: Any, *, ax: Any = None) -> Axes:
    """Draw the backlash estimate over time against the true backlash, up to three scenarios.

    A dot is where the estimate reached the backlash, a square where the learner confirmed it by stepping down.  Of a
    single scenario with the trace ``mode``, taken at every sample of the controller, grey bars are the switches of mode
    in each 10 min: those of a good estimate are few, chatter says that it is too large.

    Parameters
    ----------
    data
        Dataset of ``simulate`` with the trace ``estimate``.
    ax
        Axes to draw into; a new figure if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake; for more scenarios than three.
    """
    ds = traced(data)
    if "estimate" not in ds:
        raise InputError('data has no trace estimate: simulate with traces=["estimate", "mode"]')
    found = scenarios_of(ds, ["estimate"])
    gaps = [100.0 * parameter_of(one.ds, "backlash") for one in found]
    axes = one_place(ax, _HEIGHT)
    if len(found) == 1 and "mode" in ds and interval_of(found[0].ds) <= parameter_of(found[0].ds, "sample_time"):
        _chatter(axes, found[0].ds)
    alike = len({*gaps}) == 1
    for k, one in enumerate(found):
        look: Any = {"color": COLOURS[k], "ls": LINE_STYLES[k]}
        hours = one.ds["elapsed_time"] / _HOUR
        axes.plot(hours, 100.0 * one.ds["estimate"], drawstyle="steps-post", label=one.words or "estimate", **look)
        _mark(axes, one.ds, COLOURS[k])
    for k, gap in enumerate(gaps[:1] if alike else gaps):
        label = "true backlash" if alike else "" if k else "true backlash of each"
        axes.axhline(gap, color="black" if alike else COLOURS[k], lw=0.9, ls=":", label=label)
    axes.set(xlabel="time from the start [h]", ylabel=quantity("estimate").axis)
    axes.margins(x=0.0)
    axes.set_ylim(0.0, 1.15 * max(*gaps, float(100.0 * ds["estimate"].max()), 0.1))
    legend_above(axes, width_of(axes, ax))
    return axes


def _mark(axes: Axes, one: xr.Dataset, colour: str) -> None:
    """Where the learner reached and confirmed the backlash, if it did."""
    for name, mark in (("learn_time_reached", "o"), ("learn_time_confirmed", "s")):
        at = float(one[name]) if name in one and one[name].ndim == 0 else math.nan
        if math.isfinite(at):
            value = float(one["estimate"].sel(elapsed_time=at, method="nearest"))
            axes.plot(at / _HOUR, 100.0 * value, mark, color=colour, mec="black", mew=0.6, ms=5, ls="none")


def _chatter(axes: Axes, one: xr.Dataset) -> None:
    """Switches of mode in each block of 10 min, behind the curves, on an axis of their own."""
    mode, interval = one["mode"].values, interval_of(one)
    counts, hours = switches(mode, interval)
    behind = axes.twinx()
    behind.bar(hours, counts, width=SWITCH_BLOCK / _HOUR, align="edge", color=FAINT, lw=0)
    behind.set(ylabel="mode switches per 10 min", ylim=(0.0, max(2.0 * float(counts.max(initial=0.0)), 1.0)))
    behind.tick_params(labelsize=STYLE["font.size"])
    behind.grid(visible=False)
    behind.spines["right"].set_visible(True)
    axes.set_zorder(behind.get_zorder() + 1)
    axes.patch.set_visible(False)


def switches(mode: Array, interval: float) -> tuple[Array, Array]:
    """Switches of mode in each whole block of 10 min, and where the blocks start [h]."""
    per_block = round(SWITCH_BLOCK / interval)
    changed = np.concatenate([[0.0], (np.diff(mode.astype(float)) != 0.0).astype(float)])
    n = changed.size // per_block
    counts: Array = changed[: n * per_block].reshape(n, per_block).sum(axis=1)
    return counts, np.asarray(np.arange(n) * per_block * interval / _HOUR, dtype=np.float64)

"""``fc.plot.limit_cycle``: how a loop swings, and how it was foretold to."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import instance_of
from fastcoil.base.errors import InputError
from fastcoil.base.figures import BLUE, COLOURS, DOTTED, GREY, LINE_STYLES, RED, YELLOW, wrapped
from fastcoil.deliver.figures.place import in_style, legend_above, one_place, width_of
from fastcoil.deliver.figures.scenarios import Scenario, parameter_of, scenarios_of, traced
from fastcoil.loops.dataset import check_result
from fastcoil.study.analysis.panels import say_if_empty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_HEIGHT = 3.0
_PERIODS = 4
"""So many of the last ones are drawn."""
_LAST = 3600.0
"""Seconds that are drawn of a loop without a period."""
_PLANE = ("command", "opening")
_FORETOLD = ("margin", "hunts", "period", "amplitude")
_KINDS = (
    ("foretold and seen", True, True, "o", BLUE),
    ("seen, not foretold", False, True, "s", RED),
    ("foretold, not seen", True, False, "^", YELLOW),
    ("neither", False, False, "x", GREY),
)
"""What became of the loops in a scatter of swings: words, foretold, seen, mark, colour."""


@in_style()
def limit_cycle(data: Any, foretold: xr.Dataset | None = None, *, ax: Any = None) -> Axes:
    """Draw how a loop swings, and what was foretold of it.

    Of up to three scenarios with the traces ``command`` and ``opening``: the opening over the command in the last
    swings; the gap is the width of the parallelogram, between the dotted lines on which Eq (1) moves the stem.  The
    heading compares the swing with the one foretold.

    Of a sweep without these traces: the swing seen over the swing foretold of every scenario, peak to peak.

    Parameters
    ----------
    data
        Dataset of ``simulate``, ``run_study`` or ``open_study``.
    foretold
        What ``fc.limit_cycle(loop, boundary)`` gives for the same sweep.  A study with ``[run] predict`` has it itself.
    ax
        Axes to draw into; a new figure if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    ds = instance_of("data", data, xr.Dataset, "give a Dataset of fastcoil.simulate or open_study")
    if foretold is not None:
        cure = "give what fastcoil.limit_cycle(loop, boundary) returns"
        instance_of("foretold", foretold, xr.Dataset, cure)
        missing = [name for name in _FORETOLD if name not in foretold]
        if missing:
            raise InputError(f"foretold has no {', '.join(missing)}: {cure}")
    if all(name in ds for name in _PLANE):
        return _plane(traced(ds), foretold, ax)
    check_result(ds)
    foretold = _foretold_by(ds) if foretold is None else foretold
    if foretold is None:
        raise InputError(
            'data has neither the traces command and opening nor what was foretold: simulate with traces=["command", '
            '"opening"], or give foretold=fc.limit_cycle(loop, boundary)'
        )
    return _swings(ds, foretold, ax)


def _foretold_by(ds: xr.Dataset) -> xr.Dataset | None:
    """The predictions of a study, as ``fc.limit_cycle`` names them."""
    if "predicted_swing" not in ds:
        return None
    told = {"margin": "predicted_margin", "hunts": "predicted_hunts", "period": "predicted_period"}
    return xr.Dataset({name: ds[of] for name, of in told.items()} | {"amplitude": 0.5 * ds["predicted_swing"]})


def _plane(ds: xr.Dataset, foretold: xr.Dataset | None, ax: Any) -> Axes:
    found = scenarios_of(ds, _PLANE)
    gaps = [parameter_of(one.ds, "backlash") for one in found]
    told = [_told_of(one, foretold) for one in found]
    axes = one_place(ax, _HEIGHT)
    axes.set(xlabel="command [%]", ylabel="opening [%]")
    if say_if_empty(axes, ds["opening"]):
        return axes
    lines = []
    for k, (one, gap) in enumerate(zip(found, gaps, strict=True)):
        seen = one.ds.isel(elapsed_time=_last(one.ds))
        command, opening = 100.0 * seen["command"].values, 100.0 * seen["opening"].values
        words = _compared(one.ds, told[k])
        axes.plot(command, opening, color=COLOURS[k], ls=LINE_STYLES[k], lw=1.2, label=one.words or "_only")
        lines.append(": ".join(filter(None, [one.words, words])))
        ends = np.array([command.min(), command.max()])
        for shift in {0.0, 100.0 * gap}:
            edge = np.clip((ends - shift) / (1.0 - gap), 0.0, 100.0)
            axes.plot(ends, edge, color="black", lw=0.7, ls=DOTTED, zorder=1)
    openings = [100.0 * one.ds["opening"].values[_last(one.ds)] for one in found]
    low, high = float(np.nanmin(np.concatenate(openings))), float(np.nanmax(np.concatenate(openings)))
    room = max(0.15 * (high - low), 0.5)
    axes.set_ylim(low - room, high + room)
    if found[0].words:
        axes.legend(loc="best", framealpha=0.8, edgecolor="none")
    heading = "\n".join([*lines, "dotted: the edges of the gap"])
    axes.set_title(wrapped(heading, width_of(axes, ax), 7), loc="left", fontsize=7)
    return axes


def _last(one: xr.Dataset) -> slice:
    """The last swings of a scenario."""
    period = float(one["hunting_period"]) if "hunting_period" in one else math.nan
    seconds = one["elapsed_time"].values
    width = _PERIODS * period if math.isfinite(period) else _LAST
    return slice(int(np.searchsorted(seconds, seconds[-1] - width)), None)


def _told_of(one: Scenario, foretold: xr.Dataset | None) -> xr.Dataset | None:
    """What was foretold of one scenario."""
    if foretold is None:
        return _foretold_by(one.ds)
    place = {d: one.ds[d].item() for d in foretold["margin"].dims if d in one.ds.coords and one.ds[d].ndim == 0}
    try:
        told = foretold.sel(place)
    except (KeyError, ValueError):
        told = foretold
    if told["margin"].ndim:
        dims = ", ".join(str(dim) for dim in told["margin"].dims)
        raise InputError(f"foretold has other labels along {dims} than data: give that of the same sweep")
    return told


def _compared(one: xr.Dataset, told: xr.Dataset | None) -> str:
    """The swing that was seen, and the one that was foretold."""
    words = []
    if "hunting_swing" in one:
        words.append(f"simulated {_swing(float(one['hunting_swing']), float(one['hunting_period']))}")
    if told is not None:
        swings = float(told["hunts"]) > 0.0
        swing = _swing(2.0 * float(told["amplitude"]), float(told["period"])) if swings else "no swing"
        words.append(f"foretold {swing} (margin {float(told['margin']):.2g})")
    return ", ".join(words)


def _swing(peak_to_peak: float, period: float) -> str:
    every = f" every {period:.0f} s" if math.isfinite(period) else ""
    return f"{peak_to_peak:.2g} K{every}"


def _swings(ds: xr.Dataset, foretold: xr.Dataset, ax: Any) -> Axes:
    seen, told, hunts = xr.broadcast(ds["hunting_swing"], 2.0 * foretold["amplitude"], foretold["hunts"])
    if seen.sizes != ds["hunting_swing"].sizes:
        raise InputError("foretold has other dims or labels than data: give that of the same sweep")
    known = np.isfinite(seen.values) & np.isfinite(hunts.values)
    y, x = seen.values[known], np.nan_to_num(told.values[known])
    does = ds["hunts"].broadcast_like(seen).transpose(*seen.dims).values[known] > 0.0
    axes = one_place(ax, _HEIGHT)
    for words, is_told, is_seen, mark, colour in _KINDS:
        of_kind = ((hunts.values[known] > 0.0) == is_told) & (does == is_seen)
        label = f"{words}: {int(of_kind.sum()):,}"
        axes.plot(x[of_kind], y[of_kind], mark, color=colour, ms=3.5, mew=0.8, mfc="none", ls="none", label=label)
    top = 1.05 * max(float(x.max(initial=0.1)), float(y.max(initial=0.1)))
    axes.axline((0.0, 0.0), slope=1.0, color="black", lw=0.8, ls=DOTTED)
    axes.set(xlabel="foretold swing, peak to peak [K]", ylabel="simulated swing,\npeak to peak [K]",
             xlim=(-0.02 * top, top), ylim=(-0.02 * top, top))  # fmt: skip
    legend_above(axes, width_of(axes, ax), title="hunting", title_fontsize=8, alignment="left")
    return axes

"""Figures of a fit: Fig 2 of the paper and the profile for a valve, Figs 4 and 5 for a coil."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.figures import COLOURS, DOTTED, FAINT, apply_style
from fastcoil.measured.fit.split import FITTING, UNUSED, VALIDATION
from fastcoil.model.engine.recorded import valve_flows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MODEL, _FITTED, _HELD_BACK = COLOURS
_MOST_POINTS = 4000
_LEGEND: Any = {"framealpha": 0.8, "edgecolor": "none"}


class Branches(NamedTuple):
    """Flow over the command from 0 to 1, kg/s, opening and closing."""

    rising: Array
    falling: Array


def valve_figure(residuals: xr.Dataset, profile: xr.Dataset, curve: Array, floor: float, *, identified: bool) -> Figure:
    """Parity, data over the hysteresis curves, and profile.

    Parameters
    ----------
    residuals, profile
        As in the fit.
    curve, floor
        x_BL, m_max, a, b, c of Eqs (1) and (2), and the lowest reading of the flow meter [kg/s].
    identified
        Whether the data identify the backlash.
    """
    with apply_style():
        return _valve(residuals, profile, curve, floor, identified)


def coil_figure(residuals: xr.Dataset, rmse: Mapping[str, float]) -> Figure:
    """Supply air, leaving water and flows over time, a column for each part; ``rmse``: by part, as in the fit."""
    with apply_style():
        return _coil(residuals, rmse)


def _valve(ds: xr.Dataset, profile: xr.Dataset, curve: Array, floor: float, identified: bool) -> Figure:
    from matplotlib.figure import Figure

    fig = Figure(figsize=(10.5, 3.6), layout="constrained")
    parity, curves, profile_axes = fig.subplots(1, 3)
    looks = ((FITTING, _FITTED, "o"), (VALIDATION, _HELD_BACK, "x"))
    for part, colour, marker in looks:
        here = _thinned(ds["part"].values == part)
        if here.size:
            style = {"color": colour, "marker": marker, "s": 10, "alpha": 0.6, "lw": 0.8 * (marker == "x")}
            parity.scatter(ds["m_w"][here], ds["modelled"][here], label=part, **style)
            curves.scatter(100 * ds["command"][here], ds["m_w"][here], label=part, **style)
    top = 1.05 * float(np.nanmax(ds["m_w"]))
    parity.plot([0, top], [0, top], color="black", lw=0.8)
    parity.set(xlabel="measured flow [kg/s]", ylabel="modelled flow [kg/s]", title="Parity", aspect="equal")
    parity.set(xlim=(0, top), ylim=(0, top))
    branches = _branches(curve, floor)
    command = np.linspace(0.0, 100.0, branches.rising.size)
    curves.plot(command, branches.rising, color=_MODEL, lw=1.5, label="model, opening")
    curves.plot(command, branches.falling, color=_MODEL, lw=1.5, ls="--", label="model, closing")
    curves.set(xlabel="command [%]", ylabel="flow [kg/s]", title="Data over the hysteresis curves")
    curves.set_ylim(0, top)
    for axes in (parity, curves):
        axes.legend(loc="lower right", fontsize=8, **_LEGEND)
    _profile(profile_axes, profile, identified)
    return fig


def _branches(curve: Array, floor: float) -> Branches:
    up = np.linspace(0.0, 1.0, 201)
    flows = []
    for command, start in ((up, 1.0), (up[::-1], 0.0)):
        openings, flow = np.empty((up.size, 1)), np.empty((up.size, 1))
        batch = np.zeros(up.size, dtype=np.int64)
        valve_flows(np.ascontiguousarray(command), batch, curve[:, None].copy(), np.full((1, 1), start), openings, flow)
        flows.append(np.maximum(flow[:, 0], floor))
    return Branches(rising=flows[0], falling=flows[1][::-1])


def _profile(axes: Axes, ds: xr.Dataset, identified: bool) -> None:
    axes.plot(100 * ds["backlash"], ds["rmse"], color=_MODEL, marker=".", ms=4)
    axes.axhline(ds.attrs["limit"], color="black", lw=0.8, ls=DOTTED, label="limit of the 95 % interval")
    low, high = ds.attrs["interval_95"]
    axes.axvspan(100 * low, 100 * high, color=_FITTED, alpha=0.3, lw=0, label="95 % interval")
    axes.set(
        xlabel="backlash [%]",
        ylabel="least RMSE of the fitted part [kg/s]",
        title=f"Profile: 95 % interval {100 * low:.3g} to {100 * high:.3g} %"
        if identified
        else "Profile: the backlash is not identified",
    )
    axes.legend(loc="upper center", fontsize=8, **_LEGEND)


def _coil(ds: xr.Dataset, rmse: Mapping[str, float]) -> Figure:
    from matplotlib.figure import Figure

    parts = [part for part in (FITTING, VALIDATION) if (ds["part"] == part).any()]
    fig = Figure(figsize=(5.2 * max(len(parts), 1.4), 5.6), layout="constrained")
    rows = fig.subplots(3, len(parts), squeeze=False, sharex="col", height_ratios=(3, 2, 1.2))
    for column, part in zip(rows.T, parts, strict=True):
        span = np.flatnonzero(ds["part"].values == part)
        # the warm-up before the fitted part is worth a look
        own = ds["log"].values == str(ds["log"][span[0]].values)
        first = int(span[0]) if part == VALIDATION and own[0] else int(np.argmax(own))
        one = ds.isel(elapsed_time=slice(first, int(span[-1]) + 1))
        _temperature(column[0], one, "T_sup", f"{part}: RMSE {rmse[part]:.2g} K", "supply air [°C]")
        measured = f", RMSE {rmse[part + '_T_w_out']:.2g} K" if part + "_T_w_out" in rmse else ", not measured"
        _temperature(column[1], one, "T_w_out", f"leaving water{measured}", "leaving water [°C]")
        for name, style in (("water", {"color": _MODEL}), ("air", {"color": _HELD_BACK, "ls": "--"})):
            _by_piece(column[2], one, f"m_{name[0]}", lw=1, label=name, **style)
        column[2].set(xlabel="time [h]", ylabel="flow [kg/s]")
        column[2].set_ylim(bottom=0.0)
        _entitled(column[2], "flows")
        for axes in column:
            _shaded(axes, one)
    if (ds["part"] == UNUSED).any():
        fig.supxlabel("Grey: not compared", fontsize=8)
    return fig


def _temperature(axes: Axes, ds: xr.Dataset, name: str, title: str, label: str) -> None:
    if np.isfinite(ds[name]).any():
        _by_piece(axes, ds, name, color=_HELD_BACK, lw=2.2, label="measured")
    _by_piece(axes, ds, f"{name}_modelled", color=_MODEL, lw=1, ls="--", label="modelled")
    axes.set_ylabel(label)
    _entitled(axes, title)


def _entitled(axes: Axes, title: str) -> None:
    """Title and legend above the axes, so that they hide nothing."""
    axes.set_title(title, loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=8, frameon=False, borderaxespad=0.2)


def _by_piece(axes: Axes, ds: xr.Dataset, name: str, **style: Any) -> None:
    """A line with a break wherever the record has one."""
    breaks = np.flatnonzero(np.diff(ds["batch"])) + 1
    hours, values = (np.insert(ds[n].values.astype(float), breaks, np.nan) for n in ("elapsed_time", name))
    axes.plot(hours / 3600, values, **style)


def _shaded(axes: Axes, ds: xr.Dataset) -> None:
    """Samples that are not compared, in grey."""
    hours, unused = ds["elapsed_time"].values / 3600, ds["part"].values == UNUSED
    unused[1:] |= unused[:-1]  # up to the next sample
    bottom_to_top = axes.get_xaxis_transform()
    axes.fill_between(hours, 0.0, 1.0, where=unused, transform=bottom_to_top, color=FAINT, lw=0, zorder=0)


def _thinned(here: Mask) -> Index:
    index = np.flatnonzero(here)
    return index[:: max(index.size // _MOST_POINTS, 1)]

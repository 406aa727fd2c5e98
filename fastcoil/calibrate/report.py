"""Figures of a fit: Fig 2 of the paper and the profile for a valve, Figs 4 and 5 for a coil."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fastcoil.boundary.series import Array
from fastcoil.calibrate.result import FITTING, VALIDATION, Fit
from fastcoil.engine.valve_loop import valve_flows
from fastcoil.plots import COLOURS, STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MODEL, _FITTED, _HELD_BACK = COLOURS
_MOST_POINTS = 4000


def figure(fit: Fit) -> Figure:
    """The figure that suits the kind of fit."""
    from matplotlib import rc_context

    with rc_context(STYLE):
        return _valve(fit) if fit.kind == "valve" else _coil(fit)


def _valve(fit: Fit) -> Figure:
    from matplotlib.figure import Figure

    fig = Figure(figsize=(13, 4.2), layout="constrained")
    parity, curves, profile = fig.subplots(1, 3)
    ds = fit.residuals
    for part, colour in ((FITTING, _FITTED), (VALIDATION, _HELD_BACK)):
        here = _thinned(ds["part"].values == part)
        if here.size:
            style = {"color": colour, "s": 8, "alpha": 0.5, "lw": 0}
            parity.scatter(ds["m_w"][here], ds["modelled"][here], label=part, **style)
            curves.scatter(ds["command"][here], ds["m_w"][here], label=part, **style)
    top = 1.05 * float(np.nanmax(ds["m_w"]))
    parity.plot([0, top], [0, top], color="0.4", lw=0.8)
    parity.set(xlabel="measured flow [kg/s]", ylabel="modelled flow [kg/s]", title="Parity", aspect="equal")
    rising, falling = _branches(fit.extras["curve"], float(fit.extras["floor"]))
    command = np.linspace(0.0, 1.0, rising.size)
    curves.plot(command, rising, color=_MODEL, lw=1.5, label="model, opening")
    curves.plot(command, falling, color=_MODEL, lw=1.5, ls="--", label="model, closing")
    curves.set(xlabel="command [1]", ylabel="flow [kg/s]", title="Data over the hysteresis curves", ylim=(0, top))
    for axes in (parity, curves):
        axes.legend(frameon=False, fontsize=8)
    _profile(profile, fit)
    return fig


def _branches(curve: Array, floor: float) -> tuple[Array, Array]:
    """Flow over the command from 0 to 1, opening and closing."""
    up = np.linspace(0.0, 1.0, 201)
    flows = []
    for command, start in ((up, 1.0), (up[::-1], 0.0)):
        openings, flow = np.empty((up.size, 1)), np.empty((up.size, 1))
        batch = np.zeros(up.size, dtype=np.int64)
        valve_flows(np.ascontiguousarray(command), batch, curve[:, None].copy(), np.full((1, 1), start), openings, flow)
        flows.append(np.maximum(flow[:, 0], floor))
    return flows[0], flows[1][::-1]


def _profile(axes: Axes, fit: Fit) -> None:
    ds = fit.profile
    assert ds is not None
    axes.plot(ds["backlash"], ds["rmse"], color=_MODEL, marker=".", ms=4)
    axes.axhline(ds.attrs["limit"], color="0.4", lw=0.8, ls=":")
    low, high = ds.attrs["interval_95"]
    axes.axvspan(low, high, color=_FITTED, alpha=0.15, lw=0)
    known = "backlash" in fit.parameters
    axes.set(
        xlabel="backlash [1]",
        ylabel="least RMSE of the fitted part [kg/s]",
        title=f"Profile, 95 %: {low:.3g} to {high:.3g}" if known else "Profile: the backlash is not identified",
    )


def _coil(fit: Fit) -> Figure:
    from matplotlib.figure import Figure

    ds = fit.residuals
    parts = [part for part in (FITTING, VALIDATION) if (ds["part"] == part).any()]
    fig = Figure(figsize=(6.5 * len(parts), 6.0), layout="constrained")
    rows = fig.subplots(3, len(parts), squeeze=False, sharex="col", height_ratios=(3, 2, 1.2))
    for column, part in zip(rows.T, parts, strict=True):
        span = np.flatnonzero(ds["part"].values == part)
        # what comes before the fitted part is the warm-up, and worth a look
        one = ds.isel(elapsed_time=slice(0 if part == FITTING else int(span[0]), int(span[-1]) + 1))
        _temperature(column[0], one, "T_sup", f"{part}: RMSE {fit.rmse[part]:.2g} K", "supply air [°C]")
        measured = f", RMSE {fit.rmse[part + '_T_w_out']:.2g} K" if part + "_T_w_out" in fit.rmse else ", not measured"
        _temperature(column[1], one, "T_w_out", f"leaving water{measured}", "leaving water [°C]")
        hours = one["elapsed_time"] / 3600
        column[2].plot(hours, one["m_w"], color=_MODEL, lw=1, label="water")
        column[2].set(xlabel="time [h]", ylabel="water [kg/s]")
        column[2].set_ylim(bottom=0.0)
        for axes in column if part == FITTING else ():
            axes.axvspan(0.0, float(hours[int(np.argmax(one["part"].values == part))]), color="0.5", alpha=0.12, lw=0)
    return fig


def _temperature(axes: Axes, ds: xr.Dataset, name: str, title: str, label: str) -> None:
    hours = ds["elapsed_time"] / 3600
    if np.isfinite(ds[name]).any():
        axes.plot(hours, ds[name], color=_HELD_BACK, lw=1.2, label="measured")
    axes.plot(hours, ds[f"{name}_modelled"], color=_MODEL, lw=1, ls="--", label="modelled")
    axes.set(title=title, ylabel=label)
    axes.legend(frameon=False, fontsize=8)


def _thinned(here: NDArray[np.bool_]) -> NDArray[np.int64]:
    index = np.flatnonzero(here)
    return index[:: max(index.size // _MOST_POINTS, 1)]

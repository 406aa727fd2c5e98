"""Figure of a fitted loop: the profile over the backlash, and the temperatures that it was read from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.figures import BLUE, FAINT, GREY, RED, YELLOW, apply_style
from fastcoil.measured.fit.split import UNUSED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@apply_style()
def loop_figure(residuals: xr.Dataset, profile: xr.Dataset, *, identified: bool) -> Figure:
    """Measured and modelled supply temperature with and without the gap, the command, and the profile.

    residuals, profile: as in the fit.  identified: whether the log identifies the backlash.
    """
    from matplotlib.figure import Figure

    fig = Figure(figsize=(10.5, 5.0), layout="constrained")
    places = fig.add_gridspec(1, 2, width_ratios=(2, 1))
    left, right = fig.add_subfigure(places[0, 0]), fig.add_subfigure(places[0, 1])
    above, below = left.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    looks: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("T_sup", "measured", {"color": YELLOW, "lw": 2.4}),
        ("modelled_without_backlash", "modelled without the gap", {"color": RED, "lw": 1.0, "ls": ":"}),
        ("modelled", "modelled", {"color": BLUE, "lw": 1.0, "ls": "--"}),
    )
    for name, label, style in looks:
        _by_piece(above, residuals, name, label=label, **style)
    above.set_ylabel("supply air [°C]")
    above.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
    _by_piece(below, residuals, "command", 100.0, color=GREY)
    below.set(xlabel="time [h]", ylabel="command [%]")
    hours, unused = residuals["elapsed_time"].values / 3600, residuals["part"].values == UNUSED
    for axes in (above, below):
        axes.fill_between(
            hours, 0.0, 1.0, where=unused, transform=axes.get_xaxis_transform(), color=FAINT, lw=0, zorder=0
        )
    _profile(right.subplots(), profile, identified)
    if unused.any():
        left.supxlabel("Grey: not compared", fontsize=8)
    return fig


def _by_piece(axes: Axes, ds: xr.Dataset, name: str, scale: float = 1.0, **style: Any) -> None:
    """A line with a break wherever the record has one."""
    breaks = np.flatnonzero(np.diff(ds["batch"])) + 1
    hours, values = (np.insert(ds[n].values.astype(float), breaks, np.nan) for n in ("elapsed_time", name))
    axes.plot(hours / 3600, scale * values, **style)


def _profile(axes: Axes, ds: xr.Dataset, identified: bool) -> None:
    axes.plot(100 * ds["backlash"], ds["rmse"], color=BLUE)
    low, high = (100 * bound for bound in ds.attrs["interval_95"])
    axes.axvspan(low, high, color=RED, alpha=0.3, lw=0, label="95 % interval")
    title = f"95 % interval {low:.3g} to {high:.3g} %" if identified else "The backlash is not identified"
    axes.set(xlabel="backlash [%]", ylabel="RMSE of the changes over two minutes [K]", title=title)
    axes.legend(loc="upper center")

"""An explanation on one page: how near the loop is to a cycle, which gains hunt, the day with and without a cure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from fastcoil.explain.answer import answer_of, why_of
from fastcoil.explain.cures import SIMC, TUNINGS
from fastcoil.explain.foretold import HUNTS_ABOVE, margins
from fastcoil.explain.found import Found, Told
from fastcoil.explain.phase import depths
from fastcoil.plots.style import BLUE, DOTTED, FAINT, GREY, RED, YELLOW, apply_style, wrapped

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE = (7.5, 7.5)
_TELLING, _BEFORE = 5400, 600
"""Seconds that are drawn, and how many of them before the worst operating point."""
_ROUND = 2.2
"""Half the width of the Nyquist diagram, unless the loop needs more."""
_SPAN, _TI_STEPS = 8.0, 60
"""The map goes from the gains of now and the cures, divided by this, to as many times them."""
_CONTOURS = (0.4, 0.8, 1.6)
_MARKS = {"lower_kp": "v", "longer_ti": ">", "simc": "s"}


@apply_style()
def page(found: Found) -> Figure:
    """The explanation as a page."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=_SIZE, layout="constrained")
    grid = fig.add_gridspec(2, 2, height_ratios=(1.5, 1.0))
    nyquist, gains = fig.add_subplot(grid[0, 0]), fig.add_subplot(grid[0, 1])
    if found.told is None:
        for axes in (nyquist, gains):
            _says(axes, "theory cannot tell")
    else:
        _nyquist(nyquist, found.told)
        _gains(gains, found, found.told)
    _day(fig.add_subplot(grid[1, :]), found)
    heading = wrapped(f"{answer_of(found)}\n{why_of(found)}", _SIZE[0] - 0.3, 9.0)
    fig.suptitle(heading, x=0.01, ha="left", fontsize=9)
    return fig


def _nyquist(axes: Axes, told: Told) -> None:
    """L at the worst operating point, -1/N, and the margin: how far along its ray L is from -1/N."""
    response = told.response
    L, k = response.L, response.critical
    half = max(_ROUND, 1.15 * abs(L[k]))
    near = np.abs(L) < 4.0 * half
    axes.plot(L.real[near], L.imag[near], color=BLUE, label="loop L(jω)")
    inverse = -1.0 / depths()[1]
    axes.plot(inverse.real, inverse.imag, color=RED, ls="--", label="backlash −1/N")
    axes.plot(-1.0, 0.0, "+", color="black", ms=8)
    edge = L[k] / response.margin[k]
    axes.plot([0.0, edge.real], [0.0, edge.imag], color="black", lw=0.8, ls=DOTTED)
    axes.plot(L[k].real, L[k].imag, "o", color=BLUE, ms=6)
    axes.plot(edge.real, edge.imag, "o", mfc="white", color=RED, ms=6)
    period = 2.0 * math.pi / float(response.w[k])
    axes.annotate(
        f"margin {response.margin[k]:.2g}\nperiod {period:.0f} s",
        (L[k].real, L[k].imag), xytext=(8, -4), textcoords="offset points", va="top", fontsize=8,
    )  # fmt: skip
    axes.set(xlim=(-half, 0.35 * half), ylim=(-half, 0.35 * half), xlabel="real part", ylabel="imaginary part")
    axes.set_aspect("equal")
    axes.set_title("Hunts where L reaches −1/N along its ray", loc="left")
    axes.legend(loc="lower right", frameon=False)


def _gains(axes: Axes, found: Found, told: Told) -> None:
    """Which kp and ti hunt at the worst operating point; the margin goes with kp."""
    foretold, ds = told.foretold, found.cures
    kp, ti = found.value("kp"), found.value("ti")
    tunings = [k for k, name in enumerate(ds["cure"].values) if name in TUNINGS]

    marked = {name: [found.value(name), *(found.with_cure(name, k) for k in tunings)] for name in ("kp", "ti")}
    times = np.geomspace(min(marked["ti"]) / _SPAN, max(marked["ti"]) * _SPAN, _TI_STEPS)
    at_kp = margins(found.loop.assign(ti=("tuning", times)), foretold.plants, np.array([foretold.worst]))[:, 0]
    low, high = min(marked["kp"]) / _SPAN, max(marked["kp"]) * _SPAN
    with np.errstate(divide="ignore"):
        limits = {level: kp * level / at_kp for level in _CONTOURS}
    edge = np.clip(limits[HUNTS_ABOVE], low, high)
    axes.fill_between(times, edge, high, color=FAINT, lw=0, label=f"hunts (margin > {HUNTS_ABOVE:g})")
    for level, style in zip(_CONTOURS, (":", "-", ":"), strict=True):
        axes.plot(times, limits[level], color="black" if level == HUNTS_ABOVE else GREY, lw=1.2, ls=style)
        inside = np.flatnonzero((limits[level] > low * 1.2) & (limits[level] < high / 1.2))
        if inside.size:
            i = inside[inside.size // 3]
            axes.text(times[i], limits[level][i], f"{level:g}", fontsize=7, ha="center", va="center",
                      bbox={"fc": "white", "ec": "none", "pad": 0.6})  # fmt: skip
    axes.plot(ti, kp, "o", color=RED, ms=7, label="as it is")
    for k in tunings:
        name = str(ds["cure"].values[k])
        look: Any = {"color": BLUE if ds["hunts"][k] == 0 else YELLOW, "mec": "black", "mew": 0.6, "ls": "none"}
        axes.plot(found.with_cure("ti", k), found.with_cure("kp", k), _MARKS[name], ms=7, **look,
                  label="SIMC" if name == SIMC else name.replace("_", " "))  # fmt: skip
    axes.set(xscale="log", yscale="log", xlim=(times[0], times[-1]), ylim=(low, high))
    axes.set(xlabel="integral time Ti [s]", ylabel="proportional gain Kp [1/K]")
    axes.set_title("Which gains hunt, by their margin", loc="left")
    axes.legend(loc="lower right", fontsize=7)


def _day(axes: Axes, found: Found) -> None:
    """Part of the day as it is, and with the recommended cure."""
    ds, foretold = found.cures, found.told.foretold if found.told is not None else None
    t = ds["elapsed_time"].values
    middle = int(foretold.points.start[foretold.worst]) if foretold is not None else found.boundary.n_steps // 2
    start = max(0, min(middle - _BEFORE, found.boundary.n_steps - _TELLING))
    seen = (t >= start) & (t < start + _TELLING)
    hours = t[seen] / 3600.0
    T_set = found.boundary.series["T_set"][0][t[seen].astype(int)]
    axes.plot(hours, ds["T_sup"][0][seen], color=RED, lw=1.0, label="as it is")
    if found.best:
        cured = ds.isel(cure=found.best)
        axes.plot(hours, cured["T_sup"][seen], color=BLUE, lw=1.2, label=str(cured["words"].item()))
    axes.plot(hours, T_set, color="black", lw=0.9, ls="--", label="set-point")
    axes.set(xlabel="time from the start [h]", ylabel="supply air [°C]")
    axes.margins(x=0.0)
    axes.set_title("Simulated", loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)


def _says(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=8)
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)

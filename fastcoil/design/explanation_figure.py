"""An explanation on one page: how near the loop is to a cycle, which gains hunt, the day with and without a cure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fastcoil.base.figures import BLUE, DOTTED, FAINT, GREY, RED, YELLOW, apply_style, wrapped
from fastcoil.design.answer import Found, Theory, answer_of, seconds, why_of
from fastcoil.design.cures import SIMC, TUNINGS
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.design.phase_budget import cycles_at, of_a_gap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_SIZE, _WITHOUT_THEORY = (7.5, 7.5), (7.5, 3.8)
_TELLING, _BEFORE = 5400, 600
"""Seconds that are drawn, and how many of them before the worst operating point."""
_PHASES = (-200.0, -85.0)
"""Degrees: where a backlash may bring the phase to -180°, and some more."""
_SPAN, _TI_STEPS = 8.0, 60
"""The map goes from the gains of now and the cures, divided by this, to as many times them."""
_LABEL = 0.85
"""Where on a contour its label is, as a share of its length."""
_CONTOURS = (0.4, HUNTS_ABOVE, 1.7)
_MARKS = {"lower_kp": "v", "longer_ti": ">", "simc": "s"}


@apply_style()
def page(found: Found) -> Figure:
    """The explanation as a page; where theory cannot tell, the day alone."""
    from matplotlib.figure import Figure

    if found.theory is None:
        fig = Figure(figsize=_WITHOUT_THEORY, layout="constrained")
        _day(fig.add_subplot(), found)
    else:
        fig = Figure(figsize=_SIZE, layout="constrained")
        grid = fig.add_gridspec(2, 2, height_ratios=(1.5, 1.0))
        _nichols(fig.add_subplot(grid[0, 0]), found.theory)
        _gains(fig.add_subplot(grid[0, 1]), found, found.theory)
        _day(fig.add_subplot(grid[1, :]), found)
    heading = wrapped(f"{answer_of(found)}\n{why_of(found)}", _SIZE[0] - 0.3, 9.0)
    fig.suptitle(heading, x=0.01, ha="left", fontsize=9)
    return fig


def _nichols(axes: Axes, theory: Theory) -> None:
    """Gain of L and of -1/N over their phase: the margin is how far L is above -1/N at the same phase."""
    from matplotlib.ticker import LogLocator

    response, k = theory.response, theory.response.nearest
    L, phase = np.abs(response.L), response.left - 180.0
    margin, at = theory.prediction.margin, float(phase[k])
    edge = float(L[k]) / margin if margin else float(L[k])
    seen = (phase > _PHASES[0] - 5.0) & (phase < _PHASES[1] + 5.0)
    axes.plot(phase[seen], L[seen], color=BLUE, label="loop L(jω)")
    N = of_a_gap()
    axes.plot(-180.0 - np.degrees(np.angle(N)), 1.0 / np.abs(N), color=RED, ls="--", label="backlash −1/N")
    axes.plot(-180.0, 1.0, "+", color="black", ms=8)
    axes.plot([at, at], [edge, L[k]], color="black", lw=0.9, ls=DOTTED)
    axes.plot(at, L[k], "o", color=BLUE, ms=6)
    axes.plot(at, edge, "o", mfc="white", color=RED, ms=6)
    axes.annotate(
        f"margin {margin:.2g}", (at, edge), xytext=(7, 0), textcoords="offset points", va="center", fontsize=8,
        bbox={"fc": "white", "ec": "none", "pad": 0.6},
    )  # fmt: skip
    if theory.prediction.hunts:
        there = response.cycle
        axes.plot(phase[there], L[there], "D", color=YELLOW, mec="black", mew=0.6, ms=6, ls="none",
                  label=f"cycle, every {seconds(response.period)}")  # fmt: skip
    ends = [edge, float(L[k]), float(L[response.cycle]), 1.0]
    axes.set(yscale="log", xlim=_PHASES, ylim=(0.4 * min(ends), 4.0 * max(ends)), xlabel="phase [°]", ylabel="gain")
    axes.set_xticks(range(-180, -80, 30))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    axes.set_title("Hunts where L is above −1/N", loc="left")
    axes.legend(loc="lower right", frameon=False)


def _gains(axes: Axes, found: Found, theory: Theory) -> None:
    """Which kp and ti hunt at the worst operating point; the margin goes with kp."""
    prediction, ds = theory.prediction, found.cures
    kp, ti = found.value("kp"), found.value("ti")
    tunings = [k for k, name in enumerate(ds["cure"].values) if name in TUNINGS]

    marked = {name: [found.value(name), *(found.with_cure(name, k) for k in tunings)] for name in ("kp", "ti")}
    times = np.geomspace(min(marked["ti"]) / _SPAN, max(marked["ti"]) * _SPAN, _TI_STEPS)
    swept = found.loop.assign(ti=("tuning", times))
    at_kp = cycles_at(swept, prediction.plants, np.array([prediction.worst])).margin[:, 0]
    low, high = min(marked["kp"]) / _SPAN, max(marked["kp"]) * _SPAN
    with np.errstate(divide="ignore"):
        limits = {level: kp * level / at_kp for level in _CONTOURS}
    edge = np.clip(limits[HUNTS_ABOVE], low, high)
    axes.fill_between(times, edge, high, color=FAINT, lw=0, label=f"hunts (margin > {HUNTS_ABOVE:g})")
    for level, style in zip(_CONTOURS, (":", "-", ":"), strict=True):
        axes.plot(times, limits[level], color="black" if level == HUNTS_ABOVE else GREY, lw=1.2, ls=style)
        inside = np.flatnonzero((limits[level] > low * 1.2) & (limits[level] < high / 1.2))
        if inside.size:
            i = inside[int(_LABEL * inside.size)]
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
    ds, prediction = found.cures, found.theory.prediction if found.theory is not None else None
    t = ds["elapsed_time"].values
    middle = int(prediction.points.start[prediction.worst]) if prediction is not None else found.boundary.n_steps // 2
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

"""Figure of ``heating.py``: the coils at rest, a step of the set-point, and two hours with a worn valve."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import fastcoil as fc
from fastcoil.base.figures import BLUE, RED, YELLOW, apply_style
from studies.common import save_figure

COLOURS = {"heating": BLUE, "heating_45": RED}
STYLES = {"heating": "-", "heating_45": "--"}
LEVELS = np.linspace(0.0, 1.0, 41)
BACKLASH, SEED = 0.07, 16301
BEFORE, AFTER = 600, 2400
"""Seconds shown around the step."""


def _rest(panel: Axes) -> None:
    """Supply air over the opening at the design load, and where the presets meet it."""
    for name, colour in COLOURS.items():
        loop, water = fc.Loop.preset(name).assign(backlash=0.0), fc.presets()[name].T_w_in
        sets = np.linspace(9.0, 30.2, 60)
        day = fc.Boundary(
            m_a=1.15, T_a_in=8.76, W_a_in=0.003, T_w_in=water, T_set=np.repeat(sets[:, None], 2, 1), day=np.arange(60)
        )
        rest = fc.linearise(loop, day, at=0)
        panel.plot(100 * rest.opening, rest.T_sup, STYLES[name], color=colour, label=f"{name}, {water:g} °C")
        met = fc.linearise(loop, fc.design_day(0.5, "heating", T_w_in=water), at=0)
        panel.plot(100 * float(met.opening), 25.0, "o", color=colour, ms=5)
    panel.axhline(25.0, color="black", lw=0.8, ls=":")
    panel.annotate("design load", (3, 25.3), fontsize=8)
    panel.set(xlabel="opening [%]", ylabel="supply air at rest [°C]", xlim=(0, 100), ylim=(8, 31),
              title="The coils at rest, -20 °C outdoors")  # fmt: skip
    panel.legend(loc="lower right")


def _steps(panel: Axes, conditions: Callable[[fc.Loop], tuple[fc.Boundary, np.ndarray]], at: int, size: float) -> None:
    """Response to a step: middle and the middle 90 % of the conditions, own gains and those of a cooling loop."""
    own = fc.Loop.preset("heating").assign(backlash=0.0)
    boundary, T_set = conditions(own)
    cooling = fc.Loop.preset("lbnl")
    for label, gains, colour, style in (
        ("gains of heating", own, BLUE, "-"),
        ("gains of lbnl", own.assign(**{n: cooling[n] for n in ("kp", "ti", "sample_time")}), RED, "--"),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of gains made for cooling: they are why it is run
            ds = fc.simulate(gains, boundary, traces=["T_sup"], trace_interval=5)
        T = ds.T_sup.sel(elapsed_time=slice(at - BEFORE, at + AFTER)).transpose("day", "elapsed_time")
        share = 100 * (T.values - T_set[:, None]) / size
        low, middle, high = np.quantile(share, (0.05, 0.5, 0.95), axis=0)
        minutes = (T.elapsed_time.values - at) / 60
        panel.fill_between(minutes, low, high, color=colour, alpha=0.18, lw=0)
        panel.plot(minutes, middle, style, color=colour, label=label)
    panel.axhline(100, color="black", lw=0.8, ls=":")
    panel.set(xlabel="time after the step [min]", ylabel="share of the step [%]", xlim=(-3, 25), ylim=(-15, 155),
              title="A step of 2 K without backlash, 90 % of the conditions")  # fmt: skip
    panel.legend(loc="lower right")


def _worn(panel: Axes) -> None:
    """Two hours of a heating day with a worn valve."""
    loop = fc.Loop.preset("heating").assign(
        backlash=BACKLASH, noise_std=0.02, estimate_ratio=[0.0, 0.95], buffer_ratio=6.0, buffer_swing=0.1,
        plant_gain=25.0,
    )  # fmt: skip
    day = fc.heating_day(8, SEED)
    ds = fc.simulate(loop, day, traces=["T_sup"], trace_interval=10)
    hours = ds.elapsed_time / 3600
    set_point = day.series["T_set"][0][::10]
    panel.plot(hours, set_point, color=YELLOW, lw=2.2, label="set-point")
    for ratio, colour, style, label in ((0.0, BLUE, "-", "plain PI"), (0.95, RED, "--", "inverse of 95 %")):
        panel.plot(hours, ds.T_sup.sel(estimate_ratio=ratio), style, color=colour, lw=1.1, label=label)
    panel.set(
        xlabel="time [h]", ylabel="supply air [°C]", xlim=(4, 6), title=f"heating_day, backlash {100 * BACKLASH:g} %"
    )
    panel.set_ylim(22, 28.5)
    panel.set_xticks([4, 4.5, 5, 5.5, 6])
    panel.legend(loc="upper left")


@apply_style()
def draw(conditions: Callable[[fc.Loop], tuple[fc.Boundary, np.ndarray]], at: int, size: float) -> None:
    """Draw the figure.  conditions: days with a step of ``size`` K at second ``at``, and set-points before it."""
    figure, panels = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
    _rest(panels[0])
    _steps(panels[1], conditions, at, size)
    _worn(panels[2])
    save_figure(figure, "heating/heating.png", dpi=200)

"""The figure of ``wear.py``: the gap over the year, a linkage that comes loose and is repaired, and who notices."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from fastcoil.base.figures import BLUE, RED, YELLOW, apply_style
from studies.common import save_figure
from studies.days import CONSTANT, STEPPED
from studies.wear.detect import AT_ONCE, BEFORE, DAYS, HOURS, Estimates, alarms, threshold_of
from studies.wear.run import Run
from studies.wear.tables import DETECTORS, LABELS
from studies.wear.valves import GROWTH, PI

COLOURS = {PI: "black", "paper": YELLOW, "gradient": RED, "identify": BLUE, "identify_8h": BLUE, "hagglund": "0.55"}
DRAWN = {"bank, plant known": "black", "bank, plant 15 % off": "0.55", "identify": BLUE, "gradient": RED}
"""The detectors that are shown."""
MONTHS = 12
WORN = 0.02
"""Gap from which on a loose linkage is shown, fraction of stroke."""


@apply_style()
def draw(runs: list[Run], chosen_on: Estimates, fresh: Estimates) -> None:
    """Draw the three panels."""
    by_name = {run.sequence.name: run for run in runs}
    figure, panels = plt.subplots(1, 3, figsize=(12.0, 4.6), layout="constrained")
    _grows(panels[0], by_name[STEPPED])
    _loose(panels[1], by_name[f"{STEPPED}, loose and repaired"])
    _noticed(panels[2], chosen_on, fresh)
    save_figure(figure, "wear/wear.png")


def _months(n: int) -> np.ndarray:
    return (np.arange(n) + 1.0) * MONTHS / n


def _mean(gap: xr.DataArray, some: xr.DataArray) -> xr.DataArray:
    """Of some valves, by day; % of stroke."""
    return 100 * gap.where(some).mean("sample")


def _legend(panel: Axes) -> None:
    """Below the panel: the lines fill it."""
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=8, frameon=False)


def _grows(panel: Axes, run: Run) -> None:
    """The mean gap under each controller, and what `identify` takes it for."""
    some = run.growth == max(GROWTH)
    months = _months(run.ds.sizes["day"])
    for name in (PI, "identify", "paper", "gradient"):
        gap = _mean(run.ds.backlash_final.sel(controller=name), some)
        panel.plot(months, gap, color=COLOURS[name], label=f"gap under {LABELS[name]}")
    estimate = _mean(run.ds.estimate_final.sel(controller="identify"), some)
    panel.plot(months, estimate, "o", ms=3, color=BLUE, mfc="white", label="estimate of identify")
    panel.set(xlabel="time [months]", ylabel="gap, mean [% of stroke]", xlim=(0, MONTHS), ylim=(0, None))
    panel.set_title("Wear: set-point steps, the valves that wear most", fontsize=9)
    _legend(panel)


def _loose(panel: Axes, run: Run) -> None:
    """The mean gap of a linkage that comes loose and is repaired, and each estimate."""
    some = run.first >= WORN
    months = _months(run.ds.sizes["day"])
    gap = _mean(run.ds.backlash_final.sel(controller=PI), some)
    panel.step(months, gap, color="black", where="mid", label="gap")
    for name, line in (("identify", "-"), ("identify_8h", "--"), ("hagglund", "-"), ("paper", "-")):
        estimate = _mean(run.ds.estimate_final.sel(controller=name), some)
        panel.plot(months, estimate, line, color=COLOURS[name], label=LABELS[name])
    panel.set(xlabel="time [months]", ylabel="gap, mean [% of stroke]", xlim=(0, MONTHS), ylim=(0, None))
    panel.set_title("A linkage comes loose, and is repaired", fontsize=9)
    _legend(panel)


def _noticed(panel: Axes, chosen_on: Estimates, fresh: Estimates) -> None:
    """The share of the loops whose loose linkage was noticed, over the hours of operation since."""
    hours = np.linspace(0.0, (DAYS - BEFORE) * HOURS, 200)
    for name, colour in DRAWN.items():
        threshold = threshold_of(chosen_on, name)
        if np.isnan(threshold):
            continue
        for kind, line in ((STEPPED, "-"), (CONSTANT, "--")):
            found = alarms(fresh[AT_ONCE, kind], threshold).sel(detector=name).values.ravel()
            share = [100 * float((found <= hour).mean()) for hour in hours]
            panel.plot(hours, share, line, color=colour, label=DETECTORS[name] if line == "-" else None)
    panel.plot([], [], "--", color="0.3", label="dashed: constant set-point")
    panel.set(xlabel="operation since it came loose [h]", ylabel="noticed [% of the loops]", ylim=(-3, 103))
    panel.set_title("Three times the gap at once", fontsize=9)
    _legend(panel)

"""The figure of ``buffer.py``: false turns, the buffer's own cycle, and error and travel, over their formulas."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter
from scipy.special import ndtr

from fastcoil.base.figures import BLUE, FAINT, RED, YELLOW, apply_style
from studies.buffer.lower import NEAR, per_hour
from studies.buffer.rule import (
    LEAST_PHASE,
    LOWER_SCALE,
    POWER,
    UPPER_SCALE,
    describing_function,
    frequency,
    noise_factor,
    phase,
    turns_per_sample,
)
from studies.buffer.run import SHARES, SIZES, SWINGS, Runs
from studies.buffer.upper import SEEN
from studies.common import save_figure
from studies.remedies.tables import pooled

TIMES = {1.0: (BLUE, "o"), 5.0: (RED, "s"), 30.0: (YELLOW, "^")}
"""Sample times that are shown, with colour and mark."""
LEAST_TURNS = 1e-4
"""Turns per sample below which nothing is shown."""
NOT_SEEN = 0.7
"""Where loops without a cycle are drawn."""


@apply_style()
def draw(runs: Runs) -> None:
    """Draw both bounds against simulation, and what the buffer costs between them."""
    figure, panels = plt.subplots(1, 3, figsize=(10.0, 3.7), layout="constrained")
    _turns(panels[0], runs)
    _swings(panels[1], runs)
    _costs(panels[2], runs)
    save_figure(figure, "buffer/buffer.png")


def _turns(panel: Axes, runs: Runs) -> None:
    """False turns per sample over the buffer in standard deviations of u: exact, closed, and of the loops."""
    c = np.linspace(0.0, 8.0, 81)
    panel.plot(c, [turns_per_sample(x) for x in c], color="black", label="white noise, exact")
    panel.plot(c, 0.5 * np.pi * ndtr(-0.5 * c), "--", color="0.55", label="π/2 Q(c/2)")
    everything, valves = pooled(runs.lower), runs.valves[False]
    for time, (colour, mark) in TIMES.items():
        which = valves.sample_time == time
        added = per_hour(everything).isel(sample=which) * time / 3600.0
        unit = float(noise_factor(time)) * LOWER_SCALE
        low, middle, high = (added.quantile(q, ["sample", "day"]).values for q in (0.25, 0.5, 0.75))
        shown = middle > LEAST_TURNS
        at, low = unit * np.array(SIZES)[shown], np.maximum(low[shown], LEAST_TURNS)
        spread = [middle[shown] - np.minimum(low, middle[shown]), (high - middle)[shown]]
        panel.errorbar(
            at, middle[shown], spread, fmt=mark, color=colour, ms=4, lw=0.8, label=f"loops, every {time:g} s"
        )
    panel.set(
        yscale="log", xlim=(0, 8), ylim=(LEAST_TURNS, 1.0), xlabel="buffer / (kp σ)", ylabel="false turns per sample"
    )
    panel.legend(loc="lower left", fontsize=7)
    panel.set_title("lower bound")


def _swings(panel: Axes, runs: Runs) -> None:
    """Swings of the buffer's cycle over the phase margin, with the formula and the describing function."""
    phases = np.linspace(LEAST_PHASE, 0.5 * np.pi, 200)
    curve = UPPER_SCALE * (0.5 * np.pi / phases) ** POWER
    panel.fill_between(np.degrees(phases), curve / NEAR, curve * NEAR, color=FAINT, zorder=0)
    panel.plot(np.degrees(phases), curve, color="black", label="formula, × 1.3, ÷ 1.3")
    amplitude = 0.5 * np.geomspace(1.0, 30.0, 300)
    n = describing_function(amplitude)
    panel.plot(-np.degrees(np.angle(n)), 2.0 * amplitude * abs(n), "--", color="0.45", label="describing function")
    for heats, ds in runs.still.items():
        valves = runs.valves[heats]
        given = (valves.plant, valves.kp, valves.ti)
        exact = ds.isel(share=len(SHARES) - 1).transpose("swing", "sample")
        width = np.array([valves.upper(swing) for swing in SWINGS[1:]])
        unit = width * valves.plant.gain / np.sqrt(1.0 + (frequency(*given) * valves.plant.tau) ** 2)
        seen = exact.hunting_swing.values > SEEN * width * valves.plant.gain
        size = np.where(seen, exact.hunting_swing.values / unit, NOT_SEEN)
        panel.plot(np.broadcast_to(np.degrees(phase(*given)), size.shape).ravel(), size.ravel(), "s" if heats else "o",
                   color=RED if heats else BLUE, ms=2.2, alpha=0.5,
                   label="heating" if heats else "cooling")  # fmt: skip
    panel.axvline(90.0, color="black", lw=0.8, ls=":")
    panel.set(yscale="log", xlim=(0, 130), ylim=(0.6, 8), xlabel="phase margin where |L| = π/4 [°]",
              ylabel="swing / (K b / √(1 + ω²τ²))")  # fmt: skip
    panel.set_yticks([NOT_SEEN, 1, 2, 4, 8], ["no cycle", "1", "2", "4", "8"])
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.legend(loc="upper right", fontsize=7)
    panel.set_title("upper bound: the buffer's own cycle")


def _costs(panel: Axes, runs: Runs) -> None:
    """Error and travel over the buffer, both against those at the lower bound."""
    everything = pooled(runs.lower).isel(noisy=1)
    for metric, colour, style, words in (("rmse", BLUE, "-", "RMSE"), ("motor_travel", RED, "--", "motor travel")):
        mean = everything[metric].transpose("size", "sample", "day").mean("day")
        ratio = mean / mean.isel(size=SIZES.index(1.0))
        low, middle, high = (ratio.quantile(q, "sample").values for q in (0.1, 0.5, 0.9))
        panel.fill_between(SIZES, low, high, color=colour, alpha=0.2, lw=0)
        panel.plot(SIZES, middle, style, color=colour, label=f"{words}, median and 80 %")
    panel.set(yscale="log", xlim=(0, 2), ylim=(0.5, 40), xlabel="buffer / lower bound",
              ylabel="× that at the lower bound")  # fmt: skip
    panel.set_yticks([0.5, 1, 2, 5, 10, 20, 40], ["0.5", "1", "2", "5", "10", "20", "40"])
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.legend(loc="upper right")
    panel.set_title("what it costs")

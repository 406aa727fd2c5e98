"""How large should the buffer of a backlash inverse be?  Costs of the rules for it, the figure, and ``main``.

The constants of the formulas in ``rule.py`` come from valves and days of one seed, the tables from others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter
from scipy.special import ndtr

from fastcoil.base.figures import BLUE, RED, SHADE_GREY, YELLOW, apply_style
from studies.buffer.bounds import (
    NEAR,
    SEEN,
    lower_scales,
    no_buffer_fits,
    per_hour,
    upper_scales,
    write_allowed,
    write_cycles,
    write_lower,
    write_noise,
    write_upper,
)
from studies.buffer.rule import (
    LEAST_PHASE,
    LOWER_SCALE,
    PER_HOUR,
    POWER,
    UPPER_SCALE,
    describing_function,
    frequency,
    noise_factor,
    phase,
    turns_per_sample,
)
from studies.buffer.runs import (
    ALLOWED,
    BY_TREND,
    LOWER,
    PI,
    RULES,
    SHARES,
    SHIPPED,
    SHIPPED_RATIO,
    SIZES,
    SLOWER,
    SWINGS,
    UPPER,
    Runs,
    Valves,
    on_lower,
    on_rules,
    on_still,
    on_upper,
    population,
)
from studies.common import change_in_words, failures, pooled, progress, save_figure, write_table
from studies.days import CONSTANT, HEATING, STEPPED, kinds
from studies.remedies.runs import LEAST_TRAVEL
from studies.remedies.tables import NO_CHANGE

CROSSING = (SHIPPED, BY_TREND, LOWER, UPPER, SLOWER)
"""Rules that are shown where the bounds cross."""
DRAWS = 400
"""Draws of the bootstrap over valves."""


def change(ds: xr.Dataset, rule: str, baseline: str, metric: str = "rmse") -> str:
    """Mean change of a metric in pairs against another rule, with its interval over valves and days.

    A travel below ``LEAST_TRAVEL`` counts as that: a valve that stays open has none to divide by.
    """
    if metric == "motor_travel":
        ds = ds.assign(motor_travel=ds.motor_travel.clip(LEAST_TRAVEL))
    return change_in_words(ds, rule, baseline, metric=metric)


def travel_of(ds: xr.Dataset, rule: str, q: float = 0.5) -> float:
    """Motor travel over that of the plain PI, a quantile over the valves."""
    travel = ds.motor_travel.mean("day")
    return float((travel.sel(controller=rule) / travel.sel(controller=PI)).quantile(q))


def write_rules(runs: Runs) -> None:
    """Every rule for the buffer behind the same gains."""
    ds, good = pooled(runs.rules), runs.valves[False].backlash == 0.0
    table = []
    for rule in RULES:
        error = ds.rmse.sel(controller=rule).mean("day") / ds.rmse.sel(controller=PI).mean("day") - 1.0
        table.append(
            [
                rule,
                change(ds, rule, PI),
                change(ds, rule, SHIPPED),
                f"{100 * float(error.isel(sample=good).median()):+.0f} %",
                f"{float((error > NO_CHANGE).mean()):.0%}",
                f"× {travel_of(ds, rule):.2f}, × {travel_of(ds, rule, 0.95):.1f}",
                change(ds, rule, SHIPPED, "motor_travel"),
                f"{float(ds.hunts.sel(controller=rule).mean()):.1%}",
            ]
        )
    write_table(
        "buffer/buffer_rules",
        "The buffer of an inverse of 95 %: mean change of RMSE against plain PI with the same gains (95 % over valves "
        f"and days); {ds.sizes['sample']} fresh valves and loops, {ds.sizes['day'] // len(runs.rules)} days of each "
        f"kind ({failures([ds])})",
        ["buffer", "RMSE", "RMSE against the shipped rule", "without backlash, median", "over 1 % worse in",
         "motor travel, median, 95 % of the valves", "travel against the shipped rule, mean", "hunting"],
        table,
    )  # fmt: skip
    write_table(
        "buffer/buffer_rules_by_days",
        "The buffer of an inverse of 95 %, by kind of day: mean change of RMSE against plain PI (95 %), and motor "
        "travel of the median valve",
        ["buffer", *runs.rules],
        ([rule, *(f"{change(d, rule, PI)}, × {travel_of(d, rule):.2f}" for d in runs.rules.values())]
         for rule in RULES[1:]),
    )  # fmt: skip


def shipped_width(valves: Valves) -> Any:
    """Buffer of the shipped rule with the noise as it is: 6 kp σ, up to ``ALLOWED`` over the plant's gain."""
    return np.minimum(SHIPPED_RATIO * valves.kp * valves.sigma, ALLOWED / valves.plant.gain)


def write_crossing(runs: Runs) -> None:
    """Loops on which no buffer fits: the lower bound lies above the upper one."""
    table = []
    for heats, valves in runs.valves.items():
        ds = pooled({kind: ds for kind, ds in runs.rules.items() if (kind == HEATING) == heats})
        lower, upper, shipped = valves.lower, valves.upper(ALLOWED), shipped_width(valves)
        for which, words in ((no_buffer_fits(valves), "none fits"), (~no_buffer_fits(valves), "some fit")):
            if which.sum() < 2:
                continue
            d, loop_gain = ds.isel(sample=which), (valves.kp * valves.plant.gain)[which]
            table.append(
                [
                    f"{'heating' if heats else 'cooling'}, {words}",
                    f"{which.mean():.0%}",
                    f"{np.median(valves.sigma[which]):.3f}, {np.median(loop_gain):.2f}",
                    f"{(shipped < lower)[which].mean():.0%}, {(shipped > upper)[which].mean():.0%}",
                    *(f"{change(d, rule, PI)}, × {travel_of(d, rule):.2f}" for rule in CROSSING),
                ]
            )
    write_table(
        "buffer/buffer_crossing",
        f"Loops for which no buffer fits, and the others.  None fits where holding false reversals to {PER_HOUR:g} per "
        f"hour needs a wider buffer than a swing of {ALLOWED:g} K allows; change of RMSE against plain PI with "
        "existing gains (95 %), and motor travel of the median valve",
        ["loops", "share", "median noise in K, kp K", "shipped below the lower, above the upper bound", *CROSSING],
        table,
    )


def median_of(values: Any) -> str:
    """Median of (n_valves, n) cases and its 95 % interval by a bootstrap over the valves; NaN does not count."""
    rng = np.random.default_rng(1)
    picks = rng.integers(len(values), size=(DRAWS, len(values)))
    drawn = [np.nanquantile(values[pick], 0.5, method="nearest") for pick in picks]
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{np.nanquantile(values, 0.5, method='nearest'):.2f} ({low:.2f} to {high:.2f})"


def write_constants(choice: Runs, fresh: Runs) -> None:
    """The constants as the choice gives them, and as fresh valves would."""
    found = [
        ["lower bound", f"{LOWER_SCALE:g}", *(median_of(lower_scales(runs)) for runs in (choice, fresh))],
        ["swing", f"{UPPER_SCALE:g}", *(median_of(upper_scales(runs)) for runs in (choice, fresh))],
    ]
    n = [len(runs.valves[False].kp) for runs in (choice, fresh)]
    write_table(
        "buffer/buffer_constants",
        f"The two fitted constants: as used, as fitted to the {n[0]} valves of the choice (95 % over valves), and as "
        f"fitted to {n[1]} fresh valves",
        ["of", "in use", "choice", "fresh"],
        found,
    )


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
    for seconds, (colour, mark) in TIMES.items():
        which = valves.sample_time == seconds
        added = per_hour(everything).isel(sample=which) * seconds / 3600.0
        unit = float(noise_factor(seconds)) * LOWER_SCALE
        low, middle, high = (added.quantile(q, ["sample", "day"]).values for q in (0.25, 0.5, 0.75))
        shown = middle > LEAST_TURNS
        at, low = unit * np.array(SIZES)[shown], np.maximum(low[shown], LEAST_TURNS)
        spread = [middle[shown] - np.minimum(low, middle[shown]), (high - middle)[shown]]
        panel.errorbar(
            at, middle[shown], spread, fmt=mark, color=colour, ms=4, lw=0.8, label=f"loops, every {seconds:g} s"
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
    panel.fill_between(np.degrees(phases), curve / NEAR, curve * NEAR, color=SHADE_GREY, zorder=0)
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


CHOICE, FRESH = 15, 1501
"""Seeds of the valves that the constants come from, and of those of the tables."""
CHOICE_DAYS, FRESH_DAYS = (5101, 5102), (5201, 5202, 5203)
CHOICE_KINDS = (CONSTANT, STEPPED, HEATING)
VALVES = 256


def run(size: int, seed: int, some: Sequence[str], days: Sequence[int], *, everything: bool = True) -> Runs:
    """All runs on valves of a seed; without ``everything`` those that the constants come from."""
    done = progress()
    groups = {False: [k for k in some if k != HEATING], True: [k for k in some if k == HEATING]}
    valves = {heats: population(size, seed, group[0]) for heats, group in groups.items() if group}
    found = Runs(valves, {}, {heats: on_still(v, groups[heats][0]) for heats, v in valves.items()}, {}, {})
    for kind in some:
        found.lower[kind] = on_lower(found.of(kind), kind, days)
        if everything:
            found.upper[kind] = on_upper(found.of(kind), kind, days)
            found.rules[kind] = on_rules(found.of(kind), kind, days)
        done(kind)
    return found


def sample() -> None:
    """What noise alone does."""
    write_noise()


def main(size: int = VALVES) -> None:
    """Run everything, write the tables and draw the figure; ``size``: so many valves."""
    choice = run(size, CHOICE, CHOICE_KINDS, CHOICE_DAYS, everything=False)
    fresh = run(size, FRESH, kinds(), FRESH_DAYS)
    write_noise()
    write_constants(choice, fresh)
    write_lower(fresh)
    write_allowed(fresh)
    write_cycles(fresh)
    write_upper(fresh)
    write_rules(fresh)
    write_crossing(fresh)
    draw(fresh)

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
    NEAR_FACTOR,
    VISIBLE_SWING,
    added_turns_per_hour,
    has_no_fitting_buffer,
    lower_scales,
    upper_scales,
    write_allowed_turns,
    write_cycles,
    write_lower_bound,
    write_noise,
    write_upper_bound,
)
from studies.buffer.rule import (
    ALLOWED_TURNS_PER_HOUR,
    LEAST_PHASE,
    LOWER_SCALE,
    SWING_POWER,
    UPPER_SCALE,
    cycle_frequency,
    describing_function,
    noise_factor,
    phase_margin,
    turns_per_sample,
)
from studies.buffer.runs import (
    ALLOWED_SWING,
    BUFFER_MULTIPLES,
    BY_TREND,
    ESTIMATE_SHARES,
    LOWER_BOUND,
    PI,
    RULES,
    SHIPPED_RATIO,
    SHIPPED_RULE,
    SLOWER_PI,
    SWINGS,
    UPPER_BOUND,
    Runs,
    Valves,
    population,
    run_lower,
    run_rules,
    run_still,
    run_upper,
)
from studies.common import change_in_words, failures_in_words, pool_days, progress_printer, save_figure, write_table
from studies.days import CONSTANT, HEATING, STEPPED, kinds
from studies.remedies.runs import LEAST_TRAVEL
from studies.remedies.tables import HARM_SHARE

CROSSING_RULES = (SHIPPED_RULE, BY_TREND, LOWER_BOUND, UPPER_BOUND, SLOWER_PI)
"""Rules that are shown where the bounds cross."""
BOOTSTRAP_DRAWS = 400  # draws of the bootstrap over valves


def format_rule_change(ds: xr.Dataset, rule: str, baseline: str, metric: str = "rmse") -> str:
    """Mean change of a metric in pairs against another rule, with its interval over valves and days.

    A travel below ``LEAST_TRAVEL`` counts as that: a valve that stays open has none to divide by.
    """
    if metric == "motor_travel":
        ds = ds.assign(motor_travel=ds.motor_travel.clip(LEAST_TRAVEL))
    return change_in_words(ds, rule, baseline, metric=metric)


def relative_travel(ds: xr.Dataset, rule: str, q: float = 0.5) -> float:
    """Motor travel over that of the plain PI, a quantile over the valves."""
    travel = ds.motor_travel.mean("day")
    return float((travel.sel(controller=rule) / travel.sel(controller=PI)).quantile(q))


def write_rules(runs: Runs) -> None:
    """Write the results of every buffer rule with the same gains."""
    ds, is_good = pool_days(runs.rules), runs.valves[False].backlash == 0.0
    table = []
    for rule in RULES:
        error = ds.rmse.sel(controller=rule).mean("day") / ds.rmse.sel(controller=PI).mean("day") - 1.0
        table.append(
            [
                rule,
                format_rule_change(ds, rule, PI),
                format_rule_change(ds, rule, SHIPPED_RULE),
                f"{100 * float(error.isel(sample=is_good).median()):+.0f} %",
                f"{float((error > HARM_SHARE).mean()):.0%}",
                f"× {relative_travel(ds, rule):.2f}, × {relative_travel(ds, rule, 0.95):.1f}",
                format_rule_change(ds, rule, SHIPPED_RULE, "motor_travel"),
                f"{float(ds.hunts.sel(controller=rule).mean()):.1%}",
            ]
        )
    write_table(
        "buffer/buffer_rules",
        "The buffer of an inverse of 95 %: mean change of RMSE against plain PI with the same gains (95 % over valves "
        f"and days); {ds.sizes['sample']} fresh valves and loops, {ds.sizes['day'] // len(runs.rules)} days of each "
        f"kind ({failures_in_words([ds])})",
        ["buffer", "RMSE", "RMSE against the shipped rule", "without backlash, median", "over 1 % worse in",
         "motor travel, median, 95 % of the valves", "travel against the shipped rule, mean", "hunting"],
        table,
    )  # fmt: skip
    write_table(
        "buffer/buffer_rules_by_days",
        "The buffer of an inverse of 95 %, by kind of day: mean change of RMSE against plain PI (95 %), and motor "
        "travel of the median valve",
        ["buffer", *runs.rules],
        ([rule, *(f"{format_rule_change(d, rule, PI)}, × {relative_travel(d, rule):.2f}" for d in runs.rules.values())]
         for rule in RULES[1:]),
    )  # fmt: skip


def shipped_width(valves: Valves) -> Any:
    """Buffer of the shipped rule with the noise as it is: 6 kp σ, up to ``ALLOWED_SWING`` over the plant's gain."""
    return np.minimum(SHIPPED_RATIO * valves.kp * valves.sigma, ALLOWED_SWING / valves.plant.gain)


def write_crossing(runs: Runs) -> None:
    """Write the loops for which no buffer fits: their lower bound lies above the upper one."""
    table = []
    for is_heating, valves in runs.valves.items():
        ds = pool_days({kind: ds for kind, ds in runs.rules.items() if (kind == HEATING) == is_heating})
        lower, upper, shipped_buffer = valves.lower_bound, valves.upper_bound(ALLOWED_SWING), shipped_width(valves)
        for among, label in (
            (has_no_fitting_buffer(valves), "none fits"),
            (~has_no_fitting_buffer(valves), "some fit"),
        ):
            if among.sum() < 2:
                continue
            part, loop_gain = ds.isel(sample=among), (valves.kp * valves.plant.gain)[among]
            table.append(
                [
                    f"{'heating' if is_heating else 'cooling'}, {label}",
                    f"{among.mean():.0%}",
                    f"{np.median(valves.sigma[among]):.3f}, {np.median(loop_gain):.2f}",
                    f"{(shipped_buffer < lower)[among].mean():.0%}, {(shipped_buffer > upper)[among].mean():.0%}",
                    *(
                        f"{format_rule_change(part, rule, PI)}, × {relative_travel(part, rule):.2f}"
                        for rule in CROSSING_RULES
                    ),
                ]
            )
    write_table(
        "buffer/buffer_crossing",
        "Loops for which no buffer fits, and the others.  None fits where holding false reversals to "
        f"{ALLOWED_TURNS_PER_HOUR:g} per "
        f"hour needs a wider buffer than a swing of {ALLOWED_SWING:g} K allows; change of RMSE against plain PI with "
        "existing gains (95 %), and motor travel of the median valve",
        [
            "loops",
            "share",
            "median noise in K, kp K",
            "shipped below the lower, above the upper bound",
            *CROSSING_RULES,
        ],
        table,
    )


def format_median(values: Any) -> str:
    """Median of (n_valves, n) cases and its 95 % interval by a bootstrap over the valves; NaN does not count."""
    rng = np.random.default_rng(1)
    resamples = rng.integers(len(values), size=(BOOTSTRAP_DRAWS, len(values)))
    medians = [np.nanquantile(values[resample], 0.5, method="nearest") for resample in resamples]
    low, high = np.quantile(medians, [0.025, 0.975])
    return f"{np.nanquantile(values, 0.5, method='nearest'):.2f} ({low:.2f} to {high:.2f})"


def write_constants(choice: Runs, fresh: Runs) -> None:
    """Write the constants fitted to the choice, and to fresh valves."""
    rows = [
        ["lower bound", f"{LOWER_SCALE:g}", *(format_median(lower_scales(runs)) for runs in (choice, fresh))],
        ["swing", f"{UPPER_SCALE:g}", *(format_median(upper_scales(runs)) for runs in (choice, fresh))],
    ]
    n = [len(runs.valves[False].kp) for runs in (choice, fresh)]
    write_table(
        "buffer/buffer_constants",
        f"The two fitted constants: as used, as fitted to the {n[0]} valves of the choice (95 % over valves), and as "
        f"fitted to {n[1]} fresh valves",
        ["of", "in use", "choice", "fresh"],
        rows,
    )


SAMPLE_TIME_LOOKS = {1.0: (BLUE, "o"), 5.0: (RED, "s"), 30.0: (YELLOW, "^")}
"""Sample times that are shown, with colour and mark."""
LEAST_TURNS_PER_SAMPLE = 1e-4  # turns per sample below which nothing is shown
NO_CYCLE_LEVEL = 0.7  # where loops without a cycle are drawn


@apply_style()
def draw(runs: Runs) -> None:
    """Draw both bounds against simulation, and what the buffer costs between them."""
    figure, panels = plt.subplots(1, 3, figsize=(10.0, 3.7), layout="constrained")
    _draw_turns(panels[0], runs)
    _draw_swings(panels[1], runs)
    _draw_costs(panels[2], runs)
    save_figure(figure, "buffer/buffer.png")


def _draw_turns(panel: Axes, runs: Runs) -> None:
    """False turns per sample over the buffer in standard deviations of u: exact, closed, and of the loops."""
    c = np.linspace(0.0, 8.0, 81)
    panel.plot(c, [turns_per_sample(x) for x in c], color="black", label="white noise, exact")
    panel.plot(c, 0.5 * np.pi * ndtr(-0.5 * c), "--", color="0.55", label="π/2 Q(c/2)")
    pooled_days, valves = pool_days(runs.lower), runs.valves[False]
    for seconds, (colour, marker) in SAMPLE_TIME_LOOKS.items():
        among = valves.sample_time == seconds
        turns = added_turns_per_hour(pooled_days).isel(sample=among) * seconds / 3600.0
        unit = float(noise_factor(seconds)) * LOWER_SCALE
        low, middle, high = (turns.quantile(q, ["sample", "day"]).values for q in (0.25, 0.5, 0.75))
        is_shown = middle > LEAST_TURNS_PER_SAMPLE
        positions, low = unit * np.array(BUFFER_MULTIPLES)[is_shown], np.maximum(low[is_shown], LEAST_TURNS_PER_SAMPLE)
        error_bars = [middle[is_shown] - np.minimum(low, middle[is_shown]), (high - middle)[is_shown]]
        panel.errorbar(
            positions,
            middle[is_shown],
            error_bars,
            fmt=marker,
            color=colour,
            ms=4,
            lw=0.8,
            label=f"loops, every {seconds:g} s",
        )
    panel.set(
        yscale="log",
        xlim=(0, 8),
        ylim=(LEAST_TURNS_PER_SAMPLE, 1.0),
        xlabel="buffer / (kp σ)",
        ylabel="false turns per sample",
    )
    panel.legend(loc="lower left", fontsize=7)
    panel.set_title("lower bound")


def _draw_swings(panel: Axes, runs: Runs) -> None:
    """Swings of the buffer's cycle over the phase margin, with the formula and the describing function."""
    phases = np.linspace(LEAST_PHASE, 0.5 * np.pi, 200)
    curve = UPPER_SCALE * (0.5 * np.pi / phases) ** SWING_POWER
    panel.fill_between(np.degrees(phases), curve / NEAR_FACTOR, curve * NEAR_FACTOR, color=SHADE_GREY, zorder=0)
    panel.plot(np.degrees(phases), curve, color="black", label="formula, × 1.3, ÷ 1.3")
    amplitude = 0.5 * np.geomspace(1.0, 30.0, 300)
    n = describing_function(amplitude)
    panel.plot(-np.degrees(np.angle(n)), 2.0 * amplitude * abs(n), "--", color="0.45", label="describing function")
    for is_heating, ds in runs.still.items():
        valves = runs.valves[is_heating]
        plant_and_gains = (valves.plant, valves.kp, valves.ti)
        exact_inverse_ds = ds.isel(share=len(ESTIMATE_SHARES) - 1).transpose("swing", "sample")
        width = np.array([valves.upper_bound(swing) for swing in SWINGS[1:]])
        unit = width * valves.plant.gain / np.sqrt(1.0 + (cycle_frequency(*plant_and_gains) * valves.plant.tau) ** 2)
        has_cycle = exact_inverse_ds.hunting_swing.values > VISIBLE_SWING * width * valves.plant.gain
        heights = np.where(has_cycle, exact_inverse_ds.hunting_swing.values / unit, NO_CYCLE_LEVEL)
        panel.plot(np.broadcast_to(np.degrees(phase_margin(*plant_and_gains)), heights.shape).ravel(), heights.ravel(),
                   "s" if is_heating else "o",
                   color=RED if is_heating else BLUE, ms=2.2, alpha=0.5,
                   label="heating" if is_heating else "cooling")  # fmt: skip
    panel.axvline(90.0, color="black", lw=0.8, ls=":")
    panel.set(yscale="log", xlim=(0, 130), ylim=(0.6, 8), xlabel="phase margin where |L| = π/4 [°]",
              ylabel="swing / (K b / √(1 + ω²τ²))")  # fmt: skip
    panel.set_yticks([NO_CYCLE_LEVEL, 1, 2, 4, 8], ["no cycle", "1", "2", "4", "8"])
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.legend(loc="upper right", fontsize=7)
    panel.set_title("upper bound: the buffer's own cycle")


def _draw_costs(panel: Axes, runs: Runs) -> None:
    """Error and travel over the buffer, both against those at the lower bound."""
    noisy_days = pool_days(runs.lower).isel(noisy=1)
    for metric, colour, style, label in (("rmse", BLUE, "-", "RMSE"), ("motor_travel", RED, "--", "motor travel")):
        mean = noisy_days[metric].transpose("size", "sample", "day").mean("day")
        ratio = mean / mean.isel(size=BUFFER_MULTIPLES.index(1.0))
        low, middle, high = (ratio.quantile(q, "sample").values for q in (0.1, 0.5, 0.9))
        panel.fill_between(BUFFER_MULTIPLES, low, high, color=colour, alpha=0.2, lw=0)
        panel.plot(BUFFER_MULTIPLES, middle, style, color=colour, label=f"{label}, median and 80 %")
    panel.set(yscale="log", xlim=(0, 2), ylim=(0.5, 40), xlabel="buffer / lower bound",
              ylabel="× that at the lower bound")  # fmt: skip
    panel.set_yticks([0.5, 1, 2, 5, 10, 20, 40], ["0.5", "1", "2", "5", "10", "20", "40"])
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.legend(loc="upper right")
    panel.set_title("what it costs")


CHOICE_SEED, FRESH_SEED = 15, 1501
"""Seeds of the valves that the constants come from, and of those of the tables."""
CHOICE_DAYS, FRESH_DAYS = (5101, 5102), (5201, 5202, 5203)
CHOICE_KINDS = (CONSTANT, STEPPED, HEATING)
VALVES = 256


def run(size: int, seed: int, day_kinds: Sequence[str], day_seeds: Sequence[int], *, is_complete: bool = True) -> Runs:
    """Run valves of a seed on all days; unless ``is_complete``, only the runs that the constants come from."""
    report = progress_printer()
    groups = {False: [k for k in day_kinds if k != HEATING], True: [k for k in day_kinds if k == HEATING]}
    valves = {is_heating: population(size, seed, group[0]) for is_heating, group in groups.items() if group}
    runs = Runs(
        valves, {}, {is_heating: run_still(v, groups[is_heating][0]) for is_heating, v in valves.items()}, {}, {}
    )
    for kind in day_kinds:
        runs.lower[kind] = run_lower(runs.valves_on(kind), kind, day_seeds)
        if is_complete:
            runs.upper[kind] = run_upper(runs.valves_on(kind), kind, day_seeds)
            runs.rules[kind] = run_rules(runs.valves_on(kind), kind, day_seeds)
        report(kind)
    return runs


def sample() -> None:
    """Write the table of noise alone."""
    write_noise()


def main(size: int = VALVES) -> None:
    """Run everything, write the tables and draw the figure; ``size``: so many valves."""
    choice = run(size, CHOICE_SEED, CHOICE_KINDS, CHOICE_DAYS, is_complete=False)
    fresh = run(size, FRESH_SEED, kinds(), FRESH_DAYS)
    write_noise()
    write_constants(choice, fresh)
    write_lower_bound(fresh)
    write_allowed_turns(fresh)
    write_cycles(fresh)
    write_upper_bound(fresh)
    write_rules(fresh)
    write_crossing(fresh)
    draw(fresh)

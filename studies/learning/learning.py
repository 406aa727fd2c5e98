"""Which learning rule to ship: tables and figures.

A rule is chosen for each loop and noise on ``learning_step.toml``, and tried on fresh days; ``learning_failures.toml``
has noise and sample time, ``learner.toml`` the rule of the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy.stats import beta

import fastcoil as fc
from fastcoil.base.figures import write_figures
from studies.common import RESULTS, results, write_table
from studies.learning import maps as learning_maps

TOO_LOW, TOO_HIGH = 0.8, 1.2
"""A final estimate outside these shares of the backlash is a failure: the learner stopped early, or ran away."""
MOST_FAILURES = 0.05
CONFIDENCE = 0.95
RESAMPLES = 2000
CHOICE_DIMS = ["rule", "learning_step", "learning_interval", "learning_ratio", "buffer"]
LOOP_DIMS = ["tuning", "noise_std"]
PAIRED_DIMS = ["backlash", "backlash_estimate", "day"]
HOURS = 16
FRESH_DAYS = range(301, 401)


def judge_learners(ds: xr.Dataset, dims: Sequence[str] = PAIRED_DIMS) -> xr.Dataset:
    """Shares of failures, error, and hours to reach and confirm, over all days, backlashes and starts."""
    estimate_ratio = (ds.estimate_final / ds.backlash).round(9)  # steps of 1.4 % reach 80 % of 7 % but for round-off
    hours = {n: ds[f"learn_time_{n}"].fillna(np.inf) / 3600.0 for n in ("reached", "confirmed")}
    return xr.Dataset(
        {
            "low": (estimate_ratio < TOO_LOW).mean(dims),
            "high": (estimate_ratio > TOO_HIGH).mean(dims),
            # an estimate of NaN fails, too
            "failed": (~((estimate_ratio >= TOO_LOW) & (estimate_ratio <= TOO_HIGH))).mean(dims),
            "error": abs(estimate_ratio - 1.0).reduce(lower_median, dims),
            # never is later than all else: the median is censored where it is infinite
            "never": np.isinf(hours["confirmed"]).mean(dims),
            "reached": hours["reached"].reduce(lower_median, dims),
            "confirmed": hours["confirmed"].reduce(lower_median, dims),
        }
    )


def lower_median(values: np.ndarray, axis: int | tuple[int, ...] = -1) -> np.ndarray:
    """Lower median: always one of the values, so that they may be infinite."""
    axes = {k % values.ndim for k in np.atleast_1d(axis)}
    kept_axes = [k for k in range(values.ndim) if k not in axes]
    rows = np.sort(
        values.transpose(*kept_axes, *sorted(axes)).reshape(*(values.shape[k] for k in kept_axes), -1), axis=-1
    )
    return rows[..., (rows.shape[-1] - 1) // 2]


def best_choice(judgement: xr.Dataset) -> dict[str, Any]:
    """The safe choice that confirms soonest; ties go to the more accurate.  Where none is safe, the safest."""
    flat = judgement.stack(choice=CHOICE_DIMS)
    excess = np.maximum(flat.failed.values.round(9) - MOST_FAILURES, 0.0)
    best = flat.isel(choice=int(np.lexsort((flat.error.values, flat.confirmed.values, excess))[0]))
    return dict(zip(CHOICE_DIMS, best.choice.item(), strict=True))


def try_choice(ds: xr.Dataset, choice: dict[str, Any], loop: dict[str, Any], days: fc.Boundary) -> xr.Dataset:
    """Simulate a choice on fresh days, and what it costs.

    ``rmse`` and ``travel`` of the motor are relative to the plain PI of the same backlash, day and noise,
    ``rmse_known`` to an inverse that knows the backlash from the start, with the same buffer.
    """
    learner = fc.Loop.from_dataset(ds.sel(choice | loop).isel(day=0))
    plain_loop = learner.assign(learning_step=0.0, backlash_estimate=0.0, buffer=fc.parameters()["buffer"].default)
    known_loop = learner.assign(learning_step=0.0, backlash_estimate=xr.DataArray(ds.backlash))
    learned, plain, with_known = (fc.simulate(variant, days) for variant in (learner, plain_loop, known_loop))
    kept_metrics = ["estimate_final", "learn_time_reached", "learn_time_confirmed", "switch_frequency"]
    return learned[kept_metrics].assign(
        rmse=learned.rmse / plain.rmse - 1.0,
        rmse_known=learned.rmse / with_known.rmse - 1.0,
        travel=learned.motor_travel / plain.motor_travel,
        plain_switches=plain.switch_frequency.broadcast_like(learned.rmse),
    )


def share_with_interval(failed: float, n_days: int) -> str:
    """A share with its interval (Clopper and Pearson), as if the learners of one day failed together."""
    k, tail = failed * n_days, 0.5 - 0.5 * CONFIDENCE
    low = beta.ppf(tail, k, n_days - k + 1) if k > 0 else 0.0
    high = beta.ppf(1.0 - tail, k + 1, n_days - k) if k < n_days else 1.0
    return f"{100 * failed:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def median_with_interval(values: xr.DataArray) -> tuple[float, float, float]:
    """Median over all days, backlashes and starts, and its bootstrap interval, which draws whole days."""
    by_day = values.transpose("day", ...).values.reshape(values.sizes["day"], -1)
    day_indices = np.random.default_rng(0).integers(len(by_day), size=(RESAMPLES, len(by_day)))
    medians = np.sort(lower_median(by_day[day_indices], (1, 2)))
    last = RESAMPLES - 1
    low, high = (medians[round(last * q)] for q in (0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE))
    return float(lower_median(by_day, (0, 1))), float(low), float(high)


def median_in_words(values: xr.DataArray, template: str, scale: float = 1.0) -> str:
    """A median with its interval; a time beyond the day is given as such."""
    texts = [template.format(scale * x) if np.isfinite(x) else f"> {HOURS}" for x in median_with_interval(values)]
    return "{} ({} to {})".format(*texts)


def write_recommendations(ds: xr.Dataset, judgement: xr.Dataset) -> None:
    """Write the choice for each loop and noise, and for all, with its performance and cost on fresh days."""
    days = fc.paper_day(hours=HOURS, seed=FRESH_DAYS)
    loops = [
        {"tuning": str(t), "noise_std": float(n)}
        for t, n in product(judgement.tuning.values, judgement.noise_std.values)
    ]
    choice_rows, cost_rows = [], []
    for loop in [*loops, {}]:
        loop_judgement = judgement.sel(loop) if loop else judge_learners(ds, [*PAIRED_DIMS, *LOOP_DIMS])
        choice = best_choice(loop_judgement)
        fresh_ds = try_choice(ds, choice, loop, days)
        fresh_judgement = judge_learners(fresh_ds, fresh_ds.estimate_final.dims)
        name = [loop["tuning"], f"{loop['noise_std']:g}"] if loop else ["all", "all"]
        choice_rows.append(
            [*name, *describe_choice(choice),
             "yes" if fresh_judgement.failed <= MOST_FAILURES else "**none is safe**; the best:",
             f"{100 * float(loop_judgement.failed.sel(choice)):.0f} %",
             share_with_interval(float(fresh_judgement.failed), days.n_days)]
        )  # fmt: skip
        time_reached, time_confirmed = (fresh_ds[f"learn_time_{n}"].fillna(np.inf) for n in ("reached", "confirmed"))
        cost_rows.append(
            [*name, median_in_words(time_reached, "{:.0f}", 1 / 60), median_in_words(time_confirmed, "{:.0f}", 1 / 60),
             share_with_interval(float(fresh_judgement.never), days.n_days),
             median_in_words(abs(fresh_ds.estimate_final / fresh_ds.backlash - 1), "{:.0f}", 100),
             median_in_words(fresh_ds.rmse, "{:+.0f}", 100), median_in_words(fresh_ds.rmse_known, "{:+.0f}", 100),
             median_in_words(fresh_ds.travel, "{:.2f}"),
             f"{median_in_words(fresh_ds.switch_frequency, '{:.1f}')}; {float(fresh_ds.plain_switches.median()):.1f}"]
        )  # fmt: skip
    write_table(
        "learning/learning_choice",
        "The learning rule and settings to ship, for each loop and noise",
        ["loop", "noise, K", "rule", "step", "interval", "ratio", "buffer", "safe?", "failures: days chosen on",
         f"{days.n_days} fresh days"],
        choice_rows,
    )  # fmt: skip
    write_table(
        "learning/learning_cost",
        f"Performance of the chosen learning rules on the {days.n_days} fresh days: medians",
        ["loop", "noise, K", "reached, min", "confirmed, min", "never confirmed", "error of the estimate, %",
         "RMSE against plain PI, %", "RMSE against known backlash, %", "motor travel / plain PI",
         "switches per 10 min; plain PI"],
        cost_rows,
    )  # fmt: skip


def describe_choice(choice: dict[str, Any]) -> list[str]:
    """Rule, step, interval, ratio and buffer in words."""
    return [
        choice["rule"],
        f"{100 * choice['learning_step']:.2g} %",
        f"{choice['learning_interval'] / 60:.0f} min",
        f"{choice['learning_ratio']:g}",
        f"{100 * choice['buffer']:.0f} %",
    ]


def write_failures(judgement: xr.Dataset) -> None:
    """Write how often each rule fails over loops and noise, over all its settings."""
    other_dims = [d for d in CHOICE_DIMS if d not in ("rule", "buffer")]
    low, high = (100 * judgement[n].mean(other_dims) for n in ("low", "high"))
    write_table(
        "learning/learning_failures",
        "How often the rules fail: stops early / runs away, % of learners",
        [
            "loop",
            "noise, K",
            *(f"{r}, buffer {100 * b:.0f} %" for r in judgement.rule.values for b in judgement.buffer.values),
        ],
        (
            [str(t), f"{n:g}"]
            + [
                f"{float(low.sel(tuning=t, noise_std=n, rule=r, buffer=b)):.0f} / "
                f"{float(high.sel(tuning=t, noise_std=n, rule=r, buffer=b)):.0f}"
                for r in judgement.rule.values
                for b in judgement.buffer.values
            ]
            for t in judgement.tuning.values
            for n in judgement.noise_std.values
        ),
    )


def write_quiet(ds: xr.Dataset, judgement: xr.Dataset) -> None:
    """Write the final estimates on a day on which nothing changes: of each rule, and of the choice without noise."""
    still_day, valve_settings = fc.constant_day(hours=HOURS), {"backlash": 0.07, "backlash_estimate": 0.0}
    printed_settings = {"learning_step": 0.007, "learning_interval": 1800, "learning_ratio": 2.0}
    cell = ds.isel(day=0, noise_std=0, buffer=0).sel(printed_settings | valve_settings)
    final_estimates = fc.simulate(fc.Loop.from_dataset(cell), still_day).estimate_final
    loops = [{"tuning": str(t), "noise_std": 0.0} for t in ds.tuning.values]
    shipped_loops = [
        fc.Loop.from_dataset(ds.isel(day=0).sel(loop | best_choice(judgement.sel(loop)) | valve_settings))
        for loop in loops
    ]
    write_table(
        "learning/learning_quiet",
        "A perfectly quiet day: backlash 7 %, steps of 0.7 % every 30 min, final estimate",
        ["loop", *map(str, final_estimates.rule.values), "the choice to ship"],
        (
            [loop["tuning"]]
            + [f"{100 * float(x):.1f} %" for x in final_estimates.sel(tuning=loop["tuning"])]
            + [f"{100 * float(fc.simulate(choice, still_day).estimate_final):.1f} %"]
            for loop, choice in zip(loops, shipped_loops, strict=True)
        ),
    )


def draw_figures(ds: xr.Dataset, judgement: xr.Dataset) -> dict[str, Figure]:
    """Time against failures and error, maps over the settings, maps over noise and sample time."""
    by_sensor = results("learning_failures").load()
    dims_with_noise, backlash_and_day = [*PAIRED_DIMS, "noise_std"], ["backlash", "day"]
    noises = ", ".join(f"{n:g}" for n in ds.noise_std.values)
    bold_note = f"Bold: at most {100 * MOST_FAILURES:.0f} % fail."
    best_note = "The best of all steps, intervals, ratios and buffers."
    return {
        "learning_front": learning_maps.draw_front(judgement, "failed", "failures [% of learners]", 100.0, HOURS,
                                                   best_note),
        "learning_front_error": learning_maps.draw_front(judgement, "error", "error of the estimate [%]", 50.0, HOURS,
                                                         best_note),
        "learning_settings": learning_maps.draw_settings(
            judge_learners(ds.isel(buffer=-1), dims_with_noise), ("literal", "growing"), HOURS, MOST_FAILURES,
            f"Buffer {100 * float(ds.buffer[-1]):.0f} %, noise of {noises} K together: "
            f"{_n_learners(ds, dims_with_noise)} learners a cell.  {bold_note}",
        ),
        "learning_failures": learning_maps.draw_failure_map(
            judge_learners(by_sensor, backlash_and_day), MOST_FAILURES,
            f"{_n_learners(by_sensor, backlash_and_day)} learners a cell.  {bold_note}"
        ),
    }  # fmt: skip


def _n_learners(ds: xr.Dataset, dims: Sequence[str]) -> int:
    return int(np.prod([ds.sizes[d] for d in dims]))


def sample() -> None:
    """Run a sample of the study: the rule as it is printed."""
    write_printed_rule()


def main() -> None:
    """Write the tables, draw the figures."""
    ds = results("learning_step").load()
    judgement = judge_learners(ds)
    write_recommendations(ds, judgement)
    write_failures(judgement)
    write_quiet(ds, judgement)
    write_printed_rule()
    for path in write_figures(draw_figures(ds, judgement), RESULTS / "learning_step" / "figures"):
        print(path)


def write_printed_rule() -> None:
    """Write how often and when the printed rule reaches the backlash, and where it ends."""
    ds = results("learner")
    n_days = ds.sizes["day"]
    rows = []
    for rule in ds.rule.values:
        for loop in ds.loop.values:
            d = ds.sel(rule=rule, loop=loop)
            time_reached, time_confirmed = d.learn_time_reached, d.learn_time_confirmed
            rows.append(
                [
                    rule,
                    loop,
                    f"{int(time_reached.notnull().sum())} of {n_days}",
                    median_hours(time_reached),
                    f"{int(time_confirmed.notnull().sum())} of {n_days}",
                    median_hours(time_confirmed),
                    f"{float(d.estimate_first_down.median()):.3f}",
                    f"{float(d.estimate_final.median()):.3f}",
                ]
            )
    head = ["rule", "loop", "reached on", "after", "confirmed on", "after", "first step down to", "final estimate"]
    write_table("learning/learner", f"The self-learning rule: backlash 7 %, {n_days} days of 8 h", head, rows)


def median_hours(times: xr.DataArray) -> str:
    """Median time in hours; a dash where fewer than half of the days have one, for the others come later than all."""
    in_time = times.fillna(float("inf")).median()
    return f"{float(in_time) / 3600:.2f} h" if float(in_time) < float("inf") else "—"

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
LEVEL = 0.95
RESAMPLES = 2000
CHOICE = ["rule", "learning_step", "learning_interval", "learning_ratio", "buffer"]
LOOPS = ["tuning", "noise_std"]
PAIRED = ["backlash", "backlash_estimate", "day"]
HOURS = 16
FRESH_DAYS = range(301, 401)


def judged(ds: xr.Dataset, over: Sequence[str] = PAIRED) -> xr.Dataset:
    """Shares of failures, error, and hours to reach and confirm, over all days, backlashes and starts."""
    learned = (ds.estimate_final / ds.backlash).round(9)  # steps of 1.4 % reach 80 % of 7 % but for round-off
    hours = {n: ds[f"learn_time_{n}"].fillna(np.inf) / 3600.0 for n in ("reached", "confirmed")}
    return xr.Dataset(
        {
            "low": (learned < TOO_LOW).mean(over),
            "high": (learned > TOO_HIGH).mean(over),
            # an estimate of NaN fails, too
            "failed": (~((learned >= TOO_LOW) & (learned <= TOO_HIGH))).mean(over),
            "error": abs(learned - 1.0).reduce(middle, over),
            # never is later than all else: the median is censored where it is infinite
            "never": np.isinf(hours["confirmed"]).mean(over),
            "reached": hours["reached"].reduce(middle, over),
            "confirmed": hours["confirmed"].reduce(middle, over),
        }
    )


def middle(values: np.ndarray, axis: int | tuple[int, ...] = -1) -> np.ndarray:
    """Lower median: always one of the values, so that they may be infinite."""
    axes = {k % values.ndim for k in np.atleast_1d(axis)}
    kept = [k for k in range(values.ndim) if k not in axes]
    rows = np.sort(values.transpose(*kept, *sorted(axes)).reshape(*(values.shape[k] for k in kept), -1), axis=-1)
    return rows[..., (rows.shape[-1] - 1) // 2]


def chosen(of: xr.Dataset) -> dict[str, Any]:
    """The safe choice that confirms soonest; ties go to the more accurate.  Where none is safe, the safest."""
    flat = of.stack(choice=CHOICE)
    beyond = np.maximum(flat.failed.values.round(9) - MOST_FAILURES, 0.0)
    best = flat.isel(choice=int(np.lexsort((flat.error.values, flat.confirmed.values, beyond))[0]))
    return dict(zip(CHOICE, best.choice.item(), strict=True))


def tried(ds: xr.Dataset, choice: dict[str, Any], loop: dict[str, Any], days: fc.Boundary) -> xr.Dataset:
    """What a choice does on fresh days, and what it costs.

    ``rmse`` and ``travel`` of the motor are relative to the plain PI of the same backlash, day and noise,
    ``rmse_known`` to an inverse that knows the backlash from the start, with the same buffer.
    """
    learner = fc.Loop.from_dataset(ds.sel(choice | loop).isel(day=0))
    without = learner.assign(learning_step=0.0, backlash_estimate=0.0, buffer=fc.parameters()["buffer"].default)
    known = learner.assign(learning_step=0.0, backlash_estimate=xr.DataArray(ds.backlash))
    found, plain, exact = (fc.simulate(of, days) for of in (learner, without, known))
    kept = ["estimate_final", "learn_time_reached", "learn_time_confirmed", "switch_frequency"]
    return found[kept].assign(
        rmse=found.rmse / plain.rmse - 1.0,
        rmse_known=found.rmse / exact.rmse - 1.0,
        travel=found.motor_travel / plain.motor_travel,
        plain_switches=plain.switch_frequency.broadcast_like(found.rmse),
    )


def share_with_interval(failed: float, n_days: int) -> str:
    """A share with its interval (Clopper and Pearson), as if the learners of one day failed together."""
    k, tail = failed * n_days, 0.5 - 0.5 * LEVEL
    low = beta.ppf(tail, k, n_days - k + 1) if k > 0 else 0.0
    high = beta.ppf(1.0 - tail, k + 1, n_days - k) if k < n_days else 1.0
    return f"{100 * failed:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def median_with_interval(values: xr.DataArray) -> tuple[float, float, float]:
    """Median over all days, backlashes and starts, and its bootstrap interval, which draws whole days."""
    by_day = values.transpose("day", ...).values.reshape(values.sizes["day"], -1)
    drawn = np.random.default_rng(0).integers(len(by_day), size=(RESAMPLES, len(by_day)))
    medians = np.sort(middle(by_day[drawn], (1, 2)))
    last = RESAMPLES - 1
    low, high = (medians[round(last * q)] for q in (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL))
    return float(middle(by_day, (0, 1))), float(low), float(high)


def words(values: xr.DataArray, form: str, scale: float = 1.0) -> str:
    """A median with its interval; a time beyond the day is given as such."""
    texts = [form.format(scale * x) if np.isfinite(x) else f"> {HOURS}" for x in median_with_interval(values)]
    return "{} ({} to {})".format(*texts)


def recommendations(ds: xr.Dataset, of: xr.Dataset) -> None:
    """For each loop and noise, and for all together, the choice, how it did on fresh days, and what it cost there."""
    days = fc.paper_day(hours=HOURS, seed=FRESH_DAYS)
    loops = [{"tuning": str(t), "noise_std": float(n)} for t, n in product(of.tuning.values, of.noise_std.values)]
    ship, found = [], []
    for loop in [*loops, {}]:
        here = of.sel(loop) if loop else judged(ds, [*PAIRED, *LOOPS])
        choice = chosen(here)
        new = tried(ds, choice, loop, days)
        failed = judged(new, new.estimate_final.dims)
        name = [loop["tuning"], f"{loop['noise_std']:g}"] if loop else ["all", "all"]
        ship.append(
            [*name, *described(choice), "yes" if failed.failed <= MOST_FAILURES else "**none is safe**; the best:",
             f"{100 * float(here.failed.sel(choice)):.0f} %", share_with_interval(float(failed.failed), days.n_days)]
        )  # fmt: skip
        reached, confirmed = (new[f"learn_time_{n}"].fillna(np.inf) for n in ("reached", "confirmed"))
        found.append(
            [*name, words(reached, "{:.0f}", 1 / 60), words(confirmed, "{:.0f}", 1 / 60),
             share_with_interval(float(failed.never), days.n_days),
             words(abs(new.estimate_final / new.backlash - 1), "{:.0f}", 100),
             words(new.rmse, "{:+.0f}", 100), words(new.rmse_known, "{:+.0f}", 100), words(new.travel, "{:.2f}"),
             f"{words(new.switch_frequency, '{:.1f}')}; {float(new.plain_switches.median()):.1f}"]
        )  # fmt: skip
    write_table(
        "learning/learning_choice",
        "The learning rule and settings to ship, for each loop and noise",
        ["loop", "noise, K", "rule", "step", "interval", "ratio", "buffer", "safe?", "failures: days chosen on",
         f"{days.n_days} fresh days"],
        ship,
    )  # fmt: skip
    write_table(
        "learning/learning_cost",
        f"Performance of the chosen learning rules on the {days.n_days} fresh days: medians",
        ["loop", "noise, K", "reached, min", "confirmed, min", "never confirmed", "error of the estimate, %",
         "RMSE against plain PI, %", "RMSE against known backlash, %", "motor travel / plain PI",
         "switches per 10 min; plain PI"],
        found,
    )  # fmt: skip


def described(choice: dict[str, Any]) -> list[str]:
    """Rule, step, interval, ratio and buffer in words."""
    return [
        choice["rule"],
        f"{100 * choice['learning_step']:.2g} %",
        f"{choice['learning_interval'] / 60:.0f} min",
        f"{choice['learning_ratio']:g}",
        f"{100 * choice['buffer']:.0f} %",
    ]


def failures(of: xr.Dataset) -> None:
    """How often each rule fails over loops and noise, all of its settings together."""
    rest = [d for d in CHOICE if d not in ("rule", "buffer")]
    low, high = (100 * of[n].mean(rest) for n in ("low", "high"))
    write_table(
        "learning/learning_failures",
        "How often the rules fail: stops early / runs away, % of learners",
        ["loop", "noise, K", *(f"{r}, buffer {100 * b:.0f} %" for r in of.rule.values for b in of.buffer.values)],
        (
            [str(t), f"{n:g}"]
            + [
                f"{float(low.sel(tuning=t, noise_std=n, rule=r, buffer=b)):.0f} / "
                f"{float(high.sel(tuning=t, noise_std=n, rule=r, buffer=b)):.0f}"
                for r in of.rule.values
                for b in of.buffer.values
            ]
            for t in of.tuning.values
            for n in of.noise_std.values
        ),
    )


def quiet(ds: xr.Dataset, of: xr.Dataset) -> None:
    """A day on which nothing changes: where each rule ends, and where the choice for no noise does."""
    still, valve = fc.constant_day(hours=HOURS), {"backlash": 0.07, "backlash_estimate": 0.0}
    printed = {"learning_step": 0.007, "learning_interval": 1800, "learning_ratio": 2.0}
    cell = ds.isel(day=0, noise_std=0, buffer=0).sel(printed | valve)
    found = fc.simulate(fc.Loop.from_dataset(cell), still).estimate_final
    loops = [{"tuning": str(t), "noise_std": 0.0} for t in ds.tuning.values]
    shipped = [fc.Loop.from_dataset(ds.isel(day=0).sel(loop | chosen(of.sel(loop)) | valve)) for loop in loops]
    write_table(
        "learning/learning_quiet",
        "A perfectly quiet day: backlash 7 %, steps of 0.7 % every 30 min, final estimate",
        ["loop", *map(str, found.rule.values), "the choice to ship"],
        (
            [loop["tuning"]]
            + [f"{100 * float(x):.1f} %" for x in found.sel(tuning=loop["tuning"])]
            + [f"{100 * float(fc.simulate(choice, still).estimate_final):.1f} %"]
            for loop, choice in zip(loops, shipped, strict=True)
        ),
    )


def figures(ds: xr.Dataset, of: xr.Dataset) -> dict[str, Figure]:
    """Time against failures and error, maps over the settings, maps over noise and sample time."""
    by_sensor = results("learning_failures").load()
    noises_too, days = [*PAIRED, "noise_std"], ["backlash", "day"]
    noises = ", ".join(f"{n:g}" for n in ds.noise_std.values)
    bold = f"Bold: at most {100 * MOST_FAILURES:.0f} % fail."
    best = "The best of all steps, intervals, ratios and buffers."
    return {
        "learning_front": learning_maps.front(of, "failed", "failures [% of learners]", 100.0, HOURS, best),
        "learning_front_error": learning_maps.front(of, "error", "error of the estimate [%]", 50.0, HOURS, best),
        "learning_settings": learning_maps.settings(
            judged(ds.isel(buffer=-1), noises_too), ("literal", "growing"), HOURS, MOST_FAILURES,
            f"Buffer {100 * float(ds.buffer[-1]):.0f} %, noise of {noises} K together: "
            f"{_learners(ds, noises_too)} learners a cell.  {bold}",
        ),
        "learning_failures": learning_maps.failure_map(
            judged(by_sensor, days), MOST_FAILURES, f"{_learners(by_sensor, days)} learners a cell.  {bold}"
        ),
    }  # fmt: skip


def _learners(ds: xr.Dataset, over: Sequence[str]) -> int:
    return int(np.prod([ds.sizes[d] for d in over]))


def sample() -> None:
    """The rule as it is printed."""
    printed_rule()


def main() -> None:
    """Write the tables, draw the figures."""
    ds = results("learning_step").load()
    of = judged(ds)
    recommendations(ds, of)
    failures(of)
    quiet(ds, of)
    printed_rule()
    for path in write_figures(figures(ds, of), RESULTS / "learning_step" / "figures"):
        print(path)


def printed_rule() -> None:
    """When the rule reaches the backlash, how often, and where it ends."""
    ds = results("learner")
    n_days = ds.sizes["day"]
    rows = []
    for rule in ds.rule.values:
        for loop in ds.loop.values:
            d = ds.sel(rule=rule, loop=loop)
            reached, confirmed = d.learn_time_reached, d.learn_time_confirmed
            rows.append(
                [
                    rule,
                    loop,
                    f"{int(reached.notnull().sum())} of {n_days}",
                    hours(reached),
                    f"{int(confirmed.notnull().sum())} of {n_days}",
                    hours(confirmed),
                    f"{float(d.estimate_first_down.median()):.3f}",
                    f"{float(d.estimate_final.median()):.3f}",
                ]
            )
    head = ["rule", "loop", "reached on", "after", "confirmed on", "after", "first step down to", "final estimate"]
    write_table("learning/learner", f"The self-learning rule: backlash 7 %, {n_days} days of 8 h", head, rows)


def hours(times: xr.DataArray) -> str:
    """Median time in hours; a dash where fewer than half of the days have one, for the others come later than all."""
    in_time = times.fillna(float("inf")).median()
    return f"{float(in_time) / 3600:.2f} h" if float(in_time) < float("inf") else "—"

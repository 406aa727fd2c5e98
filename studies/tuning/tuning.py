"""Default answers: kp, ti and buffer of each preset for the valves that it may meet.

A population of valves, backlash 0 to 15 % and some without any, meets days of every kind.  ``fc.tune`` chooses gains
for all of them, for a plain PI and for an inverse of 95 %, with no more motor travel than the preset and next to no
hunting.  Fresh valves and fresh days say what that is worth, beside the preset, SIMC on each valve and the best plain
PI of a valve with 7 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.design.measures import Measure, with_intervals
from fastcoil.design.tuning_plan import Group, simc_changes
from fastcoil.design.tuning_result import Tuning
from fastcoil.model.metric_table import WARM_UP_S
from studies.common import (
    change_in_words,
    compare_rows,
    concat_along,
    format_change,
    mean_change,
    share_of,
    write_table,
)
from studies.days import HEATING, kinds, loop_settings, make_days
from studies.robustness.best_pi import best_gains

VALVES, FRESH_VALVES = 180, 96
GOOD_EVERY = 12  # one valve of so many has no backlash
LARGEST_BACKLASH = 0.15
NOISE_STD = 0.02  # measurement noise, K
SEARCH_DAYS, HOLDOUT_DAYS, FRESH_DAYS = (5101, 5102), (5201, 5202, 5203), (5301, 5302, 5303)
SEARCH = {"kp": (0.003, 0.4), "ti": (5.0, 600.0), "buffer": (0.0, 0.01)}
HUNTING_LIMIT = 0.05  # largest share of valves and days that may hunt
EVALUATIONS = 160
ESTIMATE_RATIO = 0.95  # estimate over backlash of the inverse


PRESET, SIMC, BEST_PI, TUNED_PI, TUNED_INVERSE = "preset", "SIMC", "best PI of 7 %", "tuned PI", "tuned 95 % inverse"
KEPT_METRICS = ("rmse", "motor_travel", "hunts", "status")


class Case(NamedTuple):
    """A preset in cooling or heating."""

    preset: str
    heating: bool

    @property
    def words(self) -> str:
        return f"`{self.preset}`, heating" if self.heating else f"`{self.preset}`"

    @property
    def kinds(self) -> list[str]:
        return [kind for kind in kinds() if (kind == HEATING) == self.heating]

    def loop(self, size: int, seed: int) -> fc.Loop:
        """A population of the preset."""
        gaps = np.random.default_rng([seed, size]).uniform(0.0, LARGEST_BACKLASH, size)
        gaps[::GOOD_EVERY] = 0.0
        loop = fc.Loop.preset(self.preset).assign(converged=True, noise_std=NOISE_STD, backlash=("sample", gaps))
        return loop.assign(**loop_settings(self.kinds[0]))

    def days(self, seeds: Sequence[int]) -> fc.Boundary:
        """A day of every kind for each seed."""
        parts = [make_days(kind, [seed + 100_000 * k for seed in seeds]) for k, kind in enumerate(self.kinds)]
        series = {name: np.concatenate([part.series[name] for part in parts]) for name in parts[0].series}
        return fc.Boundary(**series, day=np.concatenate([part.day for part in parts]))


CASES = (*(Case(preset, False) for preset in ("paper_like", "paper_like_fast", "lbnl", "g36")), Case("lbnl", True))


def tune_case(case: Case) -> tuple[Tuning, Tuning]:
    """Gains and buffer for the population: of a plain PI, and of an inverse that travels no more than the preset."""
    loop, limits = case.loop(VALVES, 1), {"motor_travel": "now", "hunts": (HUNTING_LIMIT, "mean")}
    tunings: list[Tuning] = []
    for ratio in (0.0, ESTIMATE_RATIO):
        tunings.append(
            fc.tune(
                loop.assign(estimate_ratio=ratio), case.days(SEARCH_DAYS), search=SEARCH, limits=limits,
                holdout=case.days(HOLDOUT_DAYS), evaluations=EVALUATIONS,
            )
        )  # fmt: skip
        limits["motor_travel"] = tunings[0].limits[0].most
    return tunings[0], tunings[1]


def compare_tunings(case: Case, pi: Tuning, inverse: Tuning) -> tuple[dict[str, xr.Dataset], dict[str, str]]:
    """Simulate every tuning on fresh valves and days; return results by kind of day, and the settings as text."""
    fresh = case.loop(FRESH_VALVES, 2)
    simc = simc_changes(Group(fresh, case.days(SEARCH_DAYS), tuple(range(FRESH_VALVES))), list(SEARCH), WARM_UP_S)
    best = best_gains(
        fc.Loop.preset(case.preset).assign(converged=True, noise_std=NOISE_STD, backlash=0.07), case.kinds
    )
    loops = {
        PRESET: fresh,
        SIMC: fresh.assign(**simc),
        BEST_PI: fresh.assign(kp=float(best.kp), ti=float(best.ti)),
        TUNED_PI: fresh.assign(**pi.parameters),
        TUNED_INVERSE: fresh.assign(estimate_ratio=ESTIMATE_RATIO, **inverse.parameters),
    }
    settings_text = {
        name: ", ".join(f"{float(np.median(np.asarray(loop[n]))):.3g}" for n in ("kp", "ti"))
        + f", {100 * float(loop['buffer']):.2g}"  # type: ignore[arg-type]
        for name, loop in loops.items()
    }
    by_kind = {}
    for kind in case.kinds:
        days = make_days(kind, FRESH_DAYS)
        datasets = {n: fc.simulate(loop, days)[list(KEPT_METRICS)].reset_coords(drop=True) for n, loop in loops.items()}
        ds = concat_along("tuning", datasets)
        by_kind[kind] = ds.assign_coords(backlash=("sample", np.asarray(fresh["backlash"])))
    return by_kind, settings_text


def tuning_rows(case: Case, by_kind: dict[str, xr.Dataset], settings_text: dict[str, str]) -> list[list[str]]:
    """A row for each tuning: what it does on fresh valves and days of all kinds together."""
    ds = xr.concat(list(by_kind.values()), "day").transpose("tuning", "day", "sample")
    measures = [Measure("rmse", 0.95), Measure("motor_travel", 0.95), Measure("hunts", None)]
    cases = {m.metric: ds[m.metric].values[..., None] for m in measures}
    table = with_intervals(cases, measures, [str(t) for t in ds.tuning.values], 0)
    largest_travel = float(table.motor_travel_p95.sel(tuning=PRESET, edge="value"))
    rows = []
    for tuning in map(str, ds.tuning.values):
        tuning_ds = table.sel(tuning=tuning)
        change = (100 * tuning_ds.change).values
        keeps_limits = (
            float(tuning_ds.motor_travel_p95[0]) <= largest_travel and float(tuning_ds.hunts_mean[0]) <= HUNTING_LIMIT
        )
        good_valve_ds = ds.rmse.isel(sample=(ds.backlash == 0.0).values)
        rows.append(
            [
                case.words,
                tuning,
                settings_text[tuning],
                "{:.3f} ({:.3f} to {:.3f})".format(*tuning_ds.rmse_p95.values),
                "—" if tuning == PRESET else "{:+.0f} % ({:+.0f} to {:+.0f})".format(*change),
                f"{Measure('rmse', 0.95).evaluate(good_valve_ds.sel(tuning=tuning).values.ravel()):.3f}",
                "{:.1f} ({:.1f} to {:.1f})".format(*tuning_ds.motor_travel_p95.values),
                "{:.0f} % ({:.0f} to {:.0f})".format(*(100 * tuning_ds.hunts_mean.values)),
                "yes" if keeps_limits else "no",
            ]
        )
    return rows


def kind_rows(case: Case, by_kind: dict[str, xr.Dataset]) -> list[list[str]]:
    """A row for each kind of day: every tuning against the preset."""
    rows = []
    for kind, ds in by_kind.items():
        cells = []
        for tuning in (SIMC, BEST_PI, TUNED_PI, TUNED_INVERSE):
            travel = float(ds.motor_travel.sel(tuning=tuning).mean() / ds.motor_travel.sel(tuning=PRESET).mean())
            cells.append(f"{change_in_words(ds, tuning, PRESET, 'tuning')}, × {travel:.2f}")
        rows.append([case.words, kind, f"{float(ds.rmse.sel(tuning=PRESET).mean()):.3f}", *cells])
    return rows


def failure_rows(case: Case, by_kind: dict[str, xr.Dataset]) -> list[list[str]]:
    """Where a tuning does worse than the preset, or hunts, good valves on their own."""
    rows = []
    for kind, ds in by_kind.items():
        groups = {"all": ds, "X = 0": ds.isel(sample=(ds.backlash == 0.0).values)}
        for tuning in (SIMC, BEST_PI, TUNED_PI, TUNED_INVERSE):
            for label, group in groups.items():
                change = mean_change(group, tuning, PRESET, "tuning")
                share_of_hunting = share_of(group.hunts.sel(tuning=tuning))
                if change[1] > 0.0 or share_of_hunting.low > HUNTING_LIMIT:
                    rows.append([case.words, kind, tuning, label, format_change(*change), str(share_of_hunting)])
    return rows


def sample() -> None:
    """Run a sample of the study: the first loop."""
    case = CASES[0]
    by_kind, _ = compare_tunings(case, *tune_case(case))
    compare_rows("tuning/tuning_kinds", kind_rows(case, by_kind))


def main() -> None:
    """Tune every case and write the tables."""
    all_rows: list[list[str]] = []
    rows_by_kind: list[list[str]] = []
    failed_rows: list[list[str]] = []
    for case in CASES:
        pi, inverse = tune_case(case)
        by_kind, settings_text = compare_tunings(case, pi, inverse)
        all_rows += tuning_rows(case, by_kind, settings_text)
        rows_by_kind += kind_rows(case, by_kind)
        failed_rows += failure_rows(case, by_kind)
        print(f"tuned {case.words}", *pi.notes, *inverse.notes, sep="\n  ", flush=True)
    fresh_text = f"{FRESH_VALVES} fresh valves, {len(FRESH_DAYS)} fresh days of each kind"
    write_table(
        "tuning/tuning_failures",
        "Where a tuning fails: RMSE significantly above that of the preset, or significantly more than "
        f"{100 * HUNTING_LIMIT:.0f} % of the days hunting; {fresh_text}",
        ["loop", "days", "tuning", "valves", "change of RMSE (95 %)", "hunting (95 %)"],
        failed_rows,
    )
    write_table(
        "tuning/tuning",
        f"Default answers, chosen on {VALVES - VALVES // 3} valves of 0 to {100 * LARGEST_BACKLASH:.0f} % backlash and "
        f"{len(SEARCH_DAYS)} days of each kind with no more motor travel than the preset; numbers of {fresh_text}",
        ["loop", "tuning", "kp in 1/K, ti in s, buffer in %", "RMSE, 95 % quantile, K", "change", "the same, X = 0",
         "motor travel, 95 % quantile", "hunting", "limits kept"],
        all_rows,
    )  # fmt: skip
    write_table(
        "tuning/tuning_kinds",
        f"Every tuning against the preset, by kind of day: mean change of RMSE (95 % over valves and days), × motor "
        f"travel; {fresh_text}",
        ["loop", "days", "RMSE of the preset, K", SIMC, BEST_PI, TUNED_PI, TUNED_INVERSE],
        rows_by_kind,
    )

"""What backlash does in a heating loop, which remedy helps or harms there, and whether theory predicts it.

Valves of 0 to 15 %, one of five without backlash, meet heating days of four kinds: set-points that step, a constant
set-point, design days, and winter days of a weather file where there is one.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import change_in_words, concat_along, share_of, write_table
from studies.days import HEATING, OUTDOOR_FRACTION, WEATHER_FILE, make_days
from studies.inverse.conditions import GROWING_RULE
from studies.learning.identify_online import IDENTIFY_SETTINGS

PRESETS = ("heating", "heating_45")
VALVES = 60
GOOD_EVERY = 5  # one valve of so many has no backlash
LARGEST_BACKLASH = 0.15  # backlash of the worst valve
VALVES_SEED, DAYS = 16101, (16111, 16112, 16113, 16114)
NOISE = 0.02  # measurement noise, K
T_SET = 25.0
PLANT_GAIN = 25.0  # of either coil at its design load, K per stroke
PI, TUNED_PI = "plain PI", "PI by `fc.tune`"
REMEDIES = {
    PI: {},
    "half kp": {"kp": 0.0125},
    "95 % inverse": {"estimate_ratio": 0.95},
    "95 %, buffer by noise": {
        "estimate_ratio": 0.95, "buffer_ratio": 6.0, "buffer_swing": 0.1, "plant_gain": PLANT_GAIN,
    },
    "`identify`": IDENTIFY_SETTINGS | {"plant_gain": PLANT_GAIN},
    "growing rule": GROWING_RULE,
}  # fmt: skip
SEARCH_SEED, SEARCH_DAYS, HOLDOUT_DAYS = 16102, (16121, 16122), (16123, 16124)
SEARCH = {"kp": (0.003, 0.3), "ti": (5.0, 600.0)}
LIMITS = {"motor_travel": "now", "hunts": (0.05, "mean"), "hunting_index": (0.8, 1.0)}
EVALUATIONS = 64
"""How the gains of ``fc.tune`` are sought: no more motor travel than the preset, and hardly any hunting."""
KEPT_METRICS = ("rmse", "motor_travel", "hunts", "status")
STEPPED, CONSTANT, DESIGN, WINTER = "stepped", "constant", "design", "winter weather"
WINTER_DAYS = (*range(1, 60), *range(335, 366))
LOOPS, POINTS, THEORY_SEED = 60, 16, 16202
"""Drawn loops and conditions of the comparison with theory."""
DRAWN_GAINS = {
    "kp 0.01 to 0.1, ti 15 to 200": ((0.01, 0.1), (15.0, 200.0)),
    "kp 0.01 to 0.2, ti 8 to 200": ((0.01, 0.2), (8.0, 200.0)),
}
HELD_SECONDS, WARM_UP_SECONDS = 8 * 3600, 4 * 3600
"""Of held conditions, and of them what is not counted."""


def valves(preset: str, seed: int = VALVES_SEED) -> fc.Loop:
    """Valves along ``sample``."""
    gaps = np.random.default_rng(seed).uniform(0.0, LARGEST_BACKLASH, VALVES)
    gaps[::GOOD_EVERY] = 0.0
    return fc.Loop.preset(preset).assign(backlash=("sample", gaps), noise_std=NOISE)


def days_by_kind(T_w_in: float, seeds: Sequence[int] = DAYS) -> dict[str, fc.Boundary]:
    """Days of each kind, with water of this temperature."""
    stepped = fc.heating_day(seed=list(seeds), T_w_in=T_w_in)
    series = {n: stepped.series[n] for n in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
    design = make_days(HEATING, seeds).series
    by_kind = {
        STEPPED: stepped,
        CONSTANT: fc.Boundary(**series, T_set=T_SET, day=list(seeds)),
        DESIGN: fc.Boundary(**(series | {n: design[n] for n in ("T_a_in", "W_a_in")}), T_set=T_SET, day=list(seeds)),
    }
    if WEATHER_FILE.is_file():
        by_kind[WINTER] = _winter_days(series, seeds)
    return by_kind


def _winter_days(series: dict[str, np.ndarray], seeds: Sequence[int]) -> fc.Boundary:
    """Winter days of the file, with the air flow and water of the other kinds."""
    days_of_year = [int(np.random.default_rng([seed, 15]).choice(WINTER_DAYS)) for seed in seeds]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # hourly data have no fast disturbances: the water has them
        air = [
            fc.weather_day(
                WEATHER_FILE, days=[day], hour=6, hours=8, m_a=1.0, T_w_in=50.0, T_set=T_SET,
                outdoor_fraction=OUTDOOR_FRACTION, T_return=21.0, RH_return=0.3,
            ).series
            for day in days_of_year
        ]  # fmt: skip
    mixed = {n: np.concatenate([day_series[n] for day_series in air]) for n in ("T_a_in", "W_a_in")}
    return fc.Boundary(**(series | mixed), T_set=T_SET, day=list(seeds))


def tune_gains(preset: str, evaluations: int = EVALUATIONS) -> dict[str, float]:
    """Tune the gains with ``fc.tune`` on other valves and other days of every kind."""
    tuning = fc.tune(
        valves(preset, SEARCH_SEED), _join_kinds(preset, SEARCH_DAYS), search=SEARCH, limits=LIMITS,
        holdout=_join_kinds(preset, HOLDOUT_DAYS), evaluations=evaluations,
    )  # fmt: skip
    return dict(tuning.parameters)


def _join_kinds(preset: str, seeds: Sequence[int]) -> fc.Boundary:
    """Join the days of all kinds in one boundary."""
    by_kind = days_by_kind(fc.presets()[preset].day["T_w_in"], seeds)
    names = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")
    series = {n: np.concatenate([day.series[n] for day in by_kind.values()]) for n in names}
    return fc.Boundary(**series, day=[seed + 100_000 * k for k in range(len(by_kind)) for seed in seeds])


def run_remedies(preset: str, gains: Mapping[str, float], seeds: Sequence[int] = DAYS) -> dict[str, xr.Dataset]:
    """Run every remedy on every kind of day; gains: those of the tuned PI."""
    loop, by_kind, remedies = valves(preset), {}, REMEDIES | {TUNED_PI: dict(gains)}
    for kind, boundary in days_by_kind(fc.presets()[preset].day["T_w_in"], seeds).items():
        datasets = {name: fc.simulate(loop.assign(**parameters), boundary) for name, parameters in remedies.items()}
        ds = concat_along(
            "remedy", {name: metrics[list(KEPT_METRICS)].reset_coords(drop=True) for name, metrics in datasets.items()}
        )
        by_kind[kind] = ds.assign_coords(backlash=("sample", np.asarray(loop["backlash"])))
    return by_kind


def remedy_rows(preset: str, by_kind: dict[str, xr.Dataset]) -> list[list[str]]:
    """A row for each kind of day, worn and good valves apart: every remedy against the plain PI."""
    table = []
    for kind, ds in by_kind.items():
        for label, is_member in (("worn", ds.backlash > 0.0), ("X = 0", ds.backlash == 0.0)):
            part = ds.isel(sample=np.flatnonzero(is_member.values))
            plain, cells = part.sel(remedy=PI), []
            for remedy in map(str, part.remedy.values):
                remedy_ds = part.sel(remedy=remedy)
                if remedy == PI:
                    cells.append(
                        f"{float(remedy_ds.rmse.mean()):.3f}, {float(remedy_ds.motor_travel.mean()):.1f}, "
                        f"{share_of(remedy_ds.hunts)}"
                    )
                    continue
                travel = float(remedy_ds.motor_travel.mean() / plain.motor_travel.mean())
                hunting = f", {float(remedy_ds.hunts.mean()):.0%} hunt" if bool(remedy_ds.hunts.any()) else ""
                cells.append(f"{change_in_words(part, remedy, PI, 'remedy')}, × {travel:.2f}{hunting}")
            table.append([f"`{preset}`", kind, label, *cells])
    return table


def theory_rows() -> list[list[str]]:
    """Rows of how often theory is right about loops drawn around the presets; the valve is closed at the start."""
    table = []
    for k, preset in enumerate(PRESETS):
        for j, (gains, (kp, ti)) in enumerate(DRAWN_GAINS.items()):
            rng = np.random.default_rng([THEORY_SEED, k, j])
            parameters = {
                "kp": np.exp(rng.uniform(*np.log(kp), LOOPS)),
                "ti": np.exp(rng.uniform(*np.log(ti), LOOPS)),
                "backlash": rng.uniform(0.0, LARGEST_BACKLASH, LOOPS) * (np.arange(LOOPS) % GOOD_EVERY > 0),
            }
            loop = fc.Loop.preset(preset).assign(**{n: ("sample", v) for n, v in parameters.items()})
            conditions = {
                "m_a": rng.uniform(0.4, 1.3, POINTS), "T_a_in": rng.uniform(8.7, 19.0, POINTS),
                "T_w_in": rng.uniform(45.0, 70.0, POINTS), "T_set": rng.uniform(20.0, 28.0, POINTS),
            }  # fmt: skip
            series = {n: np.repeat(v[:, None], HELD_SECONDS, 1) for n, v in conditions.items()}
            day = fc.Boundary(**series, W_a_in=0.003, day=np.arange(POINTS))
            theory, ds = fc.limit_cycle(loop, day), fc.simulate(loop, day, warm_up=WARM_UP_SECONDS)
            is_reachable = (fc.linearise(loop, day).reachable > 0.0) & theory.hunts.notnull()
            table.append([f"`{preset}`", gains, *_agreement_cells(theory, ds, is_reachable)])
    return table


def _agreement_cells(theory: xr.Dataset, ds: xr.Dataset, is_reachable: xr.DataArray) -> list[str]:
    hunts, predicted = ds.hunts > 0.0, theory.hunts > 0.0
    both_hunt, is_missed = hunts & predicted & is_reachable, hunts & ~predicted & is_reachable
    period = (abs(np.log(theory.period / ds.hunting_period)) < np.log(1.15)).where(both_hunt).mean()
    swing = (abs(np.log(2.0 * theory.amplitude / ds.hunting_swing)) < np.log(1.5)).where(both_hunt).mean()
    ratio = float((ds.hunting_swing / (2.0 * theory.amplitude)).where(both_hunt).median())
    large = f", {float(ds.hunting_swing.where(is_missed).median()):.1f} K" if bool(is_missed.any()) else ""
    return [
        f"{int(is_missed.sum())}{large}", f"{int((~hunts & predicted & is_reachable).sum())}",
        f"{int(is_reachable.sum())}",
        f"{int((hunts & is_reachable).sum())}", share_of(hunts == predicted, is_reachable).to_text(1),
        f"{float(period):.0%}",
        f"{float(swing):.0%}, {ratio:.2f}",
    ]  # fmt: skip


def write_backlash() -> None:
    """Write the tables."""
    table, gains = [], []
    for preset in PRESETS:
        tuned_gains = tune_gains(preset)
        gains.append(f"{preset}: kp {tuned_gains['kp']:.3g} 1/K, ti {tuned_gains['ti']:.3g} s")
        table += remedy_rows(preset, run_remedies(preset, tuned_gains))
    write_table(
        "heating/heating_backlash",
        f"Remedies in heating: RMSE in K, motor travel in strokes and hunting of the plain PI; change of the RMSE and "
        f"× motor travel of the others; {VALVES} valves, {len(DAYS)} days of each kind, noise {NOISE:g} K; tuned: "
        + "; ".join(gains),
        ["coil", "days", "valves", *REMEDIES, TUNED_PI],
        table,
    )
    write_table(
        "heating/heating_theory",
        f"What `limit_cycle` predicts of {LOOPS} loops drawn around each heating preset, at {POINTS} conditions each",
        ["coil", "gains", "missed, swing (median)", "false alarms", "cases", "hunt", "hunts or not: right",
         "period within 15 %",
         "swing within × 1.5, over the predicted (median)"],
        theory_rows(),
    )  # fmt: skip

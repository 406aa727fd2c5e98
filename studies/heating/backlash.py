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
from studies.common import along, change_in_words, share_of, write_table
from studies.days import HEATING, OUTDOOR_AIR, WEATHER_FILE, of_kind
from studies.inverse.conditions import GROWING
from studies.learning.identify_online import IDENTIFY

PRESETS = ("heating", "heating_45")
VALVES, GOOD, LARGEST = 60, 5, 0.15
"""Valves; one of so many has no backlash; backlash of the worst."""
VALVES_SEED, DAYS = 16101, (16111, 16112, 16113, 16114)
NOISE = 0.02
"""Measurement noise, K."""
T_SET = 25.0
PLANT_GAIN = 25.0
"""Of either coil at its design load, K per stroke."""
PI, TUNED = "plain PI", "PI by `fc.tune`"
REMEDIES = {
    PI: {},
    "half kp": {"kp": 0.0125},
    "95 % inverse": {"estimate_ratio": 0.95},
    "95 %, buffer by noise": {
        "estimate_ratio": 0.95, "buffer_ratio": 6.0, "buffer_swing": 0.1, "plant_gain": PLANT_GAIN,
    },
    "`identify`": IDENTIFY | {"plant_gain": PLANT_GAIN},
    "growing rule": GROWING,
}  # fmt: skip
SEARCH_SEED, SEARCH_DAYS, HOLDOUT_DAYS = 16102, (16121, 16122), (16123, 16124)
SEARCH = {"kp": (0.003, 0.3), "ti": (5.0, 600.0)}
LIMITS = {"motor_travel": "now", "hunts": (0.05, "mean"), "hunting_index": (0.8, 1.0)}
EVALUATIONS = 64
"""How the gains of ``fc.tune`` are sought: no more motor travel than the preset, and hardly any hunting."""
KEPT = ("rmse", "motor_travel", "hunts", "status")
STEPPED, CONSTANT, DESIGN, WINTER = "stepped", "constant", "design", "winter weather"
WINTER_DAYS = (*range(1, 60), *range(335, 366))
LOOPS, POINTS, THEORY_SEED = 60, 16, 16202
"""Drawn loops and conditions of the comparison with theory."""
DRAWN = {
    "kp 0.01 to 0.1, ti 15 to 200": ((0.01, 0.1), (15.0, 200.0)),
    "kp 0.01 to 0.2, ti 8 to 200": ((0.01, 0.2), (8.0, 200.0)),
}
SECONDS, WARM_UP = 8 * 3600, 4 * 3600
"""Of held conditions, and of them what is not counted."""


def valves(preset: str, seed: int = VALVES_SEED) -> fc.Loop:
    """Valves along ``sample``."""
    gaps = np.random.default_rng(seed).uniform(0.0, LARGEST, VALVES)
    gaps[::GOOD] = 0.0
    return fc.Loop.preset(preset).assign(backlash=("sample", gaps), noise_std=NOISE)


def days(T_w_in: float, seeds: Sequence[int] = DAYS) -> dict[str, fc.Boundary]:
    """Days of each kind, with water of this temperature."""
    stepped = fc.heating_day(seed=list(seeds), T_w_in=T_w_in)
    series = {n: stepped.series[n] for n in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
    design = of_kind(HEATING, seeds).series
    found = {
        STEPPED: stepped,
        CONSTANT: fc.Boundary(**series, T_set=T_SET, day=list(seeds)),
        DESIGN: fc.Boundary(**(series | {n: design[n] for n in ("T_a_in", "W_a_in")}), T_set=T_SET, day=list(seeds)),
    }
    if WEATHER_FILE.is_file():
        found[WINTER] = _of_winter(series, seeds)
    return found


def _of_winter(series: dict[str, np.ndarray], seeds: Sequence[int]) -> fc.Boundary:
    """Winter days of the file, with the air flow and water of the other kinds."""
    drawn = [int(np.random.default_rng([seed, 15]).choice(WINTER_DAYS)) for seed in seeds]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # hourly data have no fast disturbances: the water has them
        air = [
            fc.weather_day(
                WEATHER_FILE, days=[day], hour=6, hours=8, m_a=1.0, T_w_in=50.0, T_set=T_SET,
                outdoor_fraction=OUTDOOR_AIR, T_return=21.0, RH_return=0.3,
            ).series
            for day in drawn
        ]  # fmt: skip
    mixed = {n: np.concatenate([each[n] for each in air]) for n in ("T_a_in", "W_a_in")}
    return fc.Boundary(**(series | mixed), T_set=T_SET, day=list(seeds))


def tuned(preset: str, evaluations: int = EVALUATIONS) -> dict[str, float]:
    """Gains that ``fc.tune`` chooses for other valves, on other days of every kind."""
    found = fc.tune(
        valves(preset, SEARCH_SEED), _together(preset, SEARCH_DAYS), search=SEARCH, limits=LIMITS,
        holdout=_together(preset, HOLDOUT_DAYS), evaluations=evaluations,
    )  # fmt: skip
    return dict(found.parameters)


def _together(preset: str, seeds: Sequence[int]) -> fc.Boundary:
    """Days of all kinds in one boundary."""
    of_kinds = days(fc.presets()[preset].T_w_in, seeds)
    names = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")
    series = {n: np.concatenate([day.series[n] for day in of_kinds.values()]) for n in names}
    return fc.Boundary(**series, day=[seed + 100_000 * k for k in range(len(of_kinds)) for seed in seeds])


def runs(preset: str, gains: Mapping[str, float], seeds: Sequence[int] = DAYS) -> dict[str, xr.Dataset]:
    """Every remedy on every kind of day; gains: of the tuned PI."""
    loop, found, remedies = valves(preset), {}, REMEDIES | {TUNED: dict(gains)}
    for kind, boundary in days(fc.presets()[preset].T_w_in, seeds).items():
        ran = {name: fc.simulate(loop.assign(**how), boundary) for name, how in remedies.items()}
        ds = along("remedy", {name: of[list(KEPT)].reset_coords(drop=True) for name, of in ran.items()})
        found[kind] = ds.assign_coords(backlash=("sample", np.asarray(loop["backlash"])))
    return found


def rows(preset: str, found: dict[str, xr.Dataset]) -> list[list[str]]:
    """A row for each kind of day, worn and good valves apart: every remedy against the plain PI."""
    found_rows = []
    for kind, ds in found.items():
        for words, group in (("worn", ds.backlash > 0.0), ("X = 0", ds.backlash == 0.0)):
            part = ds.isel(sample=np.flatnonzero(group.values))
            plain, cells = part.sel(remedy=PI), []
            for remedy in map(str, part.remedy.values):
                at = part.sel(remedy=remedy)
                if remedy == PI:
                    cells.append(
                        f"{float(at.rmse.mean()):.3f}, {float(at.motor_travel.mean()):.1f}, {share_of(at.hunts)}"
                    )
                    continue
                travel = float(at.motor_travel.mean() / plain.motor_travel.mean())
                hunting = f", {float(at.hunts.mean()):.0%} hunt" if bool(at.hunts.any()) else ""
                cells.append(f"{change_in_words(part, remedy, PI, 'remedy')}, × {travel:.2f}{hunting}")
            found_rows.append([f"`{preset}`", kind, words, *cells])
    return found_rows


def theory_rows() -> list[list[str]]:
    """How often theory is right about loops drawn around the presets, which start with a closed valve."""
    found = []
    for k, preset in enumerate(PRESETS):
        for j, (gains, (kp, ti)) in enumerate(DRAWN.items()):
            draw = np.random.default_rng([THEORY_SEED, k, j])
            drawn = {
                "kp": np.exp(draw.uniform(*np.log(kp), LOOPS)),
                "ti": np.exp(draw.uniform(*np.log(ti), LOOPS)),
                "backlash": draw.uniform(0.0, LARGEST, LOOPS) * (np.arange(LOOPS) % GOOD > 0),
            }
            loop = fc.Loop.preset(preset).assign(**{n: ("sample", v) for n, v in drawn.items()})
            at = {
                "m_a": draw.uniform(0.4, 1.3, POINTS), "T_a_in": draw.uniform(8.7, 19.0, POINTS),
                "T_w_in": draw.uniform(45.0, 70.0, POINTS), "T_set": draw.uniform(20.0, 28.0, POINTS),
            }  # fmt: skip
            held = {n: np.repeat(v[:, None], SECONDS, 1) for n, v in at.items()}
            day = fc.Boundary(**held, W_a_in=0.003, day=np.arange(POINTS))
            theory, ds = fc.limit_cycle(loop, day), fc.simulate(loop, day, warm_up=WARM_UP)
            reach = (fc.linearise(loop, day).reachable > 0.0) & theory.hunts.notnull()
            found.append([f"`{preset}`", gains, *_agreement(theory, ds, reach)])
    return found


def _agreement(theory: xr.Dataset, ds: xr.Dataset, reach: xr.DataArray) -> list[str]:
    hunts, predicted = ds.hunts > 0.0, theory.hunts > 0.0
    both, missed = hunts & predicted & reach, hunts & ~predicted & reach
    period = (abs(np.log(theory.period / ds.hunting_period)) < np.log(1.15)).where(both).mean()
    swing = (abs(np.log(2.0 * theory.amplitude / ds.hunting_swing)) < np.log(1.5)).where(both).mean()
    ratio = float((ds.hunting_swing / (2.0 * theory.amplitude)).where(both).median())
    large = f", {float(ds.hunting_swing.where(missed).median()):.1f} K" if bool(missed.any()) else ""
    return [
        f"{int(missed.sum())}{large}", f"{int((~hunts & predicted & reach).sum())}", f"{int(reach.sum())}",
        f"{int((hunts & reach).sum())}", share_of(hunts == predicted, reach).written(1), f"{float(period):.0%}",
        f"{float(swing):.0%}, {ratio:.2f}",
    ]  # fmt: skip


def write_backlash() -> None:
    """Write the tables."""
    found_rows, gains = [], []
    for preset in PRESETS:
        chosen = tuned(preset)
        gains.append(f"{preset}: kp {chosen['kp']:.3g} 1/K, ti {chosen['ti']:.3g} s")
        found_rows += rows(preset, runs(preset, chosen))
    write_table(
        "heating/heating_backlash",
        f"Remedies in heating: RMSE in K, motor travel in strokes and hunting of the plain PI; change of the RMSE and "
        f"× motor travel of the others; {VALVES} valves, {len(DAYS)} days of each kind, noise {NOISE:g} K; tuned: "
        + "; ".join(gains),
        ["coil", "days", "valves", *REMEDIES, TUNED],
        found_rows,
    )
    write_table(
        "heating/heating_theory",
        f"What `limit_cycle` predicts of {LOOPS} loops drawn around each heating preset, at {POINTS} conditions each",
        ["coil", "gains", "missed, swing (median)", "false alarms", "cases", "hunt", "hunts or not: right",
         "period within 15 %",
         "swing within × 1.5, over the predicted (median)"],
        theory_rows(),
    )  # fmt: skip

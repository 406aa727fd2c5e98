"""What backlash does in a heating loop, which remedy helps or harms there, and whether theory foretells it.

Valves of 0 to 15 %, one of five without backlash, meet heating days of four kinds: set-points that step, a constant
set-point, design days, and winter days of a weather file where there is one.  Called by ``heating.py``.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import xarray as xr
from conditions import GROWING
from identify_online import IDENTIFY
from kinds import HERE, OUTDOOR_AIR
from kinds import HEATING as HEATING_KIND
from kinds import of_kind
from report import write_table
from shares import share_of

import fastcoil as fc

PRESETS = ("heating", "heating_45")
VALVES, GOOD, LARGEST = 60, 5, 0.15
"""Valves; one of so many has no backlash; backlash of the worst."""
VALVES_SEED, DAYS = 16101, (16111, 16112, 16113, 16114)
NOISE = 0.02
"""Measurement noise, K."""
T_SET = 25.0
PLANT_GAIN = 25.0
"""Of either coil at its design load, K per stroke."""
PI = "plain PI"
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
KEPT = ("rmse", "motor_travel", "hunts", "status")
STEPPED, CONSTANT, DESIGN, WINTER = "stepped", "constant", "design", "winter weather"
WINTER_DAYS = (*range(1, 60), *range(335, 366))
LOOPS, POINTS, THEORY_SEED = 60, 16, 16201
"""Drawn loops and conditions of the comparison with theory."""


def valves(preset: str) -> fc.Loop:
    """Valves along ``sample``."""
    gaps = np.random.default_rng(VALVES_SEED).uniform(0.0, LARGEST, VALVES)
    gaps[::GOOD] = 0.0
    return fc.Loop.preset(preset).assign(backlash=("sample", gaps), noise_std=NOISE)


def days(T_w_in: float, seeds: Sequence[int] = DAYS) -> dict[str, fc.Boundary]:
    """Days of each kind, with water of this temperature."""
    stepped = fc.heating_day(seed=list(seeds), T_w_in=T_w_in)
    series = {n: stepped.series[n] for n in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
    design = of_kind(HEATING_KIND, seeds).series
    found = {
        STEPPED: stepped,
        CONSTANT: fc.Boundary(**series, T_set=T_SET, day=list(seeds)),
        DESIGN: fc.Boundary(
            **(series | {n: design[n] for n in ("T_a_in", "W_a_in")}), T_set=T_SET, day=list(seeds)
        ),
    }
    if (HERE / "weather.csv").is_file():
        found[WINTER] = _of_winter(series, seeds)
    return found


def _of_winter(series: dict[str, np.ndarray], seeds: Sequence[int]) -> fc.Boundary:
    """Winter days of the file, with the air flow and water of the other kinds."""
    drawn = [int(np.random.default_rng([seed, 15]).choice(WINTER_DAYS)) for seed in seeds]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # hourly data have no fast disturbances: the water has them
        air = [
            fc.weather_day(
                HERE / "weather.csv", days=[day], hour=6, hours=8, m_a=1.0, T_w_in=50.0, T_set=T_SET,
                outdoor_fraction=OUTDOOR_AIR, T_return=21.0, RH_return=0.3,
            ).series
            for day in drawn
        ]  # fmt: skip
    mixed = {n: np.concatenate([each[n] for each in air]) for n in ("T_a_in", "W_a_in")}
    return fc.Boundary(**(series | mixed), T_set=T_SET, day=list(seeds))


def runs(preset: str, seeds: Sequence[int] = DAYS) -> dict[str, xr.Dataset]:
    """Every remedy on every kind of day."""
    loop, found = valves(preset), {}
    for kind, boundary in days(fc.presets()[preset].T_w_in, seeds).items():
        each = [fc.simulate(loop.assign(**v), boundary)[list(KEPT)].reset_coords(drop=True) for v in REMEDIES.values()]
        ds = xr.concat(each, xr.DataArray(list(REMEDIES), dims="remedy", name="remedy"))
        found[kind] = ds.assign_coords(backlash=("sample", np.asarray(loop["backlash"])))
    return found


def rows(preset: str, found: dict[str, xr.Dataset]) -> tuple[list[list[str]], list[list[str]]]:
    """Every remedy against the plain PI, good valves on their own; and those rows in which it is worse or hunts."""
    every, worse = [], []
    for kind, ds in found.items():
        for words, group in (("worn", ds.backlash > 0.0), ("X = 0", ds.backlash == 0.0)):
            part = ds.isel(sample=np.flatnonzero(group.values))
            change = fc.compare(part, baseline={"remedy": PI}, over=["sample", "day"], metrics="rmse", relative=True)
            plain = part.sel(remedy=PI)
            for remedy in map(str, part.remedy.values):
                at = part.sel(remedy=remedy)
                mean, low, high = (100 * float(change.rmse.sel(remedy=remedy, statistic=s)) for s in ("mean", "low", "high"))
                hunting = share_of(at.hunts)
                travel = float(at.motor_travel.mean() / plain.motor_travel.mean())
                row = [
                    f"`{preset}`", kind, words, remedy, f"{float(at.rmse.mean()):.3f}",
                    "—" if remedy == PI else f"{mean:+.0f} % ({low:+.0f} to {high:+.0f})",
                    f"{float(at.motor_travel.mean()):.1f}" if remedy == PI else f"× {travel:.2f}", str(hunting),
                ]  # fmt: skip
                every.append(row)
                if remedy != PI and (low > 0.0 or hunting.low > 0.05):
                    worse.append(row)
    return every, worse


def theory_rows() -> list[list[str]]:
    """How often theory is right about loops drawn around the presets, at conditions held for 6 h."""
    found = []
    for k, preset in enumerate(PRESETS):
        draw = np.random.default_rng([THEORY_SEED, k])
        drawn = {
            "kp": np.exp(draw.uniform(*np.log((0.01, 0.2)), LOOPS)),
            "ti": np.exp(draw.uniform(*np.log((8.0, 200.0)), LOOPS)),
            "backlash": draw.uniform(0.0, LARGEST, LOOPS),
        }
        drawn["backlash"][::GOOD] = 0.0
        loop = fc.Loop.preset(preset).assign(**{n: ("sample", v) for n, v in drawn.items()})
        still = {
            "m_a": draw.uniform(0.4, 1.3, POINTS), "T_a_in": draw.uniform(8.7, 19.0, POINTS),
            "T_w_in": draw.uniform(45.0, 70.0, POINTS), "T_set": draw.uniform(20.0, 28.0, POINTS),
        }  # fmt: skip
        day = fc.Boundary(
            **{n: np.repeat(v[:, None], 6 * 3600, 1) for n, v in still.items()}, W_a_in=0.003, day=np.arange(POINTS)
        )
        told = fc.limit_cycle(loop, day)
        reach = (fc.linearise(loop, day).reachable > 0.0) & told.hunts.notnull()
        ds = fc.simulate(loop, day, warm_up=7200)
        hunts, foretold = ds.hunts > 0.0, told.hunts > 0.0
        both = hunts & foretold & reach
        period = (abs(np.log(told.period / ds.hunting_period)) < np.log(1.15)).where(both).mean()
        swing = (abs(np.log(2.0 * told.amplitude / ds.hunting_swing)) < np.log(1.5)).where(both).mean()
        found.append(
            [f"`{preset}`", f"{int(reach.sum())}", f"{int((hunts & reach).sum())}",
             f"{int((hunts & ~foretold & reach).sum())}", f"{int((~hunts & foretold & reach).sum())}",
             share_of(hunts == foretold, reach).written(1), f"{float(period):.0%}", f"{float(swing):.0%}"]
        )  # fmt: skip
    return found


def write_backlash() -> None:
    """Write the tables."""
    every: list[list[str]] = []
    worse: list[list[str]] = []
    for preset in PRESETS:
        of_preset = rows(preset, runs(preset))
        every, worse = every + of_preset[0], worse + of_preset[1]
    head = ["coil", "days", "valves", "remedy", "RMSE, K", "change (95 %)", "motor travel, strokes", "hunting (95 %)"]
    sizes = f"{VALVES} valves, {len(DAYS)} days of each kind, noise {NOISE:g} K"
    write_table(
        "heating_harm",
        f"Where a remedy is worse than the plain PI of the same heating loop beyond chance, or hunts; {sizes}",
        head,
        worse,
    )
    write_table("heating_backlash", f"Remedies in heating, worn and good valves; {sizes}", head, every)
    write_table(
        "heating_theory",
        f"What `limit_cycle` foretells of {LOOPS} loops drawn around each heating preset, at {POINTS} conditions each",
        ["coil", "cases", "hunt", "missed", "false alarms", "right", "period within 15 %", "swing within × 1.5"],
        theory_rows(),
    )

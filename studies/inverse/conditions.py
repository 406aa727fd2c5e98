"""Under which conditions the observations of the paper hold.

Does backlash alone make a loop hunt?  Does the error rise where the estimate exceeds the backlash?  Does the learner
find the backlash on a quiet day?  What does the growing rule do to a good valve, and in heating?  Plants are generic
(the presets); the days are constant but for one set-point step, ``paper_day``, or those of ``days.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import concat_along, write_table
from studies.days import HEATING, STEPPED, loop_settings, make_days
from studies.robustness.best_pi import PRESETS

PLANTS = {"paper_like coil": "paper_like", "lbnl: sensor lag 30 s, stroke 90 s": "lbnl"}
HOURS = 5
STEP_AT = 3600
T_BEFORE, T_AFTER = 14.0, 15.0
HUNTING_SWING = 0.1
"""Peak-to-peak supply temperature, K, in the last hour that counts as hunting where it crosses the set-point."""


GROWING_RULE = {
    "learning_step": 0.028, "learning_interval": 900, "learning_ratio": 1.5, "buffer": 0.01, "learning_min_switches": 1,
    "learning_max_reference": 0.4, "learning_early_trip": 1, "learning_growth": 2, "learning_shrink": 0.5,
}  # fmt: skip
"""The one rule for all loops that the study of learning chooses."""
HARM_DAYS = range(5101, 5106)
HEATING_KP = 0.0045  # a quarter of the gain of ``lbnl``: a loop with water of 40 °C responds about three times as much


def stepped_day() -> fc.Boundary:
    """Constant air and water, one set-point step after an hour."""
    T_set = np.full(HOURS * 3600, T_BEFORE)
    T_set[STEP_AT:] = T_AFTER
    return fc.constant_day(hours=HOURS, T_set=T_set)


def tunings(n: int = 12) -> xr.Dataset:
    """Simulate n × n gains: overshoot of a step without backlash, and whether the loop hunts without and with 7 %."""
    kp, ti = np.geomspace(0.005, 0.12, n), np.geomspace(4.0, 600.0, n)
    by_plant = {}
    for plant, preset in PLANTS.items():
        loop = fc.Loop.preset(preset).assign(converged=True, kp=kp, ti=ti, sample_time=[1.0, 5.0, 10.0, 30.0])
        T = {
            x_bl: fc.simulate(loop.assign(backlash=x_bl), stepped_day(), traces=["T_sup"], trace_interval=5).T_sup
            for x_bl in (0.0, 0.07)
        }
        peak = T[0.0].sel(elapsed_time=slice(STEP_AT, None)).max("elapsed_time")
        overshoot = (peak - T_AFTER) / (T_AFTER - T_BEFORE)
        by_plant[plant] = xr.Dataset(
            {"overshoot": overshoot, "alone": _is_hunting(T[0.0]), "hunts": _is_hunting(T[0.07])}
        )
    return concat_along("plant", by_plant)


def _is_hunting(T_sup: xr.DataArray) -> xr.DataArray:
    last_hour = T_sup.sel(elapsed_time=slice((HOURS - 1) * 3600, None))
    low, high = last_hour.min("elapsed_time"), last_hour.max("elapsed_time")
    return (high - low > HUNTING_SWING) & (low < T_AFTER) & (high > T_AFTER)


def hunting_rows(ds: xr.Dataset) -> list[list[str]]:
    """Overshoot without backlash, and on each plant the number of tunings that hunt with 7 %."""
    rows = []
    for low, high in ((-np.inf, 0.05), (0.05, 0.2), (0.2, 0.4), (0.4, 0.7), (0.7, np.inf)):
        is_chosen = (ds.overshoot >= low) & (ds.overshoot < high) & ~ds.alone
        name = f"{max(low, 0):.0%} to {high:.0%}" if np.isfinite(high) else f"above {low:.0%}"
        cells = [
            f"{int((is_chosen & ds.hunts).sel(plant=p).sum())} of {int(is_chosen.sel(plant=p).sum())} hunt"
            for p in ds.plant.values
        ]
        rows.append([name, *cells])
    alone_cells = [f"{int(ds.alone.sel(plant=p).sum())}" for p in ds.plant.values]
    return [*rows, ["(hunts without backlash, too)", *alone_cells]]


def learned_when_quiet(n: int = 8) -> xr.DataArray:
    """Simulate where the learner ends on a constant day, with few switches and little evidence: n × n gains."""
    kp, ti = np.geomspace(0.005, 0.08, n), np.geomspace(8.0, 600.0, n)
    by_plant = {}
    for plant, preset in PLANTS.items():
        loop = fc.Loop.preset(preset).assign(
            converged=True, backlash=0.07, learning_step=0.007, backlash_estimate=0.007
        )
        loop = loop.assign(buffer=[1e-9, 0.001, 0.01], kp=kp, ti=ti, sample_time=[1.0, 5.0, 15.0, 30.0])
        by_plant[plant] = fc.simulate(loop, fc.constant_day(hours=24)).estimate_final
    return concat_along("plant", by_plant)


def quiet_rows(final_estimates: xr.DataArray) -> list[list[str]]:
    """Plant, buffer, and the shares that end at the backlash and far above it."""
    rows = []
    for name in final_estimates.plant.values:
        for buffer in final_estimates.buffer.values:
            part = final_estimates.sel(plant=name, buffer=buffer)
            is_right, is_too_high = abs(part - 0.07) < 0.0071, part > 0.2
            rows.append([str(name), f"{buffer:g}", f"{float(is_right.mean()):.0%}", f"{float(is_too_high.mean()):.0%}"])
    return rows


def overestimates(n: int = 6) -> xr.Dataset:
    """Simulate the errors with the exact estimate and with larger ones: n × n gains."""
    kp, ti = np.geomspace(0.01, 0.08, n), np.geomspace(8.0, 120.0, n)
    loop = fc.Loop().assign(backlash=0.07, estimate_ratio=[1.0, 1.2, 1.5], kp=kp, ti=ti)
    return fc.simulate(loop.assign(sample_time=[1.0, 5.0, 15.0, 30.0, 60.0]), fc.paper_day(hours=8, seed=1))


def overestimate_rows(ds: xr.Dataset) -> list[list[str]]:
    """Sample time, and the shares of tunings in which the error exceeds that of the exact estimate."""
    rows = []
    for sample_time in ds.sample_time.values:
        part = ds[["rmse", "rmse_settled"]].sel(sample_time=sample_time)
        share_above = (part.sel(estimate_ratio=[1.2, 1.5]) > part.sel(estimate_ratio=1.0)).mean(["kp", "ti"])
        shares = [share_above[m].sel(estimate_ratio=r) for r in (1.2, 1.5) for m in ("rmse", "rmse_settled")]
        rows.append([f"{sample_time:g} s", *(f"{float(share):.0%}" for share in shares)])
    return rows


def good_valves(seeds: Sequence[int] = HARM_DAYS) -> xr.Dataset:
    """Simulate the growing rule on valves without backlash, beside the plain PI, on days with set-point steps."""
    datasets = []
    for preset in PRESETS:
        loop = fc.Loop.preset(preset).assign(converged=True, backlash=0.0, noise_std=[0.0, 0.05])
        for variant in (loop, loop.assign(**GROWING_RULE)):
            datasets.append(_keep_metrics(fc.simulate(variant, make_days(STEPPED, seeds))))
    ds = xr.concat(datasets, "both").assign_coords(
        plant=("both", np.repeat(list(PRESETS), 2)),
        remedy=("both", ["plain PI", "growing"] * len(PRESETS)),
    )
    return ds.set_index(both=["plant", "remedy"]).unstack("both")


def heating(seeds: Sequence[int] = HARM_DAYS) -> xr.Dataset:
    """Simulate remedies in heating on the plant of ``lbnl``: water of 40 °C, design days."""
    loop = fc.Loop.preset("lbnl").assign(kp=HEATING_KP, backlash=[0.0, 0.03, 0.07, 0.12], **loop_settings(HEATING))
    remedies = {
        "plain PI": {},
        "95 %": {"estimate_ratio": 0.95},
        "95 %, buffer 1 %": {"estimate_ratio": 0.95, "buffer": 0.01},
        "growing rule": GROWING_RULE,
    }
    days = make_days(HEATING, seeds)
    return concat_along(
        "remedy",
        {name: _keep_metrics(fc.simulate(loop.assign(**parameters), days)) for name, parameters in remedies.items()},
    )


def _keep_metrics(ds: xr.Dataset) -> xr.Dataset:
    return ds[["rmse_settled", "motor_travel", "estimate_final"]].reset_coords(drop=True)


def good_valve_rows(ds: xr.Dataset) -> list[list[str]]:
    """Plant, noise, and means over days: settled error and travel of the plain PI, and what the rule makes of them."""
    rows = []
    for plant in PRESETS:
        for noise in ds.noise_std.values:
            plain, rule = (ds.sel(plant=plant, noise_std=noise, remedy=r).mean("day") for r in ("plain PI", "growing"))
            error, travel = (float(rule[m] / plain[m]) for m in ("rmse_settled", "motor_travel"))
            rows.append(
                [f"`{plant}`", f"{noise:g}", f"{float(plain.rmse_settled):.3f}", f"× {error:.1f}",
                 f"{float(plain.motor_travel):.1f}", f"× {travel:.1f}", f"{100 * float(rule.estimate_final):.1f} %"]
            )  # fmt: skip
    return rows


def heating_rows(ds: xr.Dataset) -> list[list[str]]:
    """Backlash, and the settled error with each remedy, mean over days."""
    settled_rmse = ds.rmse_settled.mean("day")
    return [
        [f"{x:.0%}", *(f"{float(settled_rmse.sel(backlash=x, remedy=r)):.3f}" for r in ds.remedy.values)]
        for x in ds.backlash.values
    ]


def main() -> None:
    """Write every table."""
    ds, overestimates_ds, quiet_estimates = tunings(), overestimates(), learned_when_quiet()
    is_mild = (ds.overshoot < 0.2) & ~ds.alone
    write_table(
        "inverse/conditions_hunting",
        f"Does backlash alone make a loop hunt?  {ds.overshoot.size:,} tunings, backlash 7 %; of the "
        f"{int(is_mild.sum())} "
        f"with less than 20 % overshoot {int((is_mild & ds.hunts).sum())} hunt",
        ["overshoot without backlash", *map(str, ds.plant.values)],
        hunting_rows(ds),
    )
    n = overestimates_ds.sizes["kp"] * overestimates_ds.sizes["ti"]
    write_table(
        "inverse/conditions_overestimates",
        f"In how many tunings is the error larger than with the exact estimate?  {n} tunings per sample time",
        ["sample time", *(f"{metric}, {ratio}" for ratio in ("120 %", "150 %") for metric in ("RMSE", "settled RMSE"))],
        overestimate_rows(overestimates_ds),
    )
    n = quiet_estimates.isel(plant=0, buffer=0).size
    write_table(
        "inverse/conditions_quiet",
        f"Does the learner find 7 % on a constant day of 24 h?  {n} tunings per line",
        ["plant", "buffer", "ends within a step of the backlash", "ends above 20 %"],
        quiet_rows(quiet_estimates),
    )
    good_ds = good_valves()
    write_table(
        "inverse/conditions_good_valve",
        f"The growing rule on a valve without backlash, means of {good_ds.sizes['day']} days with set-point steps",
        ["loop", "noise, K", "settled RMSE of the plain PI, K", "settled RMSE with the rule", "travel of the plain PI",
         "travel with the rule", "final estimate"],
        good_valve_rows(good_ds),
    )  # fmt: skip
    heating_ds = heating()
    write_table(
        "inverse/conditions_heating",
        f"Settled RMSE in heating, K: plant of `lbnl`, water of 40 °C, kp = {HEATING_KP}/K, mean of "
        f"{heating_ds.sizes['day']} design days",
        ["backlash", *map(str, heating_ds.remedy.values)],
        heating_rows(heating_ds),
    )

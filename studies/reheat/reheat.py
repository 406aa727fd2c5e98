"""Tune, compensate or find the gap of a reheat valve behind a room, over a population of boxes.

Boxes are drawn around the preset ``reheat``: gap (one valve of five has none), authority, water flow, room and noise.
Each meets winter days of 24 h of three kinds: a constant set-point, one that is set back at night, and a load that
changes with people and weather.  The gains are those of Guideline 36, three times their kp at a third of their Ti, and
SIMC for each box.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.model.metric_table import STATUS_OK
from studies.common import change_in_words, compare_rows, concat_along, draw_loguniform, share_of, write_table

BOXES, SEED = 64, 17101
DAYS = (17111, 17112, 17113)
GOOD_EVERY = 5  # one valve of so many has no backlash
HOURS = 24
WARM_UP = 7200
CONSTANT, SETBACK, LOAD = "constant", "night setback", "changing load"
G36, FAST, SIMC = "Guideline 36", "fast", "SIMC"
GAINS = {G36: {"kp": 0.1, "ti": 900.0}, FAST: {"kp": 0.3, "ti": 300.0}}
PI = "plain PI"
CONTROLLERS: dict[str, dict[str, object]] = {
    PI: {},
    "inverse 95 %": {"estimate_ratio": 0.95},
    "95 %, buffer 1 %": {"estimate_ratio": 0.95, "buffer": 0.01},
    "inverse 60 %": {"estimate_ratio": 0.6},
    "`identify`": {"estimator": "identify", "estimate_share": 0.95, "plant_gain": 25.0, "buffer": 0.01},
}
SIZES = (0.0, 0.03, 0.07, 0.15)
"""Gaps of the preset itself."""
KEPT = ("rmse", "settled_range", "hunting_swing", "hunts", "motor_travel", "estimate_final", "status")


def boxes(size: int = BOXES) -> fc.Loop:
    """Boxes along ``sample``."""
    rng = np.random.default_rng(SEED)
    gaps = rng.uniform(0.005, 0.15, size)
    gaps[::GOOD_EVERY] = 0.0
    parameters = {
        "backlash": gaps, "authority": rng.uniform(0.2, 0.7, size), "m_full": draw_loguniform(rng, 0.03, 0.06, size),
        "room_capacity": draw_loguniform(rng, 250.0, 900.0, size), "room_ua": rng.uniform(0.03, 0.07, size),
        "sensor_time_constant": draw_loguniform(rng, 30.0, 180.0, size), "stroke_time": rng.uniform(60.0, 150.0, size),
        "noise_std": rng.uniform(0.0, 0.03, size),
    }  # fmt: skip
    return fc.Loop.preset("reheat").assign(substeps=2, **{n: ("sample", values) for n, values in parameters.items()})


def winter_day(kind: str, seed: int, *, hours: int = HOURS) -> dict[str, np.ndarray]:
    """Series of a day: supply of 13 °C and water of 60 °C that drift a little, outdoors −5 to 8 °C."""
    rng, hour = np.random.default_rng([seed, len(kind)]), np.arange(hours * 3600) / 3600.0
    drift = {name: np.interp(hour, np.arange(hours + 1), rng.normal(0.0, 1.0, hours + 1)) for name in ("air", "water")}
    T_out = rng.uniform(-2.0, 5.0) + 3.0 * np.sin(2.0 * np.pi * (hour - 9.0) / 24.0)
    series = {
        "m_a": np.full(hour.size, 0.1), "T_a_in": 13.0 + 0.3 * drift["air"], "T_w_in": 60.0 + 1.0 * drift["water"],
        "W_a_in": np.full(hour.size, 0.006), "T_set": np.full(hour.size, 21.0), "T_out": T_out,
        "Q_room": np.full(hour.size, 0.2),
    }  # fmt: skip
    if kind == SETBACK:
        series["T_set"] = np.where((hour >= 6.0) & (hour < 19.0), 21.0, 18.0)
    elif kind == LOAD:  # people and sun come and go
        steps = rng.uniform(0.0, 0.6, 2 * hours)
        series["Q_room"] = steps[(hour * 2).astype(int)]
    return series


def days_of(kind: str, seeds: Sequence[int] = DAYS, *, hours: int = HOURS) -> fc.Boundary:
    """Days of one kind."""
    series = [winter_day(kind, seed, hours=hours) for seed in seeds]
    return fc.Boundary(**{name: np.stack([day[name] for day in series]) for name in series[0]}, day=list(seeds))


def simc_gains(loop: fc.Loop) -> dict[str, object]:
    """Find the SIMC gains of every box at the mean of a constant day."""
    linear = fc.linearise(loop.assign(backlash=0.0), fc.constant_day(
        hours=1, m_a=0.1, T_a_in=13.0, W_a_in=0.006, T_w_in=60.0, T_set=21.0, T_out=1.5, Q_room=0.2
    ))  # fmt: skip
    return {"kp": ("sample", linear.kp_simc.values), "ti": ("sample", linear.ti_simc.values)}


def run_boxes(loop: fc.Loop, gains: Mapping[str, object], days: fc.Boundary) -> xr.Dataset:
    """Run every controller; metrics, and ``discharge``: the median over hours of the range of T_sup, K."""
    by_controller = {}
    for name, values in CONTROLLERS.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            ds = fc.simulate(loop.assign(**gains, **values), days, warm_up=WARM_UP, traces=["T_sup"], trace_interval=60)
        hourly = ds.T_sup.isel(elapsed_time=slice(WARM_UP // 60, None)).coarsen(elapsed_time=60, boundary="trim")
        discharge = (hourly.max() - hourly.min()).median("elapsed_time")
        part = ds[list(KEPT)].assign(discharge=discharge).reset_coords(drop=True)
        by_controller[name] = part
    ds = concat_along("controller", by_controller)
    return ds.assign_coords(backlash=("sample", np.asarray(loop["backlash"])))


def controller_rows(name: str, by_kind: Mapping[str, xr.Dataset]) -> list[list[str]]:
    """A row for each kind of day and controller, on worn valves; good ones in the last column."""
    table = []
    for kind, ds in by_kind.items():
        worn, good = (ds.isel(sample=np.flatnonzero(where)) for where in (ds.backlash > 0.0, ds.backlash == 0.0))
        plain = worn.sel(controller=PI)
        for controller in map(str, ds.controller.values):
            part = worn.sel(controller=controller)
            travel = float((part.motor_travel / plain.motor_travel).median())
            table.append([
                name, kind, controller, f"{float(part.rmse.median()):.3f}", change_in_words(worn, controller, PI),
                f"{float(part.settled_range.median()):.2f}", f"{float(part.discharge.median()):.1f}",
                f"{float(part.motor_travel.median()):.1f}", f"× {travel:.2f}", f"{share_of(part.hunts)}",
                change_in_words(good, controller, PI),
            ])  # fmt: skip
    return table


def gap_rows() -> list[list[str]]:
    """A row for each pair of gains: the preset with gaps of ``SIZES`` on constant days."""
    table, days = [], days_of(CONSTANT)
    for name, gains in GAINS.items():
        ds = run_boxes(fc.Loop.preset("reheat").assign(backlash=("sample", list(SIZES)), noise_std=0.01), gains, days)
        for controller in (PI, "inverse 95 %"):
            part = ds.sel(controller=controller).mean("day")
            table.append([
                name, controller, *(
                    f"{float(part.settled_range[k]):.2f}, {float(part.discharge[k]):.1f}, "
                    f"{float(part.motor_travel[k]):.1f}" for k in range(len(SIZES))
                ),
            ])  # fmt: skip
    return table


def found_rows(by_gains: Mapping[str, Mapping[str, xr.Dataset]]) -> list[list[str]]:
    """How often ``identify`` finds the gap through the room, by gains and kind of day."""
    table = []
    for name, by_kind in by_gains.items():
        for kind, ds in by_kind.items():
            part = ds.sel(controller="`identify`")
            error = abs(part.estimate_final - part.backlash)
            is_right = error <= np.maximum(0.2 * part.backlash, 0.01)
            claims = part.estimate_final > 0.0
            worn, good = part.backlash > 0.01, part.backlash == 0.0
            table.append([
                name, kind, str(share_of(claims, worn.broadcast_like(claims))),
                str(share_of(is_right, worn.broadcast_like(claims))),
                str(share_of(claims, good.broadcast_like(claims))),
            ])  # fmt: skip
    return table


def run_all(seeds: Sequence[int] = DAYS, size: int = BOXES) -> dict[str, dict[str, xr.Dataset]]:
    """Run all gains on all kinds of days."""
    loop = boxes(size)
    gains = {**GAINS, SIMC: simc_gains(loop)}
    return {
        name: {kind: run_boxes(loop, pair, days_of(kind, seeds)) for kind in (CONSTANT, SETBACK, LOAD)}
        for name, pair in gains.items()
    }


def sample() -> None:
    """Compute the rows of the preset."""
    compare_rows("reheat/reheat_gap", gap_rows())


def main() -> None:
    """Write the tables."""
    by_gains = run_all()
    failed = sum(int((ds.status != STATUS_OK).sum()) for by_kind in by_gains.values() for ds in by_kind.values())
    rows = [row for name, by_kind in by_gains.items() for row in controller_rows(name, by_kind)]
    write_table(
        "reheat/reheat",
        f"Reheat boxes: {BOXES} around the preset, {len(DAYS)} winter days of 24 h of each kind; medians of those with "
        f"a gap, change of the RMSE against the plain PI of the same gains; {failed} days failed",
        ["gains", "days", "controller", "RMSE of the room, K", "change", "range of the room, K",
         "range of the discharge air in an hour, K", "motor travel, strokes a day", "against plain PI", "hunt",
         "change, X = 0"],
        rows,
    )  # fmt: skip
    write_table(
        "reheat/reheat_gap",
        f"The preset on {len(DAYS)} constant days: range of the room, K, of the discharge air in an hour, K, and motor "
        "travel, strokes a day",
        ["gains", "controller", *(f"gap {100 * size:g} %" for size in SIZES)],
        gap_rows(),
    )
    write_table(
        "reheat/reheat_found",
        f"What `identify` finds through the room in a day: {BOXES} boxes, {len(DAYS)} days of each kind",
        ["gains", "days", "claims a gap, above 1 %", "right to 20 % or 1 % of stroke", "claims one, X = 0"],
        found_rows(by_gains),
    )


if __name__ == "__main__":
    main()

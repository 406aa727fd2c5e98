"""Whether hunting raises power and demand where rooms answer the supply air: fan, pump, chiller and reheat.

The mechanism of the paper's introduction, as far as it needs no building: a variable-air-volume system behind the coil.
Two groups of boxes draw their air through it.  The core needs cooling all day and modulates; the perimeter has little
load, stays at its least flow and reheats.  A room is one thermal mass.  The flow of all boxes is that of coil and fan.

Coil and rooms are solved in turn, over the whole day each time: rooms answer in minutes what a loop swings, so that
few rounds are enough.  A loop that hunts never repeats a swing to the last bit, hence sums are compared and not traces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from joblib import Parallel, delayed

import fastcoil as fc
from studies.common import compare_rows, format_change, mean_of, progress_printer, share_of, write_table
from studies.days import CONSTANT, DESIGN, STEPPED, WEATHER, kinds, make_days
from studies.diagnosis.cause import valves

SEED, VALVES, DAYS, ROUNDS = 20601, 128, 4, 4
CP = 1.02  # specific heat of air, kJ/(kg K)
ROOM_SET_POINT, HEATING_SET_POINT, ROOM_CAPACITY_SECONDS = 24.0, 22.0, 1800.0
"""Set-points of cooling and of heating, °C; seconds of the greatest flow whose heat capacity is that of a room."""
CORE, PERIMETER = 0, 1
AIR_SHARES, LEAST_FLOWS, LOAD_SHARES = np.array([0.7, 0.3]), np.array([0.3, 0.4]), np.array([1.0, 0.35])
"""Of the two groups: share of the air, least flow over the greatest, load over what the day's air would carry off."""
OVERSIZE_FACTOR = 1.4  # greatest flow over the mean of the day's
BOX_BAND_K = 2.0  # proportional band of the PI of a box
BOX_TI = 900.0  # integral time of the PI of a box, s
LARGEST_REHEAT_K = 12.0  # by which a box reheats
FAN_POWER = 1.5  # power of the fan at its greatest flow, kW per kg/s
PUMP_POWER = 0.25  # power of a pump against a constant pressure, kW per kg/s
COP = 4.0  # coefficient of performance of the chiller
QUARTER_SECONDS = 900  # averaging time of a demand
WARM_UP_SECONDS = 1800  # seconds at the start of a day that do not count
HUNTS_BY_GAP, CALM, ALL_LOOPS = "hunt by the gap", "calm with the gap", "all"
KINDS = (CONSTANT, STEPPED, DESIGN, WEATHER)


class Rooms(NamedTuple):
    """Traces of the rooms, (lane, second): flow of air, kg/s; heat of all boxes, kW."""

    flow: np.ndarray
    reheat: np.ndarray


def fan_power(share: np.ndarray) -> np.ndarray:
    """Power of a fan with a variable speed over that at its greatest flow (ASHRAE 90.1, appendix G)."""
    return 0.0013 + 0.147 * share + 0.9506 * share**2 - 0.0998 * share**3


def simulate_rooms(T_sup: np.ndarray, usual_flow: np.ndarray, T_set: float) -> Rooms:
    """Simulate two groups of rooms, each of which starts at its set-point.

    T_sup: (lane, second), °C; usual_flow: (lane, second), kg/s, which would carry the core's load at ``T_set``.
    """
    greatest_flow = OVERSIZE_FACTOR * usual_flow.mean(-1, keepdims=True) * AIR_SHARES
    load = CP * (ROOM_SET_POINT - T_set) * usual_flow[:, :, np.newaxis] * AIR_SHARES * LOAD_SHARES
    T = np.full(greatest_flow.shape, ROOM_SET_POINT) - np.array([0.0, ROOM_SET_POINT - HEATING_SET_POINT])
    integral = np.clip(load[:, 0] / (CP * (ROOM_SET_POINT - T_set)) / greatest_flow, LEAST_FLOWS, 1.0)
    warming = np.where(np.arange(2) == PERIMETER, 0.3, 0.0) * np.ones_like(T)
    flow, reheat = np.empty(T_sup.shape), np.empty(T_sup.shape)
    for k in range(T_sup.shape[1]):
        error, cold = (T - ROOM_SET_POINT) / BOX_BAND_K, (HEATING_SET_POINT - T) / BOX_BAND_K
        integral = np.clip(integral + error / BOX_TI, LEAST_FLOWS, 1.0)
        warming = np.clip(warming + cold / BOX_TI, 0.0, 1.0)
        m = greatest_flow * np.clip(integral + error, LEAST_FLOWS, 1.0)
        heat = np.where(
            m <= LEAST_FLOWS * greatest_flow * (1.0 + 1e-9), np.clip(warming + cold, 0.0, 1.0) * LARGEST_REHEAT_K, 0.0
        )
        heat *= CP * m
        supply = T_sup[:, k, np.newaxis]
        T = T + (load[:, k] + heat - CP * m * (T - supply)) / (CP * greatest_flow * ROOM_CAPACITY_SECONDS)
        flow[:, k], reheat[:, k] = m.sum(-1), heat.sum(-1)
    return Rooms(flow, reheat)


class Coil(NamedTuple):
    """Traces of the coil, (lane, second), and whether a lane hunts."""

    T_sup: np.ndarray
    m_w: np.ndarray
    power: np.ndarray
    hunts: np.ndarray


def simulate_coil(loops: list[fc.Loop], days: fc.Boundary, flow: np.ndarray) -> Coil:
    """Simulate every loop on its days; flow: (loop × day, second), kg/s."""
    n = days.n_days

    def simulate_loop(k: int) -> tuple[np.ndarray, ...]:
        day = days.assign(m_a=flow[k * n : (k + 1) * n])
        ds = fc.simulate(loops[k], day, traces=["T_sup", "m_w", "power"], seed=SEED, n_jobs=1)
        return *(ds[name].transpose("day", ...).values for name in ("T_sup", "m_w", "power")), ds.hunts.values

    results = Parallel(n_jobs=-1)(delayed(simulate_loop)(k) for k in range(len(loops)))
    return Coil(*(np.concatenate(series) for series in zip(*results, strict=True)))


def daily_sums(room_state: Rooms, coil_traces: Coil, usual_flow: np.ndarray) -> dict[str, np.ndarray]:
    """Means of a day, kW, its demand, and water over heat, by lane."""
    share = room_state.flow / (OVERSIZE_FACTOR * usual_flow.mean(-1, keepdims=True))
    fan = FAN_POWER * OVERSIZE_FACTOR * usual_flow.mean(-1, keepdims=True) * fan_power(share)
    pump, chiller = PUMP_POWER * coil_traces.m_w, coil_traces.power / COP
    total = (fan + pump + chiller)[:, WARM_UP_SECONDS:]
    quarters = (
        total[:, : total.shape[1] // QUARTER_SECONDS * QUARTER_SECONDS]
        .reshape(total.shape[0], -1, QUARTER_SECONDS)
        .mean(-1)
    )
    mean = {"fan": fan, "pump": pump, "chiller": chiller, "reheat": room_state.reheat, "water": coil_traces.m_w}
    means = {name: np.asarray(series[:, WARM_UP_SECONDS:].mean(-1), float) for name, series in mean.items()}
    return means | {"electricity": total.mean(-1), "demand": quarters.max(-1)}


def valves_of_kind(kind: str, size: int) -> dict[str, np.ndarray]:
    """Valves and loops for a kind of day; each kind has its own."""
    return valves(CONSTANT, SEED + KINDS.index(kind), size)


def simulate_kind(kind: str, size: int = VALVES, n_days: int = DAYS) -> xr.Dataset:
    """Sums over (gap, sample, day), with and without gap, after the last round; ``moved``: its relative change."""
    parameters = valves_of_kind(kind, size)
    days = make_days(kind, [SEED + k for k in range(n_days)])
    usual_flow = np.tile(np.asarray(days.series["m_a"], float), (size, 1))
    T_set = float(np.mean(days.series["T_set"]))
    parts = []
    for is_worn in (True, False):
        loops = [
            fc.Loop.preset("lbnl").assign(
                m_full=1.7,
                estimate_ratio=0.0,
                **{n: float(v[k]) * (is_worn or n != "backlash") for n, v in parameters.items()},
            )
            for k in range(size)
        ]
        room_state, previous = simulate_rooms(np.full(usual_flow.shape, T_set), usual_flow, T_set), np.nan
        for _ in range(ROUNDS):
            coil_traces = simulate_coil(loops, days, room_state.flow)
            room_state = simulate_rooms(coil_traces.T_sup, usual_flow, T_set)
            totals = daily_sums(room_state, coil_traces, usual_flow)
            relative_step, previous = abs(totals["electricity"] / previous - 1.0), totals["electricity"]
        totals |= {
            "moved": relative_step,
            "hunts": coil_traces.hunts,
            "T": coil_traces.T_sup[:, WARM_UP_SECONDS:].mean(-1),
        }
        dims = ("sample", "day")
        parts.append(xr.Dataset({name: (dims, values.reshape(size, n_days)) for name, values in totals.items()}))
    return xr.concat(parts, xr.DataArray([True, False], dims="worn", name="worn"))


SUM_NAMES = ("fan", "pump", "chiller", "electricity", "demand", "water", "reheat")
MEDIAN_NAMES = ("pump", "electricity", "demand", "reheat")  # whose means a few loops that hunt may decide
HEAD = (
    "days",
    "loops",
    "loops × days",
    "hunt with, without the gap",
    *(f"{name}, mean" for name in SUM_NAMES),
    *(f"{name}, median" for name in MEDIAN_NAMES),
    "demand more than 1 % up",
    "last round",
)


def change_rows(kind: str, ds: xr.Dataset) -> list[list[str]]:
    """Change of each sum with the gap against the same loop without, over valves and days; how many of both hunt."""
    worn, good = ds.sel(worn=True), ds.sel(worn=False)
    has_gap = xr.DataArray(valves_of_kind(kind, ds.sizes["sample"])["backlash"] > 0.0, dims="sample")
    by_gap, calm = (worn.hunts > 0.0) & (good.hunts == 0.0), has_gap & (worn.hunts == 0.0)
    table = []
    for name, among in ((HUNTS_BY_GAP, by_gap), (CALM, calm), (ALL_LOOPS, has_gap & (worn.hunts >= 0.0))):
        if not bool(among.any()):  # no such loop on these days
            continue
        changes, medians = [], []
        for quantity in SUM_NAMES:
            # reheat and water may be next to nothing: against the mean of the good valves
            change = 100.0 * (worn[quantity] - good[quantity]) / good[quantity].mean()
            mean, half_width = mean_of(change.where(among))
            changes.append(f"{format_change(mean, mean - half_width, mean + half_width, 1)}")
            if quantity in MEDIAN_NAMES:
                medians.append(f"{float(change.where(among).median()):+.2f} %")
        share_up = share_of(worn.demand > 1.01 * good.demand, among)
        last_step = f"{100 * float(ds.moved.sel(worn=True).where(among).quantile(0.95)):.2f} %"
        shares = ", ".join(share_of(ds.hunts > 0.0, among).to_text(0) for ds in (worn, good))
        table.append([kind, name, f"{int(among.sum())}", shares, *changes, *medians, f"{share_up}", last_step])
    return table


def sample() -> None:
    """Compare the rows of the first kind of day."""
    compare_rows("cost/zone", change_rows(CONSTANT, simulate_kind(CONSTANT)))


def main(size: int = VALVES) -> None:
    """Write the table."""
    report, table = progress_printer(), []
    for kind in KINDS:
        if kind in kinds():
            rows = change_rows(kind, simulate_kind(kind, size))
            print(*rows, sep="\n")
            table += rows
            report(kind)
    write_table(
        "cost/zone",
        "Fan, pump, chiller and reheat behind a coil with a gap, against the same loop without: change of the daily "
        f"mean, % (95 % over valves and days), and median change; {size} valves × {DAYS} days; last round: how much "
        f"the last of {ROUNDS} iterations between coil and rooms changed the electricity, 95 % of the loops",
        HEAD,
        table,
    )

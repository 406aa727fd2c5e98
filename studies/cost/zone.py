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
from studies.common import compare_rows, mean_of, progress, share_of, signed, write_table
from studies.days import CONSTANT, DESIGN, STEPPED, WEATHER, kinds, of_kind
from studies.diagnosis.cause import valves

SEED, VALVES, DAYS, ROUNDS = 20601, 128, 4, 4
CP = 1.02
"""Specific heat of air, kJ/(kg K)."""
ROOM, HEATED_TO, CAPACITY = 24.0, 22.0, 1800.0
"""Set-points of cooling and of heating, °C; seconds of the greatest flow whose heat capacity is that of a room."""
CORE, PERIMETER = 0, 1
SHARE, LEAST, LOAD = np.array([0.7, 0.3]), np.array([0.3, 0.4]), np.array([1.0, 0.35])
"""Of the two groups: share of the air, least flow over the greatest, load over what the day's air would carry off."""
OVERSIZED = 1.4
"""Greatest flow over the mean of the day's."""
BAND, TI, WARMEST = 2.0, 900.0, 12.0
"""Of the PI of a box: K for all of its range, s; K by which it reheats at most."""
FAN, PUMP, COP = 1.5, 0.25, 4.0
"""kW per kg/s of the fan at its greatest flow, and of a pump against a constant pressure; the chiller's."""
QUARTER, WARM_UP = 900, 1800
"""Seconds of a demand, and at the start that do not count."""
GAP_HUNTS, ALL = "hunt by the gap", "all"
KINDS = (CONSTANT, STEPPED, DESIGN, WEATHER)


class Rooms(NamedTuple):
    """What the rooms of some lanes did, (lane, second): flow of air, kg/s; heat of all boxes, kW."""

    flow: np.ndarray
    reheat: np.ndarray


def fan_power(share: np.ndarray) -> np.ndarray:
    """Power of a fan with a variable speed over that at its greatest flow (ASHRAE 90.1, appendix G)."""
    return 0.0013 + 0.147 * share + 0.9506 * share**2 - 0.0998 * share**3


def rooms(T_sup: np.ndarray, usual: np.ndarray, T_set: float) -> Rooms:
    """Two groups of rooms, each at its set-point at first.

    T_sup: (lane, second), °C; usual: (lane, second), kg/s, the flow that would carry the core's load at ``T_set``.
    """
    greatest = OVERSIZED * usual.mean(-1, keepdims=True) * SHARE
    load = CP * (ROOM - T_set) * usual[:, :, np.newaxis] * SHARE * LOAD
    T = np.full(greatest.shape, ROOM) - np.array([0.0, ROOM - HEATED_TO])
    integral = np.clip(load[:, 0] / (CP * (ROOM - T_set)) / greatest, LEAST, 1.0)
    warming = np.where(np.arange(2) == PERIMETER, 0.3, 0.0) * np.ones_like(T)
    flow, reheat = np.empty(T_sup.shape), np.empty(T_sup.shape)
    for k in range(T_sup.shape[1]):
        error, cold = (T - ROOM) / BAND, (HEATED_TO - T) / BAND
        integral = np.clip(integral + error / TI, LEAST, 1.0)
        warming = np.clip(warming + cold / TI, 0.0, 1.0)
        m = greatest * np.clip(integral + error, LEAST, 1.0)
        heat = np.where(m <= LEAST * greatest * (1.0 + 1e-9), np.clip(warming + cold, 0.0, 1.0) * WARMEST, 0.0)
        heat *= CP * m
        supply = T_sup[:, k, np.newaxis]
        T = T + (load[:, k] + heat - CP * m * (T - supply)) / (CP * greatest * CAPACITY)
        flow[:, k], reheat[:, k] = m.sum(-1), heat.sum(-1)
    return Rooms(flow, reheat)


class Coil(NamedTuple):
    """Traces of the coil, (lane, second), and whether a lane hunts."""

    T_sup: np.ndarray
    m_w: np.ndarray
    power: np.ndarray
    hunts: np.ndarray


def coil(loops: list[fc.Loop], days: fc.Boundary, flow: np.ndarray) -> Coil:
    """Simulate every loop on its days; flow: (loop × day, second), kg/s."""
    n = days.n_days

    def one(k: int) -> tuple[np.ndarray, ...]:
        day = days.assign(m_a=flow[k * n : (k + 1) * n])
        ds = fc.simulate(loops[k], day, traces=["T_sup", "m_w", "power"], seed=SEED, n_jobs=1)
        return *(ds[name].transpose("day", ...).values for name in ("T_sup", "m_w", "power")), ds.hunts.values

    found = Parallel(n_jobs=-1)(delayed(one)(k) for k in range(len(loops)))
    return Coil(*(np.concatenate(each) for each in zip(*found, strict=True)))


def sums(of: Rooms, at: Coil, usual: np.ndarray) -> dict[str, np.ndarray]:
    """Means of a day, kW, its demand, and water over heat, by lane."""
    share = of.flow / (OVERSIZED * usual.mean(-1, keepdims=True))
    fan = FAN * OVERSIZED * usual.mean(-1, keepdims=True) * fan_power(share)
    pump, chiller = PUMP * at.m_w, at.power / COP
    total = (fan + pump + chiller)[:, WARM_UP:]
    quarters = total[:, : total.shape[1] // QUARTER * QUARTER].reshape(total.shape[0], -1, QUARTER).mean(-1)
    mean = {"fan": fan, "pump": pump, "chiller": chiller, "reheat": of.reheat, "water": at.m_w}
    found = {name: np.asarray(series[:, WARM_UP:].mean(-1), float) for name, series in mean.items()}
    return found | {"electricity": total.mean(-1), "demand": quarters.max(-1)}


def drawn_valves(kind: str, size: int) -> dict[str, np.ndarray]:
    """Valves and loops for a kind of day, none of them for another."""
    return valves(CONSTANT, SEED + KINDS.index(kind), size)


def of_kind_of_day(kind: str, size: int = VALVES, n_days: int = DAYS) -> xr.Dataset:
    """Sums over (gap, sample, day), with and without its gap, after the last round; ``moved``: by it, as a share."""
    drawn = drawn_valves(kind, size)
    days = of_kind(kind, [SEED + k for k in range(n_days)])
    usual = np.tile(np.asarray(days.series["m_a"], float), (size, 1))
    T_set = float(np.mean(days.series["T_set"]))
    parts = []
    for worn in (True, False):
        loops = [
            fc.Loop.preset("lbnl").assign(
                m_full=1.7, estimate_ratio=0.0, **{n: float(v[k]) * (worn or n != "backlash") for n, v in drawn.items()}
            )
            for k in range(size)
        ]
        of, before = rooms(np.full(usual.shape, T_set), usual, T_set), np.nan
        for _ in range(ROUNDS):
            at = coil(loops, days, of.flow)
            of = rooms(at.T_sup, usual, T_set)
            now = sums(of, at, usual)
            moved, before = abs(now["electricity"] / before - 1.0), now["electricity"]
        now |= {"moved": moved, "hunts": at.hunts, "T": at.T_sup[:, WARM_UP:].mean(-1)}
        dims = ("sample", "day")
        parts.append(xr.Dataset({name: (dims, each.reshape(size, n_days)) for name, each in now.items()}))
    return xr.concat(parts, xr.DataArray([True, False], dims="worn", name="worn"))


SUMS = ("fan", "pump", "chiller", "electricity", "demand", "water", "reheat")
HEAD = ("days", "loops", "loops × days", *(f"{name}, mean" for name in SUMS), "demand more than 1 % up", "last round")


def rows(kind: str, ds: xr.Dataset) -> list[list[str]]:
    """Change of each sum with the gap against the same loop without, over valves and days."""
    worn, good = ds.sel(worn=True), ds.sel(worn=False)
    gap = xr.DataArray(drawn_valves(kind, ds.sizes["sample"])["backlash"] > 0.0, dims="sample")
    by_gap = (worn.hunts > 0.0) & (good.hunts == 0.0)
    found = []
    for name, among in ((GAP_HUNTS, by_gap), (ALL, gap & (worn.hunts >= 0.0))):
        changes = []
        for each in SUMS:
            # reheat and water may be next to nothing: against the mean of the good valves
            change = 100.0 * (worn[each] - good[each]) / good[each].mean()
            middle, half = mean_of(change.where(among))
            changes.append(f"{signed(middle, middle - half, middle + half, 1)}")
        up = share_of(worn.demand > 1.01 * good.demand, among)
        moved = f"{100 * float(ds.moved.sel(worn=True).where(among).quantile(0.95)):.2f} %"
        found.append([kind, name, f"{int(among.sum())}", *changes, f"{up}", moved])
    return found


def sample() -> None:
    """The first kind of day."""
    compare_rows("cost/zone", rows(CONSTANT, of_kind_of_day(CONSTANT)))


def main(size: int = VALVES) -> None:
    """Write the table."""
    done, table = progress(), []
    for kind in KINDS:
        if kind in kinds():
            table += rows(kind, of_kind_of_day(kind, size))
            print(*table[-2:], sep="\n")
            done(kind)
    write_table(
        "cost/zone",
        f"Fan, pump, chiller and reheat behind a coil with a gap, against the same loop without: change of the daily "
        f"mean, % (95 % over valves and days); {size} valves × {DAYS} days; last round: how much the last of {ROUNDS} "
        "iterations between coil and rooms changed the electricity, 95 % of the loops",
        HEAD,
        table,
    )

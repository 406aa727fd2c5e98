"""Predictions of the linear model for one loop at the operating points of a day, and the gains that follow."""

import math
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Index
from fastcoil.design.describing_function import unpredictable_loops
from fastcoil.design.limit_cycle import Cycles, predict_cycles
from fastcoil.design.linearise import first_order, integral_speed, simc
from fastcoil.design.operating_points import PointsOfDay
from fastcoil.design.plants import Columns, Plants, linearise_plants, loop_response
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import parameter_columns
from fastcoil.model.parameter_table import PARAMETERS


class Prediction(NamedTuple):
    """Prediction of a single loop at the operating points of a day, (n_points,) each."""

    loop: Loop
    points: PointsOfDay
    plants: Plants
    cycles: Cycles
    reachable_points: Index  # where the valve can hold the set-point and theory has a hunting index
    worst_point: int  # that of them with the largest hunting index; -1 without one

    @property
    def hunting_index(self) -> float:
        """Largest hunting index of the day; NaN if no set-point can be reached."""
        return float(self.cycles.hunting_index[self.worst_point]) if self.worst_point >= 0 else math.nan

    @property
    def hunting_points(self) -> Index:
        """The operating points at which it is predicted to hunt."""
        return self.reachable_points[self.cycles.hunts[self.reachable_points] > 0.0]

    @property
    def columns(self) -> Columns:
        """The parameters, (1,) each."""
        return _loop_columns(self.loop, 1)


def _loop_columns(loop: Loop, n: int) -> Columns:
    """Parameters of a loop, n times, without a dead band, which theory does not know."""
    return parameter_columns(loop.assign(error_dead_band=0.0), {}, np.zeros(n, dtype=np.int64))


def predict(loop: Loop, points: PointsOfDay) -> Prediction:
    """Linearise a loop at the operating points of a day and predict its cycles."""
    columns = _loop_columns(loop, points.size)
    plants = linearise_plants(columns, points.conditions, loop.rules)
    cycles = predict_cycles(columns, plants)
    reachable = np.flatnonzero(plants.reachable & np.isfinite(cycles.hunting_index))
    worst = int(reachable[np.argmax(cycles.hunting_index[reachable])]) if reachable.size else -1
    return Prediction(loop, points, plants, cycles, reachable, worst)


def predict_or_nearest(loop: Loop, points: PointsOfDay) -> tuple[Prediction, tuple[str, ...]]:
    """Predict a loop, or the nearest one for which theory holds; return also why it is not the loop, a clause each."""
    doubts = why_not_linear(loop)
    prediction = predict(nearest_linear(loop) if doubts else loop, points)
    doubts = doubts or why_no_hunting_index(prediction)
    if prediction.worst_point < 0:  # gains are tried whatever compensates
        prediction = predict(nearest_linear(loop), points)
    if has_wrong_action(prediction):
        action = "cooling" if loop["action"] == "heating" else "heating"
        prediction = predict(nearest_linear(prediction.loop.assign(action=action)), points)
    return prediction, doubts


def predict_cycles_at(loop: Loop, plants: Plants, members: Index) -> Cycles:
    """Predict cycles of every scenario of a sweep of controllers and gaps at points, (n_scenarios, n_points) each."""
    n = math.prod(loop.sizes.values())
    columns = parameter_columns(loop.assign(error_dead_band=0.0), loop.sizes, np.repeat(np.arange(n), members.size))
    cycles = predict_cycles(columns, plants.select(np.tile(members, n)))
    return Cycles(*(values.reshape(n, members.size) for values in cycles))


def simc_gains(prediction: Prediction) -> tuple[float, float] | None:
    """Gains kp and ti after SIMC, whose kp is least over the points; None if the valve changes nothing."""
    if prediction.worst_point < 0:
        return None
    plants = prediction.plants.select(prediction.reachable_points)
    columns = _loop_columns(prediction.loop, prediction.reachable_points.size)
    gains = simc(columns, plants, first_order(columns, plants))
    usable = np.flatnonzero(np.isfinite(gains.kp) & np.isfinite(gains.ti))
    k = usable[np.argmin(gains.kp[usable])] if usable.size else 0
    return (float(gains.kp[k]), float(gains.ti[k])) if usable.size else None


def largest_integral_speed(prediction: Prediction) -> float:
    """Largest ``integral_speed`` of the operating points."""
    plants = prediction.plants.select(prediction.reachable_points)
    columns = _loop_columns(prediction.loop, prediction.reachable_points.size)
    return float(np.nanmax(integral_speed(columns, plants, first_order(columns, plants)), initial=0.0))


def shortest_ti(prediction: Prediction, limit: float) -> float:
    """Shortest integral time, s, from which on up to an hour the hunting index is at most ``limit``; NaN if none."""
    sample_time, ti = (float(prediction.columns[name][0]) for name in ("sample_time", "ti"))
    grid = np.geomspace(min(sample_time, ti) / 10.0, max(3600.0, 2.0 * ti), 60)
    largest = np.empty(grid.size)
    for part in np.array_split(np.arange(grid.size), 5)[::-1]:  # the longest decide, and are mostly enough
        swept = prediction.loop.assign(ti=("tuning", grid[part]))
        cycles = predict_cycles_at(swept, prediction.plants, prediction.reachable_points)
        largest[part] = cycles.hunting_index.max(axis=1)
        above = part[largest[part] > limit]
        if above.size:
            break
    else:
        return float(grid[0])
    k = int(above[-1])
    if k == grid.size - 1:
        return math.nan
    share = (largest[k] - limit) / (largest[k] - largest[k + 1])
    return float(grid[k] * (grid[k + 1] / grid[k]) ** share)


PHASE_PARTS = {
    "integral": "integral of the PI", "plant": "plant", "sensor": "sensor", "sampling": "sampling and hold",
    "backlash": "backlash (and motor)",
}  # fmt: skip
"""Parts of a loop that lag, and what a text calls them; of the plant see ``plant_in_words``."""


def plant_in_words(loop: Loop) -> str:
    """Return what stands between the valve of a single loop and its sensor, such as ``coil and room``."""
    word = "coil" if loop["plant"] == "coil" else "plant"
    return f"{word} and room" if loop["controlled"] == "T_room" else word


def phase_shares(prediction: Prediction) -> xr.DataArray:
    """Phase lag of each part of the loop where it cycles, or is nearest to a cycle, degrees; 180 in all.

    Those of integral, sensor and hold are known in closed form; the backlash, with the inverse and the motor, takes
    what the loop leaves until 180°, the plant the rest.
    """
    columns, cycles, worst = prediction.columns, prediction.cycles, prediction.worst_point
    ts, ti, tau = (float(columns[name][0]) for name in ("sample_time", "ti", "sensor_time_constant"))
    frequencies = np.geomspace(1e-4, math.pi / ts, 600)  # rad/s
    L = loop_response(columns, prediction.plants.select(np.array([worst])), frequencies)[0]
    phase_left = 180.0 + np.degrees(np.unwrap(np.angle(L)))
    w_cycle = 2.0 * math.pi / cycles.period[worst]
    w_critical = w_cycle if math.isfinite(w_cycle) else cycles.frequency[worst]
    # without any hunting index, where a gap would have most to add
    k = np.argmin(np.abs(np.log(frequencies / w_critical)) if math.isfinite(w_critical) else np.abs(phase_left - 45.0))
    w = float(frequencies[k])
    integral = -np.angle(1.0 + ts / ti / (1.0 - np.exp(-1j * w * ts)))
    pole = math.exp(-1.0 / tau) if tau > 0.0 else 0.0
    sensor = -np.angle((1.0 - pole) / (1.0 - pole * np.exp(-1j * w)))
    lags = {"integral": integral, "sensor": sensor, "sampling": 0.5 * w * ts}  # rad
    shares = {part: math.degrees(lag) for part, lag in lags.items()} | {"backlash": float(phase_left[k])}
    shares["plant"] = 180.0 - sum(shares.values())
    attrs = {"units": "degree", "long_name": "phase that each part of the loop takes", "period": 2.0 * math.pi / w}
    return xr.DataArray([shares[p] for p in PHASE_PARTS], coords={"part": list(PHASE_PARTS)}, dims="part", attrs=attrs)


def nearest_linear(loop: Loop) -> Loop:
    """Return the plain PI of a loop, which theory covers whatever else the loop has: see ``Parameter.theory``."""
    nearest = {name: p.theory.nearest for name, p in PARAMETERS.items()}
    return loop.assign(**{name: value for name, value in nearest.items() if value is not None})


def why_not_linear(loop: Loop) -> tuple[str, ...]:
    """Reasons why theory does not hold for a single loop, a clause each; empty where it does."""
    if loop["law"] == "pi" and float(loop["kp"]) <= 0.0:  # type: ignore[arg-type]
        return (f"kp = {loop['kp']:g} does not control: a kp has to be above 0",)
    # after the colon stands what to do about it in Python
    return tuple(why.partition(":")[0] for why, m in unpredictable_loops(_loop_columns(loop, 1)).items() if m.any())


def why_no_hunting_index(prediction: Prediction) -> tuple[str, ...]:
    """Reason why a prediction has no meaningful hunting index, a clause; empty where it has one."""
    if prediction.worst_point < 0:
        if not prediction.plants.reachable.any():
            return ("no set-point of the day can be held: the valve is at its end all the time",)
        return ("its compensation crosses the gap too slowly to count as an inverse",)
    if not has_wrong_action(prediction):
        return ()
    effect, action = ("cools", "cooling") if prediction.loop["action"] == "heating" else ("warms", "heating")
    return (f"the valve acts the wrong way round: opening it {effect} the air, so give action = {action}",)


def has_wrong_action(prediction: Prediction) -> bool:
    """Whether opening the valve moves the temperature away from the set-point wherever it can be reached."""
    sign = 1.0 if prediction.loop["action"] == "heating" else -1.0
    gain = sign * prediction.plants.gain[prediction.reachable_points]
    return bool(gain.size and not (gain > 0.0).any())


def hunting_index_omissions(prediction: Prediction) -> tuple[str, ...]:
    """Effects that the hunting index does not include, a clause each."""
    clauses, dead_band = [], float(prediction.loop["error_dead_band"])  # type: ignore[arg-type]
    noise = float(prediction.loop["noise_std"])  # type: ignore[arg-type]
    if noise > 0.0:  # limits: docs/findings/hunting.md, with noise
        clauses.append(
            f"the noise of {noise:.3g} K: with it a loop may hunt where (kp K)^0.7 (T + 2 θ)/ti is above 4; here it is "
            f"{largest_integral_speed(prediction):.2g}"
        )
    if dead_band > 0.0:
        clauses.append(f"the error dead band of {dead_band:g} K, which may hold a loop still, or make it hunt")
    n, missed = prediction.points.size, int(np.count_nonzero(~prediction.plants.reachable))
    if missed:
        clauses.append(f"{missed} of {n} operating points, at which the valve is at its end and misses the set-point")
    return tuple(clauses)

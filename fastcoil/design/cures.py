"""What the linear model predicts on a day, and the cures: chosen with theory, tried by simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.design.describing_function import unknown
from fastcoil.design.limit_cycle import HUNTS_ABOVE, Cycles, cycles_of
from fastcoil.design.linearise import first_order, margins_of, simc
from fastcoil.design.operating_points import PointsOfDay
from fastcoil.design.plants import Complex, Plants, loop_response, plants_of
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import columns_of
from fastcoil.loops.simulate import simulate
from fastcoil.model.metric_table import OFF, SETTLING_TIME, STATUS_OK
from fastcoil.model.parameter_table import PARAMETERS, Scalar

UNSURE = (0.7, 1.0)
"""Margins between which theory does not decide."""
SAFE = 0.7
"""Margin that a cure has to reach."""


class Prediction(NamedTuple):
    """A loop, a single scenario, at the operating points of a day.

    plants: linear models of valve and coil.  cycles: margin, hunts, period and amplitude, (n_points,) each.
    worst: the point with the largest margin among those at which the set-point can be reached and theory has one; -1 if
    there is none.
    """

    loop: Loop
    points: PointsOfDay
    plants: Plants
    cycles: Cycles
    worst: int

    @property
    def reached(self) -> Index:
        """The operating points at which the valve can hold the set-point, and theory has a margin."""
        return np.flatnonzero(self.plants.reachable & np.isfinite(self.cycles.margin))

    @property
    def margin(self) -> float:
        """Largest margin of the day; NaN if no set-point can be reached."""
        return float(self.cycles.margin[self.worst]) if self.worst >= 0 else math.nan

    @property
    def hunting(self) -> Index:
        """The operating points at which it is predicted to hunt."""
        return self.reached[self.cycles.hunts[self.reached] > 0.0]

    @property
    def hunts(self) -> bool:
        """Whether the loop is predicted to hunt at some operating point."""
        return self.hunting.size > 0

    @property
    def plant(self) -> Plants:
        """The plant at the worst operating point."""
        return self.plants.some(np.array([self.worst]))


def predict(loop: Loop, points: PointsOfDay) -> Prediction:
    """Linearise a loop at the operating points of a day and look for its cycles."""
    columns = columns_of(without_dead_band(loop), {}, np.zeros(points.size, dtype=np.int64))
    plants = plants_of(columns, points.conditions)
    cycles = cycles_of(columns, plants)
    found = Prediction(loop, points, plants, cycles, -1)
    reached = found.reached
    return found._replace(worst=int(reached[np.argmax(cycles.margin[reached])])) if reached.size else found


def cycles_at(loop: Loop, plants: Plants, which: Index) -> Cycles:
    """Cycles of every scenario of a sweep at some operating points, (n_scenarios, n_points) each.

    The sweep may change the controller and the backlash, which leave the plants as they are.
    """
    n = math.prod(loop.sizes.values())
    columns = columns_of(without_dead_band(loop), loop.sizes, np.repeat(np.arange(n), which.size))
    found = cycles_of(columns, plants.some(np.tile(which, n)))
    return Cycles(*(values.reshape(n, which.size) for values in found))


def without_dead_band(loop: Loop) -> Loop:
    """Theory knows no dead band: it predicts what the loop does without one, and that is reported."""
    return loop.assign(error_dead_band=0.0)


def _one(loop: Loop) -> dict[str, np.ndarray]:
    """The parameters of a single scenario, (1,) each."""
    return columns_of(loop, {}, np.zeros(1, dtype=np.int64))


def gain_margin_without_backlash(prediction: Prediction) -> float:
    """By how much kp may be multiplied behind a perfect valve where the loop is worst; below 1 it swings."""
    columns = _one(prediction.loop) | {"backlash": np.zeros(1)}
    return float(margins_of(columns, prediction.plant).gain_margin[0])


def simc_gains(prediction: Prediction) -> tuple[float, float] | None:
    """kp and ti after SIMC where the loop is worst; None where the valve changes nothing."""
    columns = _one(prediction.loop)
    gains = simc(columns, prediction.plant, first_order(columns, prediction.plant))
    found = float(gains.kp[0]), float(gains.ti[0])
    return found if all(map(math.isfinite, found)) else None


PARTS = ("integral", "coil", "sensor", "sampling", "backlash")
_SLOWEST = 1e-4  # rad/s
_FREQUENCIES = 600


class Response(NamedTuple):
    """Frequency response of an open loop at one operating point, backlash left out: 1 + L N = 0 is a cycle.

    w: rad/s.  L: complex.  left: phase until 180°, degrees.
    nearest: index of the frequency of the margin.  cycle: of the cycle; the same without one.
    """

    w: Array
    L: Complex
    left: Array
    nearest: int
    cycle: int

    @property
    def period(self) -> float:
        """Of the cycle, or of the margin, s."""
        return 2.0 * math.pi / float(self.w[self.cycle])


def response_of(prediction: Prediction) -> Response:
    """Frequency response of the loop at its worst operating point."""
    columns = _one(without_dead_band(prediction.loop))
    w = np.geomspace(_SLOWEST, math.pi / float(columns["sample_time"][0]), _FREQUENCIES)
    L = loop_response(columns, prediction.plant, w)[0]
    left = 180.0 + np.degrees(np.unwrap(np.angle(L)))
    at, period = (float(of[prediction.worst]) for of in (prediction.cycles.frequency, prediction.cycles.period))

    def index_of(frequency: float) -> int:
        return int(np.argmin(np.abs(np.log(w / frequency))))

    # without any margin, where a gap would have most to add
    nearest = index_of(at) if math.isfinite(at) else int(np.argmin(np.abs(left - 45.0)))
    cycle = index_of(2.0 * math.pi / period) if math.isfinite(period) else nearest
    return Response(w, L, left, nearest, cycle)


def phase_shares(loop: Loop, response: Response) -> xr.DataArray:
    """Degrees that each part takes where the loop cycles, or is nearest to it; together 180°.

    The sampled integral, the phase of 1 + (Ts/Ti)/(1 - z^-1), the sensor's lag and the hold, half a sample, are known
    in closed form.  The backlash, with the inverse and the motor, takes what the loop leaves until 180°, the coil all
    the rest.
    """
    w = float(response.w[response.cycle])
    ts, ti, tau = (float(loop[name]) for name in ("sample_time", "ti", "sensor_time_constant"))  # type: ignore[arg-type]
    integral = -np.angle(1.0 + ts / ti / (1.0 - np.exp(-1j * w * ts)))
    pole = math.exp(-1.0 / tau) if tau > 0.0 else 0.0
    sensor = -np.angle((1.0 - pole) / (1.0 - pole * np.exp(-1j * w)))
    shares = {
        "integral": math.degrees(float(integral)),
        "sensor": math.degrees(float(sensor)),
        "sampling": math.degrees(0.5 * w * ts),
        "backlash": float(response.left[response.cycle]),
    }
    shares["coil"] = 180.0 - sum(shares.values())
    attrs = {"units": "degree", "long_name": "phase that each part of the loop takes", "period": response.period}
    return xr.DataArray([shares[part] for part in PARTS], dims="part", coords={"part": list(PARTS)}, attrs=attrs)


def why_not_linear(loop: Loop) -> tuple[str, ...]:
    """Why theory does not hold for a single loop, a clause each; empty where it does."""
    if loop["law"] == "pi" and float(loop["kp"]) <= 0.0:  # type: ignore[arg-type]
        return (f"kp = {loop['kp']:g} does not control: a kp has to be above 0",)
    columns = _one(without_dead_band(loop))
    # behind the colon stands what to do about it in Python
    return tuple(reason.partition(":")[0] for reason, holds in unknown(columns).items() if holds.any())


def why_no_margin(prediction: Prediction) -> tuple[str, ...]:
    """Why a prediction has no margin that means anything, a clause; empty where it has."""
    if prediction.worst < 0:
        if not prediction.plants.reachable.any():
            return ("no set-point of the day can be held: the valve is at its end all the time",)
        return ("its compensation crosses the gap too slowly to count as an inverse",)
    gain = prediction.plants.gain[prediction.reached]
    heats = prediction.loop["action"] == "heating"
    if ((gain > 0.0) if heats else (gain < 0.0)).any():
        return ()
    does, other = ("cools", "cooling") if heats else ("warms", "heating")
    return (f"the valve acts the wrong way round: opening it {does} the air, so give action = {other}",)


def left_out(prediction: Prediction) -> tuple[str, ...]:
    """What the margin does not see, a clause each."""
    found, band = [], float(prediction.loop["error_dead_band"])  # type: ignore[arg-type]
    if band > 0.0:
        found.append(
            f"the error dead band of {band:g} K, which may hold a loop still that is predicted to hunt, or make "
            "another hunt"
        )
    n, missed = prediction.points.size, int(np.count_nonzero(~prediction.plants.reachable))
    if missed:
        found.append(
            f"{missed} of {n} operating points, at which the valve is at its end and cannot hold the set-point"
        )
    return tuple(found)


AS_IS, LOWER_KP, LONGER_TI, SIMC, DEAD_BAND, INVERSE, BOTH, REPAIRED = (
    "as_it_is", "lower_kp", "longer_ti", "simc", "dead_band", "inverse", "simc_and_inverse", "repaired_valve",
)  # fmt: skip
TUNINGS = (LOWER_KP, LONGER_TI, SIMC)
INVERSE_SHARE, BUFFER_RATIO, BUFFER_SWING = 0.95, 6.0, 0.1
"""Of an inverse with a buffer that goes with the noise; K of the last: what docs/findings/remedies.md recommends."""
LEAST_GAIN = 0.2
"""Smallest plant gain that the buffer may reckon with, K per stroke: the buffer has to stay below 1."""
DEAD_BAND_WIDTHS = (0.1, 0.5)
"""Least and most, K; as wide as the swing is high in between."""
_QUIET_DEAD_BAND = 0.25  # K, where nothing hunts
_LONGEST_TI = 3600.0
_TI_STEPS = 60
_STEPS_BACK = 4


class Cure(NamedTuple):
    """What may be changed.  words: as a technician says it.  changes: parameter → value."""

    name: str
    words: str
    changes: Mapping[str, Scalar]


def shortest_ti(prediction: Prediction, margin: float) -> float:
    """Shortest integral time that keeps the margin at or below ``margin`` at every operating point, s; NaN if none.

    All longer ones up to an hour keep it, too.  It is sought where the loop is worst now, then wherever that answer
    does not hold.
    """
    loop = prediction.loop
    sample_time, ti = float(loop["sample_time"]), float(loop["ti"])  # type: ignore[arg-type]
    grid = np.geomspace(min(sample_time, ti) / 10.0, max(_LONGEST_TI, 2.0 * ti), _TI_STEPS)
    swept = loop.assign(ti=("tuning", grid))
    looked_at = np.array([prediction.worst])
    found = math.nan
    for _ in range(_STEPS_BACK):
        largest = cycles_at(swept, prediction.plants, looked_at).margin.max(axis=1)
        found = _last_crossing(grid, largest, margin)
        if not math.isfinite(found):
            return math.nan
        there = cycles_at(loop.assign(ti=("tuning", [found])), prediction.plants, prediction.reached).margin[0]
        worst = int(prediction.reached[np.argmax(there)])
        if worst in looked_at:
            break
        looked_at = np.append(looked_at, worst)
    return found


def _last_crossing(grid: np.ndarray, values: np.ndarray, limit: float) -> float:
    """Where falling values reach a limit for the last time; the first of the grid if they never exceed it."""
    above = np.flatnonzero(values > limit)
    if not above.size:
        return float(grid[0])
    k = int(above[-1])
    if k == grid.size - 1:
        return math.nan
    share = (values[k] - limit) / (values[k] - values[k + 1])
    return float(grid[k] * (grid[k + 1] / grid[k]) ** share)


def cures_of(loop: Loop, prediction: Prediction | None) -> list[Cure]:
    """What to try on one loop, as it is first; no gains where theory cannot tell, and prediction is None."""
    kp, ti, backlash = (float(loop[name]) for name in ("kp", "ti", "backlash"))  # type: ignore[arg-type]
    found = [Cure(AS_IS, "as it is", {})]
    if prediction is not None and prediction.margin > SAFE:
        less = _rounded(kp * SAFE / prediction.margin, down=True)
        found.append(Cure(LOWER_KP, f"kp {less:g} 1/K, ti {ti:g} s", {"kp": less}))
        more = shortest_ti(prediction, SAFE)
        if math.isfinite(more):
            more = _rounded(more, down=False)
            found.append(Cure(LONGER_TI, f"kp {kp:g} 1/K, ti {more:g} s", {"ti": more}))
    gains: dict[str, Scalar] = {}
    simc = simc_gains(prediction) if prediction is not None else None
    if simc is not None:
        gains = {"kp": _rounded(simc[0]), "ti": _rounded(simc[1])}
        found.append(Cure(SIMC, f"SIMC: kp {gains['kp']:g} 1/K, ti {gains['ti']:g} s", gains))
    band = _dead_band(prediction)
    if float(loop["error_dead_band"]) < band:  # type: ignore[arg-type]
        found.append(Cure(DEAD_BAND, f"error dead band of {band:g} K", {"error_dead_band": band}))
    if backlash > 0.0:
        if prediction is not None:
            inverse: dict[str, Scalar] = {
                "backlash_estimate": INVERSE_SHARE * backlash,
                "compensation": "inverse",
                "buffer_ratio": BUFFER_RATIO,
                "buffer_noise": "measured",
                "buffer_swing": BUFFER_SWING,
                "plant_gain": max(abs(float(prediction.plants.gain[prediction.worst])), LEAST_GAIN),
            }
            found.append(Cure(INVERSE, f"inverse of {100 * INVERSE_SHARE:g} %, buffer by noise", inverse))
            if simc is not None:
                found.append(Cure(BOTH, "SIMC and this inverse", gains | inverse))
        # no gap, and whatever assumed one is off; a stem cannot stick without a gap in this model
        without = {"backlash": 0.0, "backlash_estimate": 0.0, "slip_jump": 0.0}
        found.append(Cure(REPAIRED, "valve repaired: no backlash", without))
    return found


def _dead_band(prediction: Prediction | None) -> float:
    """As wide as the swing is high, to 0.05 K."""
    if prediction is None or not prediction.hunts:
        return _QUIET_DEAD_BAND
    height = float(np.nanmax(prediction.cycles.amplitude[prediction.reached]))
    return float(np.clip(math.ceil(round(height / 0.05, 6)) * 0.05, *DEAD_BAND_WIDTHS).round(2))


def _rounded(value: float, *, down: bool | None = None) -> float:
    """A number that somebody types into a controller: two digits, on the safe side if that is said."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    digits = value / scale
    whole = round(digits) if down is None else math.floor(digits + 1e-9) if down else math.ceil(digits - 1e-9)
    return float(f"{whole * scale:.6g}")


def with_cures(loop: Loop, cures: list[Cure]) -> Loop:
    """The loop as a sweep along ``cure``."""
    names = dict.fromkeys(name for cure in cures for name in cure.changes)
    changed = {}
    for name in names:
        own = loop[name] if loop[name] is not None else PARAMETERS[name].default
        given = next(cure.changes[name] for cure in cures if name in cure.changes)
        changed[name] = ("cure", [cure.changes.get(name, given if own is None else own) for cure in cures])
    return loop.assign(**changed)


_POINTS = 43200  # most samples of a trace: one every 2 s of a day
PLAIN = 1.5
"""So many times as large a swing shows that a loop hunts here and not there."""
AS_PREDICTED = 0.7
"""Simulated over predicted swing from which the one counts as the other."""
WORSE, BETTER = 1.05, 0.95
"""RMSE relative to now from which a cure counts as worse, and up to which as better."""


def try_cures(
    loop: Loop, boundary: Boundary, cures: list[Cure], prediction: Prediction | None, warm_up: int, seed: int
) -> xr.Dataset:
    """Simulate and predict every cure on one day: metrics, the trace T_sup and the margin, over ``cure``."""
    every = max(2, -(-boundary.n_steps // _POINTS))
    swept = with_cures(loop, cures)
    ds = simulate(
        swept, boundary, traces=["T_sup"], trace_interval=every, warm_up=warm_up, seed=seed, n_jobs=1,
        progress=False,
    )  # fmt: skip
    ds = ds.isel(day=0, drop=True) if "day" in ds.dims else ds
    ds = ds if "cure" in ds.dims else ds.expand_dims("cure")
    worst, n_hunting = np.full(len(cures), math.nan), np.zeros(len(cures))
    if prediction is not None:
        cycles = cycles_at(swept, prediction.plants, prediction.reached)
        worst, n_hunting = cycles.margin.max(axis=1), np.count_nonzero(cycles.hunts > 0.0, axis=1)
    return ds.assign_coords(cure=[cure.name for cure in cures]).assign(
        words=("cure", [cure.words for cure in cures]),
        margin=("cure", worst, {"long_name": "largest describing-function margin, predicted"}),
        n_hunting=("cure", n_hunting, {"long_name": "operating points predicted to hunt"}),
    )


def swings_at(points: PointsOfDay, boundary: Boundary, now: xr.Dataset) -> Array:
    """Simulated swing at each operating point, K: max - min of T_sup in settled seconds; NaN if there are none."""
    T_set = boundary.series["T_set"][0]
    seconds = np.arange(T_set.size)
    changed = np.flatnonzero(np.diff(T_set, prepend=T_set[0]))
    last = np.searchsorted(changed, seconds, side="right")
    since = seconds - np.where(last > 0, changed[last - 1] if changed.size else 0, -SETTLING_TIME)
    of_second = np.where(since >= SETTLING_TIME, points.of_second, -1)[now["elapsed_time"].values.astype(int)]
    T_sup = now["T_sup"].values
    seen = [T_sup[of_second == k] for k in range(points.size)]
    return np.array([np.ptp(T) if T.size else np.nan for T in seen])


def hunts_uncounted(prediction: Prediction, swings: Array, now: xr.Dataset) -> bool:
    """Whether a loop hunts although the metric does not count it, since it does at times only, or not regularly enough.

    At the operating points at which it is predicted to hunt, the simulated swings are, in the median, ``PLAIN`` times
    those elsewhere; or they are of the size predicted, ``AS_PREDICTED``, and above ``OFF``.
    """
    if now["hunts"] > 0 or not prediction.hunting.size:
        return False
    elsewhere = np.setdiff1d(prediction.reached, prediction.hunting)
    there, rest = (_median(swings[some]) for some in (prediction.hunting, elsewhere))
    expected = 2.0 * _median(prediction.cycles.amplitude[prediction.hunting])
    return there > PLAIN * rest or there > max(AS_PREDICTED * expected, OFF)


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def hunting(ds: xr.Dataset) -> Mask:
    """Which cures leave the loop hunting, as it is first: those whose simulated day hunts.

    Where that is not counted for the loop as it is, those that are predicted to hunt somewhere, too.
    """
    shown, expected = ds["hunts"].values > 0, ds["n_hunting"].values > 0
    return np.asarray(shown | expected if ds["uncounted"] else shown)


def verdict(ds: xr.Dataset, k: int) -> str:
    """What a cure did, in a few words; as it is first in ``ds``."""
    if ds["status"].values[k] != STATUS_OK:
        return "failed"
    before, after = hunting(ds)[[0, k]]
    with np.errstate(divide="ignore", invalid="ignore"):
        error, swing = (float(of[k] / of[0]) for of in (ds["rmse"].values, ds["hunting_swing"].values))
    if not before:
        if after:
            return "makes it hunt"
        return "worse" if error > WORSE else "better" if error < BETTER else "no gain"
    if not after:
        return "cures it, at a larger error" if error > WORSE else "cures it"
    return "still hunts, and worse" if swing > 1.1 else "still hunts, but less" if swing < 0.7 else "still hunts"


def recommended(ds: xr.Dataset, names: list[str]) -> int:
    """Which cure to take: of those that leave no hunting, neither simulated nor predicted, the one with the least RMSE.

    A cure whose margin stays too large comes after these, a dead band or a repaired valve last.  0 where the loop is
    good as it is, or where nothing helps.
    """
    error, margin = ds["rmse"].values, np.nan_to_num(ds["margin"].values)
    good = (ds["status"].values == STATUS_OK) & ~hunting(ds)
    if good[0]:
        good &= (error < BETTER * error[0]) & ~np.isin(names, REPAIRED)
    rank = np.where(np.isin(names, (DEAD_BAND, REPAIRED)), 2, np.where(margin > HUNTS_ABOVE, 1, 0))
    able = [k for k, name in enumerate(names) if good[k] and name != AS_IS]
    return min(able, key=lambda k: (rank[k], error[k]), default=0)

"""What the linear model predicts at the operating points of a day, where the phase goes, and what theory leaves out."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index
from fastcoil.design.describing_function import describing_function, unknown
from fastcoil.design.limit_cycle import Cycles, cycles_of
from fastcoil.design.linearise import first_order, margins_of, simc
from fastcoil.design.operating_points import PointsOfDay
from fastcoil.design.plants import Complex, Plants, loop_response, plants_of
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import columns_of

UNSURE = (0.7, 1.0)
"""Margins between which theory does not decide."""
SAFE = 0.7
"""Margin that a cure has to reach."""


class Prediction(NamedTuple):
    """A loop at the operating points of a day.

    plants: linear models of valve and coil.  cycles: margin, hunts, period and amplitude, (n_points,) each.
    worst: the point with the largest margin among those at which the set-point can be reached and theory has one; -1 if
    there is none.
    """

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
    def elsewhere(self) -> Index:
        """The others at which theory has a margin."""
        return np.setdiff1d(self.reached, self.hunting)

    @property
    def hunts(self) -> bool:
        """Whether the loop is predicted to hunt at some operating point."""
        return self.hunting.size > 0

    @property
    def plant(self) -> Plants:
        """The plant at the worst operating point."""
        return self.plants.some(np.array([self.worst]))


def predict(loop: Loop, points: PointsOfDay) -> Prediction:
    """Linearise one loop, a single scenario, at the operating points of a day and look for its cycles."""
    columns = columns_of(without_dead_band(loop), {}, np.zeros(points.size, dtype=np.int64))
    plants = plants_of(columns, points.conditions)
    cycles = cycles_of(columns, plants)
    found = Prediction(points, plants, cycles, -1)
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


def gain_margin_without_backlash(loop: Loop, prediction: Prediction) -> float:
    """By how much the kp of one loop may be multiplied behind a perfect valve, where it is worst; below 1 it swings."""
    columns = _one(loop) | {"backlash": np.zeros(1)}
    return float(margins_of(columns, prediction.plant).gain_margin[0])


def simc_gains(loop: Loop, prediction: Prediction) -> tuple[float, float] | None:
    """kp and ti after SIMC for one loop where it is worst; None where the valve changes nothing."""
    columns = _one(loop)
    gains = simc(columns, prediction.plant, first_order(columns, prediction.plant))
    found = float(gains.kp[0]), float(gains.ti[0])
    return found if all(map(math.isfinite, found)) else None


PARTS = ("integral", "coil", "sensor", "sampling", "backlash")
_SLOWEST = 1e-4
"""rad/s."""
_FREQUENCIES, _AMPLITUDES = 600, 300


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


def response_of(loop: Loop, prediction: Prediction) -> Response:
    """Frequency response of a single loop at its worst operating point."""
    columns = _one(without_dead_band(loop))
    w = np.geomspace(_SLOWEST, math.pi / float(columns["sample_time"][0]), _FREQUENCIES)
    L = loop_response(columns, prediction.plant, w)[0]
    left = 180.0 + np.degrees(np.unwrap(np.angle(L)))
    at, period = (float(of[prediction.worst]) for of in (prediction.cycles.frequency, prediction.cycles.period))
    # without any margin, where a gap would have most to add
    nearest = _index(w, at) if math.isfinite(at) else int(np.argmin(np.abs(left - 45.0)))
    cycle = _index(w, 2.0 * math.pi / period) if math.isfinite(period) else nearest
    return Response(w, L, left, nearest, cycle)


def of_a_gap() -> Complex:
    """Describing function of a backlash of any size, over the amplitudes of its input."""
    amplitude = np.geomspace(0.5 + 1e-6, 500.0, _AMPLITUDES)
    gap = np.ones_like(amplitude)
    return describing_function(amplitude, gap, gap)


def _index(w: Array, at: float) -> int:
    return int(np.argmin(np.abs(np.log(w / at))))


def phase_shares(loop: Loop, response: Response) -> dict[str, float]:
    """Degrees that each of ``PARTS`` takes where the loop cycles, or is nearest to it; together 180°.

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
    return {part: shares[part] for part in PARTS}


def why_not_linear(loop: Loop) -> tuple[str, ...]:
    """Why theory does not hold for a single loop, a clause each; empty where it does."""
    if loop["law"] == "pi" and float(loop["kp"]) <= 0.0:  # type: ignore[arg-type]
        return (f"kp = {loop['kp']:g} does not control: a kp has to be above 0",)
    columns = _one(without_dead_band(loop))
    # behind the colon stands what to do about it in Python
    return tuple(reason.partition(":")[0] for reason, holds in unknown(columns).items() if holds.any())


def why_no_margin(loop: Loop, prediction: Prediction) -> tuple[str, ...]:
    """Why a prediction has no margin that means anything, a clause; empty where it has."""
    if prediction.worst < 0:
        if not prediction.plants.reachable.any():
            return ("no set-point of the day can be held: the valve is at its end all the time",)
        return ("its compensation crosses the gap too slowly to count as an inverse",)
    gain = prediction.plants.gain[prediction.reached]
    heats = loop["action"] == "heating"
    if ((gain > 0.0) if heats else (gain < 0.0)).any():
        return ()
    does, other = ("cools", "cooling") if heats else ("warms", "heating")
    return (f"the valve acts the wrong way round: opening it {does} the air, so give action = {other}",)


def left_out(loop: Loop, prediction: Prediction) -> tuple[str, ...]:
    """What the margin does not see, a clause each."""
    found = []
    if float(loop["error_dead_band"]) > 0.0:  # type: ignore[arg-type]
        band = f"the error dead band of {loop['error_dead_band']:g} K"
        found.append(f"{band}, which may hold a loop still that is predicted to hunt, or make another hunt")
    n, missed = prediction.points.size, int(np.count_nonzero(~prediction.plants.reachable))
    if missed:
        found.append(
            f"{missed} of {n} operating points, at which the valve is at its end and cannot hold the set-point"
        )
    return tuple(found)

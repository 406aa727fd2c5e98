"""Where the phase of a loop goes: what each part takes of the 180° at which it hunts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.arrays import Array
from fastcoil.explanation.foretold import Foretold, picked
from fastcoil.simulation.loop import Loop
from fastcoil.simulation.scenarios import columns_of
from fastcoil.theory.curve_of_plant import swings_of
from fastcoil.theory.cycles import DISTURBANCE, MOST
from fastcoil.theory.elements import Elements
from fastcoil.theory.plants import frequency_response, loop_response
from fastcoil.theory.response import Complex

PARTS = ("integral", "coil", "sensor", "sampling", "backlash")
_SLOWEST = 1e-4
"""rad/s."""
_FREQUENCIES, _AMPLITUDES = 600, 300


class Response(NamedTuple):
    """Frequency response of an open loop at one operating point, and the describing function of what is not linear.

    w: rad/s.  L: complex, backlash left out.  left: phase until 180°, degrees.
    nearest: index of the frequency of the margin.  cycle: of the cycle; the same without one.
    N: of backlash, inverse and motor at the frequency of the margin, over the amplitudes among which the margin is
    sought; 1 + L N = 0 is a cycle.
    """

    w: Array
    L: Complex
    left: Array
    nearest: int
    cycle: int
    N: Complex

    @property
    def period(self) -> float:
        """Of the cycle, or of the margin, s."""
        return 2.0 * math.pi / float(self.w[self.cycle])


def response_of(loop: Loop, foretold: Foretold) -> Response:
    """Frequency response of a single loop at its worst operating point."""
    columns = columns_of(loop, {}, np.zeros(1, dtype=np.int64))
    plant = picked(foretold.plants, np.array([foretold.worst]))
    w = np.geomspace(_SLOWEST, math.pi / float(columns["sample_time"][0]), _FREQUENCIES)
    L = loop_response(columns, plant, w)[0]
    left = 180.0 + np.degrees(np.unwrap(np.angle(L)))
    at, period = (float(of[foretold.worst]) for of in (foretold.cycles.frequency, foretold.cycles.period))
    # without any margin, where a gap would have most to add
    nearest = _index(w, at) if math.isfinite(at) else int(np.argmin(np.abs(left - 45.0)))
    cycle = _index(w, 2.0 * math.pi / period) if math.isfinite(period) else nearest
    elements = Elements.of(columns)
    A = elements.amplitudes(MOST, _AMPLITUDES)
    N = elements.describe(A, np.full_like(A, w[nearest]), swings_of(plant.curve, plant.T_sup, plant.gain))[0]
    gain = float(np.abs(frequency_response(plant.response, w[nearest : nearest + 1]))[0, 0])
    swing = A[0] * np.abs(N) * gain / (1.0 - float(columns["backlash"][0]))
    return Response(w, L, left, nearest, cycle, N[(np.abs(N) > 0.0) & (swing <= DISTURBANCE)])


def _index(w: Array, at: float) -> int:
    return int(np.argmin(np.abs(np.log(w / at))))


def phase_shares(loop: Loop, response: Response) -> dict[str, float]:
    """Degrees that each of ``PARTS`` takes where the loop cycles, or is nearest to it; together 180°.

    The sampled integral, the phase of 1 + (Ts/Ti)/(1 - z^-1), the sensor's lag and the hold, half a sample, are known
    in closed form.  The backlash, with
    the inverse and the motor, takes what the loop leaves until 180°, the coil all the rest.
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

"""Where the phase of a loop goes: what each part takes of the 180° at which it hunts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.design.explanation.predicted import Foretold, picked, without_dead_band
from fastcoil.design.theory.describing_function import describing_function
from fastcoil.design.theory.plants import loop_response
from fastcoil.design.theory.response import Complex
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import columns_of

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


def response_of(loop: Loop, foretold: Foretold) -> Response:
    """Frequency response of a single loop at its worst operating point."""
    columns = columns_of(without_dead_band(loop), {}, np.zeros(1, dtype=np.int64))
    plant = picked(foretold.plants, np.array([foretold.worst]))
    w = np.geomspace(_SLOWEST, math.pi / float(columns["sample_time"][0]), _FREQUENCIES)
    L = loop_response(columns, plant, w)[0]
    left = 180.0 + np.degrees(np.unwrap(np.angle(L)))
    at, period = (float(of[foretold.worst]) for of in (foretold.cycles.frequency, foretold.cycles.period))
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

"""Where the phase of a loop goes: what each part takes of the 180° at which it hunts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.arrays import Array
from fastcoil.explanation.foretold import Foretold, picked
from fastcoil.simulation.loop import Loop
from fastcoil.simulation.scenarios import columns_of
from fastcoil.theory.describing_function import describing_function
from fastcoil.theory.plants import loop_response
from fastcoil.theory.response import Complex

PARTS = ("integral", "coil", "sensor", "sampling", "backlash")
_SLOWEST = 1e-4
"""rad/s."""
_FREQUENCIES, _DEPTHS = 600, 400


class Response(NamedTuple):
    """Frequency response of an open loop at one operating point, backlash left out.

    w: rad/s.  L: complex, 1 + L N = 0 is a cycle.  left: phase until 180°, degrees.  margin: |L| |N| at each frequency,
    with the N whose phase is just what is left; 0 where no backlash has that phase.
    """

    w: Array
    L: Complex
    left: Array
    margin: Array

    @property
    def critical(self) -> int:
        """Index of the frequency at which the loop is nearest to a cycle, or on it."""
        return int(np.argmax(self.margin))

    def at_period(self, period: float) -> int:
        """Index of the frequency of a period, s; the critical one without a period."""
        return int(np.argmin(np.abs(self.w - 2.0 * math.pi / period))) if math.isfinite(period) else self.critical


def depths() -> tuple[Array, Complex]:
    """Half the gap over the amplitude of its input, from nearly 0 to nearly 1, and N of a backlash there."""
    k = np.linspace(1e-6, 1.0 - 1e-6, _DEPTHS)
    gap = np.ones_like(k)
    return k, describing_function(0.5 / k, gap, gap)


def response_of(loop: Loop, foretold: Foretold, point: int) -> Response:
    """Frequency response of a single loop at one of its operating points."""
    columns = columns_of(loop, {}, np.zeros(1, dtype=np.int64))
    plant = picked(foretold.plants, np.array([point]))
    w = np.geomspace(_SLOWEST, math.pi / float(columns["sample_time"][0]), _FREQUENCIES)
    L = loop_response(columns, plant, w)[0]
    left = 180.0 + np.degrees(np.unwrap(np.angle(L)))
    N = depths()[1]
    size = np.interp(left, -np.degrees(np.angle(N)), np.abs(N))
    return Response(w, L, left, np.where((left > 0.0) & (left < 90.0), np.abs(L) * size, 0.0))


def phase_shares(loop: Loop, response: Response, k: int) -> dict[str, float]:
    """Degrees that each of ``PARTS`` takes at frequency number k; together 180°.

    The sampled integral, the phase of 1 + (Ts/Ti)/(1 - z^-1), the sensor's lag and the hold, half a sample, are known
    in closed form.  The backlash takes what the loop leaves until 180°, the coil all the rest.
    """
    w = float(response.w[k])
    ts, ti, tau = (float(loop[name]) for name in ("sample_time", "ti", "sensor_time_constant"))  # type: ignore[arg-type]
    integral = -np.angle(1.0 + ts / ti / (1.0 - np.exp(-1j * w * ts)))
    pole = math.exp(-1.0 / tau) if tau > 0.0 else 0.0
    sensor = -np.angle((1.0 - pole) / (1.0 - pole * np.exp(-1j * w)))
    shares = {
        "integral": math.degrees(float(integral)),
        "sensor": math.degrees(float(sensor)),
        "sampling": math.degrees(0.5 * w * ts),
        "backlash": float(response.left[k]),
    }
    shares["coil"] = 180.0 - sum(shares.values())
    return {part: shares[part] for part in PARTS}

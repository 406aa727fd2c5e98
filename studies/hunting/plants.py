"""What is known of a loop before anything is simulated: a model of its plant from a small step, and its margins."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.design.theory.describing_function import describing_function
from fastcoil.design.theory.operating_points import OperatingPoints
from fastcoil.design.theory.plants import loop_response, plants_of

LEAST_GAIN = 0.2
"""K per stroke: with less a valve changes nothing."""
FREQUENCIES = np.geomspace(3e-4, math.pi, 300)
"""rad/s."""


def foreseen(loop: fc.Loop, day: fc.Boundary) -> xr.Dataset:
    """The model K, T, theta, and margins, over the dims of the loop and ``day``, at the mean conditions of each day.

    K: K per unit of command.  T, theta: s, what an engineer reads from a step of the command, with the gap out of the
    way; half a sample time counts as dead time, since a sampled controller acts that much later on average.
    opening: where the valve rests.  margin: largest |L| |N|.  gain_margin.  phase_margin: degrees, 180 if |L| < 1.
    reachable: whether the valve holds the set-point and changes anything.
    """
    linear = fc.linearise(loop, day)
    X, ts = (xr.DataArray(loop[name]).reset_coords(drop=True) for name in ("backlash", "sample_time"))
    found = xr.Dataset(
        {
            "K": abs(linear.gain) / (1.0 - X),
            "T": linear.lag,
            "theta": linear.delay + 0.5 * ts,
            "opening": linear.opening,
            "margin": margins(loop, day),
            "gain_margin": linear.gain_margin.fillna(np.inf),
            "phase_margin": linear.phase_margin.fillna(180.0),
            "reachable": linear.reachable.astype(bool) & (abs(linear.gain) > LEAST_GAIN),
        }
    )
    return found.reset_coords(drop=True)


def margins(loop: fc.Loop, day: fc.Boundary) -> xr.DataArray:
    """Largest |L| |N| over the frequencies at which L and a gap together lag 180 degrees; 0 if there are none.

    N: describing function of a gap, whose lag goes from 0 to 90 degrees as its input shrinks to the gap: Slotine
    and Li (1991), eq 5.21.  A cycle asks for 1.  Motor, limits of the stroke and the curve of the valve are left out;
    ``fc.limit_cycle`` has them.  Proportional to kp.
    """
    points, parts = OperatingPoints(loop, day, None), []
    for index in points.chunks():
        columns = points.columns(index)
        L = loop_response(columns, plants_of(columns, points.conditions(index)), FREQUENCIES)
        made = np.isfinite(L)  # there is none above half the sampling frequency
        left = np.pi + np.unwrap(np.where(made, np.angle(L), 0.0), axis=1)
        inside = made & (left > 0.0) & (left < 0.5 * np.pi)
        parts.append(np.where(inside, np.abs(L) * np.interp(left, *_GAP), 0.0).max(axis=1))
    return points.dataset({"margin": (np.concatenate(parts), {})}).margin


def gap(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lag, rad, and size of the describing function of a gap; depth: half the gap over the amplitude of its input."""
    N = describing_function(0.5 / depth, np.array(1.0), np.array(1.0))
    return -np.angle(N), np.abs(N)


_GAP = gap(np.linspace(1e-6, 1.0 - 1e-6, 2000))

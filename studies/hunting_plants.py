"""What is known of a loop before anything is simulated: a model of its plant from a small step, and its margins."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

import fastcoil as fc

LEAST_GAIN = 0.2
"""K per stroke: with less a valve changes nothing."""


def foreseen(loop: fc.Loop, day: fc.Boundary) -> xr.Dataset:
    """The model K, T, theta, and margins, over the dims of the loop and ``day``, at the mean conditions of each day.

    K: K per unit of command.  T, theta: s, what an engineer reads from a step of the command, with the gap out of the
    way; half a sample time counts as dead time, since a sampled controller acts that much later on average.
    opening: where the valve rests.  margin: largest |L| |N|.  gain_margin; phase_margin: degrees, 180 if |L| is never 1.
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
            "margin": _margin(loop, day),
            "gain_margin": linear.gain_margin.fillna(np.inf),
            "phase_margin": linear.phase_margin.fillna(180.0),
            "reachable": linear.reachable.astype(bool) & (abs(linear.gain) > LEAST_GAIN),
        }
    )
    return found.reset_coords(drop=True)


def _margin(loop, day):
    """Stand in."""
    from fastcoil.theory.operating_points import OperatingPoints
    from fastcoil.theory.plants import loop_response, plants_of

    points = OperatingPoints(loop, day, None)
    out = np.zeros(points.size)
    for index in points.chunks():
        c = points.columns(index)
        L = loop_response(c, plants_of(c, points.conditions(index)), np.geomspace(3e-4, math.pi, 240))
        L = np.where(np.isnan(L), 0.0, L)
        left = 180.0 + np.degrees(np.unwrap(np.angle(L), axis=1))
        k = np.linspace(1e-6, 1 - 1e-6, 2000)
        real = (0.5 * np.pi + np.arcsin(1 - 2 * k) + 2 * (1 - 2 * k) * np.sqrt(k * (1 - k))) / np.pi
        N = real - 4j / np.pi * k * (1 - k)
        inside = (left > 0) & (left < 90)
        out[index] = np.where(inside, np.abs(L) * np.interp(left, -np.degrees(np.angle(N)), np.abs(N)), 0.0).max(axis=1)
    return points.dataset({"m": (out, {})}).m

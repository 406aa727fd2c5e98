"""What is known of a loop before anything is simulated: the model of its plant from a small step, and its margins.

K, T and theta are what an engineer reads from a step of the command: the temperature that the sensor shows, backlash
out of the way.  Two points of the response, at 35.3 and 85.3 % of its end, give T and theta: Sundaresan and Krishnaswamy
(1978).  Half a sample time counts as dead time, since a sampled controller acts that much later on average.
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.simulation.scenarios import Layout
from fastcoil.theory.plants import Plants, loop_response, plants_of

AT_ONCE = 1024
"""Loops."""
POINTS = (0.353, 0.853)
LEAST_GAIN = 0.2
"""K per stroke: with less a valve changes nothing."""
FREQUENCIES = np.geomspace(3e-4, math.pi, 240)
"""rad/s."""
SERIES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")


def foreseen(loop: fc.Loop, day: fc.Boundary) -> xr.Dataset:
    """K (K per unit of command), T and theta (s), and margins, over ``day`` and the dims of the loop.

    margin: largest |L| |N|; gain_margin; phase_margin in degrees, 180 where |L| never is 1; reachable.
    Conditions are the means of each day.
    """
    layout = Layout(loop, day)
    means = {name: day.series[name].mean(axis=1) for name in SERIES}
    parts = []
    for some in np.array_split(np.arange(layout.size), math.ceil(layout.size / AT_ONCE)):
        columns = layout.columns(some)
        at = columns["day"].astype(int) if day.has_day_dim else np.zeros(some.size, int)
        plants = plants_of(columns, {name: values[at] for name, values in means.items()})
        of_step, of_bode = _first_order(columns, plants), _bode(loop_response(columns, plants, FREQUENCIES))
        reachable = plants.reachable & (np.abs(plants.gain) > LEAST_GAIN)
        parts.append(
            {
                **of_step,
                **of_bode,
                "margin": _margin(loop_response(columns, plants, FREQUENCIES)),
                "reachable": reachable,
            }
        )
    shape = tuple(layout.sizes.values())
    whole = {name: np.concatenate([part[name] for part in parts]).reshape(shape) for name in parts[0]}
    labels = {dim: layout.coordinates()[dim] for dim in layout.sizes if dim in layout.coordinates()}
    return xr.Dataset({name: (tuple(layout.sizes), values) for name, values in whole.items()}, coords=labels)


def _first_order(columns: dict[str, np.ndarray], plants: Plants) -> dict[str, np.ndarray]:
    """Gain, time constant and dead time of the measured step response, as in the text above."""
    ts, decay = columns["sample_time"], _decay(columns["sensor_time_constant"])
    share, y = plants.response / plants.gain[:, None], np.zeros(ts.size)
    reached = np.full((len(POINTS), ts.size), np.nan)
    t = 0
    while np.isnan(reached).any():
        now = share[:, min(t, share.shape[1] - 1)]
        y = now + decay * (y - now)
        t += 1
        for k, point in enumerate(POINTS):
            reached[k] = np.where(np.isnan(reached[k]) & (y >= point), t, reached[k])
    t1, t2 = reached
    theta = np.maximum(1.3 * t1 - 0.29 * t2, 0.0) + 0.5 * ts
    gain = np.abs(plants.gain) / (1.0 - columns["backlash"])
    return {"K": gain, "T": np.maximum(0.67 * (t2 - t1), 1.0), "theta": np.maximum(theta, 1.0)}


def _decay(tau: np.ndarray) -> np.ndarray:
    """What a first-order lag keeps from second to second; 0 without one."""
    return np.where(tau > 0.0, np.exp(-1.0 / np.maximum(tau, 1e-9)), 0.0)


def _bode(L: np.ndarray) -> dict[str, np.ndarray]:
    """Gain and phase margins; the worst where the curve crosses several times."""
    made = np.isfinite(L)
    size, left = np.abs(np.where(made, L, 0.0)), 180.0 + np.degrees(np.unwrap(np.angle(np.where(made, L, 1.0)), axis=1))
    turns = made[:, 1:] & (left[:, :-1] > 0.0) & (left[:, 1:] <= 0.0)
    turns |= made[:, :-1] & ~made[:, 1:]  # at half the sampling frequency L is real
    crosses = (size[:, :-1] >= 1.0) & (size[:, 1:] < 1.0)
    largest = np.where(turns, size[:, :-1], 0.0).max(axis=1)
    gain_margin = np.where(largest > 0.0, 1.0 / np.maximum(largest, 1e-9), np.inf)
    return {"gain_margin": gain_margin, "phase_margin": np.where(crosses, left[:, :-1], 180.0).min(axis=1)}


def _margin(L: np.ndarray) -> np.ndarray:
    """TEMPORARY"""
    L = np.where(np.isnan(L), 0.0, L)
    left = 180.0 + np.degrees(np.unwrap(np.angle(L), axis=1))
    k = np.linspace(1e-6, 1 - 1e-6, 2000)
    real = (0.5 * np.pi + np.arcsin(1 - 2 * k) + 2 * (1 - 2 * k) * np.sqrt(k * (1 - k))) / np.pi
    N = real - 4j / np.pi * k * (1 - k)
    inside = (left > 0) & (left < 90)
    return np.where(inside, np.abs(L) * np.interp(left, -np.degrees(np.angle(N)), np.abs(N)), 0.0).max(axis=1)

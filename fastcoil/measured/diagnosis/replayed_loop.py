"""The day of a log once more, with a fitted loop in place of the real one."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.diagnosis.fitted_plant import FittedPlant, lagged
from fastcoil.measured.diagnosis.recovered_pi import RecoveredPI

BUFFER = 1e-9
"""Least buffer of the inverse, so that round-off is no reversal."""


class Day(NamedTuple):
    """What a replay takes from the log, at the steps of the simulation, (n_steps,).

    disturbance: without noise, K.  noise: that the controller reads, K.  T_set: °C.  command: as logged.
    works: whether the controller works; else the logged command acts.
    """

    disturbance: Array
    noise: Array
    T_set: Array
    command: Array
    works: Mask


class Played(NamedTuple):
    """Signals of a replay, (n_steps,): true temperature, °C; command, motor position and opening, fractions."""

    temperature: Array
    command: Array
    position: Array
    opening: Array


def day_of(plant: FittedPlant, command: Array, T_set: Array, good: Mask, period: float) -> Day:
    """The day of a log; the noise is told from the disturbance by how it changes from sample to sample.

    period: samples to a period of a loop that hunts, else 0.  What is left of the hunting in the disturbance is what
    the plant does not get right, and would go on in a loop that is calm: a mean over whole periods takes it out.
    """
    n = plant.disturbance.size
    smooth, level = without_noise(plant.disturbance, good)
    noise_seen = plant.disturbance - smooth
    if period > 0.0:
        smooth = mean_over(smooth, period)
    at = np.arange((n - 1) * plant.per_sample + 1) / plant.per_sample
    sample = at.astype(int)
    noise = level * np.random.default_rng(0).standard_normal(at.size)  # between samples nobody knows it
    noise[:: plant.per_sample] = noise_seen
    works = good[sample] & good[np.minimum(sample + 1, n - 1)]
    return Day(np.interp(at, np.arange(n), smooth), noise, T_set[sample], command[sample], works)


def mean_over(series: Array, width: float) -> Array:
    """Moving mean over ``width`` samples around each; fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(series)])
    k = np.arange(series.size)
    half = np.minimum(np.minimum(k, series.size - 1 - k) + 0.5, 0.5 * width)
    ends = np.arange(total.size, dtype=float)
    return np.asarray((np.interp(k + 0.5 + half, ends, total) - np.interp(k + 0.5 - half, ends, total)) / (2.0 * half))


def without_noise(series: Array, good: Mask) -> tuple[Array, float]:
    """A random walk seen through white noise, smoothed, and the noise's standard deviation.

    Changes from sample to sample have the variance q + 2 r and, one after the other, the covariance -r, with r that of
    the noise and q that of a step of the walk; the smoother is the one that is best for these (Muth 1960, both ways).
    """
    changes = np.diff(series)
    changes = changes[good[1:] & good[:-1]]
    most = 6.0 * 1.4826 * float(np.median(np.abs(changes)))
    changes = np.clip(changes, -most, most)
    variance = float(changes @ changes) / changes.size
    r = min(-float(changes[1:] @ changes[:-1]) / changes.size, 0.499 * variance)
    if r <= 0.0:
        return series, 0.0
    q = variance - 2.0 * r
    ahead = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))
    share = ahead / (ahead + r)
    once = lagged(series, share)[::-1]
    return lagged(once, share)[::-1], math.sqrt(r)


def play(
    plant: FittedPlant,
    pi: RecoveredPI,
    day: Day,
    stroke_time: float,
    backlash: float,
    estimate: float,
    buffer: float,
) -> Played:
    """Replay a day: PI with clamped integral, inverse, motor, play operator, plant, recorded disturbance.

    estimate, buffer: of the inverse, fractions of stroke; an estimate of 0 is the plain PI.
    """
    n, step = day.T_set.size, plant.step
    c_1, c_2 = plant.curve
    least, most = plant.least, plant.most
    a_1, a_2 = (math.exp(-step / lag) for lag in plant.lags)
    every = max(1, round(pi.sample_time / step))
    kp, ki = pi.kp, pi.kp * every * step / pi.ti
    travel = step / stroke_time if stroke_time > 0.0 else 1.0
    stretch = 1.0 / (1.0 - backlash)
    buffer = max(buffer, BUFFER)
    disturbance, noise, T_set, logged = (s.tolist() for s in (day.disturbance, day.noise, day.T_set, day.command))
    works = day.works.tolist()
    position = command = u_ext = logged[0]
    mode = 1.0
    q = min(max(position - 0.5 * backlash, 0.0), 1.0 - backlash)
    inside = min(max(q * stretch, least), most)
    level = (c_1 + c_2 * inside) * inside + (c_1 + 2.0 * c_2 * inside) * (q * stretch - inside)
    slow = fast = level
    waiting = [level] * (plant.delay + 1)
    integral, worked = 0.0, False
    temperatures, commands, positions, opens = ([0.0] * n for _ in range(4))
    for k in range(n):
        temperature = fast + disturbance[k]
        if not works[k]:
            command = u_ext = logged[k]
            worked = False
        elif k % every == 0 or not worked:
            error = temperature + noise[k] - T_set[k]
            integral = integral + ki * error if worked else logged[k] - kp * error
            integral = 0.0 if integral < 0.0 else 1.0 if integral > 1.0 else integral
            u = kp * error + integral
            u = 0.0 if u < 0.0 else 1.0 if u > 1.0 else u
            turned = u < u_ext - buffer if mode > 0.0 else u > u_ext + buffer
            if turned:
                mode = -mode
            if turned or (u > u_ext if mode > 0.0 else u < u_ext):
                u_ext = u
                command = (1.0 - estimate) * u + (estimate if mode > 0.0 else 0.0)
                command = 0.0 if command < 0.0 else 1.0 if command > 1.0 else command
            worked = True
        ahead = command - position
        position = position + travel if ahead > travel else position - travel if ahead < -travel else command
        q = position - backlash if q < position - backlash else q
        q = position if q > position else q
        opening = q * stretch
        inside = least if opening < least else most if opening > most else opening
        level = (c_1 + c_2 * inside) * inside + (c_1 + 2.0 * c_2 * inside) * (opening - inside)
        temperatures[k], commands[k], positions[k], opens[k] = temperature, command, position, opening
        waiting[k % len(waiting)] = level
        slow += (waiting[(k + 1) % len(waiting)] - slow) * (1.0 - a_1)
        fast += (slow - fast) * (1.0 - a_2)
    return Played(*map(np.array, (temperatures, commands, positions, opens)))

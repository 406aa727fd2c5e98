"""The loop behind a trend log, fitted, and what its day would have been with another valve or controller."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.design.theory.describing_function import describing_function
from fastcoil.measured.diagnosis.fitted_plant import FittedPlant, fit_plant
from fastcoil.measured.diagnosis.likelihood import HORIZON
from fastcoil.measured.diagnosis.outcome import Outcome, counted_steps, outcome_of
from fastcoil.measured.diagnosis.recovered_pi import RecoveredPI, recover_pi
from fastcoil.measured.diagnosis.replayed_loop import Day, Played, day_of, play

MOST_SECONDS = 172800.0
"""Of a longer log the end is replayed."""
LARGEST_ERROR, LARGEST_TRAVEL_ERROR = 0.2, 0.4
"""By how much control error and motor travel of the replayed log may differ from the logged ones, as logarithms."""
GAIN_ERROR, LARGEST_SPREAD = 1.15, 1.5
"""A what-if is told if that much more and less loop gain change no verdict, and the control error by less than this."""
HUNTS_ABOVE = 0.8
"""Margin that foretells hunting; less than that of a plant that is known, 0.85: the gain of this one is fitted."""
_FREQUENCIES, _DEPTHS = 400, 400


class FittedLoop(NamedTuple):
    """A loop fitted to a log, ready to be replayed.

    kp: 1/K.  ti, sample_time: s.  action: ``cooling`` or ``heating``.
    gain: K per stroke at the middle opening, below 0 for cooling.
    margin: largest |L| |N| where 0–90° of phase margin are left; above ``HUNTS_ABOVE`` the loop hunts behind any gap.
    explained_command, explained_temperature: shares of the variance of their changes that PI and plant explain.
    """

    kp: float
    ti: float
    sample_time: float
    action: str
    gain: float
    margin: float
    explained_command: float
    explained_temperature: float
    backlash: float
    stroke_time: float
    pi: RecoveredPI
    plant: FittedPlant
    day: Day


def fit_loop_model(
    command: Array,
    temperature: Array,
    T_set: Array,
    interval: float,
    backlash: float,
    stroke_time: float,
    sample_time: float | None = None,
    enabled: Mask | None = None,
) -> FittedLoop | str:
    """Fit controller and plant to a trend log; one sentence if that cannot be done, or not be trusted.

    Parameters
    ----------
    command, temperature, T_set
        (n,): fraction of stroke, °C, °C; NaN where missing.
    interval
        Seconds from sample to sample.
    backlash, stroke_time
        Of valve (fraction of stroke) and motor (s, 0 if it is as good as immediate).
    sample_time
        Of the controller, s; found from the log if None.
    enabled
        Whether the plant was on; all of it if None.
    """
    found = fit_and_doubt(command, temperature, T_set, interval, backlash, stroke_time, sample_time, enabled)
    return found if isinstance(found, str) else found[1] or found[0]


def fit_and_doubt(
    command: Array,
    temperature: Array,
    T_set: Array,
    interval: float,
    backlash: float,
    stroke_time: float,
    sample_time: float | None = None,
    enabled: Mask | None = None,
) -> tuple[FittedLoop, str] | str:
    """As ``fit_loop_model``, with the loop and why it is not to be trusted (empty if it is) where it can be fitted."""
    if interval > HORIZON:
        return f"the log has a sample every {interval:g} s only: log every {HORIZON:g} s or faster"
    last = slice(-int(MOST_SECONDS / interval), None)
    command, temperature, T_set = (np.asarray(series, float)[last] for series in (command, temperature, T_set))
    good = np.isfinite(command) & np.isfinite(temperature) & np.isfinite(T_set)
    good = good if enabled is None else good & np.asarray(enabled, bool)[last]
    if not good.any():
        return "no sample has command, temperature and set-point with the plant on"
    command, temperature, T_set = (_held(series) for series in (command, temperature, T_set))
    pi = recover_pi(command, temperature, T_set, interval, good, sample_time)
    if isinstance(pi, str):
        return pi
    is_held = pi.sample_time >= interval
    sign = -1.0 if pi.kp > 0.0 else 1.0
    plant = fit_plant(command, temperature, good, interval, backlash, stroke_time, is_held, sign)
    if plant is None:
        return "no plant that answers the valve explains the log: the temperature hardly follows the command"
    action = "cooling" if pi.kp > 0.0 else "heating"
    fitted = FittedLoop(
        abs(pi.kp), pi.ti, pi.sample_time, action, plant.gain, margin(pi, plant), pi.explained, plant.explained,
        backlash, stroke_time, pi, plant,
        day_of(plant, command, T_set, good, _period(temperature, T_set, good, interval)),
    )  # fmt: skip
    return fitted, _doubt(fitted, command, temperature, T_set)


def what_if(
    fitted: FittedLoop,
    backlash: float | None = None,
    kp_factor: float = 1.0,
    ti_factor: float = 1.0,
    estimate: float = 0.0,
    buffer: float = 0.0,
) -> Outcome | str:
    """What the logged day would have been with another backlash, kp, ti, or with a backlash inverse.

    A sentence where the answer turns on less than the fit can know: what changes is simulated with ``GAIN_ERROR`` more
    and less loop gain too, and all three have to agree.

    Parameters
    ----------
    backlash
        Fraction of stroke; that of the fit if None.
    kp_factor, ti_factor
        Times the kp and ti of the log.
    estimate, buffer
        Of the inverse, fractions of stroke; an estimate of 0 is the plain PI.
    """
    size = fitted.backlash if backlash is None else backlash

    def with_gain(factor: float) -> Outcome:
        pi = fitted.pi._replace(kp=factor * kp_factor * fitted.pi.kp, ti=ti_factor * fitted.pi.ti)
        played = play(fitted.plant, pi, fitted.day, fitted.stroke_time, size, estimate, buffer)
        return outcome_of(played, fitted.day, fitted.plant.step)

    found = with_gain(1.0)
    if (size, kp_factor, ti_factor, estimate) == (fitted.backlash, 1.0, 1.0, 0.0):
        return found  # the log itself, which is known
    more, less = with_gain(GAIN_ERROR), with_gain(1.0 / GAIN_ERROR)
    if not found.hunts == more.hunts == less.hunts:
        turns_on = f"{100 * (GAIN_ERROR - 1.0):.0f} % of its gain"
        return f"whether the loop would hunt turns on {turns_on}, which the log does not tell"
    errors = [found.rmse, more.rmse, less.rmse]
    if not max(errors) < LARGEST_SPREAD * min(errors):
        return (
            f"the control error would be {min(errors):.2g} to {max(errors):.2g} K: it turns on "
            f"{100 * (GAIN_ERROR - 1.0):.0f} % of the loop's gain, which the log does not tell"
        )
    return found


def margin(pi: RecoveredPI, plant: FittedPlant) -> float:
    """Largest |L| |N| over the frequencies at which L has 0–90° of phase margin and N takes just these.

    L: PI, zero-order hold, plant; N: describing function of the play operator, whose phase goes from 0 to -90° as its
    input shrinks to the gap.  A limit cycle asks for 1.  The motor's rate limit is left out: at the amplitude of a gap
    it takes a few seconds.
    """
    ts = pi.sample_time
    w = np.geomspace(1e-4, math.pi / ts, _FREQUENCIES)
    s = 1j * w
    law = abs(pi.kp) * (1.0 + ts / pi.ti / (1.0 - np.exp(-s * ts)))
    hold = (1.0 - np.exp(-s * ts)) / (s * ts)
    slow, fast = plant.lags
    answer = abs(plant.gain) * np.exp(-s * plant.delay * plant.step) / ((1.0 + s * slow) * (1.0 + s * fast))
    L = law * hold * answer
    left = 180.0 + np.degrees(np.unwrap(np.angle(L)))
    inside = (left > 0.0) & (left < 90.0)
    if not inside.any():
        return 0.0
    k = np.linspace(1e-6, 1.0 - 1e-6, _DEPTHS)  # half the gap over the amplitude of its input
    gap = np.ones(_DEPTHS)
    N = describing_function(0.5 / k, gap, gap)
    size = np.interp(left[inside], -np.degrees(np.angle(N)), np.abs(N))
    return float(np.max(np.abs(L[inside]) * size))


def _period(temperature: Array, T_set: Array, good: Mask, interval: float) -> float:
    """Samples to a period if the logged loop hunts, else 0."""
    nothing = np.zeros(T_set.size)
    seen = outcome_of(
        Played(temperature, nothing, nothing, nothing), Day(nothing, nothing, T_set, nothing, good), interval
    )
    return seen.period / interval if seen.hunts else 0.0


def _doubt(fitted: FittedLoop, command: Array, temperature: Array, T_set: Array) -> str:
    """Why the fitted loop is not to be trusted, or nothing: it has to repeat the log that it was fitted to."""
    day, plant = fitted.day, fitted.plant
    played = play(plant, fitted.pi, day, fitted.stroke_time, fitted.backlash, 0.0, 0.0)
    counted = counted_steps(day, plant.step)[:: plant.per_sample]
    at = slice(None, None, plant.per_sample)
    true = temperature - day.noise[at]
    logged = float(np.sqrt(np.mean((true - T_set)[counted] ** 2)))
    replayed = float(np.sqrt(np.mean((played.temperature[at] - T_set)[counted] ** 2)))
    if not abs(math.log(replayed / logged)) < LARGEST_ERROR:
        return (
            f"the fitted loop does not repeat the log: it errs by {replayed:.2g} K where the log errs by {logged:.2g} K"
        )
    moves = [float(np.sum(np.abs(np.diff(series))[counted[1:]])) for series in (played.command[at], command)]
    if not abs(math.log(max(moves[0], 1e-9) / max(moves[1], 1e-9))) < LARGEST_TRAVEL_ERROR:
        return (
            f"the fitted loop does not repeat the log: its command travels {moves[0]:.3g} strokes where that of the "
            f"log travels {moves[1]:.3g}"
        )
    return ""


def _held(series: Array) -> Array:
    """Missing values replaced by the last before them, those at the beginning by the first there is."""
    known = np.flatnonzero(np.isfinite(series))
    return series[known[np.maximum(np.searchsorted(known, np.arange(series.size), side="right") - 1, 0)]]

"""A first-order model with delay, and the kp and ti that three published rules give."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.design.theory.plants import Columns, Plants, driven_gain
from fastcoil.design.theory.response import sensed_by

RULES = ("simc", "lambda", "ziegler_nichols")
_EARLY, _LATE = 0.353, 0.853
"""Shares of the response at which Sundaresan and Krishnaswamy read the two times."""
_LONGER = 36000
"""By how much a response that has not come that far is followed, s."""
_CALMER = 3.0
"""Closed-loop time constant of lambda tuning, in lags."""


class FirstOrder(NamedTuple):
    """From the opening to the measured temperature: gain e^(-delay s)/(1 + lag s); lag and delay (n,), s."""

    lag: Array
    delay: Array


class Gains(NamedTuple):
    """kp, 1/K, and ti, s, (n,) each; NaN where the valve changes nothing or acts the wrong way round."""

    kp: Array
    ti: Array


def first_order(columns: Columns, plants: Plants) -> FirstOrder:
    """Reduce the answer to a step of the opening, seen through the sensor's lag, to first order with delay.

    The model that meets the response at 35.3 and 85.3 % of its end; its delay is at least 0.  These are the two points
    of K. R. Sundaresan, P. R. Krishnaswamy: Estimation of time delay time constant parameters in time, frequency, and
    Laplace domains.  Can. J. Chem. Eng. 56 (1978), 257-262, who round lag = 0.67 (t2 - t1), delay = 1.3 t1 - 0.29 t2.
    """
    tau = np.asarray(columns["sensor_time_constant"], float)
    kinds, first, which = np.unique(
        np.stack([plants.same.astype(float), tau]), axis=1, return_index=True, return_inverse=True
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        response, gain = plants.response[first], plants.gain[first][:, None]
        longer = _LONGER if np.any(response[:, -1:] / gain < _LATE) else 0
        share = sensed_by(response, kinds[1], longer) / gain
    t1, t2 = _time_at(share, _EARLY), _time_at(share, _LATE)
    lag = (t2 - t1) / math.log((1.0 - _EARLY) / (1.0 - _LATE))
    delay = np.maximum(t1 + lag * math.log(1.0 - _EARLY), 0.0)
    return FirstOrder(lag[which.ravel()], delay[which.ravel()])


def simc(columns: Columns, plants: Plants, model: FirstOrder) -> Gains:
    """Skogestad's SIMC with the closed-loop time constant equal to the dead time θ.

    kp = lag/(2 K θ), ti = min(lag, 8 θ).  S. Skogestad: Simple analytic rules for model reduction and PID controller
    tuning.  J. Process Control 13 (2003), 291-309, eqs 23 and 24.
    """
    dead = _dead_time(columns, model)
    return _valid(plants, columns, model.lag / (2.0 * dead), np.minimum(model.lag, 8.0 * dead))


def calm(columns: Columns, plants: Plants, model: FirstOrder) -> Gains:
    """Lambda tuning with a closed-loop time constant of three lags, its robust choice.

    kp = lag/(K (λ + θ)), ti = lag, λ = 3 lag.  K. J. Åström, T. Hägglund: Advanced PID Control.  ISA (2006).
    """
    dead = _dead_time(columns, model)
    return _valid(plants, columns, model.lag / (_CALMER * model.lag + dead), model.lag)


def ziegler_nichols(ultimate_gain: Array, ultimate_period: Array) -> Gains:
    """Ziegler and Nichols' rule for PI from the ultimate gain, 1/K, and the ultimate period, s.

    kp = 0.45 Ku, ti = Pu/1.2.  J. G. Ziegler, N. B. Nichols: Optimum settings for automatic controllers.  Trans. ASME
    64 (1942), 759-768.
    """
    return Gains(0.45 * ultimate_gain, ultimate_period / 1.2)


def _dead_time(columns: Columns, model: FirstOrder) -> Array:
    """θ, s: a controller acts half a sample time late on average."""
    return np.asarray(model.delay + 0.5 * np.asarray(columns["sample_time"], float))


def _valid(plants: Plants, columns: Columns, kp_times_gain: Array, ti: Array) -> Gains:
    gain = driven_gain(columns, plants)
    acts = (gain > 0.0) & (ti > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Gains(np.where(acts, kp_times_gain / gain, np.nan), np.where(acts, ti, np.nan))


def _time_at(share: Array, level: float) -> Array:
    """Seconds after the step at which each row, from second 1 on, first reaches a level; straight between seconds."""
    whole = np.concatenate([np.zeros((share.shape[0], 1)), share], axis=1)
    k = np.maximum(np.argmax(whole >= level, axis=1), 1)
    rows = np.arange(k.size)
    below, above = whole[rows, k - 1], whole[rows, k]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(above >= level, k - 1 + (level - below) / (above - below), np.nan)

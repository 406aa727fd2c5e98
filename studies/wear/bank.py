"""A bank of models that notices a growing gap, of the kind that Tudoroiu and Zaheeruddin used.

What they did, after the abstracts of their papers (CCA 2005; HSI 2008): an interacting multiple model of unscented
Kalman filters on a simulated loop of the discharge air temperature, in which the gap of the valve's actuator grows; the
filters know the equations of the loop.  That a filter stands for a size of the gap is our reading.

What this is: a model of the package for each size, driven by the command and by what enters the coil.  The part of its
error that stays is taken for a disturbance, by a filter of fixed gain; the probabilities of the sizes follow a Markov
chain and the likelihoods of what is left, as theirs do.  What it is not: an unscented filter.  A command is known
without noise, so a stem that follows it needs no sigma points; and the models do not mix their states, for each keeps
its own place in its own gap.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc

CANDIDATES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.14)
"""Sizes of the gap that have a model, fraction of stroke."""
INTERVAL = 30
"""Seconds between the samples that the models are compared at."""
COLOUR = 600.0
"""Time within which an error of a model is taken for a disturbance that stays, s."""
SOJOURN = 86400.0
"""Time for which the gap keeps its size in the mean, s; then it takes one of the sizes beside it."""
LEAST = 1e-6
"""Probability that a size never falls below."""
PLANTS = {"known": (1.0, 1.0), "5 % off": (0.95, 1.05), "15 % off": (0.85, 1.15)}
"""What a model has for the conductances of the coil and for the flow of the open valve, as shares of the true ones."""


def foretold(valve: fc.Loop, days: fc.Boundary, command: np.ndarray) -> xr.DataArray:
    """Temperature that the controller would measure with each gap and each plant, °C, over every INTERVAL.

    command: (day, second).
    """
    conductances, flows = (("plant", list(factors)) for factors in zip(*PLANTS.values(), strict=True))
    factor = xr.DataArray(conductances[1], dims="plant")
    given = {name: factor * float(valve[name]) for name in ("beta1", "beta3", "beta5")}
    given["m_full"] = xr.DataArray(flows[1], dims="plant") * float(valve["m_full"])
    models = valve.assign(**given, backlash=("candidate", list(CANDIDATES)), noise_std=0.0, estimator="none")
    ds = fc.simulate(
        models, days, command=command, carry_over=True, traces=["T_measured"], trace_interval=INTERVAL, n_jobs=1
    )
    found = ds.T_measured.reset_coords(drop=True).assign_coords(plant=list(PLANTS))
    return found.transpose("plant", "day", "elapsed_time", "candidate")


def innovations(measured: np.ndarray, foretold: np.ndarray) -> np.ndarray:
    """What is new in the errors of the models, K: (time, candidate)."""
    error = measured[:, None] - foretold
    new = np.zeros_like(error)
    new[1:] = error[1:] - np.exp(-INTERVAL / COLOUR) * error[:-1]
    return new


def noise_of(new: np.ndarray) -> np.ndarray:
    """Standard deviation of what is new where the best of the models explains it, K; new: (…, time, candidate)."""
    return np.sqrt((new**2).mean(-2).min(-1)) + 1e-4


def probabilities(new: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Probability of each gap; new: (case, time, candidate), K; noise: (case,), K."""
    n = new.shape[-1]
    leave = INTERVAL / SOJOURN
    chain = np.eye(n) * (1.0 - leave)
    for j in range(n):
        beside = [k for k in (j - 1, j + 1) if 0 <= k < n]
        chain[j, beside] = leave / len(beside)
    now = np.full((new.shape[0], n), 1.0 / n)
    found = np.empty_like(new)
    for k in range(new.shape[1]):
        log = -0.5 * (new[:, k] / noise[:, None]) ** 2
        now = (now @ chain) * np.exp(log - log.max(-1, keepdims=True))
        now = np.maximum(now / now.sum(-1, keepdims=True), LEAST)
        now /= now.sum(-1, keepdims=True)
        found[:, k] = now
    return found

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
from fastcoil.model.physics import installed_valve
from studies.common import progress
from studies.days import CONSTANT, STEPPED, of_kind
from studies.remedies.runs import picked
from studies.wear.runs import controllers, valves

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


def predicted(valve: fc.Loop, days: fc.Boundary, command: np.ndarray) -> xr.DataArray:
    """Temperature that the controller would measure with each gap and each plant, °C, over every INTERVAL.

    valve: its ``backlash`` is that of its commissioning.  command: (day, second).
    """
    conductances, flows = (xr.DataArray(list(factors), dims="plant") for factors in zip(*PLANTS.values(), strict=True))
    given = {name: conductances * float(valve[name]) for name in ("beta1", "beta3", "beta5")}
    m_max, a, b, c = installed_valve(*(float(valve[name]) for name in ("rangeability", "authority", "m_full")))
    # a model opens by q / (1 - its own gap), the valve by q / (1 - that of its commissioning)
    sizes = xr.DataArray(list(CANDIDATES), dims="candidate")
    wider = (1.0 - sizes) / (1.0 - float(valve["backlash"]))
    given |= {"m_max": flows * m_max, "valve_a": a, "valve_b": b * wider, "valve_c": c / wider}
    models = valve.assign(**given, backlash=sizes, noise_std=0.0, estimator="none")
    ds = fc.simulate(
        models, days, command=command, carry_over=True, traces=["T_measured"], trace_interval=INTERVAL, n_jobs=1
    )
    found = ds.T_measured.reset_coords(drop=True).assign_coords(plant=list(PLANTS))
    return found.transpose("plant", "day", "elapsed_time", "candidate")


def innovations(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """What is new in the errors of the models, K: (time, candidate)."""
    error = measured[:, None] - predicted
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


SEQUENCE, BEFORE, HOURS = 8, 3, 6
LARGER = 3.0
"""By what the gap is multiplied."""
STEADY, GOOD, AT_ONCE, SLOWLY = "constant gap", "no gap", "three times as large at once", "within five days"
KINDS = (STEPPED, CONSTANT)
GAPS = (0.03, 0.12)
"""Between which the gaps lie once they have grown, fraction of stroke."""
LEAST_C_W = 10.0
"""kJ/K per volume; the models without a gap open further than the valve, and would be unstable with less water."""
CHOSEN_ON, FRESH = (7501,), (7601, 7701)
"""First days of the sequences that the thresholds are chosen on, and of those that are quoted."""
VALVES = {CHOSEN_ON: slice(0, 16), FRESH: slice(16, 40)}
EVERY = 600
"""Seconds between the estimates that are looked at."""
THRESHOLDS = (0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.08, 0.10)
"""Growth of the estimate that may raise an alarm, fraction of stroke."""
FALSE = 0.05
"""Share of sequences with a constant gap that may raise one."""
PASSIVE = {
    "identify": {"estimator": "identify", "estimate_share": 0.0},
    "hagglund": {"estimator": "hagglund", "estimate_share": 0.0},
}
ACTING = ("paper", "gradient")


Estimates = dict[tuple[str, str], xr.DataArray]
"""What the detectors believe, by case and kind of day; see ``estimates``."""


def days_of(kind: str, first: int) -> fc.Boundary:
    """A sequence of days without any change of the gap."""
    return of_kind(kind, list(range(first, first + SEQUENCE)), hours=HOURS)


def scale_of(case: str, n_steps: int) -> np.ndarray:
    """What the gap is multiplied by: (day, second)."""
    second = np.arange(SEQUENCE * n_steps, dtype=float)
    since = (second - BEFORE * n_steps) / ((SEQUENCE - BEFORE) * n_steps)
    grown = {STEADY: 0.0 * since, GOOD: 0.0 * since, AT_ONCE: since >= 0.0, SLOWLY: np.clip(since, 0.0, 1.0)}[case]
    return (1.0 + (LARGER - 1.0) * grown).reshape(SEQUENCE, n_steps)


def drawn(case: str, which: tuple[int, ...]) -> fc.Loop:
    """Valves with the gaps of a case at its start, those of their commissioning."""
    loop = picked(valves(), sample=VALVES[which])
    n = xr.DataArray(loop["backlash"]).sizes["sample"]
    gaps = np.random.default_rng([which[0], 3]).uniform(*GAPS, n)
    inert = xr.DataArray(loop["C_w"]).clip(LEAST_C_W)
    return loop.assign(backlash=("sample", gaps / LARGER * (case != GOOD)), C_w=inert)


def estimates(case: str, kind: str, which: tuple[int, ...]) -> xr.DataArray:
    """Gap that each detector believes in, over detector, sample, day (the sequence), elapsed_time (of all days)."""
    loop, found = drawn(case, which), []
    for first in which:
        days = days_of(kind, first)
        scaled = days.assign(backlash_scale=scale_of(case, days.n_steps))
        of_rules = {
            name: _along(_lived(loop.assign(**rule), scaled, ["estimate"], EVERY).estimate)
            for name, rule in (PASSIVE | {name: controllers()[name] for name in ACTING}).items()
        }
        found.append(xr.concat([*of_rules.values(), *banks(loop, days, scaled)], "detector", join="override"))
    names = [*PASSIVE, *ACTING, *(f"bank, plant {plant}" for plant in PLANTS)]
    return xr.concat(found, "day").assign_coords(detector=names)


def banks(loop: fc.Loop, days: fc.Boundary, scaled: fc.Boundary) -> list[xr.DataArray]:
    """Mean gap after the probabilities of the bank, a bank for each plant: (sample, elapsed_time)."""
    seen = _lived(loop, scaled, ["T_measured", "command"], 5)
    measured = seen.T_measured.values[..., :: INTERVAL // 5]
    commands = np.repeat(seen.command.transpose("sample", "day", "elapsed_time").values, 5, axis=-1)
    new = []
    for k in range(seen.sizes["sample"]):
        models = predicted(picked(loop, sample=k), days, commands[k]).values
        new.append([innovations(measured[k].ravel(), of.reshape(-1, len(CANDIDATES))) for of in models])
    news = np.array(new)  # sample, plant, time, candidate
    at_first = news.shape[2] * BEFORE // SEQUENCE
    found = []
    for p in range(len(PLANTS)):
        of = news[:, p]
        mean = probabilities(of, noise_of(of[:, :at_first])) @ np.array(CANDIDATES)
        each = mean.reshape(mean.shape[0], -1, EVERY // INTERVAL).mean(-1)
        found.append(xr.DataArray(each, dims=("sample", "elapsed_time")))
    return found


def _lived(loop: fc.Loop, days: fc.Boundary, traces: list[str], every: int) -> xr.Dataset:
    ds = fc.simulate(loop, days, carry_over=True, traces=traces, trace_interval=every)[traces].reset_coords(drop=True)
    return ds.transpose("sample", "day", "elapsed_time")


def _along(estimate: xr.DataArray) -> xr.DataArray:
    """One after the other: (sample, elapsed_time)."""
    return xr.DataArray(estimate.values.reshape(estimate.shape[0], -1), dims=("sample", "elapsed_time"))


def alarms(estimate: xr.DataArray, threshold: float) -> xr.DataArray:
    """Hours of operation after the third day until an estimate is so much above that of the third day; inf: never."""
    per_day = estimate.sizes["elapsed_time"] // SEQUENCE
    before = estimate.isel(elapsed_time=slice((BEFORE - 1) * per_day, BEFORE * per_day)).mean("elapsed_time")
    after = estimate.isel(elapsed_time=slice(BEFORE * per_day, None)) - before
    raised = after > threshold
    hours = (raised.argmax("elapsed_time") + 1) * EVERY / 3600.0
    return hours.where(raised.any("elapsed_time"), np.inf)


def threshold_of(found: Estimates, detector: str) -> float:
    """The least threshold with few false alarms; nan: none has."""
    for threshold in THRESHOLDS:
        raised = [
            np.isfinite(alarms(found[case, kind], threshold).sel(detector=detector))
            for case in (STEADY, GOOD)
            for kind in KINDS
        ]
        if np.mean([float(each.mean()) for each in raised]) <= FALSE:
            return threshold
    return np.nan


def run(which: tuple[int, ...]) -> Estimates:
    """The estimates on the days that the thresholds are chosen on, or on fresh ones."""
    done, found = progress(), {}
    cases = (STEADY, GOOD) if which == CHOSEN_ON else (STEADY, GOOD, AT_ONCE, SLOWLY)
    for kind in KINDS:
        for case in cases:
            found[case, kind] = estimates(case, kind, which)
            done(f"{kind}, {case}")
    return found

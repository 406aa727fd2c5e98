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
from studies.common import progress_printer
from studies.days import CONSTANT, STEPPED, make_days
from studies.remedies.runs import select_loop
from studies.wear.runs import controllers, valves

CANDIDATES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.14)  # sizes of the gap that have a model, fraction of stroke
MODEL_INTERVAL = 30  # seconds between the samples that the models are compared at
ERROR_TIME_CONSTANT = 600.0  # time within which an error of a model is taken for a disturbance that stays, s
SOJOURN_SECONDS = 86400.0
"""Time for which the gap keeps its size in the mean, s; then it takes one of the sizes beside it."""
LEAST_PROBABILITY = 1e-6  # probability that a size never falls below
PLANT_FACTORS = {"known": (1.0, 1.0), "5 % off": (0.95, 1.05), "15 % off": (0.85, 1.15)}
"""What a model has for the conductances of the coil and for the flow of the open valve, as shares of the true ones."""


def predict_temperatures(valve: fc.Loop, days: fc.Boundary, command: np.ndarray) -> xr.DataArray:
    """Temperature that the controller would measure with each gap and each plant, °C, every ``MODEL_INTERVAL``.

    valve: its ``backlash`` is that of its commissioning.  command: (day, second).
    """
    conductances, flows = (
        xr.DataArray(list(factors), dims="model") for factors in zip(*PLANT_FACTORS.values(), strict=True)
    )
    plant_parameters = {name: conductances * float(valve[name]) for name in ("beta1", "beta3", "beta5")}
    m_max, a, b, c = installed_valve(*(float(valve[name]) for name in ("rangeability", "authority", "m_full")))
    # a model opens by q / (1 - its own gap), the valve by q / (1 - that of its commissioning)
    sizes = xr.DataArray(list(CANDIDATES), dims="candidate")
    width_ratio = (1.0 - sizes) / (1.0 - float(valve["backlash"]))
    plant_parameters |= {"m_max": flows * m_max, "valve_a": a, "valve_b": b * width_ratio, "valve_c": c / width_ratio}
    models = valve.assign(**plant_parameters, backlash=sizes, noise_std=0.0, estimator="none")
    ds = fc.simulate(
        models, days, command=command, carry_over=True, traces=["T_measured"], trace_interval=MODEL_INTERVAL, n_jobs=1
    )
    temperatures = ds.T_measured.reset_coords(drop=True).assign_coords(model=list(PLANT_FACTORS))
    return temperatures.transpose("model", "day", "elapsed_time", "candidate")


def innovations(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Innovations of the models' errors, K: (time, candidate)."""
    error = measured[:, None] - predicted
    innovation = np.zeros_like(error)
    innovation[1:] = error[1:] - np.exp(-MODEL_INTERVAL / ERROR_TIME_CONSTANT) * error[:-1]
    return innovation


def innovation_std(innovation: np.ndarray) -> np.ndarray:
    """Standard deviation of what is new where the best model explains it, K; innovation: (…, time, candidate)."""
    return np.sqrt((innovation**2).mean(-2).min(-1)) + 1e-4


def gap_probabilities(innovation: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Probability of each gap; innovation: (case, time, candidate), K; noise: (case,), K."""
    n = innovation.shape[-1]
    leave_probability = MODEL_INTERVAL / SOJOURN_SECONDS
    chain = np.eye(n) * (1.0 - leave_probability)
    for j in range(n):
        neighbours = [k for k in (j - 1, j + 1) if 0 <= k < n]
        chain[j, neighbours] = leave_probability / len(neighbours)
    probability = np.full((innovation.shape[0], n), 1.0 / n)
    history = np.empty_like(innovation)
    for k in range(innovation.shape[1]):
        log_likelihood = -0.5 * (innovation[:, k] / noise[:, None]) ** 2
        probability = (probability @ chain) * np.exp(log_likelihood - log_likelihood.max(-1, keepdims=True))
        probability = np.maximum(probability / probability.sum(-1, keepdims=True), LEAST_PROBABILITY)
        probability /= probability.sum(-1, keepdims=True)
        history[:, k] = probability
    return history


SEQUENCE_DAYS = 8
DAYS_BEFORE = 3  # days before the gap changes
DAY_HOURS = 6
GROWTH_FACTOR = 3.0  # by what the gap is multiplied
STEADY, NO_GAP, AT_ONCE, SLOWLY = "constant gap", "no gap", "three times as large at once", "within five days"
KINDS = (STEPPED, CONSTANT)
GROWN_GAPS = (0.03, 0.12)  # between which the gaps lie once they have grown, fraction of stroke
LEAST_C_W = 10.0
"""kJ/K per volume; the models without a gap open further than the valve, and would be unstable with less water."""
CHOICE_FIRST_DAYS, FRESH_FIRST_DAYS = (7501,), (7601, 7701)
"""First days of the sequences that the thresholds are chosen on, and of those that are quoted."""
VALVE_SLICES = {CHOICE_FIRST_DAYS: slice(0, 16), FRESH_FIRST_DAYS: slice(16, 40)}
ESTIMATE_INTERVAL = 600  # seconds between the estimates that are looked at
THRESHOLDS = (0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.08, 0.10)
"""Growth of the estimate that may raise an alarm, fraction of stroke."""
FALSE_ALARM_SHARE = 0.05  # share of sequences with a constant gap that may raise one
PASSIVE_RULES = {
    "identify": {"estimator": "identify", "estimate_share": 0.0},
    "hagglund": {"estimator": "hagglund", "estimate_share": 0.0},
}
ACTING_RULES = ("paper", "gradient")


Estimates = dict[tuple[str, str], xr.DataArray]
"""Gaps estimated by the detectors, by case and kind of day; see ``estimate_gaps``."""


def sequence_days(kind: str, first_day: int) -> fc.Boundary:
    """A sequence of days without any change of the gap."""
    return make_days(kind, list(range(first_day, first_day + SEQUENCE_DAYS)), hours=DAY_HOURS)


def gap_scale(case: str, n_steps: int) -> np.ndarray:
    """Factor of the gap: (day, second)."""
    second = np.arange(SEQUENCE_DAYS * n_steps, dtype=float)
    elapsed_share = (second - DAYS_BEFORE * n_steps) / ((SEQUENCE_DAYS - DAYS_BEFORE) * n_steps)
    grown_share = {
        STEADY: 0.0 * elapsed_share,
        NO_GAP: 0.0 * elapsed_share,
        AT_ONCE: elapsed_share >= 0.0,
        SLOWLY: np.clip(elapsed_share, 0.0, 1.0),
    }[case]
    return (1.0 + (GROWTH_FACTOR - 1.0) * grown_share).reshape(SEQUENCE_DAYS, n_steps)


def valves_of_case(case: str, first_days: tuple[int, ...]) -> fc.Loop:
    """Valves with the gaps of a case at its start, those of their commissioning."""
    loop = select_loop(valves(), sample=VALVE_SLICES[first_days])
    n = xr.DataArray(loop["backlash"]).sizes["sample"]
    gaps = np.random.default_rng([first_days[0], 3]).uniform(*GROWN_GAPS, n)
    C_w = xr.DataArray(loop["C_w"]).clip(LEAST_C_W)
    return loop.assign(backlash=("sample", gaps / GROWTH_FACTOR * (case != NO_GAP)), C_w=C_w)


def estimate_gaps(case: str, kind: str, first_days: tuple[int, ...]) -> xr.DataArray:
    """Gap that each detector believes in, over detector, sample, day (the sequence), elapsed_time (of all days)."""
    loop, sequences = valves_of_case(case, first_days), []
    for first_day in first_days:
        days = sequence_days(kind, first_day)
        worn_days = days.assign(backlash_scale=gap_scale(case, days.n_steps))
        rule_estimates = {
            name: _join_days(
                _simulate_sequence(loop.assign(**rule), worn_days, ["estimate"], ESTIMATE_INTERVAL).estimate
            )
            for name, rule in (PASSIVE_RULES | {name: controllers()[name] for name in ACTING_RULES}).items()
        }
        sequences.append(
            xr.concat([*rule_estimates.values(), *bank_estimates(loop, days, worn_days)], "detector", join="override")
        )
    names = [*PASSIVE_RULES, *ACTING_RULES, *(f"bank, plant {plant}" for plant in PLANT_FACTORS)]
    return xr.concat(sequences, "day").assign_coords(detector=names)


def bank_estimates(loop: fc.Loop, days: fc.Boundary, worn_days: fc.Boundary) -> list[xr.DataArray]:
    """Mean gap after the probabilities of the bank, a bank for each plant: (sample, elapsed_time)."""
    traces = _simulate_sequence(loop, worn_days, ["T_measured", "command"], 5)
    readings = traces.T_measured.values[..., :: MODEL_INTERVAL // 5]
    commands = np.repeat(traces.command.transpose("sample", "day", "elapsed_time").values, 5, axis=-1)
    by_valve = []
    for k in range(traces.sizes["sample"]):
        models = predict_temperatures(select_loop(loop, sample=k), days, commands[k]).values
        by_valve.append(
            [innovations(readings[k].ravel(), plant_models.reshape(-1, len(CANDIDATES))) for plant_models in models]
        )
    innovation = np.array(by_valve)  # sample, plant, time, candidate
    n_before = innovation.shape[2] * DAYS_BEFORE // SEQUENCE_DAYS
    means = []
    for p in range(len(PLANT_FACTORS)):
        plant_models = innovation[:, p]
        mean = gap_probabilities(plant_models, innovation_std(plant_models[:, :n_before])) @ np.array(CANDIDATES)
        estimate = mean.reshape(mean.shape[0], -1, ESTIMATE_INTERVAL // MODEL_INTERVAL).mean(-1)
        means.append(xr.DataArray(estimate, dims=("sample", "elapsed_time")))
    return means


def _simulate_sequence(loop: fc.Loop, days: fc.Boundary, traces: list[str], every: int) -> xr.Dataset:
    ds = fc.simulate(loop, days, carry_over=True, traces=traces, trace_interval=every)[traces].reset_coords(drop=True)
    return ds.transpose("sample", "day", "elapsed_time")


def _join_days(estimate: xr.DataArray) -> xr.DataArray:
    """Join the days of a sequence: (sample, elapsed_time)."""
    return xr.DataArray(estimate.values.reshape(estimate.shape[0], -1), dims=("sample", "elapsed_time"))


def alarm_hours(estimate: xr.DataArray, threshold: float) -> xr.DataArray:
    """Hours of operation after the third day until an estimate is so much above that of the third day; inf: never."""
    per_day = estimate.sizes["elapsed_time"] // SEQUENCE_DAYS
    before = estimate.isel(elapsed_time=slice((DAYS_BEFORE - 1) * per_day, DAYS_BEFORE * per_day)).mean("elapsed_time")
    after = estimate.isel(elapsed_time=slice(DAYS_BEFORE * per_day, None)) - before
    is_raised = after > threshold
    hours = (is_raised.argmax("elapsed_time") + 1) * ESTIMATE_INTERVAL / 3600.0
    return hours.where(is_raised.any("elapsed_time"), np.inf)


def choose_threshold(gap_estimates: Estimates, detector: str) -> float:
    """The least threshold with few false alarms; nan: none has."""
    for threshold in THRESHOLDS:
        alarms_by_case = [
            np.isfinite(alarm_hours(gap_estimates[case, kind], threshold).sel(detector=detector))
            for case in (STEADY, NO_GAP)
            for kind in KINDS
        ]
        if np.mean([float(is_raised.mean()) for is_raised in alarms_by_case]) <= FALSE_ALARM_SHARE:
            return threshold
    return np.nan


def run(first_days: tuple[int, ...]) -> Estimates:
    """The estimates on the days that the thresholds are chosen on, or on fresh ones."""
    report, by_case = progress_printer(), {}
    cases = (STEADY, NO_GAP) if first_days == CHOICE_FIRST_DAYS else (STEADY, NO_GAP, AT_ONCE, SLOWLY)
    for kind in KINDS:
        for case in cases:
            by_case[case, kind] = estimate_gaps(case, kind, first_days)
            report(f"{kind}, {case}")
    return by_case

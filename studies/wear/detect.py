"""How soon a growing gap is noticed: the bank of models that the seed cites beside the estimators of the package.

All see the same loops under plain PI on the same days, but for the rules that need their own inverse to learn anything.
The gap is constant for three days, and from then on constant, three times as large, or growing to that over five days.
"""

from __future__ import annotations

import time

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.days import CONSTANT, STEPPED, of_kind
from studies.remedies.run import picked
from studies.wear.bank import CANDIDATES, INTERVAL, PLANTS, foretold, innovations, noise_of, probabilities
from studies.wear.valves import controllers, valves

DAYS, BEFORE, HOURS = 8, 3, 6
LARGER = 3.0
"""By what the gap is multiplied."""
STEADY, GOOD, AT_ONCE, SLOWLY = "constant gap", "no gap", "three times as large at once", "within five days"
KINDS = (STEPPED, CONSTANT)
GAPS = (0.03, 0.12)
"""Between which the gaps lie at the end, fraction of stroke."""
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
    return of_kind(kind, list(range(first, first + DAYS)), hours=HOURS)


def scale_of(case: str, n_steps: int) -> np.ndarray:
    """What the gap is multiplied by: (day, second)."""
    second = np.arange(DAYS * n_steps, dtype=float)
    since = (second - BEFORE * n_steps) / ((DAYS - BEFORE) * n_steps)
    grown = {STEADY: 0.0 * since, GOOD: 0.0 * since, AT_ONCE: since >= 0.0, SLOWLY: np.clip(since, 0.0, 1.0)}[case]
    return ((1.0 + (LARGER - 1.0) * grown) / LARGER).reshape(DAYS, n_steps)


def drawn(case: str, which: tuple[int, ...]) -> fc.Loop:
    """Valves with the gaps of a case at its end."""
    loop = picked(valves(), sample=VALVES[which])
    n = xr.DataArray(loop["backlash"]).sizes["sample"]
    gaps = np.random.default_rng([which[0], 3]).uniform(*GAPS, n)
    return loop.assign(backlash=("sample", gaps * (case != GOOD)))


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
        models = foretold(picked(loop, sample=k), days, commands[k]).values
        new.append([innovations(measured[k].ravel(), of.reshape(-1, len(CANDIDATES))) for of in models])
    news = np.array(new)  # sample, plant, time, candidate
    at_first = news.shape[2] * BEFORE // DAYS
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
    per_day = estimate.sizes["elapsed_time"] // DAYS
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
    started, found = time.monotonic(), {}
    cases = (STEADY, GOOD) if which == CHOSEN_ON else (STEADY, GOOD, AT_ONCE, SLOWLY)
    for kind in KINDS:
        for case in cases:
            found[case, kind] = estimates(case, kind, which)
            print(f"{kind}, {case} after {time.monotonic() - started:.0f} s", flush=True)
    return found

"""Hunting with noise on the sensor: what the rule and ``fc.limit_cycle`` still promise, at each sample time.

The conditions stand still, so that nothing but the loop and its noise can move the temperature, and every day starts
with a cold plant: a cycle that needs a start gets it without noise, too.  The rule is that which ``hunting.py`` chose
without noise, on other valves; the limit of 3 was chosen on valves of seed 7001.  A loop hunts where the metric
``hunts`` says so: a regular swing of more than 0.1 K of the temperature itself, not of its reading.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import compare_rows, concat_along, pool_days, write_table
from studies.hunting.loops import (
    OPERATING_KINDS,
    WARM_UP_SECONDS,
    adapt_to_kind,
    conditions,
    integral_speed,
    is_usable,
    loop_parameters,
    loop_properties,
    share_or_dash,
    valves,
)

NOISE_LEVELS = (0.0, 0.01, 0.02, 0.05)  # standard deviations, K
SAMPLE_TIMES = (5.0, 10.0, 20.0, 30.0, 60.0)
INDEX_EDGES = (0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, np.inf)  # between which the index of the rule is grouped
INDEX_NAME = "(kp K)^0.7 (T + 2 θ) / Ti"
LIMITS = (5.0, 4.0, 3.0, 2.0)
BACKLASH_SIZES = (0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15)
SEED, VALVES, DAYS = 16001, 512, 6
GAP_LABELS = ("with", "without")


def rule_index(ds: xr.Dataset) -> xr.DataArray:
    """The index of the rule, of ``hunting.py``."""
    return integral_speed(ds, 0.7, 2.0)


def population(seed: int, size: int, days: int, gaps: Sequence[str] = GAP_LABELS) -> xr.Dataset:
    """Fresh loops at each noise, as they are or without their gap: (sample, day, noise, gap)."""
    all_valves = valves(seed, size).assign(
        sample_time=("sample", np.random.default_rng([seed, 7]).choice(SAMPLE_TIMES, size)),
        backlash=("sample", np.random.default_rng([seed, 8]).choice(BACKLASH_SIZES, size)),
    )
    parts = {}
    for kind in OPERATING_KINDS:
        loop, day = adapt_to_kind(all_valves, kind), conditions(kind, seed + 1, days)
        loops_by_gap = {"with": loop, "without": loop.assign(backlash=0.0)}
        parts[kind] = concat_along("gap", {gap: _simulate_noises(loops_by_gap[gap], day, seed) for gap in gaps})
    return pool_days(parts, data_vars="all")


def _simulate_noises(loop: fc.Loop, day: fc.Boundary, seed: int) -> xr.Dataset:
    by_noise = {
        noise: fc.simulate(loop.assign(noise_std=noise), day, warm_up=WARM_UP_SECONDS, seed=seed)[["hunts"]]
        for noise in NOISE_LEVELS
    }
    ds = concat_along("noise", {noise: metrics.reset_coords(drop=True) for noise, metrics in by_noise.items()})
    predicted = fc.limit_cycle(loop, day).hunts.reset_coords(drop=True).rename("predicted")
    parameters = loop_parameters(loop, "kp", "ti", "backlash", "sample_time")
    return xr.merge([ds, loop_properties(loop, day), predicted, parameters], compat="override")


def rows_by_index(ds: xr.Dataset) -> Iterator[list[str]]:
    """Shares that hunt at each noise, by the index, with the gap and without."""
    for gap in ds.gap.values:
        of_gap = ds.sel(gap=gap)
        for low, high in pairwise(INDEX_EDGES):
            is_inside = is_usable(of_gap) & (rule_index(of_gap) >= low) & (rule_index(of_gap) < high)
            label = f"above {low:g}" if np.isinf(high) else f"{low:g} to {high:g}"
            shares = [
                share_or_dash(of_gap.hunts.sel(noise=noise) > 0.0, is_inside.sel(noise=noise)) for noise in NOISE_LEVELS
            ]
            yield [gap, label, f"{int(is_inside.isel(noise=0).sum()):,}", *shares]


def rows_by_limit(ds: xr.Dataset) -> Iterator[list[str]]:
    """Shares of hunting loops among those that keep the index below a limit, with a gap."""
    with_gap = ds.sel(gap="with")
    among, hunts = is_usable(with_gap), with_gap.hunts > 0.0
    for limit in LIMITS:
        obeys = rule_index(with_gap) <= limit
        shares = [share_or_dash(hunts.sel(noise=n), (among & obeys).sel(noise=n)) for n in NOISE_LEVELS]
        is_calm = (among & ~hunts).isel(noise=0)
        yield [f"Ti ≥ (kp K)^0.7 (T + 2 θ) / {limit:g}", share_or_dash(obeys, among.isel(noise=0), 0), *shares,
               share_or_dash(~obeys, is_calm, 0)]  # fmt: skip


def rows_by_sample_time(ds: xr.Dataset) -> Iterator[list[str]]:
    """How many hunt below the limits, by the sample time of the controller, with a gap."""
    with_gap = ds.sel(gap="with")
    for sample_time in SAMPLE_TIMES:
        row = [f"{sample_time:g} s"]
        for limit in (5.0, 3.0):
            obeys = is_usable(with_gap) & (rule_index(with_gap) <= limit) & (with_gap.sample_time == sample_time)
            row += [share_or_dash(with_gap.hunts.sel(noise=n) > 0.0, obeys.sel(noise=n)) for n in NOISE_LEVELS]
        yield row


def prediction_rows(ds: xr.Dataset) -> Iterator[list[str]]:
    """How good ``fc.limit_cycle`` and the rule are at each noise."""
    for gap in ds.gap.values:
        for noise in NOISE_LEVELS:
            of_noise = ds.sel(gap=gap, noise=noise)
            among, is_hunting, row = is_usable(of_noise), of_noise.hunts > 0.0, [gap, f"{noise:g} K"]
            row.append(share_or_dash(is_hunting, among, 0))
            for is_predicted in (of_noise.predicted > 0.0, rule_index(of_noise) > LIMITS[0]):
                is_right = is_predicted == is_hunting
                row += [share_or_dash(is_right, part) for part in (among, among & is_hunting, among & ~is_hunting)]
            yield row


def sample() -> None:
    """Run a sample of the study: the loops without their gap."""
    ds = population(SEED, VALVES, DAYS, GAP_LABELS[1:])
    compare_rows("hunting/hunting_noise", rows_by_index(ds))
    compare_rows("hunting/hunting_noise_predicted", prediction_rows(ds))


def main() -> None:
    """Write the tables."""
    ds = population(SEED, VALVES, DAYS)
    cases_text = f"{VALVES} fresh valves × {ds.sizes['day']} constant conditions"
    noises = [f"noise {noise:g} K" for noise in NOISE_LEVELS]
    write_table("hunting/hunting_noise", f"Share of the loops that hunt, by {INDEX_NAME}: {cases_text}",
                ["gap", "index", "loops", *noises], rows_by_index(ds))  # fmt: skip
    write_table("hunting/hunting_noise_limits",
                f"Share of hunting loops among those that meet each rule, with a gap: {cases_text}",
                ["rule", "meet it", *noises, "calm loops that it forbids, without noise"],
                rows_by_limit(ds))  # fmt: skip
    heads = [f"{noise}, index up to {limit:g}" for limit in (5.0, 3.0) for noise in noises]
    write_table("hunting/hunting_noise_sampling",
                f"Share of hunting loops among those that meet the rule, by sample time, with a gap: {cases_text}",
                ["sample time", *heads], rows_by_sample_time(ds))  # fmt: skip
    heads = [f"{name}: {case_words}" for name in ("`fc.limit_cycle`", f"{INDEX_NAME} > {LIMITS[0]:g}")
             for case_words in ("right", "of those that hunt", "of the calm")]  # fmt: skip
    write_table("hunting/hunting_noise_predicted", f"Predictions of hunting at each level of noise: {cases_text}",
                ["gap", "noise", "hunt", *heads], prediction_rows(ds))  # fmt: skip

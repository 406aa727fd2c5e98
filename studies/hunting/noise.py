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
from studies.common import along, compare_rows, pooled, write_table
from studies.hunting.loops import (
    OPERATING,
    WARM_UP,
    able,
    acting,
    conditions,
    foreseen,
    of_loop,
    share_written,
    speed,
    valves,
)

NOISE = (0.0, 0.01, 0.02, 0.05)
"""K, standard deviation."""
SAMPLE_TIMES = (5.0, 10.0, 20.0, 30.0, 60.0)
EDGES = (0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, np.inf)
"""Of the index."""
INDEX, LIMITS = "(kp K)^0.7 (T + 2 θ) / Ti", (5.0, 4.0, 3.0, 2.0)
SIZES = (0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15)
SEED, VALVES, DAYS = 16001, 512, 6
GAPS = ("with", "without")


def index(ds: xr.Dataset) -> xr.DataArray:
    """The index of the rule, of ``hunting.py``."""
    return speed(ds, 0.7, 2.0)


def population(seed: int, size: int, days: int, gaps: Sequence[str] = GAPS) -> xr.Dataset:
    """Fresh loops at each noise, as they are or without their gap: (sample, day, noise, gap)."""
    drawn = valves(seed, size).assign(
        sample_time=("sample", np.random.default_rng([seed, 7]).choice(SAMPLE_TIMES, size)),
        backlash=("sample", np.random.default_rng([seed, 8]).choice(SIZES, size)),
    )
    parts = {}
    for kind in OPERATING:
        loop, day = acting(drawn, kind), conditions(kind, seed + 1, days)
        ways = {"with": loop, "without": loop.assign(backlash=0.0)}
        parts[kind] = along("gap", {gap: _at_noises(ways[gap], day, seed) for gap in gaps})
    return pooled(parts, data_vars="all")


def _at_noises(loop: fc.Loop, day: fc.Boundary, seed: int) -> xr.Dataset:
    found = {
        noise: fc.simulate(loop.assign(noise_std=noise), day, warm_up=WARM_UP, seed=seed)[["hunts"]] for noise in NOISE
    }
    ds = along("noise", {noise: one.reset_coords(drop=True) for noise, one in found.items()})
    predicted = fc.limit_cycle(loop, day).hunts.reset_coords(drop=True).rename("predicted")
    known = of_loop(loop, "kp", "ti", "backlash", "sample_time")
    return xr.merge([ds, foreseen(loop, day), predicted, known], compat="override")


def by_index(ds: xr.Dataset) -> Iterator[list[str]]:
    """Shares that hunt at each noise, by the index, with the gap and without."""
    for gap in ds.gap.values:
        at = ds.sel(gap=gap)
        for low, high in pairwise(EDGES):
            inside = able(at) & (index(at) >= low) & (index(at) < high)
            words = f"above {low:g}" if np.isinf(high) else f"{low:g} to {high:g}"
            shares = [share_written(at.hunts.sel(noise=noise) > 0.0, inside.sel(noise=noise)) for noise in NOISE]
            yield [gap, words, f"{int(inside.isel(noise=0).sum()):,}", *shares]


def by_limit(ds: xr.Dataset) -> Iterator[list[str]]:
    """What becomes of those who keep the index below a limit, with a gap."""
    at = ds.sel(gap="with")
    among, hunts = able(at), at.hunts > 0.0
    for limit in LIMITS:
        obeys = index(at) <= limit
        of_noise = [share_written(hunts.sel(noise=n), (among & obeys).sel(noise=n)) for n in NOISE]
        calm = (among & ~hunts).isel(noise=0)
        yield [f"Ti ≥ (kp K)^0.7 (T + 2 θ) / {limit:g}", share_written(obeys, among.isel(noise=0), 0), *of_noise,
               share_written(~obeys, calm, 0)]  # fmt: skip


def by_sample_time(ds: xr.Dataset) -> Iterator[list[str]]:
    """How many hunt below the limits, by the sample time of the controller, with a gap."""
    at = ds.sel(gap="with")
    for sample_time in SAMPLE_TIMES:
        row = [f"{sample_time:g} s"]
        for limit in (5.0, 3.0):
            obeys = able(at) & (index(at) <= limit) & (at.sample_time == sample_time)
            row += [share_written(at.hunts.sel(noise=n) > 0.0, obeys.sel(noise=n)) for n in NOISE]
        yield row


def predicted(ds: xr.Dataset) -> Iterator[list[str]]:
    """How good ``fc.limit_cycle`` and the rule are at each noise."""
    for gap in ds.gap.values:
        for noise in NOISE:
            at = ds.sel(gap=gap, noise=noise)
            among, true, row = able(at), at.hunts > 0.0, [gap, f"{noise:g} K"]
            row.append(share_written(true, among, 0))
            for said in (at.predicted > 0.0, index(at) > LIMITS[0]):
                right = said == true
                row += [share_written(right, part) for part in (among, among & true, among & ~true)]
            yield row


def sample() -> None:
    """The loops without their gap."""
    ds = population(SEED, VALVES, DAYS, GAPS[1:])
    compare_rows("hunting/hunting_noise", by_index(ds))
    compare_rows("hunting/hunting_noise_predicted", predicted(ds))


def main() -> None:
    """Write the tables."""
    ds = population(SEED, VALVES, DAYS)
    of = f"{VALVES} fresh valves × {ds.sizes['day']} constant conditions"
    noises = [f"noise {noise:g} K" for noise in NOISE]
    write_table("hunting/hunting_noise", f"Share of the loops that hunt, by {INDEX}: {of}",
                ["gap", "index", "loops", *noises], by_index(ds))  # fmt: skip
    write_table("hunting/hunting_noise_limits",
                f"Share of hunting loops among those that meet each rule, with a gap: {of}",
                ["rule", "meet it", *noises, "calm loops that it forbids, without noise"], by_limit(ds))  # fmt: skip
    heads = [f"{noise}, index up to {limit:g}" for limit in (5.0, 3.0) for noise in noises]
    write_table("hunting/hunting_noise_sampling",
                f"Share of hunting loops among those that meet the rule, by sample time, with a gap: {of}",
                ["sample time", *heads], by_sample_time(ds))  # fmt: skip
    heads = [f"{name}: {what}" for name in ("`fc.limit_cycle`", f"{INDEX} > {LIMITS[0]:g}")
             for what in ("right", "of those that hunt", "of the calm")]  # fmt: skip
    write_table("hunting/hunting_noise_predicted", f"Predictions of hunting at each level of noise: {of}",
                ["gap", "noise", "hunt", *heads], predicted(ds))  # fmt: skip

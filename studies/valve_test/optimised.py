"""Is there a better relay?  A random search over its rate, threshold and hold for the one whose test tells most.

Each relay is judged by the bound of ``studies.valve_test.bound``, so that the reading does not favour the one it was
made for.  The best of the search and the shipped relay then meet on other valves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import fastcoil as fc
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE
from studies.common import compare_rows, loguniform, write_table
from studies.valve_test.bound import HEAD, SEED, VALVES, bounded, row
from studies.valve_test.valve_test import START, Case

TRIED, TRIED_ON, TRIED_SEED = 32, 24, 8671
"""Relays that are drawn, valves on which each is judged, and the seed of both."""
RATES, THRESHOLDS, HOLDS = (2e-4, 1.6e-3), (0.05, 0.6), (20.0, 300.0)
"""1/s, no faster than a motor of 150 s; K; s."""
LIMIT = 1.5
"""K: the excursion of 95 % of the tests may be no larger."""
BEST = 3


class Tried(NamedTuple):
    """A relay, its bound relative to what makes a claim right, median, and the excursion of 95 % of its tests, K."""

    test: fc.ValveTest
    bound: float
    excursion: float


def tried(test: fc.ValveTest) -> Tried:
    """Judge a relay on the valves of the search."""
    found = bounded(Case(test=test), TRIED_SEED, TRIED_ON)
    enough = found.gap.size >= TRIED_ON // 2  # tests that are aborted tell nothing
    share = found.bound / np.maximum(SIZE_TOLERANCE * found.gap, GOOD_BACKLASH)
    return Tried(test, float(np.median(share)) if enough else np.inf, float(np.quantile(found.excursion, 0.95)))


def optimised() -> list[fc.ValveTest]:
    """Relays of 20 min that tell most, of those drawn, and within the limit."""
    draw = np.random.default_rng(TRIED_SEED)
    found = []
    for _ in range(TRIED):
        rate, threshold, hold = (loguniform(draw, *ends, 1)[0] for ends in (RATES, THRESHOLDS, HOLDS))
        relay = {"rate": float(f"{rate:.2g}"), "threshold": float(f"{threshold:.2g}"), "hold": float(round(hold))}
        found.append(tried(fc.ValveTest(start=START, **relay)))
        print(relay, *found[-1][1:], flush=True)
    within = [one for one in found if one.excursion <= LIMIT]
    return [one.test for one in sorted(within, key=lambda one: one.bound)[:BEST]]


SHIPPED = " (as shipped)"


def shown(test: fc.ValveTest, note: str = "") -> list[str]:
    """The row of a relay."""
    name = f"{100 * test.rate:.3g} %/s, threshold {test.threshold:g} K, holds {test.hold:g} s{note}"
    return [name, *row(bounded(Case(test=test), SEED + 50))]


def sample() -> None:
    """The shipped relay."""
    compare_rows("valve_test/valve_test_optimised", [shown(fc.ValveTest(start=START), SHIPPED)])


def main() -> None:
    """Write what the best relays tell on other valves, beside the shipped one."""
    rows = [shown(fc.ValveTest(start=START), SHIPPED), *map(shown, optimised())]
    title = (
        f"The most informative 20-min relay tests of {TRIED} drawn at random, excursion limit {LIMIT:g} K: "
        f"{VALVES} other valves"
    )
    write_table("valve_test/valve_test_optimised", title, HEAD, rows)

"""Is there a better relay?  A random search over its rate, threshold and hold for the one whose test tells most.

Each relay is judged by the bound of ``studies.valve_test.bound``, so that the reading does not favour the one it was
made for.  The best of the search and the shipped relay then meet on other valves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import fastcoil as fc
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE
from studies.common import compare_rows, draw_loguniform, write_table
from studies.valve_test.bound import HEAD, SEED, VALVES, bound_case, bound_row
from studies.valve_test.valve_test import TEST_START, Case

SEARCH_RELAYS, SEARCH_VALVES, SEARCH_SEED = 32, 24, 8671
"""Relays that are drawn, valves on which each is judged, and the seed of both."""
RATES, THRESHOLDS, HOLDS = (2e-4, 1.6e-3), (0.05, 0.6), (20.0, 300.0)
"""1/s, no faster than a motor of 150 s; K; s."""
EXCURSION_LIMIT = 1.5  # K: the excursion of 95 % of the tests may be no larger
BEST_COUNT = 3


class RelayScore(NamedTuple):
    """A relay, its bound relative to what makes a claim right, median, and the excursion of 95 % of its tests, K."""

    test: fc.ValveTest
    bound: float
    excursion: float


def judge_relay(test: fc.ValveTest) -> RelayScore:
    """Judge a relay on the valves of the search."""
    readings = bound_case(Case(test=test), SEARCH_SEED, SEARCH_VALVES)
    has_enough = readings.gap.size >= SEARCH_VALVES // 2  # tests that are aborted tell nothing
    relative_bound = readings.bound / np.maximum(SIZE_TOLERANCE * readings.gap, GOOD_BACKLASH)
    return RelayScore(
        test, float(np.median(relative_bound)) if has_enough else np.inf, float(np.quantile(readings.excursion, 0.95))
    )


def search_relays() -> list[fc.ValveTest]:
    """Relays of 20 min that tell most, of those drawn, and within the limit."""
    rng = np.random.default_rng(SEARCH_SEED)
    scores = []
    for _ in range(SEARCH_RELAYS):
        rate, threshold, hold = (draw_loguniform(rng, *limits, 1)[0] for limits in (RATES, THRESHOLDS, HOLDS))
        relay = {"rate": float(f"{rate:.2g}"), "threshold": float(f"{threshold:.2g}"), "hold": float(round(hold))}
        scores.append(judge_relay(fc.ValveTest(start=TEST_START, **relay)))
        print(relay, *scores[-1][1:], flush=True)
    acceptable = [score for score in scores if score.excursion <= EXCURSION_LIMIT]
    return [score.test for score in sorted(acceptable, key=lambda score: score.bound)[:BEST_COUNT]]


SHIPPED_NOTE = " (as shipped)"


def relay_row(test: fc.ValveTest, note: str = "") -> list[str]:
    """The row of a relay."""
    name = f"{100 * test.rate:.3g} %/s, threshold {test.threshold:g} K, holds {test.hold:g} s{note}"
    return [name, *bound_row(bound_case(Case(test=test), SEED + 50))]


def sample() -> None:
    """Run a sample of the study: the shipped relay."""
    compare_rows("valve_test/valve_test_optimised", [relay_row(fc.ValveTest(start=TEST_START), SHIPPED_NOTE)])


def main() -> None:
    """Write what the best relays tell on other valves, beside the shipped one."""
    rows = [relay_row(fc.ValveTest(start=TEST_START), SHIPPED_NOTE), *map(relay_row, search_relays())]
    title = (
        f"The most informative 20-min relay tests of {SEARCH_RELAYS} drawn at random, excursion limit "
        f"{EXCURSION_LIMIT:g} K: "
        f"{VALVES} other valves"
    )
    write_table("valve_test/valve_test_optimised", title, HEAD, rows)

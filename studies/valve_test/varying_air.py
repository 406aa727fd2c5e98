"""Whether a valve can be tested in a unit whose air flow varies (VAV), by kind of day.

The air flow of design days swings by a sum of three sines of 10 to 60 min, or jumps as boxes open and close.  The rules
of waiting and of the limit were chosen on valves and days of seed 101.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import fastcoil as fc
from fastcoil.model.metric_table import TEST_ABORTED_MEANINGS
from studies.common import compare_rows, draw_loguniform, share_of, write_table
from studies.days import DESIGN
from studies.diagnosis.diagnosis import Population
from studies.valve_test.valve_test import TEST_START, Case, CaseReadings, read_case

SEED, VALVES, DAYS = 9691, 48, 16
SWING_PERIODS_S = (600.0, 3600.0)
BOX_TIMES_S = (300.0, 1200.0)  # between two boxes that open or close
BOX_SHARE = 0.1  # of the air flow that a box takes


def swinging_air(share: float) -> Callable[[np.random.Generator, np.ndarray], np.ndarray]:
    """Return air that swings by a share of its flow."""

    def air(rng: np.random.Generator, seconds: np.ndarray) -> np.ndarray:
        periods = draw_loguniform(rng, *SWING_PERIODS_S, 3)[:, np.newaxis]
        swing = np.sin(2.0 * np.pi * (seconds / periods + rng.uniform(size=(3, 1)))).sum(axis=0)
        return 1.0 + share * swing / np.abs(swing).max()

    return air


def jumping_air(rng: np.random.Generator, seconds: np.ndarray) -> np.ndarray:
    """Air whose flow jumps within 30 % of its mean as one of six boxes opens or closes."""
    boxes, t = 3, 0.0
    share = np.empty(seconds.size)
    while t < seconds.size:
        share[int(t) :] = 1.0 + BOX_SHARE * (boxes - 3)
        boxes += 1 if boxes == 0 or (boxes < 6 and rng.random() < 0.5) else -1
        t += rng.uniform(*BOX_TIMES_S)
    return share


TEST, LOGGED = fc.ValveTest(start=TEST_START), ("m_a",)
CASES = {
    "air flow constant": Case(Population(DESIGN), TEST, inputs=LOGGED),
    "swings by ± 10 %": Case(Population(DESIGN), TEST, air=swinging_air(0.1), inputs=LOGGED),
    "swings by ± 20 %": Case(Population(DESIGN), TEST, air=swinging_air(0.2), inputs=LOGGED),
    "swings by ± 20 %, m_a not logged": Case(Population(DESIGN), TEST, air=swinging_air(0.2)),
    "swings by ± 30 %": Case(Population(DESIGN), TEST, air=swinging_air(0.3), inputs=LOGGED),
    "jumps by 10 % every 5 to 20 min": Case(Population(DESIGN), TEST, air=jumping_air, inputs=LOGGED),
}
REFUSED = TEST_ABORTED_MEANINGS.index("varying_air")

HEAD = (
    "air flow", "units", "refused, nothing moved", "ended early", "to their end", "wait, median · 95 %, min",
    "excursion, median · 95 %, K", "gap claimed, of all units", "claims that are right", "good valves accused",
)  # fmt: skip


def air_cells(readings: CaseReadings) -> list[str]:
    """Format the readings of a kind of day as a row; shares are of all units, also those whose test was refused."""
    is_refused = readings.aborted == REFUSED
    is_unit = readings.began | (is_refused & readings.own)
    wait, excursion = (
        [float(values.where(readings.began).quantile(q)) for q in (0.5, 0.95)]
        for values in (readings.wait / 60.0, readings.excursion)
    )
    right = share_of(readings.right, readings.claimed).to_text(1) if bool(readings.claimed.any()) else "no claim"
    return [
        f"{int(is_unit.sum())}", f"{int((is_refused & is_unit).sum())}",
        f"{int((readings.began & ~readings.ended).sum())}", f"{share_of(readings.ended, is_unit)}",
        f"{wait[0]:.0f} · {wait[1]:.0f}", f"{excursion[0]:.2f} · {excursion[1]:.2f}",
        f"{share_of(readings.claimed, is_unit)}", right, f"{int(readings.accused.sum())} of {int(readings.good.sum())}",
    ]  # fmt: skip


def air_row(k: int) -> list[str]:
    """Simulate and read a kind of day; air that is not logged is that of the row before."""
    label = list(CASES)[k]
    case = CASES[label]
    return [label, *air_cells(read_case(case, SEED + k - (not case.inputs), VALVES, DAYS))]


def sample() -> None:
    """Run a sample of the study: air that jumps."""
    compare_rows("valve_test/varying_air", [air_row(len(CASES) - 1)])


def main() -> None:
    """Write the table."""
    rows = []
    for k in range(len(CASES)):
        rows.append(air_row(k))
        print(rows[-1], flush=True)
    title = f"Valve tests of 20 min where the air flow varies: {VALVES} units on {DAYS} design days"
    write_table("valve_test/varying_air", title, HEAD, rows)

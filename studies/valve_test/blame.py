"""Why loops swing, after a valve test whose first hold is a quarter of an hour, beside what the log alone tells.

The loops and the truth are those of ``diagnosis.cause``, with other seeds: the test is in the log only.
"""

from __future__ import annotations

from typing import NamedTuple

from joblib import Parallel, delayed

import fastcoil as fc
from studies.common import compare_rows, write_table
from studies.days import CONSTANT, DESIGN
from studies.diagnosis.cause import ANSWERS, CAUSES, SWINGING, counted, logs, of_logs

SEED, VALVES, DAY = 9651, 256, 96511
KINDS = (CONSTANT, DESIGN, SWINGING)
TEST = fc.ValveTest(start=4 * 3600, minutes=45, settle=900)
BEFORE = TEST.start / 3600
"""Hours of normal operation in the log before the test."""


class Answer(NamedTuple):
    """What the log alone and what the test says of a loop, and what is true."""

    kind: str
    true: str
    alone: str
    tested: str


def answers(kind: str, seed: int = SEED, n: int = VALVES, day_seed: int = DAY) -> list[Answer]:
    """Read the test of every loop of a kind, and diagnose the log before it."""
    of = logs(kind, seed, n, day_seed, TEST)
    found = []
    for log, true, stroke_time in zip(of.logs, of.cause, of.stroke_time.tolist(), strict=True):
        before = log.where(log.elapsed_time < TEST.start, drop=True).drop_vars("test")
        alone = fc.diagnose(before, stroke_time=stroke_time).cause
        began = bool((log.test > 0.0).any())
        tested = fc.read_test(log, stroke_time=stroke_time).cause if began else alone
        found.append(Answer(kind, true, alone, tested))
    return found


def sample() -> None:
    """The first kind of day."""
    compare_rows("valve_test/blame", counted(KINDS[0], [(one.true, one.tested) for one in answers(KINDS[0])]))


def main() -> None:
    """Write the tables."""
    of_kinds = Parallel(n_jobs=-1)(delayed(answers)(kind) for kind in KINDS)
    everything = [one for found in of_kinds for one in found]
    rows = []
    for kind, found in zip(KINDS, of_kinds, strict=True):
        rows += counted(kind, [(one.true, one.tested) for one in found])
    title = f"Why loops swing, after a test: {VALVES} valves on a day of each kind; diagnosed cause by true cause"
    write_table("valve_test/blame", title, ["day", "truth", "loops", *ANSWERS], rows)  # fmt: skip
    summary = []
    for answer in CAUSES:
        row = [answer]
        for way in ("alone", "tested"):
            given = [one for one in everything if getattr(one, way) == answer]
            true = [one for one in everything if one.true == answer]
            row += [str(len(given)), of_logs([one.true == answer for one in given]),
                    of_logs([getattr(one, way) == answer for one in true])]  # fmt: skip
        summary.append(row)
    head = [f"{what}, {way}" for way in (f"log of {BEFORE:.0f} h alone", "with the test")
            for what in ("answers", "right of these", "share of the true ones")]  # fmt: skip
    title = f"Causes diagnosed from the log alone and with the test: {len(everything)} loops"
    write_table("valve_test/blame_answers", title, ["cause", *head], summary)

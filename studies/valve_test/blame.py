"""Why loops swing, after a valve test whose first hold is a quarter of an hour, beside what the log alone tells.

The loops and the truth are those of ``diagnosis.cause``, with other seeds: the test is in the log only.
"""

from __future__ import annotations

from typing import NamedTuple

from joblib import Parallel, delayed

import fastcoil as fc
from studies.common import compare_rows, write_table
from studies.days import CONSTANT, DESIGN
from studies.diagnosis.cause import ANSWERS, CAUSES, SWINGING, count_answers, share_of_logs, simulate_logs

SEED, VALVES, DAY_SEED = 9651, 256, 96511
KINDS = (CONSTANT, DESIGN, SWINGING)
TEST = fc.ValveTest(start=4 * 3600, minutes=45, settle=900)
HOURS_BEFORE_TEST = TEST.start / 3600  # hours of normal operation in the log before the test


class Answer(NamedTuple):
    """Cause of a swing from the log alone and from the test, and the truth."""

    kind: str
    true_cause: str
    log_cause: str
    test_cause: str


def read_answers(kind: str, seed: int = SEED, n: int = VALVES, day_seed: int = DAY_SEED) -> list[Answer]:
    """Read the test of every loop of a kind, and diagnose the log before it."""
    logs_of_kind = simulate_logs(kind, seed, n, day_seed, TEST)
    answers = []
    for log, cause, stroke_time in zip(
        logs_of_kind.logs, logs_of_kind.cause, logs_of_kind.stroke_time.tolist(), strict=True
    ):
        before = log.where(log.elapsed_time < TEST.start, drop=True).drop_vars("test")
        alone = fc.diagnose(before, stroke_time=stroke_time).cause
        has_test = bool((log.test > 0.0).any())
        tested = fc.read_test(log, stroke_time=stroke_time).cause if has_test else alone
        answers.append(Answer(kind, cause, alone, tested))
    return answers


def sample() -> None:
    """Run a sample of the study: the first kind of day."""
    compare_rows(
        "valve_test/blame",
        count_answers(KINDS[0], [(answer.true_cause, answer.test_cause) for answer in read_answers(KINDS[0])]),
    )


def main() -> None:
    """Write the tables."""
    answers_by_kind = Parallel(n_jobs=-1)(delayed(read_answers)(kind) for kind in KINDS)
    all_answers = [answer for kind_answers in answers_by_kind for answer in kind_answers]
    rows = []
    for kind, kind_answers in zip(KINDS, answers_by_kind, strict=True):
        rows += count_answers(kind, [(answer.true_cause, answer.test_cause) for answer in kind_answers])
    title = f"Why loops swing, after a test: {VALVES} valves on a day of each kind; diagnosed cause by true cause"
    write_table("valve_test/blame", title, ["day", "truth", "loops", *ANSWERS], rows)  # fmt: skip
    summary = []
    for cause in CAUSES:
        row = [cause]
        for way in ("log_cause", "test_cause"):
            n_with_answer = [answer for answer in all_answers if getattr(answer, way) == cause]
            n_with_cause = [answer for answer in all_answers if answer.true_cause == cause]
            row += [str(len(n_with_answer)), share_of_logs([answer.true_cause == cause for answer in n_with_answer]),
                    share_of_logs([getattr(answer, way) == cause for answer in n_with_cause])]  # fmt: skip
        summary.append(row)
    head = [f"{description}, {way}" for way in (f"log of {HOURS_BEFORE_TEST:.0f} h alone", "with the test")
            for description in ("answers", "right of these", "share of the true ones")]  # fmt: skip
    title = f"Causes diagnosed from the log alone and with the test: {len(all_answers)} loops"
    write_table("valve_test/blame_answers", title, ["cause", *head], summary)

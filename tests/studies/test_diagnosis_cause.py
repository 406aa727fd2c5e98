"""``studies/diagnosis/cause.py``: the truth that it simulates, and the tables that it counts."""

import numpy as np
import pytest

import fastcoil as fc
from studies.diagnosis import cause as diagnosis_cause
from studies.diagnosis.cause import Answer


def test_the_tables_count_the_answers_by_truth_and_by_answer(read_table, monkeypatch):
    answers = [
        Answer("stepped", "backlash", "backlash", 0.08, True, 0.09),
        Answer("stepped", "backlash", "unknown", 0.08, False, 0.02),
        Answer("stepped", "none", "backlash", 0.0, True, 0.05),
        Answer("stepped", "none", "none", 0.0, True, 0.01),
    ]
    monkeypatch.setattr(diagnosis_cause, "diagnose_logs", lambda kind: answers if kind == "stepped" else [])
    monkeypatch.setattr(diagnosis_cause, "delayed", lambda function: function)
    monkeypatch.setattr(diagnosis_cause, "Parallel", lambda n_jobs: list)
    diagnosis_cause.main()
    _, rows = read_table("diagnosis_cause")
    assert rows[0] == ["day", "truth", "loops", "none", "backlash", "tuning", "disturbance", "unknown"]
    assert [" ".join(row) for row in rows[1:]] == ["stepped none 2 1 1 0 0 0", "stepped backlash 2 0 1 0 0 1"]
    _, (_, *by_answer) = read_table("diagnosis_answers")
    backlash_row = next(row for row in by_answer if row[0] == "cause: backlash")
    assert (backlash_row[1], backlash_row[2][:6], backlash_row[3][:6]) == ("2", "50.0 %", "50.0 %")
    claims_row = next(row for row in by_answer if row[0] == "a backlash")
    assert (claims_row[1], claims_row[2][:6]) == ("3", "66.7 %")
    accused_row = next(row for row in by_answer if row[0].startswith("a backlash above"))
    assert (accused_row[1], accused_row[3][:6]) == ("1", "50.0 %")


@pytest.mark.kernel
@pytest.mark.full
def test_the_truth_is_told_by_simulations_without_gap_and_without_swing():
    logs = diagnosis_cause.simulate_logs("swinging", n=12)
    assert len(logs.logs) == len(logs.cause) == 12
    assert set(logs.cause) <= set(diagnosis_cause.CAUSES)
    assert "disturbance" in logs.cause
    is_good_valve = logs.backlash == 0.0
    assert not any(cause == "backlash" for cause, is_good in zip(logs.cause, is_good_valve, strict=True) if is_good)
    assert np.isfinite(fc.diagnose(logs.logs[0]).backlash)

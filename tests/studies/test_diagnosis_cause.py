"""``studies/diagnosis/cause.py``: the truth that it simulates, and the tables that it counts."""

import numpy as np
import pytest

import fastcoil as fc
from studies.diagnosis import cause as diagnosis_cause
from studies.diagnosis.cause import Answer


def test_the_tables_count_the_answers_by_truth_and_by_answer(written, monkeypatch):
    found = [
        Answer("stepped", "backlash", "backlash", 0.08, True, 0.09),
        Answer("stepped", "backlash", "unknown", 0.08, False, 0.02),
        Answer("stepped", "none", "backlash", 0.0, True, 0.05),
        Answer("stepped", "none", "none", 0.0, True, 0.01),
    ]
    monkeypatch.setattr(diagnosis_cause, "answers", lambda kind: found if kind == "stepped" else [])
    monkeypatch.setattr(diagnosis_cause, "delayed", lambda function: function)
    monkeypatch.setattr(diagnosis_cause, "Parallel", lambda n_jobs: list)
    diagnosis_cause.main()
    _, rows = written("diagnosis_cause")
    assert rows[0] == ["day", "truth", "loops", "none", "backlash", "tuning", "disturbance", "unknown"]
    assert rows[1:] == [
        ["stepped", "none", "2", "1", "1", "0", "0", "0"],
        ["stepped", "backlash", "2", "0", "1", "0", "0", "1"],
    ]
    _, (_, *by_answer) = written("diagnosis_answers")
    blamed = next(row for row in by_answer if row[0] == "cause: backlash")
    assert (blamed[1], blamed[2][:6], blamed[3][:6]) == ("2", "50.0 %", "50.0 %")
    claims = next(row for row in by_answer if row[0] == "a backlash")
    assert (claims[1], claims[2][:6]) == ("3", "66.7 %")
    accused = next(row for row in by_answer if row[0].startswith("a backlash above"))
    assert (accused[1], accused[3][:6]) == ("1", "50.0 %")


@pytest.mark.kernel
@pytest.mark.full
def test_the_truth_is_told_by_simulations_without_gap_and_without_swing():
    found = diagnosis_cause.logs("swinging", n=12)
    assert len(found.logs) == len(found.cause) == 12
    assert set(found.cause) <= set(diagnosis_cause.CAUSES)
    assert "disturbance" in found.cause
    good = found.backlash == 0.0
    assert not any(cause == "backlash" for cause, is_good in zip(found.cause, good, strict=True) if is_good)
    d = fc.diagnose(found.logs[0])
    assert np.isfinite(d.backlash)

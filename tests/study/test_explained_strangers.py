"""A stranger's study is explained without running its code."""

import pytest
from helpers.studies import PLAIN

import fastcoil as fc
from fastcoil.study.maintenance import one_scenario

STUDY = PLAIN.replace("[sweep]", '[cases.controller]\nown = { law = "mine:rule" }\npi = { law = "pi" }\n[sweep]')
SOURCE = """
import pathlib
from typing import NamedTuple
import fastcoil as fc
pathlib.Path({trace!r}).touch()
class Parameters(NamedTuple):
    kp: float
class Memory(NamedTuple):
    last: float = 0.0
@fc.law(Parameters=Parameters, Memory=Memory)
def rule(now, p, memory):
    return p.kp * now.error, memory
"""
AT = {"backlash": "0.02", "estimate_ratio": "0.9", "day": "1"}


def test_a_scenario_with_the_studys_own_law_is_refused_and_another_is_explained(with_code, trace):
    path = with_code(STUDY, SOURCE)
    with pytest.raises(fc.InputError, match="uses rule, code of the study's own, which is not run here"):
        one_scenario(path, AT | {"controller": "own"}, {})
    assert one_scenario(path, AT | {"controller": "pi"}, {}).loop["law"] == "pi"
    assert not trace.exists()

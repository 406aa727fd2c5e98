"""``fc.ValveTest``: what it refuses, what it becomes in a loop, and what a technician reads."""

import numpy as np
import pytest
from click.testing import CliRunner
from helpers.refusals import assert_mistakes, assert_refused
from helpers.rules import own_pi
from helpers.sentences import assert_worded

import fastcoil as fc
from fastcoil.cli.main import main
from fastcoil.model.parameter_table import PARAMETERS


def test_a_test_is_parameters_of_a_loop_and_its_defaults_are_theirs():
    defaults = {name: p.default for name, p in PARAMETERS.items() if p.group == "test"}
    assert fc.ValveTest(start=60.0).parameters() == defaults | {"test_start": 60.0}


def test_every_bad_value_is_refused_by_its_name():
    values = {"start": -1, "minutes": 0, "rate": np.nan, "threshold": "0.3", "settle": -1, "hold": -1, "excursion": 0}
    mistakes = [(name, "type" if name == "threshold" else "value") for name in values]
    assert_mistakes(mistakes, fc.ValveTest, **values)


@pytest.mark.parametrize(
    ("field", "code", "parameters"),
    [
        ("test_start", "missing", {"test_rate": 0.001}),
        ("test_rate", "conflict", {"test_start": 60, "test_rate": 0.01, "stroke_time": 90}),
        ("test_rate", "conflict", {"test_start": 60, "stroke_time": 400}),
        ("test_start", "value", {"test_start": 3000}),
    ],
)
def test_a_loop_with_an_impossible_test_is_refused(field, code, parameters):
    assert_refused(field, code, fc.simulate, fc.Loop(**parameters), fc.constant_day(hours=1))


def test_an_open_loop_and_a_law_of_your_own_have_no_test():
    day, command = fc.constant_day(hours=1), np.full(3600, 0.5)
    assert_refused("command", "conflict", fc.simulate, fc.Loop(test_start=60), day, command=command)
    assert_refused("test_start", "unsupported", fc.simulate, fc.Loop(law=own_pi), day, test=fc.ValveTest())


def test_the_instructions_give_the_numbers_of_the_test():
    test = fc.ValveTest(rate=4e-4, threshold=0.2, settle=70, hold=95, excursion=1.2, minutes=25)
    assert_worded(*test.instructions())
    printed = CliRunner().invoke(main, ["valve-test", "plan", "--minutes", "25", "--excursion", "1.2", "--hold", "95"])
    assert printed.exit_code == 0
    assert "until 25 min" in printed.output

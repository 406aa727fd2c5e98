"""``fc.ValveTest``: what it refuses, what it becomes in a loop, and what a technician reads."""

from typing import NamedTuple

import numpy as np
import pytest
from click.testing import CliRunner

import fastcoil as fc
from fastcoil.cli.main import main
from fastcoil.model.parameter_table import PARAMETERS


def test_a_test_is_parameters_of_a_loop_and_its_defaults_are_theirs():
    given = fc.ValveTest(start=60.0).parameters()
    assert set(given) == {name for name, p in PARAMETERS.items() if p.group == "test"}
    assert {n: v for n, v in given.items() if n != "test_start"} == {
        name: p.default for name, p in PARAMETERS.items() if p.group == "test" and p.default is not None
    }


def test_every_bad_value_is_refused_by_its_name():
    with pytest.raises(fc.InputError) as refused:
        fc.ValveTest(start=-1, minutes=0, rate=np.nan, threshold="0.3", settle=-1, hold=-1, excursion=0)
    names = ("minutes", "rate", "threshold", "settle", "hold", "excursion", "start")
    assert sorted(problem.split(" = ")[0] for problem in refused.value.problems) == sorted(names)


@pytest.mark.parametrize(
    ("loop", "says"),
    [
        ({"test_rate": 0.001}, "test_rate without test_start: give the time"),
        ({"test_start": 60, "test_rate": 0.01, "stroke_time": 90}, "a motor of 90 s for its stroke is slower"),
        ({"test_start": 60, "stroke_time": 400}, "up to 4 times that, and a motor of 400 s for its stroke is slower"),
        ({"test_start": -1}, "test_start = -1 s: must be at least 0"),
    ],
)
def test_a_loop_with_a_test_that_cannot_be_is_refused(loop, says):
    with pytest.raises(fc.InputError, match=says):
        fc.simulate(fc.Loop(**loop), fc.constant_day(hours=1))


class Parameters(NamedTuple):
    """Of a law."""

    kp: float


class Memory(NamedTuple):
    """Of a law."""

    n: float = 0.0


def test_a_law_of_your_own_has_no_test():
    @fc.law(Parameters, Memory)
    def half(now, p, memory):
        return 0.5, memory

    with pytest.raises(fc.InputError, match="a valve test hands back to the PI"):
        fc.simulate(fc.Loop(law=half), fc.constant_day(hours=1), test=fc.ValveTest())


def test_the_instructions_give_the_numbers_of_the_test():
    lines = "\n".join(
        fc.ValveTest(rate=4e-4, threshold=0.2, settle=70, hold=95, excursion=1.2, minutes=25).instructions()
    )
    for words in (
        "1.2 % of the stroke every 30 s",
        "by 0.2 K",
        "Wait 70 s",
        "for 95 s",
        "more than 1.2 K",
        "until 25 min",
    ):
        assert words in lines
    printed = CliRunner().invoke(main, ["valve-test", "plan", "--minutes", "25", "--excursion", "1.2", "--hold", "95"])
    assert printed.exit_code == 0
    assert "until 25 min" in printed.output

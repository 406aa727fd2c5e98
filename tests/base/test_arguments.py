"""Checks of arguments: numbers of Python and numpy, names, levels."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.refusals import assert_mistakes, assert_refused

import fastcoil as fc
from fastcoil.base.arguments import (
    is_number,
    require_confidence_level,
    require_flag,
    require_integer,
    require_names,
    require_path,
)  # fmt: skip
from fastcoil.base.errors import InputTypeError


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        *((number, True) for number in (1, 2.5, np.float32(1), np.int8(3), Fraction(1, 3), float("nan"))),
        *((other, False) for other in (True, np.True_, "1", None, 1j, [1], np.array([1.0]), np.timedelta64(1, "ns"))),
    ],
)
def test_what_is_a_number(value, expected):
    assert is_number(value) is expected


@pytest.mark.parametrize(
    ("value", "code"),
    [*((value, "type") for value in (2.0, True, np.True_, "2", None)), (0, "value"), (np.int64(6), "value")],
)
def test_a_bad_whole_number_is_named_with_the_cure(value, code):
    assert_refused("n", code, require_integer, "n", value, 1, 5)
    assert (type(require_integer("n", np.int64(5), 1, 5)), require_integer("n", 10**30, 1)) == (int, 10**30)


@pytest.mark.parametrize(
    ("level", "code"),
    [*((level, "value") for level in (0, 1, 95, -0.1, float("nan"))), *((x, "type") for x in ("0.9", None, True))],
)
def test_a_level_is_between_0_and_1(level, code):
    assert_refused("level", code, require_confidence_level, level)
    assert (require_confidence_level(0.95), require_confidence_level(np.float32(0.5))) == (0.95, 0.5)


def test_bad_names_are_named_with_the_cure():
    assert require_names("over", ("day", np.str_("replicate"))) == ["day", "replicate"]
    for names, code in ([], "missing"), (7, "type"), (["day", None], "type"), (["day", "day"], "duplicate"):
        assert_refused("over", code, require_names, "over", names)


@pytest.mark.parametrize("value", [1, 0, None, "True", pd.NA, np.array([True])])
def test_a_flag_is_true_or_false_of_python_or_numpy(value):
    assert require_flag("drop", np.True_) is require_flag("drop", np.array(True)) is True
    assert isinstance(assert_refused("drop", "type", require_flag, "drop", value), InputTypeError)


def test_a_bad_path_is_named_with_the_cure():
    assert require_path("out", np.str_("a/b")) == require_path("out", Path("a/b")) == Path("a/b")
    for value, code in (b"a", "type"), (None, "type"), ("", "path"), ("a\0b", "path"), ("s3://bucket/x", "path"):
        assert_refused("out", code, require_path, "out", value)


def test_all_mistakes_of_a_call_come_together():
    mistakes = [("path", "type"), ("out", "type"), ("n_jobs", "value"), ("backend", "choice"), ("extend", "type")]
    error = assert_mistakes(mistakes, fc.run_study, 5, out=b"x", n_jobs=0, backend="thread", extend="yes")
    assert isinstance(error, InputTypeError)


def test_sizes_that_a_value_asks_for_have_limits():
    for call in (
        lambda: fc.Loop(kp=range(10**9)),
        lambda: fc.paper_day(hours=1, seed=range(10**9)),
        lambda: fc.constant_day(hours=1e9),
        lambda: fc.simulate(fc.Loop(), fc.paper_day(), replicates=10**9),
        lambda: fc.Boundary(m_a=range(10**9), T_a_in=25, W_a_in=0.01, T_w_in=7, T_set=14),
    ):
        with pytest.raises(fc.InputError, match="at most|fewer|more than|must be|are available"):
            call()

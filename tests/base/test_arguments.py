"""Checks of arguments: numbers of Python and numpy, names, levels."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fastcoil as fc
from fastcoil.base.arguments import (
    is_number,
    require_confidence_level,
    require_flag,
    require_integer,
    require_names,
    require_path,
)
from fastcoil.base.errors import InputError, InputTypeError


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
    ("value", "sentence"),
    [
        (0, "n = 0: must be at least 1 and at most 5"),
        (np.int64(6), "n = 6: must be at least 1 and at most 5"),
        (2.0, "n = 2.0: give a whole number"),
        (True, "n = True: give a whole number"),
        (np.True_, "n = np.True_: give a whole number"),
        ("2", "n = '2': give a whole number"),
        (None, "n = None: give a whole number"),
    ],
)
def test_a_bad_whole_number_is_named_with_the_cure(value, sentence):
    with pytest.raises(InputError) as raised:
        require_integer("n", value, 1, 5)
    assert raised.value.problems == [sentence]
    assert (type(require_integer("n", np.int64(5), 1, 5)), require_integer("n", 10**30, 1)) == (int, 10**30)


@pytest.mark.parametrize("level", [0, 1, 95, -0.1, float("nan"), "0.9", None, True])
def test_a_level_is_between_0_and_1(level):
    with pytest.raises(InputError) as raised:
        require_confidence_level(level)
    assert raised.value.problems == [f"level = {level!r}: must be a number between 0 and 1, such as 0.95"]
    assert (require_confidence_level(0.95), require_confidence_level(np.float32(0.5))) == (0.95, 0.5)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ([], "over is empty: give at least one name"),
        (7, "over = 7: must be a name or a list of names"),
        (["day", None], "over = ['day', None]: must be a name or a list of names"),
        (["day", "day"], "over: 'day' is given more than once: give it once"),
    ],
)
def test_bad_names_are_named_with_the_cure(given, sentence):
    assert require_names("over", ("day", np.str_("replicate"))) == ["day", "replicate"]
    with pytest.raises(InputError) as raised:
        require_names("over", given)
    assert raised.value.problems == [sentence]


@pytest.mark.parametrize("value", [1, 0, None, "True", pd.NA, np.array([True])])
def test_a_flag_is_true_or_false_of_python_or_numpy(value):
    assert require_flag("drop", np.True_) is require_flag("drop", np.array(True)) is True
    with pytest.raises(InputTypeError, match="drop = .*: give True or False"):
        require_flag("drop", value)


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (b"a", "out is a bytes: give a path"),
        (None, "out is a NoneType: give a path"),
        ("", "out is empty: give a path"),
        ("a\0b", r"'a\x00b' is not a usable path (embedded null byte): give a path"),
        ("s3://bucket/x", "'s3:/bucket/x' is an address, and fastcoil reads and writes local files: give a path"),
    ],
)
def test_a_bad_path_is_named_with_the_cure(value, sentence):
    assert require_path("out", np.str_("a/b")) == require_path("out", Path("a/b")) == Path("a/b")
    with pytest.raises(InputError) as raised:
        require_path("out", value)
    assert raised.value.problems == [sentence]


def test_all_mistakes_of_a_call_come_together():
    with pytest.raises(InputTypeError) as raised:
        fc.run_study(5, out=b"x", n_jobs=0, backend="thread", extend="yes")
    assert raised.value.problems == [
        "path is a int: give the path of a study file",
        "out is a bytes: give the path of a folder",
        "n_jobs = 0: must be at least 1 and at most 1024",
        "backend = 'thread', did you mean 'threads'?: choose 'threads', 'loky' or 'dask'",
        "extend = 'yes': give True or False",
    ]


def test_sizes_that_a_value_asks_for_have_limits():
    for call in (
        lambda: fc.Loop(kp=range(10**9)),
        lambda: fc.paper_day(hours=1, seed=range(10**9)),
        lambda: fc.constant_day(hours=1e9),
        lambda: fc.simulate(fc.Loop(), fc.paper_day(), replicates=10**9),
        lambda: fc.Boundary(m_a=range(10**9), T_a_in=25, W_a_in=0.01, T_w_in=7, T_set=14),
    ):
        with pytest.raises(InputError, match="at most|fewer|more than|must be|are available"):
            call()

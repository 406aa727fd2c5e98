"""Checks of arguments: numbers of Python and numpy, names, levels."""

from fractions import Fraction

import numpy as np
import pytest

from fastcoil.arguments import is_number, level_of, names_of, whole_number_problems
from fastcoil.errors import InputError


@pytest.mark.parametrize("value", [1, 2.5, np.float32(1), np.int8(3), Fraction(1, 3), float("nan")])
def test_numbers(value):
    assert is_number(value)


@pytest.mark.parametrize("value", [True, np.True_, "1", None, 1j, [1], np.array([1.0])])
def test_what_is_not_a_number(value):
    assert not is_number(value)


@pytest.mark.parametrize("value", [1, 5, np.int64(5), np.uint8(1)])
def test_whole_numbers_within_their_limits(value):
    assert whole_number_problems("n", value, 1, 5) == []


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
    assert whole_number_problems("n", value, 1, 5) == [sentence]


def test_a_whole_number_may_have_no_upper_limit():
    assert whole_number_problems("n", 10**30, 1) == []
    assert whole_number_problems("n", 0, 1) == ["n = 0: must be at least 1"]


@pytest.mark.parametrize("level", [0, 1, 95, -0.1, float("nan"), "0.9", None, True])
def test_a_level_is_between_0_and_1(level):
    with pytest.raises(InputError) as caught:
        level_of(level)
    assert caught.value.problems == [f"level = {level!r}: must be a number between 0 and 1, such as 0.95"]
    assert (level_of(0.95), level_of(np.float32(0.5))) == (0.95, 0.5)


def test_names_are_one_or_several():
    assert names_of("over", "day") == ["day"]
    assert names_of("over", ("day", np.str_("replicate"))) == ["day", "replicate"]


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
    with pytest.raises(InputError) as caught:
        names_of("over", given)
    assert caught.value.problems == [sentence]

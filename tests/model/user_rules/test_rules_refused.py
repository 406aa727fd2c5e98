"""A rule that would not run, or run otherwise than it reads, is refused with a sentence before anything runs."""

from typing import NamedTuple

import numpy as np
import pytest
from helpers.rules import Memory, Parameters, constant_rule, make_parameters

import fastcoil as fc
from fastcoil.model.numerics.compile_user_function import _place_and_reason

ARRAY = np.array([0.1, 0.2, 0.4])
TUPLE = (0.1, 0.2, 0.4)
LONG = (0.1,) * 300


def again(x):
    return again(x - 1.0) if x > 0.0 else 0.0


def makes_an_array(now, p, memory):
    return np.zeros(3).sum() + now.e, memory


def raises(now, p, memory):
    if now.e > 100.0:
        raise ValueError("hot")
    return 0.1, memory


def knows(now, p, memory):
    return now.backlash, memory


def forgets(now, p, memory):
    return now.e


def sometimes(now, p, memory):
    if now.e > 0.0:
        return 0.1
    return 0.1, memory


def other_shape(now, p, memory):
    return 0.1, (1.0, 2.0, 3.0)


def of_bytes(now, p, memory):
    return b"abc"[int(now.t)] * 1e-3, memory


def draws(now, p, memory):
    return np.random.random(), memory  # noqa: NPY002


def calls_itself(now, p, memory):
    return again(now.e), memory


def misspells(now, p, memory):
    return nwo.e, memory  # noqa: F821


def looks_up(now, p, memory):
    return ARRAY[int(now.t)], memory


def beyond(now, p, memory):
    return TUPLE[int(now.t)], memory


def too_long(now, p, memory):
    return LONG[0], memory


def make_early():
    def early(now, p, memory):
        return late * now.e, memory

    if early is None:
        late = 1.0
    return early


REFUSED_RULES = [
    (looks_up, r"looks_up uses ARRAY, array\(\[0.1, 0.2, 0.4\]\)"),
    (beyond, "beyond may raise an error"),
    (too_long, "too_long uses LONG, .*tuples of up to 256 numbers"),
    (make_early(), "early uses late, which has no value yet"),
    (makes_an_array, "makes_an_array makes an array, a list or a text"),
    (raises, "raises may raise an error"),
    (knows, r"knows does not compile, line \d+ of test_rules_refused.py: Unknown attribute 'backlash'"),
    (forgets, r"forgets: return a number and Memory\(…\) with a number for each field"),
    (sometimes, r"sometimes does not compile, line \d+ .*: Can't unify return type"),
    (other_shape, r"other_shape: return a number and Memory\(…\) with a number for each field"),
    (of_bytes, "of_bytes uses bytes"),
    (draws, "draws draws random numbers"),
    (calls_itself, "calls_itself uses again, which calls itself"),
    (misspells, "misspells does not compile: NameError: name 'nwo' is not defined"),
]


@pytest.mark.kernel
@pytest.mark.parametrize(("function", "sentence"), REFUSED_RULES, ids=lambda x: getattr(x, "__name__", ""))
def test_what_would_not_run_is_refused_in_one_line(function, sentence, monkeypatch):
    monkeypatch.setattr("fastcoil.loops.simulate.run_plan", lambda *plan: pytest.fail("it ran"))
    rule = fc.estimator(Parameters, Memory)(function)
    with pytest.raises(fc.InputError, match=sentence) as error_info:
        fc.simulate(fc.Loop(estimator=rule), fc.constant_day(hours=1))
    assert len(error_info.value.problems) == 1
    assert "\n" not in str(error_info.value)
    assert len(str(error_info.value)) < 350


class OfText(NamedTuple):
    word: str = "a"


def halved(x):
    return 0.5 * x


@pytest.mark.parametrize(
    ("parameters", "memory", "sentence"),
    [
        (make_parameters(backlash=None), Memory, "fine reads backlash, which a rule must not know"),
        (make_parameters(learning_step=None), Memory, "fine reads learning_step, which a rule must not know"),
        (make_parameters(action=None), Memory, "fine reads action, which a rule must not know"),
        (
            make_parameters(kp=0.1),
            Memory,
            "kp = 0.1: kp is a parameter of the loop, which has its value; write kp: float",
        ),
        (make_parameters(kpp=None), Memory, "kpp is no parameter of the loop, did you mean 'kp'.: give it a default"),
        (make_parameters(rmse=1.0), Memory, "the name rmse is taken"),
        (make_parameters(word="a"), Memory, "word of Parameters is no float"),
        (make_parameters(), Memory, "give a class made with typing.NamedTuple that has fields"),
        (3, Memory, "Parameters is 3: give a class made with typing.NamedTuple"),
        (halved, None, "(?s)Parameters is <function halved at .*Memory is None: give a class"),
        (Parameters, OfText, "word of Memory is no float: a rule works with numbers, write word: float"),
    ],
)
def test_what_a_rule_may_not_read_or_remember(parameters, memory, sentence):
    with pytest.raises(fc.InputError, match=sentence):
        fc.estimator(parameters, memory)(constant_rule)


def test_what_cannot_be_called_as_a_rule():
    with pytest.raises(fc.InputError, match=r"write it as def halved\(now, p, memory\)"):
        fc.estimator(Parameters, Memory)(halved)


def test_a_parameter_that_is_none():
    for arguments, sentence in (
        ({"default": 2.0, "upper": 1.0}, r"default = 2.0: give a number \(from -inf to 1\)"),
        ({"default": -1.0, "lower": 0.0}, "at least 0"),
        ({"default": "a"}, "default = 'a': give a number"),
        ({"default": 1.0, "unit": 3}, "unit = 3: give a text"),
        ({"default": np.nan}, r"give a number \(any finite number\)"),
        ({"default": np.inf}, r"default = inf: give a number \(any finite"),
        ({"default": np.inf, "upper": 2.0}, "from -inf to 2"),
        ({"default": 1.0, "lower": np.inf}, "lower = inf: give a number$"),
        ({"default": 1.0, "unit": "a\0b"}, "it has characters that cannot be stored as UTF-8"),
    ):
        with pytest.raises(fc.InputError, match=sentence):
            fc.parameter(**arguments)


def test_the_reason_has_no_colours_where_colorama_is_installed():
    error = Exception("Failed in nopython mode\n\x1b[1mUnknown attribute\x1b[0m 'e'\nFile \"mine.py\", line 3:")
    assert _place_and_reason(error) == ", line 3 of mine.py: Unknown attribute 'e'"

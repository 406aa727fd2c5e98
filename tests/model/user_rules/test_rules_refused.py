"""A rule that would not run, or run otherwise than it reads, is refused with a sentence before anything runs."""

from typing import NamedTuple

import numpy as np
import pytest
from helpers.rules import Memory, Parameters, declared, fine

import fastcoil as fc

TABLE = [1.0, 2.0]
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


def replaces(now, p, memory):
    return 0.1, memory._replace(calls=1.0)


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


def uses_a_list(now, p, memory):
    return TABLE[0], memory


def calls_itself(now, p, memory):
    return again(now.e), memory


def misspells(now, p, memory):
    return nwo.e, memory  # noqa: F821


def clips(now, p, memory):
    return np.clip(now.e, 0, 1), memory


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


REFUSED = [
    (looks_up, r"looks_up uses ARRAY, array\(\[0.1, 0.2, 0.4\]\): write a table as a tuple of numbers"),
    (beyond, r"beyond may raise .*; limit an index in whole numbers, as in TUPLE\[min\(max\(k, 0\), 2\)\]"),
    (too_long, "too_long uses LONG, a tuple of 300 numbers, which takes minutes to compile: give it at most 256"),
    (make_early(), "early uses late, which has no value yet: give it one before"),
    (makes_an_array, "makes_an_array makes an array, a list or a text in every call"),
    (raises, "raises may raise an error or print"),
    (knows, r"knows reads backlash of a Sample, line \d+ of test_rules_refused.py: it has t, T_set, m_a, T"),
    (replaces, r"replaces reads _replace of a Memory, .*: make a new Memory\(…\)"),
    (forgets, r"forgets returns a number alone: return a number and Memory\(…\), with a comma between"),
    (sometimes, r"sometimes does not compile, line \d+ .*: Can't unify return type"),
    (other_shape, r"other_shape returns 3 values as its memory: return Memory\(…\), a number for each field"),
    (of_bytes, "of_bytes uses bytes: use numbers"),
    (draws, "draws draws random numbers: nobody could repeat its results"),
    (uses_a_list, r"uses_a_list uses TABLE, \[1.0, 2.0\]: write a table as a tuple"),
    (calls_itself, "calls_itself uses again, which calls itself: use a loop"),
    (misspells, "misspells does not compile: NameError: name 'nwo' is not defined"),
    (clips, r"clips does not compile, line \d+ .*: there is no compiled form of clip\("),
]


@pytest.mark.kernel
@pytest.mark.parametrize(("function", "sentence"), REFUSED, ids=lambda x: getattr(x, "__name__", ""))
def test_what_would_not_run_is_refused_in_one_line(function, sentence, monkeypatch):
    monkeypatch.setattr("fastcoil.loops.simulate.run_plan", lambda *plan: pytest.fail("it ran"))
    rule = fc.estimator(Parameters, Memory)(function)
    with pytest.raises(fc.InputError, match=sentence) as refused:
        fc.simulate(fc.Loop(estimator=rule), fc.constant_day(hours=1))
    assert len(refused.value.problems) == 1
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 250


class OfText(NamedTuple):
    word: str = "a"


@pytest.mark.parametrize(
    ("parameters", "memory", "sentence"),
    [
        (declared(backlash=None), Memory, "fine reads backlash, which is the plant itself: a rule must not know it"),
        (declared(learning_step=None), Memory, "fine reads learning_step, which is not for rules"),
        (declared(action=None), Memory, "fine reads action, which is not for rules"),
        (declared(kp=0.1), Memory, "kp = 0.1: kp is a parameter of the loop, which has its value; write kp: float"),
        (declared(kpp=None), Memory, "kpp is no parameter of the loop, did you mean 'kp'.: give it a default"),
        (declared(rmse=1.0), Memory, "the name rmse is taken"),
        (declared(word="a"), Memory, "word of Parameters is no float"),
        (declared(), Memory, "Parameters has no fields: give it one"),
        (3, Memory, "Parameters is 3: give a class made with typing.NamedTuple"),
        (Parameters, OfText, "word of Memory is no float: a rule works with numbers, write word: float"),
    ],
)
def test_what_a_rule_may_not_read_or_remember(parameters, memory, sentence):
    with pytest.raises(fc.InputError, match=sentence):
        fc.estimator(parameters, memory)(fine)


async def waits(now, p, memory):
    return 0.1, memory


def test_functions_that_wait():
    with pytest.raises(fc.InputError, match="waits: a rule cannot wait, write def without async"):
        fc.estimator(Parameters, Memory)(waits)


def test_a_parameter_that_is_none():
    for given, sentence in (
        ({"default": 2.0, "upper": 1.0}, "default = 2.0: give a number of at most 1"),
        ({"default": -1.0, "lower": 0.0}, "of at least 0"),
        ({"default": "a"}, "default = 'a': give a number"),
        ({"default": 1.0, "unit": 3}, "unit = 3: give a text"),
        ({"default": np.nan}, "give a number$"),
        ({"default": np.inf}, "default = inf: give a number$"),
        ({"default": np.inf, "upper": 2.0}, "give a number of at most 2$"),
        ({"default": 1.0, "lower": np.inf}, "lower = inf: give a number$"),
        ({"default": 1.0, "unit": "a\0b"}, "it has characters that cannot be stored as UTF-8"),
    ):
        with pytest.raises(fc.InputError, match=sentence):
            fc.parameter(**given)

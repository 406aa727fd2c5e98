"""A rule that would not run, or run otherwise than it reads, is refused with a sentence before anything runs."""

from typing import NamedTuple

import numpy as np
import pytest
from helpers.refusals import assert_mistakes, assert_refused
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
    looks_up, beyond, too_long, make_early(), makes_an_array, raises, forgets, other_shape, of_bytes, draws,
    calls_itself,
]  # fmt: skip
NOT_COMPILED = [  # with what the compiler says, which its version decides
    (knows, r"knows does not compile, line \d+ of test_rules_refused.py: Unknown attribute 'backlash'"),
    (sometimes, r"sometimes does not compile, line \d+ .*: Can't unify return type"),
    (misspells, "misspells does not compile: NameError: name 'nwo' is not defined"),
]


def simulate_rule(function, monkeypatch):
    """Simulate a loop with a function as estimator; nothing may run."""
    monkeypatch.setattr("fastcoil.loops.simulate.run_plan", lambda *plan: pytest.fail("it ran"))
    fc.simulate(fc.Loop(estimator=fc.estimator(Parameters, Memory)(function)), fc.constant_day(hours=1))


@pytest.mark.kernel
@pytest.mark.parametrize("function", REFUSED_RULES)
def test_what_would_not_run_is_refused_in_one_line(function, monkeypatch):
    error = assert_refused(function.__name__, "code", simulate_rule, function, monkeypatch)
    assert "\n" not in str(error)
    assert len(str(error)) < 350


@pytest.mark.kernel
@pytest.mark.parametrize(("function", "sentence"), NOT_COMPILED)
def test_what_does_not_compile_is_refused_with_its_line(function, sentence, monkeypatch):
    with pytest.raises(fc.InputError, match=sentence) as caught:
        simulate_rule(function, monkeypatch)
    assert (caught.value.field, caught.value.code) == (function.__name__, "code")
    assert len(caught.value.problems) == len(str(caught.value).splitlines()) == 1


class OfText(NamedTuple):
    word: str = "a"


def halved(x):
    return 0.5 * x


@pytest.mark.parametrize(
    ("parameters", "memory", "mistakes"),
    [
        (make_parameters(backlash=None), Memory, [("backlash", "unsupported")]),
        (make_parameters(learning_step=None), Memory, [("learning_step", "unsupported")]),
        (make_parameters(action=None), Memory, [("action", "unsupported")]),
        (make_parameters(kp=0.1), Memory, [("kp", "conflict")]),
        (make_parameters(kpp=None), Memory, [("kpp", "name")]),
        (make_parameters(rmse=1.0), Memory, [("rmse", "name")]),
        (make_parameters(word="a"), Memory, [("word", "code")]),
        (make_parameters(), Memory, [("Parameters", "type")]),
        (3, None, [("Parameters", "type"), ("Memory", "type")]),
        (Parameters, OfText, [("word", "code")]),
    ],
    ids=lambda value: value[0][0] if isinstance(value, list) else "",
)
def test_what_a_rule_may_not_read_or_remember(parameters, memory, mistakes):
    assert_mistakes(mistakes, lambda: fc.estimator(parameters, memory)(constant_rule))


def test_what_cannot_be_called_as_a_rule():
    assert_refused("halved", "code", fc.estimator(Parameters, Memory), halved)
    assert_refused("law", "type", fc.law(Parameters, Memory), 3)


@pytest.mark.parametrize(
    ("field", "code", "arguments"),
    [
        ("default", "value", {"default": 2.0, "upper": 1.0}),
        ("default", "value", {"default": -1.0, "lower": 0.0}),
        ("default", "type", {"default": "a"}),
        ("unit", "type", {"default": 1.0, "unit": 3}),
        ("default", "value", {"default": np.nan}),
        ("default", "value", {"default": np.inf}),
        ("default", "value", {"default": np.inf, "upper": 2.0}),
        ("lower", "value", {"default": 1.0, "lower": np.inf}),
        ("unit", "value", {"default": 1.0, "unit": "a\0b"}),
    ],
)
def test_a_parameter_that_is_none(field, code, arguments):
    assert_refused(field, code, fc.parameter, **arguments)


def test_the_reason_has_no_colours_where_colorama_is_installed():
    error = Exception("Failed in nopython mode\n\x1b[1mUnknown attribute\x1b[0m 'e'\nFile \"mine.py\", line 3:")
    assert _place_and_reason(error) == ", line 3 of mine.py: Unknown attribute 'e'"

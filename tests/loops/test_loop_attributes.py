"""Parameters of a loop are attributes to read, and keywords that editors, type checkers and IPython know."""

from __future__ import annotations

import copy
import inspect
import pickle
import typing

import pytest
from helpers.rules import by_error

import fastcoil as fc
from fastcoil.loops.assignment import WORD
from fastcoil.loops.keywords import Keywords, Numbers, PresetName, Words
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.model.user_rules import Rule


def test_every_parameter_is_an_attribute_with_the_value_of_the_loop():
    loop = fc.Loop(backlash=[0.02, 0.07], kp=0.05)
    listed = dir(loop)
    for name in fc.parameters():
        value = loop[name]
        assert getattr(loop, name) is value
        assert name in listed
    assert (loop.kp, loop.sizes, loop.estimator) == (0.05, {"backlash": 2}, None)


def test_a_parameter_that_a_rule_brings_is_an_attribute_too():
    loop = fc.Loop(estimator=by_error, gain=0.5)
    assert loop.gain == 0.5
    assert {"gain"} == set(dir(loop)) - set(dir(fc.Loop()))


def test_a_wrong_name_gets_the_nearest_and_no_second_guess_of_python():
    with pytest.raises(AttributeError) as caught:
        fc.Loop().backlsh  # noqa: B018
    assert str(caught.value) == "a Loop has no backlsh, did you mean 'backlash'?"
    assert caught.value.obj is None  # of which python would guess
    assert not hasattr(fc.Loop(), "_repr_latex_")


def test_a_loop_is_not_changed_by_an_attribute_and_says_what_does():
    loop = fc.Loop()
    with pytest.raises(AttributeError, match=r"a Loop does not change: take a copy, loop\.assign\(backlash=…\)"):
        loop.backlash = 0.1
    with pytest.raises(AttributeError):
        loop.anything = 1
    assert loop == fc.Loop()


def test_attributes_do_not_disturb_copies_and_pickles():
    loop = fc.Loop(backlash=[0.02, 0.07])
    for other in (copy.copy(loop), copy.deepcopy(loop), pickle.loads(pickle.dumps(loop))):
        assert other == loop


def test_no_parameter_hides_behind_a_method_of_the_loop():
    assert not {name for name in vars(fc.Loop) if not name.startswith("_")} & PARAMETERS.keys()


def test_keywords_for_type_checkers_are_those_of_the_table_with_its_words():
    hints = typing.get_type_hints(Keywords)
    assert list(hints) == [WORD, *PARAMETERS]
    for name, p in PARAMETERS.items():
        parts = typing.get_args(hints[name])
        words = next((typing.get_args(part) for part in parts if typing.get_origin(part) is typing.Literal), ())
        assert words == p.choices, name
        own = {Rule} if name in ("estimator", "law") else set()
        shape = Words if p.is_word else Numbers
        assert set(parts) == {*typing.get_args(shape), *own, *([typing.Literal[p.choices]] if words else [])}, name


def test_presets_for_type_checkers_are_all_of_them():
    assert typing.get_args(PresetName) == tuple(fc.presets())


@pytest.mark.parametrize("function", [fc.Loop, fc.Loop().assign])
def test_a_signature_has_every_parameter(function):
    names = list(inspect.signature(function).parameters)
    assert names == [*PARAMETERS, WORD]


def completed(text):
    """What IPython offers behind a text."""
    from IPython.core.completer import IPCompleter, provisionalcompleter

    completer = IPCompleter(namespace={"fc": fc, "loop": fc.Loop()})
    with provisionalcompleter():
        return {found.text.strip("=.") for found in completer.completions(text, len(text))}


@pytest.mark.parametrize(
    ("text", "offered"),
    [
        ("loop.assign(backl", {"backlash", "backlash_estimate"}),
        ("loop.stroke", {"stroke_time"}),
        ('loop["stroke', {"stroke_time"}),
        ("fc.Boundary.from_csv('x', time_f", {"time_format"}),
        ("fc.plot.lim", {"limit_cycle"}),
    ],
)
def test_ipython_completes_it(text, offered):
    pytest.importorskip("IPython")
    assert offered <= completed(text)

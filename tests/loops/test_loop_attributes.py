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
from fastcoil.loops.keywords import UNCHANGED, Keywords, PresetName, Value
from fastcoil.model.parameter_table import PARAMETERS


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
        words = {typing.Literal[p.choices]} if p.is_word else set()
        assert set(typing.get_args(hints[name])) == {*typing.get_args(Value), *words}, name


CHECKED = """
import fastcoil as fc
loop = fc.Loop(backlash=0.1, kp=("tuning", [0.01, 0.02]), action="heating", converged=True)
doubled = loop.backlash * 2, loop["kp"] * 2
loop = loop.assign(**{"gain": 3.0})
fc.Loop(backlsh=0.1)
loop.assign(backlsh=0.1)
"""


def test_a_type_checker_refuses_a_mistyped_parameter_and_nothing_else(tmp_path):
    mypy = pytest.importorskip("mypy.api")
    (tmp_path / "checked.py").write_text(CHECKED)
    said, _, _ = mypy.run([str(tmp_path / "checked.py")])
    errors = [line.partition("checked.py:")[2] for line in said.splitlines() if ": error:" in line]
    assert [line.split(":")[0] for line in errors] == ["6", "7"], said
    assert all('did you mean "backlash"' in line for line in errors)


def test_presets_for_type_checkers_are_all_of_them():
    assert typing.get_args(PresetName) == tuple(fc.presets())


def test_a_loop_shows_every_parameter_as_a_keyword_with_its_default():
    shown = inspect.signature(fc.Loop).parameters
    assert list(shown) == [*PARAMETERS, "converged"]
    for name, parameter in shown.items():
        assert parameter.kind is inspect.Parameter.KEYWORD_ONLY
        assert parameter.default == (PARAMETERS[name].default if name in PARAMETERS else False)
    given = {name: p.default for name, p in shown.items() if p.default is not None}
    assert fc.Loop(**given) == fc.Loop()


def test_assign_shows_every_parameter_as_unchanged():
    shown = inspect.signature(fc.Loop().assign).parameters
    assert list(shown) == [*PARAMETERS, "converged"]
    assert all(p.kind is inspect.Parameter.KEYWORD_ONLY and p.default is UNCHANGED for p in shown.values())
    assert "kp=unchanged" in str(inspect.signature(fc.Loop.assign))


def test_help_lists_every_parameter_with_unit_text_and_bounds():
    lines = inspect.getdoc(fc.Loop).splitlines()
    for name, parameter in PARAMETERS.items():
        row = next(k for k, line in enumerate(lines) if line.startswith(f"{name} : "))
        assert parameter.unit in ("", "1") or lines[row].endswith(parameter.unit)
        assert lines[row + 1].strip() == f"{parameter.text} ({parameter.bounds})."
    assert lines.index("Parameters") < lines.index("Examples")


def test_calls_are_as_strict_as_before():
    with pytest.raises(TypeError):
        fc.Loop(0.03)
    with pytest.raises(fc.InputError, match="kp = None"):
        fc.Loop(kp=None)


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

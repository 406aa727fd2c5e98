"""The JSON Schema knows where a study's own rules may stand, and that they bring parameters which it cannot know."""

from __future__ import annotations

import tomllib

import pytest
from jsonschema import Draft202012Validator

from fastcoil.base.errors import InputError
from fastcoil.study.file.schema import study_schema
from fastcoil.study.file.spec import read_study

VALIDATOR = Draft202012Validator(study_schema())
SOURCE = """
from typing import NamedTuple
import fastcoil as fc

class Parameters(NamedTuple):
    sample_time: float
    gain: float = 3e-4
    most: float = 10.0

class Memory(NamedTuple):
    last: float = 0.0

@fc.estimator(Parameters, Memory)
def rule(now, p, memory):
    return p.gain * p.most, memory

@fc.law(Parameters, Memory)
def own_law(now, p, memory):
    return p.gain * p.most, memory
"""
RULE, SAMPLED = "estimator = 'mine:rule'\n", "method = 'sobol'\nsize = 8\n"
PLACES = {
    "loop": "[loop]\nestimator = 'mine:rule'",
    "law": "[loop]\nlaw = 'mine:own_law'",
    "sweep": "[loop]\n[sweep]\nestimator = ['none', 'mine:rule']",
    "case": "[loop]\n[cases.controller]\nplain = { estimator = 'none' }\nown = { estimator = 'mine:rule', gain = 1 }",
    "sample": f"[loop]\n[sample]\n{SAMPLED}estimator = {{ choice = ['none', 'mine:rule'] }}",
}
OWN = [
    "[loop]\nestimator = 'mine:rule'\ngain = 1e-3",
    "[loop]\nlaw = 'mine:own_law'\n[sweep]\ngain = [1e-3, 2e-3]\nmost = { geomspace = [1, 10, 3] }",
    f"[loop]\n{RULE}[sample]\n{SAMPLED}gain = {{ uniform = [0, 1] }}\nmost = {{ choice = [1, 2] }}",
    f"[loop]\n{RULE}[cases.tuning]\nslow = {{ gain = 1e-4 }}\nfast = {{ gain = 1e-3 }}",
]


def is_valid(text):
    return VALIDATOR.is_valid(tomllib.loads(text))


@pytest.fixture
def read(tmp_path):
    """Return a function that says whether the reader takes a study."""
    (tmp_path / "mine.py").write_text(SOURCE)

    def is_read(text):
        (tmp_path / "study.toml").write_text(text)
        try:
            read_study(tmp_path / "study.toml")
        except InputError:
            return False
        return True

    return is_read


@pytest.mark.parametrize(
    ("estimator", "is_right"), [("learner", True), ("mine:rule", True), ("package.mine:rule", True), ("lerner", False)]
)
def test_an_estimator_is_a_word_or_a_function(estimator, is_right):
    for table in ({"loop": {"estimator": estimator}}, {"loop": {}, "sweep": {"estimator": ["none", estimator]}}):
        assert VALIDATOR.is_valid(table) == is_right


@pytest.mark.parametrize("text", OWN)
def test_a_study_with_a_rule_may_have_parameters_of_its_own_in_every_table(text, read):
    assert read(text)
    assert is_valid(text)


@pytest.mark.parametrize("text", PLACES.values(), ids=PLACES)
def test_a_rule_is_found_wherever_it_is_named(text, read):
    with_own = text.replace("[loop]", "[loop]\nmost = 5")
    assert read(with_own)
    assert is_valid(with_own)


@pytest.mark.parametrize("text", OWN + [text.replace("[loop]", "[loop]\nmost = 5") for text in PLACES.values()])
def test_without_a_rule_the_same_names_are_wrong(text, read):
    without = text.replace("mine:rule", "learner").replace("mine:own_law", "pi")
    assert not is_valid(without)
    assert not read(without)


@pytest.mark.parametrize(
    "text",
    [
        "[loop]\nestimator = 'mine:rule'\ngain = 'much'",
        "[loop]\nestimator = 'mine:rule'\n'the gain' = 1",
        "[loop]\nestimator = 'mine:rule'\n[sweep]\ngain = 3",
        f"[loop]\n{RULE}[cases.tuning]\nslow = {{ gain = [1, 2] }}",
        f"[loop]\n{RULE}[sample]\n{SAMPLED}gain = {{ between = [0, 1] }}",
        f"[loop]\n{RULE}[sample]\n{SAMPLED}",
        f"titel = 'a rule makes no table of it'\n[loop]\n{RULE}",
        f"[loop]\n{RULE}[run]\ngain = 3",
    ],
)
def test_a_parameter_of_its_own_is_a_number_under_a_name_like_any_other(text, read):
    assert not is_valid(text)
    assert not read(text)

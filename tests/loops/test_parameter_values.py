"""Values of parameters: every sentence about a bad value or name; the word ``converged``."""

import math

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_only_problem, only_problem, problems

import fastcoil as fc
from fastcoil.loops.assignment import CONVERGED
from fastcoil.study.file.spec import read_study


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("backlash", 0.91, ["backlash = 0.91", "0 to 0.9"]),
        ("backlash_estimate", 1.0, ["backlash_estimate = 1", "below 1"]),
        ("ti", 0.0, ["ti = 0 s", "above 0"]),
        ("sample_time", 1.5, ["sample_time = 1.5 s", "whole"]),
        ("learning_interval", 599, ["learning_interval = 599 s", "600"]),
        ("noise_std", -1e-300, ["noise_std = -1e-300 K", "at least 0"]),
        ("kp", math.nan, ["kp = nan", "finite"]),
        ("C_w", -math.inf, ["C_w = -inf", "finite"]),
        ("kp", True, ["kp = True", "number"]),
        ("kp", "0.1", ["kp = '0.1'", "number"]),
        ("kp", None, ["kp = None", "number"]),
        ("n_volumes", 8.5, ["n_volumes = 8.5", "whole", "1 to 64"]),
        ("n_volumes", [8, 65], ["n_volumes = 65", "1 to 64"]),
        ("action", "cool", ["action = 'cool'", "'cooling' or 'heating'"]),
        ("air_march", ["lagged", "printed"], ["air_march = 'printed'", "'lagged' or 'quasistatic'"]),
        ("backlash", [], ["backlash = []", "at least one"]),
        ("backlash", [0.07, 0.07 + 1e-15], ["backlash", "0.07", "twice"]),
        ("backlash", [0.05, 0.95, 1.5], ["backlash = 0.95", "0 to 0.9", "1 more"]),
        ("backlash", [0.05, "0.07"], ["backlash = '0.07'", "number"]),
        ("backlash", [0.05, True], ["backlash = True", "number"]),
        ("backlash", [[0.05], [0.07]], ["backlash = [0.05]", "DataArray"]),
        ("backlash", np.array([[0.05], [0.07]]), ["backlash", "DataArray"]),
        ("backlash", xr.DataArray([True, False], dims="size"), ["backlash", "bool", "numbers"]),
        ("backlash", xr.DataArray(np.full((2, 2), 0.05), dims=("backlash", "size")), ["backlash", "dimension"]),
        ("backlash", ("method", [0.05, 0.07]), ["'method'", "dimension"]),
        ("backlash", ("my size", [0.05, 0.07]), ["'my size'", "dimension"]),
    ],
)
def test_a_bad_value_is_named_with_the_cure(name, value, words):
    assert_only_problem(words, fc.Loop, **{name: value})


@pytest.mark.parametrize(
    ("wrong", "right"),
    [("baklash", "backlash"), ("C_W", "C_w")],
)
def test_an_unknown_name_is_answered_with_the_nearest(wrong, right):
    problem = only_problem(fc.Loop, **{wrong: 0.1})
    assert wrong in problem
    assert repr(right) in problem
    with pytest.raises(fc.InputError, match=right):
        fc.Loop()[wrong]


def test_all_mistakes_are_reported_at_once():
    found = problems(
        fc.Loop, baklash=0.1, ti=0.0, kp=math.nan, action="cool", backlash=[], estimate_ratio=0.5, backlash_estimate=0.1
    )
    assert len(found) == 6
    words = ["baklash", "ti = 0", "kp = nan", "action = 'cool'", "backlash = []", "estimate_ratio"]
    assert all(word in problem for word, problem in zip(words, found, strict=True))


LONG = 3600
"""Values, as many as an hour has seconds."""


def test_a_long_list_with_duplicates_may_be_meant_as_a_series():
    problem = only_problem(fc.Loop, backlash=[0.07] * LONG)
    assert "0.07 appears twice" in problem
    assert "did you mean a series?" in problem
    assert "fc.Boundary" in problem
    assert "series" not in only_problem(fc.Loop, backlash=[0.07] * (LONG - 1))
    assert fc.Loop(backlash=np.linspace(0.0, 0.9, LONG)).sizes == {"backlash": LONG}


@pytest.mark.parametrize("values", [{"kp": [0.1, [0.2, 0.3]]}, {"kp": 10**400}], ids=["ragged list", "huge integer"])
def test_what_numpy_cannot_read_is_refused_in_our_words(values):
    assert problems(fc.Loop, **values)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_an_array_of_numbers_is_refused_as_the_same_list_is(bad):
    values = [0.1, bad, 0.2, bad]
    assert only_problem(fc.Loop, kp=np.array(values)) == only_problem(fc.Loop, kp=values)
    assert only_problem(fc.Loop, kp=("case", np.array(values))) == only_problem(fc.Loop, kp=("case", values))


MEANING = {"air_march": "quasistatic", "substeps": 8}


def test_it_stands_for_the_air_march_and_the_substeps():
    assert dict(CONVERGED) == MEANING
    expected = fc.Loop.preset("g36").assign(**MEANING)
    assert fc.Loop.preset("g36", converged=True) == expected
    assert fc.Loop.preset("g36").assign(converged=True) == expected
    assert fc.Loop(converged=np.True_) == fc.Loop(**MEANING)
    assert isinstance(expected["substeps"], int)


def test_false_leaves_a_loop_as_it_is():
    assert fc.Loop(converged=False) == fc.Loop() != fc.Loop(converged=True)
    assert fc.Loop(substeps=3).assign(converged=False) == fc.Loop(substeps=3)


@pytest.mark.parametrize("given", [{"substeps": 8}, {"air_march": "quasistatic"}, MEANING])
def test_it_clashes_with_what_it_stands_for_in_one_sentence(given):
    with pytest.raises(fc.InputError) as caught:
        fc.Loop(converged=True, **given)
    assert caught.value.problems == [
        "converged stands for air_march = 'quasistatic' and substeps = 8: leave it out, or leave out "
        + " and ".join(sorted(given))
    ]


def test_its_mistakes_are_told_beside_others():
    with pytest.raises(fc.InputError) as caught:
        fc.Loop(converged=1, kp="much")
    assert [text.split(":")[0] for text in caught.value.problems] == ["converged = 1", "kp = 'much'"]
    with pytest.raises(fc.InputError, match="converged is not a parameter"):
        fc.Loop()["converged"]


def study(tmp_path, text):
    path = tmp_path / "study.toml"
    path.write_text(text)
    return read_study(path)


def test_a_study_file_may_say_it(tmp_path):
    spec = study(tmp_path, '[loop]\npreset = "lbnl"\nconverged = true\n[sweep]\nbacklash = [0.0, 0.07]\n')
    assert spec.plan.layout.loop == fc.Loop.preset("lbnl", converged=True).assign(backlash=[0.0, 0.07])
    assert study(tmp_path, "[loop]\nconverged = false\n").plan.layout.loop == fc.Loop()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[loop]\nconverged = true\nsubsteps = 4", r"\[loop\] converged stands for .*: leave it out, or .* substeps$"),
        ("[loop]\nconverged = 1", r"\[loop\] converged = 1: give True or False"),
        (
            "[loop]\nconverged = true\n[sweep]\nsubsteps = [1, 2]",
            r"substeps appears in \[loop\] as part of converged and in \[sweep\]: leave one out",
        ),
        ("[loop]\n[sweep]\nconverged = [true, false]", r"\[sweep\] converged is not a parameter"),
    ],
)
def test_a_study_file_with_a_mistake_is_refused(tmp_path, text, words):
    with pytest.raises(fc.InputError, match=words):
        study(tmp_path, text)

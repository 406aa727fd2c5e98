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


@pytest.mark.parametrize(("wrong", "right"), [("baklash", "backlash"), ("C_W", "C_w")])
def test_an_unknown_name_is_answered_with_the_nearest(wrong, right):
    problem = only_problem(fc.Loop, **{wrong: 0.1})
    assert wrong in problem
    assert repr(right) in problem
    with pytest.raises(fc.InputError, match=right):
        fc.Loop()[wrong]


def test_all_mistakes_are_reported_at_once():
    sentences = problems(
        fc.Loop, baklash=0.1, ti=0.0, kp=math.nan, action="cool", backlash=[], estimate_ratio=0.5, backlash_estimate=0.1
    )
    assert len(sentences) == 6
    words = ["baklash", "ti = 0", "kp = nan", "action = 'cool'", "backlash = []", "estimate_ratio"]
    assert all(word in problem for word, problem in zip(words, sentences, strict=True))


MEANING = {"air_march": "quasistatic", "substeps": 8}


def test_it_stands_for_the_air_march_and_the_substeps():
    assert dict(CONVERGED) == MEANING
    expected = fc.Loop.preset("g36").assign(**MEANING)
    assert fc.Loop.preset("g36", converged=True) == expected
    assert fc.Loop.preset("g36").assign(converged=True) == expected
    assert fc.Loop(converged=np.True_) == fc.Loop(**MEANING)
    assert isinstance(expected["substeps"], int)


@pytest.mark.parametrize("given", [{"substeps": 8}, {"air_march": "quasistatic"}, MEANING])
def test_it_clashes_with_what_it_stands_for_in_one_sentence(given):
    with pytest.raises(fc.InputError) as caught:
        fc.Loop(converged=True, **given)
    assert caught.value.problems == [
        "converged stands for air_march = 'quasistatic' and substeps = 8: leave it out, or leave out "
        + " and ".join(sorted(given))
    ]


def read_text_as_study(tmp_path, text):
    path = tmp_path / "study.toml"
    path.write_text(text)
    return read_study(path)


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
        read_text_as_study(tmp_path, text)

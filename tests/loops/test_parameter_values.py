"""Values of parameters: every sentence about a bad value or name; the word ``converged``."""

import math

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_mistakes, assert_refused

import fastcoil as fc
from fastcoil.loops.assignment import CONVERGED
from fastcoil.study.file.spec import read_study


@pytest.mark.parametrize(
    ("field", "code", "value"),
    [
        ("backlash", "value", 0.91), ("backlash_estimate", "value", 1.0), ("ti", "value", 0.0),
        ("sample_time", "value", 1.5), ("learning_interval", "value", 599), ("noise_std", "value", -1e-300),
        ("kp", "value", math.nan), ("C_w", "value", -math.inf), ("kp", "type", True), ("kp", "type", "0.1"),
        ("kp", "type", None), ("n_volumes", "value", 8.5), ("n_volumes", "value", [8, 65]),
        ("action", "choice", "cool"), ("air_march", "choice", ["lagged", "printed"]), ("backlash", "missing", []),
        ("backlash", "duplicate", [0.07, 0.07 + 1e-15]), ("backlash", "value", [0.05, 0.95, 1.5]),
        ("backlash", "type", [0.05, "0.07"]), ("backlash", "type", [0.05, True]),
        ("backlash", "shape", [[0.05], [0.07]]), ("backlash", "shape", np.array([[0.05], [0.07]])),
        ("backlash", "type", xr.DataArray([True, False], dims="size")),
        ("backlash", "name", xr.DataArray(np.full((2, 2), 0.05), dims=("backlash", "size"))),
        ("backlash", "name", ("method", [0.05, 0.07])), ("backlash", "name", ("my size", [0.05, 0.07])),
        ("baklash", "name", 0.1), ("C_W", "name", 0.1),
    ],
)  # fmt: skip
def test_a_bad_value_or_name_is_refused(field, code, value):
    assert_refused(field, code, fc.Loop, **{field: value})


def test_all_mistakes_are_reported_together():
    values = {"ti": 0.0, "kp": math.nan, "action": "cool", "backlash": [], "estimate_ratio": 0.5}
    mistakes = [("baklash", "name"), ("ti", "value"), ("kp", "value"), ("action", "choice"), ("backlash", "missing")]
    mistakes.append(("estimate_ratio", "conflict"))
    assert_mistakes(mistakes, fc.Loop, baklash=0.1, **values, backlash_estimate=0.1)
    assert_refused("baklash", "name", fc.Loop().__getitem__, "baklash")


MEANING = {"air_march": "quasistatic"}


def test_converged_stands_for_the_air_march():
    assert dict(CONVERGED) == MEANING
    expected = fc.Loop.preset("paper_like_fast").assign(**MEANING)
    assert fc.Loop.preset("paper_like_fast", converged=True) == expected
    assert fc.Loop.preset("paper_like_fast").assign(converged=True) == expected
    assert fc.Loop(converged=np.True_, substeps=4) == fc.Loop(**MEANING, substeps=4)


def test_presets_of_practice_are_converged_and_those_of_the_paper_as_printed():
    marches = {name: fc.Loop.preset(name)["air_march"] for name in fc.presets()}
    assert marches == {
        "paper_like": "lagged", "paper_like_fast": "lagged", "lbnl": "quasistatic", "g36": "quasistatic",
        "heating": "quasistatic", "heating_45": "quasistatic", "reheat": "quasistatic",
    }  # fmt: skip
    assert fc.Loop()["air_march"] == "lagged"
    assert fc.Loop.preset("lbnl", converged=True) == fc.Loop.preset("lbnl")


def test_it_clashes_with_what_it_stands_for_in_one_sentence():
    assert_refused("converged", "conflict", fc.Loop, converged=True, **MEANING)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "[loop]\nconverged = true\nair_march = 'lagged'",
            r"\[loop\] converged stands for .*: leave it out, or .* air_march$",
        ),
        ("[loop]\nconverged = 1", r"\[loop\] converged = 1: give True or False"),
        (
            "[loop]\nconverged = true\n[sweep]\nair_march = ['lagged', 'quasistatic']",
            r"air_march appears in \[loop\] as part of converged and in \[sweep\]: leave one out",
        ),
        ("[loop]\n[sweep]\nconverged = [true, false]", r"\[sweep\] converged is not a parameter"),
    ],
)
def test_a_study_file_with_a_mistake_is_refused(tmp_path, text, words):
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(fc.InputError, match=words):
        read_study(tmp_path / "study.toml")

"""The word ``converged`` of a loop and of a study file."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.loops.assignment import CONVERGED
from fastcoil.study.file.spec import read_study

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

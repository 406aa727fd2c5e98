"""A study's own code: where it is found and what it declares, without running any of it."""

from pathlib import Path

import pytest
from helpers.refusals import assert_mistakes, assert_refused, only_problem
from helpers.rules import RULE_HEADER

from fastcoil.study.file import user_code
from fastcoil.study.file.spec import read_study
from fastcoil.study.file.user_code import UserCode, find_function, load_function

SOURCE = """
import numpy as np
import xarray as xr

def overshoot(traces):
    error = traces["T_sup"] - 14.0
    return xr.Dataset({"overshoot": error.max("elapsed_time"), "undershoot": -error.min("elapsed_time")})
"""

# Where a function is found


def test_a_module_next_to_the_study_is_found_also_in_a_folder(tmp_path):
    (tmp_path / "pkg").mkdir()
    for name in ("statistics", "pkg/mine"):
        (tmp_path / f"{name}.py").write_text(SOURCE)
    assert find_function("reduce", "statistics:overshoot", tmp_path).source == SOURCE
    function = find_function("reduce", "pkg.mine:overshoot", tmp_path)
    assert (function.name, function.path) == ("pkg.mine:overshoot", tmp_path / "pkg" / "mine.py")


def test_the_hash_is_of_name_and_text():
    hashes = {UserCode(*r, Path("a.py")).sha256 for r in (("a:f", "x = 1"), ("a:g", "x = 1"), ("a:f", "x = 2"))}
    assert len(hashes) == 3
    assert UserCode("a:f", "x = 1", Path("elsewhere/a.py")).sha256 in hashes


@pytest.mark.parametrize(
    ("text", "source", "code"),
    [
        *(
            (text, b"", "format")
            for text in ("mine", "mine.py:overshoot()", "mine:", ":f", "../mine:f", "mine:a:b", "")
        ),
        *((text, b"", "path") for text in ("statistics:f", "absent.mod:f")),
        *(("mine:f", source, "path") for source in (b"# \xe9", b"# coding: zlib\n", b"# coding: utf-7\n# +2AA-")),
    ],
)
def test_what_cannot_be_found_or_read_is_refused_with_one_sentence(tmp_path, text, source, code):
    (tmp_path / "mine.py").write_bytes(source)
    problem = only_problem(find_function, "reduce", text, tmp_path)
    assert (problem.field, problem.code) == ("reduce", code)
    assert "\n" not in problem


# Studies

STUDY = "[loop]\n[run]\ntraces = ['T_sup']\nreduce = 'mine:overshoot'\n"


def test_a_study_finds_its_reduction_next_to_it_or_in_a_given_folder(tmp_path):
    for name, source in (("one", SOURCE), ("two", SOURCE + "\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text(source)
    (tmp_path / "one" / "study.toml").write_text(STUDY)
    beside = read_study(tmp_path / "one" / "study.toml")
    in_folder = read_study(tmp_path / "one" / "study.toml", tmp_path / "two")
    assert (beside.reduction.source, in_folder.reduction.source) == (SOURCE, SOURCE + "\n")
    assert beside.sha256 != in_folder.sha256, "the source is part of what decides the result"


def test_a_reduction_without_traces_and_an_absent_one_are_both_named(tmp_path):
    (tmp_path / "study.toml").write_text("[loop]\nkpp = 1\n[run]\nreduce = 'absent:f'")
    mistakes = [("kpp", "name"), ("reduce", "path"), ("traces", "missing")]
    assert_mistakes(mistakes, read_study, tmp_path / "study.toml")


# Rules of a study

RULED = '[loop]\nestimator = "mine:one"\n[boundary]\nkind = "constant_day"\nhours = 1\n'
RULE = RULE_HEADER + "def one(now, p, memory):\n    return p.gain, memory\n"


@pytest.fixture
def study(tmp_path):
    """Write a study with rules, and its module."""

    def write(source, text=RULED):
        (tmp_path / "mine.py").write_text(source)
        path = tmp_path / "study.toml"
        path.write_text(text)
        return path

    return write


def test_a_source_that_is_too_large_is_not_read_as_python(study, monkeypatch):
    path = study(RULE + "\nif 0: y = [" + "1," * 140_000 + "]")
    monkeypatch.setattr(user_code, "parse_rule", lambda *rule: pytest.fail("it was read"))
    assert_refused("estimator", "size", read_study, path)


def test_a_rule_keeps_the_name_that_its_source_gives_it(study):
    two = "\ndef two(now, p, memory): return 0.0, memory\none = fc.estimator(Parameters, Memory)(two)\n"
    path = study(RULE + two)
    assert "one is not the estimator that its source declares" in only_problem(read_study, path, prepare=load_function)

"""Rules of a study as they are read: bounded, and with names that are free."""

import pytest
from helpers.rules import HEAD

from fastcoil.base.errors import InputError
from fastcoil.study.file import own_code as rules
from fastcoil.study.file.spec import read_study
from fastcoil.study.workers.user_code import load

STUDY = """
[loop]
estimator = "mine:one"
[boundary]
kind = "constant_day"
hours = 1
"""
SOURCE = (
    HEAD
    + """\
def one(now, p, memory):
    return p.gain, memory
"""
)


@pytest.fixture
def study(tmp_path):
    """Write a study with rules, and its module."""

    def write(source, text=STUDY):
        (tmp_path / "mine.py").write_text(source)
        path = tmp_path / "study.toml"
        path.write_text(text)
        return path

    return write


def test_a_source_that_is_too_large_is_not_read_as_python(study, monkeypatch):
    path = study(SOURCE + "\nif 0: y = [" + "1," * 140_000 + "]")
    monkeypatch.setattr(rules, "declared", lambda *rule: pytest.fail("it was read"))
    with pytest.raises(InputError, match=r"mine.py has \d+,\d+ bytes, more than 262,144: move what") as found:
        read_study(path)
    assert len(found.value.problems) == 1


def test_a_word_of_the_package_is_no_name_of_a_rule(study):
    with pytest.raises(InputError, match="learner is taken, call the function something else"):
        read_study(study(SOURCE.replace("one", "learner"), STUDY.replace("one", "learner")))


def test_a_rule_keeps_the_name_that_its_source_gives_it(study):
    two = "\ndef two(now, p, memory): return 0.0, memory\none = fc.estimator(Parameters, Memory)(two)\n"
    path = study(SOURCE + two)
    with pytest.raises(InputError, match="one is the rule two in the end: give each a name of its own"):
        read_study(path, prepare=load)


def test_a_unit_that_no_file_holds_is_refused(study):
    with pytest.raises(InputError, match=r"unit = 'a\\x00b': it has characters that cannot be stored as UTF-8"):
        read_study(study(SOURCE.replace("(0.01)", r'(0.01, unit="a\x00b")')))

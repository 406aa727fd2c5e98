"""The errors that a user catches, and values in their messages."""

import pickle

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.base.arguments import collect_problems
from fastcoil.base.errors import Problem, short_repr

BUILTIN_BASE_OF_ERROR = {
    "InputError": ValueError,
    "InputTypeError": TypeError,
    "StorageError": OSError,
    "LockedError": fc.FastcoilError,
    "IntegrityError": fc.FastcoilError,
}
WRONG_TYPE = Problem("m = 'x': give a number", "m", "type")


def test_the_whole_family_is_public():
    assert set(BUILTIN_BASE_OF_ERROR) | {"FastcoilError"} <= set(fc.__all__)
    for name, builtin in BUILTIN_BASE_OF_ERROR.items():
        assert {fc.FastcoilError, builtin} <= set(getattr(fc, name).__mro__)


def test_a_sentence_on_a_wrong_type_makes_a_type_error_of_the_whole_call():
    assert type(fc.InputError("n = 3: lower it")) is fc.InputError
    mixed = fc.InputError(["n = 3: lower it", WRONG_TYPE])
    assert type(mixed) is fc.InputTypeError
    assert (mixed.exit_code, mixed.field, mixed.code) == (2, "", "")
    assert (mixed.problems[1].field, mixed.problems[1].code) == ("m", "type")
    assert str(mixed) == "n = 3: lower it\nm = 'x': give a number"
    unpickled = pickle.loads(pickle.dumps(mixed))
    assert (type(unpickled), str(unpickled)) == (fc.InputTypeError, str(mixed))
    assert type(fc.InputTypeError.__new__(fc.InputTypeError)) is fc.InputTypeError


def test_a_sentence_collected_as_it_is_keeps_its_kind_and_one_of_a_file_does_not():
    for prefix, is_type_error in (("", True), ("[loop] ", False)):
        problems: list[str] = []
        with collect_problems(problems, prefix):
            raise fc.InputError(WRONG_TYPE)
        assert isinstance(fc.InputError(problems), fc.InputTypeError) is is_type_error


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.5, "1.5"),
        ("x" * 70, "'" + "x" * 56 + "..."),
        ("\ud800", r"'\ud800'"),
        (np.arange(4).reshape(2, 2), "array([[0, 1], [2, 3]])"),
    ],
    ids=["number", "long", "surrogate", "several lines"],
)
def test_a_value_is_shown_on_one_line_cut_short(value, text):
    assert short_repr(value) == text


def test_the_text_of_an_error_is_printable_and_cut_and_the_error_has_all_of_it():
    error = fc.InputError([f"key {k} \x1b[31m\nis unknown" for k in range(30_000)])
    lines = str(error).split("\n")
    assert lines[0] == "key 0 \\x1b[31m\\nis unknown"
    assert lines[20:] == ["… and 29,980 more mistakes"]
    assert len(error.problems) == 30_000
    assert error.problems[0] in error.args[0]
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert str(fc.IntegrityError("one\x1b\ntwo")) == "one\\x1b\ntwo"
    assert str(fc.StorageError("full\x1b")) == "full\\x1b"

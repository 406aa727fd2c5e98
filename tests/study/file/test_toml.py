"""TOML that takes long to parse, and what no study can hold, is refused in a sentence."""

from __future__ import annotations

import time

import pytest
from helpers.refusals import only_problem, problems

from fastcoil.study.file.tables import parse_toml


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    "text",
    [
        '"""' + '\\"""' * 200_000,
        "'''" + "''a" * 300_000,
        '"' + '\\"' * 400_000,
        "#" * 1_000_000,
        "[" * 1_000_000,
        "x = " + "{a=" * 300_000,
        "x = " + "[" * 5000 + "]" * 5000,
        "x = 1" + "0" * 1_000_000,
        "x = 1e" + "9" * 1_000_000,
        'x = "' + "\\u0041" * 160_000 + '"',
        "\0" * 1_000_000,
        "x = " + "\ud7ff" * 300_000,
    ],
)
def test_no_text_of_a_mebibyte_takes_long(text):
    """Each is read, or refused in a sentence."""
    start = time.monotonic()
    try:
        parse_toml(text, "s.toml")
    except ValueError as refused:
        assert len(str(refused)) < 500  # noqa: PT017
    assert time.monotonic() - start < 20.0


def test_tables_and_lists_inside_each_other_have_an_end():
    assert "x.a has more than 20 tables or lists inside each other" in only_problem(
        parse_toml, "x.a = " + "[" * 30 + "]" * 30, "s.toml"
    )
    assert "without end: give at most 20" in only_problem(parse_toml, "x = " + "[" * 5000 + "]" * 5000, "s.toml")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('x = "a\\u0000"', "s.toml: x = 'a\\x00' holds the character NUL: delete it"),
        ('x = [{ y = "\\u0000" }]', "s.toml: x.y = '\\x00' holds the character NUL: delete it"),
        ('[x]\n"\\u0000" = 1', "s.toml: x'\\x00' holds the character NUL: delete it"),
        ("k" * 300_000 + " = 1", "is a key of 300,000 characters: give at most 200"),
        ("x = 0x" + "f" * 5000, "s.toml: x is a number of too many digits: give a smaller one"),
    ],
)
def test_what_no_study_can_hold_is_refused(text, sentence):
    problem = only_problem(parse_toml, text, "s.toml")
    assert sentence in problem
    assert len(problem) < 200


def test_every_mistake_gets_its_sentence():
    assert len(problems(parse_toml, 'x = "\\u0000"\ny = "\\u0000"', "s.toml")) == 2

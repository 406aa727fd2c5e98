"""TOML of strangers: short texts that would take minutes, and what no study can hold, are refused at once."""

from __future__ import annotations

import time
import tomllib

import pytest
from helpers.refusals import only_problem, problems

from fastcoil.study.file.tables import parse_toml

BENIGN = (
    r'''
title = "a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s.t.u.v.w.x.y.z = 1 # no comment"
question = """
One. Two. Three. Four. Five. Six. Seven. Eight. Nine. Ten. Eleven. Twelve. Thirteen. Fourteen. Fifteen. Sixteen.
a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s.t.u.v.w.x.y.z \""" ""
"""
other = 'C:\a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s.t.u.v.w.x.y.z'
more = '''
    + "'''"
    + r"""
a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s.t.u.v.w.x.y.z ''
"""
    + "'''"
    + '''
# a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s.t.u.v.w.x.y.z " \'\'\' """
"a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s.t.u.v.w.x.y.z" = 2024-07-01T08:00:00.5+02:00
[cases . "tuning" . 'fa st']
k.p = [0.1, 0.2, 0.3, 1.5e-3, { a.b.c = 1.5 }, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1]
'''
)


def test_what_looks_like_a_long_key_and_is_none_is_read():
    assert parse_toml(BENIGN, "s.toml") == tomllib.loads(BENIGN)
    assert parse_toml(BENIGN.replace("\n", "\r\n"), "s.toml") == tomllib.loads(BENIGN)


@pytest.mark.parametrize(
    "text",
    [
        "\n\n" + "a." * 200_000 + "b = 1",
        "\n\n[" + "a." * 200_000 + "b]",
        "\n\n[[ " + "a\t. " * 100_000 + "b ]]",
        "\n\nx = { " + "a." * 200_000 + "b = 1 }",
        "\n\n" + '"a"."b".' * 50_000 + "b = 1",
        "\n\n" + "'a'.1." * 50_000 + "b = 1",
        "\n\n" + "a." * 20 + "b = 1",
    ],
)
def test_a_key_of_too_many_parts_is_refused_before_it_is_parsed(text):
    start = time.monotonic()
    problem = only_problem(parse_toml, text, "s.toml")
    assert "s.toml: row 3 has a key of " in problem
    assert problem.endswith(" parts, " + problem.split(" parts, ")[1].split(": give")[0] + ": give at most 20")
    assert len(problem) < 200
    assert time.monotonic() - start < 5.0


def test_a_key_of_twenty_parts_is_read():
    assert parse_toml("a." * 19 + "b = 1", "s.toml")


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    "text",
    [
        '"""' + '\\"""' * 200_000,
        "'''" + "''a" * 300_000,
        '"' + '\\"' * 400_000,
        "'" + "a'" * 400_000,
        '"' * 1_000_000,
        "'" * 1_000_001,
        "." * 1_000_000,
        "a.\n" * 300_000,
        "a . " * 19 + ("b " + "a . " * 19) * 10_000,
        "#" * 1_000_000,
        "[" * 1_000_000,
        "x = " + "{a=" * 300_000,
        "x = " + "[" * 5000 + "]" * 5000,
        "= " * 400_000,
        "\\" * 1_000_000,
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

"""Text that takes long to parse, and studies that are too large or hold thousands of mistakes, get a sentence soon."""

import time

import pytest
from helpers.refusals import assert_refused, only_problem

from fastcoil.loops import plan
from fastcoil.study.file.spec import read_study
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
    assert_refused("x.a", "size", parse_toml, "x.a = " + "[" * 30 + "]" * 30, "s.toml")
    # deeper than Python goes, or not, where hypothesis has raised its limit
    assert "give at most 20" in only_problem(parse_toml, "x = " + "[" * 5000 + "]" * 5000, "s.toml")
    assert_refused("s.toml", "size", parse_toml, "a." * 300_000 + "b = 1", "s.toml")


@pytest.mark.parametrize(
    ("text", "field", "code"),
    [
        ('x = "a\\u0000"', "x", "value"),
        ('x = [{ y = "\\u0000" }]', "x.y", "value"),
        ('[x]\n"\\u0000" = 1', "x", "name"),
        ("k" * 300_000 + " = 1", 200 * "k", "name"),
        ("x = 0x" + "f" * 5000, "x", "value"),
    ],
)
def test_what_no_study_can_hold_is_refused(text, field, code):
    error = assert_refused(field, code, parse_toml, text, "s.toml")
    assert len(str(error)) < 200


DAY = "[boundary]\nhours = 1\n"


@pytest.fixture
def read_soon(tmp_path, monkeypatch):
    """Return a function that reads a study in seconds and not minutes."""
    monkeypatch.setattr(plan, "available_memory", lambda: 8 * 2**30)

    def read(text):
        (tmp_path / "s.toml").write_text(text)
        start = time.process_time()
        try:
            return read_study(tmp_path / "s.toml")
        finally:
            assert time.process_time() - start < 5.0

    return read


def test_an_axis_of_millions_of_values_is_refused(read_soon):
    text = f"[loop]\n[sweep]\nbacklash = {{ linspace = [0.0, 0.5, 10000000] }}\n{DAY}"
    assert_refused("backlash", "value", read_soon, text)


@pytest.mark.parametrize(
    "text",
    [
        "[sweep]\nbacklash = { linspace = [0.0, 0.5, 100000] }\nti = { geomspace = [5, 50, 100000] }\n",
        "[sweep]\nbacklash = { linspace = [0.0, 0.5, 100000] }\n[run]\nreplicates = 4294967296\n",
        '[sample]\nmethod = "saltelli"\nsize = 1048576\nbacklash = { uniform = [0.0, 0.5] }\n'
        "[cases.tuning]\n" + "".join(f"c{k} = {{ kp = 0.01 }}\n" for k in range(1000)),
        "[sweep]\nbacklash = { linspace = [0.0, 0.5, 1000000] }\n"
        f"[boundary]\nhours = 0.1\nseed = {list(range(500))}\n",
    ],
)
def test_more_scenarios_than_memory_holds_are_refused_before_they_are_made(read_soon, text):
    problem = only_problem(read_soon, "[loop]\n" + text + ("" if "[boundary]" in text else DAY))
    assert "scenarios need" in problem
    assert len(problem) < 1000

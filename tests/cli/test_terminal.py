"""What reaches the terminal: text of strangers as text, a line each, and no more mistakes than a reader can mend."""

import ast
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import commands
from helpers.sentences import assert_worded

import fastcoil
from fastcoil.base.errors import InputError
from fastcoil.base.text import escape_control_characters
from fastcoil.cli.terminal import print_error, print_logs

UNSAFE_TEXT = "\x1b[2J\x1b]0;x\x07\r\n\x00\x7f\x85\x9b\u202e\u2066\u2028\ud800"
UNSAFE_TITLE = UNSAFE_TEXT.replace("\x00", "").replace("\ud800", "")
"""What a study file may hold of it."""
ESCAPED_TEXT = r"\x1b[2J\x1b]0;x\x07\r\n\x00\x7f\x85\x9b\u202e\u2066\u2028\ud800"


@pytest.fixture
def fastcoil_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return commands.fastcoil


def toml_string(text):
    """The text as a string of TOML, every character but letters escaped."""
    return "".join(c if c.isalnum() else f"\\U{ord(c):08x}" for c in text)


def test_no_character_controls_the_terminal():
    directional_marks = [0x61C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A)]
    for code in [*range(0x20), *range(0x7F, 0xA0), *directional_marks]:
        assert escape_control_characters(f"a{chr(code)}b") == f"a{chr(code).encode('unicode_escape').decode()}b"
    assert escape_control_characters(UNSAFE_TEXT) == ESCAPED_TEXT


def test_logs_of_libraries_are_printed_without_control(capsys, monkeypatch):
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    print_logs()
    try:
        raise ValueError(UNSAFE_TEXT)
    except ValueError:
        logging.getLogger("a.library").exception("%s", UNSAFE_TEXT)
    first, *traceback = capsys.readouterr().err.split("\n")
    assert first == ESCAPED_TEXT
    assert traceback[0].startswith("Traceback")
    assert all(escape_control_characters(line) == line for line in traceback)


@pytest.mark.parametrize(
    ("settings", "name", "content"),
    [
        ({"NUMBA_NUM_THREADS": "0"}, "none", b""),
        ({}, ".numba_config.yaml", b"num_threads"),
        ({}, "matplotlibrc", b"\xff"),
    ],
)
def test_settings_that_a_library_refuses_are_a_sentence(tmp_path, settings, name, content):
    (tmp_path / name).write_bytes(content)
    command = [sys.executable, "-m", "fastcoil", "explain", "lbnl", "-o", "loop.png"]
    ended = subprocess.run(
        command, env=os.environ | settings, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2
    assert_worded(ended.stderr.splitlines()[-1])


def test_many_mistakes_are_cut_and_counted_and_the_exception_keeps_all(capsys):
    error = InputError([f"mistake {k}" for k in range(30_000)])
    print_error(error)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "fastcoil: mistake 0"
    assert lines[19:] == ["fastcoil: mistake 19", "fastcoil: … and 29,980 more mistakes"]
    assert len(error.problems) == 30_000


def test_everything_is_printed_through_the_one_function():
    """Else a new command would show text of strangers as it is; the bar has words and numbers of its own alone."""
    for path in Path(fastcoil.__file__).parent.rglob("*.py"):
        if path.name not in ("terminal.py", "progress.py"):
            calls = [ast.unparse(n.func) for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call)]
            forbidden = {"print", "click.echo", "click.secho", "sys.stdout.write", "sys.stderr.write"} & set(calls)
            assert not forbidden, path


@pytest.mark.kernel
def test_title_question_and_labels_reach_the_terminal_as_text(fastcoil_command, tmp_path):
    (tmp_path / "s.toml").write_text(
        f'title = "{toml_string(UNSAFE_TITLE)}"\nquestion = "{toml_string(UNSAFE_TITLE)}"\n[loop]\n[cases.tuning]\n'
        f'"{toml_string(UNSAFE_TITLE)}" = {{ kp = 0.02 }}\nb = {{ kp = 0.03 }}\n[boundary]\nhours = 1\n'
    )
    for words in (
        ("run", "s.toml", "-o", "out", "--no-figures"),
        ("status", "out"),
        ("plan", "s.toml"),
        ("rerun", "out", "--at", "tuning=" + UNSAFE_TITLE),
        ("rerun", "out"),
    ):
        output = fastcoil_command(*words).output
        assert output
        assert not set(output) & (set(UNSAFE_TEXT) - set(ESCAPED_TEXT) - {"\n"}), words
    assert escape_control_characters(UNSAFE_TITLE) in fastcoil_command("status", "out").output.splitlines()[0]


@pytest.mark.kernel  # `run` compiles it while it reads the study
@pytest.mark.parametrize(
    "words",
    [
        ("run", UNSAFE_TEXT),
        ("run", "s.toml", "-o", UNSAFE_TEXT),
        ("run", "s.toml", "--scheduler", UNSAFE_TEXT, "--backend", "dask"),
        ("status", UNSAFE_TEXT),
        ("plot", UNSAFE_TEXT, "--by", UNSAFE_TEXT),
        ("rerun", "nowhere", "--at", UNSAFE_TEXT),
        ("fit", "coil", "log.csv", "--column", UNSAFE_TEXT),
        ("init", "--from", UNSAFE_TEXT),
        ("parameters", UNSAFE_TEXT),
        (UNSAFE_TEXT,),
        ("run", f"--{UNSAFE_TEXT}"),
    ],
)
def test_words_of_the_command_line_reach_the_terminal_as_text(fastcoil_command, tmp_path, words):
    (tmp_path / "s.toml").write_text("[loop]\n")
    (tmp_path / "log.csv").write_text(f"{UNSAFE_TEXT[:5]},b\n1,2\n3,4\n")
    result = fastcoil_command(*words)
    assert result.exit_code == 2, result.output
    assert result.output
    assert "Traceback" not in result.output
    assert not set(result.output) & (set(UNSAFE_TEXT) - set(ESCAPED_TEXT) - {"\n"}), result.output

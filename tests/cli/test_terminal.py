"""What reaches the terminal: text of strangers as text, a line each, and no more mistakes than a reader can mend."""

import ast
from pathlib import Path

import pytest
from click.testing import CliRunner

import fastcoil
from fastcoil.base.errors import InputError
from fastcoil.base.text import printable
from fastcoil.cli.main import main
from fastcoil.cli.terminal import complain

NASTY = "\x1b[2J\x1b]0;x\x07\r\n\x00\x7f\x85\x9b\u202e\u2066\u2028\ud800"
TITLE = NASTY.replace("\x00", "").replace("\ud800", "")
"""What a study file may hold of it."""
SAFE = r"\x1b[2J\x1b]0;x\x07\r\n\x00\x7f\x85\x9b\u202e\u2066\u2028\ud800"


@pytest.fixture
def fastcoil_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(main, words)


def toml(text):
    """The text as a string of TOML, every character but letters escaped."""
    return "".join(c if c.isalnum() else f"\\U{ord(c):08x}" for c in text)


def test_no_character_controls_the_terminal():
    for code in [
        *range(0x20),
        *range(0x7F, 0xA0),
        0x61C,
        0x200E,
        0x200F,
        *range(0x202A, 0x202F),
        *range(0x2066, 0x206A),
    ]:
        assert printable(f"a{chr(code)}b") == f"a{chr(code).encode('unicode_escape').decode()}b"
    assert printable(NASTY) == SAFE


def test_many_mistakes_are_cut_and_counted_and_the_exception_keeps_all(capsys):
    error = InputError([f"mistake {k}" for k in range(30_000)])
    complain(error)
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "fastcoil: mistake 0"
    assert said[19:] == ["fastcoil: mistake 19", "fastcoil: … and 29,980 more mistakes"]
    assert len(error.problems) == 30_000


def test_everything_is_printed_through_the_one_function():
    """Else a new command would show text of strangers as it is; the bar has words and numbers of its own alone."""
    for path in Path(fastcoil.__file__).parent.rglob("*.py"):
        if path.name not in ("terminal.py", "progress.py"):
            calls = [ast.unparse(n.func) for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call)]
            found = {"print", "click.echo", "click.secho", "sys.stdout.write", "sys.stderr.write"} & set(calls)
            assert not found, path


@pytest.mark.kernel
def test_title_question_and_labels_reach_the_terminal_as_text(fastcoil_command, tmp_path):
    (tmp_path / "s.toml").write_text(
        f'title = "{toml(TITLE)}"\nquestion = "{toml(TITLE)}"\n[loop]\n[cases.tuning]\n'
        f'"{toml(TITLE)}" = {{ kp = 0.02 }}\nb = {{ kp = 0.03 }}\n[boundary]\nhours = 1\n'
    )
    for words in (
        ("run", "s.toml", "-o", "out", "--no-figures"),
        ("status", "out"),
        ("plan", "s.toml"),
        ("rerun", "out", "--at", "tuning=" + TITLE),
        ("rerun", "out"),
    ):
        said = fastcoil_command(*words).output
        assert said
        assert not set(said) & (set(NASTY) - set(SAFE) - {"\n"}), words
    assert printable(TITLE) in fastcoil_command("status", "out").output.splitlines()[0]


@pytest.mark.kernel  # `run` compiles it while it reads the study
@pytest.mark.parametrize(
    "words",
    [
        ("run", NASTY),
        ("run", "s.toml", "-o", NASTY),
        ("run", "s.toml", "--scheduler", NASTY, "--backend", "dask"),
        ("status", NASTY),
        ("plot", NASTY, "--by", NASTY),
        ("rerun", "nowhere", "--at", NASTY),
        ("fit", "coil", "log.csv", "--column", NASTY),
        ("init", "--from", NASTY),
        ("parameters", NASTY),
        (NASTY,),
        ("run", f"--{NASTY}"),
    ],
)
def test_words_of_the_command_line_reach_the_terminal_as_text(fastcoil_command, tmp_path, words):
    (tmp_path / "s.toml").write_text("[loop]\n")
    (tmp_path / "log.csv").write_text(f"{NASTY[:5]},b\n1,2\n3,4\n")
    result = fastcoil_command(*words)
    assert result.exit_code == 2, result.output
    assert result.output
    assert "Traceback" not in result.output
    assert not set(result.output) & (set(NASTY) - set(SAFE) - {"\n"}), result.output

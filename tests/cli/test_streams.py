"""The streams of a command: whatever is closed or full, its work is done, and its exit code says what was lost."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

STUDY = "[loop]\n[sweep]\nbacklash = [0.02, 0.07]\n[boundary]\nhours = 1\n"
COMMAND = f"{sys.executable} -m fastcoil"
LOST_OUTPUT = "fastcoil: not all lines could be printed"


@pytest.fixture
def run_in_shell(tmp_path):
    (tmp_path / "s.toml").write_text(STUDY)
    root = Path(__file__).parents[2]

    def run(words, **env):
        command = ["bash", "-c", f"set -o pipefail; {COMMAND} {words}"]
        env = os.environ | {"PYTHONPATH": str(root)} | env
        return subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=120, check=False, env=env)

    return run


@pytest.mark.kernel
@pytest.mark.parametrize(
    ("streams", "code", "said"),
    [
        (">/dev/full", 4, f"{LOST_OUTPUT} (No space left on device)"),
        pytest.param(">&-", 4, f"{LOST_OUTPUT} (Bad file descriptor)", marks=pytest.mark.full),
        pytest.param("<&- >&- 2>&-", 4, "", marks=pytest.mark.full),
        *(pytest.param(streams, 0, "", marks=pytest.mark.full) for streams in ("2>&-", "2>/dev/full", "| head -n 1")),
    ],
)
def test_a_study_is_run_whatever_becomes_of_the_streams(run_in_shell, tmp_path, streams, code, said):
    if "/dev/full" in streams and not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    process = run_in_shell(f"run s.toml -o out --no-figures -j 1 {streams}")
    assert process.returncode == code, process
    errors = process.stderr.decode()
    assert "Traceback" not in errors
    assert "Exception" not in errors
    assert errors.splitlines()[-1:] == [line for line in errors.splitlines() if line.startswith(LOST_OUTPUT)][-1:]
    assert said in errors
    names = {path.name for path in (tmp_path / "out").iterdir() if path.name[0] != "."}
    assert names == {"results.nc", "answer.json", "run.json", "study.toml"}


def test_help_that_cannot_be_printed_says_so(run_in_shell):
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    process = run_in_shell("run --help > /dev/full")
    assert process.returncode == 4
    assert process.stderr.decode() == f"{LOST_OUTPUT} (No space left on device); files were written as usual\n"


def test_a_mistake_keeps_its_exit_code_where_nothing_can_be_said(run_in_shell):
    assert run_in_shell("run absent.toml >&- 2>&-").returncode == 2
    assert run_in_shell("run --nope 2>&-").returncode == 2


def test_a_terminal_of_few_characters_gets_the_others_escaped(run_in_shell, tmp_path):
    (tmp_path / "s.toml").write_text('title = "Größe Δ"\n' + STUDY)
    process = run_in_shell("init --from nöΔ", PYTHONIOENCODING="latin-1")
    assert process.returncode == 2
    assert b"n\xf6\\u0394" in process.stderr


def test_a_pipe_whose_reader_left_is_no_fault(run_in_shell):
    process = run_in_shell("init --list | head -n 1")
    assert (process.returncode, process.stdout.count(b"\n"), process.stderr) == (0, 1, b"")

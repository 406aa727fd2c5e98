"""A long fit says on stderr how far it is; it ends cleanly however it ends."""

import os
import pty
import signal
import subprocess
import sys
import time

import pytest
from click.testing import CliRunner
from helpers.log_files import VALVE_HEADER, valve_rows, write_csv
from helpers.processes import environment

import fastcoil as fc
from fastcoil.base import progress
from fastcoil.cli.fit import fit_progress
from fastcoil.cli.main import main
from fastcoil.measured.least_squares import progress as fitting


@pytest.fixture
def clock(monkeypatch):
    """A clock that a test sets."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(progress, "PATIENCE", 0.0)
    return now


def test_every_ten_seconds_a_line_says_how_much_is_done_and_how_long_the_rest_takes(clock, capsys):
    with fit_progress():
        fitting.get()("starts", 0, 768)
        clock[0] += 9.0
        fitting.get()()
        assert capsys.readouterr().err == ""
        fitting.get()("descents", 0, 5)
        clock[0] += 24.0
        fitting.get()("descents", 2, 5)
        clock[0] += 1.0
        fitting.get()()
    assert capsys.readouterr().err == "2 of 5 descents, 36 s to go\n"
    fitting.get()()
    clock[0] += 60.0
    fitting.get()()
    assert capsys.readouterr().err == ""


@pytest.mark.full
@pytest.mark.kernel
def test_a_fit_reports_its_parts_and_a_short_one_prints_nothing(tmp_path):
    path = write_csv(tmp_path / "valve.csv", VALVE_HEADER, valve_rows(80))
    options = ["--lag", "0", "--hold", "command", "-o", str(tmp_path / "valve.toml")]
    done = CliRunner().invoke(main, ["fit", "valve", str(path), *options])
    assert (done.exit_code, done.stderr) == (0, ""), done
    parts = []
    token = fitting.set(lambda *part: parts.append(part) if part else None)
    fc.fit_valve(path, lag=0, holds="command")
    fitting.reset(token)
    assert {what for what, _, _ in parts} == {"starts", "descents", "values of the backlash"}
    assert [done for what, done, _ in parts if what == "descents"] == [0, 1, 2, 3, 4]
    assert all(done < of for _, done, of in parts)


@pytest.mark.full
def test_ctrl_c_ends_a_fit_cleanly(tmp_path):
    path = write_csv(tmp_path / "valve.csv", VALVE_HEADER, valve_rows(120_000))
    command = [sys.executable, "-m", "fastcoil", "fit", "valve", str(path), "-o", str(tmp_path / "valve.toml")]
    ours, theirs = pty.openpty()
    with subprocess.Popen(command, stderr=theirs, stdout=subprocess.DEVNULL, env=environment()) as running:
        os.close(theirs)
        said, until = b"", time.monotonic() + 120
        while b"descents" not in said and time.monotonic() < until:
            said += os.read(ours, 4096)
        running.send_signal(signal.SIGINT)
        assert running.wait(30) == 130
    os.close(ours)
    assert b"Traceback" not in said
    assert not (tmp_path / "valve.toml").exists()

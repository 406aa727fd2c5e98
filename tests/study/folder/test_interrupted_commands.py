"""Commands that are interrupted, that find the folder held by another run, or that lose their reader."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest
from helpers.commands import fastcoil
from helpers.processes import child_environment
from helpers.studies import PLAIN_STUDY, shard_files, unfinished_files

from fastcoil.study import maintenance
from fastcoil.study import run as runner

pytestmark = pytest.mark.kernel

LONG = PLAIN_STUDY.replace("hours = 0.25", "hours = 8").replace("[0.0, 0.9]", "{ linspace = [0.0, 1.5, 6000] }")
"""Seconds of work in several shards a day."""


@pytest.fixture
def command(tmp_path):
    """Return a function that starts the command line on a study of some seconds, one worker."""
    (tmp_path / "my study.toml").write_text(LONG)
    started = []

    def start(*words, **options):
        options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": tmp_path} | options
        words = words or ("run", "my study.toml", "-o", "out", "-j", "1", "--no-figures")
        process = subprocess.Popen([sys.executable, "-m", "fastcoil", *words], env=child_environment(), **options)
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=60)


def wait_for_shards(process, folder, n=1):
    """Until there are some, or a minute is over."""
    end = time.monotonic() + 60
    while len([p for p in shard_files(folder) if p.suffix == ".nc" and not p.name.startswith(".")]) < n:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.alone
@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.full)], ids=str)
def test_a_run_that_is_asked_to_end_does_so_at_once_and_says_how_to_go_on(command, tmp_path, number):
    process = command()
    wait_for_shards(process, tmp_path / "out")
    process.send_signal(number)
    _, stderr = process.communicate(timeout=5)
    assert process.returncode == 143, stderr
    kept = "[1-9][0-9,]* of 36,000 scenario-days|finished scenarios"
    assert re.search(f"interrupted; ({kept}) are kept, to resume: fastcoil run", stderr)
    assert "Traceback" not in stderr
    assert not (tmp_path / "out" / "results.nc").exists()
    assert unfinished_files(tmp_path / "out") == []
    assert maintenance.verify(tmp_path / "out") == []
    assert any("Unfinished" in line for line in maintenance.status(tmp_path / "out"))


@pytest.mark.alone
@pytest.mark.full
def test_a_second_run_exits_with_5_and_names_the_first_until_that_is_killed(command, tmp_path, monkeypatch):
    first = command()
    wait_for_shards(first, tmp_path / "out")
    first.send_signal(signal.SIGSTOP)  # it holds the folder, and takes no processor
    words = ["run", tmp_path / "my study.toml", "-o", tmp_path / "out", "-j", "1", "--no-figures"]
    second = fastcoil(*words)
    assert second.exit_code == 5
    assert f"in use by another run (process {first.pid} on " in second.stderr
    assert "Traceback" not in second.output
    first.kill()
    first.wait(timeout=60)
    held = []

    def look(*_):
        held.append((tmp_path / "out" / ".holder").read_text())
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "make_pool", look)
    third = fastcoil(*words)
    assert "Resuming:" in third.stderr
    assert f"process {os.getpid()} " in held[0]


@pytest.mark.alone
@pytest.mark.full
def test_ctrl_c_before_the_first_shard_leaves_no_folder(command, tmp_path):
    process = command("run", "my study.toml", "-o", "deep/out", "-j", "1", "--no-figures")
    end = time.monotonic() + 60
    while not (tmp_path / "deep" / "out" / ".holder").exists():
        assert time.monotonic() < end
        time.sleep(0.002)
    if shard_files(tmp_path / "deep" / "out"):
        pytest.skip("this machine was faster")
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=5)
    assert process.returncode == 130, stderr
    assert not (tmp_path / "deep").exists()
    assert "to resume" not in stderr

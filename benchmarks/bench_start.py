"""What a user waits for before anything is simulated: import, command line, compilation."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from conftest import Timed
from suite import ALL

STUDY = """
[loop]
preset = "paper_like"
[sweep]
backlash = { linspace = [0.0, 0.14, 10] }
estimate_ratio = { linspace = [0.0, 1.5, 10] }
[boundary]
kind = "paper_day"
hours = 8
seed = 1
"""
SCENARIOS, SECONDS = 100, 8 * 3600
FASTCOIL = (sys.executable, "-m", "fastcoil")


def call(*command: str | Path, cache: Path | None = None) -> None:
    environment = os.environ | ({"XDG_CACHE_HOME": str(cache)} if cache else {})
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    return path


def test_python_alone(timed: Timed) -> None:
    timed(lambda: call(sys.executable, "-c", "pass"), 10)


def test_import(timed: Timed) -> None:
    timed(lambda: call(sys.executable, "-c", "import fastcoil"), 10)


def test_help(timed: Timed) -> None:
    timed(lambda: call(*FASTCOIL, "--help"), 10)


def test_run_warm(timed: Timed, study: Path, tmp_path: Path) -> None:
    """A grid study without figures, kernels compiled before; every round writes a folder of its own."""
    number = count()

    def fresh() -> tuple[tuple[Path], dict[str, Any]]:
        return (tmp_path / str(next(number)),), {}

    def run(folder: Path) -> None:
        call(*FASTCOIL, "run", study, "--no-figures", "-o", folder)

    timed(run, 5, setup=fresh, lane_steps=SCENARIOS * SECONDS, lanes=SCENARIOS, threads=ALL)


def test_run_cold(timed: Timed, study: Path, tmp_path: Path) -> None:
    """The same with an empty cache: everything that a study needs is compiled."""
    command = (*FASTCOIL, "run", study, "--no-figures", "-o", tmp_path / "cold")
    timed(lambda: call(*command, cache=tmp_path / "cache"), 1, warm_up=False,
          lane_steps=SCENARIOS * SECONDS, lanes=SCENARIOS, threads=ALL)  # fmt: skip

"""What a user waits for around the simulation itself: import, command line, compilation, files, figures."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from conftest import Timed
from suite import ALL, QUICK

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
SCENARIOS = 100
SECONDS = 8 * 3600
FASTCOIL = (sys.executable, "-m", "fastcoil")
NO_DASK = (sys.executable, "-c", "import sys; sys.modules['dask'] = None; from fastcoil.__main__ import run; run()")
"""As installed without the extra ``dask``, which xarray imports wherever it is."""


def run_command(*command: str | Path, cache: Path | None = None) -> None:
    environment = os.environ | ({"XDG_CACHE_HOME": str(cache)} if cache else {})
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # a user's Python reads its sources once
    process = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    return path


def test_python_alone(timed: Timed) -> None:
    timed(lambda: run_command(sys.executable, "-c", "pass"), 10)


def test_libraries(timed: Timed) -> None:
    """What no command on results can do without."""
    timed(lambda: run_command(sys.executable, "-c", "import numpy, numba, xarray, netCDF4"), 10)


def test_import(timed: Timed) -> None:
    timed(lambda: run_command(sys.executable, "-c", "import fastcoil"), 10)


def test_help(timed: Timed) -> None:
    timed(lambda: run_command(*FASTCOIL, "--help"), 10)


def test_plan(timed: Timed, study: Path) -> None:
    timed(lambda: run_command(*FASTCOIL, "plan", study), 5)


def test_run_warm(timed: Timed, study: Path, tmp_path: Path) -> None:
    """A grid study without figures, kernels compiled before; every round writes a folder of its own."""
    number = count()

    def fresh() -> tuple[tuple[Path], dict[str, Any]]:
        return (tmp_path / str(next(number)),), {}

    def run(folder: Path) -> None:
        run_command(*FASTCOIL, "run", study, "--no-figures", "-o", folder)

    timed(run, 5, setup=fresh, lane_steps=SCENARIOS * SECONDS, lanes=SCENARIOS, threads=ALL)


def test_run_warm_with_figures(timed: Timed, study: Path, tmp_path: Path) -> None:
    """The same with the standard figures of the study, two PNG files; the answer in words comes before them."""
    number = count()
    timed(lambda folder: run_command(*FASTCOIL, "run", study, "-o", folder), 5,
          setup=lambda: ((tmp_path / str(next(number)),), {}),
          lane_steps=SCENARIOS * SECONDS, lanes=SCENARIOS, threads=ALL)  # fmt: skip


def test_run_again(timed: Timed, study: Path, tmp_path: Path) -> None:
    """A study that is finished: it is found so, and summarised."""
    command = (*FASTCOIL, "run", study, "--no-figures", "-o", tmp_path / "finished")
    run_command(*command)
    timed(lambda: run_command(*command), 5)


def test_run_again_without_dask(timed: Timed, study: Path, tmp_path: Path) -> None:
    command = (*NO_DASK, "run", study, "--no-figures", "-o", tmp_path / "finished")
    run_command(*command)
    timed(lambda: run_command(*command), 5)


def test_status(timed: Timed, study: Path, tmp_path: Path) -> None:
    run_command(*FASTCOIL, "run", study, "--no-figures", "-o", tmp_path / "finished")
    timed(lambda: run_command(*FASTCOIL, "status", tmp_path / "finished"), 5)


@pytest.mark.skipif(QUICK, reason="a cold run compiles the same")
def test_first_compile(timed: Timed, tmp_path: Path) -> None:
    """The kernels of the default loop alone, with an empty cache: what comes once after an installation."""
    compile_it = "from fastcoil.model.engine.lanes import compile_kernel; compile_kernel()"
    timed(
        lambda: run_command(sys.executable, "-c", compile_it, cache=tmp_path / "cache"), 1, warm_up=False, threads=ALL
    )


def test_run_cold(timed: Timed, study: Path, tmp_path: Path) -> None:
    """The same with an empty cache: everything that a study needs is compiled."""
    command = (*FASTCOIL, "run", study, "--no-figures", "-o", tmp_path / "cold")
    timed(lambda: run_command(*command, cache=tmp_path / "cache"), 1, warm_up=False,
          lane_steps=SCENARIOS * SECONDS, lanes=SCENARIOS, threads=ALL)  # fmt: skip

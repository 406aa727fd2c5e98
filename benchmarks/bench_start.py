"""What a user waits for around the simulation itself: import, command line, compilation, files, figures."""

from __future__ import annotations

import os
import subprocess
import sys
import time
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
LIBRARIES = (sys.executable, "-c", "import numpy, numba, xarray, netCDF4")
"""What no command on results can do without."""
FASTCOIL = (sys.executable, "-m", "fastcoil")
NEW = "a new folder"
NO_DASK = (sys.executable, "-c", "import sys; sys.modules['dask'] = None; from fastcoil.__main__ import run; run()")
"""As installed without the extra ``dask``."""


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
    timed(lambda: run_command(*LIBRARIES), 10)


def test_import(timed: Timed) -> None:
    timed(lambda: run_command(sys.executable, "-c", "import fastcoil"), 10)


def test_help(timed: Timed) -> None:
    timed(lambda: run_command(*FASTCOIL, "--help"), 10)


def test_plan(timed: Timed, study: Path) -> None:
    time_beside_imports(timed, study, *FASTCOIL, "plan", study)


def time_beside_imports(timed: Timed, study: Path, *command: str | Path, **options: Any) -> None:
    """Time a command in turns with the bare imports, whose seconds are recorded as ``imports``.

    ``NEW`` among its words is a folder of results for each round, beside the study.
    """
    imports: list[float] = []
    folders = (study.with_name(str(n)) for n in count())

    def setup() -> tuple[tuple[Path], dict[str, Any]]:
        start = time.perf_counter()
        run_command(*LIBRARIES)
        imports.append(time.perf_counter() - start)
        return (next(folders),), {}

    def run(folder: Path) -> None:
        run_command(*(folder if word == NEW else word for word in command))

    timed(run, 7, setup=setup, imports=imports, **options)


def test_run_warm(timed: Timed, study: Path) -> None:
    """A grid study without figures, kernels compiled before; every round writes a folder of its own."""
    time_beside_imports(timed, study, *FASTCOIL, "run", study, "--no-figures", "-o", NEW,
                        lane_steps=SCENARIOS * SECONDS, lanes=SCENARIOS, threads=ALL)  # fmt: skip


def test_run_warm_with_figures(timed: Timed, study: Path) -> None:
    """The same with the standard figures of the study, two PNG files; the answer in words comes before them."""
    time_beside_imports(timed, study, *FASTCOIL, "run", study, "-o", NEW,
                        lane_steps=SCENARIOS * SECONDS, lanes=SCENARIOS, threads=ALL)  # fmt: skip


@pytest.mark.parametrize("command", [FASTCOIL, NO_DASK], ids=["dask", "no dask"])
def test_run_again(timed: Timed, study: Path, tmp_path: Path, command: tuple[str, ...]) -> None:
    """A study that is finished: it is found so, and summarised."""
    words = (*command, "run", study, "--no-figures", "-o", tmp_path / "finished")
    run_command(*words)
    time_beside_imports(timed, study, *words)


def test_status(timed: Timed, study: Path, tmp_path: Path) -> None:
    run_command(*FASTCOIL, "run", study, "--no-figures", "-o", tmp_path / "finished")
    time_beside_imports(timed, study, *FASTCOIL, "status", tmp_path / "finished")


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

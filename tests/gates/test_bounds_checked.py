"""No whole run reads or writes outside an array: kernels that check every index agree with the reference as well."""

import subprocess
import sys
from pathlib import Path

import pytest
from helpers.processes import child_environment

TESTS = Path(__file__).parents[1]
OF_EVERY_KERNEL = [
    *("model/engine/test_truth.py", "model/engine/test_metrics.py", "model/estimators/test_twins.py"),
    *("measured/test_replay.py", "measured/test_valve.py", "measured/test_coil.py"),
]
"""Tests of whole runs with every feature, of replays and of fits."""


@pytest.mark.full
@pytest.mark.kernel
@pytest.mark.parametrize("tests", OF_EVERY_KERNEL)
def test_whole_runs_stay_within_their_arrays(tmp_path, tests):
    checking_environment = child_environment(NUMBA_BOUNDSCHECK="1", XDG_CACHE_HOME=str(tmp_path), FASTCOIL_FULL="")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(TESTS / tests)]
    subprocess.run(command, env=checking_environment, cwd=TESTS.parent, check=True)

"""Gate: a damaged study file, log or weather file is read or refused in sentences, in bounded memory and time."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
KINDS = 14
"""Of files and readers in ``helpers.text_fuzz``."""


def faults(seed, count, folder):
    """A line for each file, of ``count`` of each kind, that was neither read nor refused in sentences."""
    command = [sys.executable, "-m", "helpers.text_fuzz", str(seed), str(count), str(folder)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)]), "OMP_NUM_THREADS": "1"}
    return subprocess.check_output(command, env=environment, text=True, timeout=1200).splitlines()


pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="measures its memory as Linux gives it")


def test_damaged_files_are_read_or_refused_in_sentences(tmp_path):
    assert faults(1, 30 // KINDS, tmp_path) == []


@pytest.mark.full
@pytest.mark.parametrize("seed", range(2, 6))
def test_more_damaged_files_are_read_or_refused_in_sentences(tmp_path, seed):
    assert faults(seed, 400, tmp_path) == []

"""No whole run reads or writes outside an array: every index is checked, and the numbers are the same to the bit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import every_feature
from helpers.processes import environment

from fastcoil.model.metric_table import STATUS_OK

pytestmark = pytest.mark.kernel

SCRIPT = Path(every_feature.__file__)


def run(folder, *features, **env):
    """All numbers of some features, from a process of its own."""
    folder.mkdir()
    out = folder / "found.npz"
    done = subprocess.run(
        [sys.executable, str(SCRIPT), str(out), *features],
        env=environment(**env),
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    with np.load(out) as found:
        return dict(found)


@pytest.mark.full
def test_a_whole_run_stays_within_its_arrays(tmp_path):
    # in the interpreter NumPy checks every index
    found = run(tmp_path / "checked", "short_study", NUMBA_DISABLE_JIT="1")
    assert (found["short_study.status"] == STATUS_OK).all()


@pytest.mark.full
@pytest.mark.parametrize("feature", [f for f in every_feature.FEATURES if f != "short_study"])
def test_every_feature_stays_within_its_arrays(tmp_path, feature):
    found = run(tmp_path / "checked", feature, NUMBA_BOUNDSCHECK="1")
    expected = run(tmp_path / "plain", feature)
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)

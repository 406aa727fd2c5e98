"""One more estimator is one file and its word among the choices: all that the package does with estimators follows."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fastcoil as fc
from fastcoil.model.estimators import interface
from fastcoil.model.estimators.registry import ESTIMATORS
from fastcoil.model.parameter_table import PARAMETERS

ESTIMATOR_SOURCE = '''"""The share of the turns of the inverse among its samples, as an example of an estimator."""

from typing import NamedTuple

import numpy as np

from fastcoil.model.estimators.interface import Estimator, filter_weight, low_pass
from fastcoil.model.numerics.jit import exact

SCALE = 0.05
"""Estimate where the inverse turns at every sample."""


class Parameters(NamedTuple):
    """Parameters of the loop that it uses."""

    sample_time: float
    ti: float


class Memory(NamedTuple):
    """What it remembers."""

    weight: float
    """Of a new value."""
    switches: float
    """Turns up to the last sample."""
    share: float
    """Share of samples with a turn, filtered."""


@exact
def initial_memory(p):
    """Memory at the start: nothing yet."""
    return Memory(filter_weight(20.0 * p.ti, p.sample_time), 0.0, np.nan)


@exact
def update_estimate(now, p, memory):
    """Let the estimate follow the share of turns."""
    share = low_pass(memory.share, 1.0 if now.switches > memory.switches else 0.0, memory.weight)
    return SCALE * share, Memory(memory.weight, now.switches, share)


ESTIMATOR = Estimator("turns", Parameters, Memory, update_estimate, initial_memory)
'''
CHECK_SOURCE = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from helpers.exported import worst_in_c
import fastcoil as fc
assert Path(fc.__file__).parent == Path("fastcoil").absolute()
assert fc.parameters()["estimator"].choices[-1] == "turns"
loop = fc.Loop(estimator=["none", "turns"], backlash=0.1, sample_time=1, n_volumes=1, noise_std=0.05)
ds = fc.simulate(loop, fc.paper_day(hours=20 / 3600), warm_up=2, n_jobs=1)
assert ds.estimate_final.sel(estimator="turns") > 0.0
assert ds.estimate_final.sel(estimator="none") == 0.0
code = Path(sys.argv[2]) / "valve.c"
assert worst_in_c(*fc.export_controller(fc.Loop(estimator="turns", n_volumes=1), code, "c")) == 0.0
assert "Let the estimate follow the share of turns" in code.read_text()
"""


def test_each_choice_has_its_estimator():
    names = PARAMETERS["estimator"].choices
    assert [None if e is None else e.name for e in ESTIMATORS] == [None if n == "none" else n for n in names]
    assert ESTIMATORS[0] is None


def test_each_file_has_its_choice():
    files = {path.stem for path in Path(interface.__file__).parent.glob("*.py")} - {"__init__", "interface", "registry"}
    assert files == set(PARAMETERS["estimator"].choices) - {"none"}, "choices of estimator in model/parameters.toml"


def test_no_estimator_reads_the_true_backlash():
    assert not {"backlash", "estimate_ratio"} & {name for e in ESTIMATORS[1:] for name in e.Parameters._fields}


@pytest.mark.kernel
@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.full
def test_one_more_estimator_is_one_file_and_one_word(tmp_path):
    package = tmp_path / "fastcoil"
    shutil.copytree(Path(fc.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "model" / "estimators" / "turns.py").write_text(ESTIMATOR_SOURCE)
    table = package / "model" / "parameters.toml"
    words = '"learner", "hagglund", "gradient", "identify"]'
    assert table.read_text().count(words) == 1
    table.write_text(table.read_text().replace(words, f'{words[:-1]}, "turns"]'))
    (tmp_path / "out").mkdir()
    completed = subprocess.run(
        [sys.executable, "-c", CHECK_SOURCE, Path(__file__).parents[2], tmp_path / "out"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path), "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == 0, completed.stderr

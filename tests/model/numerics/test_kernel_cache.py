"""The cache of compiled kernels: never stale, never damaged, never fatal, nobody else's."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import fastcoil
from fastcoil.model.numerics import kernel_cache

pytestmark = pytest.mark.kernel

PACKAGE = Path(fastcoil.__file__).parent
# the smallest kernel that calls a formula of the physics: a motor, limited in its travel, on its way up
RUN = """
import numpy as np
from fastcoil.model.engine.recorded import motor_positions
positions = np.empty(3)
motor_positions(np.array([0.0, 1.0]), 0.1, positions)
print(float(positions[2]), sum(motor_positions.stats.cache_hits.values()))
"""
# and one that takes a tenth of a second
SMALL = """
import numpy as np
from fastcoil.model.numerics.noise import low_pass
y = np.empty(2)
low_pass(np.ones(2), 0.5, y)
print(float(y[1]), sum(low_pass.stats.cache_hits.values()))
"""


@pytest.fixture
def copied(tmp_path):
    """A folder with a copy of the package, and the environment in which Python finds it and an empty cache."""
    shutil.copytree(PACKAGE, tmp_path / "fastcoil", ignore=shutil.ignore_patterns("__pycache__"))
    keep = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "PYTHON"))}
    return tmp_path, keep | {"PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}


def run(env, code=RUN):
    command = [sys.executable, "-c", code]
    # not from here, where Python would find the package itself before the copy
    return subprocess.run(command, env=env, cwd=env["PYTHONPATH"], capture_output=True, text=True, check=True)


def travel_and_hits(env):
    travel, hits = run(env).stdout.split()
    return float(travel), int(hits)


def test_a_later_process_takes_the_kernel_that_two_compiled_at_once_until_a_formula_changes(copied):
    root, env = copied
    words = [sys.executable, "-c", RUN]
    both = [subprocess.Popen(words, env=env, cwd=env["PYTHONPATH"], stdout=subprocess.PIPE, text=True) for _ in "ab"]
    said = {p.communicate(timeout=120)[0].split()[0] for p in both}
    assert [p.returncode for p in both] == [0, 0]
    travel, hits = travel_and_hits(env)
    assert said == {str(travel)} == {"0.1"}
    assert hits == 1
    # motor_positions lies in another file than the formula it calls
    actuator = root / "fastcoil" / "model" / "physics.py"
    text = actuator.read_text()
    assert text.count("position + max_travel\n") == 1
    actuator.write_text(text.replace("position + max_travel\n", "position + 2.0 * max_travel\n"))
    assert travel_and_hits(env) == (0.2, 0)
    actuator.write_text(text)
    assert travel_and_hits(env) == (0.1, 1)
    assert len(list((root / "cache" / "fastcoil" / "kernels").iterdir())) == 2


def test_a_damaged_cache_is_compiled_again_and_the_users_own_numba_cache_keeps_its_place(copied):
    root, env = copied
    own = root / "own"
    # a module that is loaded again reads the cache as a new process does, without its seconds of imports
    code = (
        SMALL
        + """
import importlib, os, sys
from pathlib import Path
import fastcoil.model.numerics.noise as module
folder = Path(module.low_pass.stats.cache_path)
for damage in (lambda b: b[:10], lambda b: b[:-1], lambda b: bytes(len(b))):
    (path,) = folder.glob("*.low_pass-*.nbc")
    path.write_bytes(damage(path.read_bytes()))
    for _ in range(2):
        module = importlib.reload(module)
        module.low_pass(np.ones(2), 0.5, y)
        print(float(y[1]), sum(module.low_pass.stats.cache_hits.values()))
from numba.core import config
print(config.CACHE_DIR)
"""
    )
    first, *others, place = run(env | {"NUMBA_CACHE_DIR": str(own)}, code).stdout.splitlines()
    assert first == "0.75 0"
    assert others == ["0.75 0", "0.75 1"] * 3
    assert place == str(own)
    assert not own.exists()
    assert list((root / "cache" / "fastcoil" / "kernels").rglob("*.nbc"))


def test_a_cache_that_cannot_be_written_is_a_warning_and_no_more(copied):
    root, env = copied
    (root / "file").touch()
    found = run(env | {"XDG_CACHE_HOME": str(root / "file")}, SMALL)
    assert found.stdout == "0.75 0\n"
    assert "cannot be made (File exists): set XDG_CACHE_HOME to a folder of your own" in found.stderr
    assert found.stderr.count("Warning") == 1


def test_a_kernel_compiled_with_other_settings_than_its_folder_says_is_not_kept(copied):
    root, env = copied
    changed = SMALL.replace("y = ", "import os\nos.environ['NUMBA_OPT'] = '1'\ny = ")
    assert changed != SMALL
    assert run(env, changed).stdout.endswith(" 0\n")
    assert not list((root / "cache").rglob("*.nbc"))


def test_pruning_keeps_the_current_folder_and_the_latest_ones(tmp_path):
    now = time.time()
    (tmp_path / "mine").mkdir()  # whatever it does here
    os.utime(tmp_path / "mine", (0, 0))
    for age in range(7):
        folder = tmp_path / f"{age:016x}"
        folder.mkdir()
        (folder / "kernel.nbc").touch()
        os.utime(folder, (now - age, now - age))
    kernel_cache._prune(tmp_path / f"{6:016x}")
    assert {folder.name for folder in tmp_path.iterdir()} == {f"{age:016x}" for age in (0, 1, 2, 3, 6)} | {"mine"}

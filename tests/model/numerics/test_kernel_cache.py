"""The cache of compiled kernels: stale, damaged or foreign files are not loaded, and a full disk is no error."""

import errno
import os
import random
import shutil
import stat
import subprocess
import sys
import warnings
from pathlib import Path

import numba
import numpy as np
import pytest

import fastcoil
from fastcoil.model.engine.emulator import emulate
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.model.numerics import kernel_cache
from fastcoil.model.numerics.jit import FLAGS
from fastcoil.model.numerics.kernel_cache import KernelCache, kernel_folder
from fastcoil.model.numerics.noise import low_pass

pytestmark = pytest.mark.kernel

PACKAGE = Path(fastcoil.__file__).parent
# the smallest kernel that calls a formula of the physics: a motor, limited in its travel, on its way up
RUN_SCRIPT = """
import numpy as np
from fastcoil.model.engine.recorded import motor_positions
positions = np.empty(3)
motor_positions(np.array([0.0, 1.0]), 0.1, positions)
print(float(positions[2]), sum(motor_positions.stats.cache_hits.values()))
"""


def start_process(env):
    command = [sys.executable, "-c", RUN_SCRIPT]
    # not from here, where Python would find the package itself before the copy
    return subprocess.Popen(command, env=env, cwd=env["PYTHONPATH"], stdout=subprocess.PIPE, text=True)


def travel_and_hits(process):
    travel, hits = process.communicate(timeout=120)[0].split()
    return float(travel), int(hits)


def test_a_later_process_takes_the_kernel_that_two_compiled_at_once_until_a_formula_changes(tmp_path):
    """In a copy of the package, with an empty cache."""
    shutil.copytree(PACKAGE, tmp_path / "fastcoil", ignore=shutil.ignore_patterns("__pycache__"))
    env = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "PYTHON"))}
    env |= {"PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    assert {travel_and_hits(process)[0] for process in [start_process(env), start_process(env)]} == {0.1}
    assert travel_and_hits(start_process(env)) == (0.1, 1)
    # motor_positions lies in another file than the formula it calls
    actuator = tmp_path / "fastcoil" / "model" / "physics.py"
    text = actuator.read_text()
    assert text.count("position + max_travel\n") == 1
    actuator.write_text(text.replace("position + max_travel\n", "position + 2.0 * max_travel\n"))
    assert travel_and_hits(start_process(env)) == (0.2, 0)
    actuator.write_text(text)
    assert travel_and_hits(start_process(env)) == (0.1, 1)
    assert len(list((tmp_path / "cache" / "fastcoil" / "kernels").iterdir())) == 2


@pytest.fixture
def folder(tmp_path):
    """A folder with a large kernel and a small one, and no others."""
    compile_kernel()
    low_pass(np.ones(3), 0.5, np.empty(3))
    source = Path(low_pass.stats.cache_path)
    copy = tmp_path / "fastcoil" / "kernels" / source.name
    copy.mkdir(mode=0o700, parents=True)
    for kernel in (emulate, low_pass):
        shutil.copy(kernel_file(kernel, source), copy)
    return copy


def is_loaded(kernel, folder):
    """Whether the kernel is found in a folder."""
    (signature,) = kernel.signatures
    return KernelCache(kernel.py_func, folder).load_overload(signature, kernel.targetctx) is not None


def kernel_file(kernel, folder):
    """The file of a kernel."""
    (path,) = folder.glob(f"*.{kernel.py_func.__name__}-*.nbc")
    return path


def filter_with_cache(folder):
    """Compile a small kernel, or load it from a folder, and store it there; return one number of it."""
    function = numba.njit(**FLAGS)(low_pass.py_func)
    function._cache = KernelCache(low_pass.py_func, folder)
    filtered = np.empty(3)
    function(np.ones(3), 0.5, filtered)
    return filtered[2]


def test_a_damaged_kernel_is_compiled_again(folder):
    dice = random.Random(30)
    for k in range(30):
        kernel = dice.choice([emulate, low_pass])
        path = kernel_file(kernel, folder)
        sound = path.read_bytes()
        # headers and pickled names are short, and the machine code long
        position = dice.choice([dice.randrange(300), dice.randrange(len(sound))])
        damaged = bytearray(sound)
        damaged[position] ^= 1 << dice.randrange(8)
        path.write_bytes(damaged if k % 3 else sound[:position])
        assert not is_loaded(kernel, folder), (kernel, position)
        path.write_bytes(sound)
    assert is_loaded(emulate, folder)
    kernel_file(low_pass, folder).write_bytes(b"damaged")
    assert filter_with_cache(folder) == 0.875
    assert is_loaded(low_pass, folder)


def test_a_kernel_compiled_with_other_settings_than_its_folder_says_is_not_kept(folder, monkeypatch):
    kernel_file(low_pass, folder).unlink()
    settings = iter([{"OPT": "3"}, {"OPT": "1"}])
    monkeypatch.setattr(kernel_cache, "_numba_settings", lambda: next(settings))
    assert filter_with_cache(folder) == 0.875
    assert len(list(folder.iterdir())) == 1


def test_a_kernel_under_the_name_of_another_or_from_another_folder_is_not_loaded(folder):
    shutil.copy(kernel_file(emulate, folder), kernel_file(low_pass, folder))
    assert not is_loaded(low_pass, folder)
    other_folder = folder.with_name("0" * 16)
    shutil.copytree(folder, other_folder)
    assert is_loaded(emulate, folder)
    assert not is_loaded(emulate, other_folder)


FOLDER_FAULTS = {
    "belongs to another user": lambda path: os.chown(path, 12345, -1),
    "belongs to another user, two levels above": lambda path: os.chown(path.parents[1], 12345, -1),
    "can be written by other users": lambda path: path.chmod(0o770),
    "can be written by other users, all": lambda path: path.chmod(0o707),
    "is a symbolic link": lambda path: path.symlink_to(path.rename(path.parents[2] / "elsewhere")),
    "cannot be made (File exists)": lambda path: path.rename(path.parents[2] / "elsewhere") and path.touch(),
}


@pytest.fixture
def call_with_warnings(tmp_path, monkeypatch):
    """Return a function that calls another one as in a new process; it returns the result and the warnings."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def call(function, *arguments):
        kernel_cache._warn_uncached.cache_clear()
        kernel_folder.cache_clear()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            return function(*arguments), [str(w.message) for w in caught]

    yield call
    kernel_cache._warn_uncached.cache_clear()
    kernel_folder.cache_clear()


@pytest.mark.parametrize("fault", FOLDER_FAULTS)
def test_a_folder_that_another_may_write_to_is_not_used(folder, call_with_warnings, fault):
    assert call_with_warnings(kernel_folder, folder.name) == (folder, [])
    try:
        FOLDER_FAULTS[fault](folder)
    except PermissionError:
        pytest.skip("only root can give files away")
    unused, (warning,) = call_with_warnings(kernel_folder, folder.name)
    assert unused is None
    assert warning.startswith(f"every process compiles the kernels again: {folder} {fault.partition(',')[0]}: fix it")


def test_what_is_made_is_private_whatever_the_umask(call_with_warnings):
    before = os.umask(0)
    try:
        new_folder, warnings_ = call_with_warnings(kernel_folder, "0" * 16)
    finally:
        os.umask(before)
    assert not warnings_
    assert {stat.S_IMODE(p.stat().st_mode) for p in (*new_folder.parents[:2], new_folder)} == {0o700}


def test_a_full_disk_is_a_warning_and_leaves_nothing_half_written(folder, monkeypatch, call_with_warnings):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    kernel_file(low_pass, folder).unlink()
    monkeypatch.setattr(os, "replace", full)
    filtered, (warning,) = call_with_warnings(filter_with_cache, folder)
    assert filtered == 0.875
    assert "cannot be written ([Errno 28] No space left on device): fix it, or set XDG_CACHE_HOME" in warning
    assert len(list(folder.iterdir())) == 1


def test_pruning_keeps_the_current_folder_and_the_latest_ones(tmp_path):
    ages = {"mine": 9, **{f"{age:016x}": age for age in range(7)}}
    for name, age in ages.items():
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    kernel_cache._prune_folders(tmp_path / f"{6:016x}")
    assert {folder.name for folder in tmp_path.iterdir()} == {f"{age:016x}" for age in (0, 1, 2, 3, 6)} | {"mine"}

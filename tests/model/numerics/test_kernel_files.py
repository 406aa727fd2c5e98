"""The files of compiled kernels: damaged, or in a folder that is open to others, they are not loaded."""

import errno
import os
import random
import shutil
import stat
import warnings
from pathlib import Path

import numba
import numpy as np
import pytest

from fastcoil.model.engine.emulator import emulate
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.model.engine.plant import step_numbers
from fastcoil.model.engine.rows import PARAMETER_ROWS
from fastcoil.model.numerics import kernel_cache
from fastcoil.model.numerics.jit import FLAGS
from fastcoil.model.numerics.kernel_cache import KernelCache, kernel_folder
from fastcoil.model.numerics.noise import low_pass

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def compiled():
    """Compiled kernels that are in the cache, a large one and two small ones."""
    compile_kernel()
    step_numbers(np.ones((len(PARAMETER_ROWS), 1)), np.ones(1), 0.0, np.empty(1), np.empty(1))
    low_pass(np.ones(3), 0.5, np.empty(3))
    return [emulate, step_numbers, low_pass]


@pytest.fixture
def folder(compiled, tmp_path):
    """A copy of the folder of these kernels, and of no others."""
    source = Path(low_pass.stats.cache_path)
    copy = tmp_path / "fastcoil" / "kernels" / source.name
    copy.mkdir(mode=0o700, parents=True)
    for kernel in compiled:
        (path,) = source.glob(f"*.{kernel.py_func.__name__}-*.nbc")
        shutil.copy(path, copy)
    return copy


def loads(kernel, folder):
    """Whether the kernel is found in a folder."""
    (signature,) = kernel.signatures
    return KernelCache(kernel.py_func, folder).load_overload(signature, kernel.targetctx) is not None


def stored(kernel, folder):
    """The file of a kernel."""
    (path,) = folder.glob(f"*.{kernel.py_func.__name__}-*.nbc")
    return path


def filter_from(folder):
    """Compile a small kernel, or load it from a folder, and keep it there.  Returns one number of it."""
    function = numba.njit(**FLAGS)(low_pass.py_func)
    function._cache = KernelCache(low_pass.py_func, folder)
    filtered = np.empty(3)
    function(np.ones(3), 0.5, filtered)
    return filtered[2]


@pytest.mark.parametrize("n", [30, pytest.param(2000, marks=pytest.mark.full)])
def test_no_kernel_with_a_flipped_bit_is_loaded(compiled, folder, n):
    dice = random.Random(n)
    for _ in range(n):
        kernel = dice.choice(compiled)
        path = stored(kernel, folder)
        sound = path.read_bytes()
        # headers and pickled names are short, and the machine code long
        position = dice.choice([dice.randrange(300), dice.randrange(len(sound))])
        damaged = bytearray(sound)
        damaged[position] ^= 1 << dice.randrange(8)
        path.write_bytes(damaged)
        assert not loads(kernel, folder), (kernel, position)
        path.write_bytes(sound)
    assert all(loads(kernel, folder) for kernel in compiled)


def test_a_kernel_under_the_name_of_another_or_from_another_folder_is_not_loaded(folder):
    shutil.copy(stored(emulate, folder), stored(low_pass, folder))
    assert not loads(low_pass, folder)
    other = folder.with_name("0" * 16)
    shutil.copytree(folder, other)
    assert loads(emulate, folder)
    assert not loads(emulate, other)


STRANGE = {
    "of another user": lambda path: os.chown(path, 12345, -1),
    "writable for the group": lambda path: path.chmod(0o660),
    "writable for all": lambda path: path.chmod(0o606),
}


@pytest.fixture
def warned():
    """Return a function that runs another and gives its result and its warnings, as in a new process."""

    def call(function, *words):
        kernel_cache._warn.cache_clear()
        kernel_folder.cache_clear()
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            return function(*words), [str(w.message) for w in found]

    yield call
    kernel_cache._warn.cache_clear()
    kernel_folder.cache_clear()


def make_strange(path, how):
    if how == "of another user" and os.geteuid() != 0:
        pytest.skip("only root can give files away")
    STRANGE[how](path)


@pytest.mark.parametrize("how", [*STRANGE, "link"])
def test_a_folder_that_another_may_write_to_is_not_used(folder, tmp_path, monkeypatch, warned, how):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert warned(kernel_folder, folder.name) == (folder, [])
    if how == "link":
        folder.rename(tmp_path / "elsewhere")
        folder.symlink_to(tmp_path / "elsewhere")
    else:
        make_strange(folder, how)
    found, (warning,) = warned(kernel_folder, folder.name)
    assert found is None
    assert warning.startswith(f"every process compiles the kernels again: {folder} ")
    assert warning.endswith(": remove it, or set XDG_CACHE_HOME to a folder of your own")
    assert len(list(folder.iterdir())) == 3


@pytest.mark.parametrize("level", [0, 1])
def test_a_folder_of_another_user_above_it_is_not_used(folder, tmp_path, monkeypatch, warned, level):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    make_strange(folder.parents[level], "of another user")
    assert warned(kernel_folder, folder.name)[0] is None
    assert warned(kernel_folder, "0" * 16)[0] is None
    assert [f.name for f in folder.parent.iterdir()] == [folder.name]


def test_what_is_made_is_private_whatever_the_umask(folder, tmp_path, monkeypatch, warned):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new"))
    before = os.umask(0)
    try:
        made, warnings_ = warned(kernel_folder, "0" * 16)
        filter_from(made)
    finally:
        os.umask(before)
    assert not warnings_
    assert loads(low_pass, made)
    assert {stat.S_IMODE(p.stat().st_mode) for p in (tmp_path / "new", *made.parents[:2], made)} == {0o700}
    assert [stat.S_IMODE(p.stat().st_mode) for p in made.iterdir()] == [0o600]


def test_a_relative_folder_is_no_place_for_a_cache(tmp_path, monkeypatch, warned):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    assert warned(kernel_folder, "0" * 16)[0] == tmp_path / "home" / ".cache" / "fastcoil" / "kernels" / ("0" * 16)
    monkeypatch.setenv("HOME", "home")
    found, (warning,) = warned(kernel_folder, "0" * 16)
    assert found is None
    assert "not known" in warning
    assert not (tmp_path / "cache").exists()


def test_a_full_disk_is_a_warning_and_leaves_nothing_half_written(folder, monkeypatch, warned):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    stored(low_pass, folder).unlink()
    monkeypatch.setattr(os, "replace", full)
    filtered, (warning,) = warned(filter_from, folder)
    assert filtered == 0.875
    assert "cannot be written (No space left on device): free some space, or set XDG_CACHE_HOME" in warning
    assert len(list(folder.iterdir())) == 2

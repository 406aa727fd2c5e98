"""The fingerprint of what kernels are made of."""

import shutil
from pathlib import Path

import pytest

import fastcoil
from fastcoil.model.numerics import jit

PACKAGE = Path(fastcoil.__file__).parent


@pytest.fixture
def package_copy(tmp_path, monkeypatch):
    """A copy of the package, whose sources are hashed instead of those of the package."""
    copy = tmp_path / "fastcoil"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(jit, "__file__", str(copy / "model" / "numerics" / "jit.py"))
    yield copy
    jit.model_sha256.cache_clear()
    jit.fingerprint.cache_clear()


def current_hashes():
    """The hash of the model and the fingerprint, computed again."""
    for function in (jit.model_sha256, jit.fingerprint):
        function.cache_clear()
    return jit.model_sha256(), jit.fingerprint()


TABLES = ["parameter_table.py", "parameters.toml", "metric_table.py", "outputs.toml"]  # their order is that of rows
PARTS = ["physics.py", "engine/rows.py", "estimators/learner.py", "numerics/jit.py", *TABLES]
OTHER_PARTS = ["numerics/kernel_cache.py", "../loops/simulate.py"]  # whether a kernel is compiled, not to what


@pytest.mark.parametrize(("part", "belongs"), [*((p, True) for p in PARTS), *((p, False) for p in OTHER_PARTS)])
def test_the_hashes_follow_what_kernels_are_made_of(package_copy, monkeypatch, part, belongs):
    model, fingerprint = current_hashes()
    assert (package_copy / "model" / part).exists()
    with (package_copy / "model" / part).open("a") as file:
        file.write("\n# changed\n")
    changed = current_hashes()
    assert (changed[0] != model, changed[1] != fingerprint) == (belongs, belongs)
    monkeypatch.setenv("NUMBA_OPT", "1")
    assert current_hashes()[0] == changed[0]
    assert current_hashes()[1] not in (fingerprint, changed[1])

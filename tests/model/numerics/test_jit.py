"""The fingerprint of what kernels are made of."""

import shutil
from pathlib import Path

import pytest

import fastcoil
from fastcoil.model.numerics import jit

PACKAGE = Path(fastcoil.__file__).parent


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A copy of the package, whose sources are hashed instead of those of the package."""
    copy = tmp_path / "fastcoil"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(jit, "__file__", str(copy / "model" / "numerics" / "jit.py"))
    yield copy
    jit.model_sha256.cache_clear()
    jit.fingerprint.cache_clear()


def hashes():
    """The hash of the model and the fingerprint, computed again."""
    for function in (jit.model_sha256, jit.fingerprint):
        function.cache_clear()
    return jit.model_sha256(), jit.fingerprint()


@pytest.mark.parametrize(
    ("part", "belongs"),
    [
        ("model/physics.py", True),
        ("model/engine/rows.py", True),
        ("model/numerics/jit.py", True),
        ("model/parameter_table.py", True),
        # decides whether a kernel is compiled, not to what
        ("model/numerics/kernel_cache.py", False),
        ("loops/simulate.py", False),
    ],
)
def test_the_hashes_follow_what_kernels_are_made_of(copied, monkeypatch, part, belongs):
    model, fingerprint = hashes()
    assert (copied / part).exists()
    with (copied / part).open("a") as file:
        file.write("\n# changed\n")
    changed = hashes()
    assert (changed[0] != model, changed[1] != fingerprint) == (belongs, belongs)
    monkeypatch.setenv("NUMBA_OPT", "1")
    assert hashes()[0] == changed[0]
    assert hashes()[1] not in (fingerprint, changed[1])


def test_an_estimator_decides_nothing_where_nobody_uses_it(copied):
    def of(*names):
        jit.model_sha256.cache_clear()
        return jit.model_sha256(frozenset(names))

    plain, learning = of("none"), of("none", "learner")
    assert len({plain, learning, of(*jit.SHIPPED)}) == 3
    assert of(*jit.SHIPPED) == hashes()[0]
    with (copied / "model" / "estimators" / "learner.py").open("a") as file:
        file.write("\n# changed\n")
    assert of("none") == plain
    assert of("none", "learner") != learning
    assert not jit.is_model(learning)
    assert jit.is_model(plain)

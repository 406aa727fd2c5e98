"""The names of ``fastcoil`` itself."""

import importlib.metadata
import subprocess
import sys

import fastcoil as fc


def test_the_version_is_that_of_the_installed_package():
    assert fc.__version__ == importlib.metadata.version("fastcoil")
    assert "__version__" in dir(fc)


def test_a_source_tree_that_is_not_installed_has_an_unknown_version(monkeypatch):
    from fastcoil import version

    def absent(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(version, "version", absent)
    assert version.package_version() == "unknown"


def test_presets_and_parameters_load_nothing_heavy():
    code = (
        "import sys, fastcoil as fc; fc.presets(); fc.parameters(); fc.__version__; "
        "sys.exit(str({'numba', 'numpy', 'xarray', 'scipy', 'matplotlib'} & set(sys.modules) or ''))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert done.stderr.strip() == ""

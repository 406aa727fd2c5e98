"""What a command loads while somebody waits, and that dask is known as soon as it is used."""

import os
import subprocess
import sys

import pytest
from helpers.processes import ROOT

SMALL = """
[loop]
[sweep]
backlash = [0.0, 0.07]
estimate_ratio = [0.0, 1.0]
[boundary]
hours = 0.25
[run]
warm_up = 60
"""
UNUSED = (
    "matplotlib", "PIL", "dask", "distributed", "scipy.signal", "scipy.stats", "scipy.optimize", "scipy.special",
    "scipy.linalg", "IPython", "jinja2", "panel", "bokeh", "fastcoil.measured.diagnosis",
    "fastcoil.measured.fit", "fastcoil.deliver.report", "fastcoil.deliver.export",
)  # fmt: skip
COMPILER = ("numba.np.arraymath", "numba.cpython.listobj", "numba.typed.typeddict")
"""Parts of Numba that compile, and that nothing needs that is compiled already."""


def loaded_by(folder, *command):
    """The modules that a command loads, in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    words = [sys.executable, "-X", "importtime", "-m", "fastcoil", *command]
    done = subprocess.run(words, env=environment, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    lines = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    return {line.rpartition("|")[2].strip() for line in lines}


def among(loaded, names):
    return sorted(name for name in loaded for other in names if f"{name}.".startswith(f"{other}."))


@pytest.mark.kernel
def test_what_is_compiled_is_run_without_the_compiler_dask_or_anything_that_draws(tmp_path):
    (tmp_path / "small.toml").write_text(SMALL)
    subprocess.run([sys.executable, "-m", "fastcoil", "plan", "small.toml"], cwd=tmp_path, check=True, timeout=300,
                   env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True)  # fmt: skip
    ran = loaded_by(tmp_path, "run", "small.toml", "--no-figures", "-o", "out")
    assert "netCDF4" in ran
    assert among(ran, UNUSED + COMPILER) == []
    assert among(loaded_by(tmp_path, "status", "out"), UNUSED + COMPILER) == []


def test_help_loads_no_library_that_computes(tmp_path):
    assert among(loaded_by(tmp_path, "run", "--help"), ("numpy", "numba", "xarray", "pandas", *UNUSED)) == []


WITH_DASK = """
import gc, sys
import click
from fastcoil.cli.quick_start import OWN_PROCESS, quick_start

with click.Context(click.Command("run"), obj=OWN_PROCESS):
    with quick_start():
        assert not gc.isenabled()
        import xarray as xr
assert gc.isenabled()
import numpy as np
ds = xr.Dataset({"a": ("x", [1.0, 2.0])}, coords={"x": [0, 1]})
assert float(ds["a"].where(ds["x"] > 0).sum()) == 2.0
assert ds["a"].chunks is None
assert "dask" not in sys.modules

import dask.array as da
masked = da.ma.masked_array(da.from_array(np.array([1.0, 2.0]), chunks=1), mask=[False, True])
assert np.isnan(xr.Variable("x", masked).values[1])
lazy = xr.DataArray(da.ones(4, chunks=2), dims="x")
assert lazy.chunks == ((2, 2),)
assert type(lazy.data) is da.Array
assert type((2.0 * lazy).load().data) is np.ndarray
assert "chunksize" in repr(lazy)
assert float(lazy.chunk(x=1).sum()) == 4.0
"""


def test_arrays_of_dask_are_known_once_it_is_imported(tmp_path):
    pytest.importorskip("dask.array")
    done = subprocess.run([sys.executable, "-c", WITH_DASK], env=os.environ | {"PYTHONPATH": str(ROOT)}, check=False,
                          cwd=tmp_path, capture_output=True, text=True, timeout=120)  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_a_process_that_is_more_than_a_command_is_left_as_it_is():
    import gc

    import click
    from xarray.namedarray import utils

    from fastcoil.cli.quick_start import quick_start

    before = utils.is_dask_collection
    with click.Context(click.Command("run")), quick_start():
        assert gc.isenabled()
    assert utils.is_dask_collection is before

"""What a command loads while somebody waits."""

import os
import re
import subprocess
import sys

import dask.array
import pytest
import xarray as xr
from helpers.commands import fastcoil
from helpers.processes import ROOT

from fastcoil.cli import terminal

SMALL_STUDY = """
[loop]
[sweep]
backlash = [0.0, 0.07]
estimate_ratio = [0.0, 1.0]
[boundary]
hours = 0.25
[run]
warm_up = 60
"""
UNUSED_MODULES = (
    "matplotlib", "PIL", "dask", "distributed", "scipy.signal", "scipy.stats", "scipy.optimize", "scipy.special",
    "scipy.linalg", "IPython", "jinja2", "panel", "bokeh", "tornado", "fastcoil.measured.diagnosis",
    "fastcoil.measured.fit", "fastcoil.deliver.report", "fastcoil.deliver.export",
)  # fmt: skip
COMPILER_MODULES = ("numba.np.arrayobj", "numba.np.arraymath", "numba.cpython.listobj", "numba.typed.typeddict")
"""Parts of Numba that compile, and that nothing needs that is compiled already."""


RUN_COMMANDS = """
import sys
from fastcoil.__main__ import run
for command in sys.argv[1:]:
    sys.argv[1:] = command.split()
    try:
        run()
    except SystemExit as end:
        assert not end.code, command
"""


def modules_loaded_by(folder, *commands):
    """The modules that commands load, one after the other, in a process of their own."""
    words = [sys.executable, "-X", "importtime", "-c", RUN_COMMANDS, *commands]
    options = {"env": os.environ | {"PYTHONPATH": str(ROOT)}, "cwd": folder, "timeout": 300}
    process = subprocess.run(words, capture_output=True, text=True, check=False, **options)
    assert process.returncode == 0, process.stderr[-2000:]
    lines = [line for line in process.stderr.splitlines() if line.startswith("import time:")]
    return {line.rpartition("|")[2].strip() for line in lines}


def modules_below(loaded, names):
    return sorted(name for name in loaded for package in names if f"{name}.".startswith(f"{package}."))


@pytest.mark.kernel
def test_what_is_compiled_is_run_without_the_compiler_or_anything_that_draws(tmp_path):
    (tmp_path / "small.toml").write_text(SMALL_STUDY)
    fastcoil("plan", tmp_path / "small.toml")  # what a study needs is compiled
    run = "run small.toml --no-figures -o out"
    loaded = modules_loaded_by(tmp_path, run, run, "status out", "plan small.toml")  # a new study, then a finished one
    assert "xarray" in loaded
    assert modules_below(loaded, UNUSED_MODULES + COMPILER_MODULES) == []


def test_help_loads_no_library_that_computes(tmp_path):
    computing_modules = ("numpy", "numba", "xarray", "pandas", "asyncio", *UNUSED_MODULES)
    assert modules_below(modules_loaded_by(tmp_path, "run --help"), computing_modules) == []


def test_arrays_of_dask_are_still_known_in_a_command():
    assert fastcoil("presets").exit_code == 0
    array = xr.DataArray(dask.array.arange(6, chunks=2), dims="x")
    assert array.chunks == ((2, 2, 2),)
    assert array.sum().values == 15


@pytest.mark.kernel
def test_compile_leaves_nothing_to_compile():
    assert fastcoil("compile").exit_code == 0
    result = fastcoil("compile")
    assert result.stdout.startswith("Nothing to compile: ")
    assert result.stderr == ""


COMPILING = "Compiling the simulation for this machine, once: "


@pytest.mark.parametrize(
    ("is_terminal", "text"),
    [(False, f"{COMPILING}about 12 s …\n"), (True, f"\r{COMPILING}3 of 5 …")],
)
def test_a_compilation_is_one_line_that_a_terminal_erases(is_terminal, text, monkeypatch, capsys):
    monkeypatch.setattr(terminal, "is_stderr_terminal", lambda: is_terminal)
    display = terminal.CompilationDisplay()
    display(3, 5)  # the check of a study, which may be refused
    display(5, 5)
    for _ in range(2):
        display(4, 40)
        display(40, 40)
    first, *others = re.split(r"\r {50,}\r", capsys.readouterr().err)
    assert first == text
    assert others == ([f"\r{COMPILING}4 of 40 …"] * 2 + [""] if is_terminal else [])

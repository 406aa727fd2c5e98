"""The names of ``fastcoil`` itself."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import fastcoil as fc
from fastcoil.base.machine import VERSION


def test_the_version_has_one_source():
    output = subprocess.check_output([sys.executable, "-m", "fastcoil", "--version"], text=True)
    assert output.split()[-1] == fc.__version__ == VERSION
    assert "__version__" in dir(fc)


def test_presets_and_parameters_load_nothing_heavy():
    code = (
        "import sys, fastcoil as fc; fc.presets(); fc.parameters(); fc.__version__; "
        "sys.exit(str({'numba', 'numpy', 'xarray', 'scipy', 'matplotlib'} & set(sys.modules) or ''))"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert process.stderr.strip() == ""


FORK_PROGRAM = """
import os, signal, sys, threading, time
import fastcoil as fc

loading = threading.Event()

class Slow:
    def find_spec(self, name, path=None, target=None):
        if name == "fastcoil.base.errors":
            loading.set()
            time.sleep(0.3)

sys.meta_path.insert(0, Slow())
threading.Thread(target=lambda: fc.InputError).start()
loading.wait()
child = os.fork()
if child == 0:
    signal.alarm(20)
    fc.InputError
    os._exit(0)
sys.exit(os.waitpid(child, 0)[1])
"""


def test_a_child_of_a_fork_can_load_what_another_thread_was_loading():
    assert subprocess.run([sys.executable, "-W", "ignore", "-c", FORK_PROGRAM], check=False, timeout=60).returncode == 0


def test_the_public_names_are_those_of_the_stub_for_type_checkers():
    statements = ast.parse(Path(fc.__file__).with_suffix(".pyi").read_text()).body
    imports = [statement for statement in statements if isinstance(statement, ast.ImportFrom)]
    imported = {alias.asname: node.module for node in imports for alias in node.names if alias.asname}
    assert len(imported) > 40
    assert set(fc.__all__) - imported.keys() == {"__version__", "parameters", "plot"}
    for name, module in imported.items():
        assert getattr(fc, name) is getattr(importlib.import_module(module), name)

"""The house rules that a machine can check: layers, one file of compiler flags, and loops that stay vectorised."""

import ast
import platform
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.numerics.jit import _FLAGS, JIT_ENABLED

PACKAGE = Path(fc.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))
LAYERS = [
    {"errors"},
    {"parameter_table", "outputs", "files"},
    {"numerics"},
    {"physics", "control"},
    {"engine"},
    {"arguments", "arrays"},
    {"moist_air"},
    {"logs"},
    {"boundary"},
    {"simulation"},
    {"plots"},
    {"analysis", "calibrate"},
    {"study"},
    {"paper"},
    {"cli"},
    {"__main__", "__init__"},
]
"""A module imports from its own package and from the layers above it in this list, never from below."""
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
COMPILED = {"numerics", "physics", "control", "engine"}
MOST_LINES = 300


def layer(path):
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(path):
    """Dotted names of all that a module imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def is_named(path):
    return str(path.relative_to(PACKAGE))


@pytest.mark.parametrize("path", MODULES, ids=is_named)
def test_nobody_imports_upward(path):
    for name in imports(path):
        package, _, rest = name.partition(".")
        if package == "fastcoil":
            other = rest.split(".")[0]
            assert other == layer(path) or RANK[other] < RANK[layer(path)], f"{is_named(path)} imports {name}"


@pytest.mark.parametrize("path", MODULES, ids=is_named)
def test_only_one_file_names_numba_and_no_compiled_one_names_xarray(path):
    roots = {name.split(".")[0] for name in imports(path)}
    assert not roots & {"numba", "llvmlite"} or is_named(path) == "numerics/jit.py"
    allowed = {"__future__", "collections", "typing", "math", "numpy", "fastcoil"}
    assert layer(path) not in COMPILED or roots <= allowed or is_named(path) == "numerics/jit.py"
    assert RANK[layer(path)] > 1 or roots <= sys.stdlib_module_names | {"fastcoil"}


@pytest.mark.parametrize("path", MODULES, ids=is_named)
def test_no_threads_no_fast_math_and_no_other_decorators(path):
    tree = ast.parse(path.read_text())
    names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    names |= {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    assert not names & {"prange", "objmode", "vectorize", "guvectorize", "jitclass", "stencil"}
    assert not names & {"njit", "jit", "intrinsic"} or is_named(path) == "numerics/jit.py"
    keywords = {node.arg for node in ast.walk(tree) if isinstance(node, ast.keyword)}
    assert not keywords & {"parallel", "forceobj", "boundscheck"}
    fast = [ast.unparse(n.value) for n in ast.walk(tree) if isinstance(n, ast.keyword) and n.arg == "fastmath"]
    assert not fast or (is_named(path) == "numerics/jit.py" and set(fast) == {"{'contract'}", "False"})


def test_flags_of_every_compiled_function():
    assert _FLAGS == {"error_model": "numpy", "nogil": True}


@pytest.mark.parametrize("path", MODULES, ids=is_named)
def test_no_module_is_too_long_to_be_read_at_one_sitting(path):
    assert len(path.read_text().splitlines()) <= MOST_LINES


@pytest.mark.parametrize("path", [p for p in MODULES if layer(p) in COMPILED], ids=is_named)
def test_every_compiled_function_is_documented(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef) and node.decorator_list and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{is_named(path)}: {node.name}"


def test_the_package_loads_nothing_until_asked():
    code = "import sys, fastcoil; print(*sys.modules)"
    root = {"PYTHONPATH": str(PACKAGE.parent), "PATH": ""}
    found = subprocess.run([sys.executable, "-c", code], env=root, capture_output=True, text=True, check=True)
    assert not {"numba", "numpy", "scipy", "xarray", "matplotlib"} & set(found.stdout.split())


# Machine code

ARITHMETIC = r"\tv?(?:add|sub|mul|div|sqrt|min|max|fn?m(?:add|sub)\d+)"


# Most scalar operations for each packed one: none in a loop over lanes of one array; ln m_a, taken out of its
# loop; and, where two arrays might overlap, the whole loop once more, which never runs.
SCALAR_SHARE = {
    "control": 0,
    "actuate": 0,
    "deliver": 0,
    "air_side": 0.3,
    "march_water": 1.1,
    "march_air": 1.1,
    "account_second": 1.1,
}


def assembly_of(name):
    """Assembly of one section, compiled alone with the flags of the kernel."""
    import numba
    from numba import types as T

    from fastcoil.engine import controller, metrics, plant

    f, i, b, A = T.float64, T.int64, T.boolean, T.Array(T.float64, 1, "C")
    section, signature = {
        "control": (controller.control, (A, i, f, f, b, f)),
        "actuate": (plant.actuate, (A, b)),
        "deliver": (plant.deliver, (A,)),
        "air_side": (plant.air_side, (A, f)),
        "march_water": (plant.march_water, (A, A, i)),
        "march_air": (plant.march_air, (A, A, i, b, b, f, f, f, b)),
        "account_second": (metrics.account_second, (A, A, i, f, f, i)),
    }[name]
    return next(iter(numba.njit(signature, **_FLAGS)(section.py_func).inspect_asm().values()))


@pytest.mark.kernel
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86-64 assembly")
@pytest.mark.parametrize("name", SCALAR_SHARE)
def test_sections_are_vectorised(name):
    import llvmlite.binding

    assembly = assembly_of(name)
    packed = re.findall(ARITHMETIC + r"pd\t.*", assembly)
    scalar = re.findall(ARITHMETIC + r"sd\t.*", assembly)
    assert len(packed) > 20
    assert len(scalar) <= SCALAR_SHARE[name] * len(packed)
    if llvmlite.binding.get_host_cpu_features().get("avx2"):
        assert sum("%ymm" in line or "%zmm" in line for line in packed) > 0.9 * len(packed)
    assert not re.search(r"\$_?(exp|log|pow|sin|cos|floor|fmod)\b", assembly)


@pytest.mark.kernel
def test_one_compiled_signature_serves_every_kind_of_run(short):
    from fastcoil.engine.emulator import emulate

    days = fc.paper_day(hours=0.1, seed=[1, 2])
    fc.simulate(fc.Loop(), short, warm_up=60)
    fc.simulate(fc.Loop(), days, warm_up=60, command=np.full((2, 360), 0.3), traces=["T_c", "wet_volumes"])
    fc.simulate(fc.Loop(noise_std=[0.0, 0.1], n_volumes=4), days, warm_up=0, seed=2**63 + 1, replicates=2)
    assert len(emulate.signatures) == 1


def test_the_interpreter_runs_the_same_formulas():
    from fastcoil.physics.valve import water_flow

    formula = water_flow.py_func if JIT_ENABLED else water_flow
    assert formula(0.5, 2.0, 0.7, 9.0, 0.38) == pytest.approx(water_flow(0.5, 2.0, 0.7, 9.0, 0.38), rel=1e-15)

"""The house rules: layers, no circles, one file that names the compiler's flags, short files, docstrings."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import fastcoil
from fastcoil.numerics.jit import FLAGS

PACKAGE = Path(fastcoil.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))
LAYERS = [
    {"printable"},
    {"errors"},
    {"parameter_table", "outputs", "files", "version"},
    {"arguments", "card", "memory", "look", "progress"},
    {"listing", "numerics", "told"},
    {"physics", "control"},
    {"estimators"},
    {"engine"},
    {"rules"},
    {"arrays", "result"},
    {"moist_air"},
    {"logs"},
    {"plots"},
    {"tables"},
    {"boundary"},
    {"simulation"},
    {"theory"},
    {"analysis", "calibrate", "diagnosis"},
    {"tuning", "explanation", "handover"},
    {"study"},
    {"paper"},
    {"plot", "reports", "explore"},
    {"cli"},
    {"__main__", "__init__"},
]
"""A module imports from its own package and from the layers above it in this list, never from below."""
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
COMPILED = {"numerics", "physics", "control", "estimators", "engine"}
NAME_NUMBA = ("numerics/jit.py", "numerics/kernel_cache.py", "numerics/own_code.py", "numerics/stages.py")
MOST_LINES = 300


def layer(path):
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


@cache
def nodes(path):
    """All nodes of a module's syntax tree."""
    return list(ast.walk(ast.parse(path.read_text())))


def imports(path):
    """Dotted names of all that a module imports, wherever in it."""
    found = set()
    for node in nodes(path):
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


def module_name(path):
    """Dotted name; that of a package for its __init__."""
    return ".".join(("fastcoil", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")


def circle(graph):
    """One circle of a graph, {module: those it imports}: each imports the next.  Empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1][::-1]
    return []


def test_no_circle_of_modules_inside_a_package_either():
    """Imports inside functions and those for the type checker alone count too."""
    names = {module_name(path) for path in MODULES}
    graph = {
        # what is imported is a module itself, or a name in one
        module_name(path): {name if name in names else name.rpartition(".")[0] for name in imports(path)} & names
        for path in MODULES
    }
    assert sum(map(len, graph.values())) > len(names)
    found = circle(graph)
    assert not found, " imports ".join(found)


def test_a_circle_is_found():
    found = circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})
    assert "".join(found) in ("abca", "bcab", "cabc")
    assert not circle({"a": {"b"}, "b": {"c"}, "d": {"a", "c"}})


@pytest.mark.parametrize("path", MODULES, ids=is_named)
def test_only_the_compiler_and_its_cache_name_numba_and_no_compiled_file_names_xarray(path):
    roots = {name.split(".")[0] for name in imports(path)}
    assert not roots & {"numba", "llvmlite"} or is_named(path) in NAME_NUMBA
    allowed = {"__future__", "collections", "dataclasses", "functools", "typing", "math", "numpy", "fastcoil"}
    assert layer(path) not in COMPILED or roots <= allowed or is_named(path) in NAME_NUMBA
    assert RANK[layer(path)] > 1 or roots <= sys.stdlib_module_names | {"fastcoil"}


@pytest.mark.parametrize("path", MODULES, ids=is_named)
def test_no_threads_no_fast_math_and_no_other_decorators(path):
    names = {node.id for node in nodes(path) if isinstance(node, ast.Name)}
    names |= {node.attr for node in nodes(path) if isinstance(node, ast.Attribute)}
    assert not names & {"prange", "objmode", "vectorize", "guvectorize", "jitclass", "stencil"}
    assert not names & {"njit", "jit", "intrinsic"} or is_named(path) in NAME_NUMBA
    keywords = {node.arg for node in nodes(path) if isinstance(node, ast.keyword)}
    assert not keywords & {"parallel", "forceobj", "boundscheck"}
    fast = [ast.unparse(n.value) for n in nodes(path) if isinstance(n, ast.keyword) and n.arg == "fastmath"]
    assert not fast or (is_named(path) == "numerics/jit.py" and set(fast) == {"{'contract'}", "False"})


def test_flags_of_every_compiled_function():
    assert FLAGS == {"error_model": "numpy", "nogil": True}


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


LOOK_THEMSELVES = {
    # each turns errors of the operating system into sentences itself, or into "no"
    "look.py", "files.py", "memory.py", "plots/files.py", "study/shipped.py", "study/folder/final.py",
    "study/folder/lock.py", "study/folder/shards.py", "simulation/stored_file.py", "cli/interrupts.py",
}  # fmt: skip


@pytest.mark.parametrize("path", MODULES, ids=is_named)
def test_only_few_files_ask_themselves_what_exists(path):
    asked = {node.attr for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Attribute)}
    assert not asked & {"exists", "is_file", "is_dir"} or is_named(path) in LOOK_THEMSELVES, "ask fastcoil.look"

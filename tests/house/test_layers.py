"""The house rules: subpackages in layers, no circles, one file that names the compiler's flags, docstrings."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import fastcoil
from fastcoil.model.numerics.jit import FLAGS

PACKAGE = Path(fastcoil.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))
LAYERS = ["base", "model", "logs", "loops", "design", "measured", "study", "deliver", "cli", "__main__", "__init__"]
"""A subpackage imports from itself and from those before it."""
INSIDE_MODEL = [
    ["parameter_table", "metric_table", "moist_air"],
    ["numerics"], ["physics", "control"], ["estimators"], ["valve_test"], ["engine"], ["user_rules"],
]  # fmt: skip
"""The same inside the model, where compiled code lies."""
COMPILED = {"numerics", "physics", "control", "valve_test", "estimators", "engine"}
NAME_NUMBA = {"jit.py", "kernel_cache.py", "compile_user_function.py", "stages.py"}
"""Files of model/numerics that may name the compiler."""
MOST_LINES = 500


@cache
def nodes(path):
    """All nodes of a module's syntax tree."""
    return list(ast.walk(ast.parse(path.read_text())))


@cache
def imports(path):
    """Dotted names of all that a module imports, wherever in it."""
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def place(path):
    """The parts of a module's path in the package, without suffix."""
    return path.relative_to(PACKAGE).with_suffix("").parts


def is_compiled(path):
    return place(path)[0] == "model" and place(path)[1] in COMPILED


def may_name_numba(path):
    return place(path)[:2] == ("model", "numerics") and path.name in NAME_NUMBA


def rank(parts, order):
    return next(k for k, names in enumerate(order) if parts[0] == names or parts[0] in names)


def test_no_room_imports_from_a_higher_one():
    upward = []
    for path in MODULES:
        own = place(path)
        for name in imports(path):
            other = tuple(name.split(".")[1:])
            if not name.startswith("fastcoil."):
                continue
            if other[0] != own[0]:
                wrong = LAYERS.index(other[0]) >= LAYERS.index(own[0])
            else:
                inside = own[0] == "model" and own[1] != other[1] and own[1] != "__init__"
                wrong = inside and rank(other[1:], INSIDE_MODEL) >= rank(own[1:], INSIDE_MODEL)
            upward += [f"{'/'.join(own)} imports {name}"] * wrong
    assert not upward


def module_name(path):
    """Dotted name; that of a package for its __init__."""
    return ".".join(("fastcoil", *place(path))).removesuffix(".__init__")


def circle(graph):
    """One circle of a graph, {module: those it imports}: each imports the next.  Empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1][::-1]
    return []


def test_no_circle_of_modules_inside_a_room():
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


def test_numba_is_named_in_the_compiler_files_alone_and_xarray_above_the_model_alone():
    allowed = {
        "__future__",
        "collections",
        "dataclasses",
        "functools",
        "importlib",
        "types",
        "typing",
        "math",
        "numpy",
        "fastcoil",
    }
    wrong = []
    for path in MODULES:
        roots = {name.split(".")[0] for name in imports(path)}
        foreign = roots & {"numba", "llvmlite"} and not may_name_numba(path)
        labelled = place(path)[0] in ("base", "model") and "xarray" in roots
        odd = is_compiled(path) and not roots <= allowed and not may_name_numba(path)
        wrong += ["/".join(place(path))] * bool(foreign or labelled or odd)
    assert not wrong


def test_no_threads_no_fast_math_and_no_other_decorators():
    for path in MODULES:
        where = "/".join(place(path))
        names = {node.id for node in nodes(path) if isinstance(node, ast.Name)}
        names |= {node.attr for node in nodes(path) if isinstance(node, ast.Attribute)}
        assert not names & {"prange", "objmode", "vectorize", "guvectorize", "jitclass", "stencil"}, where
        assert not names & {"njit", "jit", "intrinsic"} or may_name_numba(path), where
        keywords = {node.arg for node in nodes(path) if isinstance(node, ast.keyword)}
        assert not keywords & {"parallel", "forceobj", "boundscheck"}, where
        fast = [ast.unparse(n.value) for n in nodes(path) if isinstance(n, ast.keyword) and n.arg == "fastmath"]
        assert not fast or (path.name == "jit.py" and set(fast) == {"{'contract'}", "False"}), where


def test_flags_of_every_compiled_function():
    assert FLAGS == {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}


def test_every_module_can_be_read_at_one_sitting():
    assert not [path for path in MODULES if len(path.read_text().splitlines()) > MOST_LINES]


def test_every_compiled_function_is_documented():
    bare = [
        f"{'/'.join(place(path))}: {node.name}"
        for path in filter(is_compiled, MODULES)
        for node in nodes(path)
        if isinstance(node, ast.FunctionDef) and node.decorator_list and not node.name.startswith("_")
        if not ast.get_docstring(node)
    ]
    assert not bare


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, fastcoil; print(*sys.modules)"
    root = {"PYTHONPATH": str(PACKAGE.parent), "PATH": ""}
    found = subprocess.run([sys.executable, "-c", code], env=root, capture_output=True, text=True, check=True)
    assert not {"numba", "numpy", "scipy", "xarray", "matplotlib"} & set(found.stdout.split())

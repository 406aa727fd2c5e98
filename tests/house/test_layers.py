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
    ["parameter_table", "metric_table", "moist_air"], ["hunting"],
    ["numerics"], ["physics", "control"], ["estimators"], ["valve_test"], ["engine"], ["user_rules"],
]  # fmt: skip
"""The same inside the model, where compiled code lies."""
COMPILED_PARTS = {"numerics", "physics", "control", "valve_test", "estimators", "engine"}
MAY_NAME_NUMBA = {"__init__.py", "jit.py", "kernel_cache.py", "compile_user_function.py", "stages.py"}
"""Files of model/numerics that may name the compiler."""
MOST_LINES = 500


@cache
def nodes(path):
    """All nodes of a module's syntax tree."""
    return list(ast.walk(ast.parse(path.read_text())))


@cache
def imports(path):
    """Dotted names of all that a module imports, wherever in it."""
    names = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def module_parts(path):
    """The parts of a module's path in the package, without suffix."""
    return path.relative_to(PACKAGE).with_suffix("").parts


def is_compiled(path):
    return module_parts(path)[0] == "model" and module_parts(path)[1] in COMPILED_PARTS


def is_compiler_file(path):
    return module_parts(path)[:2] == ("model", "numerics") and path.name in MAY_NAME_NUMBA


def layer_index(parts, order):
    return next(k for k, names in enumerate(order) if parts[0] == names or parts[0] in names)


def test_no_room_imports_from_a_higher_one():
    upward = []
    for path in MODULES:
        parts = module_parts(path)
        for name in imports(path):
            imported_parts = tuple(name.split(".")[1:])
            if not name.startswith("fastcoil."):
                continue
            if imported_parts[0] != parts[0]:
                is_upward = LAYERS.index(imported_parts[0]) >= LAYERS.index(parts[0])
            else:
                inside = parts[0] == "model" and parts[1] != imported_parts[1] and parts[1] != "__init__"
                ranks = (layer_index(path_parts[1:], INSIDE_MODEL) for path_parts in (imported_parts, parts))
                is_upward = inside and next(ranks) >= next(ranks)
            upward += [f"{'/'.join(parts)} imports {name}"] * is_upward
    assert not upward


def module_name(path):
    """Dotted name; that of a package for its __init__."""
    return ".".join(("fastcoil", *module_parts(path))).removesuffix(".__init__")


def find_circle(graph):
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
    modules = find_circle(graph)
    assert not modules, " imports ".join(modules)


def test_a_circle_is_found():
    modules = find_circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})
    assert "".join(modules) in ("abca", "bcab", "cabc")
    assert not find_circle({"a": {"b"}, "b": {"c"}, "d": {"a", "c"}})


def test_numba_is_named_in_the_compiler_files_alone_and_xarray_above_the_model_alone():
    allowed = {"__future__", "collections", "dataclasses", "functools", "importlib", "types", "typing"}
    allowed |= {"math", "numpy", "fastcoil"}
    offenders = []
    for path in MODULES:
        roots = {name.split(".")[0] for name in imports(path)}
        foreign = roots & {"numba", "llvmlite"} and not is_compiler_file(path)
        labelled = module_parts(path)[0] in ("base", "model") and "xarray" in roots
        has_foreign_import = is_compiled(path) and not roots <= allowed and not is_compiler_file(path)
        offenders += ["/".join(module_parts(path))] * bool(foreign or labelled or has_foreign_import)
    assert not offenders


def test_no_threads_no_fast_math_and_no_other_decorators():
    for path in MODULES:
        where = "/".join(module_parts(path))
        names = {node.id for node in nodes(path) if isinstance(node, ast.Name)}
        names |= {node.attr for node in nodes(path) if isinstance(node, ast.Attribute)}
        assert not names & {"prange", "objmode", "vectorize", "guvectorize", "jitclass", "stencil"}, where
        assert not names & {"njit", "jit", "intrinsic"} or is_compiler_file(path), where
        keywords = {node.arg for node in nodes(path) if isinstance(node, ast.keyword)}
        assert not keywords & {"parallel", "forceobj", "boundscheck"}, where
        fast_math = {ast.unparse(n.value) for n in nodes(path) if isinstance(n, ast.keyword) and n.arg == "fastmath"}
        assert not fast_math or (path.name == "jit.py" and fast_math == {"{'contract'}", "False"}), where


def test_flags_of_every_compiled_function():
    assert FLAGS == {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}


def test_every_module_can_be_read_at_one_sitting():
    assert not [path for path in MODULES if len(path.read_text().splitlines()) > MOST_LINES]


def test_every_compiled_function_is_documented():
    undocumented = [
        f"{'/'.join(module_parts(path))}: {node.name}"
        for path in filter(is_compiled, MODULES)
        for node in nodes(path)
        if isinstance(node, ast.FunctionDef) and node.decorator_list and not node.name.startswith("_")
        if not ast.get_docstring(node)
    ]
    assert not undocumented


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, fastcoil; print(*sys.modules)"
    root = {"PYTHONPATH": str(PACKAGE.parent), "PATH": ""}
    process = subprocess.run([sys.executable, "-c", code], env=root, capture_output=True, text=True, check=True)
    assert not {"numba", "numpy", "scipy", "xarray", "matplotlib"} & set(process.stdout.split())

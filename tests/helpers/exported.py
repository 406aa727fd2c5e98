"""Run exported controllers in each of the three languages on their vectors."""

import csv
import importlib.util
import re
import shutil
import subprocess

import numpy as np
import pytest

from helpers.structured_text import Project

INPUT_COLUMNS = {"T_sup", "T_set", "m_a", "enabled", "start_test", "reset", "start_command"}
"""Columns of inputs; the others are the required answers."""
SWITCHES = ("enabled", "start_test", "reset")
COMPILER_FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off"]


def skip_without_compiler(language):
    """Skip a test of the exported C if there is no compiler."""
    if language == "c" and shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")


def read_vectors(path):
    """Read the rows of a file of vectors, numbers by name."""
    with path.open() as file:
        return [{n: float(x) for n, x in row.items()} for row in csv.DictReader(x for x in file if x[0] != "#")]


def load_module(path):
    """Load an exported Python file."""
    spec = importlib.util.spec_from_file_location("exported", path)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def python_runner(text):
    """Return a function that runs one cycle of the exported Python and returns its state."""
    names = {}
    exec(compile(text, "exported.py", "exec"), names)
    s = names["State"]()
    return lambda given: (names["step"](s, *given.values()), s)[1]


def structured_text_runner(text):
    """Return the same for an exported function block."""
    project = Project(text)
    block = project.block(next(unit.name for unit in project.units.values() if unit.name.startswith("fb_")))
    return lambda given: (block(**given), block)[1]


def differences(run, stored):
    """Yield the largest difference of each cycle from its vector."""
    for row in read_vectors(stored):
        inputs = {n: x > 0.5 if n in SWITCHES else x for n, x in row.items() if n in INPUT_COLUMNS}
        outputs = run(inputs | {"start_command": row.get("start_command", 0.0)})
        yield float(np.max([abs(getattr(outputs, n) - x) for n, x in row.items() if n not in INPUT_COLUMNS]))


def worst_in_python(code, stored):
    """Return the largest difference of the exported Python from its vectors."""
    return max(differences(python_runner(code.read_text()), stored))


def worst_in_c(code, stored):
    """Return the same for the exported C, compiled without a warning."""
    subprocess.run(["gcc", *COMPILER_FLAGS, "-DFASTCOIL_CHECK", code, "-lm", "-o", code.with_suffix("")], check=True)
    process = subprocess.run([code.with_suffix(""), stored], check=False, capture_output=True, text=True)
    worst = [float(x) for x in re.findall(r"largest difference (\S+)", process.stdout)]
    assert len(worst) == len(read_vectors(stored)[0].keys() - INPUT_COLUMNS)
    assert (process.returncode == 0) == (max(worst) <= 1e-12), process.stdout
    return max(worst)


def worst_in_structured_text(code, stored, program):
    """Return the same for the exported function block, by an interpreter; its program of checks must agree."""
    worst = max(differences(structured_text_runner(code.read_text()), stored))
    check = Project(code.read_text(), program.read_text()).block(f"{code.stem}_check")
    check()
    assert check.same == (check.largest <= 1e-12)
    assert check.largest <= worst
    return worst


def has_differences(run, stored):
    """Whether a controller differs from its vectors, or fails."""
    try:
        return any(not worst <= 1e-12 for worst in differences(run, stored))
    except (ArithmeticError, AttributeError):
        return True


WORST_DIFFERENCE = {"python": worst_in_python, "c": worst_in_c, "st": worst_in_structured_text}

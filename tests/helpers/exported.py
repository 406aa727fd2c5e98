"""Exported controllers, run in each of the three languages on their own vectors."""

import csv
import importlib.util
import re
import subprocess

from helpers.structured_text import Project

FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off"]


def vectors(path):
    """Rows of a file of vectors, numbers by name."""
    with path.open() as file:
        return [{n: float(x) for n, x in row.items()} for row in csv.DictReader(x for x in file if x[0] != "#")]


def module(path):
    """An exported Python file, loaded."""
    spec = importlib.util.spec_from_file_location("exported", path)
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def worst_in_python(code, stored, *, stops=False):
    """Largest difference of the exported Python from its vectors; the first that counts, if it is to stop there."""
    found, worst = module(code), 0.0
    s = found.State()
    for row in vectors(stored):
        given = [row[n] > 0.5 if n in ("enabled", "reset") else row[n] for n in inputs_of(row)]
        found.step(s, *given, 0.0)
        worst = max([worst, *(abs(getattr(s, n) - row[n]) for n in outputs_of(row))])
        if stops and worst > 1e-12:
            break
    return worst


def worst_in_c(code, stored):
    """The same of the exported C, compiled without a warning."""
    subprocess.run(["gcc", *FLAGS, "-DFASTCOIL_CHECK", code, "-lm", "-o", code.with_suffix("")], check=True)
    done = subprocess.run([code.with_suffix(""), stored], check=False, capture_output=True, text=True)
    worst = [float(x) for x in re.findall(r"largest difference (\S+)", done.stdout)]
    assert len(worst) == len(outputs_of(vectors(stored)[0]))
    assert (done.returncode == 0) == (max(worst) <= 1e-12), done.stdout
    return max(worst)


def worst_in_structured_text(code, stored, program):
    """The same of the exported function block, by an interpreter; its program of checks must agree."""
    project = Project(code.read_text(), program.read_text())
    block, worst = project.block(f"FB_{code.stem}"), 0.0
    for row in vectors(stored):
        given = {n: row[n] > 0.5 if n in ("enabled", "reset") else row[n] for n in inputs_of(row)}
        block(**given, start_command=0.0)
        worst = max([worst, *(abs(getattr(block, n) - row[n]) for n in outputs_of(row))])
    check = project.block(f"{code.stem}_check")
    check()
    assert check.same == (check.largest <= 1e-12)
    assert check.largest <= worst
    return worst


def inputs_of(row):
    """Names of what a controller is given."""
    return [n for n in ("T_sup", "T_set", "m_a", "enabled", "reset") if n in row]


def outputs_of(row):
    """Names of what it must answer."""
    return [n for n in row if n not in inputs_of(row)]


WORST = {"python": worst_in_python, "c": worst_in_c, "st": worst_in_structured_text}

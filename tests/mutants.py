"""Break the code on purpose, one small change at a time, and report which changes no test notices.

    python tests/mutants.py                  # 60 changes, seed 1, two at a time: takes hours
    python tests/mutants.py --seed 2 -n 10   # ten others
    python tests/mutants.py --show           # lists the changes without running a test

A change is a comparison turned round, a number tripled, a sign flipped, ``min`` and ``max`` exchanged or ``and`` and
``or``, at a place drawn at random over ``ROOMS``.  Each is tried in a copy of the tree.  A first round runs the tests
that name its module or function, a second, for changes not caught by then, those of its subpackage, a third those of
the subpackages that use it.  At the end the tests that failed run without a change: one that fails there too has caught
nothing.  What survives needs a test, is dead code, or belongs into ``EQUIVALENT``.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("model", "loops", "logs", "measured", "study")
TESTS_AFTER = {
    "model": ["tests/loops", "tests/design", "tests/measured"],
    "loops": ["tests/study", "tests/model/engine", "tests/cli"],
    "logs": ["tests/measured", "tests/loops", "tests/cli"],
    "measured": ["tests/cli", "tests/deliver/report"],
    "study": ["tests/cli", "tests/deliver/report"],
}
"""Tests to run after those of the subpackage itself, which use it."""
NEGATED = {ast.Lt: ">=", ast.LtE: ">", ast.Gt: "<=", ast.GtE: "<", ast.Eq: "!=", ast.NotEq: "=="}
SIGNS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
EXCHANGED = {"min": "max", "max": "min"}
DRAWS = ("plot", "draw", "figure", "axes", "html")  # functions that draw: looked at with the eye, not by these tests
MESSAGES = ("warn", "problem", "add_problem")  # calls whose arguments are words
EQUIVALENT = {}
"""Changed lines that compute the same, and why; not drawn."""
MOST_NAMED = 8  # test files that run first
TIMEOUT = 1800  # s for the tests of one change in one round
TEST_TIMEOUT = 120  # s for one test, against a loop without end


class Place(ast.NodeVisitor):
    """Collects ``(line, column, end column, new text, what)`` of every change that a file allows."""

    def __init__(self, source):
        self.lines = source.split("\n")
        self.changes = []
        self.visit(ast.parse(source))

    def add(self, node, new, what):
        """A node on one line is replaced by ``new``."""
        line = self.lines[node.lineno - 1]
        if node.lineno == node.end_lineno and line.isascii():
            self.changes.append((node.lineno, node.col_offset, node.end_col_offset, new, what))

    def add_operator(self, left, right, old, new, what):
        """The operator between two nodes on one line is replaced."""
        line = self.lines[left.end_lineno - 1]
        at = line.find(old, left.end_col_offset)
        if left.end_lineno == right.lineno and line.isascii() and left.end_col_offset <= at < right.col_offset:
            self.changes.append((left.end_lineno, at, at + len(old), new, what))

    def visit_FunctionDef(self, node):
        if not any(word in node.name.lower() for word in DRAWS) and not returns_only_words(node):
            for part in node.body:  # neither defaults nor decorators
                self.visit(part)

    def visit_If(self, node):
        if ast.unparse(node.test) != "TYPE_CHECKING":
            self.generic_visit(node)

    def visit_JoinedStr(self, node):
        """What a message shows is not computed with."""

    def visit_Raise(self, node):
        """Nor is the message of an error."""

    def visit_AnnAssign(self, node):
        if node.value is not None:
            self.visit(node.value)

    def visit_Subscript(self, node):
        self.visit(node.value)  # an index is no threshold

    def visit_Compare(self, node):
        if len(node.ops) == 1 and type(node.ops[0]) in NEGATED:
            old = ast.unparse(ast.Compare(ast.Name("a"), node.ops, [ast.Name("b")])).split()[1]
            self.add_operator(node.left, node.comparators[0], old, NEGATED[type(node.ops[0])], "comparison")
        self.generic_visit(node)

    def visit_BinOp(self, node):
        if type(node.op) in SIGNS:
            old = ast.unparse(ast.BinOp(ast.Name("a"), node.op, ast.Name("b"))).split()[1]
            self.add_operator(node.left, node.right, old, SIGNS[type(node.op)], "sign")
        self.generic_visit(node)

    def visit_UnaryOp(self, node):
        if isinstance(node.op, (ast.USub, ast.Not)):
            self.add(node, f"({ast.unparse(node.operand)})", "sign")
        self.generic_visit(node)

    def visit_BoolOp(self, node):
        old = "and" if isinstance(node.op, ast.And) else "or"
        self.add_operator(node.values[0], node.values[1], old, {"and": "or", "or": "and"}[old], "and, or")
        self.generic_visit(node)

    def visit_Call(self, node):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in EXCHANGED and len(node.args) > 1:
            self.add(node.func, ast.unparse(node.func).replace(name, EXCHANGED[name]), "clamp")
        if name not in MESSAGES:
            self.generic_visit(node)

    def visit_Constant(self, node):
        if isinstance(node.value, (int, float)) and not isinstance(node.value, bool) and node.value not in (0, 1, -1):
            self.add(node, repr(3 * node.value), "number")


def returns_only_words(function):
    """Whether all that a function returns is text for a reader."""
    values = [node.value for node in ast.walk(function) if isinstance(node, ast.Return)]
    texts = [value for value in values if isinstance(value, ast.JoinedStr)]
    return bool(texts) and all(isinstance(value, (ast.JoinedStr, ast.Constant)) for value in values)


def draw(n, seed):
    """``n`` changes, each room and each kind as often as the others where the code allows."""
    chance = random.Random(seed)
    drawn = []
    while len(drawn) < n:
        room = ROOMS[len(drawn) % len(ROOMS)]
        path = chance.choice(sorted((ROOT / "fastcoil" / room).rglob("*.py")))
        source = path.read_text(encoding="utf-8")
        by_kind = {}
        for change in Place(source).changes:
            if mutated(source, change).split("\n")[change[0] - 1].strip() not in EQUIVALENT:
                by_kind.setdefault(change[-1], []).append(change)
        if by_kind:
            kind = chance.choice(sorted(by_kind))
            change = (room, path.relative_to(ROOT), chance.choice(by_kind[kind]))
            drawn += [change] * (change not in drawn)
    return drawn


def mutated(source, change):
    """The source with one change."""
    line, start, end, new, _ = change
    lines = source.split("\n")
    lines[line - 1] = lines[line - 1][:start] + new + lines[line - 1][end:]
    return "\n".join(lines)


def enclosing_names(source, line):
    """The functions and classes that contain a line, and the constant that it defines."""
    nodes = (node for node in ast.walk(ast.parse(source)) if node.__dict__.get("lineno", line + 1) <= line)
    names = []
    for node in nodes:
        if line <= node.end_lineno:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                names.append(node.name)
            elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                names += [node.targets[0].id] * node.targets[0].id.isupper()
    return names


def named_tests(room, path, names):
    """The test files that name the module or a function, those of the subpackage first, then by how often."""
    module = re.compile(rf"\b{re.escape('.'.join(path.with_suffix('').parts))}\b|\b{path.stem} import\b")
    function = re.compile(rf"\b({'|'.join(names)})\b") if names else None
    ranked = []
    for file in sorted((ROOT / "tests").rglob("test_*.py")):
        text = file.read_text(encoding="utf-8")
        parts = file.relative_to(ROOT / "tests").parts
        n = 5 * (file.stem == f"test_{path.stem}") + 3 * len(module.findall(text))
        n += len(function.findall(text)) if function else 0
        if n and parts[0] not in ("docs", "gates", "house", "notebooks", "studies"):
            ranked.append((parts[0] != room, -n, file.relative_to(ROOT).as_posix()))
    return [file for *_, file in sorted(ranked)[:MOST_NAMED]]


def run_tests(tree, cache, *tests):
    """Run tests: None if they all pass, else the first that fails."""
    environment = os.environ | {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(cache)}
    options = ["-x", "-q", "--no-header", "-p", "no:cacheprovider", "-o", f"timeout={TEST_TIMEOUT}", "-m", "not alone"]
    command = [sys.executable, "-m", "pytest", *options, *tests]
    try:
        run = subprocess.run(  # noqa: PLW1510
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=TIMEOUT
        )
    except subprocess.TimeoutExpired:
        return f"{tests[0]}: no end after {TIMEOUT} s"
    if run.returncode in (0, 5):  # 5: no tests
        return None
    failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", run.stdout, re.MULTILINE)
    return failed[1] if failed else f"{tests[0]}: exit {run.returncode}"


def try_change(tree, cache, drawn, round_number):
    """Run the tests of one round against one change: None if they all pass, else the first that fails."""
    room, path, change = drawn
    source = (ROOT / path).read_text(encoding="utf-8")
    named = named_tests(room, path, enclosing_names(source, change[0]))
    ignored = [f"--ignore={file}" for file in named]
    tests = (named, [f"tests/{room}", *ignored], [*TESTS_AFTER[room], *ignored])[round_number]
    if not tests:
        return None
    (tree / path).write_text(mutated(source, change), encoding="utf-8")
    try:
        return run_tests(tree, cache, *tests)
    finally:
        (tree / path).write_text(source, encoding="utf-8")


def failing_anyway(tree, cache, tests):
    """Those of the tests that fail without a change too."""
    if not tests or run_tests(tree, cache, *tests) is None:
        return []
    return [test for test in tests if run_tests(tree, cache, test)]


def show(path, change):
    """One change as a line of text."""
    line = (ROOT / path).read_text(encoding="utf-8").split("\n")[change[0] - 1]
    new = mutated(line, (1, *change[1:]))
    return f"{path}:{change[0]} ({change[-1]})\n    - {line.strip()}\n    + {new.strip()}"


def main():
    """Try the changes and print what survived."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-n", type=int, default=60, help="how many changes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--show", action="store_true", help="list the changes only")
    options = parser.parse_args()
    drawn = draw(options.n, options.seed)
    if options.show:
        for _, path, change in drawn:
            print(show(path, change))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        lanes = [(Path(folder, f"tree{k}"), Path(folder, f"cache{k}")) for k in range(2)]
        for tree, _ in lanes:
            ignored = shutil.ignore_patterns(".git", ".venv*", "results", "build", "__pycache__")
            shutil.copytree(ROOT, tree, ignore=ignored)
        caught_by = dict.fromkeys(range(len(drawn)))

        def try_changes(lane, queue, round_number):
            while queue:
                k = queue.popleft()
                began = time.monotonic()
                caught_by[k] = try_change(*lane, drawn[k], round_number)
                seconds = time.monotonic() - began
                outcome = f"{caught_by[k] or 'not caught'} ({seconds:.0f} s)"
                print(f"{k + 1:3d} {show(*drawn[k][1:])}\n    {outcome}", flush=True)

        for round_number in range(3):
            left = [k for k, test in caught_by.items() if test is None]
            print(f"round {round_number + 1}: {len(left)} changes", flush=True)
            queue = deque(left)
            with ThreadPoolExecutor(2) as pool:
                list(pool.map(lambda lane: try_changes(lane, queue, round_number), lanes))  # noqa: B023
        tests = {test for test in caught_by.values() if test and "::" in test}
        for test in failing_anyway(*lanes[0], sorted(tests)):
            changes = [k + 1 for k in caught_by if caught_by[k] == test]
            print(f"{test} fails without a change too: not caught {changes}")
            caught_by |= {k - 1: None for k in changes}
    n_caught = sum(test is not None for test in caught_by.values())
    for k in (k for k, test in caught_by.items() if test is None):
        print(f"SURVIVED {k + 1} {show(*drawn[k][1:])}")
    print(f"{n_caught} of {len(drawn)} changes caught")
    return n_caught < len(drawn)


if __name__ == "__main__":
    sys.exit(main())

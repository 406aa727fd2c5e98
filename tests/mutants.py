"""Break the code on purpose, one small change at a time, and report which changes no test notices.

    python tests/mutants.py                  # 60 changes, seed 1, two at a time: about an hour on two cores
    python tests/mutants.py --seed 2 -n 10   # ten others
    python tests/mutants.py --show           # lists the changes without running a test

A change is a comparison turned round, a number tripled, a sign flipped, ``min`` and ``max`` exchanged or ``and`` and
``or``, at a place drawn at random over ``ROOMS``.  Each is tried in a copy of the tree: the tests of its own subpackage run
first, until one fails, then those of the subpackages that use it.  What survives needs a test, or is dead code.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
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
TIMEOUT = 900  # s for the tests of one change


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
        if not any(word in node.name.lower() for word in DRAWS):
            for part in node.body:  # neither defaults nor decorators
                self.visit(part)

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
        self.generic_visit(node)

    def visit_Constant(self, node):
        if isinstance(node.value, (int, float)) and not isinstance(node.value, bool) and node.value not in (0, 1, -1):
            self.add(node, repr(3 * node.value), "number")


def draw(n, seed):
    """``n`` changes, each room and each kind as often as the others where the code allows."""
    chance = random.Random(seed)
    drawn = []
    while len(drawn) < n:
        room = ROOMS[len(drawn) % len(ROOMS)]
        path = chance.choice(sorted((ROOT / "fastcoil" / room).rglob("*.py")))
        by_kind = {}
        for change in Place(path.read_text(encoding="utf-8")).changes:
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


def own_tests(room, path):
    """The folder or file of the tests of a source file, as near to it as there is one."""
    inside = path.relative_to("fastcoil").with_suffix("").parts
    found = [f"tests/{'/'.join(inside[:k])}" for k in range(len(inside), 0, -1)]
    return list(dict.fromkeys(p for p in found if (ROOT / p).is_dir())) or [f"tests/{room}"]


def try_change(k, drawn, copies):
    """Run the tests against one change: None if they all pass, else the first that fails."""
    room, path, change = drawn
    tree = copies / str(k % 2)
    source = (ROOT / path).read_text(encoding="utf-8")
    (tree / path).write_text(mutated(source, change), encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(copies / f"cache{k % 2}")}
    try:
        for tests in [*own_tests(room, path), *TESTS_AFTER[room]]:
            command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider", tests]
            try:
                run = subprocess.run(
                    command, cwd=tree, env=environment, capture_output=True, text=True, timeout=TIMEOUT
                )
            except subprocess.TimeoutExpired:
                return f"{tests}: no end after {TIMEOUT} s"
            if run.returncode == 1 or run.returncode > 2:
                failed = [line for line in run.stdout.split("\n") if line.startswith(("FAILED", "ERROR"))]
                return failed[0][:120] if failed else f"{tests}: exit {run.returncode}"
            if run.returncode == 2:
                return f"{tests}: cannot be collected"
        return None
    finally:
        (tree / path).write_text(source, encoding="utf-8")


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
    survived = []
    with tempfile.TemporaryDirectory() as folder:
        copies = Path(folder)
        for k in range(2):
            ignored = shutil.ignore_patterns(".git", ".venv*", "results", "build", "__pycache__")
            shutil.copytree(ROOT, copies / str(k), ignore=ignored)

        def lane(first):
            for k in range(first, len(drawn), 2):
                began = time.monotonic()
                caught = try_change(k, drawn[k], copies)
                if caught is None:
                    survived.append(k)
                print(f"{k + 1:3d} {show(*drawn[k][1:])}\n    {caught or 'SURVIVED'} ({time.monotonic() - began:.0f} s)",
                      flush=True)  # fmt: skip

        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lane, range(2)))
    print(f"{len(drawn) - len(survived)} of {len(drawn)} changes caught")
    return bool(survived)


if __name__ == "__main__":
    sys.exit(main())

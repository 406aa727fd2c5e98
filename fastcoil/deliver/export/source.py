"""The rendered laws, taken apart: constants, state and functions, with the comments that belong to each."""

from __future__ import annotations

import ast
import io
import tokenize
from dataclasses import dataclass

KINDS = {"float": "real", "bool": "flag", "int": "whole", "None": ""}
"""Types of the laws: every number is a double but for the counters of loops."""


@dataclass(frozen=True)
class Constant:
    """A named number, or a table of numbers."""

    name: str
    value: float | int | list[float]
    line: int

    @property
    def kind(self) -> str:
        return "whole" if isinstance(self.value, int) else "real"


@dataclass(frozen=True)
class Field:
    """Something that the state holds; sizes: names of constants or numbers, for an array."""

    name: str
    kind: str
    sizes: tuple[str, ...]
    line: int


@dataclass(frozen=True)
class Function:
    """A function of numbers, or a section: one that works on the state, given first."""

    name: str
    arguments: dict[str, str]
    returns: str
    text: str
    body: list[ast.stmt]
    is_section: bool
    lines: dict[str, int]
    """Where each argument stands."""


class Laws:
    """What the text of the laws holds."""

    def __init__(self, text: str) -> None:
        tree = ast.parse(text)
        self.text = ast.get_docstring(tree) or ""
        self.constants: list[Constant] = []
        self.functions: dict[str, Function] = {}
        self.lines = text.splitlines()
        self._comments = {
            token.start[0]: token.string.removeprefix("#").strip()
            for token in tokenize.generate_tokens(io.StringIO(text).readline)
            if token.type == tokenize.COMMENT
        }
        fields: list[ast.AnnAssign] = []
        for node in tree.body:
            if isinstance(node, ast.Assign):
                name = ast.unparse(node.targets[0])
                self.constants.append(Constant(name, ast.literal_eval(node.value), node.lineno))
            elif isinstance(node, ast.ClassDef):
                self.state_text = ast.get_docstring(node) or ""
                fields = [one for one in node.body if isinstance(one, ast.AnnAssign)]
            elif isinstance(node, ast.FunctionDef):
                self.functions[node.name] = _function(node)
        sizes = _sizes(self.functions["start"])
        self.fields = [
            Field(name, KINDS.get(ast.unparse(one.annotation), "real"), sizes.get(name, ()), one.lineno)
            for one in fields
            for name in [ast.unparse(one.target)]
        ]

        self.kinds = {one.name: one.kind for one in self.constants}
        self.kinds |= {f"s.{one.name}": one.kind for one in self.fields}
        self.kinds |= {one.name: one.returns for one in self.functions.values()}

    def comment(self, line: int) -> str:
        """What is said behind the code of a line."""
        return self._comments.get(line, "") if self.lines[line - 1].strip()[:1] != "#" else ""

    def above(self, line: int) -> list[str]:
        """The comments right above a line, each a line of its own."""
        found: list[str] = []
        while line > 1 and self.lines[line - 2].strip().startswith("#"):
            line -= 1
            found.insert(0, self._comments[line])
        return found

    def has_gap(self, line: int) -> bool:
        """Whether an empty line stands before a line and the comments above it."""
        line -= len(self.above(line))
        return line > 1 and not self.lines[line - 2].strip()


def is_elif(node: ast.If, laws: Laws) -> bool:
    """Whether what stands in the else of a condition is one ``elif``."""
    return laws.lines[node.orelse[0].lineno - 1].lstrip().startswith("elif")


def counted(call: ast.Call) -> tuple[ast.expr, ast.expr, bool]:
    """First value of a range, the one behind the last, and whether it counts down."""
    given = call.args
    low = given[0] if len(given) > 1 else ast.Constant(0)
    return low, given[min(len(given), 2) - 1], len(given) > 2


def aligned(rows: list[tuple[str, str]], width: int = 116) -> list[str]:
    """Code and what is said of it: below one another behind the code, or above it where a line is too short."""
    column = max((len(code) for code, said in rows if said and "\n" not in code), default=0)
    lines = []
    for code, said in rows:
        indent = code[: len(code) - len(code.lstrip())]
        beside = f"{code:<{min(column, 56)}}  {said}"
        fits = len(beside) <= width and "\n" not in code
        lines += [beside] if said and fits else [*([indent + said] if said else []), code]
    return lines


def _function(node: ast.FunctionDef) -> Function:
    kinds = {one.arg: ast.unparse(one.annotation or ast.Name("float")) for one in node.args.args}
    is_section = "State" in kinds.values()
    return Function(
        node.name,
        {name: KINDS[kind] for name, kind in kinds.items() if kind != "State"},
        KINDS[ast.unparse(node.returns or ast.Name("None"))],
        ast.get_docstring(node) or "",
        node.body[1:],  # behind its text
        is_section,
        {one.arg: one.lineno for one in node.args.args},
    )


def _sizes(start: Function) -> dict[str, tuple[str, ...]]:
    """Arrays of the state by name, from ``s.name = zeros(sizes)`` where it starts."""
    return {
        one.targets[0].attr: tuple(map(ast.unparse, one.value.args))
        for one in start.body
        if isinstance(one, ast.Assign) and isinstance(one.value, ast.Call) and isinstance(one.targets[0], ast.Attribute)
        if ast.unparse(one.value.func) == "zeros"
    }

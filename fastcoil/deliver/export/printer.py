"""Statements and expressions of the laws, said in C or Structured Text."""

from __future__ import annotations

import ast
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping

from fastcoil.deliver.export.source import Function, Laws
from fastcoil.deliver.export.words import WIDTH, broken

_LEVEL = {"or": 1, "and": 2, "compare": 4, "sum": 5, "product": 6, "unary": 7, "whole": 8}
"""How tightly an operator binds, in both languages."""
_SIGNS: Mapping[type, tuple[str, str]] = {
    ast.Add: ("+", "sum"), ast.Sub: ("-", "sum"), ast.Mult: ("*", "product"), ast.Div: ("/", "product"),
    ast.Lt: ("<", "compare"), ast.LtE: ("<=", "compare"), ast.Gt: (">", "compare"), ast.GtE: (">=", "compare"),
    ast.Eq: ("==", "compare"), ast.NotEq: ("!=", "compare"), ast.And: ("and", "and"), ast.Or: ("or", "or"),
}  # fmt: skip


class Printer(ABC):
    """What the languages share; each says its own words.

    WORDS: of operators, of True and False, and of the parts of a statement, with {} for what is in them.  FUNCTIONS:
    their names by those of Python.  BREAKS: where a line may end.
    """

    WORDS: Mapping[str, str]
    FUNCTIONS: Mapping[str, str]
    BREAKS: str
    TYPES: Mapping[str, str]

    def __init__(self, laws: Laws) -> None:
        self.laws = laws
        self.functions = dict(self.FUNCTIONS)

    @abstractmethod
    def state(self, field: str) -> str:
        """A field of the state."""

    @abstractmethod
    def index(self, indices: list[str]) -> str:
        """Some subscripts."""

    @abstractmethod
    def number(self, value: float) -> str:
        """A real number."""

    @abstractmethod
    def comment(self, text: str) -> str:
        """A comment of one line, or of several."""

    @abstractmethod
    def call(self, function: Function, given: list[ast.expr]) -> list[str]:
        """The call of a function that works on the state."""

    @abstractmethod
    def zeros(self, target: str, sizes: list[ast.expr]) -> list[str]:
        """An array filled with zeros."""

    @abstractmethod
    def loop(self, i: str, ends: tuple[ast.expr, ast.expr, bool]) -> tuple[str, str]:
        """Head and end of a loop from a number to the one before another, or down."""

    def constant(self, value: object) -> str:
        """A number or a truth."""
        if isinstance(value, bool):
            return self.WORDS[str(value)]
        return self.number(value) if isinstance(value, float) else str(value)

    def say(self, node: ast.expr, around: str = "or") -> str:
        """An expression inside one that binds like ``around``."""
        text, level = self._said(node)
        return f"({text})" if _LEVEL[level] < _LEVEL[around] else text

    def _said(self, node: ast.expr) -> tuple[str, str]:  # noqa: PLR0911 — one for each kind
        if isinstance(node, ast.BinOp):
            sign, level = _SIGNS[type(node.op)]
            # what stands on the right is grouped first, or the rounding would be another
            right = {"sum": "product", "product": "unary"}[level]
            return f"{self.say(node.left, level)} {sign} {self.say(node.right, right)}", level
        if isinstance(node, ast.BoolOp):
            sign, level = _SIGNS[type(node.op)]
            # a comparison among conditions is grouped where the language needs it
            parts = [self.say(one, "sum" if "group" in self.WORDS else "compare") for one in node.values]
            return f" {self.WORDS[sign]} ".join(parts), level
        if isinstance(node, ast.Compare):
            sign, level = _SIGNS[type(node.ops[0])]
            sides = (self.say(one, "sum") for one in (node.left, node.comparators[0]))
            return f" {self.WORDS.get(sign, sign)} ".join(sides), level
        if isinstance(node, ast.UnaryOp):
            sign = self.WORDS["not"] if isinstance(node.op, ast.Not) else "-"
            return f"{sign}{self.say(node.operand, 'unary')}", "unary"
        if isinstance(node, ast.Constant):
            return self.constant(node.value), "whole"
        if isinstance(node, ast.Name):
            return node.id, "whole"
        if isinstance(node, ast.Attribute):
            return self.state(node.attr), "whole"
        if isinstance(node, ast.Subscript):
            return self.say(node.value) + self.index([self.say(node.slice)]), "whole"
        if isinstance(node, ast.Call):
            return f"{self.functions[ast.unparse(node.func)]}({', '.join(map(self.say, node.args))})", "whole"
        raise TypeError(f"the laws have no {ast.unparse(node)}")

    def block(self, body: list[ast.stmt], depth: int) -> list[str]:
        """Statements as lines, with what is said of them."""
        lines: list[str] = []
        indent = "    " * depth
        for k, node in enumerate(body):
            said = self.laws.comment(node.lineno)
            lines += [""] if k and lines[-1] and self.laws.has_gap(node.lineno) else []
            lines += [indent + self.comment(one) for one in self.laws.above(node.lineno)]
            first, *rest = self._statement(node, depth)
            beside = f"{indent}{first}  {self.comment(said)}" if said else indent + first
            if len(beside) > WIDTH and said:
                lines, beside = [*lines, indent + self.comment(said)], indent + first
            lines += [*broken(beside, self.BREAKS), *rest]
        return lines

    def _statement(self, node: ast.stmt, depth: int) -> list[str]:
        """A statement, its first line without indentation."""
        words, say, indent = self.WORDS, self.say, "    " * depth
        found: list[str] = []
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call) and _name(node.value) == "zeros":
            found = self.zeros(say(node.targets[0]), node.value.args)
        elif isinstance(node, ast.Assign):
            found = [words["="].format(self.target(node.targets[0]), say(node.value))]
        elif isinstance(node, ast.AugAssign):
            found = [words["="].format(say(node.target), say(ast.BinOp(node.target, node.op, node.value)))]
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            found = self.call(self.laws.functions[_name(node.value)], node.value.args[1:])
        elif isinstance(node, ast.Return) and node.value is not None:
            found = words["return"].format(say(node.value)).splitlines()
        elif isinstance(node, ast.For) and isinstance(node.iter, ast.Call):
            head, end = self.loop(say(node.target), _counted(node.iter))
            return [head, *self.block(node.body, depth + 1), indent + end]
        elif isinstance(node, ast.If):
            lines = [words["if"].format(say(node.test)), *self.block(node.body, depth + 1)]
            while self.laws.has_elif(node) and isinstance(node.orelse[0], ast.If):
                node = node.orelse[0]
                lines += broken(indent + words["elif"].format(say(node.test)), self.BREAKS)
                lines += self.block(node.body, depth + 1)
            lines += [indent + words["else"], *self.block(node.orelse, depth + 1)] if node.orelse else []
            return [*lines, indent + words["end"]]
        else:
            raise TypeError(f"the laws have no {ast.unparse(node)}")
        return [found[0], *(indent + line if line else "" for line in found[1:])]

    def target(self, node: ast.expr) -> str:
        """What is stored."""
        return self.say(node)

    def locals_of(self, body: list[ast.stmt], arguments: dict[str, str]) -> dict[str, str]:
        """Kinds of the intermediate values and the counters that some statements store, in their order."""
        found: dict[str, str] = {}
        for node in statements_in(body):
            target = node.target if isinstance(node, ast.For) else getattr(node, "targets", [None])[0]
            if isinstance(target, ast.Name) and target.id not in arguments:
                known = self.laws.kinds | arguments | found
                kind = kind_of(node.value, known) if isinstance(node, ast.Assign) else "whole"
                if found.setdefault(target.id, kind) != kind:
                    raise TypeError(f"{target.id} has two types in the laws")
        return found


def statements_in(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Statements with those inside them, in their order."""
    for node in body:
        yield node
        if isinstance(node, (ast.If, ast.For)):
            yield from statements_in([*node.body, *node.orelse])


def kind_of(node: ast.expr, kinds: Mapping[str, str]) -> str:
    """Whether an expression is a flag, a whole number or a real one; kinds: of names, fields and functions."""
    if isinstance(node, ast.Constant):
        return {bool: "flag", int: "whole"}.get(type(node.value), "real")
    if isinstance(node, (ast.BoolOp, ast.Compare)) or (isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)):
        return "flag"
    if isinstance(node, ast.UnaryOp):
        return kind_of(node.operand, kinds)
    if isinstance(node, ast.BinOp):
        both = {kind_of(node.left, kinds), kind_of(node.right, kinds)}
        return "whole" if both == {"whole"} else "real"
    name = _name(node) if isinstance(node, ast.Call) else ast.unparse(node)
    if name in ("min", "max", "abs") and isinstance(node, ast.Call):
        return kind_of(node.args[0], kinds)
    return "whole" if name == "int" else kinds.get(name, "real")


def _name(call: ast.Call) -> str:
    return ast.unparse(call.func)


def _counted(call: ast.Call) -> tuple[ast.expr, ast.expr, bool]:
    """First value of a range, the one behind the last, and whether it counts down."""
    low, high = [ast.Constant(0), *call.args][-2:] if len(call.args) < 3 else call.args[:2]
    return low, high, len(call.args) > 2


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

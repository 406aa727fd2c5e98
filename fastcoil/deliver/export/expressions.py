"""Expressions of the laws, said in C or Structured Text."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

_LEVEL = {"or": 1, "and": 2, "compare": 4, "sum": 5, "product": 6, "unary": 7, "whole": 8}
"""How tightly an operator binds, in both languages."""
_ARITHMETIC: Mapping[type, tuple[str, str]] = {
    ast.Add: ("+", "sum"),
    ast.Sub: ("-", "sum"),
    ast.Mult: ("*", "product"),
    ast.Div: ("/", "product"),
}


@dataclass(frozen=True)
class Language:
    """What differs between the languages in an expression.

    words: of Python's operators and True and False.  functions: name in Python → here; ``None`` for all as they are.
    state: an attribute of the state.  index: some subscripts.  number: a float.
    """

    words: Mapping[str, str]
    functions: Mapping[str, str] | None
    state: Callable[[str], str]
    index: Callable[[list[str]], str]
    number: Callable[[float], str]

    def say(self, node: ast.expr, around: str = "or") -> str:
        """An expression inside one that binds like ``around``."""
        text, level = self._say(node)
        return f"({text})" if _LEVEL[level] < _LEVEL[around] else text

    def _say(self, node: ast.expr) -> tuple[str, str]:
        if isinstance(node, ast.BinOp):
            sign, level = _ARITHMETIC[type(node.op)]
            # what stands on the right is grouped first, or the rounding would be another
            right = {"sum": "product", "product": "unary"}[level]
            return f"{self.say(node.left, level)} {sign} {self.say(node.right, right)}", level
        if isinstance(node, ast.BoolOp):
            word = "or" if isinstance(node.op, ast.Or) else "and"
            # a comparison among conditions is grouped for the reader; of one kind with another it has to be
            parts = [self.say(one, "sum" if self.words["group"] else "compare") for one in node.values]
            return f" {self.words[word]} ".join(parts), word
        if isinstance(node, ast.Compare):
            word = self.words[_comparison(node.ops[0])]
            return f"{self.say(node.left, 'sum')} {word} {self.say(node.comparators[0], 'sum')}", "compare"
        if isinstance(node, ast.UnaryOp):
            sign = self.words["not"] if isinstance(node.op, ast.Not) else "-"
            return f"{sign}{self.say(node.operand, 'unary')}", "unary"
        return self._say_term(node), "whole"

    def _say_term(self, node: ast.expr) -> str:
        if isinstance(node, ast.Constant):
            if isinstance(node.value, bool):
                return self.words[str(node.value)]
            return self.number(node.value) if isinstance(node.value, float) else str(node.value)
        if isinstance(node, ast.Name):
            return node.id
        if isinstance(node, ast.Attribute):
            return self.state(node.attr)
        if isinstance(node, ast.Subscript):
            indices: list[str] = []
            inner: ast.expr = node
            while isinstance(inner, ast.Subscript):
                indices.insert(0, self.say(inner.slice))
                inner = inner.value
            return self._say_term(inner) + self.index(indices)
        if isinstance(node, ast.Call):
            arguments = ", ".join(map(self.say, node.args))
            name = ast.unparse(node.func)
            return f"{name if self.functions is None else self.functions[name]}({arguments})"
        raise TypeError(f"the laws have no {ast.unparse(node)}")


def _comparison(sign: ast.cmpop) -> str:
    signs: Mapping[type, str] = {
        ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
    }  # fmt: skip
    return signs[type(sign)]


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
    name = ast.unparse(node.func if isinstance(node, ast.Call) else node)
    if name in ("min", "max") and isinstance(node, ast.Call):
        return kind_of(node.args[0], kinds)
    return "whole" if name == "int" else kinds.get(name, "real")


def stored_in(nodes: list[ast.stmt]) -> list[str]:
    """Intermediate values that some statements find, in their order."""
    targets = [n.targets[0] for top in nodes for n in ast.walk(top) if isinstance(n, ast.Assign)]
    found = [target.id for target in targets if isinstance(target, ast.Name)]
    return list(dict.fromkeys(found))


def loaded_in(nodes: list[ast.stmt]) -> set[str]:
    """Names that some statements read."""
    return {n.id for top in nodes for n in ast.walk(top) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)}


def broken(line: str, width: int, breaks: str) -> list[str]:
    """A line that is too long as several, each after the first further in; breaks: before which words it may end."""
    if len(line) <= width:
        return [line]
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    places = [m.start() for m in re.finditer(breaks, line) if len(indent) < m.start() <= width]
    if not places:
        return [line]
    depth = {place: line[:place].count("(") - line[:place].count(")") for place in places}
    best = max(place for place in places if depth[place] == min(depth.values()))
    return [line[:best], *broken(indent + line[best:].lstrip(), width, breaks)]

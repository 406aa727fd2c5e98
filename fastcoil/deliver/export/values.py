"""What a rule computes with while it is translated: expressions in place of numbers, and what the statements read."""

from __future__ import annotations

import ast
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import FunctionType
from typing import Any

from fastcoil.model.parameter_table import LARGEST


@dataclass(frozen=True, eq=False)
class Number:
    """An expression."""

    text: ast.expr
    kind: str = "real"  # or flag, or whole
    value: Any = None  # where the loop decides it
    needs: frozenset[str] = frozenset()  # flags that all hold where it is a number, and not NaN

    @property
    def is_nothing(self) -> bool:
        """Whether it is NaN."""
        return isinstance(self.value, float) and math.isnan(self.value)

    @property
    def is_atom(self) -> bool:
        """Whether it is a name or a constant."""
        text = self.text.operand if isinstance(self.text, ast.UnaryOp) else self.text
        return isinstance(text, (ast.Constant, ast.Name, ast.Attribute))


@dataclass(frozen=True)
class Table:
    """A table of constant numbers; without values the array of an estimator."""

    name: str = "s.w"
    values: tuple[float, ...] = ()


class Scope:
    """One call of a function; ``finish``: what is done with what it returns."""

    def __init__(self, function: FunctionType, definition: ast.FunctionDef, finish: Callable[[Any], Any]) -> None:
        self.function, self.definition, self.finish = function, definition, finish
        self.names: dict[str, Any] = {}  # what they stand for
        self.arguments = [one.arg for one in (*definition.args.posonlyargs, *definition.args.args)]
        nodes = list(ast.walk(definition))
        nodes += [one.target for one in nodes if isinstance(one, ast.AugAssign)]
        names = [one for one in nodes if isinstance(one, ast.Name)]
        # how often each is stored
        self.stored = Counter(one.id for one in names if not isinstance(one.ctx, ast.Load))
        self.stored.update(set(self.arguments) & set(self.stored))


def constant(value: Any) -> Number:
    """A number as it is, without a name."""
    kind = {bool: "flag", int: "whole"}.get(type(value), "real")
    if kind == "flag":
        return Number(ast.Constant(value), kind, value)
    if kind == "real":
        # nothing exceeds the largest number either
        value = math.copysign(LARGEST, value) if math.isinf(value) else float(value)
    text: ast.expr = ast.Constant(0.0 if math.isnan(value) else abs(value))
    return Number(ast.UnaryOp(ast.USub(), text) if math.copysign(1.0, value) < 0.0 else text, kind, value)


def expression(text: str) -> ast.expr:
    """The tree of an expression."""
    return ast.parse(text, mode="eval").body


def call_of(name: str, *given: ast.expr) -> ast.Call:
    """The call of a function by its name."""
    return ast.Call(expression(name), list(given), [])


def assigned(name: str, value: ast.expr) -> ast.Assign:
    """A statement that stores a value."""
    return ast.Assign([expression(name)], value)


def negated(text: ast.expr) -> ast.expr:
    """The opposite of a condition."""
    if isinstance(text, ast.UnaryOp) and isinstance(text.op, ast.Not):
        return text.operand
    return ast.UnaryOp(ast.Not(), text)


def joined(sign: ast.boolop, texts: Iterable[ast.expr]) -> ast.expr:
    """Conditions joined by and, or by or."""
    found: list[ast.expr] = []
    for text in texts:
        found += text.values if isinstance(text, ast.BoolOp) and isinstance(text.op, type(sign)) else [text]
    return found[0] if len(found) == 1 else ast.BoolOp(sign, found)


def implied(text: ast.expr, truth: bool, definitions: Mapping[str, ast.expr]) -> set[str]:
    """Conditions that hold where one is true, or false.  definitions: of flags by name."""
    if isinstance(text, ast.UnaryOp) and isinstance(text.op, ast.Not):
        return implied(text.operand, not truth, definitions)
    if isinstance(text, ast.BoolOp):
        parts = text.values if isinstance(text.op, ast.And) == truth else []
        return set().union(*(implied(one, truth, definitions) for one in parts))
    found = {ast.unparse(text)} if truth else set()
    if isinstance(text, ast.Name) and text.id in definitions:
        found |= implied(definitions[text.id], truth, definitions)
    return found


def read_in(nodes: list[ast.stmt] | ast.expr) -> set[str]:
    """Names and fields of the state that are read."""
    found: set[str] = set()
    for top in nodes if isinstance(nodes, list) else [nodes]:
        targets = {id(n.targets[0]) for n in ast.walk(top) if isinstance(n, ast.Assign)}
        found |= {
            ast.unparse(n) for n in ast.walk(top) if isinstance(n, (ast.Attribute, ast.Name)) and id(n) not in targets
        }
    return found


def has_return(node: ast.AST) -> bool:
    """Whether a function returns from within a statement."""
    return any(isinstance(one, ast.Return) for one in ast.walk(node))


def needed(body: list[ast.stmt], goals: set[str]) -> list[ast.stmt]:
    """The statements that what is sought depends on."""
    goals = set(goals)
    while True:
        kept = _kept(body, goals)
        more = read_in(kept) - goals
        if not more:
            return kept
        goals |= more


def _kept(body: list[ast.stmt], goals: set[str]) -> list[ast.stmt]:
    """The statements that store one of the goals."""
    found: list[ast.stmt] = []
    for node in body:
        kept: list[ast.stmt] = [node]
        if isinstance(node, ast.If):
            kept = conditional(node.test, _kept(node.body, goals), _kept(node.orelse, goals))
        elif isinstance(node, ast.For):
            inner = _kept(node.body, goals)
            kept = [ast.For(node.target, node.iter, inner, [])] if inner else []
        elif isinstance(node, ast.Assign):
            target = node.targets[0]
            name = ast.unparse(target.value if isinstance(target, ast.Subscript) else target)
            kept = [node] if name in goals else []
        found += kept
    return found


def conditional(test: ast.expr, yes: list[ast.stmt], no: list[ast.stmt]) -> list[ast.stmt]:
    """An if; nothing where nothing is done in either case."""
    if not yes:
        test, yes, no = negated(test), no, yes
    return [ast.If(test, yes, no)] if yes else []

"""Expressions that stand for numbers while a rule is translated, and the names that statements read and store."""

from __future__ import annotations

import ast
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import FunctionType
from typing import Any

from fastcoil.model.parameter_table import LARGEST_FLOAT


@dataclass(frozen=True, eq=False)
class Number:
    """An expression of the laws that stands for a number, with its value where the loop's parameters decide it."""

    text: ast.expr
    kind: str = "real"  # or flag, or whole
    value: Any = None
    known_flags: frozenset[str] = frozenset()  # all of them hold where it is not NaN

    @property
    def is_nan(self) -> bool:
        """Whether the value is known to be NaN."""
        return isinstance(self.value, float) and math.isnan(self.value)

    @property
    def is_atom(self) -> bool:
        """Whether the expression is a name or a constant, perhaps with a sign."""
        text = self.text.operand if isinstance(self.text, ast.UnaryOp) else self.text
        return isinstance(text, (ast.Constant, ast.Name, ast.Attribute))


@dataclass(frozen=True)
class Table:
    """A table of constant numbers; without values, the array of an estimator."""

    name: str = "s.w"
    values: tuple[float, ...] = ()


class Scope:
    """One call of a function that is translated in place; ``finish`` receives the returned value."""

    def __init__(self, function: FunctionType, definition: ast.FunctionDef, finish: Callable[[Any], Any]) -> None:
        self.function, self.definition, self.finish = function, definition, finish
        self.names: dict[str, Any] = {}  # value by name
        self.arguments = [node.arg for node in (*definition.args.posonlyargs, *definition.args.args)]
        nodes = list(ast.walk(definition))
        nodes += [node.target for node in nodes if isinstance(node, ast.AugAssign)]
        names = [node for node in nodes if isinstance(node, ast.Name)]
        self.store_counts = Counter(node.id for node in names if not isinstance(node.ctx, ast.Load))
        self.store_counts.update(set(self.arguments) & set(self.store_counts))


def constant(value: Any) -> Number:
    """Return a Python number as a constant expression with its value."""
    kind = {bool: "flag", int: "whole"}.get(type(value), "real")
    if kind == "flag":
        return Number(ast.Constant(value), kind, value)
    if kind == "real":
        # as in the kernel, infinity is the largest number
        value = math.copysign(LARGEST_FLOAT, value) if math.isinf(value) else float(value)
    text: ast.expr = ast.Constant(0.0 if math.isnan(value) else abs(value))
    return Number(ast.UnaryOp(ast.USub(), text) if math.copysign(1.0, value) < 0.0 else text, kind, value)


def expression(text: str) -> ast.expr:
    """Parse a text of Python as an expression."""
    return ast.parse(text, mode="eval").body


def call_of(name: str, *arguments: ast.expr) -> ast.Call:
    """Return the call of a function by its name."""
    return ast.Call(expression(name), list(arguments), [])


def assignment(name: str, value: ast.expr) -> ast.Assign:
    """Return a statement that stores a value."""
    return ast.Assign([expression(name)], value)


def negation(text: ast.expr) -> ast.expr:
    """Return the opposite of a condition."""
    if isinstance(text, ast.UnaryOp) and isinstance(text.op, ast.Not):
        return text.operand
    return ast.UnaryOp(ast.Not(), text)


def join_conditions(sign: ast.boolop, texts: Iterable[ast.expr]) -> ast.expr:
    """Join conditions by and, or by or."""
    conditions: list[ast.expr] = []
    for text in texts:
        conditions += text.values if isinstance(text, ast.BoolOp) and isinstance(text.op, type(sign)) else [text]
    return conditions[0] if len(conditions) == 1 else ast.BoolOp(sign, conditions)


def implied_conditions(text: ast.expr, truth: bool, definitions: Mapping[str, ast.expr]) -> set[str]:
    """Return the conditions that hold where one is true, or false.  definitions: of flags by name."""
    if isinstance(text, ast.UnaryOp) and isinstance(text.op, ast.Not):
        return implied_conditions(text.operand, not truth, definitions)
    if isinstance(text, ast.BoolOp):
        parts = text.values if isinstance(text.op, ast.And) == truth else []
        return set().union(*(implied_conditions(part, truth, definitions) for part in parts))
    conditions = {ast.unparse(text)} if truth else set()
    if isinstance(text, ast.Name) and text.id in definitions:
        conditions |= implied_conditions(definitions[text.id], truth, definitions)
    return conditions


def names_read_in(nodes: list[ast.stmt] | ast.expr) -> set[str]:
    """Return the names and fields of the state that are read."""
    names: set[str] = set()
    for node in nodes if isinstance(nodes, list) else [nodes]:
        targets = {id(n.targets[0]) for n in ast.walk(node) if isinstance(n, ast.Assign)}
        reads = (n for n in ast.walk(node) if isinstance(n, (ast.Attribute, ast.Name)) and id(n) not in targets)
        names |= {ast.unparse(n) for n in reads}
    return names


def has_return(node: ast.AST) -> bool:
    """Whether a function returns from within a statement."""
    return any(isinstance(part, ast.Return) for part in ast.walk(node))


def needed_statements(body: list[ast.stmt], goals: set[str]) -> list[ast.stmt]:
    """Return the statements on which the goals depend."""
    goals = set(goals)
    while True:
        kept_statements = _statements_storing(body, goals)
        new_goals = names_read_in(kept_statements) - goals
        if not new_goals:
            return kept_statements
        goals |= new_goals


def _statements_storing(body: list[ast.stmt], goals: set[str]) -> list[ast.stmt]:
    """Return the statements that store one of the goals."""
    statements: list[ast.stmt] = []
    for node in body:
        kept_parts: list[ast.stmt] = [node]
        if isinstance(node, ast.If):
            yes, no = (_statements_storing(branch, goals) for branch in (node.body, node.orelse))
            kept_parts = if_statement(node.test, yes, no)
        elif isinstance(node, ast.For):
            inner = _statements_storing(node.body, goals)
            kept_parts = [ast.For(node.target, node.iter, inner, [])] if inner else []
        elif isinstance(node, ast.Assign):
            target = node.targets[0]
            name = ast.unparse(target.value if isinstance(target, ast.Subscript) else target)
            kept_parts = [node] if name in goals else []
        statements += kept_parts
    return statements


def if_statement(test: ast.expr, yes: list[ast.stmt], no: list[ast.stmt]) -> list[ast.stmt]:
    """Return an if statement; none where both branches are empty."""
    if not yes:
        test, yes, no = negation(test), no, yes
    return [ast.If(test, yes, no)] if yes else []

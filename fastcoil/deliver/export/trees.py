"""Conditions and statements of the laws as syntax trees: what they read, imply and need."""

from __future__ import annotations

import ast
import io
import tokenize
from collections.abc import Iterator, Mapping, Sequence
from typing import Any


def expression(text: str) -> ast.expr:
    """The tree of an expression."""
    return ast.parse(text, mode="eval").body


LARGEST = 1.7976931348623157e308


def negated(text: ast.expr) -> ast.expr:
    """The opposite of a condition."""
    return (
        text.operand if isinstance(text, ast.UnaryOp) and isinstance(text.op, ast.Not) else ast.UnaryOp(ast.Not(), text)
    )


def _flat(kind: type, texts: Iterator[ast.expr] | Sequence[ast.expr]) -> list[ast.expr]:
    found: list[ast.expr] = []
    for text in texts:
        found += text.values if isinstance(text, ast.BoolOp) and isinstance(text.op, kind) else [text]
    return found


def conjunction(texts: Iterator[ast.expr] | Sequence[ast.expr]) -> ast.expr:
    """Conditions joined by and."""
    found = _flat(ast.And, texts)
    return found[0] if len(found) == 1 else ast.BoolOp(ast.And(), found)


def disjunction(texts: Iterator[ast.expr] | Sequence[ast.expr]) -> ast.expr:
    """Conditions joined by or."""
    found = _flat(ast.Or, texts)
    return found[0] if len(found) == 1 else ast.BoolOp(ast.Or(), found)


def call_of(name: str, *given: ast.expr) -> ast.Call:
    """The call of a function by its name."""
    return ast.Call(expression(name), list(given), [])


def implied(text: ast.expr, truth: bool, definitions: Mapping[str, ast.expr]) -> set[str]:
    """Conditions that hold where one is true, or false."""
    if isinstance(text, ast.UnaryOp) and isinstance(text.op, ast.Not):
        return implied(text.operand, not truth, definitions)
    if isinstance(text, ast.BoolOp):
        if isinstance(text.op, ast.And) == truth:
            return set().union(*(implied(one, truth, definitions) for one in text.values))
        return set()
    found = {ast.unparse(text)} if truth else set()
    if isinstance(text, ast.Name) and text.id in definitions:
        found |= implied(definitions[text.id], truth, definitions)
    return found


def has_return(node: ast.AST) -> bool:
    """Whether a function returns from within a statement."""
    return any(isinstance(one, ast.Return) for one in ast.walk(node))


def ends(body: list[ast.stmt]) -> bool:
    """Whether a block returns in any case."""
    if not body:
        return False
    last = body[-1]
    return isinstance(last, ast.Return) or (isinstance(last, ast.If) and ends(last.body) and ends(last.orelse))


def variable_of(node: ast.AST) -> str:
    """The variable that is stored."""
    while isinstance(node, ast.Subscript):
        node = node.value
    return ast.unparse(node)


def names_in(text: str) -> list[str]:
    """The names in a text, without its comments and docstrings."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return [token.string for token in tokens if token.type == tokenize.NAME]


def read_in(nodes: Any) -> set[str]:
    """Names and fields of the state that are read."""
    found: set[str] = set()
    for top in nodes if isinstance(nodes, list) else [nodes]:
        stored = {id(n.targets[0]) for n in ast.walk(top) if isinstance(n, ast.Assign)}
        for node in ast.walk(top):
            if isinstance(node, ast.Attribute) and id(node) not in stored:
                found.add(ast.unparse(node))
            elif isinstance(node, ast.Name) and id(node) not in stored:
                found.add(node.id)
            elif isinstance(node, ast.Expr):
                found.add("s.w")
    return found


def test_of(block: list[ast.stmt]) -> str:
    """The condition of a block that is one if; empty for any other."""
    return ast.unparse(block[0].test) if len(block) == 1 and isinstance(block[0], ast.If) else ""


def needed(body: list[ast.stmt], goals: set[str]) -> list[ast.stmt]:
    """The statements that what is sought depends on."""
    needed, before = set(goals), -1

    def look(nodes: list[ast.stmt], around: set[str]) -> None:
        for node in nodes:
            if isinstance(node, ast.If):
                inner = around | read_in(ast.Expression(node.test))
                look(node.body, inner)
                look(node.orelse, inner)
            elif isinstance(node, ast.For):
                look(node.body, around | read_in(ast.Expression(node.iter)))
            elif (
                isinstance(node, ast.Return)
                or (isinstance(node, ast.Assign) and variable_of(node.targets[0]) in needed)
                or isinstance(node, ast.Expr)
                and "s.w" in needed
            ):
                needed.update(around | read_in(node))

    def kept(nodes: list[ast.stmt]) -> list[ast.stmt]:
        found: list[ast.stmt] = []
        for node in nodes:
            if isinstance(node, ast.If):
                node.body, node.orelse = kept(node.body), kept(node.orelse)
                if not node.body and node.orelse:
                    node.test, node.body, node.orelse = negated(node.test), node.orelse, []
                found += [node] if node.body else []
            elif isinstance(node, ast.For):
                node.body = kept(node.body)
                found += [node] if node.body else []
            elif not isinstance(node, ast.Assign) or variable_of(node.targets[0]) in needed:
                found.append(node)
        return found

    while len(needed) != before:
        before = len(needed)
        look(body, set())
    return kept(body)


def merged(body: list[ast.stmt]) -> list[ast.stmt]:
    """Statements under one condition after another, under one."""
    found: list[ast.stmt] = []
    for node in body:
        if isinstance(node, ast.If):
            node.body, node.orelse = merged(node.body), merged(node.orelse)
        elif isinstance(node, ast.For):
            node.body = merged(node.body)
        last = found[-1] if found else None
        test = ast.dump(node.test) if isinstance(node, ast.If) else ""
        stored = {variable_of(n.targets[0]) for n in ast.walk(last) if isinstance(n, ast.Assign)} if last else set()
        if (
            isinstance(last, ast.If)
            and isinstance(node, ast.If)
            and ast.dump(last.test) == test
            and not stored & read_in(ast.Expression(node.test))
        ):
            first: Any = (node.body or node.orelse)[0]
            first.above = [*getattr(node, "above", []), *getattr(first, "above", [])]
            last.body = merged([*last.body, *node.body])
            last.orelse = merged([*last.orelse, *node.orelse])
        else:
            found.append(node)
    return found

"""Expressions of a rule, evaluated: what the loop decides is decided, the rest stays an expression of variables."""

import ast
import builtins
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np

from fastcoil.base.errors import InputError
from fastcoil.deliver.export.values import (
    Number,
    Scope,
    Table,
    assigned,
    call_of,
    conditional,
    constant,
    expression,
    implied,
    joined,
    negated,
    read_in,
)
from fastcoil.deliver.export.words import RESERVED, plain_text
from fastcoil.model.numerics import elementary

_SIGNS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}  # fmt: skip
FUNCTIONS: Mapping[str, tuple[Any, ...]] = {
    "math.exp": (math.exp, np.exp, elementary.exp), "math.log": (math.log, np.log, elementary.log),
    "math.sqrt": (math.sqrt, np.sqrt), "math.sin": (math.sin, np.sin), "math.cos": (math.cos, np.cos),
    "math.tan": (math.tan, np.tan), "math.asin": (math.asin, np.arcsin), "math.acos": (math.acos, np.arccos),
    "math.atan": (math.atan, np.arctan), "math.tanh": (math.tanh, np.tanh), "math.floor": (math.floor, np.floor),
    "abs": (abs, np.abs, math.fabs, np.fabs), "min": (min, np.minimum), "max": (max, np.maximum),
    "isnan": (math.isnan, np.isnan), "int": (int,), "float": (float,), "bool": (bool,),
}  # fmt: skip
"""What a rule may call, by the name that the laws have for it."""
KNOWN = "abs, cos, exp, floor, log, max, min, sin, sqrt, tan, tanh, their inverses"
SAID = "assignments, if, for k in range(…), return, numbers, tables of them, + - * / ** % // and comparisons"


class AgainError(Exception):
    """More than was known may be NaN, changes, or is no whole number: translate once more."""


class Formulas(ABC):
    """Evaluates expressions, and collects statements and the variables in them."""

    def __init__(self, kind: str, rule: str, names: Sequence[str]) -> None:
        self.kind, self.rule, self.where = kind, rule, ""  # law or estimator, and its name
        self.pool = {each.casefold() for each in (*names, *RESERVED)}  # names that are taken
        self.names: dict[Any, str] = {}  # by what they stand for, the same in every round
        self.kinds: dict[str, str] = {}  # of variables
        self.nothing: set[str] = set()  # those that may be NaN; beside each is a flag, ``name_known``
        self.out: list[ast.stmt] = []  # the statements so far
        self._begin()

    def _begin(self) -> None:
        """Begin a round: all but names, kinds and what may be NaN is found anew."""
        self.constants: dict[str, Any] = {}
        self.unsteady: set[str] = set()  # variables that get several values
        self._afresh()

    def _afresh(self) -> list[ast.stmt]:
        """Begin another function of the laws.  Returns the statements of the one before."""
        before = self.out
        self.path: Any = ()  # the calls that led here
        self.wanted = "value"  # the name of what is evaluated
        self.facts: set[str] = set()  # conditions that hold here
        self.definitions: dict[str, ast.expr] = {}  # of flags, by name
        self.out = []
        return before

    def _refusal(self, what: str, cure: str) -> InputError:
        where = f"{self.where}: " if self.where else ""
        return InputError(
            f"{self.kind} = {self.rule!r} cannot be exported: {where}{what}: {cure}, or export the loop with "
            f"{'an estimator' if self.kind == 'estimator' else 'the law'} of fastcoil"
        )

    def _lacks(self, node: ast.AST) -> InputError:
        return self._refusal(f"it has {ast.unparse(node)}", f"use {SAID}")

    def _named(self, wanted: str, key: Any) -> str:
        """A name that all languages can have and nothing else has; key: what it stands for."""
        if (key, wanted) not in self.names:
            name = "_".join(filter(None, plain_text(wanted).split("_"))) or "x"
            found, k = name, 1
            while self.pool & {found.casefold(), f"{found}_known".casefold()}:
                k, found = k + 1, f"{name}_{k + 1}"
            self.pool.add(found.casefold())
            self.names[key, wanted] = found
        return self.names[key, wanted]

    def _local(self, wanted: str, key: Any) -> str:
        """The name of a variable in the call that led here."""
        return self._named(wanted, (self.path, key))

    def _variable(self, name: str) -> Number:
        needs = frozenset({f"{name}_known"} & {f"{each}_known" for each in self.nothing})
        return Number(expression(name), self.kinds.get(name, "real"), None, needs)

    def _needs(self, *numbers: Number) -> list[ast.expr]:
        """Flags that hold where numbers are none of them NaN, without those that hold here anyway."""
        needs = frozenset().union(*(one.needs for one in numbers)) - self.facts
        return [expression(each) for each in sorted(needs)]

    # statements

    @contextmanager
    def _aside(self, test: ast.expr | None = None, truth: bool = True) -> Iterator[list[ast.stmt]]:
        """Collects the statements that are made inside apart, where a condition is true or false."""
        before, self.out = self.out, []
        more = set() if test is None else implied(test, truth, self.definitions) - self.facts
        self.facts |= more
        try:
            yield self.out
        finally:
            self.out = before
            self.facts -= more

    def _either(
        self, test: ast.expr, runs: tuple[Callable[[], Any], Callable[[], Any]], name: str = "", key: Any = None
    ) -> Any:
        """What one of two functions gives, by a condition; ``None`` where only their statements matter."""
        found, blocks = [], []
        for run, truth in zip(runs, (True, False), strict=True):
            with self._aside(test, truth) as block:
                found.append(run())
            blocks.append(block)
        value = found[0]
        if value is not found[1]:
            value = self._merged(name, (found[0], found[1]), key, test, blocks)
        self.out += conditional(test, *blocks)
        return value

    def _merged(self, name: str, pair: tuple[Any, Any], key: Any, test: ast.expr, blocks: list[list[ast.stmt]]) -> Any:
        """One of two values, which blocks of statements store in a variable where they differ."""
        yes, no = pair
        if isinstance(yes, dict):  # a tuple, by name or place
            return {n: self._merged(f"{name}_{n}", (one, no[n]), key, test, blocks) for n, one in yes.items()}
        is_alike = repr(yes.value) == repr(no.value) and ast.unparse(yes.text) == ast.unparse(no.text)
        if is_alike and self._is_steady(yes):
            return yes
        out = self._local(name, key)
        for block, value, truth in zip(blocks, pair, (True, False), strict=True):
            with self._aside(test, truth) as stored:
                self._store(out, value)
            block.extend(stored)
        return self._variable(out)

    def _store(self, name: str, value: Number) -> None:
        """``name`` = value, and whether it is a number, where that is not certain."""
        kinds, flag = self.kinds, f"{name}_known"
        if not value.is_nothing and kinds.setdefault(name, "real" if name[:2] == "s." else value.kind) != value.kind:
            if kinds[name] != "real":
                kinds[name] = "real"
                raise AgainError
            value = self._real(value)
        needs = self._needs(value)
        if (needs or value.is_nothing) and name not in self.nothing:
            self.nothing.add(name)
            raise AgainError
        store: list[ast.stmt] = [assigned(name, value.text)]
        if ast.unparse(value.text) == name and not value.is_nothing:
            return
        if name in self.nothing:
            known = ast.Constant(not value.is_nothing) if not needs else joined(ast.And(), needs)
            self.facts.discard(flag)
            self.out.append(assigned(flag, known))
            store = [ast.If(expression(flag), store, [])] if needs else store
        self.out += [] if value.is_nothing else store

    def _bound(self, name: str, value: Any, key: Any, many: bool = False) -> Any:
        """A value as later statements may read it; many: it is one of several that a variable gets."""
        if isinstance(value, dict):
            return {
                n: one if not many and self._is_steady(one) else self._bound(f"{name}_{n}", one, key, many)
                for n, one in value.items()
            }
        if not isinstance(value, Number) or (not many and value.is_atom and self._is_steady(value)):
            return value
        out = self._local(name, key)
        if many:
            self.unsteady.add(out)
        elif value.kind == "flag" and self._is_steady(value):
            self.definitions[out] = value.text
        self._store(out, value)
        return self._variable(out)

    def _is_steady(self, value: Any) -> bool:
        """Whether a value reads nothing that changes."""
        return isinstance(value, Number) and not read_in(value.text) & {*self.unsteady, "s.w"}

    # kinds

    def _real(self, number: Number) -> Number:
        if number.kind == "real":
            return number
        if number.value is not None:
            return constant(float(number.value))
        if number.kind == "whole":
            return Number(call_of("float", number.text))
        numbers = (lambda: constant(1.0), lambda: constant(0.0))
        found: Number = self._either(number.text, numbers, "as_number", ast.unparse(number.text))
        return found

    # expressions

    def _value_of(self, name: str, node: ast.expr, scope: Scope) -> Any:
        """A value that will have a name."""
        before, self.wanted = self.wanted, name
        value = self._value(node, scope)
        self.wanted = before
        return value

    def _value(self, node: ast.expr, scope: Scope) -> Any:  # noqa: PLR0911 — one for each kind
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
            return constant(node.value)
        if isinstance(node, ast.Name):
            return self._looked_up(node.id, scope)
        if isinstance(node, ast.Attribute):
            return self._attribute(self._value(node.value, scope), node)
        if isinstance(node, ast.Tuple):
            return {str(k): self._value(one, scope) for k, one in enumerate(node.elts)}
        if isinstance(node, ast.UnaryOp):
            return self._unary(node, self._value(node.operand, scope))
        if isinstance(node, ast.BoolOp):
            return self._both(node, scope)
        if isinstance(node, ast.Compare):
            values = [self._value(one, scope) for one in (node.left, *node.comparators)]
            signs = zip(node.ops, values, values[1:], strict=False)
            return self._joined(ast.And(), [self._compared(*each) for each in signs])
        if isinstance(node, ast.BinOp):
            sides = (self._value(one, scope) for one in (node.left, node.right))
            left, right = (self._real(one) if one.kind == "flag" else one for one in sides)
            return self._arithmetic(node.op, left, right)
        if isinstance(node, ast.IfExp):
            test, body, orelse = self._flag(self._value(node.test, scope)), node.body, node.orelse
            if test.value is not None:
                return self._value(body if test.value else orelse, scope)
            runs = (lambda: self._value(body, scope), lambda: self._value(orelse, scope))
            return self._either(test.text, runs, self.wanted, id(node))
        if isinstance(node, ast.Subscript):
            return self._element(node, scope)
        if isinstance(node, ast.Call):
            return self._call(node, scope)
        raise self._lacks(node)

    @abstractmethod
    def _call(self, node: ast.Call, scope: Scope) -> Any: ...

    # names

    def _looked_up(self, name: str, scope: Scope) -> Any:
        python = scope.function
        cells = dict(zip(python.__code__.co_freevars, python.__closure__ or (), strict=True))
        if name in scope.names:
            return scope.names[name]
        if name in cells:
            return self._lifted(name, cells[name].cell_contents)
        if name in python.__globals__:
            return self._lifted(name, python.__globals__[name])
        return getattr(builtins, name)

    def _lifted(self, name: str, value: Any) -> Any:
        """A name of the module: numbers become constants of the laws."""
        value = value.item() if isinstance(value, (np.number, np.bool_)) else value
        if isinstance(value, (int, float)):
            number = constant(value)
            if isinstance(value, bool) or not math.isfinite(value):
                return number
            return replace(number, text=ast.Name(self._module_constant(name, value)))
        if isinstance(value, (tuple, np.ndarray)) and not hasattr(value, "_fields"):
            numbers = tuple(np.asarray(value, dtype=float).tolist())
            return Table(self._module_constant(name, numbers), numbers)
        return value

    def _module_constant(self, name: str, value: Any) -> str:
        called = self._named(plain_text(name).strip("_").upper(), ("constant", repr(value)))
        self.constants[called] = value
        return called

    def _attribute(self, of: Any, node: ast.Attribute) -> Any:
        if isinstance(of, dict) and node.attr in of:
            return of[node.attr]
        if isinstance(of, ModuleType) and hasattr(of, node.attr):
            value = getattr(of, node.attr)
            return constant(value) if isinstance(value, float) else value
        raise self._lacks(node)

    def _element(self, node: ast.Subscript, scope: Scope) -> Any:
        of = self._value(node.value, scope)
        index = self._value(node.slice, scope)
        if isinstance(of, dict):
            return [*of.values()][index.value]
        if index.value is not None and of.values:
            return constant(of.values[index.value])
        return Number(ast.Subscript(expression(of.name), index.text))

    # conditions

    def _flag(self, number: Number) -> Number:
        """A truth; of a number, whether it is not 0."""
        if number.kind != "flag":
            return self._compared(ast.NotEq(), number, constant(0 if number.kind == "whole" else 0.0))
        return number

    @staticmethod
    def _joined(sign: ast.boolop, parts: list[Number]) -> Number:
        """Flags joined by and, or by or, without those that are known."""
        is_and = isinstance(sign, ast.And)
        if any(one.value is not None and bool(one.value) != is_and for one in parts):
            return constant(not is_and)
        unknown = [one.text for one in parts if one.value is None]
        return Number(joined(sign, unknown), "flag") if unknown else constant(is_and)

    def _both(self, node: ast.BoolOp, scope: Scope) -> Number:
        """``and`` or ``or``: what stands further right is evaluated only where it matters."""
        is_and, parts = isinstance(node.op, ast.And), [self._flag(self._value(node.values[0], scope))]
        for one in node.values[1:]:
            first = self._joined(node.op, parts)
            if first.value is not None and bool(first.value) != is_and:
                return first
            with self._aside(first.text, is_and) as block:
                parts.append(self._flag(self._value(one, scope)))
            if block:
                name = self._local("holds", id(one))
                self._store(name, first)
                block.append(assigned(name, parts[-1].text))
                self.out.append(ast.If(ast.Name(name) if is_and else negated(ast.Name(name)), block, []))
                parts = [self._variable(name)]
        return self._joined(node.op, parts)

    def _compared(self, sign: ast.cmpop, left: Number, right: Number) -> Number:
        """Whether a comparison holds, which none with NaN does but !=."""
        holds = _SIGNS[type(sign)]
        left, right = (self._real(one) if one.kind == "flag" else one for one in (left, right))
        if left.is_nothing or right.is_nothing:
            return constant(isinstance(sign, ast.NotEq))
        if left.value is not None and right.value is not None:
            return constant(bool(holds(left.value, right.value)))
        if left.kind != right.kind:
            left, right = self._real(left), self._real(right)
        flags, test = self._needs(left, right), ast.Compare(left.text, [sign], [right.text])
        if isinstance(sign, ast.NotEq):
            return Number(joined(ast.Or(), [*map(negated, flags), test]), "flag")
        return Number(joined(ast.And(), [*flags, test]), "flag")

    # arithmetic

    def _unary(self, node: ast.UnaryOp, value: Number) -> Number:
        if isinstance(node.op, ast.Not):
            number = self._flag(value)
            return Number(negated(number.text), "flag") if number.value is None else constant(not number.value)
        if not isinstance(node.op, ast.USub):
            raise self._lacks(node)
        number = self._real(value) if value.kind == "flag" else value
        if isinstance(number.text, ast.Constant):
            return constant(-number.value)
        known = None if number.value is None else -number.value
        return replace(number, text=ast.UnaryOp(ast.USub(), number.text), value=known)

    def _arithmetic(self, sign: ast.operator, left: Number, right: Number) -> Number:
        if isinstance(sign, ast.Pow):
            return self._power(left, right)
        if isinstance(sign, (ast.FloorDiv, ast.Mod)):
            is_whole = left.kind == right.kind == "whole" and isinstance(sign, ast.FloorDiv)
            ratio = self._arithmetic(ast.Div(), left, right)
            floor = self._mathematics("int" if is_whole else "math.floor", [ratio])
            if isinstance(sign, ast.FloorDiv):
                return floor
            return self._arithmetic(ast.Sub(), left, self._arithmetic(ast.Mult(), floor, right))
        applied = _SIGNS[type(sign)]
        if left.kind != right.kind or isinstance(sign, ast.Div):
            left, right = self._real(left), self._real(right)
        if isinstance(sign, ast.Mult):
            for one, other in ((left, right), (right, left)):
                if isinstance(one.text, ast.Constant) and one.value == 1:
                    return other
        value = None
        if left.value is not None and right.value is not None:
            with np.errstate(all="ignore"):
                value = applied(np.float64(left.value), np.float64(right.value)).item()
            value = int(value) if left.kind == "whole" else value
            are_written = isinstance(left.text, ast.Constant) and isinstance(right.text, ast.Constant)
            if are_written or not math.isfinite(value):
                return constant(value)
        return Number(ast.BinOp(left.text, sign, right.text), left.kind, value, left.needs | right.needs)

    def _power(self, left: Number, right: Number) -> Number:
        if right.value not in (2, 3):
            left, right = self._real(left), self._real(right)
            return Number(call_of("math.pow", left.text, right.text), needs=left.needs | right.needs)
        if not left.is_atom:
            name = self._local("x", ast.unparse(left.text))
            self._store(name, left)
            left = self._variable(name)
        square = self._arithmetic(ast.Mult(), left, left)
        return square if right.value == 2 else self._arithmetic(ast.Mult(), square, left)

    def _mathematics(self, name: str, given: list[Number]) -> Number:
        """The value of a function that the languages have."""
        if name == "bool":
            return self._flag(given[0])
        if name == "isnan":
            needs = self._needs(given[0])
            return Number(negated(joined(ast.And(), needs)), "flag") if needs else constant(given[0].is_nothing)
        is_whole = name in ("min", "max", "abs") and all(one.kind == "whole" for one in given)
        numbers = given if is_whole else [self._real(one) for one in given]
        if name == "float":
            return numbers[0]
        while len(numbers) > 2:
            numbers = [self._mathematics(name, numbers[:2]), *numbers[2:]]
        kind = "whole" if is_whole or name == "int" else "real"
        value = None
        if all(one.value is not None for one in numbers):
            value = FUNCTIONS[name][0](*(one.value for one in numbers))
            value = value if kind == "whole" else float(value)
        both = frozenset().union(*(one.needs for one in numbers))
        return Number(call_of(name, *(one.text for one in numbers)), kind, value, both)

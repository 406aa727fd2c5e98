"""Expressions of a rule, evaluated: what the loop decides is decided, the rest stays an expression."""

from __future__ import annotations

import ast
import builtins
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any

import numpy as np

from fastcoil.base.errors import InputError
from fastcoil.deliver.export.python import documented
from fastcoil.deliver.export.values import (
    Choice,
    Number,
    Record,
    Rows,
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
    stored_in,
)
from fastcoil.deliver.export.words import RESERVED, plain_text
from fastcoil.model.numerics import elementary

_SIGNS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}  # fmt: skip
_FUNCTIONS: Mapping[str, tuple[Any, ...]] = {
    "math.exp": (math.exp, np.exp, elementary.exp), "math.log": (math.log, np.log, elementary.log),
    "math.sqrt": (math.sqrt, np.sqrt), "math.sin": (math.sin, np.sin), "math.cos": (math.cos, np.cos),
    "math.tan": (math.tan, np.tan), "math.asin": (math.asin, np.arcsin), "math.acos": (math.acos, np.arccos),
    "math.atan": (math.atan, np.arctan), "math.tanh": (math.tanh, np.tanh), "math.floor": (math.floor, np.floor),
    "abs": (abs, np.abs, math.fabs, np.fabs), "min": (min, np.minimum), "max": (max, np.maximum),
    "isnan": (math.isnan, np.isnan), "int": (int,), "float": (float,), "bool": (bool,),
}  # fmt: skip
"""What a rule may call, by the name that the laws have for it."""
KNOWN = "abs, cos, exp, floor, log, max, min, sin, sqrt, tan, tanh, their inverses"


class AgainError(Exception):
    """More than was known may be NaN, changes, or is no whole number: translate once more."""


class InlineError(Exception):
    """A function of numbers cannot stand by itself: it finds NaN, reads a table, or returns several numbers."""


@dataclass
class Unit:
    """The variables of one function of the laws.

    pool: names that are taken.  names: by what they stand for, the same in every round.  kinds: of variables.  nothing:
    those that may be NaN; beside each is a flag, ``name_known``.
    """

    pool: set[str]
    names: dict[Any, str] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    nothing: set[str] = field(default_factory=set)


class Formulas(ABC):
    """Evaluates expressions and stores what they give.

    kind, rule: law or estimator, and its name.  names: those that the laws have already.  unit: whose variables are
    made.  path: the calls that led here.  facts: conditions that hold here.  definitions: of flags, by name.  unsteady:
    variables that get several values.  bounds: largest value of each counter.  out: the statements so far.
    """

    def __init__(self, kind: str, rule: str, names: Sequence[str]) -> None:
        self.kind, self.rule, self.names, self.where = kind, rule, names, ""
        self.units: dict[Any, Unit] = {"": Unit({each.casefold() for each in (*names, *RESERVED)})}
        self.begin()

    def begin(self) -> None:
        """Begin a round: all but names, kinds and what may be NaN is found anew."""
        self.constants: dict[str, tuple[Any, str]] = {}
        self.bounds: dict[str, int] = {}
        self.unsteady: set[str] = set()
        self.enter("")

    def enter(self, unit: Any, path: tuple[Any, ...] = ()) -> None:
        """Write another function of the laws; one of numbers alone has names of its own."""
        if unit and unit not in self.units:
            pool = {*RESERVED, *(name.casefold() for name in (*self.names, *self.constants) if name.isupper())}
            self.units[unit] = Unit(pool)
        self.unit = self.units[unit]
        self.path, self.is_function = path, bool(unit)
        self.facts: set[str] = set()
        self.definitions: dict[str, ast.expr] = {}
        self.out: list[ast.stmt] = []

    def refusal(self, what: str, cure: str) -> InputError:
        """What a rule has and the languages have not."""
        where = f"{self.where}: " if self.where else ""
        return InputError(
            f"{self.kind} = {self.rule!r} cannot be exported: {where}{what}: {cure}, or export the loop with "
            f"{'an estimator' if self.kind == 'estimator' else 'the law'} of fastcoil"
        )

    # names and statements

    def named(self, wanted: str, key: Any, unit: Unit | None = None) -> str:
        """A name that all languages can have and nothing else has; key: what it stands for."""
        unit = unit or self.unit
        if (key, wanted) not in unit.names:
            name = "_".join(filter(None, plain_text(wanted).split("_"))) or "x"
            found, k = name, 1
            while unit.pool & {found.casefold(), f"{found}_known".casefold()}:
                k, found = k + 1, f"{name}_{k + 1}"
            unit.pool.add(found.casefold())
            unit.names[key, wanted] = found
        return unit.names[key, wanted]

    def local(self, wanted: str, key: Any) -> str:
        """The name of a variable in the call that led here."""
        return self.named(wanted, (self.path, key))

    def variable(self, name: str) -> Number:
        """A variable as a number."""
        needs = {f"{name}_known"} - self.facts if name in self.unit.nothing else set()
        return Number(expression(name), self.unit.kinds.get(name, "real"), None, frozenset(needs))

    @contextmanager
    def aside(self, test: ast.expr | None = None, truth: bool = True) -> Iterator[list[ast.stmt]]:
        """Collects the statements that are made inside apart, where a condition is true or false."""
        before, self.out = self.out, []
        more = set() if test is None else implied(test, truth, self.definitions) - self.facts
        self.facts |= more
        try:
            yield self.out
        finally:
            self.out = before
            self.facts -= more

    def when(self, test: ast.expr, yes: list[ast.stmt], no: list[ast.stmt]) -> None:
        """An if, or more of the one before."""
        last, text = self.out[-1] if self.out else None, ast.unparse(test)
        if isinstance(last, ast.If) and ast.unparse(last.test) == text and not stored_in([last]) & read_in(test):
            last.body, last.orelse = last.body + yes, last.orelse + no
        elif (made := conditional(test, yes, no)) is not None:
            self.out.append(made)

    def store(self, name: str, value: Number | Choice) -> None:
        """``name`` = value, and whether it is a number, where that is not certain."""
        if isinstance(value, Choice):
            blocks = []
            for side, truth in ((value.yes, True), (value.no, False)):
                with self.aside(value.test, truth) as block:
                    self.store(name, side)
                blocks.append(block)
            self.when(value.test, *blocks)
            return
        kinds, flag = self.unit.kinds, f"{name}_known"
        if not value.is_nothing and kinds.setdefault(name, "real" if name[:2] == "s." else value.kind) != value.kind:
            if kinds[name] != "real":
                kinds[name] = "real"
                raise AgainError
            self.store(name, self.real(value))
            return
        needs = value.needs - self.facts
        if (needs or value.is_nothing) and name not in self.unit.nothing:
            self.unit.nothing.add(name)
            raise AgainError
        store = assigned(name, value.text)
        if ast.unparse(value.text) == name and not value.is_nothing:
            return
        if name not in self.unit.nothing:
            self.out.append(store)
            return
        self.facts.discard(flag)
        if value.is_nothing:
            self.out.append(assigned(flag, ast.Constant(False)))
        elif needs:
            self.out += [assigned(flag, self.all_known(needs)), ast.If(expression(flag), [store], [])]
        else:
            self.out += [assigned(flag, ast.Constant(True)), store]

    def bound(self, name: str, value: Any, key: Any, many: bool = False) -> Any:
        """A value as later statements may read it; many: it is one of several that a variable gets."""
        if isinstance(value, tuple):
            return tuple(self.bound(f"{name}_{k}", one, key, many) for k, one in enumerate(value, 1))
        if isinstance(value, Record):
            parts = {
                n: one if not many and self.is_lasting(one) else self.bound(f"{name}_{n}", one, key, many)
                for n, one in value.fields.items()
            }
            return Record(value.cls, parts)
        if not isinstance(value, (Number, Choice)) or (not many and self.is_steady(value)):
            return value
        out = self.local(name, key)
        if many:
            self.unsteady.add(out)
        elif isinstance(value, Number) and value.kind == "flag" and not read_in(value.text) & self.unsteady:
            self.definitions[out] = value.text
        self.store(out, value)
        return self.variable(out)

    def is_steady(self, value: Any) -> bool:
        """Whether a value is a name or a constant that nothing changes."""
        return isinstance(value, Number) and value.is_atom and not self.unsteady & read_in(value.text)

    def is_lasting(self, value: Any) -> bool:
        """Whether a value reads nothing that changes."""
        if isinstance(value, Choice):
            return not read_in(value.test) & self.unsteady and self.is_lasting(value.yes) and self.is_lasting(value.no)
        return isinstance(value, Number) and not read_in(value.text) & {*self.unsteady, "s.w"}

    def either(self, test: ast.expr, runs: tuple[Callable[[], Any], Callable[[], Any]], name: str, key: Any) -> Any:
        """What one of two functions gives, by a condition; ``None`` where only their statements matter."""
        found, blocks = [], []
        for run, truth in zip(runs, (True, False), strict=True):
            with self.aside(test, truth) as block:
                found.append(run())
            blocks.append(block)
        if not any(isinstance(one, (Number, Choice, tuple, Record)) for one in found):
            self.when(test, *blocks)
            return found[0] if found[0] is found[1] else None
        if not any(blocks):
            return self.chosen(test, *found)
        for k, truth in enumerate((True, False)):
            with self.aside(test, truth) as block:
                found[k] = self.bound(name, found[k], key, many=True)
            blocks[k] += block
        self.when(test, *blocks)
        return self.seen(found[0])

    def chosen(self, test: ast.expr, yes: Any, no: Any) -> Any:
        """One of two values."""
        if isinstance(yes, tuple) and isinstance(no, tuple):
            return tuple(self.chosen(test, *pair) for pair in zip(yes, no, strict=True))
        if isinstance(yes, Record) and isinstance(no, Record):
            return Record(yes.cls, {n: self.chosen(test, one, no.fields[n]) for n, one in yes.fields.items()})
        for one in (yes, no):
            if not isinstance(one, (Number, Choice)):
                raise self.refusal("it chooses between classes or tables", "choose between their numbers")
        same = isinstance(yes, Number) and isinstance(no, Number) and ast.unparse(yes.text) == ast.unparse(no.text)
        return yes if same and repr(yes.value) == repr(no.value) else Choice(test, yes, no)

    def seen(self, value: Any) -> Any:
        """A number that is read here, where some flags are known to hold."""
        if isinstance(value, Number) and isinstance(value.text, (ast.Name, ast.Attribute)) and value.value is None:
            name = ast.unparse(value.text)
            if name in self.unit.nothing:
                return self.variable(name)
        return replace(value, needs=value.needs - self.facts) if isinstance(value, Number) else value

    @staticmethod
    def all_known(needs: frozenset[str]) -> ast.expr:
        """Whether all that is needed has a value."""
        return joined(ast.And(), map(expression, sorted(needs)))

    # kinds

    def number(self, value: Any) -> Number:
        """A value as an expression of its own."""
        if isinstance(value, Choice):
            name = self.local(value.name, value.key)
            self.store(name, value)
            return self.variable(name)
        if not isinstance(value, Number):
            raise self.refusal("it uses a class or a table as a number", "use its fields, or an index")
        return value

    def real(self, value: Any) -> Number:
        """A number as a real one."""
        number = self.number(value)
        if number.kind == "real":
            return number
        if number.value is not None:
            return constant(float(number.value))
        if number.kind == "whole":
            return Number(call_of("float", number.text))
        return self.number(Choice(number.text, constant(1.0), constant(0.0), "as_number"))

    def flag(self, value: Any) -> Number:
        """A truth; of a number, whether it is not 0."""
        number = self.number(value)
        if number.kind == "flag":
            return number
        if number.value is not None:
            return constant(bool(number.value))
        return self.compared(ast.NotEq(), number, constant(0 if number.kind == "whole" else 0.0))

    def whole(self, value: Any) -> Number:
        """An index, or an end of a loop."""
        number = self.number(value)
        if number.kind != "whole":
            raise self.refusal("an index or an end of a loop is no whole number", "write int(…) around it")
        return number

    # expressions

    def value(self, node: ast.expr, scope: Scope) -> Any:  # noqa: PLR0911 — one for each kind
        """What an expression gives."""
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
            return constant(node.value)
        if isinstance(node, ast.Name):
            return self.seen(self._looked_up(node.id, scope))
        if isinstance(node, ast.Attribute):
            return self.seen(self._attribute(self.value(node.value, scope), node))
        if isinstance(node, ast.Tuple):
            return tuple(self.value(one, scope) for one in node.elts)
        if isinstance(node, ast.UnaryOp):
            return self._unary(node, self.value(node.operand, scope))
        if isinstance(node, ast.BoolOp):
            return self._both(node, scope)
        if isinstance(node, ast.Compare):
            values = [self.value(one, scope) for one in (node.left, *node.comparators)]
            signs = zip(node.ops, values, values[1:], strict=False)
            return self._joined(ast.And(), [self.compared(*each) for each in signs])
        if isinstance(node, ast.BinOp):
            return self._arithmetic(node, self.value(node.left, scope), self.value(node.right, scope))
        if isinstance(node, ast.IfExp):
            test = self.flag(self.value(node.test, scope))
            if test.value is not None:
                return self.value(node.body if test.value else node.orelse, scope)
            body, orelse = node.body, node.orelse
            run = lambda: self.value(body, scope), lambda: self.value(orelse, scope)
            return self.either(test.text, run, "value", id(node))
        if isinstance(node, ast.Subscript):
            return self._element(node, scope)
        if isinstance(node, ast.Call):
            return self.call(node, scope)
        raise self.refusal(f"it has {ast.unparse(node)}", "use numbers, fields and functions of them")

    @abstractmethod
    def call(self, node: ast.Call, scope: Scope) -> Any:
        """What a call gives."""

    def _looked_up(self, name: str, scope: Scope) -> Any:
        python = scope.function
        cells = dict(zip(python.__code__.co_freevars, python.__closure__ or (), strict=True))
        if name in scope.names:
            return scope.names[name]
        if name in cells:
            return self._lifted(name, cells[name].cell_contents, "")
        if name in python.__globals__:
            return self._lifted(name, python.__globals__[name], python.__code__.co_filename)
        if hasattr(builtins, name):
            return getattr(builtins, name)
        raise self.refusal(f"{name} has no value", "give it one before it is read")

    def _lifted(self, name: str, value: Any, filename: str) -> Any:
        """A name of the module: numbers become constants of the laws; a function has them as numbers."""
        if isinstance(value, (bool, np.bool_)):
            return constant(bool(value))
        if isinstance(value, (int, float, np.number)):
            number = constant(value.item() if isinstance(value, np.number) else value)
            if self.is_function or not math.isfinite(number.value):
                return number
            return replace(number, text=ast.Name(self._module_constant(name, number.value, filename)))
        if isinstance(value, (tuple, np.ndarray)) and not hasattr(value, "_fields"):
            if np.ndim(value) != 1:
                raise self.refusal(f"{name} is a table of several dimensions", "use one table for each row")
            if self.is_function:
                raise InlineError
            numbers = tuple(np.asarray(value, dtype=float).tolist())
            return Table(self._module_constant(name, numbers, filename), numbers)
        return value

    def _module_constant(self, name: str, value: Any, filename: str) -> str:
        called = self.named(plain_text(name).strip("_").upper(), ("constant", repr(value)))
        self.constants.setdefault(called, (value, documented(filename, name)))
        return called

    def _attribute(self, of: Any, node: ast.Attribute) -> Any:
        if isinstance(of, Record) and node.attr in of.fields:
            return of.fields[node.attr]
        if isinstance(of, ModuleType) and hasattr(of, node.attr):
            value = getattr(of, node.attr)
            return constant(value) if isinstance(value, float) else value
        raise self.refusal(f"it has {ast.unparse(node)}", "use fields of what the rule is given")

    def _unary(self, node: ast.UnaryOp, value: Any) -> Number:
        if isinstance(node.op, ast.Not):
            number = self.flag(value)
            return Number(negated(number.text), "flag") if number.value is None else constant(not number.value)
        if not isinstance(node.op, ast.USub):
            raise self.refusal(f"it has {ast.unparse(node)}", "use and, or, not and -")
        number = self.number(value)
        number = self.real(number) if number.kind == "flag" else number
        if isinstance(number.text, ast.Constant):
            return constant(-number.value)
        known = None if number.value is None else -number.value
        return replace(number, text=ast.UnaryOp(ast.USub(), number.text), value=known)

    def _both(self, node: ast.BoolOp, scope: Scope) -> Number:
        """``and`` or ``or``: what stands further right is evaluated only where it matters."""
        is_and, parts = isinstance(node.op, ast.And), [self.flag(self.value(node.values[0], scope))]
        for one in node.values[1:]:
            first = self._joined(node.op, parts)
            if first.value is not None and bool(first.value) != is_and:
                return first
            with self.aside(first.text, is_and) as block:
                part = self.flag(self.value(one, scope))
            if block:
                name = self.local("holds", id(one))
                self.store(name, first)
                block.append(assigned(name, part.text))
                self.out.append(ast.If(ast.Name(name) if is_and else negated(ast.Name(name)), block, []))
                parts = [self.variable(name)]
            else:
                parts.append(part)
        return self._joined(node.op, parts)

    @staticmethod
    def _joined(sign: ast.boolop, parts: list[Number]) -> Number:
        """Flags joined by and, or by or, without those that are known."""
        is_and = isinstance(sign, ast.And)
        if any(one.value is not None and bool(one.value) != is_and for one in parts):
            return constant(not is_and)
        unknown = [one.text for one in parts if one.value is None]
        return Number(joined(sign, unknown), "flag") if unknown else constant(is_and)

    def compared(self, sign: ast.cmpop, left: Any, right: Any) -> Number:
        """Whether a comparison holds, which none with NaN does but !=."""
        if type(sign) not in _SIGNS:
            raise self.refusal("it has is or in", "compare numbers")
        for one, other in ((left, right), (right, left)):
            if isinstance(one, Choice) and isinstance(one.yes, Number) and isinstance(one.no, Number):
                sides = [self.compared(sign, *((k, other) if one is left else (other, k))) for k in (one.yes, one.no)]
                yes, no = (side.value for side in sides)
                if yes is not None and no is not None:
                    return constant(yes) if yes == no else Number(one.test if yes else negated(one.test), "flag")
        left, right = (self.number(one) for one in (left, right))
        left, right = (self.real(one) if one.kind == "flag" else one for one in (left, right))
        if left.is_nothing or right.is_nothing:
            return constant(isinstance(sign, ast.NotEq))
        if left.value is not None and right.value is not None:
            return constant(bool(_SIGNS[type(sign)](left.value, right.value)))
        if left.kind != right.kind:
            left, right = self.real(left), self.real(right)
        flags = [expression(one) for one in sorted((left.needs | right.needs) - self.facts)]
        test: ast.expr = ast.Compare(left.text, [sign], [right.text])
        if isinstance(sign, ast.NotEq):
            return Number(joined(ast.Or(), [*map(negated, flags), test]), "flag")
        return Number(joined(ast.And(), [*flags, test]), "flag")

    def _arithmetic(self, node: ast.BinOp, left: Any, right: Any) -> Number:
        left, right, sign = self.number(left), self.number(right), node.op
        if isinstance(sign, (ast.BitAnd, ast.BitOr)) and left.kind == right.kind == "flag":
            return self._joined(ast.And() if isinstance(sign, ast.BitAnd) else ast.Or(), [left, right])
        left, right = (self.real(one) if one.kind == "flag" else one for one in (left, right))
        if isinstance(sign, ast.Pow):
            return self._power(left, right)
        if isinstance(sign, (ast.FloorDiv, ast.Mod)):
            return self._divided(sign, left, right)
        if type(sign) not in _SIGNS:
            raise self.refusal(f"it has {ast.unparse(node)}", "use + - * / ** % and //")
        return self._calculated(sign, left, right)

    def _calculated(self, sign: ast.operator, left: Number, right: Number) -> Number:
        """Left + - * / right."""
        if left.kind != right.kind or isinstance(sign, ast.Div):
            left, right = self.real(left), self.real(right)
        for one, other in ((left, right), (right, left)):
            if isinstance(sign, ast.Mult) and isinstance(one.text, ast.Constant) and one.value == 1:
                return other
        value = None
        if left.value is not None and right.value is not None:
            with np.errstate(all="ignore"):
                value = _SIGNS[type(sign)](np.float64(left.value), np.float64(right.value)).item()
            value = int(value) if left.kind == "whole" else value
            if not math.isfinite(value) or (left.is_literal and right.is_literal):
                return constant(value)
        return Number(ast.BinOp(left.text, sign, right.text), left.kind, value, left.needs | right.needs)

    def _divided(self, sign: ast.operator, left: Number, right: Number) -> Number:
        """Left // right, or left % right."""
        if left.kind == right.kind == "whole" and isinstance(sign, ast.FloorDiv):
            ratio = self._calculated(ast.Div(), self.real(left), self.real(right))
            return Number(call_of("int", ratio.text), "whole")
        left, right = self.real(left), self.real(right)
        floor = self.mathematics("math.floor", [self._calculated(ast.Div(), left, right)])
        if isinstance(sign, ast.FloorDiv):
            return floor
        return self._calculated(ast.Sub(), left, self._calculated(ast.Mult(), floor, right))

    def _power(self, left: Number, right: Number) -> Number:
        if right.value not in (2, 3):
            left, right = self.real(left), self.real(right)
            value = None if None in (left.value, right.value) else left.value**right.value
            return Number(call_of("math.pow", left.text, right.text), "real", value, left.needs | right.needs)
        if not left.is_atom:
            name = self.local("x", ast.unparse(left.text))
            self.store(name, left)
            left = self.variable(name)
        square = self._calculated(ast.Mult(), left, left)
        return square if right.value == 2 else self._calculated(ast.Mult(), square, left)

    def _element(self, node: ast.Subscript, scope: Scope) -> Any:
        of = self.value(node.value, scope)
        if not isinstance(of, (tuple, Table, Rows)):
            raise self.refusal(f"it has {ast.unparse(node)}", "use a table of numbers and an index in whole numbers")
        index = self.whole(self.value(node.slice, scope))
        if index.value is not None and isinstance(of, tuple):
            return of[index.value]
        if index.value is not None and isinstance(of, Table):
            return constant(of.values[index.value])
        return Number(ast.Subscript(expression(of.name if isinstance(of, Table) else "s.w"), index.text))

    @staticmethod
    def known_function(function: Any) -> str:
        """The laws' name for a function of mathematics; empty for any other."""
        return next((name for name, same in _FUNCTIONS.items() if any(function is one for one in same)), "")

    def mathematics(self, name: str, given: list[Any]) -> Number:
        """The value of a function that the languages have."""
        if name == "bool":
            return self.flag(given[0])
        numbers = [self.number(one) for one in given]
        if name == "isnan":
            needs = numbers[0].needs - self.facts
            if needs:
                return Number(negated(self.all_known(frozenset(needs))), "flag")
            return constant(numbers[0].is_nothing)
        is_whole = name in ("min", "max", "abs") and all(one.kind == "whole" for one in numbers)
        numbers = numbers if is_whole else [self.real(one) for one in numbers]
        if name == "float":
            return numbers[0]
        while len(numbers) > 2:
            numbers = [self.mathematics(name, numbers[:2]), *numbers[2:]]
        values = [one.value for one in numbers]
        value = None if None in values else _FUNCTIONS[name][0](*values)
        kind = "whole" if is_whole or name == "int" else "real"
        value = value if value is None or kind == "whole" else float(value)
        needs = frozenset().union(*(one.needs for one in numbers))
        return Number(call_of(name, *(one.text for one in numbers)), kind, value, needs)

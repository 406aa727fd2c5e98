"""Symbols in place of numbers: what the Python of a rule computes with while it is translated.

A ``Number`` is the text of an expression with its kind, its value where the loop decides it, and the flags that say
whether it is a number at all, and not NaN.  ``Symbols`` gives names to intermediate values and collects statements.
"""

from __future__ import annotations

import ast
import math
import operator
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FunctionType
from typing import Any

from fastcoil.base.errors import InputError
from fastcoil.deliver.export.trees import (
    LARGEST,
    call_of,
    conjunction,
    expression,
    implied,
    negated,
    read_in,
)
from fastcoil.deliver.export.words import RESERVED, plain_text

SIGNS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}  # fmt: skip


MATHEMATICS = {
    "exp": math.exp, "log": math.log, "sqrt": math.sqrt, "sin": math.sin, "cos": math.cos, "tan": math.tan,
    "arcsin": math.asin, "arccos": math.acos, "arctan": math.atan, "floor": math.floor, "tanh": math.tanh,
    "abs": abs, "min": min, "max": max, "isnan": math.isnan,
}  # fmt: skip
"""Functions of one number, and abs, min and max, by the name that NumPy has for them."""


OTHER_NAMES = {"asin": "arcsin", "acos": "arccos", "atan": "arctan", "fabs": "abs", "absolute": "abs",
                "minimum": "min", "maximum": "max"}  # fmt: skip


IN_MATH = {"arcsin": "asin", "arccos": "acos", "arctan": "atan"}


@dataclass(frozen=True, eq=False)
class Number:
    """The text of a number, a flag or a whole number, by its kind.

    value: where the loop decides it.  needs: flags that all hold if it is a number, and not NaN.
    """

    text: ast.expr
    kind: str = "real"
    value: Any = None
    needs: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class Later:
    """An argument of a class that is evaluated where it is used."""

    node: ast.expr
    scope: Scope


@dataclass(frozen=True)
class Record:
    """A named tuple."""

    cls: Any
    fields: dict[str, Any]


@dataclass(frozen=True)
class Table:
    """A tuple or an array of constant numbers."""

    name: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Rows:
    """The array of an estimator's state."""

    text: ast.expr


@dataclass
class Scope:
    """One call of a function: what its names stand for, and how they are called in the code."""

    function: FunctionType
    definition: ast.FunctionDef
    names: dict[str, Any]
    called: dict[str, str] = field(default_factory=dict)
    stored: Counter[str] = field(default_factory=Counter)
    loaded: Counter[str] = field(default_factory=Counter)
    blocks: list[list[ast.stmt]] = field(default_factory=list)
    hint: str = "found"

    def __post_init__(self) -> None:
        for node in ast.walk(self.definition):
            if isinstance(node, ast.Name):
                (self.loaded if isinstance(node.ctx, ast.Load) else self.stored)[node.id] += 1
            if isinstance(node, (ast.AugAssign, ast.For)) and isinstance(node.target, ast.Name):
                self.stored[node.target.id] += 1

    def is_final(self, name: str) -> bool:
        """Whether a name that is given a value here has it wherever it is read."""
        inside = [n.id for top in self.blocks[-1] for n in ast.walk(top) if isinstance(n, ast.Name)]
        here = sum(n == name for n in inside) - self.stored[name]
        return self.stored[name] == 1 and here == self.loaded[name]


class AgainError(Exception):
    """Something more than was known may be NaN, change, or be no whole number: translate once more."""


class SeesConstantsError(Exception):
    """A function reads a table: Structured Text hides it from functions."""


def constant(value: Any) -> Number:
    """A number as it is, without a name."""
    if isinstance(value, bool):
        return Number(ast.Constant(value), "flag", value)
    if isinstance(value, int):
        return Number(ast.Constant(value), "whole", value)
    value = float(value)
    if math.isinf(value):  # the largest number stands for it, which nothing exceeds
        value = math.copysign(LARGEST, value)
    if math.isnan(value):
        return NOTHING
    text: ast.expr = ast.Constant(abs(value))
    return Number(ast.UnaryOp(ast.USub(), text) if math.copysign(1.0, value) < 0.0 else text, "real", value)


NOTHING = Number(ast.Constant(0.0), "real", math.nan)


def number_of(text: ast.expr) -> Number:
    """The number that is written."""
    return constant(ast.literal_eval(text))


def is_plain(number: Number) -> bool:
    """Whether a number is a name or a constant: it may stand wherever it is read."""
    text = number.text.operand if isinstance(number.text, ast.UnaryOp) else number.text
    return isinstance(text, (ast.Constant, ast.Name, ast.Attribute)) or (
        isinstance(text, ast.IfExp) and isinstance(text.test, ast.Attribute)
    )


class Symbols:
    """The names and the statements that a rule becomes."""

    def __init__(
        self, kind: str, name: str, step: Any, start: Any, Parameters: Any, Memory: Any,  # noqa: N803 — classes
        numbers: Mapping[str, float], *, words: int = 0, estimate: str = "s.estimate", taken: Sequence[str] = (),
        neutral: frozenset[str] = frozenset(), literal: frozenset[str] = frozenset(),
    ) -> None:  # fmt: skip
        self.kind, self.rule, self.step, self.start, self.words = kind, name, step, start, words
        self.Parameters, self.Memory, self.numbers, self.estimate = Parameters, Memory, numbers, estimate
        self.neutral, self.literal = neutral, literal
        self.taken = {each.casefold() for each in (*taken, *RESERVED)}
        names = [*numbers, *Memory._fields]
        self.taken |= {each.upper().casefold() for each in numbers}
        self.fields = {each: self._named(each, "_kept") for each in Memory._fields}
        self.taken |= {f"{each}_known".casefold() for each in names}
        self.nothing: set[str] = set()
        """Variables that may be NaN."""
        self.changing: set[str] = set()
        """Fields of the memory that do not keep their first value."""
        self.kinds: dict[str, str] = {}
        self.where = ""
        self.path: tuple[Any, ...] = ()
        self.found_names: dict[Any, str] = {}
        self.pool = set(self.taken) | {each.casefold() for each in self.fields.values()}
        self._begin()

    def _begin(self) -> None:
        """Begin a round: all but the names, and what may be NaN or change, is found anew."""
        self.constants: dict[str, tuple[Any, str]] = {}
        self.functions: dict[Any, tuple[str, str, str]] = {}
        self.sections: dict[Any, tuple[str, str, str]] = {}
        self.definitions: dict[str, ast.expr] = {}
        """Flags by name: the condition that each stands for."""
        self.facts: set[str] = set()
        """Conditions that hold here."""
        self.said: set[tuple[str, int]] = set()
        self.unsteady: set[str] = set()
        """Names that get more than one value."""
        self.bounds: dict[str, int] = {}
        """Largest value of each loop's counter."""
        self.at_first: dict[str, Any] = {}
        """The fields that keep their first value, as far as is known."""
        self.out: list[ast.stmt] = []
        self.as_function = self.is_start = False
        self.path = ()

    def _parameter(self, name: str) -> Number:
        value = float(self.numbers[name])
        return constant(value) if name in self.literal else Number(ast.Name(name.upper()), "real", value)

    def _variable(self, text: str) -> Number:
        needs = frozenset({f"{text}_known"}) if text in self.nothing else frozenset()
        return Number(expression(text), self.kinds.get(text, "real"), None, needs)

    def _refusal(self, what: str, cure: str) -> InputError:
        where = f"{self.where}: " if self.where else ""
        return InputError(
            f"{self.kind} = {self.rule!r} cannot be exported: {where}{what}: {cure}, or export the loop with "
            f"{'an estimator' if self.kind == 'estimator' else 'the law'} of fastcoil"
        )

    def _named(self, wanted: str, suffix: str = "") -> str:
        """A name that all three languages can have, and that nothing else has."""
        name = plain_text(wanted).strip("_") or "x"
        while "__" in name:
            name = name.replace("__", "_")
        k, found = 1, name
        while found.casefold() in self.taken:
            k, found = k + 1, f"{name}{suffix}" if suffix and k == 1 else f"{name}_{k + 1}"
        self.taken.add(found.casefold())
        return found

    def _local(self, wanted: str, place: Any = None) -> str:
        """A name of an intermediate value, the same in every round."""
        name = plain_text(wanted).strip("_").replace("__", "_") or "x"
        key = (self.path, place, name)
        if place is not None and key in self.found_names:
            return self.found_names[key]
        found, k = name, 1
        while found.casefold() in self.pool or f"{found}_known".casefold() in self.pool:
            k, found = k + 1, f"{name}_{k + 1}"
        self.pool.add(found.casefold())
        self.found_names[key] = found
        return found

    @contextmanager
    def _aside(self, test: ast.expr | None = None, truth: bool = True) -> Iterator[list[ast.stmt]]:
        """Collects the statements that are made inside apart from the others, where a condition is true or false."""
        made: list[ast.stmt] = []
        before, self.out = self.out, made
        more = set() if test is None else implied(test, truth, self.definitions) - self.facts
        self.facts |= more
        try:
            yield made
        finally:
            self.out = before
            self.facts -= more

    def _when(self, test: ast.expr, body: list[ast.stmt], orelse: list[ast.stmt]) -> None:
        if body and orelse and ast.dump(ast.Module(body, [])) == ast.dump(ast.Module(orelse, [])):
            self.out += body
        elif body:
            self.out.append(ast.If(test, body, orelse))
        elif orelse:
            self.out.append(ast.If(negated(test), orelse, []))

    def _emit(self, *nodes: ast.stmt) -> None:
        self.out += nodes

    def _store(self, name: str, value: Number) -> None:
        """``name`` = value, and whether it is a number, where that is not certain."""
        if name in self.at_first and repr(self.at_first[name]) == repr(value.value):
            return
        if value.value is None or isinstance(value.value, bool) or not math.isnan(value.value):
            kind = self.kinds.setdefault(name, value.kind)
            if name.startswith("s.") or kind != value.kind:
                self._become(name, "real")
                value = self._real(value)
        needs = value.needs - self.facts
        is_nothing = value.value is not None and not isinstance(value.value, bool) and math.isnan(value.value)
        if (needs or is_nothing) and name not in self.nothing:
            self.nothing.add(name)
            raise AgainError
        if ast.unparse(value.text) == name and not is_nothing:
            return
        if name not in self.nothing:
            self._emit(ast.Assign([expression(name)], value.text))
            return
        flag = f"{name}_known"
        self.facts.discard(flag)
        store = ast.Assign([expression(name)], value.text)
        if is_nothing:
            self._emit(ast.Assign([expression(flag)], ast.Constant(False)))
        elif not needs:
            self._emit(ast.Assign([expression(flag)], ast.Constant(True)), store)
        else:
            test = conjunction(map(expression, sorted(needs)))
            self._emit(ast.Assign([expression(flag)], test), ast.If(expression(flag), [store], []))

    def _become(self, name: str, kind: str) -> None:
        if self.kinds.get(name, kind) != kind:
            self.kinds[name] = kind
            raise AgainError
        self.kinds[name] = kind

    def _is_steady(self, number: Number) -> bool:
        """Whether a number is a name or a constant that nothing changes later."""
        return is_plain(number) and not self.unsteady & read_in(ast.Expression(number.text))

    def _kept(self, name: str, like: Any) -> Any:
        if isinstance(like, tuple):
            return tuple(self._kept(f"{name}_{k + 1}", one) for k, one in enumerate(like))
        if isinstance(like, Record):
            return Record(like.cls, {n: self._kept(f"{name}_{n}", one) for n, one in like.fields.items()})
        return self._variable(name)

    def _plain_choice(self, number: Number) -> Number:
        """A number without a conditional expression."""
        if not any(isinstance(one, ast.IfExp) for one in ast.walk(number.text)):
            return number
        name = self._local("mode", ast.dump(number.text))
        choice: Any = number.text
        self._when(
            choice.test, [ast.Assign([ast.Name(name)], choice.body)], [ast.Assign([ast.Name(name)], choice.orelse)]
        )
        self.kinds[name] = "real"
        return Number(ast.Name(name))

    def _real(self, number: Number) -> Number:
        """A number as a real one."""
        number = self._plain_choice(number)
        if number.kind == "real":
            return number
        if number.kind == "whole" and number.value is None:
            return Number(call_of("float", number.text))
        if number.value is not None:
            return constant(float(number.value))
        name = self._local("as_number", ast.dump(number.text))
        self.kinds[name] = "real"
        self._when(
            number.text,
            [ast.Assign([ast.Name(name)], ast.Constant(1.0))],
            [ast.Assign([ast.Name(name)], ast.Constant(0.0))],
        )
        return Number(ast.Name(name))

    def _is_neutral(self, number: Number) -> bool:
        """Whether a factor of 1 is left out: a number as such, or a parameter that is at its default."""
        text = number.text
        named = isinstance(text, ast.Name) and text.id.lower() in self.neutral
        return number.value == 1.0 and (named or isinstance(text, ast.Constant))

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
    assignment,
    call_of,
    constant,
    expression,
    if_statement,
    implied_conditions,
    join_conditions,
    names_read_in,
    negation,
)
from fastcoil.deliver.export.words import RESERVED_WORDS, plain_text
from fastcoil.model.numerics import elementary

_OPERATORS: Mapping[type, Callable[[Any, Any], Any]] = {
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
SUPPORTED_FUNCTIONS = "abs, cos, exp, floor, log, max, min, sin, sqrt, tan, tanh, their inverses"
SUPPORTED_SYNTAX = (
    "assignments, if, for k in range(…), return, numbers, tables of them, + - * / ** % // and comparisons"
)


class TranslateAgainError(Exception):
    """More than was known may be NaN, changes, or is no whole number: translate once more."""


class Formulas(ABC):
    """Evaluates expressions, and collects statements and the variables in them."""

    def __init__(self, kind: str, rule: str, names: Sequence[str]) -> None:
        self.kind, self.rule, self.where = kind, rule, ""  # law or estimator, and its name
        self.taken_names = {name.casefold() for name in (*names, *RESERVED_WORDS)}  # names that are taken
        self.names: dict[Any, str] = {}  # by what they stand for, the same in every round
        self.kinds: dict[str, str] = {}  # of variables
        self.may_be_nan: set[str] = set()  # those that may be NaN; beside each is a flag, ``name_known``
        self.out: list[ast.stmt] = []  # the statements so far
        self._begin()

    def _begin(self) -> None:
        """Begin a round: all but names, kinds and what may be NaN is found anew."""
        self.constants: dict[str, Any] = {}
        self.reassigned_names: set[str] = set()  # variables that get several values
        self._begin_function()

    def _begin_function(self) -> list[ast.stmt]:
        """Begin another function of the laws.  Returns the statements of the one before."""
        previous_statements = self.out
        self.path: Any = ()  # the calls that led here
        self.wanted_name = "value"  # the name of what is evaluated
        self.true_conditions: set[str] = set()  # conditions that hold here
        self.definitions: dict[str, ast.expr] = {}  # of flags, by name
        self.out = []
        return previous_statements

    def _refusal(self, problem: str, cure: str) -> InputError:
        place = f"{self.where}: " if self.where else ""
        return InputError(
            f"{self.kind} = {self.rule!r} cannot be exported: {place}{problem}: {cure}, or export the loop with "
            f"{'an estimator' if self.kind == 'estimator' else 'the law'} of fastcoil"
        )

    def _unsupported_syntax(self, node: ast.AST) -> InputError:
        return self._refusal(f"it has {ast.unparse(node)}", f"use {SUPPORTED_SYNTAX}")

    def _unique_name(self, preferred: str, key: Any) -> str:
        """A name that all languages can have and nothing else has; key: what it stands for."""
        if (key, preferred) not in self.names:
            name = "_".join(filter(None, plain_text(preferred).split("_"))) or "x"
            candidate, k = name, 1
            while self.taken_names & {candidate.casefold(), f"{candidate}_known".casefold()}:
                k, candidate = k + 1, f"{name}_{k + 1}"
            self.taken_names.add(candidate.casefold())
            self.names[key, preferred] = candidate
        return self.names[key, preferred]

    def _local_name(self, preferred: str, key: Any) -> str:
        """The name of a variable in the call that led here."""
        return self._unique_name(preferred, (self.path, key))

    def _variable(self, name: str) -> Number:
        needs = frozenset({f"{name}_known"} & {f"{variable}_known" for variable in self.may_be_nan})
        return Number(expression(name), self.kinds.get(name, "real"), None, needs)

    def _known_flags(self, *numbers: Number) -> list[ast.expr]:
        """Flags that hold where numbers are none of them NaN, without those that hold here anyway."""
        needs = frozenset().union(*(number.known_flags for number in numbers)) - self.true_conditions
        return [expression(flag) for flag in sorted(needs)]

    # statements

    @contextmanager
    def _separate_block(self, test: ast.expr | None = None, truth: bool = True) -> Iterator[list[ast.stmt]]:
        """Collects the statements that are made inside apart, where a condition is true or false."""
        outer_statements, self.out = self.out, []
        new_conditions = (
            set() if test is None else implied_conditions(test, truth, self.definitions) - self.true_conditions
        )
        self.true_conditions |= new_conditions
        try:
            yield self.out
        finally:
            self.out = outer_statements
            self.true_conditions -= new_conditions

    def _branch(
        self, test: ast.expr, runs: tuple[Callable[[], Any], Callable[[], Any]], name: str = "", key: Any = None
    ) -> Any:
        """What one of two functions gives, by a condition; ``None`` where only their statements matter."""
        results, blocks = [], []
        for run, truth in zip(runs, (True, False), strict=True):
            with self._separate_block(test, truth) as block:
                results.append(run())
            blocks.append(block)
        value = results[0]
        if value is not results[1]:
            value = self._merge_branches(name, (results[0], results[1]), key, test, blocks)
        self.out += if_statement(test, *blocks)
        return value

    def _merge_branches(
        self, name: str, pair: tuple[Any, Any], key: Any, test: ast.expr, blocks: list[list[ast.stmt]]
    ) -> Any:
        """One of two values, which blocks of statements store in a variable where they differ."""
        yes, no = pair
        if isinstance(yes, dict):  # a tuple, by name or place
            return {n: self._merge_branches(f"{name}_{n}", (part, no[n]), key, test, blocks) for n, part in yes.items()}
        is_alike = repr(yes.value) == repr(no.value) and ast.unparse(yes.text) == ast.unparse(no.text)
        if is_alike and self._is_steady(yes):
            return yes
        out = self._local_name(name, key)
        for block, value, truth in zip(blocks, pair, (True, False), strict=True):
            with self._separate_block(test, truth) as stored:
                self._store(out, value)
            block.extend(stored)
        return self._variable(out)

    def _store(self, name: str, value: Number) -> None:
        """``name`` = value, and whether it is a number, where that is not certain."""
        kinds, flag = self.kinds, f"{name}_known"
        if not value.is_nan and kinds.setdefault(name, "real" if name[:2] == "s." else value.kind) != value.kind:
            if kinds[name] != "real":
                kinds[name] = "real"
                raise TranslateAgainError
            value = self._real(value)
        needs = self._known_flags(value)
        if (needs or value.is_nan) and name not in self.may_be_nan:
            self.may_be_nan.add(name)
            raise TranslateAgainError
        store: list[ast.stmt] = [assignment(name, value.text)]
        if ast.unparse(value.text) == name and not value.is_nan:
            return
        if name in self.may_be_nan:
            is_known = ast.Constant(not value.is_nan) if not needs else join_conditions(ast.And(), needs)
            self.true_conditions.discard(flag)
            self.out.append(assignment(flag, is_known))
            store = [ast.If(expression(flag), store, [])] if needs else store
        self.out += [] if value.is_nan else store

    def _bind(self, name: str, value: Any, key: Any, is_reassigned: bool = False) -> Any:
        """A value as later statements may read it; many: it is one of several that a variable gets."""
        if isinstance(value, dict):
            return {
                n: part
                if not is_reassigned and self._is_steady(part)
                else self._bind(f"{name}_{n}", part, key, is_reassigned)
                for n, part in value.items()
            }
        if not isinstance(value, Number) or (not is_reassigned and value.is_atom and self._is_steady(value)):
            return value
        out = self._local_name(name, key)
        if is_reassigned:
            self.reassigned_names.add(out)
        elif value.kind == "flag" and self._is_steady(value):
            self.definitions[out] = value.text
        self._store(out, value)
        return self._variable(out)

    def _is_steady(self, value: Any) -> bool:
        """Whether a value reads nothing that changes."""
        return isinstance(value, Number) and not names_read_in(value.text) & {*self.reassigned_names, "s.w"}

    # kinds

    def _real(self, number: Number) -> Number:
        if number.kind == "real":
            return number
        if number.value is not None:
            return constant(float(number.value))
        if number.kind == "whole":
            return Number(call_of("float", number.text))
        numbers = (lambda: constant(1.0), lambda: constant(0.0))
        converted: Number = self._branch(number.text, numbers, "as_number", ast.unparse(number.text))
        return converted

    # expressions

    def _value_of(self, name: str, node: ast.expr, scope: Scope) -> Any:
        """A value that will have a name."""
        outer_name, self.wanted_name = self.wanted_name, name
        value = self._value(node, scope)
        self.wanted_name = outer_name
        return value

    def _value(self, node: ast.expr, scope: Scope) -> Any:  # noqa: PLR0911 — one for each kind
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
            return constant(node.value)
        if isinstance(node, ast.Name):
            return self._look_up(node.id, scope)
        if isinstance(node, ast.Attribute):
            return self._attribute(self._value(node.value, scope), node)
        if isinstance(node, ast.Tuple):
            return {str(k): self._value(part, scope) for k, part in enumerate(node.elts)}
        if isinstance(node, ast.UnaryOp):
            return self._unary(node, self._value(node.operand, scope))
        if isinstance(node, ast.BoolOp):
            return self._evaluate_bool_op(node, scope)
        if isinstance(node, ast.Compare):
            values = [self._value(part, scope) for part in (node.left, *node.comparators)]
            signs = zip(node.ops, values, values[1:], strict=False)
            return self._join_flags(ast.And(), [self._compare(*comparison) for comparison in signs])
        if isinstance(node, ast.BinOp):
            sides = (self._value(part, scope) for part in (node.left, node.right))
            left, right = (self._real(part) if part.kind == "flag" else part for part in sides)
            return self._arithmetic(node.op, left, right)
        if isinstance(node, ast.IfExp):
            test, body, orelse = self._flag(self._value(node.test, scope)), node.body, node.orelse
            if test.value is not None:
                return self._value(body if test.value else orelse, scope)
            runs = (lambda: self._value(body, scope), lambda: self._value(orelse, scope))
            return self._branch(test.text, runs, self.wanted_name, id(node))
        if isinstance(node, ast.Subscript):
            return self._element(node, scope)
        if isinstance(node, ast.Call):
            return self._call(node, scope)
        raise self._unsupported_syntax(node)

    @abstractmethod
    def _call(self, node: ast.Call, scope: Scope) -> Any: ...

    # names

    def _look_up(self, name: str, scope: Scope) -> Any:
        python = scope.function
        cells = dict(zip(python.__code__.co_freevars, python.__closure__ or (), strict=True))
        if name in scope.names:
            return scope.names[name]
        if name in cells:
            return self._lift_constant(name, cells[name].cell_contents)
        if name in python.__globals__:
            return self._lift_constant(name, python.__globals__[name])
        return getattr(builtins, name)

    def _lift_constant(self, name: str, value: Any) -> Any:
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
        constant_name = self._unique_name(plain_text(name).strip("_").upper(), ("constant", repr(value)))
        self.constants[constant_name] = value
        return constant_name

    def _attribute(self, of: Any, node: ast.Attribute) -> Any:
        if isinstance(of, dict) and node.attr in of:
            return of[node.attr]
        if isinstance(of, ModuleType) and hasattr(of, node.attr):
            value = getattr(of, node.attr)
            return constant(value) if isinstance(value, float) else value
        raise self._unsupported_syntax(node)

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
            return self._compare(ast.NotEq(), number, constant(0 if number.kind == "whole" else 0.0))
        return number

    @staticmethod
    def _join_flags(sign: ast.boolop, parts: list[Number]) -> Number:
        """Flags joined by and, or by or, without those that are known."""
        is_and = isinstance(sign, ast.And)
        if any(part.value is not None and bool(part.value) != is_and for part in parts):
            return constant(not is_and)
        unknown = [part.text for part in parts if part.value is None]
        return Number(join_conditions(sign, unknown), "flag") if unknown else constant(is_and)

    def _evaluate_bool_op(self, node: ast.BoolOp, scope: Scope) -> Number:
        """``and`` or ``or``: what stands further right is evaluated only where it matters."""
        is_and, parts = isinstance(node.op, ast.And), [self._flag(self._value(node.values[0], scope))]
        for operand in node.values[1:]:
            first = self._join_flags(node.op, parts)
            if first.value is not None and bool(first.value) != is_and:
                return first
            with self._separate_block(first.text, is_and) as block:
                parts.append(self._flag(self._value(operand, scope)))
            if block:
                name = self._local_name("holds", id(operand))
                self._store(name, first)
                block.append(assignment(name, parts[-1].text))
                self.out.append(ast.If(ast.Name(name) if is_and else negation(ast.Name(name)), block, []))
                parts = [self._variable(name)]
        return self._join_flags(node.op, parts)

    def _compare(self, sign: ast.cmpop, left: Number, right: Number) -> Number:
        """Whether a comparison holds, which none with NaN does but !=."""
        holds = _OPERATORS[type(sign)]
        left, right = (self._real(side) if side.kind == "flag" else side for side in (left, right))
        if left.is_nan or right.is_nan:
            return constant(isinstance(sign, ast.NotEq))
        if left.value is not None and right.value is not None:
            return constant(bool(holds(left.value, right.value)))
        if left.kind != right.kind:
            left, right = self._real(left), self._real(right)
        flags, test = self._known_flags(left, right), ast.Compare(left.text, [sign], [right.text])
        if isinstance(sign, ast.NotEq):
            return Number(join_conditions(ast.Or(), [*map(negation, flags), test]), "flag")
        return Number(join_conditions(ast.And(), [*flags, test]), "flag")

    # arithmetic

    def _unary(self, node: ast.UnaryOp, value: Number) -> Number:
        if isinstance(node.op, ast.Not):
            number = self._flag(value)
            return Number(negation(number.text), "flag") if number.value is None else constant(not number.value)
        if not isinstance(node.op, ast.USub):
            raise self._unsupported_syntax(node)
        number = self._real(value) if value.kind == "flag" else value
        if isinstance(number.text, ast.Constant):
            return constant(-number.value)
        result = None if number.value is None else -number.value
        return replace(number, text=ast.UnaryOp(ast.USub(), number.text), value=result)

    def _arithmetic(self, sign: ast.operator, left: Number, right: Number) -> Number:
        if isinstance(sign, ast.Pow):
            return self._power(left, right)
        if isinstance(sign, (ast.FloorDiv, ast.Mod)):
            is_whole = left.kind == right.kind == "whole" and isinstance(sign, ast.FloorDiv)
            ratio = self._arithmetic(ast.Div(), left, right)
            floor = self._apply_function("int" if is_whole else "math.floor", [ratio])
            if isinstance(sign, ast.FloorDiv):
                return floor
            return self._arithmetic(ast.Sub(), left, self._arithmetic(ast.Mult(), floor, right))
        operation = _OPERATORS[type(sign)]
        if left.kind != right.kind or isinstance(sign, ast.Div):
            left, right = self._real(left), self._real(right)
        if isinstance(sign, ast.Mult):
            for factor, other_factor in ((left, right), (right, left)):
                if isinstance(factor.text, ast.Constant) and factor.value == 1:
                    return other_factor
        value = None
        if left.value is not None and right.value is not None:
            with np.errstate(all="ignore"):
                value = operation(np.float64(left.value), np.float64(right.value)).item()
            value = int(value) if left.kind == "whole" else value
            are_literals = isinstance(left.text, ast.Constant) and isinstance(right.text, ast.Constant)
            if are_literals or not math.isfinite(value):
                return constant(value)
        return Number(ast.BinOp(left.text, sign, right.text), left.kind, value, left.known_flags | right.known_flags)

    def _power(self, left: Number, right: Number) -> Number:
        if right.value not in (2, 3):
            left, right = self._real(left), self._real(right)
            return Number(call_of("math.pow", left.text, right.text), known_flags=left.known_flags | right.known_flags)
        if not left.is_atom:
            name = self._local_name("x", ast.unparse(left.text))
            self._store(name, left)
            left = self._variable(name)
        square = self._arithmetic(ast.Mult(), left, left)
        return square if right.value == 2 else self._arithmetic(ast.Mult(), square, left)

    def _apply_function(self, name: str, arguments: list[Number]) -> Number:
        """The value of a function that the languages have."""
        if name == "bool":
            return self._flag(arguments[0])
        if name == "isnan":
            needs = self._known_flags(arguments[0])
            return (
                Number(negation(join_conditions(ast.And(), needs)), "flag") if needs else constant(arguments[0].is_nan)
            )
        is_whole = name in ("min", "max", "abs") and all(number.kind == "whole" for number in arguments)
        numbers = arguments if is_whole else [self._real(number) for number in arguments]
        if name == "float":
            return numbers[0]
        while len(numbers) > 2:
            numbers = [self._apply_function(name, numbers[:2]), *numbers[2:]]
        kind = "whole" if is_whole or name == "int" else "real"
        value = None
        if all(number.value is not None for number in numbers):
            value = FUNCTIONS[name][0](*(number.value for number in numbers))
            value = value if kind == "whole" else float(value)
        all_flags = frozenset().union(*(number.known_flags for number in numbers))
        return Number(call_of(name, *(number.text for number in numbers)), kind, value, all_flags)

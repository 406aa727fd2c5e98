"""Evaluate expressions of a rule: what the loop's parameters decide becomes a value, the rest stays an expression."""

import ast
import builtins
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np

from fastcoil.base.errors import InputError
from fastcoil.deliver.export.words import RESERVED_WORDS, plain_text
from fastcoil.model.numerics import elementary

from fastcoil.deliver.export.values import (  # isort: skip
    Number, Scope, Table, assignment, call_of, constant, expression, if_statement, implied_conditions, join_conditions,
    names_read_in, negation,
)  # fmt: skip

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
"""Functions that a rule may call, by their name in the laws."""
ALLOWED_FUNCTIONS = "abs, cos, exp, floor, log, max, min, sin, sqrt, tan, tanh, their inverses"
ALLOWED_SYNTAX = "assignments, if, for k in range(…), return, numbers, tables of them, + - * / ** % // and comparisons"


class TranslateAgainError(Exception):
    """A variable turned out to be real, or to be NaN at times: translate once more."""


class Formulas(ABC):
    """Evaluates expressions, and collects statements and the variables in them."""

    def __init__(self, kind: str, rule: str, names: Sequence[str]) -> None:
        self.kind, self.rule, self.source_line = kind, rule, ""  # law or estimator, and its name
        self.taken_names = {name.casefold() for name in (*names, *RESERVED_WORDS)}
        self.names: dict[Any, str] = {}  # by what they stand for, the same in every round
        self.kinds: dict[str, str] = {}  # of variables
        self.may_be_nan: set[str] = set()  # variables; each has a flag, ``name_known``
        self.statements: list[ast.stmt] = []
        self._begin_round()

    def _begin_round(self) -> None:
        """Begin a round of translation: forget all but names, kinds and which variables may be NaN."""
        self.constants: dict[str, Any] = {}
        self.reassigned_names: set[str] = set()
        self._begin_function()

    def _begin_function(self) -> list[ast.stmt]:
        """Begin another function of the laws; return the statements of the previous one."""
        previous_statements, self.statements = self.statements, []
        self.path: Any = ()  # the calls that led here
        self.wanted_name = "value"  # of the expression under evaluation
        self.true_conditions: set[str] = set()  # at this place
        self.definitions: dict[str, ast.expr] = {}  # of flags, by name
        return previous_statements

    def _export_error(self, problem: str, cure: str) -> InputError:
        place = f"{self.source_line}: " if self.source_line else ""
        alternative = f"{'an estimator' if self.kind == 'estimator' else 'the law'} of fastcoil"
        sentence = f"{self.kind} = {self.rule!r} cannot be exported: {place}{problem}: {cure}, or export the loop with "
        return InputError(sentence + alternative, self.kind, "code")

    def _syntax_error(self, node: ast.AST) -> InputError:
        return self._export_error(f"it has {ast.unparse(node)}", f"use {ALLOWED_SYNTAX}")

    def _unique_name(self, preferred: str, key: Any) -> str:
        """Return a name that is free in all languages; key: what it stands for."""
        if (key, preferred) not in self.names:
            name = "_".join(filter(None, plain_text(preferred).split("_"))) or "x"
            candidate, k = name, 1
            while self.taken_names & {candidate.casefold(), f"{candidate}_known".casefold()}:
                k, candidate = k + 1, f"{name}_{k + 1}"
            self.taken_names.add(candidate.casefold())
            self.names[key, preferred] = candidate
        return self.names[key, preferred]

    def _local_name(self, preferred: str, key: Any) -> str:
        """Return the name of a variable of the current call."""
        return self._unique_name(preferred, (self.path, key))

    def _variable_value(self, name: str) -> Number:
        """Return a variable as a number, of unknown value."""
        flags = frozenset([f"{name}_known"] if name in self.may_be_nan else [])
        return Number(expression(name), self.kinds.get(name, "real"), None, flags)

    def _known_flags(self, *numbers: Number) -> list[ast.expr]:
        """Return the flags that hold where none of the numbers is NaN, without those that hold here anyway."""
        flags = frozenset().union(*(number.known_flags for number in numbers)) - self.true_conditions
        return [expression(flag) for flag in sorted(flags)]

    # statements

    @contextmanager
    def _separate_block(self, test: ast.expr | None = None, truth: bool = True) -> Iterator[list[ast.stmt]]:
        """Collect the statements that are made in the block, where ``test`` is true or false, apart from the others."""
        outer_statements, self.statements = self.statements, []
        implied = set() if test is None else implied_conditions(test, truth, self.definitions)
        implied -= self.true_conditions
        self.true_conditions |= implied
        try:
            yield self.statements
        finally:
            self.statements = outer_statements
            self.true_conditions -= implied

    def _evaluate_branches(
        self, test: ast.expr, branches: tuple[Callable[[], Any], Callable[[], Any]], name: str = "", key: Any = None
    ) -> Any:
        """Evaluate both branches of a condition, each by a function, and return their common value, if any."""
        results, blocks = [], []
        for run, truth in zip(branches, (True, False), strict=True):
            with self._separate_block(test, truth) as block:
                results.append(run())
            blocks.append(block)
        value = results[0]
        if value is not results[1]:
            value = self._merge_branches(name, (results[0], results[1]), key, test, blocks)
        self.statements += if_statement(test, *blocks)
        return value

    def _merge_branches(
        self, name: str, values: tuple[Any, Any], key: Any, test: ast.expr, blocks: list[list[ast.stmt]]
    ) -> Any:
        """Return the common value of two branches; where they differ, both store it in one variable."""
        yes, no = values
        if isinstance(yes, dict):  # a tuple, by name or place
            return {n: self._merge_branches(f"{name}_{n}", (v, no[n]), key, test, blocks) for n, v in yes.items()}
        is_alike = repr(yes.value) == repr(no.value) and ast.unparse(yes.text) == ast.unparse(no.text)
        if is_alike and self._is_steady(yes):
            return yes
        variable_name = self._local_name(name, key)
        for block, value, truth in zip(blocks, values, (True, False), strict=True):
            with self._separate_block(test, truth) as store_statements:
                self._store_value(variable_name, value)
            block.extend(store_statements)
        return self._variable_value(variable_name)

    def _store_value(self, name: str, value: Number) -> None:
        """Add a statement that stores a value in a variable, with a flag where it may be NaN."""
        kinds, flag = self.kinds, f"{name}_known"
        if not value.is_nan and kinds.setdefault(name, "real" if name[:2] == "s." else value.kind) != value.kind:
            if kinds[name] != "real":
                kinds[name] = "real"
                raise TranslateAgainError
            value = self._to_real(value)
        flags = self._known_flags(value)
        if (flags or value.is_nan) and name not in self.may_be_nan:
            self.may_be_nan.add(name)
            raise TranslateAgainError
        store: list[ast.stmt] = [assignment(name, value.text)]
        if ast.unparse(value.text) == name and not value.is_nan:
            return
        if name in self.may_be_nan:
            is_known = ast.Constant(not value.is_nan) if not flags else join_conditions(ast.And(), flags)
            self.true_conditions.discard(flag)
            self.statements.append(assignment(flag, is_known))
            store = [ast.If(expression(flag), store, [])] if flags else store
        self.statements += [] if value.is_nan else store

    def _bind_value(self, name: str, value: Any, key: Any, is_reassigned: bool = False) -> Any:
        """Store a value in a variable if it may change later; return it as later statements may read it."""
        if isinstance(value, dict):
            steady_names = {n for n, part in value.items() if not is_reassigned and self._is_steady(part)}
            bind = partial(self._bind_value, key=key, is_reassigned=is_reassigned)
            return {n: part if n in steady_names else bind(f"{name}_{n}", part) for n, part in value.items()}
        if not isinstance(value, Number) or (not is_reassigned and value.is_atom and self._is_steady(value)):
            return value
        variable_name = self._local_name(name, key)
        if is_reassigned:
            self.reassigned_names.add(variable_name)
        elif value.kind == "flag" and self._is_steady(value):
            self.definitions[variable_name] = value.text
        self._store_value(variable_name, value)
        return self._variable_value(variable_name)

    def _is_steady(self, value: Any) -> bool:
        """Whether a value reads no variable that changes."""
        return isinstance(value, Number) and not names_read_in(value.text) & {*self.reassigned_names, "s.w"}

    # kinds

    def _to_real(self, number: Number) -> Number:
        """Convert a whole number or a flag to a real one."""
        if number.kind == "real":
            return number
        if number.value is not None:
            return constant(float(number.value))
        if number.kind == "whole":
            return Number(call_of("float", number.text))
        numbers = (lambda: constant(1.0), lambda: constant(0.0))
        converted: Number = self._evaluate_branches(number.text, numbers, "as_number", ast.unparse(number.text))
        return converted

    # expressions

    def _evaluate_named(self, name: str, node: ast.expr, scope: Scope) -> Any:
        """Evaluate an expression; a variable that has to hold its value gets this name."""
        outer_name, self.wanted_name = self.wanted_name, name
        value = self._evaluate(node, scope)
        self.wanted_name = outer_name
        return value

    def _evaluate(self, node: ast.expr, scope: Scope) -> Any:  # noqa: PLR0911 — one for each kind
        """Evaluate an expression: a number, a tuple of them by place, or a function or module that it names."""
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
            return constant(node.value)
        if isinstance(node, ast.Name):
            return self._look_up_name(node.id, scope)
        if isinstance(node, ast.Attribute):
            return self._evaluate_attribute(self._evaluate(node.value, scope), node)
        if isinstance(node, ast.Tuple):
            return {str(k): self._evaluate(part, scope) for k, part in enumerate(node.elts)}
        if isinstance(node, ast.UnaryOp):
            return self._evaluate_unary(node, self._evaluate(node.operand, scope))
        if isinstance(node, ast.BoolOp):
            return self._evaluate_bool_op(node, scope)
        if isinstance(node, ast.Compare):
            values = [self._evaluate(part, scope) for part in (node.left, *node.comparators)]
            signs = zip(node.ops, values, values[1:], strict=False)
            return self._join_flags(ast.And(), [self._evaluate_comparison(*comparison) for comparison in signs])
        if isinstance(node, ast.BinOp):
            sides = (self._evaluate(part, scope) for part in (node.left, node.right))
            left, right = (self._to_real(part) if part.kind == "flag" else part for part in sides)
            return self._evaluate_arithmetic(node.op, left, right)
        if isinstance(node, ast.IfExp):
            test, body, orelse = self._to_flag(self._evaluate(node.test, scope)), node.body, node.orelse
            if test.value is not None:
                return self._evaluate(body if test.value else orelse, scope)
            branches = (lambda: self._evaluate(body, scope), lambda: self._evaluate(orelse, scope))
            return self._evaluate_branches(test.text, branches, self.wanted_name, id(node))
        if isinstance(node, ast.Subscript):
            return self._evaluate_element(node, scope)
        if isinstance(node, ast.Call):
            return self._evaluate_call(node, scope)
        raise self._syntax_error(node)

    @abstractmethod
    def _evaluate_call(self, node: ast.Call, scope: Scope) -> Any: ...

    # names

    def _look_up_name(self, name: str, scope: Scope) -> Any:
        """Return what a name stands for: a local value, one of the module, or a builtin."""
        python = scope.function
        if name in scope.names:
            return scope.names[name]
        cells = zip(python.__code__.co_freevars, python.__closure__ or (), strict=True)
        outer = python.__globals__ | {cell_name: cell.cell_contents for cell_name, cell in cells}
        return self._lift_constant(name, outer[name]) if name in outer else getattr(builtins, name)

    def _lift_constant(self, name: str, value: Any) -> Any:
        """Return a value of the user's module; numbers and tables become constants of the laws, under this name."""
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
        """Return the name of the constant of the laws that has this value; make one if there is none."""
        constant_name = self._unique_name(plain_text(name).strip("_").upper(), ("constant", repr(value)))
        self.constants[constant_name] = value
        return constant_name

    def _evaluate_attribute(self, owner: Any, node: ast.Attribute) -> Any:
        if isinstance(owner, dict) and node.attr in owner:
            return owner[node.attr]
        if isinstance(owner, ModuleType) and hasattr(owner, node.attr):
            value = getattr(owner, node.attr)
            return constant(value) if isinstance(value, float) else value
        raise self._syntax_error(node)

    def _evaluate_element(self, node: ast.Subscript, scope: Scope) -> Any:
        table, index = self._evaluate(node.value, scope), self._evaluate(node.slice, scope)
        if isinstance(table, dict):
            return [*table.values()][index.value]
        if index.value is not None and table.values:
            return constant(table.values[index.value])
        return Number(ast.Subscript(expression(table.name), index.text))

    # conditions

    def _to_flag(self, number: Number) -> Number:
        """Convert a number to a truth value: whether it is not 0."""
        if number.kind != "flag":
            return self._evaluate_comparison(ast.NotEq(), number, constant(0 if number.kind == "whole" else 0.0))
        return number

    @staticmethod
    def _join_flags(sign: ast.boolop, flags: list[Number]) -> Number:
        """Join flags by and, or by or, without those whose value is known."""
        is_and = isinstance(sign, ast.And)
        if any(part.value is not None and bool(part.value) != is_and for part in flags):
            return constant(not is_and)
        unknown = [part.text for part in flags if part.value is None]
        return Number(join_conditions(sign, unknown), "flag") if unknown else constant(is_and)

    def _evaluate_bool_op(self, node: ast.BoolOp, scope: Scope) -> Number:
        """Evaluate ``and`` or ``or``: the operands further right only where they matter."""
        is_and, flags = isinstance(node.op, ast.And), [self._to_flag(self._evaluate(node.values[0], scope))]
        for operand in node.values[1:]:
            flag_so_far = self._join_flags(node.op, flags)
            if flag_so_far.value is not None and bool(flag_so_far.value) != is_and:
                return flag_so_far
            with self._separate_block(flag_so_far.text, is_and) as block:
                flags.append(self._to_flag(self._evaluate(operand, scope)))
            if block:
                name = self._local_name("holds", id(operand))
                self._store_value(name, flag_so_far)
                block.append(assignment(name, flags[-1].text))
                self.statements.append(ast.If(ast.Name(name) if is_and else negation(ast.Name(name)), block, []))
                flags = [self._variable_value(name)]
        return self._join_flags(node.op, flags)

    def _evaluate_comparison(self, sign: ast.cmpop, left: Number, right: Number) -> Number:
        """Compare two numbers; with NaN only != holds."""
        holds = _OPERATORS[type(sign)]
        left, right = (self._to_real(side) if side.kind == "flag" else side for side in (left, right))
        if left.is_nan or right.is_nan:
            return constant(isinstance(sign, ast.NotEq))
        if left.value is not None and right.value is not None:
            return constant(bool(holds(left.value, right.value)))
        if left.kind != right.kind:
            left, right = self._to_real(left), self._to_real(right)
        flags, test = self._known_flags(left, right), ast.Compare(left.text, [sign], [right.text])
        if isinstance(sign, ast.NotEq):
            return Number(join_conditions(ast.Or(), [*map(negation, flags), test]), "flag")
        return Number(join_conditions(ast.And(), [*flags, test]), "flag")

    # arithmetic

    def _evaluate_unary(self, node: ast.UnaryOp, value: Number) -> Number:
        if isinstance(node.op, ast.Not):
            number = self._to_flag(value)
            return Number(negation(number.text), "flag") if number.value is None else constant(not number.value)
        if not isinstance(node.op, ast.USub):
            raise self._syntax_error(node)
        number = self._to_real(value) if value.kind == "flag" else value
        if isinstance(number.text, ast.Constant):
            return constant(-number.value)
        result = None if number.value is None else -number.value
        return replace(number, text=ast.UnaryOp(ast.USub(), number.text), value=result)

    def _evaluate_arithmetic(self, sign: ast.operator, left: Number, right: Number) -> Number:
        if isinstance(sign, ast.Pow):
            return self._evaluate_power(left, right)
        if isinstance(sign, (ast.FloorDiv, ast.Mod)):
            is_whole = left.kind == right.kind == "whole" and isinstance(sign, ast.FloorDiv)
            ratio = self._evaluate_arithmetic(ast.Div(), left, right)
            floor = self._apply_function("int" if is_whole else "math.floor", [ratio])
            if isinstance(sign, ast.FloorDiv):
                return floor
            return self._evaluate_arithmetic(ast.Sub(), left, self._evaluate_arithmetic(ast.Mult(), floor, right))
        operation = _OPERATORS[type(sign)]
        if left.kind != right.kind or isinstance(sign, ast.Div):
            left, right = self._to_real(left), self._to_real(right)
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

    def _evaluate_power(self, left: Number, right: Number) -> Number:
        if right.value not in (2, 3):
            left, right = self._to_real(left), self._to_real(right)
            return Number(call_of("math.pow", left.text, right.text), known_flags=left.known_flags | right.known_flags)
        if not left.is_atom:
            name = self._local_name("x", ast.unparse(left.text))
            self._store_value(name, left)
            left = self._variable_value(name)
        square = self._evaluate_arithmetic(ast.Mult(), left, left)
        return square if right.value == 2 else self._evaluate_arithmetic(ast.Mult(), square, left)

    def _apply_function(self, name: str, arguments: list[Number]) -> Number:
        """Evaluate a call of one of ``FUNCTIONS``, by its name there."""
        if name == "bool":
            return self._to_flag(arguments[0])
        if name == "isnan":
            if flags := self._known_flags(arguments[0]):
                return Number(negation(join_conditions(ast.And(), flags)), "flag")
            return constant(arguments[0].is_nan)
        is_whole = name in ("min", "max", "abs") and all(number.kind == "whole" for number in arguments)
        numbers = arguments if is_whole else [self._to_real(number) for number in arguments]
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

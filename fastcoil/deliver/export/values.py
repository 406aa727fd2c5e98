"""Expressions of a rule, evaluated with symbols: what the loop decides is decided, the rest becomes text."""

from __future__ import annotations

import ast
import builtins
import copy
import math
from abc import ABC, abstractmethod
from types import ModuleType
from typing import Any

import numpy as np

from fastcoil.deliver.export.python import (
    documented,
)
from fastcoil.deliver.export.symbols import (
    IN_MATH,
    MATHEMATICS,
    NOTHING,
    OTHER_NAMES,
    SIGNS,
    Later,
    Number,
    Record,
    Rows,
    Scope,
    SeesConstantsError,
    Symbols,
    Table,
    constant,
    is_plain,
    number_of,
)
from fastcoil.deliver.export.trees import (
    call_of,
    conjunction,
    disjunction,
    expression,
    negated,
)
from fastcoil.deliver.export.words import plain_text
from fastcoil.model.numerics import elementary


class Values(Symbols, ABC):
    """Evaluates expressions; what needs statements, such as a choice, is stored in a name."""

    def _forced(self, value: Any) -> Any:
        return self._value(value.node, value.scope, "value") if isinstance(value, Later) else value

    @abstractmethod
    def _call(self, node: ast.Call, scope: Scope, hint: str) -> Any:
        """The value of a call, which may need statements."""

    def _value(self, node: ast.expr, scope: Scope, hint: str) -> Any:  # noqa: PLR0911 — one for each kind
        if isinstance(node, ast.Constant):
            if not isinstance(node.value, (int, float)):
                raise self._refusal(f"it has {node.value!r}", "use numbers")
            return constant(node.value)
        if isinstance(node, ast.Name):
            return self._looked_up(node.id, scope)
        if isinstance(node, ast.Attribute):
            return self._attribute(self._value(node.value, scope, hint), node)
        if isinstance(node, ast.Tuple):
            return tuple(self._lazily(one, scope, hint) for one in node.elts)
        if isinstance(node, ast.UnaryOp):
            return self._unary(node, self._value(node.operand, scope, hint))
        if isinstance(node, ast.BoolOp):
            return self._both(node.values, isinstance(node.op, ast.And), scope, hint)
        if isinstance(node, ast.Compare):
            return self._comparison(node, scope, hint)
        if isinstance(node, ast.BinOp):
            left, right = self._value(node.left, scope, hint), self._value(node.right, scope, hint)
            return self._arithmetic(node, self._number(left), self._number(right))
        if isinstance(node, ast.IfExp):
            test = self._flag(self._value(node.test, scope, "test"))
            if test.value is not None:
                return self._value(node.body if test.value else node.orelse, scope, hint)
            return self._choice(node, test, scope, "", hint)
        if isinstance(node, ast.Subscript):
            return self._element(node, scope, hint)
        if isinstance(node, ast.Call):
            return self._call(node, scope, hint)
        raise self._refusal(f"it has {ast.unparse(node)}", "use numbers, fields and functions of them")

    def _lazily(self, node: ast.expr, scope: Scope, hint: str) -> Any:
        """A part of a tuple, evaluated where it is stored if nothing that it reads changes until then."""
        names = [n.id for n in ast.walk(node) if isinstance(n, ast.Name)]
        steady = all(scope.stored[n] <= 1 and not isinstance(scope.names.get(n), Rows) for n in names)
        if isinstance(node, ast.IfExp) and steady:
            frozen = copy.copy(scope)
            frozen.names = dict(scope.names)
            return Later(node, frozen)
        return self._value(node, scope, hint)

    def _looked_up(self, name: str, scope: Scope) -> Any:
        if name in scope.names:
            return scope.names[name]
        function = scope.function
        cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
        if name in cells:
            return self._lifted(name, cells[name].cell_contents)
        if name in function.__globals__:
            return self._lifted(name, function.__globals__[name], function.__code__.co_filename)
        if hasattr(builtins, name):
            return getattr(builtins, name)
        raise self._refusal(f"{name} has no value", "give it one before it is read")

    def _lifted(self, name: str, value: Any, filename: str = "") -> Any:
        """A name of the module: numbers become constants of the code."""
        if isinstance(value, (bool, np.bool_)):
            return constant(bool(value))
        if isinstance(value, (int, float, np.number)):
            number = constant(value.item() if isinstance(value, np.number) else value)
            if not math.isfinite(number.value) or self.as_function:
                return number
            called = self._module_constant(name, number.value, filename)
            return Number(ast.Name(called), number.kind, number.value)
        if isinstance(value, (tuple, np.ndarray)) and not hasattr(value, "_fields"):
            numbers = tuple(float(x) for x in np.asarray(value, dtype=float).ravel())
            if np.ndim(value) != 1:
                raise self._refusal(f"{name} is a table of several dimensions", "use one table for each row")
            if self.as_function:
                raise SeesConstantsError
            return Table(self._module_constant(name, numbers, filename), numbers)
        return value

    def _module_constant(self, name: str, value: Any, filename: str) -> str:
        wanted = plain_text(name).strip("_").upper()
        k, called = 1, wanted
        while called in self.constants and self.constants[called][0] != value or called.casefold() in self.taken:
            k, called = k + 1, f"{wanted}_{k + 1}"
        said = documented(filename, name)
        self.constants.setdefault(called, (value, said))
        self.pool.add(called.casefold())
        return called

    def _attribute(self, of: Any, node: ast.Attribute) -> Any:
        if isinstance(of, Record) and node.attr in of.fields:
            found = self._forced(of.fields[node.attr])
            return found
        if isinstance(of, ModuleType) and hasattr(of, node.attr):
            value = getattr(of, node.attr)
            return constant(value) if isinstance(value, float) else value
        raise self._refusal(f"it has {ast.unparse(node)}", "use fields of what the rule is given")

    def _unary(self, node: ast.UnaryOp, value: Any) -> Number:
        number = self._number(value)
        if isinstance(node.op, ast.Not):
            number = self._flag(number)
            return constant(not number.value) if number.value is not None else Number(negated(number.text), "flag")
        if isinstance(node.op, ast.UAdd):
            return number
        if not isinstance(node.op, ast.USub):
            raise self._refusal(f"it has {ast.unparse(node)}", "use and, or and not")
        number = self._real(number) if number.kind == "flag" else number
        value = None if number.value is None else -number.value
        if isinstance(number.text, ast.Constant):
            return constant(value)
        return Number(ast.UnaryOp(ast.USub(), number.text), number.kind, value, number.needs)

    def _both(self, nodes: list[ast.expr], is_and: bool, scope: Scope, hint: str) -> Number:
        """``and`` or ``or``: what stands further right is evaluated where it matters."""
        with self._aside() as block:
            first = self._flag(self._value(nodes[0], scope, hint))
        self.out += block
        if len(nodes) == 1 or first.value is not None:
            decides = len(nodes) == 1 or bool(first.value) != is_and
            return first if decides else self._both(nodes[1:], is_and, scope, hint)
        with self._aside(first.text, is_and) as block:
            rest = self._both(nodes[1:], is_and, scope, hint)
        if not block and rest.value is not None:
            return first if bool(rest.value) == is_and else rest
        if not block:
            return Number((conjunction if is_and else disjunction)([first.text, rest.text]), "flag")
        name = self._local("holds" if hint == "test" else hint, id(nodes[1]))
        self.kinds[name] = "flag"
        with self._aside(first.text, is_and) as kept:
            self._store(name, rest)
        other: list[ast.stmt] = [ast.Assign([ast.Name(name)], ast.Constant(not is_and))]
        self._when(first.text, *([*block, *kept], other)[:: 1 if is_and else -1])
        return Number(ast.Name(name), "flag")

    def _comparison(self, node: ast.Compare, scope: Scope, hint: str) -> Number:
        values = [self._number(self._value(one, scope, hint)) for one in (node.left, *node.comparators)]
        values = [self._real(one) if one.kind == "flag" else one for one in values]
        parts: list[ast.expr] = []
        for sign, left, right in zip(node.ops, values, values[1:], strict=False):
            one = self._compared(sign, left, right, node)
            if one.value is None:
                parts.append(one.text)
            elif not one.value:
                return constant(False)
        return Number(conjunction(parts), "flag") if parts else constant(True)

    def _compared(self, sign: ast.cmpop, left: Number, right: Number, node: ast.Compare) -> Number:
        if type(sign) not in SIGNS:
            raise self._refusal(f"it has {ast.unparse(node)}", "compare numbers")
        if left.value is not None and right.value is not None:
            return constant(bool(SIGNS[type(sign)](left.value, right.value)))
        differs = isinstance(sign, ast.NotEq)
        if any(one.value is not None and math.isnan(one.value) for one in (left, right)):
            return constant(differs)
        for one, other in ((left, right), (right, left)):
            text = one.text
            if isinstance(text, ast.IfExp) and other.value is not None:  # the mode, or what is one of two constants
                pairs = [(side.value, other.value) if one is left else (other.value, side.value)
                         for side in map(number_of, (text.body, text.orelse))]  # fmt: skip
                up, down = (bool(SIGNS[type(sign)](*pair)) for pair in pairs)
                if up == down:
                    return constant(up)
                return Number(text.test if up else negated(text.test), "flag")
        left, right = self._plain_choice(left), self._plain_choice(right)
        if left.kind != right.kind:
            left, right = self._real(left), self._real(right)
        needs = sorted((left.needs | right.needs) - self.facts)
        compared: ast.expr = ast.Compare(left.text, [sign], [right.text])
        if needs:
            flags = [expression(one) for one in needs]
            compared = disjunction([*map(negated, flags), compared]) if differs else conjunction([*flags, compared])
        return Number(compared, "flag")

    def _arithmetic(self, node: ast.BinOp, left: Number, right: Number) -> Number:  # noqa: PLR0911 — one for each kind
        left, right = self._plain_choice(left), self._plain_choice(right)
        if isinstance(node.op, (ast.BitAnd, ast.BitOr)) and left.kind == right.kind == "flag":
            is_and = isinstance(node.op, ast.BitAnd)
            known = [one for one in (left, right) if one.value is not None]
            if any(one.value != is_and for one in known):
                return constant(not is_and)
            texts = [one.text for one in (left, right) if one.value is None]
            return Number((conjunction if is_and else disjunction)(texts), "flag") if texts else constant(is_and)
        left, right = (self._real(one) if one.kind == "flag" else one for one in (left, right))
        if isinstance(node.op, ast.Pow):
            return self._power(node, left, right)
        if isinstance(node.op, ast.FloorDiv) and left.kind == right.kind == "whole":
            parts = ast.BinOp(call_of("float", left.text), ast.Div(), call_of("float", right.text))
            return Number(call_of("int", parts), "whole")
        if isinstance(node.op, (ast.Mod, ast.FloorDiv)):
            left, right = self._real(left), self._real(right)
            ratio = self._arithmetic(ast.BinOp(node.left, ast.Div(), node.right), left, right)
            whole = self._mathematics("floor", [ratio])
            if isinstance(node.op, ast.FloorDiv):
                return whole
            return self._arithmetic(
                ast.BinOp(node.left, ast.Sub(), node.right),
                left,
                self._arithmetic(ast.BinOp(node.left, ast.Mult(), node.right), whole, right),
            )
        if type(node.op) not in SIGNS:
            raise self._refusal(f"it has {ast.unparse(node)}", "use + - * / ** % and //")
        if left.kind != right.kind or isinstance(node.op, ast.Div):
            left, right = self._real(left), self._real(right)
        if isinstance(node.op, ast.Mult) and self._is_neutral(left):
            return right
        if isinstance(node.op, ast.Mult) and self._is_neutral(right):
            return left
        if isinstance(node.op, ast.Div) and self._is_neutral(right):
            return left
        value = None
        if left.value is not None and right.value is not None:
            with np.errstate(all="ignore"):
                value = SIGNS[type(node.op)](np.float64(left.value), np.float64(right.value)).item()
            value = int(value) if left.kind == "whole" else value
        needs = left.needs | right.needs
        if value is not None and math.isnan(value):
            return NOTHING
        if value is not None and (
            isinstance(left.text, ast.Constant) and isinstance(right.text, ast.Constant) or not math.isfinite(value)
        ):
            return constant(value)
        return Number(ast.BinOp(left.text, node.op, right.text), left.kind, value, needs)

    def _power(self, node: ast.BinOp, left: Number, right: Number) -> Number:
        if right.value in (2, 3) and right.kind in ("whole", "real"):
            left = left if is_plain(left) else self._settled_number(left)
            square = self._arithmetic(ast.BinOp(node.left, ast.Mult(), node.left), left, left)
            return (
                square
                if right.value == 2
                else self._arithmetic(ast.BinOp(node.left, ast.Mult(), node.left), square, left)
            )
        left, right = self._real(left), self._real(right)
        value = float(left.value) ** right.value if left.value is not None and right.value is not None else None
        return Number(call_of("math.pow", left.text, right.text), "real", value, left.needs | right.needs)

    def _choice(self, node: ast.IfExp, test: Number, scope: Scope, wanted: str, hint: str = "value") -> Any:
        """A conditional expression as an if that stores one of two values."""
        found: list[Any] = []
        blocks: list[list[ast.stmt]] = []
        for branch, truth in ((node.body, True), (node.orelse, False)):
            with self._aside(test.text, truth) as block:
                found.append(self._value(branch, scope, wanted or hint))
            blocks.append(block)
        one, other = found
        if isinstance(one, Number) and isinstance(other, Number):
            same = ast.unparse(one.text) == ast.unparse(other.text) and not blocks[0] and not blocks[1]
            if same and one.value == other.value and not {one.kind, other.kind} - {one.kind}:
                return one
            if one.kind == other.kind == "flag" and not blocks[0] and not blocks[1]:
                return self._flag_choice(test, one, other)
        name = wanted or self._local(hint, id(node))
        for block, value, truth in zip(blocks, found, (True, False), strict=True):
            with self._aside(test.text, truth) as kept:
                self._keep(name, value)
            block.extend(kept)
        self._when(test.text, *blocks)
        return self._kept(name, one)

    def _flag_choice(self, test: Number, one: Number, other: Number) -> Number:
        yes = conjunction([test.text, *([] if one.value else [one.text])]) if one.value is not False else None
        no = (
            conjunction([negated(test.text), *([] if other.value else [other.text])])
            if other.value is not False
            else None
        )
        if yes is None and no is None:
            return constant(False)
        parts = [part for part in (yes, no) if part is not None]
        return Number(disjunction(parts), "flag")

    def _element(self, node: ast.Subscript, scope: Scope, hint: str) -> Any:
        of = self._value(node.value, scope, hint)
        if isinstance(of, tuple):
            index = self._number(self._value(node.slice, scope, "index"))
            if index.value is not None:
                return of[int(index.value)]
        if isinstance(of, (Table, Rows)):
            index = self._whole(self._value(node.slice, scope, "index"))
            if isinstance(of, Table) and index.value is not None:
                return constant(of.values[int(index.value)])
            text = ast.Name(of.name) if isinstance(of, Table) else of.text
            return Number(ast.Subscript(text, index.text))
        raise self._refusal(f"it has {ast.unparse(node)}", "use a table of numbers and an index in whole numbers")

    def _known_function(self, function: Any) -> str:
        if function is elementary.exp or function is elementary.log:
            return "exp" if function is elementary.exp else "log"
        if function in (int, float, bool):
            return str(function.__name__)
        name = getattr(function, "__name__", "")
        name = OTHER_NAMES.get(name, name)
        own = [
            getattr(module, attr, None)
            for module in (math, np, builtins)
            for attr in (name, getattr(function, "__name__", ""))
        ]
        return name if name in MATHEMATICS and any(function is one for one in own) else ""

    def _mathematics(self, name: str, given: list[Number]) -> Number:
        if name == "isnan":
            (one,) = given
            if one.value is not None:
                return constant(math.isnan(one.value))
            needs = sorted(one.needs - self.facts)
            return Number(negated(conjunction(map(expression, needs))), "flag") if needs else constant(False)
        if name in ("min", "max") and len({one.kind for one in given}) == 1 and given[0].kind == "whole":
            kind = "whole"
        else:
            kind, given = "real", [self._real(one) for one in given]
        if len(given) > 2:
            return self._mathematics(name, [self._mathematics(name, given[:2]), *given[2:]])
        value = None
        if all(one.value is not None for one in given):
            function: Any = MATHEMATICS[name]
            value = function(*(one.value for one in given))
            if (
                name in ("floor", "abs", "min", "max")
                and all(isinstance(one.text, ast.Constant) for one in given)
                or name == "floor"
            ):
                return constant(int(value) if kind == "whole" else float(value))
        called = name if name in ("abs", "min", "max") else f"math.{IN_MATH.get(name, name)}"
        return Number(
            call_of(called, *(one.text for one in given)), kind, value, frozenset().union(*(one.needs for one in given))
        )

    def _made(self, cls: Any, node: ast.Call, scope: Scope) -> Record:
        """A named tuple, its parts evaluated where they are stored."""
        values: dict[str, Any] = {n: constant(float(x)) for n, x in cls._field_defaults.items()}
        for name, one in zip(cls._fields, node.args, strict=False):
            values[name] = self._lazily(one, scope, name)
        values |= {str(one.arg): self._lazily(one.value, scope, str(one.arg)) for one in node.keywords}
        return Record(cls, {n: values[n] for n in cls._fields})

    def _flag(self, value: Any) -> Number:
        """A truth; of a number, whether it is not 0."""
        number = self._number(value)
        if number.kind == "flag":
            return number
        if number.value is not None:
            return constant(bool(number.value))
        zero = constant(0 if number.kind == "whole" else 0.0)
        return self._compared(ast.NotEq(), number, zero, ast.Compare(number.text, [ast.NotEq()], [zero.text]))

    def _number(self, value: Any) -> Number:
        value = self._forced(value)
        if not isinstance(value, Number):
            raise self._refusal("it uses a class or a table as a number", "use its fields, or an index")
        return value

    def _settled_number(self, number: Number) -> Number:
        name = self._local("x", ast.dump(number.text))
        self._store(name, number)
        return self._variable(name)

    def _keep(self, name: str, value: Any) -> None:
        """Store what a branch returns."""
        if isinstance(value, tuple):
            for k, one in enumerate(value):
                self._keep(f"{name}_{k + 1}", one)
        elif isinstance(value, Record):
            for n, one in value.fields.items():
                self._keep(f"{name}_{n}", self._forced(one))
        else:
            self._store(name, self._number(value))

    def _whole(self, value: Any) -> Number:
        number = self._number(value)
        if number.kind != "whole":
            raise self._refusal("an index or an end of a loop is no whole number", "write int(…) around it")
        return number

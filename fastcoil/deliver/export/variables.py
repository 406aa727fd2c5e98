"""The variables of the laws while a rule is translated: their names, their kinds, and what is stored in them when."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from fastcoil.base.errors import InputError
from fastcoil.deliver.export.values import (
    Choice,
    Number,
    Record,
    assigned,
    call_of,
    conditional,
    constant,
    expression,
    implied,
    joined,
    read_in,
    stored_in,
)
from fastcoil.deliver.export.words import RESERVED, plain_text


class AgainError(Exception):
    """More than was known may be NaN, changes, or is no whole number: translate once more."""


class Variables:
    """Collects statements and the variables in them.

    kind, rule: law or estimator, and its name.  pool: names that are taken.  names: by what they stand for, the same in
    every round.  kinds: of variables.  nothing: those that may be NaN; beside each is a flag, ``name_known``.  path:
    the calls that led here.  facts: conditions that hold here.  definitions: of flags, by name.  unsteady: variables
    that get several values.  out: the statements so far.
    """

    def __init__(self, kind: str, rule: str, names: Sequence[str]) -> None:
        self.kind, self.rule, self.where = kind, rule, ""
        self.pool = {each.casefold() for each in (*names, *RESERVED)}
        self.names: dict[Any, str] = {}
        self.kinds: dict[str, str] = {}
        self.nothing: set[str] = set()
        self.out: list[ast.stmt] = []
        self._begin()

    def _begin(self) -> None:
        """Begin a round: all but names, kinds and what may be NaN is found anew."""
        self.constants: dict[str, tuple[Any, str]] = {}
        self.unsteady: set[str] = set()
        self._afresh()

    def _afresh(self) -> list[ast.stmt]:
        """Begin another function of the laws.  Returns the statements of the one before."""
        before = self.out
        self.path: Any = ()
        self.facts: set[str] = set()
        self.definitions: dict[str, ast.expr] = {}
        self.out = []
        return before

    def _refusal(self, what: str, cure: str) -> InputError:
        where = f"{self.where}: " if self.where else ""
        return InputError(
            f"{self.kind} = {self.rule!r} cannot be exported: {where}{what}: {cure}, or export the loop with "
            f"{'an estimator' if self.kind == 'estimator' else 'the law'} of fastcoil"
        )

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
        has_value = any(isinstance(one, (Number, Choice, tuple, Record)) for one in found)
        if has_value and not any(blocks):
            return self._chosen(test, *found)
        for k, truth in enumerate((True, False) if has_value else ()):
            with self._aside(test, truth) as block:
                found[k] = self._bound(name, found[k], key, many=True)
            blocks[k] += block
        self._when(test, *blocks)
        return found[0] if has_value or found[0] is found[1] else None

    def _when(self, test: ast.expr, yes: list[ast.stmt], no: list[ast.stmt]) -> None:
        """An if, or more of the one before."""
        last, text = self.out[-1] if self.out else None, ast.unparse(test)
        if isinstance(last, ast.If) and ast.unparse(last.test) == text and not stored_in([last]) & read_in(test):
            last.body, last.orelse = last.body + yes, last.orelse + no
        elif (made := conditional(test, yes, no)) is not None:
            self.out.append(made)

    def _chosen(self, test: ast.expr, yes: Any, no: Any) -> Any:
        """One of two values."""
        if isinstance(yes, tuple) and isinstance(no, tuple):
            return tuple(self._chosen(test, *pair) for pair in zip(yes, no, strict=True))
        if isinstance(yes, Record) and isinstance(no, Record):
            return Record(yes.cls, {n: self._chosen(test, one, no.fields[n]) for n, one in yes.fields.items()})
        if not isinstance(yes, (Number, Choice)) or not isinstance(no, (Number, Choice)):
            raise self._refusal("it chooses between classes or tables", "choose between their numbers")
        if isinstance(yes, Number) and isinstance(no, Number) and repr(yes.value) == repr(no.value):
            return yes if ast.unparse(yes.text) == ast.unparse(no.text) else Choice(test, yes, no)
        return Choice(test, yes, no)

    def _store(self, name: str, value: Number | Choice) -> None:
        """``name`` = value, and whether it is a number, where that is not certain."""
        if isinstance(value, Choice):
            yes, no = value.yes, value.no
            self._either(value.test, (lambda: self._store(name, yes), lambda: self._store(name, no)))
            return
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
            self.facts.discard(flag)
            known = ast.Constant(not value.is_nothing) if not needs else joined(ast.And(), needs)
            self.out.append(assigned(flag, known))
            store = [ast.If(expression(flag), store, [])] if needs else store
        self.out += [] if value.is_nothing else store

    def _bound(self, name: str, value: Any, key: Any, many: bool = False) -> Any:
        """A value as later statements may read it; many: it is one of several that a variable gets."""
        if isinstance(value, tuple):
            return tuple(self._bound(f"{name}_{k}", one, key, many) for k, one in enumerate(value, 1))
        if isinstance(value, Record):
            bound = {
                n: one if not many and self._is_steady(one) else self._bound(f"{name}_{n}", one, key, many)
                for n, one in value.fields.items()
            }
            return Record(value.cls, bound)
        if not isinstance(value, (Number, Choice)) or (not many and value.is_atom and self._is_steady(value)):
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
        return isinstance(value, (Number, Choice)) and not read_in(value.text) & {*self.unsteady, "s.w"}

    # kinds

    def _number(self, value: Any, name: str = "value") -> Number:
        """A value as an expression; name: of the variable that a choice is stored in."""
        if isinstance(value, Choice):
            name = self._local(value.name or name, ast.unparse(value.text))
            self._store(name, value)
            return self._variable(name)
        if not isinstance(value, Number):
            raise self._refusal("it uses a class or a table as a number", "use its fields, or an index")
        return value

    def _real(self, value: Any) -> Number:
        number = self._number(value)
        if number.kind == "real":
            return number
        if number.value is not None:
            return constant(float(number.value))
        if number.kind == "whole":
            return Number(call_of("float", number.text))
        return self._number(Choice(number.text, constant(1.0), constant(0.0), "as_number"))

    def _whole(self, value: Any) -> Number:
        number = self._number(value)
        if number.kind != "whole":
            raise self._refusal("an index or an end of a loop is no whole number", "write int(…) around it")
        return number

"""A rule of the kernel, of the package or of the user, written anew as laws for the field.

``Translator`` runs the Python of a rule with symbols in place of numbers.  It follows every call, so that what is left
is one function of numbers and the state, without classes, tuples or conditional expressions.  What the parameters of
the loop decide is decided here: a branch that this controller never takes is not in its code.

NaN, which stands for "nothing yet" in a memory, has no portable form in Structured Text.  A variable that may be NaN
gets a flag beside it, ``x_known``, and every comparison asks for the flag first.
"""

from __future__ import annotations

import ast
import io
import math
import re
import tokenize
from collections.abc import Mapping
from typing import Any, NamedTuple

from fastcoil.deliver.export.python import (
    commented,
    constant_text,
    docstring_of,
    documented,
    function_text,
    text_of,
)
from fastcoil.deliver.export.statements import Statements
from fastcoil.deliver.export.symbols import (
    AgainError,
    Later,
    Number,
    Record,
    Rows,
    Scope,
    constant,
)
from fastcoil.deliver.export.trees import (
    conjunction,
    expression,
    merged,
    names_in,
    needed,
    read_in,
    test_of,
)
from fastcoil.deliver.export.words import RESERVED

_MOST_ROUNDS = 50


class Port(NamedTuple):
    """A rule as laws: texts of Python, see ``source.Laws``."""

    parameters: tuple[str, ...]
    constants: list[str]
    fields: list[str]
    start: list[str]
    functions: list[str]
    sections: list[str]
    call: str
    reads: frozenset[str]


class Translator(Statements):
    """Translates one rule.

    name: of the rule.  kind: estimator or law.  step, start: its functions; without a start its memory begins with its
    defaults.  numbers: its parameters.  words: size of its array.  estimate: the text of the estimate that it sees.
    taken: names that the code has already.  neutral: parameters that are at a default that switches something off.
    """

    def port(self) -> Port:
        """The laws of the rule.

        Raises
        ------
        InputError
            With a sentence, where the rule has something that the languages have not.
        """
        for _ in range(_MOST_ROUNDS):
            try:
                return self._port()
            except AgainError:
                continue
        raise self._refusal("its variables have no kind of their own", "use a new name for another kind of value")

    def _port(self) -> Port:
        self._begin()
        parameters = Record(self.Parameters, {n: self._parameter(n) for n in self.Parameters._fields})
        first = self._first(parameters)
        memory = {}
        for n, number in first.items():
            name, value = self.fields[n], number.value
            if name not in self.changing and (
                isinstance(number.text, ast.Constant) or (value is not None and math.isnan(value))
            ):
                memory[n] = number
                self.at_first[f"s.{name}"] = value
                continue
            if value is not None and math.isnan(value):
                self.nothing.add(f"s.{name}")
            memory[n] = self._variable(f"s.{name}")
        given: list[Any] = [self._sample(), parameters, Record(self.Memory, memory)]
        given += [Rows(expression("s.w"))] if self.words else []
        scope = self._scope(self.step, given)
        self._run(scope.definition.body, scope, self._commit)
        return self._written(scope, first, merged(needed(self.out, {self._goal})))

    def _first(self, parameters: Record) -> dict[str, Number]:
        """The memory at the start."""
        if self.start is None:
            defaults = {n: float(self.Memory._field_defaults.get(n, 0.0)) for n in self.Memory._fields}
            return {n: constant(x) for n, x in defaults.items()}
        self.is_start = True
        scope = self._scope(self.start, [parameters])
        found = self._run(scope.definition.body, scope, None)
        self.is_start = False
        return {n: self._number(found.fields[n]) for n in self.Memory._fields}

    @property
    def _goal(self) -> str:
        return "s.decided" if self.kind == "law" else "s.estimate"

    def _sample(self) -> Record:
        """What the rule sees, by the names that the controller has for it."""
        texts = {
            "t": "s.clock", "T_set": "T_set", "T": "T_sup" if self.kind == "law" else "s.T_seen", "e": "s.e",
            "u": "s.u", "command": "s.command", "switches": "s.switches", "estimate": self.estimate,
        }  # fmt: skip
        seen = {name: Number(expression(text)) for name, text in texts.items()}
        seen["m_a"] = Number(expression("m_a"), needs=frozenset({"m_a >= 0.0"}))
        seen["mode"] = Number(expression("1.0 if s.rising else -1.0"))
        return Record(None, seen)

    def _commit(self, found: Any) -> None:
        """Store what the rule returns; a field is stored after all that reads its value of before."""
        if not isinstance(found, tuple) or len(found) != 2 or not isinstance(found[1], Record):
            raise self._refusal("it returns something else than a number and its memory", "return a number, Memory(…)")
        goal = self._goal
        parts: dict[str, Any] = {goal: found[0]}
        parts |= {f"s.{self.fields[n]}": one for n, one in found[1].fields.items()}
        blocks = {}
        for target, value in parts.items():
            with self._aside() as block:
                self._leave(target, value)
            if block:
                blocks[target] = block
        for target in blocks:
            if target != goal and target[2:] not in self.changing:
                self.changing.add(target[2:])
                raise AgainError
        last: list[ast.stmt] = []
        previous = ""
        while blocks:
            free = [
                t
                for t in blocks
                if not any({t, f"{t}_known"} & read_in(other) for o, other in blocks.items() if o != t)
            ]
            if free:
                alike = [t for t in free if test_of(blocks[t]) == previous and previous]
                target = (alike or free)[0]
                previous = test_of(blocks[target])
                self.out += blocks.pop(target)
                continue
            target = next(iter(blocks))
            name = self._local(f"next_{target[2:]}", "next")
            del blocks[target]
            self._leave(name, parts[target])
            with self._aside() as block:
                self._leave(target, self._variable(name))
            last += block
        self.out += last

    def _leave(self, target: str, value: Any) -> None:
        """Store a part of what a step leaves; of a conditional expression each branch stores it."""
        if isinstance(value, Later):
            self._leave_node(target, value.node, value.scope)
            return
        number = self._real(self._number(value))
        if target in ("s.estimate", "s.decided"):
            if ast.unparse(number.text) == target:
                return
            needs = number.needs - self.facts
            limited = ast.Call(ast.Name("clipped"), [number.text], [])
            store: list[ast.stmt] = [ast.Assign([expression(target)], limited)]
            self._emit(*([ast.If(conjunction(map(expression, sorted(needs))), store, [])] if needs else store))
            return
        self._store(target, number)

    def _leave_node(self, target: str, node: ast.expr, scope: Scope) -> None:
        if not isinstance(node, ast.IfExp):
            self._leave(target, self._value(node, scope, target.removeprefix("s.")))
            return
        test = self._flag(self._value(node.test, scope, "test"))
        if test.value is not None:
            self._leave_node(target, node.body if test.value else node.orelse, scope)
            return
        blocks = []
        for branch, truth in ((node.body, True), (node.orelse, False)):
            with self._aside(test.text, truth) as block:
                self._leave_node(target, branch, scope)
            blocks.append(block)
        self._when(test.text, *blocks)

    def _renumbered(self, text: str, taken: set[str]) -> str:
        """A text whose intermediate names have the least numbers that tell them apart.  taken: names; grows."""
        public = {"function", "section", "rule"}
        wanted = {found: name for (_, place, name), found in self.found_names.items() if place not in public}
        new: dict[str, str] = {}
        lines = text.splitlines(keepends=True)
        tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
        for before, token in zip(tokens, tokens[1:], strict=False):
            name = token.string.removesuffix("_known")
            if token.type == tokenize.NAME and before.string != "." and name in wanted and name not in new:
                k, found = 1, wanted[name]
                while {found.casefold(), f"{found}_known".casefold()} & taken:
                    k, found = k + 1, f"{wanted[name]}_{k + 1}"
                taken.add(found.casefold())
                new[name] = found
        for before, token in reversed(list(zip(tokens, tokens[1:], strict=False))):
            name = token.string.removesuffix("_known")
            if token.type == tokenize.NAME and before.string != "." and name in new:
                (row, start), line = token.start, lines[token.start[0] - 1]
                lines[row - 1] = line[:start] + new[name] + token.string[len(name) :] + line[token.end[1] :]
        return "".join(lines)

    def _written(self, scope: Scope, first: Mapping[str, Number], body: list[ast.stmt]) -> Port:
        """The texts, without constants and fields that nothing reads."""
        name = self._local(self.rule, "rule")
        arguments = [n for n in ("T_sup", "T_set", "m_a") if n in read_in(body)]
        head = ["s: State", *(f"{n}: float" for n in arguments)]
        main = function_text(name, head, "None", docstring_of(scope.function), body)
        functions = [text for _, _, text in self.functions.values() if text]
        sections = [*(text for _, _, text in self.sections.values()), main]
        called = {each.casefold() for each, _, _ in (*self.functions.values(), *self.sections.values())}
        called |= {each.casefold() for each in (*RESERVED, *self.constants, *map(str.upper, self.numbers))}
        functions = [self._renumbered(text, set(called)) for text in functions]
        sections = self._renumbered("\n\n\n".join(sections), self.taken | called).split("\n\n\n")
        read = {*names_in("\n".join([*functions, *sections]))}
        stored = set(re.findall(r"\bs\.(\w+)", "\n".join(sections)))
        fields, start = [], []
        for n, number in first.items():
            kept, is_nothing = self.fields[n], number.value is not None and math.isnan(number.value)
            if kept in stored:
                said = documented(scope.function.__code__.co_filename, n, self.Memory.__name__)
                fields.append(commented(f"{kept}: float", said))
                start.append(f"s.{kept} = {text_of(ast.Constant(0.0) if is_nothing else self._real(number).text)}")
            if f"{kept}_known" in stored:
                fields.append(f"{kept}_known: bool  # whether {kept} has a value")
                start.append(f"s.{kept}_known = {not is_nothing}")
        if self.words and "w" in stored:
            fields.append("w: list[float]  # sums and other numbers, one behind the other")
            start.append(f"s.w = zeros({self.words})")
        read |= {*names_in("\n".join(start))}
        return Port(
            tuple(n for n in self.numbers if n.upper() in read),
            [constant_text(n, value, said) for n, (value, said) in self.constants.items() if n in read],
            fields, start, functions, sections, f"{name}({', '.join(['s', *arguments])})",
            frozenset({*arguments, *(["T_seen"] if "T_seen" in read else [])}),
        )  # fmt: skip

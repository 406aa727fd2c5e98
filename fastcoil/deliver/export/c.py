"""The laws in C99: one file, no dynamic memory, nothing but headers of the standard library."""

from __future__ import annotations

import ast
from collections import Counter
from textwrap import wrap

from fastcoil.deliver.export.printer import Printer, aligned, statements_in
from fastcoil.deliver.export.source import Function, Laws, Named
from fastcoil.deliver.export.words import WIDTH, broken, number

_ZEROS = {"real": "0.0", "flag": "false", "whole": "0"}
_MATHEMATICS = ("exp", "log", "sqrt", "pow", "sin", "cos", "tan", "asin", "acos", "atan", "tanh", "floor")
_INCLUDED = "#include <math.h>\n#include <stdbool.h>\n#include <string.h>"
_COMPILE = "GCC and Clang need -ffp-contract=off for that, and never -ffast-math."
_PUBLIC = ("start", "step")


class InC(Printer):
    """Writes the laws in C, with ``name`` before the names that other files see."""

    TYPES = {"real": "double", "flag": "bool", "whole": "int", "": "void"}
    WORDS = {
        "or": "||", "and": "&&", "not": "!", "True": "true", "False": "false", "group": "", "=": "{} = {};",
        "return": "return {};", "if": "if ({}) {{", "elif": "}} else if ({}) {{", "else": "} else {", "end": "}",
    }  # fmt: skip
    FUNCTIONS = {f"math.{name}": name for name in _MATHEMATICS} | {
        "abs": "fabs", "max": "fmax", "min": "fmin", "float": "(double)", "int": "(int)",
    }  # fmt: skip
    BREAKS = r" (?=&& |\|\| |[-+*/] )|(?<=,) "

    def __init__(self, laws: Laws, name: str) -> None:
        super().__init__(laws)
        self.struct = f"{name}_state"
        self.functions |= {one: f"{name}_{one}" if one in _PUBLIC else one for one in laws.functions}
        self.declared: dict[str, str] = {}

    def text(self) -> str:
        """The whole file."""
        laws = self.laws
        parts = [
            self.comment(f"{laws.text}\n{_COMPILE}"),
            _INCLUDED,
            "\n".join(self._constants()).strip(),
            self.comment(f"{laws.state_text}\n\nOne full of zeros starts by itself.")
            + f"\ntypedef struct {{\n{self._fields()}\n}} {self.struct};",
            "\n".join(f"{self._head(laws.functions[one])};" for one in _PUBLIC),
            *(self._function(one) for one in laws.functions.values()),
        ]
        return "\n\n".join(parts) + "\n"

    def _constants(self) -> list[str]:
        """Those with a number as definitions, aligned from gap to gap."""
        lines: list[str] = []
        rows: list[tuple[str, str]] = []
        for one in self.laws.constants:
            if self.laws.has_gap(one.line):
                lines, rows = [*lines, *aligned(rows), ""], []
            rows += [(self.comment(line), "") for line in self.laws.above(one.line)]
            said = self.laws.comment(one.line)
            rows.append((self._constant(one), said and self.comment(said)))
        return [*lines, *aligned(rows)]

    def _constant(self, one: Named) -> str:
        if isinstance(one.value, list):
            numbers = wrap(", ".join(map(number, one.value)), WIDTH - 4)
            return "\n    ".join([f"static const double {one.name}[{len(one.value)}] = {{", *numbers]) + "\n};"
        value = self.constant(one.value)
        return f"#define {one.name} {f'({value})' if one.value < 0 else value}"

    def _fields(self) -> str:
        rows = []
        for one in self.laws.fields:
            size, said = f"[{one.size}]" if one.size else "", self.laws.comment(one.line)
            rows.append((f"    {self.TYPES[one.kind]} {one.name}{size};", said and self.comment(said)))
        return "\n".join(aligned(rows))

    def _head(self, one: Function) -> str:
        arguments = [f"{self.TYPES[kind]} {name}" for name, kind in one.arguments.items()]
        arguments = [f"{self.struct} *s", *arguments] if one.is_section else arguments
        static = "" if one.name in _PUBLIC else "static "
        head = f"{static}{self.TYPES[one.returns]} {self.functions[one.name]}({', '.join(arguments)})"
        return "\n".join(broken(head, r" (?=\w+ \w+[,)])"))

    def _function(self, one: Function) -> str:
        """A function; what it finds once is declared there, other variables before all."""
        nodes = list(statements_in(one.body))
        stored = Counter(ast.unparse(each) for node in nodes for each in _targets(node))
        counters = {ast.unparse(node.target) for node in nodes if isinstance(node, ast.For)}
        kinds = {name: kind for name, kind in self.locals_of(one.body, one.arguments).items() if name not in counters}
        once = {ast.unparse(each) for node in one.body for each in _targets(node) if stored[ast.unparse(each)] == 1}
        self.declared = {name: f"const {self.TYPES[kind]} {name}" for name, kind in kinds.items() if name in once}
        before = [
            f"    {self.TYPES[kind]} {name} = {_ZEROS[kind]};" for name, kind in kinds.items() if name not in once
        ]
        return "\n".join([self.comment(one.text), self._head(one), "{", *before, *self.block(one.body, 1), "}"])

    def target(self, node: ast.expr) -> str:
        return self.declared.get(self.say(node), self.say(node))

    def state(self, field: str) -> str:
        return f"s->{field}"

    def index(self, indices: list[str]) -> str:
        # fmin and fmax of whole numbers are doubles
        return "".join(f"[(int){one}]" if one.startswith("f") else f"[{one}]" for one in indices)

    def number(self, value: float) -> str:
        return number(value)

    def comment(self, text: str) -> str:
        lines = text.splitlines()
        return f"/* {text} */" if len(lines) == 1 else "\n".join(["/*", *(f" * {x}".rstrip() for x in lines), " */"])

    def call(self, function: Function, given: list[ast.expr]) -> list[str]:
        return [f"{self.functions[function.name]}({', '.join(['s', *map(self.say, given)])});"]

    def zeros(self, target: str, sizes: list[ast.expr]) -> list[str]:
        return [f"memset({target}, 0, sizeof {target});"]

    def loop(self, i: str, ends: tuple[ast.expr, ast.expr, bool]) -> tuple[str, str]:
        low, high, down = ends
        return (
            f"for (int {i} = {self.say(low)}; {i} {'>' if down else '<'} {self.say(high)}; {i}{'--' if down else '++'}) {{",
            "}",
        )


def _targets(node: ast.stmt) -> list[ast.expr]:
    """What a statement stores."""
    if isinstance(node, ast.Assign):
        return node.targets
    return [node.target] if isinstance(node, ast.AugAssign) else []

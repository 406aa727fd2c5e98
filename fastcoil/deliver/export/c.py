"""The laws in C99: one file, no dynamic memory, nothing but headers of the standard library."""

import ast
from textwrap import wrap
from typing import ClassVar

from fastcoil.deliver.export.printer import Printer, statements_in
from fastcoil.deliver.export.source import Function, Laws, Named
from fastcoil.deliver.export.words import WIDTH, broken, number

_ZEROS = {"real": "0.0", "flag": "false", "whole": "0"}
_MATHEMATICS = ("exp", "log", "sqrt", "pow", "sin", "cos", "tan", "asin", "acos", "atan", "tanh", "floor")
_INCLUDED = "#include <math.h>\n#include <stdbool.h>\n#include <string.h>"
_COMPILE = "GCC and Clang need -ffp-contract=off for that, and never -ffast-math."
_PUBLIC = ("start", "step")


class InC(Printer):
    """Writes the laws in C, with ``name`` before the names that other files see."""

    TYPES: ClassVar = {"real": "double", "flag": "bool", "whole": "int", "": "void"}
    WORDS: ClassVar = {
        "or": "||", "and": "&&", "not": "!", "True": "true", "False": "false", "state": "s->", "=": "{} = {};",
        "return": "return {};", "if": "if ({}) {{", "elif": "}} else if ({}) {{", "else": "} else {", "end if": "}",
        "up": "for (int {i} = {low}; {i} < {high}; {i}++) {{", "down": "for (int {i} = {low}; {i} > {high}; {i}--) {{",
        "end for": "}", "zeros": "memset({0}, 0, sizeof {0});",
    }  # fmt: skip
    FUNCTIONS: ClassVar = {f"math.{name}": name for name in _MATHEMATICS} | {
        "abs": "fabs", "max": "fmax", "min": "fmin", "float": "(double)", "int": "(int)",
    }  # fmt: skip
    COMMENT = ("/*", " * ", "*/")
    BREAKS = r" (?=&& |\|\| |[-+*/] )|(?<=,) "

    def __init__(self, laws: Laws, name: str) -> None:
        super().__init__(laws)
        self.struct = f"{name}_state"
        self.functions |= {one: f"{name}_{one}" if one in _PUBLIC else one for one in laws.functions}

    def text(self) -> str:
        """The whole file."""
        laws = self.laws
        fields = "\n".join(self.listed(laws.fields, self._field, "    "))
        state = self.comment(f"{laws.state_text}\n\nOne full of zeros starts by itself.")
        parts = [
            self.comment(f"{laws.text}\n{_COMPILE}"),
            _INCLUDED,
            "\n".join(self.listed(laws.constants, self._constant)),
            f"{state}\ntypedef struct {{\n{fields}\n}} {self.struct};",
            "\n".join(f"{self._head(laws.functions[one])};" for one in _PUBLIC),
            *(self._function(one) for one in laws.functions.values()),
        ]
        return "\n\n".join(parts) + "\n"

    def _constant(self, one: Named) -> str:
        if isinstance(one.value, list):
            numbers = wrap(", ".join(map(number, one.value)), WIDTH - 4)
            return "\n    ".join([f"static const double {one.name}[{len(one.value)}] = {{", *numbers]) + "\n};"
        value = self.constant(one.value)
        return f"#define {one.name} {f'({value})' if one.value < 0 else value}"

    def _field(self, one: Named) -> str:
        return f"{self.TYPES[one.kind]} {one.name}{f'[{one.size}]' if one.size else ''};"

    def _head(self, one: Function) -> str:
        arguments = [f"{self.TYPES[each.kind]} {each.name}" for each in one.arguments]
        arguments = [f"{self.struct} *s", *arguments] if one.is_section else arguments
        static = "" if one.name in _PUBLIC else "static "
        head = f"{static}{self.TYPES[one.returns]} {self.functions[one.name]}({', '.join(arguments)})"
        return "\n".join(broken(head, r"(?<=,) "))

    def _function(self, one: Function) -> str:
        """A function, its variables before all but the counters of loops."""
        counters = {ast.unparse(node.target) for node in statements_in(one.body) if isinstance(node, ast.For)}
        kinds = {name: kind for name, kind in self.locals_of(one.body, one.kinds).items() if name not in counters}
        before = [f"    {self.TYPES[kind]} {name} = {_ZEROS[kind]};" for name, kind in kinds.items()]
        return "\n".join([self.comment(one.text), self._head(one), "{", *before, *self.block(one.body, 1), "}"])

    def _term(self, node: ast.expr) -> str:
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Call):  # fmin of whole numbers is a double
            return f"{self.say(node.value)}[(int){self.say(node.slice)}]"
        return super()._term(node)

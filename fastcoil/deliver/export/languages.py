"""The laws in C99, and as a function block in Structured Text of IEC 61131-3.

C is one file without dynamic memory, with nothing but headers of the standard library.  Structured Text has what its
second edition has, and so every later one: functions of numbers stay functions; what works on the state is written
where it is called, for functions of that edition see no state but their own, and function blocks have no methods.
The XML of PLCopen (TC6 2.01, IEC 61131-10; ``laws/plcopen.xml.jinja``) has the units as elements, their bodies as text.
"""

import ast
from textwrap import wrap
from typing import ClassVar, NamedTuple

from fastcoil.deliver.export.printer import Function, Laws, Named, Printer, statements_in
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


OUTPUTS = ("command", "u", "integral_part", "e", "rising", "switches", "estimate", "test", "test_aborted")
_STEP = "    "
_INTERMEDIATE = "VAR  (* Intermediate values. *)"


class Unit(NamedTuple):
    """A function, or the block, which ``returns`` nothing; ``variables`` by what their declaration begins with."""

    name: str
    returns: str
    text: str
    variables: dict[str, list[Named]]
    body: list[str]


_X = {"VAR_INPUT": [Named("x", "real")]}
_MISSING = {
    "math.floor": Unit(
        "floor", "real", "Largest whole number up to x, between -2E9 and 2E9.", _X | {"VAR": [Named("found", "real")]},
        [
            *("found := DINT_TO_LREAL(TRUNC(x));", "IF found > x THEN", f"{_STEP}found := found - 1.0;", "END_IF;"),
            "{} := found;",
        ],
    ),
    "math.tanh": Unit(
        "tanh", "real", "Hyperbolic tangent.", _X,
        ["{} := 1.0 - 2.0 / (EXP(2.0 * MAX(MIN(x, 20.0), -20.0)) + 1.0);"],
    ),
}  # fmt: skip
"""Functions that the standard lacks."""


class InST(Printer):
    """Writes the laws in Structured Text; ``name`` is part of the names that a project sees."""

    TYPES: ClassVar = {"real": "LREAL", "flag": "BOOL", "whole": "INT"}
    WORDS: ClassVar = {
        "or": "OR", "and": "AND", "not": "NOT ", "True": "TRUE", "False": "FALSE", "==": "=", "!=": "<>", "state": "",
        "=": "{} := {};", "if": "IF {} THEN", "elif": "ELSIF {} THEN", "else": "ELSE", "end if": "END_IF;",
        "up": "FOR {i} := {low} TO {last} DO", "down": "FOR {i} := {low} TO {last} BY -1 DO", "end for": "END_FOR;",
        "zeros": f"FOR i := 0 TO {{1}} DO\n{_STEP}{{0}}[i] := 0.0;\nEND_FOR;",
    }  # fmt: skip
    FUNCTIONS: ClassVar = {
        "abs": "ABS", "max": "MAX", "min": "MIN", "math.exp": "EXP", "math.log": "LN", "math.sqrt": "SQRT",
        "math.sin": "SIN", "math.cos": "COS", "math.tan": "TAN", "math.asin": "ASIN", "math.acos": "ACOS",
        "math.atan": "ATAN", "math.pow": "EXPT", "float": "INT_TO_LREAL", "int": "TRUNC",
    }  # fmt: skip
    COMMENT = ("(*", "   ", "*)")
    BREAKS = r" (?=AND |OR |[-+*/] )|(?<=,) "

    def __init__(self, laws: Laws, name: str) -> None:
        super().__init__(laws)
        self.block_name = f"FB_{name}"
        self.missing = {word: f"F_{name}_{word[5:]}" for word in _MISSING if f"{word}(" in laws.source}
        self.functions |= self.missing
        self.functions |= {one: f"F_{name}_{one}" for one, own in laws.functions.items() if not own.is_section}

    def text(self) -> str:
        return "\n\n".join([self.comment(self.laws.text), *map(self._written, self.units())]) + "\n"

    def units(self) -> list[Unit]:
        """The functions, and the block at the end."""
        missing = [
            _MISSING[word]._replace(name=own, body=[line.format(own) for line in _MISSING[word].body])
            for word, own in self.missing.items()
        ]
        functions = [self._function(one) for one in self.laws.functions.values() if not one.is_section]
        return [*missing, *functions, self._block()]

    def _written(self, unit: Unit) -> str:
        if unit.returns:
            lines = [self.comment(unit.text), f"FUNCTION {unit.name} : {self.TYPES[unit.returns]}"]
        else:
            lines = [f"FUNCTION_BLOCK {unit.name}"]
        for opening, variables in unit.variables.items():
            declared = self._constant if opening == "VAR CONSTANT" else self._declared
            grouped = opening == _INTERMEDIATE
            each = self._intermediate(variables) if grouped else self.listed(variables, declared, _STEP)
            lines += [opening, *each, "END_VAR"]
        lines += unit.body if unit.returns else ["", *unit.body]
        return "\n".join([*lines, "END_FUNCTION" if unit.returns else "END_FUNCTION_BLOCK"])

    def _function(self, one: Function) -> Unit:
        own = self.functions[one.name]
        self.words["return"] = f"{own} := {{}};\nRETURN;"
        body = self.block(one.body, 0)
        return Unit(
            own, one.returns, one.text,
            {"VAR_INPUT": one.arguments} | self._locals(one),
            body[:-1] if body[-1] == "RETURN;" else body,
        )  # fmt: skip

    def _block(self) -> Unit:
        laws, step = self.laws, self.laws.functions["step"]
        variables = {
            "VAR_INPUT": step.arguments,
            "VAR_OUTPUT": [one for one in laws.fields if one.name in OUTPUTS],
            "VAR CONSTANT": laws.constants,
            f"VAR  (* {laws.state_text} *)": [one for one in laws.fields if one.name not in OUTPUTS],
        }
        return Unit(self.block_name, "", laws.text, variables | self._locals(step), self._section(step))

    def _locals(self, one: Function) -> dict[str, list[Named]]:
        kinds = self.locals_of(one.body, one.kinds)
        return {_INTERMEDIATE: [Named(name, kind) for name, kind in kinds.items()]} if kinds else {}

    def locals_of(self, body: list[ast.stmt], arguments: dict[str, str]) -> dict[str, str]:
        """With those of the sections that are called, which are written there."""
        found = super().locals_of(body, arguments)
        for node in statements_in(body):
            inner: dict[str, str] = {}
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
                one = self.laws.functions[ast.unparse(node.value.func)]
                passed = zip(one.kinds.items(), node.value.args[1:], strict=True)
                inner = {name: kind for (name, kind), value in passed if ast.unparse(value) != name}
                inner |= self.locals_of(one.body, one.kinds)
            elif isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("zeros("):
                inner = {"i": "whole"}
            found |= inner
        return found

    def _declared(self, one: Named) -> str:
        array = f"ARRAY[0..{one.size - 1}] OF " if one.size else ""
        return f"{one.name} : {array}{self.TYPES[one.kind]};"

    def _intermediate(self, variables: list[Named]) -> list[str]:
        lines = []
        for kind, word in self.TYPES.items():
            names = [one.name for one in variables if one.kind == kind]
            lines += wrap(f"{', '.join(names)} : {word};", WIDTH - 4) if names else []
        return [_STEP + line for line in lines]

    def _constant(self, one: Named) -> str:
        if isinstance(one.value, list):
            numbers = [_STEP * 2 + line for line in wrap(", ".join(map(st_number, one.value)), WIDTH - 8)]
            return "\n".join([f"{one.name} : ARRAY[0..{len(one.value) - 1}] OF LREAL := [", *numbers, f"{_STEP}];"])
        return f"{one.name} : {self.TYPES[one.kind]} := {self.constant(one.value)};"

    def call(self, function: Function, given: list[ast.expr]) -> list[str]:
        """What it does, behind the values of its arguments."""
        passed = zip(function.kinds, given, strict=True)
        values = [f"{name} := {self.say(value)};" for name, value in passed if ast.unparse(value) != name]
        return [*values, *self._section(function), ""]

    def _section(self, one: Function) -> list[str]:
        body = one.body[:-1] if isinstance(one.body[-1], ast.Return) else one.body  # the output is the command
        lines = self.block(body, 0)
        return [*self.comment(one.text).splitlines(), *(lines if lines[-1] else lines[:-1])]

    def number(self, value: float) -> str:
        return st_number(value)


def st_number(value: float) -> str:
    """A number as Structured Text writes it: 1.0E-9."""
    mantissa, e, power = number(value).partition("e")
    return mantissa + ("" if "." in mantissa else ".0") + (f"E{power}" if e else "")

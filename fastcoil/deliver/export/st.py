"""The laws as a function block in Structured Text, IEC 61131-3: what its second edition has, and so every later one.

Functions of numbers stay functions.  What works on the state is written where it is called: functions of the second
edition see no state but their own, and function blocks have no methods.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from textwrap import wrap

from fastcoil.deliver.export.printer import Printer, aligned, statements_in
from fastcoil.deliver.export.source import Function, Laws, Named
from fastcoil.deliver.export.words import WIDTH, number

OUTPUTS = ("command", "u", "integral_part", "e", "rising", "switches", "estimate")
"""What the block shows of its state."""
_MISSING = {
    "math.floor": (
        "DINT_TO_LREAL(TRUNC(x))", "found > x", "found - 1.0", "Largest whole number up to x, between -2E9 and 2E9.",
    ),
    "math.tanh": ("1.0 - 2.0 / (EXP(2.0 * MIN(x, 20.0)) + 1.0)", "x < -20.0", "-1.0", "Hyperbolic tangent."),
}  # fmt: skip
"""Functions that the standard lacks: value, a condition, the value then, and what it is."""
_STEP = "    "


class InST(Printer):
    """Writes the laws in Structured Text; ``name`` is part of the names that a project sees."""

    TYPES = {"real": "LREAL", "flag": "BOOL", "whole": "INT"}
    WORDS = {
        "or": "OR", "and": "AND", "not": "NOT ", "True": "TRUE", "False": "FALSE", "==": "=", "!=": "<>", "group": "",
        "=": "{} := {};", "if": "IF {} THEN", "elif": "ELSIF {} THEN", "else": "ELSE", "end": "END_IF;",
    }  # fmt: skip
    FUNCTIONS = {
        "abs": "ABS", "max": "MAX", "min": "MIN", "math.exp": "EXP", "math.log": "LN", "math.sqrt": "SQRT",
        "math.sin": "SIN", "math.cos": "COS", "math.tan": "TAN", "math.asin": "ASIN", "math.acos": "ACOS",
        "math.atan": "ATAN", "math.pow": "EXPT", "float": "INT_TO_LREAL", "int": "TRUNC",
    }  # fmt: skip
    BREAKS = r" (?=AND |OR |[-+*/] )|(?<=,) "

    def __init__(self, laws: Laws, name: str) -> None:
        super().__init__(laws)
        self.block_name = f"FB_{name}"
        self.missing = {word: f"F_{name}_{word[5:]}" for word in _MISSING if f"{word}(" in laws.source}
        self.functions |= self.missing
        self.functions |= {one: f"F_{name}_{one}" for one, own in laws.functions.items() if not own.is_section}

    def text(self) -> str:
        """The whole file."""
        missing = [self._missing(own, *_MISSING[word]) for word, own in self.missing.items()]
        functions = [self._function(one) for one in self.laws.functions.values() if not one.is_section]
        return "\n\n".join([self.comment(self.laws.text), *missing, *functions, self._block()]) + "\n"

    def _missing(self, own: str, value: str, test: str, other: str, said: str) -> str:
        return (
            f"{self.comment(said)}\nFUNCTION {own} : LREAL\nVAR_INPUT\n{_STEP}x : LREAL;\nEND_VAR\nVAR\n"
            f"{_STEP}found : LREAL;\nEND_VAR\nfound := {value};\nIF {test} THEN\n{_STEP}found := {other};\nEND_IF;\n"
            f"{own} := found;\nEND_FUNCTION"
        )

    def _function(self, one: Function) -> str:
        inputs = [f"{_STEP}{name} : {self.TYPES[kind]};" for name, kind in one.arguments.items()]
        own = self.functions[one.name]
        self.WORDS = {**type(self).WORDS, "return": f"{own} := {{}};\nRETURN;"}
        body = self.block(one.body, 0)
        lines = [
            *(self.comment(one.text), f"FUNCTION {own} : {self.TYPES[one.returns]}"),
            *("VAR_INPUT", *inputs, "END_VAR", *self._declared(self.locals_of(one.body, one.arguments))),
            *(body[:-1] if body[-1] == "RETURN;" else body),
            "END_FUNCTION",
        ]
        return "\n".join(lines)

    def _block(self) -> str:
        laws, step = self.laws, self.laws.functions["step"]
        inputs = [
            (f"{_STEP}{name} : {self.TYPES[kind]};", self.comment(laws.comment(step.lines[name])))
            for name, kind in step.arguments.items()
        ]
        shown: list[tuple[str, str]] = []
        hidden: list[tuple[str, str]] = []
        for one in laws.fields:
            said = laws.comment(one.line)
            array = f"ARRAY[0..{one.size - 1}] OF " if one.size else ""
            row = (f"{_STEP}{one.name} : {array}{self.TYPES[one.kind]};", said and self.comment(said))
            (shown if one.name in OUTPUTS else hidden).append(row)
        lines = [
            f"FUNCTION_BLOCK {self.block_name}",
            *("VAR_INPUT", *aligned(inputs), "END_VAR"),
            *("VAR_OUTPUT", *aligned(shown), "END_VAR"),
            *("VAR CONSTANT", *self._constants(), "END_VAR"),
            *(f"VAR  (* {laws.state_text} *)", *aligned(hidden), "END_VAR"),
            *self._declared(self.locals_of(step.body, step.arguments)),
            *("", *self._section(step), "END_FUNCTION_BLOCK"),
        ]
        return "\n".join(lines)

    def locals_of(self, body: list[ast.stmt], arguments: dict[str, str]) -> dict[str, str]:
        """With those of the sections that are called, which are written there."""
        found = super().locals_of(body, arguments)
        for node in statements_in(body):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
                one = self.laws.functions[ast.unparse(node.value.func)]
                passed = zip(one.arguments.items(), node.value.args[1:], strict=True)
                inner = {name: kind for (name, kind), value in passed if ast.unparse(value) != name}
                inner |= self.locals_of(one.body, one.arguments)
                for name, kind in inner.items():
                    if found.setdefault(name, kind) != kind:
                        raise TypeError(f"{name} has two types in the laws")
            elif isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("zeros("):
                found["i"] = "whole"
        if arguments is self.laws.functions["step"].arguments:
            named = [*arguments, *(one.name for one in (*self.laws.constants, *self.laws.fields))]
            for name in {each.lower() for each in named} & {each.lower() for each in found}:
                raise TypeError(f"{name} is two things in the laws: Structured Text does not tell them apart")
        return found

    def _declared(self, kinds: Mapping[str, str]) -> list[str]:
        """Declarations of the intermediate values, by type."""
        lines = []
        for kind, word in self.TYPES.items():
            names = [name for name, own in kinds.items() if own == kind]
            lines += wrap(f"{', '.join(names)} : {word};", WIDTH - 4) if names else []
        return ["VAR  (* Intermediate values. *)", *(_STEP + line for line in lines), "END_VAR"] if lines else []

    def _constants(self) -> list[str]:
        rows: list[tuple[str, str]] = []
        for one in self.laws.constants:
            rows += [("", "")] if rows and self.laws.has_gap(one.line) else []
            rows += [(_STEP + self.comment(line), "") for line in self.laws.above(one.line)]
            said = self.laws.comment(one.line)
            rows.append((_STEP + self._constant(one), said and self.comment(said)))
        return aligned(rows)

    def _constant(self, one: Named) -> str:
        if isinstance(one.value, list):
            numbers = [_STEP * 2 + line for line in wrap(", ".join(map(st_number, one.value)), WIDTH - 8)]
            return "\n".join([f"{one.name} : ARRAY[0..{len(one.value) - 1}] OF LREAL := [", *numbers, f"{_STEP}];"])
        return f"{one.name} : {self.TYPES[one.kind]} := {self.constant(one.value)};"

    def call(self, function: Function, given: list[ast.expr]) -> list[str]:
        """What it does, behind the values of its arguments, with a gap around it."""
        passed = zip(function.arguments, given, strict=True)
        values = [f"{name} := {self.say(value)};" for name, value in passed if ast.unparse(value) != name]
        return [*values, *self._section(function), ""]

    def _section(self, one: Function) -> list[str]:
        body = one.body[:-1] if isinstance(one.body[-1], ast.Return) else one.body  # the output is the command
        lines = self.block(body, 0)
        return [*self.comment(one.text).splitlines(), *(lines[:-1] if not lines[-1] else lines)]

    def state(self, field: str) -> str:
        return field

    def index(self, indices: list[str]) -> str:
        return f"[{', '.join(indices)}]"

    def number(self, value: float) -> str:
        return st_number(value)

    def comment(self, text: str) -> str:
        lines = text.splitlines()
        return f"(* {text} *)" if len(lines) == 1 else "\n".join(["(*", *(f"   {x}".rstrip() for x in lines), "*)"])

    def zeros(self, target: str, sizes: list[ast.expr]) -> list[str]:
        return [f"FOR i := 0 TO {self._before(sizes[0])} DO", f"{_STEP}{target}[i] := 0.0;", "END_FOR;"]

    def loop(self, i: str, ends: tuple[ast.expr, ast.expr, bool]) -> tuple[str, str]:
        low, high, down = ends
        last = self._before(high, -1) if down else self._before(high)
        return f"FOR {i} := {self.say(low)} TO {last}{' BY -1' if down else ''} DO", "END_FOR;"

    def _before(self, node: ast.expr, less: int = 1) -> str:
        """A whole number one back, or one on."""
        if isinstance(node, ast.Constant) and isinstance(node.value, int):
            return str(node.value - less)
        return f"{self.say(node)} {'-' if less > 0 else '+'} 1"


def st_number(value: float) -> str:
    """A number as Structured Text writes it: 1.0E-9."""
    mantissa, e, power = number(value).partition("e")
    return mantissa + ("" if "." in mantissa else ".0") + (f"E{power}" if e else "")

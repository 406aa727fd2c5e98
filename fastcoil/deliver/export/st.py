"""The laws as a function block in Structured Text, IEC 61131-3: what its second edition has, and so every later one.

Functions of numbers stay functions.  What works on the state is written where it is called: functions of the second
edition see no state but their own, and function blocks have no methods.
"""

from __future__ import annotations

import ast
from textwrap import indent, wrap

from fastcoil.deliver.export.expressions import Language, broken, kind_of
from fastcoil.deliver.export.source import Constant, Function, Laws, aligned, counted, is_elif
from fastcoil.deliver.export.words import WIDTH, number

OUTPUTS = ("command", "u", "integral_part", "e", "rising", "switches", "estimate")
"""What the block shows of its state."""
_TYPES = {"real": "LREAL", "flag": "BOOL", "whole": "INT"}
_WORDS = {
    "or": "OR",
    "and": "AND",
    "not": "NOT ",
    "True": "TRUE",
    "False": "FALSE",
    "==": "=",
    "!=": "<>",
    "group": "yes",
}
_WORDS |= {sign: sign for sign in ("<", "<=", ">", ">=")}
_FUNCTIONS = {
    "abs": "ABS", "max": "MAX", "min": "MIN", "math.exp": "EXP", "math.log": "LN", "math.sqrt": "SQRT",
    "math.sin": "SIN", "math.cos": "COS", "math.tan": "TAN", "math.asin": "ASIN", "math.acos": "ACOS",
    "math.atan": "ATAN", "math.pow": "EXPT", "float": "INT_TO_LREAL", "int": "TRUNC",
}  # fmt: skip
_MISSING = {
    "floor": (
        "DINT_TO_LREAL(TRUNC(x))",
        "found > x",
        "found - 1.0",
        "Largest whole number up to x, between -2E9 and 2E9.",
    ),
    "tanh": ("1.0 - 2.0 / (EXP(2.0 * MIN(x, 20.0)) + 1.0)", "x < -20.0", "-1.0", "Hyperbolic tangent."),
}
"""Functions that the standard lacks: value, a condition, the value then, and what it is."""
_BREAKS = r" (?=AND |OR |[-+*/] )"
_STEP = "    "


class InST:
    """Writes the laws in Structured Text; ``name`` is part of the names that a project sees."""

    def __init__(self, laws: Laws, name: str) -> None:
        self.laws, self.block_name = laws, f"FB_{name}"
        self.functions = {f: f"F_{name}_{f}" for f, one in laws.functions.items() if not one.is_section}
        lacking = [word for word in _MISSING if any(f"math.{word}(" in line for line in laws.lines)]
        self.missing = {f"math.{word}": f"F_{name}_{word}" for word in lacking}
        self.sizes = {one.name: one.value for one in laws.constants if isinstance(one.value, int)}
        self.locals: dict[str, str] = {}
        self.inset = 0
        self.arguments = laws.functions["step"].arguments
        step = laws.functions["step"]
        self.taken = {name.lower() for name in [*step.arguments, *self.sizes]}
        self.taken |= {one.name.lower() for one in laws.constants} | {one.name.lower() for one in laws.fields}
        self.language = Language(
            _WORDS,
            _FUNCTIONS | self.functions | self.missing,
            lambda field: field,
            lambda indices: f"[{', '.join(indices)}]",
            st_number,
        )

    def text(self) -> str:
        """The whole file."""
        functions = [self._function(one) for one in self.laws.functions.values() if not one.is_section]
        missing = [self._missing(word.removeprefix("math."), own) for word, own in self.missing.items()]
        self.locals = {}
        body = self._section(self.laws.functions["step"])
        return "\n\n".join([_comment(self.laws.text), *missing, *functions, self._block_of(body)]) + "\n"

    def _missing(self, word: str, own: str) -> str:
        value, test, other, said = _MISSING[word]
        return (
            f"{_comment(said)}\nFUNCTION {own} : LREAL\nVAR_INPUT\n{_STEP}x : LREAL;\nEND_VAR\nVAR\n"
            f"{_STEP}found : LREAL;\nEND_VAR\nfound := {value};\nIF {test} THEN\n{_STEP}found := {other};\nEND_IF;\n"
            f"{own} := found;\nEND_FUNCTION"
        )

    def _function(self, one: Function) -> str:
        inputs = [f"{_STEP}{name} : {_TYPES[kind]};" for name, kind in one.arguments.items()]
        self.locals, own = {}, self.functions[one.name]
        before, self.arguments, self.taken = (self.arguments, self.taken), one.arguments, set()
        body = self._statements(one.body, own)
        self.arguments, self.taken = before
        body = body[:-1] if body[-1].strip() == "RETURN;" else body
        return "\n".join(
            [
                _comment(one.text), f"FUNCTION {own} : {_TYPES[one.returns]}",
                "VAR_INPUT", *inputs, "END_VAR", *self._declared_locals(), *body, "END_FUNCTION",
            ]
        )  # fmt: skip

    def _block_of(self, body: list[str]) -> str:
        laws, step = self.laws, self.laws.functions["step"]
        inputs = [
            (f"{_STEP}{name} : {_TYPES[kind]};", _comment(laws.comment(step.lines[name])))
            for name, kind in step.arguments.items()
        ]
        shown: list[tuple[str, str]] = []
        hidden: list[tuple[str, str]] = []
        for one in laws.fields:
            said = laws.comment(one.line)
            row = (f"{_STEP}{one.name} : {self._array(one.sizes)}{_TYPES[one.kind]};", said and _comment(said))
            (shown if one.name in OUTPUTS else hidden).append(row)
        parts = [
            f"FUNCTION_BLOCK {self.block_name}",
            *("VAR_INPUT", *aligned(inputs), "END_VAR"),
            *("VAR_OUTPUT", *aligned(shown), "END_VAR"),
            *("VAR CONSTANT", *self._constants(), "END_VAR"),
            *("VAR  (* " + laws.state_text + " *)", *aligned(hidden), "END_VAR"),
            *self._declared_locals(),
            "",
            *body,
            "END_FUNCTION_BLOCK",
        ]
        return "\n".join(parts)

    def _declared_locals(self) -> list[str]:
        """Declarations of the intermediate values, by type."""
        lines = []
        for kind, word in _TYPES.items():
            names = [name for name, own in self.locals.items() if own == kind]
            lines += wrap(f"{', '.join(names)} : {word};", WIDTH - 4) if names else []
        return ["VAR  (* Intermediate values. *)", *(_STEP + line for line in lines), "END_VAR"] if lines else []

    def _constants(self) -> list[str]:
        rows: list[tuple[str, str]] = []
        for one in self.laws.constants:
            rows += [("", "")] if rows and self.laws.has_gap(one.line) else []
            rows += [(_STEP + _comment(line), "") for line in self.laws.above(one.line)]
            said = self.laws.comment(one.line)
            rows.append((_STEP + self._constant(one), said and _comment(said)))
        return aligned(rows)

    def _constant(self, one: Constant) -> str:
        if isinstance(one.value, list):
            numbers = wrap(", ".join(map(st_number, one.value)), WIDTH - 8)
            numbers = [_STEP * 2 + line for line in numbers]
            return "\n".join([f"{one.name} : ARRAY[0..{len(one.value) - 1}] OF LREAL := [", *numbers, f"{_STEP}];"])
        value = st_number(one.value) if isinstance(one.value, float) else str(one.value)
        return f"{one.name} : {_TYPES[one.kind]} := {value};"

    def _array(self, sizes: tuple[str, ...]) -> str:
        ends = [self.sizes[size] if size in self.sizes else int(size) for size in sizes]
        return f"ARRAY[{', '.join(f'0..{end - 1}' for end in ends)}] OF " if ends else ""

    def _called_section(self, one: Function, given: list[ast.expr]) -> list[str]:
        """What a section does, behind the values of its arguments."""
        lines = []
        for (name, kind), value in zip(one.arguments.items(), given, strict=True):
            if not (isinstance(value, ast.Name) and value.id == name):
                self._declare(name, kind)
                lines.append(f"{name} := {self.language.say(value)};")
        return [*lines, *self._section(one)]

    def _section(self, one: Function) -> list[str]:
        return [*_comment(one.text).splitlines(), *self._statements(one.body)]

    def _statements(self, body: list[ast.stmt], own: str = "") -> list[str]:
        lines: list[str] = []
        for k, node in enumerate(body):
            section = isinstance(node, ast.Expr)
            gap = k and lines[-1] and (section or self.laws.has_gap(node.lineno))
            lines += [""] if gap else []
            lines += [_comment(said) for said in self.laws.above(node.lineno)]
            if isinstance(node, ast.Return) and not own:
                break  # the output is the command
            first, *rest = self._statement(node, own)
            said = self.laws.comment(node.lineno)
            beside = f"{first}  {_comment(said)}" if said else first
            width = WIDTH - self.inset
            if len(beside) > width:
                lines, beside = [*lines, *([_comment(said)] if said else [])], first
            lines += [*broken(beside, width, _BREAKS), *rest]
            lines += [""] if section and k + 1 < len(body) else []
        return lines

    def _statement(self, node: ast.stmt, own: str) -> list[str]:  # noqa: PLR0911 — one for each kind
        say = self.language.say
        if isinstance(node, ast.Assign):
            target, value = node.targets[0], node.value
            if isinstance(value, ast.Call) and ast.unparse(value.func) == "zeros":
                return self._zeros(say(target), value)
            if isinstance(target, ast.Name):
                self._declare(target.id, kind_of(value, self._kinds()))
            return [f"{say(target)} := {say(value)};"]
        if isinstance(node, ast.AugAssign):
            changed = ast.BinOp(node.target, node.op, node.value)
            return [f"{say(node.target)} := {say(changed)};"]
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            return self._called_section(self.laws.functions[ast.unparse(node.value.func)], node.value.args[1:])
        if isinstance(node, ast.Return) and node.value is not None:
            return [f"{own} := {say(node.value)};", "RETURN;"]
        if isinstance(node, ast.For) and isinstance(node.target, ast.Name) and isinstance(node.iter, ast.Call):
            return self._loop(node.target.id, node.iter, node.body)
        if isinstance(node, ast.If):
            lines = [f"IF {say(node.test)} THEN", *self._inner(node.body, own)]
            while len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If) and is_elif(node, self.laws):
                node = node.orelse[0]
                lines += [f"ELSIF {say(node.test)} THEN", *self._inner(node.body, own)]
            lines += ["ELSE", *self._inner(node.orelse, own)] if node.orelse else []
            return [*lines, "END_IF;"]
        raise TypeError(f"the laws have no {ast.unparse(node)}")

    def _inner(self, body: list[ast.stmt], own: str) -> list[str]:
        self.inset += len(_STEP)
        lines = indent("\n".join(self._statements(body, own)), _STEP).split("\n")
        self.inset -= len(_STEP)
        return lines

    def _loop(self, i: str, call: ast.Call, body: list[ast.stmt]) -> list[str]:
        low, high, down = counted(call)
        self._declare(i, "whole")
        first = self.language.say(low)
        last = self._next(high, 1 if down else -1)
        by = " BY -1" if down else ""
        return [f"FOR {i} := {first} TO {last}{by} DO", *self._inner(body, ""), "END_FOR;"]

    def _next(self, node: ast.expr, more: int) -> str:
        """A whole number one on, or one back."""
        if isinstance(node, ast.Constant) and isinstance(node.value, int):
            return str(node.value + more)
        return f"{self.language.say(node)} {'+' if more > 0 else '-'} 1"

    def _zeros(self, target: str, call: ast.Call) -> list[str]:
        names = ("i", "k", "m")[: len(call.args)]
        lines = [f"{target}[{', '.join(names)}] := 0.0;"]
        for name, size in reversed(list(zip(names, call.args, strict=True))):
            self._declare(name, "whole")
            inner = [_STEP + line for line in lines]
            lines = [f"FOR {name} := 0 TO {self._next(size, -1)} DO", *inner, "END_FOR;"]
        return lines

    def _kinds(self) -> dict[str, str]:
        return self.laws.kinds | self.arguments | self.locals

    def _declare(self, name: str, kind: str) -> None:
        if name.lower() in self.taken:
            raise TypeError(f"{name} is two things in the laws: Structured Text does not tell them apart")
        if self.locals.setdefault(name, kind) != kind:
            raise TypeError(f"{name} has two types in the laws")


def st_number(value: float) -> str:
    """A number as Structured Text writes it: 1.0E-9."""
    mantissa, e, power = number(value).partition("e")
    return mantissa + ("" if "." in mantissa else ".0") + (f"E{power}" if e else "")


def _comment(text: str) -> str:
    """A comment of one line, or of several."""
    lines = text.splitlines()
    return f"(* {text} *)" if len(lines) == 1 else "\n".join(["(*", *(f"   {line}".rstrip() for line in lines), "*)"])

"""Print the laws in C99, as a function block in Structured Text of IEC 61131-3, and as XML of PLCopen around it.

Structured Text is that of the second edition, without methods: functions of numbers stay functions; sections, which
work on the state of the block, are inlined.
"""

import ast
from textwrap import wrap
from typing import ClassVar, NamedTuple

from fastcoil.deliver.export.printer import Declaration, Function, Laws, Printer, nested_statements
from fastcoil.deliver.export.words import LINE_WIDTH, break_line, number_literal

_PUBLIC_FUNCTIONS = ("start", "step")


class CPrinter(Printer):
    """Prints the laws in C; ``name`` is the prefix of the public names."""

    TYPES: ClassVar = {"real": "double", "flag": "bool", "whole": "int", "": "void"}
    SYNTAX: ClassVar = {
        "or": "||", "and": "&&", "not": "!", "True": "true", "False": "false", "state": "s->", "=": "{} = {};",
        "return": "return {};", "if": "if ({}) {{", "elif": "}} else if ({}) {{", "else": "} else {", "end if": "}",
        "up": "for (int {i} = {low}; {i} < {high}; {i}++) {{", "down": "for (int {i} = {low}; {i} > {high}; {i}--) {{",
        "end for": "}", "zeros": "memset({0}, 0, sizeof {0});",
    }  # fmt: skip
    FUNCTIONS: ClassVar = {
        f"math.{name}": name
        for name in ("exp", "log", "sqrt", "pow", "sin", "cos", "tan", "asin", "acos", "atan", "tanh", "floor")
    } | {"abs": "fabs", "max": "fmax", "min": "fmin", "float": "(double)", "int": "(int)"}
    COMMENT = ("/*", " * ", "*/")
    LINE_BREAKS = r" (?=&& |\|\| |[-+*/] )|(?<=,) "

    def __init__(self, laws: Laws, name: str) -> None:
        super().__init__(laws)
        self.struct_name = f"{name}_state"
        self.functions |= {function: function for function in laws.functions}
        self.functions |= {function: f"{name}_{function}" for function in _PUBLIC_FUNCTIONS}

    def code_text(self) -> str:
        laws = self.laws
        fields = "\n".join(self.declaration_lines(laws.fields, self._field_text, "    "))
        state = self.comment_text(f"{laws.state_text}\n\nOne full of zeros starts by itself.")
        parts = [
            self.comment_text(f"{laws.text}\nGCC and Clang need -ffp-contract=off for that, and never -ffast-math."),
            "#include <math.h>\n#include <stdbool.h>\n#include <string.h>",
            "\n".join(self.declaration_lines(laws.constants, self._constant_text)),
            f"{state}\ntypedef struct {{\n{fields}\n}} {self.struct_name};",
            "\n".join(f"{self._signature_text(laws.functions[function])};" for function in _PUBLIC_FUNCTIONS),
            *(self._function_text(function) for function in laws.functions.values()),
        ]
        return "\n\n".join(parts) + "\n"

    def _constant_text(self, constant: Declaration) -> str:
        if isinstance(constant.value, list):
            numbers = wrap(", ".join(map(number_literal, constant.value)), LINE_WIDTH - 4)
            head = f"static const double {constant.name}[{len(constant.value)}] = {{"
            return "\n    ".join([head, *numbers]) + "\n};"
        value = self.constant_text(constant.value)
        return f"#define {constant.name} {f'({value})' if constant.value < 0 else value}"

    def _field_text(self, field: Declaration) -> str:
        return f"{self.TYPES[field.kind]} {field.name}{f'[{field.size}]' if field.size else ''};"

    def _signature_text(self, function: Function) -> str:
        arguments = [f"{self.TYPES[argument.kind]} {argument.name}" for argument in function.arguments]
        arguments = [f"{self.struct_name} *s", *arguments] if function.is_section else arguments
        static = "" if function.name in _PUBLIC_FUNCTIONS else "static "
        head = f"{static}{self.TYPES[function.returns]} {self.functions[function.name]}({', '.join(arguments)})"
        return "\n".join(break_line(head, r"(?<=,) "))

    def _function_text(self, function: Function) -> str:
        """Print a function; its variables, except the counters of loops, are declared first."""
        counters = {ast.unparse(node.target) for node in nested_statements(function.body) if isinstance(node, ast.For)}
        zeros = {"real": "0.0", "flag": "false", "whole": "0"}
        lines = [self.comment_text(function.text), self._signature_text(function), "{"]
        for name, kind in self.kinds_of_locals(function.body, function.argument_kinds).items():
            lines += [f"    {self.TYPES[kind]} {name} = {zeros[kind]};"] if name not in counters else []
        return "\n".join([*lines, *self.block_lines(function.body, 1), "}"])

    def _term_text(self, node: ast.expr) -> str:
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Call):  # fmin of whole numbers is a double
            return f"{self.expression_text(node.value)}[(int){self.expression_text(node.slice)}]"
        return super()._term_text(node)


OUTPUT_FIELDS = ("command", "u", "integral_part", "e", "rising", "switches", "estimate", "test", "test_aborted")
_INDENT = "    "
_INTERMEDIATE_SECTION = "VAR  (* Intermediate values. *)"


class ProgramUnit(NamedTuple):
    """A function or the function block, which ``returns`` nothing; ``variables`` by the opening of their section."""

    name: str
    returns: str
    text: str
    variables: dict[str, list[Declaration]]
    body: list[str]


_MISSING_FUNCTIONS = {
    "math.floor": ProgramUnit(
        "floor", "real", "Largest whole number up to x, between -2E9 and 2E9.",
        {"VAR_INPUT": [Declaration("x", "real")], "VAR": [Declaration("whole", "real")]},
        [
            *("whole := DINT_TO_LREAL(TRUNC(x));", "IF whole > x THEN", f"{_INDENT}whole := whole - 1.0;", "END_IF;"),
            "{} := whole;",
        ],
    ),
    "math.tanh": ProgramUnit(
        "tanh", "real", "Hyperbolic tangent.", {"VAR_INPUT": [Declaration("x", "real")]},
        ["{} := 1.0 - 2.0 / (EXP(2.0 * MAX(MIN(x, 20.0), -20.0)) + 1.0);"],
    ),
}  # fmt: skip
"""Functions that Structured Text does not have, by those of Python, with {} for their name."""


class StructuredTextPrinter(Printer):
    """Prints the laws in Structured Text; ``name`` is part of the public names."""

    TYPES: ClassVar = {"real": "LREAL", "flag": "BOOL", "whole": "INT"}
    SYNTAX: ClassVar = {
        "or": "OR", "and": "AND", "not": "NOT ", "True": "TRUE", "False": "FALSE", "==": "=", "!=": "<>", "state": "",
        "=": "{} := {};", "if": "IF {} THEN", "elif": "ELSIF {} THEN", "else": "ELSE", "end if": "END_IF;",
        "up": "FOR {i} := {low} TO {last} DO", "down": "FOR {i} := {low} TO {last} BY -1 DO", "end for": "END_FOR;",
        "zeros": f"FOR i := 0 TO {{1}} DO\n{_INDENT}{{0}}[i] := 0.0;\nEND_FOR;",
    }  # fmt: skip
    FUNCTIONS: ClassVar = {
        "abs": "ABS", "max": "MAX", "min": "MIN", "math.exp": "EXP", "math.log": "LN", "math.sqrt": "SQRT",
        "math.sin": "SIN", "math.cos": "COS", "math.tan": "TAN", "math.asin": "ASIN", "math.acos": "ACOS",
        "math.atan": "ATAN", "math.pow": "EXPT", "float": "INT_TO_LREAL", "int": "TRUNC",
    }  # fmt: skip
    COMMENT = ("(*", "   ", "*)")
    LINE_BREAKS = r" (?=AND |OR |[-+*/] )|(?<=,) "

    def __init__(self, laws: Laws, name: str) -> None:
        super().__init__(laws)
        self.block_name = f"FB_{name}"
        missing = [word for word in _MISSING_FUNCTIONS if f"{word}(" in laws.source]
        self.missing_functions = {word: f"F_{name}_{word.removeprefix('math.')}" for word in missing}
        functions = [function.name for function in laws.functions.values() if not function.is_section]
        self.functions |= self.missing_functions | {function: f"F_{name}_{function}" for function in functions}

    def code_text(self) -> str:
        return "\n\n".join([self.comment_text(self.laws.text), *map(self._unit_text, self.units())]) + "\n"

    def units(self) -> list[ProgramUnit]:
        """Return the functions as units, and the function block at the end."""
        units = []
        for word, name in self.missing_functions.items():
            unit = _MISSING_FUNCTIONS[word]
            units.append(unit._replace(name=name, body=[line.format(name) for line in unit.body]))
        units += [self._function_unit(function) for function in self.laws.functions.values() if not function.is_section]
        return [*units, self._block_unit()]

    def _unit_text(self, unit: ProgramUnit) -> str:
        """Print a function or the function block."""
        if unit.returns:
            lines = [self.comment_text(unit.text), f"FUNCTION {unit.name} : {self.TYPES[unit.returns]}"]
        else:
            lines = [f"FUNCTION_BLOCK {unit.name}"]
        for opening, variables in unit.variables.items():
            declare = self._constant_text if opening == "VAR CONSTANT" else self._declaration_text
            if opening == _INTERMEDIATE_SECTION:
                declarations = self._intermediate_declarations(variables)
            else:
                declarations = self.declaration_lines(variables, declare, _INDENT)
            lines += [opening, *declarations, "END_VAR"]
        lines += unit.body if unit.returns else ["", *unit.body]
        return "\n".join([*lines, "END_FUNCTION" if unit.returns else "END_FUNCTION_BLOCK"])

    def _function_unit(self, function: Function) -> ProgramUnit:
        name = self.functions[function.name]
        self.syntax["return"] = f"{name} := {{}};\nRETURN;"
        body = self.block_lines(function.body, 0)
        variables = {"VAR_INPUT": function.arguments} | self._local_variables(function)
        body = body[:-1] if body[-1] == "RETURN;" else body
        return ProgramUnit(name, function.returns, function.text, variables, body)

    def _block_unit(self) -> ProgramUnit:
        laws, step = self.laws, self.laws.functions["step"]
        variables = {
            "VAR_INPUT": step.arguments,
            "VAR_OUTPUT": [field for field in laws.fields if field.name in OUTPUT_FIELDS],
            "VAR CONSTANT": laws.constants,
            f"VAR  (* {laws.state_text} *)": [field for field in laws.fields if field.name not in OUTPUT_FIELDS],
        }
        variables |= self._local_variables(step)
        return ProgramUnit(self.block_name, "", laws.text, variables, self._inlined_section_lines(step))

    def _local_variables(self, function: Function) -> dict[str, list[Declaration]]:
        kinds = self.kinds_of_locals(function.body, function.argument_kinds)
        return {_INTERMEDIATE_SECTION: [Declaration(name, kind) for name, kind in kinds.items()]} if kinds else {}

    def kinds_of_locals(self, body: list[ast.stmt], arguments: dict[str, str]) -> dict[str, str]:
        """Add the variables of the called sections, which are inlined."""
        kinds = super().kinds_of_locals(body, arguments)
        for node in nested_statements(body):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
                section = self.laws.functions[ast.unparse(node.value.func)]
                values = zip(section.argument_kinds.items(), node.value.args[1:], strict=True)
                kinds |= {name: kind for (name, kind), value in values if ast.unparse(value) != name}
                kinds |= self.kinds_of_locals(section.body, section.argument_kinds)
            elif isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("zeros("):
                kinds["i"] = "whole"
        return kinds

    def _declaration_text(self, variable: Declaration) -> str:
        array = f"ARRAY[0..{variable.size - 1}] OF " if variable.size else ""
        return f"{variable.name} : {array}{self.TYPES[variable.kind]};"

    def _intermediate_declarations(self, variables: list[Declaration]) -> list[str]:
        lines = []
        for kind, word in self.TYPES.items():
            names = [variable.name for variable in variables if variable.kind == kind]
            lines += wrap(f"{', '.join(names)} : {word};", LINE_WIDTH - 4) if names else []
        return [_INDENT + line for line in lines]

    def _constant_text(self, constant: Declaration) -> str:
        if isinstance(constant.value, list):
            literals = ", ".join(map(structured_text_literal, constant.value))
            numbers = [_INDENT * 2 + line for line in wrap(literals, LINE_WIDTH - 8)]
            head = f"{constant.name} : ARRAY[0..{len(constant.value) - 1}] OF LREAL := ["
            return "\n".join([head, *numbers, f"{_INDENT}];"])
        return f"{constant.name} : {self.TYPES[constant.kind]} := {self.constant_text(constant.value)};"

    def call_lines(self, function: Function, arguments: list[ast.expr]) -> list[str]:
        """Inline a section, after assignments to its arguments."""
        pairs = zip(function.argument_kinds, arguments, strict=True)
        lines = [f"{name} := {self.expression_text(value)};" for name, value in pairs if ast.unparse(value) != name]
        return [*lines, *self._inlined_section_lines(function), ""]

    def _inlined_section_lines(self, function: Function) -> list[str]:
        # the output is the command
        lines = self.block_lines(function.body[:-1] if isinstance(function.body[-1], ast.Return) else function.body, 0)
        return [*self.comment_text(function.text).splitlines(), *(lines if lines[-1] else lines[:-1])]

    def number_text(self, value: float) -> str:
        return structured_text_literal(value)


def structured_text_literal(value: float) -> str:
    """Return a number as a literal of Structured Text: 1.0E-9."""
    mantissa, e, power = number_literal(value).partition("e")
    return mantissa + ("" if "." in mantissa else ".0") + (f"E{power}" if e else "")

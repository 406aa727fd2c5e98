"""Parse the rendered laws, with the comment on each part, and print them in C or Structured Text."""

import ast
import io
import tokenize
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from textwrap import wrap
from typing import Any, ClassVar

from fastcoil.deliver.export.words import LINE_WIDTH, break_line, number_literal

_KINDS = {"float": "real", "bool": "flag", "int": "whole", "None": "", "list[float]": "real"}
"""Kind of a value by its Python type in the laws: every number is real but for the counters of loops."""


@dataclass(frozen=True)
class Declaration:
    """A constant with its value, a field of the state or an argument; size: of an array."""

    name: str
    kind: str
    description: str = ""
    value: float | int | list[float] = 0.0
    size: int = 0


@dataclass(frozen=True)
class Function:
    """A function of the laws: of numbers, or a section, whose first argument is the state."""

    name: str
    arguments: list[Declaration]
    returns: str
    text: str
    body: list[ast.stmt]
    is_section: bool

    @property
    def argument_kinds(self) -> dict[str, str]:
        return {argument.name: argument.kind for argument in self.arguments}


class Laws:
    """The constants, fields and functions in the text of the laws."""

    def __init__(self, text: str) -> None:
        tree, comments = ast.parse(text), _comments_by_line(text)
        self.source = text
        self.text, self.state_text = ast.get_docstring(tree) or "", ""
        self.constants: list[Declaration] = []
        self.fields: list[Declaration] = []
        self.functions: dict[str, Function] = {}
        for node in tree.body:
            if isinstance(node, ast.Assign):
                value = ast.literal_eval(node.value)
                name, kind = ast.unparse(node.targets[0]), "whole" if isinstance(value, int) else "real"
                self.constants.append(Declaration(name, kind, comments.get(node.lineno, ""), value))
            elif isinstance(node, ast.FunctionDef):
                self.functions[node.name] = _parse_function(node, comments)
        sizes = {
            ast.unparse(node.targets[0])[2:]: int(ast.unparse(node.value.args[0]))
            for node in self.functions["start"].body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call)
            if ast.unparse(node.value.func) == "zeros"
        }
        for node in next(node for node in tree.body if isinstance(node, ast.ClassDef)).body:
            if isinstance(node, ast.AnnAssign):
                name = ast.unparse(node.target)
                kind = _KINDS[ast.unparse(node.annotation)]
                self.fields.append(Declaration(name, kind, comments.get(node.lineno, ""), size=sizes.get(name, 0)))
            elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                self.state_text = str(node.value.value)
        self.kinds = {constant.name: constant.kind for constant in self.constants}
        self.kinds |= {f"s.{field.name}": field.kind for field in self.fields}
        self.kinds |= {function.name: function.returns for function in self.functions.values()}


def _comments_by_line(text: str) -> dict[int, str]:
    """Return the comment on each line, behind it or right above it, by the number of the line."""
    comments: dict[int, str] = {}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            line, comment = token.start[0], token.string.removeprefix("#").strip()
            if token.line.strip().startswith("#"):
                comments[line + 1] = f"{comments.pop(line, '')} {comment}".strip()
            else:
                comments[line] = comment
    return comments


def _parse_function(node: ast.FunctionDef, comments: dict[int, str]) -> Function:
    """Return a function of the laws from its tree; comments: by line."""
    arguments, is_section = [], False
    for argument in node.args.args:
        python_type = ast.unparse(argument.annotation or ast.Name("float"))
        if python_type == "State":
            is_section = True
        else:
            arguments.append(Declaration(argument.arg, _KINDS[python_type], comments.get(argument.lineno, "")))
    returns = _KINDS[ast.unparse(node.returns or ast.Name("None"))]
    return Function(node.name, arguments, returns, ast.get_docstring(node) or "", node.body[1:], is_section)


_PRECEDENCE = {"or": 1, "and": 2, "compare": 4, "sum": 5, "product": 6, "unary": 7, "whole": 8}
"""How tightly an operator binds, in C and in Structured Text."""
_OPERATORS: Mapping[type, tuple[str, str]] = {
    ast.Add: ("+", "sum"), ast.Sub: ("-", "sum"), ast.Mult: ("*", "product"), ast.Div: ("/", "product"),
    ast.Lt: ("<", "compare"), ast.LtE: ("<=", "compare"), ast.Gt: (">", "compare"), ast.GtE: (">=", "compare"),
    ast.Eq: ("==", "compare"), ast.NotEq: ("!=", "compare"), ast.And: ("and", "and"), ast.Or: ("or", "or"),
}  # fmt: skip


class Printer:
    """Base class of the printers of C and Structured Text."""

    SYNTAX: ClassVar[dict[str, str]]  # of operators, truths and parts of a statement, with {} for what is in them
    FUNCTIONS: ClassVar[dict[str, str]]  # their names by those of Python
    TYPES: ClassVar[dict[str, str]]  # of numbers by their kind
    COMMENT: ClassVar[tuple[str, str, str]]  # what stands before, in and behind one
    LINE_BREAKS: ClassVar[str]  # where a line may end

    def __init__(self, laws: Laws) -> None:
        self.laws, self.syntax, self.functions = laws, dict(self.SYNTAX), dict(self.FUNCTIONS)

    def comment_text(self, text: str) -> str:
        first, mark, last = self.COMMENT
        lines = [f"{mark}{line}".rstrip() for line in text.splitlines()]
        return f"{first} {text} {last}" if len(lines) < 2 else "\n".join([first, *lines, mark[:1].strip() + last])

    def number_text(self, value: float) -> str:
        return number_literal(value)

    def constant_text(self, value: object) -> str:
        if isinstance(value, bool):
            return self.syntax[str(value)]
        return self.number_text(value) if isinstance(value, float) else str(value)

    def declaration_lines(
        self, items: Iterable[Declaration], text: Callable[[Declaration], str], indent: str = ""
    ) -> list[str]:
        """Print declarations, each with its description as a comment behind or above."""
        lines: list[str] = []
        for item in items:
            code, comment = indent + text(item), self.comment_text(item.description)
            if not item.description:
                lines.append(code)
            elif len(code) + len(comment) < LINE_WIDTH - 1:
                lines.append(f"{code}  {comment}")
            else:
                comment_lines = wrap(item.description, LINE_WIDTH - 8)
                lines += [*(indent + self.comment_text(line) for line in comment_lines), code]
        return lines

    def expression_text(self, node: ast.expr, around: str = "or") -> str:
        """Print an expression, in brackets where it stands in an operator ``around`` that binds more tightly."""
        text, level = self._text_and_level(node)
        return f"({text})" if _PRECEDENCE[level] < _PRECEDENCE[around] else text

    def _text_and_level(self, node: ast.expr) -> tuple[str, str]:
        """Print an expression; also return the operator, of ``_PRECEDENCE``, that holds it together."""
        if isinstance(node, ast.BinOp):
            sign, level = _OPERATORS[type(node.op)]
            # the right operand keeps its group, for the same rounding
            right = {"sum": "product", "product": "unary"}[level]
            return f"{self.expression_text(node.left, level)} {sign} {self.expression_text(node.right, right)}", level
        if isinstance(node, ast.BoolOp):
            sign, level = _OPERATORS[type(node.op)]
            # brackets around a comparison help the reader; between ``and`` and ``or`` they are necessary
            return f" {self.syntax[sign]} ".join(self.expression_text(operand, "sum") for operand in node.values), level
        if isinstance(node, ast.Compare):
            sign, level = _OPERATORS[type(node.ops[0])]
            sides = (self.expression_text(operand, "sum") for operand in (node.left, node.comparators[0]))
            return f" {self.syntax.get(sign, sign)} ".join(sides), level
        if isinstance(node, ast.UnaryOp):
            sign = self.syntax["not"] if isinstance(node.op, ast.Not) else "-"
            return f"{sign}{self.expression_text(node.operand, 'unary')}", "unary"
        return self._term_text(node), "whole"

    def _term_text(self, node: ast.expr) -> str:
        if isinstance(node, ast.Constant):
            return self.constant_text(node.value)
        if isinstance(node, ast.Name):
            return node.id
        if isinstance(node, ast.Attribute):
            return self.syntax["state"] + node.attr
        if isinstance(node, ast.Subscript):
            return f"{self.expression_text(node.value)}[{self.expression_text(node.slice)}]"
        call: Any = node
        return f"{self.functions[ast.unparse(call.func)]}({', '.join(map(self.expression_text, call.args))})"

    def block_lines(self, body: list[ast.stmt], depth: int) -> list[str]:
        """Print statements as lines, indented to this depth."""
        lines: list[str] = []
        for node in body:
            first, *rest = self._statement_lines(node, depth)
            lines += [*break_line("    " * depth + first, self.LINE_BREAKS), *rest]
        return lines

    def _statement_lines(self, node: ast.stmt, depth: int) -> list[str]:
        """Print a statement, its first line without indentation."""
        syntax, text_of, indent = self.syntax, self.expression_text, "    " * depth
        if isinstance(node, ast.For) and isinstance(node.iter, ast.Call):
            ends, goes_up = node.iter.args, len(node.iter.args) < 3
            first_text = text_of(ends[0]) if len(ends) > 1 else "0"
            end_node: Any = ends[min(len(ends), 2) - 1]
            last_text = f"{text_of(end_node)} {'-' if goes_up else '+'} 1"
            if isinstance(end_node, ast.Constant):
                last_text = str(int(str(end_node.value)) + (-1 if goes_up else 1))
            loop_template = syntax["up" if goes_up else "down"]
            head = loop_template.format(i=text_of(node.target), low=first_text, high=text_of(end_node), last=last_text)
            return [head, *self.block_lines(node.body, depth + 1), indent + syntax["end for"]]
        if isinstance(node, ast.If):
            lines = [syntax["if"].format(text_of(node.test)), *self.block_lines(node.body, depth + 1)]
            while node.orelse and isinstance(node.orelse[0], ast.If) and node.orelse[0].col_offset == node.col_offset:
                node = node.orelse[0]  # an elif, which begins where its if does
                lines += break_line(indent + syntax["elif"].format(text_of(node.test)), self.LINE_BREAKS)
                lines += self.block_lines(node.body, depth + 1)
            lines += [indent + syntax["else"], *self.block_lines(node.orelse, depth + 1)] if node.orelse else []
            return [*lines, indent + syntax["end if"]]
        first, *rest = self._simple_statement_lines(node)
        return [first, *(indent + line if line else "" for line in rest)]

    def _simple_statement_lines(self, node: ast.stmt) -> list[str]:
        """Print a statement without others inside."""
        syntax, text_of = self.syntax, self.expression_text
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            return self.call_lines(self.laws.functions[ast.unparse(node.value.func)], node.value.args[1:])
        if isinstance(node, ast.Return) and node.value is not None:
            return syntax["return"].format(text_of(node.value)).splitlines()
        if isinstance(node, ast.AugAssign):
            return [syntax["="].format(text_of(node.target), text_of(ast.BinOp(node.target, node.op, node.value)))]
        if isinstance(node, ast.Assign):
            target, value = node.targets[0], node.value
            if isinstance(value, ast.Call) and ast.unparse(value.func) == "zeros":
                return syntax["zeros"].format(text_of(target), int(ast.unparse(value.args[0])) - 1).splitlines()
            return [syntax["="].format(text_of(target), text_of(value))]
        raise TypeError(f"the laws have no {ast.unparse(node)}")

    def call_lines(self, function: Function, arguments: list[ast.expr]) -> list[str]:
        return [f"{self.functions[function.name]}({', '.join(['s', *map(self.expression_text, arguments)])});"]

    def kinds_of_locals(self, body: list[ast.stmt], arguments: dict[str, str]) -> dict[str, str]:
        """Return the kinds of the intermediate values and counters that statements store, in their order."""
        kinds: dict[str, str] = {}
        for node in nested_statements(body):
            if isinstance(node, ast.Assign):
                for target in node.targets:
                    if isinstance(target, ast.Name) and target.id not in arguments:
                        kinds.setdefault(target.id, expression_kind(node.value, self.laws.kinds | arguments | kinds))
            elif isinstance(node, ast.For) and isinstance(node.target, ast.Name) and node.target.id not in arguments:
                kinds.setdefault(node.target.id, "whole")
        return kinds


def nested_statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Iterate over statements and those inside them, in their order."""
    for node in body:
        yield node
        if isinstance(node, (ast.If, ast.For)):
            yield from nested_statements([*node.body, *node.orelse])


def expression_kind(node: ast.expr, kinds: Mapping[str, str]) -> str:
    """Return the kind of an expression: flag, whole or real; kinds: of names, fields and functions."""
    if isinstance(node, ast.Constant):
        return {bool: "flag", int: "whole"}.get(type(node.value), "real")
    if isinstance(node, (ast.BoolOp, ast.Compare)) or (isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)):
        return "flag"
    if isinstance(node, ast.UnaryOp):
        return expression_kind(node.operand, kinds)
    if isinstance(node, ast.BinOp):
        return "whole" if expression_kind(node.left, kinds) == expression_kind(node.right, kinds) == "whole" else "real"
    name = ast.unparse(node.func if isinstance(node, ast.Call) else node)
    if name in ("min", "max", "abs") and isinstance(node, ast.Call):
        return expression_kind(node.args[0], kinds)
    return "whole" if name == "int" else kinds.get(name, "real")

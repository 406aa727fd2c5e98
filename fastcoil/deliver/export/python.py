"""Python in and out: the source of a rule with its comments, and the laws as text."""

from __future__ import annotations

import ast
import io
import linecache
import tokenize
from functools import cache
from pathlib import Path
from textwrap import wrap
from types import FunctionType
from typing import Any

from fastcoil.deliver.export.expressions import Language, broken
from fastcoil.deliver.export.words import WIDTH, number, plain_text


@cache
def _source(filename: str) -> tuple[ast.Module, list[str], dict[int, str]] | None:
    """Tree, lines and comments of a file, or of what was run in its name."""
    lines = linecache.getlines(filename)
    if not lines:
        return None
    tokens = tokenize.generate_tokens(io.StringIO("".join(lines)).readline)
    comments = {
        t.start[0]: plain_text(t.string.removeprefix("#").strip()) for t in tokens if t.type == tokenize.COMMENT
    }
    return ast.parse("".join(lines)), lines, comments


def definition_of(python: FunctionType) -> ast.FunctionDef | None:
    """The tree of a function; ``None`` where its source is not at hand."""
    code, source = python.__code__, _source(python.__code__.co_filename)
    for node in ast.walk(source[0]) if source else ():
        if isinstance(node, ast.FunctionDef) and node.name == code.co_name:
            first = min([node.lineno, *(one.lineno for one in node.decorator_list)])
            if first == code.co_firstlineno:
                return node
    return None


def comments_of(filename: str, line: int) -> list[str]:
    """The comments above a line and behind it."""
    source = _source(filename)
    if source is None:
        return []
    _, lines, comments = source
    found: list[str] = []
    above = line - 1
    while above > 0 and lines[above - 1].strip().startswith("#"):
        found.insert(0, comments[above])
        above -= 1
    behind = comments.get(line, "")
    return [*found, *([behind] if behind and not behind.startswith(("noqa", "type:", "fmt:")) else [])]


def documented(filename: str, name: str, cls: str = "") -> str:
    """What the text behind a constant, or a field of a class, says of it."""
    source = _source(filename) if filename else None
    if source is None:
        return ""
    body: list[ast.stmt] = source[0].body
    for node in body:
        if cls and isinstance(node, ast.ClassDef) and node.name == cls:
            body = node.body
    for node, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        names = [n.id for target in targets if target is not None for n in ast.walk(target) if isinstance(n, ast.Name)]
        if name in names and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            return plain_text(" ".join(str(after.value.value).split()))
    return ""


def docstring_of(python: FunctionType) -> str:
    """A function's docstring, in lines that fit."""
    definition = definition_of(python)
    text = definition and ast.get_docstring(definition)
    parts = plain_text(text or f"As {python.__name__} of {Path(python.__code__.co_filename).name}.").split("\n\n")
    return "\n\n".join(part if "\n  " in f"\n{part}" else "\n".join(wrap(part, 88)) for part in parts)


_SAME = ("or", "and", "True", "False", "==", "!=", "<", "<=", ">", ">=")
_PYTHON = Language(
    dict(zip(_SAME, _SAME, strict=True)) | {"not": "not ", "group": ""},
    None, lambda name: f"s.{name}", lambda indices: "".join(f"[{one}]" for one in indices), number,
)  # fmt: skip


def text_of(node: ast.AST) -> str:
    """A statement or an expression of the laws in Python."""
    if isinstance(node, ast.Assign):
        return f"{text_of(node.targets[0])} = {text_of(node.value)}"
    if isinstance(node, ast.Return):
        return f"return {text_of(node.value)}"  # type: ignore[arg-type]
    return _PYTHON.say(node.value if isinstance(node, ast.Expr) else node)  # type: ignore[arg-type]


def commented(code: str, said: str) -> str:
    """Code with what is said of it: behind it, or above it where the line is too short."""
    if not said:
        return code
    if len(code) + len(said) < WIDTH - 4:
        return f"{code}  # {said}"
    return "\n".join([*(f"# {line}" for line in wrap(said, WIDTH - 8)), code])


def constant_text(name: str, value: Any, said: str) -> str:
    """A constant, or a table of them, with what is said of it."""
    if isinstance(value, tuple):
        numbers = "\n    ".join(wrap(", ".join(map(repr, value)), WIDTH - 8))
        return (
            commented(f"{name} = [\n    {numbers},\n]", said)
            if not said
            else f"# {said}\n{name} = [\n    {numbers},\n]"
        )
    return commented(f"{name} = {value!r}", said)


def function_text(name: str, head: list[str], returns: str, doc: str, body: list[ast.stmt]) -> str:
    """A function of the laws."""
    lines = doc.splitlines()
    told = [f'    """{lines[0]}', *(f"    {line}".rstrip() for line in lines[1:])]
    told = [f'{told[0]}"""'] if len(lines) == 1 else [*told, '    """']
    start = f"def {name}({', '.join(head)}) -> {returns}:"
    if len(start) > WIDTH:
        start = "\n".join([f"def {name}(", *broken(f"    {', '.join(head)}", WIDTH, r" (?=\w+: )"), f") -> {returns}:"])
    return "\n".join([start, *told, *_lines(body, 1)])


def _lines(body: list[ast.stmt], depth: int) -> list[str]:
    """Statements as lines of Python."""
    indent, lines = "    " * depth, []
    for node in body:
        lines += [f"{indent}# {said}" for said in getattr(node, "above", ())]
        if isinstance(node, ast.If):
            lines += _if_lines(node, depth, "if")
        elif isinstance(node, ast.For):
            lines += [f"{indent}for {text_of(node.target)} in {text_of(node.iter)}:", *_lines(node.body, depth + 1)]
        else:
            lines += _wrapped(indent + text_of(node))  # type: ignore[arg-type]
    return lines or [f"{indent}pass"]


def _if_lines(node: ast.If, depth: int, word: str) -> list[str]:
    indent = "    " * depth
    lines = [*_wrapped(f"{indent}{word} {text_of(node.test)}:"), *_lines(node.body, depth + 1)]
    if len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If) and not getattr(node.orelse[0], "above", ()):
        return lines + _if_lines(node.orelse[0], depth, "elif")
    return lines + ([f"{indent}else:", *_lines(node.orelse, depth + 1)] if node.orelse else [])


def _wrapped(line: str) -> list[str]:
    """A line of Python, in brackets over several lines where it is too long."""
    if len(line) <= WIDTH:
        return [line]
    indent = line[: len(line) - len(line.lstrip())]
    for start in (" = ", "return ", "elif ", "if "):
        head, sign, rest = line.partition(start)
        if sign and (start != " = " or "==" not in head):
            tail = ":" if rest.endswith(":") else ""
            inner = broken(f"{indent}    {rest.removesuffix(':')}", WIDTH, r" (?=and |or |[-+*/] )")
            return [f"{head}{sign}(", *inner, f"{indent}){tail}"]
    return [line]

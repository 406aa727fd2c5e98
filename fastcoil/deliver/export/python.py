"""Python in and out: the source of a rule with its comments, and the laws as text."""

import ast
import io
import linecache
import re
import tokenize
from functools import cache
from pathlib import Path
from textwrap import indent, wrap
from types import FunctionType
from typing import Any

from fastcoil.deliver.export.words import WIDTH, broken, plain_text


@cache
def _source(filename: str) -> tuple[ast.Module, list[str], dict[int, str]] | None:
    """Tree, lines and comments of a file, or of what was run in its name."""
    lines = linecache.getlines(filename)
    if not lines:
        return None
    text = "".join(lines)
    return ast.parse(text), lines, {n: plain_text(said) for n, said in comments_in(text).items()}


def comments_in(text: str) -> dict[int, str]:
    """Comments by line."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return {t.start[0]: t.string.removeprefix("#").strip() for t in tokens if t.type == tokenize.COMMENT}


def names_in(text: str) -> list[str]:
    """The names in a text, without its comments and docstrings."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return [token.string for token in tokens if token.type == tokenize.NAME]


@cache
def definition_of(python: FunctionType) -> ast.FunctionDef | None:
    """The tree of a function; ``None`` where its source is not at hand."""
    code, source = python.__code__, _source(python.__code__.co_filename)
    for node in ast.walk(source[0]) if source else ():
        if isinstance(node, ast.FunctionDef) and node.name == code.co_name:
            first = min([node.lineno, *(one.lineno for one in node.decorator_list)])
            if first == code.co_firstlineno:
                return node
    return None


def comments_of(python: FunctionType, node: ast.stmt) -> list[str]:
    """The comments above a statement and behind its first line."""
    source = _source(python.__code__.co_filename)
    if source is None:
        return []
    _, lines, comments = source
    above = node.lineno
    while above > 1 and lines[above - 2].strip().startswith("#"):
        above -= 1
    found = [comments[line] for line in range(above, node.lineno + 1) if line in comments]
    return [said for said in found if not said.startswith(("noqa", "type:", "fmt:"))]


def documented(filename: str, name: str, cls: str = "") -> str:
    """What the text behind a constant, or a field of a class, says of it."""
    source = _source(filename) if filename else None
    body: list[ast.stmt] = source[0].body if source else []
    if cls:
        body = next((node.body for node in body if isinstance(node, ast.ClassDef) and node.name == cls), [])
    for node, after in zip(body, body[1:], strict=False):
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        names = [n.id for target in targets if target is not None for n in ast.walk(target) if isinstance(n, ast.Name)]
        if name in names and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            return str(after.value.value)
    return ""


def docstring_of(python: FunctionType) -> str:
    """A function's docstring, in lines that fit."""
    definition = definition_of(python)
    text = definition and ast.get_docstring(definition)
    parts = plain_text(text or f"As {python.__name__} of {Path(python.__code__.co_filename).name}.").split("\n\n")
    return "\n\n".join(part if "\n  " in f"\n{part}" else "\n".join(wrap(part, 88)) for part in parts)


def commented(code: str, said: str) -> str:
    """Code with what is said of it: behind it, or above it where the line is too short."""
    said = " ".join(plain_text(said).split())
    if not said:
        return code
    if len(code) + len(said) < WIDTH - 4 and "\n" not in code:
        return f"{code}  # {said}"
    return "\n".join([*(f"# {line}" for line in wrap(said, WIDTH - 8)), code])


def constant_text(name: str, value: Any, said: str) -> str:
    """A constant, or a table of them, with what is said of it."""
    if isinstance(value, tuple):
        numbers = "\n    ".join(wrap(", ".join(map(repr, value)), WIDTH - 8))
        return commented(f"{name} = [\n    {numbers},\n]", said)
    return commented(f"{name} = {value!r}", said)


def function_text(name: str, head: list[str], returns: str, doc: str, body: list[ast.stmt]) -> str:
    """A function of the laws."""
    start = f"def {name}({', '.join(head)}) -> {returns}:"
    if len(start) > WIDTH:
        start = "\n".join([f"def {name}(", *broken(f"    {', '.join(head)}", r" (?=\w+: )"), f") -> {returns}:"])
    text = f'"""{doc}"""' if "\n" not in doc else f'"""{doc}\n"""'
    return "\n".join([start, indent(text, "    "), *lines_of(body or [ast.Pass()], 1)])


def lines_of(body: list[ast.stmt], depth: int = 0) -> list[str]:
    """Statements as lines of Python."""
    lines = ast.unparse(ast.fix_missing_locations(ast.Module(_with_comments(body), []))).splitlines()
    return [part for line in lines for part in _wrapped("    " * depth + line)]


def _with_comments(body: list[ast.stmt]) -> list[ast.stmt]:
    """Statements with those that say something of them before them: names, which is what a text can be in a tree."""
    found: list[ast.stmt] = []
    for node in body:
        if isinstance(node, (ast.If, ast.For)):
            node.body, node.orelse = _with_comments(node.body), _with_comments(node.orelse)
        found += [*(ast.Expr(ast.Name(f"# {said}")) for said in getattr(node, "above", ())), node]
    return found


def _wrapped(line: str) -> list[str]:
    """A line of Python, in brackets over several lines where it is too long."""
    found = re.match(r"( *)(\w[\w.\[\] +*]* = |return |elif |if )(.*?)(:?)$", line)
    if len(line) <= WIDTH or found is None:
        return [line]
    space, head, inner, tail = found.groups()
    return [f"{space}{head}(", *broken(f"{space}    {inner}", r" (?=and |or |[-+*/] )|(?<=,) "), f"{space}){tail}"]

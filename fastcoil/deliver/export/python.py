"""Python in and out: the source of a rule, and the laws as text."""

import ast
import inspect
import io
import re
import tokenize
from functools import cache
from textwrap import dedent, wrap
from types import FunctionType
from typing import Any

from fastcoil.deliver.export.words import WIDTH, broken, plain_text


def names_in(text: str) -> list[str]:
    """The names in a text, without its comments and docstrings."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return [token.string for token in tokens if token.type == tokenize.NAME]


@cache
def definition_of(python: FunctionType) -> ast.FunctionDef | None:
    """The tree of a function, with the lines of its file; ``None`` where its source is not at hand."""
    try:
        lines, first = inspect.getsourcelines(python.__code__)
        tree = ast.parse(dedent("".join(lines)))
    except (OSError, SyntaxError):
        return None
    ast.increment_lineno(tree, first - 1)
    return next((node for node in tree.body if isinstance(node, ast.FunctionDef)), None)


def summary_of(python: FunctionType) -> str:
    """The first line of a function's docstring."""
    definition = definition_of(python)
    text = (definition and ast.get_docstring(definition)) or f"As {python.__name__}."
    return plain_text(text.splitlines()[0])


def commented(code: str, said: str) -> str:
    """Code with what is said of it: behind it, or above it where the line is too short."""
    said = " ".join(plain_text(said).split())
    if not said:
        return code
    if len(code) + len(said) < WIDTH - 4:
        return f"{code}  # {said}"
    return "\n".join([*(f"# {line}" for line in wrap(said, WIDTH - 8)), code])


def constant_text(name: str, value: Any) -> str:
    """A constant, or a table of them."""
    if isinstance(value, tuple):
        numbers = "\n    ".join(wrap(", ".join(map(repr, value)), WIDTH - 8))
        return f"{name} = [\n    {numbers},\n]"
    return f"{name} = {value!r}"


def function_text(name: str, head: list[str], returns: str, doc: str, body: list[ast.stmt]) -> str:
    """A function of the laws."""
    start = f"def {name}({', '.join(head)}) -> {returns}:"
    if len(start) > WIDTH:
        start = "\n".join([f"def {name}(", *broken(f"    {', '.join(head)}", r" (?=\w+: )"), f") -> {returns}:"])
    return "\n".join([start, f'    """{doc}"""', *lines_of(body or [ast.Pass()], 1)])


def lines_of(body: list[ast.stmt], depth: int = 0) -> list[str]:
    """Statements as lines of Python."""
    lines = ast.unparse(ast.fix_missing_locations(ast.Module(body, []))).splitlines()
    return [part for line in lines for part in _wrapped("    " * depth + line)]


def _wrapped(line: str) -> list[str]:
    """A line of Python, in brackets over several lines where it is too long."""
    found = re.match(r"( *)(\w[\w.\[\] +*]* = |return |elif |if )(.*?)(:?)$", line)
    if len(line) <= WIDTH or found is None:
        return [line]
    space, head, inner, tail = found.groups()
    return [f"{space}{head}(", *broken(f"{space}    {inner}", r" (?=and |or |[-+*/] )|(?<=,) "), f"{space}){tail}"]

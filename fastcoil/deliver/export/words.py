"""Names, numbers and comments that C, Structured Text and Python can all have; Python in and out as text."""

import ast
import inspect
import io
import re
import tokenize
import tomllib
import unicodedata
from functools import cache
from pathlib import Path
from textwrap import dedent, wrap
from types import FunctionType
from typing import Any

LINE_WIDTH = 100  # characters of a line of exported code
_WORD_LISTS = tomllib.loads((Path(__file__).parent / "laws" / "reserved.toml").read_text(encoding="utf-8"))
_ASCII_SPELLINGS = _WORD_LISTS.pop("ascii")
IEC_KEYWORDS = frozenset(_WORD_LISTS["iec"].split())
RESERVED_WORDS = frozenset(" ".join(_WORD_LISTS.values()).split())  # in small letters


def plain_text(text: str) -> str:
    """Convert a text to ASCII, for the oldest tools; it cannot begin or end a comment or a string of any language."""
    spelled = "".join(_ASCII_SPELLINGS.get(letter, letter) for letter in text)
    ascii_text = unicodedata.normalize("NFKD", spelled).encode("ascii", "ignore").decode()
    printable = "".join(letter if letter.isprintable() or letter == "\n" else " " for letter in ascii_text)
    harmless = re.sub(r"(?<=\*)(?=[/)])|(?<=[/(])(?=\*)", " ", printable.replace("\\", "/"))
    return harmless.replace('"', "'").replace("``", "`")


def number_literal(value: float) -> str:
    """Return a number with all its digits: 1e-9, not 1e-09."""
    return re.sub(r"e([-+])0", r"e\1", repr(float(value)))


def break_line(line: str, breaks: str, width: int = LINE_WIDTH) -> list[str]:
    """Break a line that is too long, with further indentation; breaks: pattern of the places where it may end."""
    if len(line) <= width:
        return [line]
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    break_places = [m.start() for m in re.finditer(breaks, line) if len(indent) < m.start() <= width]
    if not break_places:
        return [line]
    depth = {place: line[:place].count("(") - line[:place].count(")") for place in break_places}
    end = max(place for place in break_places if depth[place] == min(depth.values()))
    return [line[:end], *break_line(indent + line[end:].lstrip(), breaks, width)]


def names_in(text: str) -> list[str]:
    """Return the names in a text of Python, without its comments and docstrings."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return [token.string for token in tokens if token.type == tokenize.NAME]


@cache
def definition_of(python: FunctionType) -> ast.FunctionDef | None:
    """Return the syntax tree of a function, with the line numbers of its file; None without its source."""
    try:
        lines, first_line = inspect.getsourcelines(python.__code__)
        tree = ast.parse(dedent("".join(lines)))
    except (OSError, SyntaxError):
        return None
    ast.increment_lineno(tree, first_line - 1)
    return next((node for node in tree.body if isinstance(node, ast.FunctionDef)), None)


def summary_of(python: FunctionType) -> str:
    """Return the first line of a function's docstring."""
    definition = definition_of(python)
    text = (definition and ast.get_docstring(definition)) or f"As {python.__name__}."
    return plain_text(text.splitlines()[0])


def add_comment(code: str, comment: str) -> str:
    """Return code with a comment behind it, or above it where the line is too short."""
    comment = " ".join(plain_text(comment).split())
    if not comment:
        return code
    if len(code) + len(comment) < LINE_WIDTH - 4:
        return f"{code}  # {comment}"
    return "\n".join([*(f"# {line}" for line in wrap(comment, LINE_WIDTH - 8)), code])


def constant_text(name: str, value: Any) -> str:
    """Return the definition of a constant, or of a table of them."""
    if isinstance(value, tuple):
        numbers = "\n    ".join(wrap(", ".join(map(repr, value)), LINE_WIDTH - 8))
        return f"{name} = [\n    {numbers},\n]"
    return f"{name} = {value!r}"


def function_text(name: str, head: list[str], returns: str, doc: str, body: list[ast.stmt]) -> str:
    """Return the Python text of a function of the laws; head: its arguments, with types."""
    start = f"def {name}({', '.join(head)}) -> {returns}:"
    if len(start) > LINE_WIDTH:
        start = "\n".join([f"def {name}(", *break_line(f"    {', '.join(head)}", r" (?=\w+: )"), f") -> {returns}:"])
    return "\n".join([start, f'    """{doc}"""', *lines_of(body or [ast.Pass()], 1)])


def lines_of(body: list[ast.stmt], depth: int = 0) -> list[str]:
    """Return statements as lines of Python, indented to this depth."""
    lines = ast.unparse(ast.fix_missing_locations(ast.Module(body, []))).splitlines()
    return [part for line in lines for part in _wrap_statement("    " * depth + line)]


def _wrap_statement(line: str) -> list[str]:
    """Wrap a line of Python in brackets where it is too long."""
    match = re.match(r"( *)(\w[\w.\[\] +*]* = |return |elif |if )(.*?)(:?)$", line)
    if len(line) <= LINE_WIDTH or match is None:
        return [line]
    space, head, inner, tail = match.groups()
    return [f"{space}{head}(", *break_line(f"{space}    {inner}", r" (?=and |or |[-+*/] )|(?<=,) "), f"{space}){tail}"]

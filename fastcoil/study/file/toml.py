"""TOML that a user writes, as tables; refused where it would take minutes to parse, or holds what no study can."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import Any

from fastcoil.base.errors import InputError, shown

_MOST_PARTS = 20
"""Parts of a dotted key: a study needs four.  The time to parse one rises with their square."""
_DEEPEST = 20
"""Tables and lists inside each other: a study needs five."""
LONGEST_KEY = 200
"""Characters; keys are labels of axes too."""
_LARGEST_NUMBER = 8192
"""Bits; Python shows no number that is much longer."""
_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"?|'[^'\n]*+'?)"""
_TOKEN = re.compile(
    r'''"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5}|\Z)|'{3}(?:[^']|'(?!''))*+(?:'{3,5}|\Z)|#[^\n]*+'''
    rf"|(?P<key>{_PART}(?:[ \t]*+\.[ \t]*+{_PART})++)|{_PART}",
    re.DOTALL,
)
"""A text of several lines, a comment, a dotted key, or one part of a key or a value.  Each is read once."""


_FLATTEN = f"give at most {_DEEPEST}"


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """The tables of a text.

    Parameters
    ----------
    text
        Lines end with LF or CRLF.
    name
        What messages call it.

    Raises
    ------
    InputError
        If it is not TOML; for a key with too many parts, tables in tables without end, keys and numbers too long to be
        shown, and the character NUL in a text, at which the files of results would end it.
    """
    text = text.replace("\r\n", "\n")
    for match in _TOKEN.finditer(text):
        if match["key"] and match["key"].count(".") >= _MOST_PARTS:
            row = text.count("\n", 0, match.start()) + 1
            parts = len(re.findall(_PART, match["key"]))
            if parts > _MOST_PARTS:
                raise InputError(
                    f"{name}: row {row} has a key of {parts:,} parts, {shown(match['key'])}: give at most {_MOST_PARTS}"
                )
    try:
        tables = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{name} has tables or lists inside each other without end: {_FLATTEN}") from None
    except ValueError as error:  # also of a number with more digits than Python reads
        raise InputError(f"{name} is not valid TOML: {_cut(str(error))}") from None
    problems = list(_problems(tables))
    if problems:
        raise InputError([f"{name}: {problem}" for problem in problems])
    return tables


def _cut(reason: str) -> str:
    return reason if len(reason) <= 300 else reason[:200] + " … " + reason[-60:]


def _problems(tables: dict[str, Any]) -> Iterator[str]:
    left: list[tuple[str, int, Any]] = [("", 0, tables)]
    while left:
        place, depth, value = left.pop()
        if isinstance(value, dict | list) and depth >= _DEEPEST:
            yield f"{place} has more than {_DEEPEST} tables or lists inside each other: {_FLATTEN}"
        elif isinstance(value, dict):
            for key, one in value.items():
                if len(key) > LONGEST_KEY:
                    yield f"{place}{shown(key)} is a key of {len(key):,} characters: give at most {LONGEST_KEY}"
                elif "\0" in key:
                    yield f"{place}{shown(key)} holds the character NUL: delete it"
                else:
                    left.append((f"{place}.{key}" if place else key, depth + 1, one))
        elif isinstance(value, list):
            left += [(place, depth + 1, one) for one in value]
        elif isinstance(value, str) and "\0" in value:
            yield f"{place} = {shown(value)} holds the character NUL: delete it"
        elif isinstance(value, int) and value.bit_length() > _LARGEST_NUMBER:
            yield f"{place} is a number of too many digits: give a smaller one"

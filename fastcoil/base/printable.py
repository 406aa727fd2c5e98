"""Text of strangers as it may be shown: nothing in it moves the cursor, hides a line or turns the writing round."""

from __future__ import annotations

import unicodedata

_UNSAFE = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Categories of Unicode: control and format (bidirectional too), half characters, separators of lines."""


def printable(text: str) -> str:
    r"""The text on one line, every character that is not shown as itself written as in Python: ``\x1b``, ``\u202e``."""
    if text.isprintable():
        return text
    return "".join(_escaped(c) if unicodedata.category(c) in _UNSAFE else c for c in text)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")

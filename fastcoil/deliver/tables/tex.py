"""Text of anybody in TeX: labels in a table, titles in BibTeX."""

from __future__ import annotations

from fastcoil.base.text import MINUS, NONE

_ESCAPED = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "_": r"\_", "%": r"\%",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"$<$", ">": r"$>$", "|": r"$|$",
    MINUS: "$-$", NONE: "--", "∞": r"$\infty$", "°": r"$^{\circ}$", "³": "$^3$", "²": "$^2$", "×": r"$\times$",
    "β": r"$\beta$", "\"": "''",
}  # fmt: skip


def escaped(text: str) -> str:
    """Text that TeX shows as it is."""
    return "".join(_ESCAPED.get(letter, letter) for letter in text)

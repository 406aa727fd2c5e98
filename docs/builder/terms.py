"""Link the first use of each term on a page to the glossary."""

from __future__ import annotations

import re

MORE_MEANINGS = {
    *(
        "boundary",
        "command",
        "dry",
        "estimate",
        "front",
        "gain",
        "interval",
        "inverse",
        "kernel",
        "margin",
        "metric",
        "pi",
    ),
    *("plant", "reset", "sample", "settled", "sweep", "wet"),
}
"""Terms that are also everyday words, or too frequent to link."""
TERM = re.compile(r"^### (.+)$", re.MULTILINE)
LEFT_ALONE = r"\[[^\]]*\](?:\([^)]*\)|\[[^\]]*\]|: \S+)?|`[^`]*`|\$[^$\n]*\$|^#.*$|^\|.*$|<!--.*?-->|https?://\S+"
"""Links, code, formulas, headings, tables, comments."""


def terms(glossary: str) -> dict[str, str]:
    """Return term in lower case → anchor of its heading in the glossary; a heading may name several terms."""
    return {
        term: re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")
        for heading in TERM.findall(glossary)
        for term in heading.lower().split(", ")
        if term not in MORE_MEANINGS
    }


def linked(text: str, known: dict[str, str], glossary: str) -> str:
    """Return ``text``, without fenced blocks, with a link to ``glossary`` at the first use of each term.

    Remove linked terms from ``known``, with the other terms of their heading.
    """
    if not known:
        return text
    longest_first = sorted(known, key=len, reverse=True)
    words = "|".join(re.escape(term).replace(r"\ ", r"\s+") for term in longest_first)
    found = re.compile(rf"(?P<alone>{LEFT_ALONE})|(?<![\w/-])(?P<term>{words})(?P<end>s|es)?(?![\w/-])", re.M | re.I)

    def link(match: re.Match[str]) -> str:
        anchor = known.get(" ".join((match["term"] or "").lower().split()))
        if anchor is None:
            return match[0]
        for term in [term for term, its in known.items() if its == anchor]:
            del known[term]
        return f"[{match[0]}]({glossary}#{anchor})"

    return found.sub(link, text)

"""Link the first use of each term on a page to the glossary."""

from __future__ import annotations

import re

EVERYDAY_WORDS = {
    *("boundary", "command", "dry", "estimate", "front", "gain", "interval", "inverse", "kernel", "metric", "pi"),
    *("plant", "reset", "sample", "settled", "sweep", "wet"),
}
"""Terms that are also everyday words, or too frequent to link."""
TERM = re.compile(r"^### (.+)$", re.MULTILINE)
NEVER_LINKED = r"\[[^\]]*\](?:\([^)]*\)|\[[^\]]*\]|: \S+)?|`[^`]*`|\$[^$\n]*\$|^#.*$|^\|.*$|<!--.*?-->|https?://\S+"
"""Links, code, formulas, headings, tables, comments."""


def terms(glossary: str) -> dict[str, str]:
    """Return term in lower case → anchor of its heading in the glossary; a heading may name several terms."""
    return {
        term: re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")
        for heading in TERM.findall(glossary)
        for term in heading.lower().split(", ")
        if term not in EVERYDAY_WORDS
    }


def link_terms(text: str, anchor_by_term: dict[str, str], glossary: str) -> str:
    """Return ``text``, without fenced blocks, with a link to ``glossary`` at the first use of each term.

    Remove linked terms from ``anchor_by_term``, with the other terms of their heading.
    """
    if not anchor_by_term:
        return text
    longest_first = sorted(anchor_by_term, key=len, reverse=True)
    alternatives = "|".join(re.escape(term).replace(r"\ ", r"\s+") for term in longest_first)
    pattern = re.compile(
        rf"(?P<alone>{NEVER_LINKED})|(?<![\w/-])(?P<term>{alternatives})(?P<end>s|es)?(?![\w/-])", re.M | re.I
    )

    def link(match: re.Match[str]) -> str:
        anchor = anchor_by_term.get(" ".join((match["term"] or "").lower().split()))
        if anchor is None:
            return match[0]
        for term in [term for term, term_anchor in anchor_by_term.items() if term_anchor == anchor]:
            del anchor_by_term[term]
        return f"[{match[0]}]({glossary}#{anchor})"

    return pattern.sub(link, text)

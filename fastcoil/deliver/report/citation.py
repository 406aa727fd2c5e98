"""How to cite fastcoil, the paper whose model it implements, and results of a study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastcoil.base.machine import package_version
from fastcoil.deliver.tables.tex import escaped

TITLE = "fastcoil: closed-loop emulation of HVAC coil valves with backlash"
AUTHORS = "The fastcoil authors"
LICENCE = "MIT"
PAPER: Mapping[str, str] = {
    "title": "Self-learning Backlash Inverse Control of Cooling or Heating Coil Valves Having Backlash Hysteresis",
    "authors": "Cai, Jie and Braun, James E.",
    "year": "2016",
    "series": "International Refrigeration and Air Conditioning Conference",
    "number": "1801",
    "publisher": "Purdue e-Pubs",
    "url": "https://docs.lib.purdue.edu/iracc/1801",
}
"""CITATION.cff has the same; a test compares them."""


def citation(results: Mapping[str, Any] | None = None) -> list[str]:
    """Plain text, a line each.

    results: the attributes of results, which are then cited with the version that made them and their hash.
    """
    lines = [
        f"{AUTHORS}. {TITLE}. Version {_version(results)}, {LICENCE} licence.",
        f"{PAPER['authors']} ({PAPER['year']}). {PAPER['title']}. {PAPER['series']}, paper {PAPER['number']}, "
        f"{PAPER['publisher']}. {PAPER['url']}",
    ]
    if results is not None:
        lines.append(
            f"Results: {results['title']}. Made with fastcoil {_version(results)}; content_sha256 "
            f"{results['content_sha256']}."
        )
    return lines


def bibtex(results: Mapping[str, Any] | None = None) -> list[str]:
    """The same as BibTeX."""
    entries = [
        _entry(
            "software", "fastcoil",
            title=f"{{{TITLE}}}", author=f"{{{AUTHORS}}}", version=_version(results), license=LICENCE,
        ),
        _entry(
            "inproceedings", "cai2016backlash",
            title=f"{{{PAPER['title']}}}", author=PAPER["authors"], year=PAPER["year"], booktitle=PAPER["series"],
            number=PAPER["number"], publisher=PAPER["publisher"], url=PAPER["url"],
        ),
    ]  # fmt: skip
    if results is not None:
        title = escaped(" ".join(str(results["title"]).split()))
        entries.append(
            _entry(
                "misc", f"results{results['content_sha256'][:8]}",
                title=f"{{{title}}}", howpublished=f"Results of fastcoil {_version(results)}",
                note=rf"content\_sha256 {results['content_sha256']}",
            )
        )  # fmt: skip
    return [line for entry in entries for line in entry]


def _version(results: Mapping[str, Any] | None) -> str:
    return package_version() if results is None else str(results.get("fastcoil_version", "unknown"))


def _entry(kind: str, key: str, **fields: str) -> list[str]:
    return [f"@{kind}{{{key},", *(f"  {name} = {{{value}}}," for name, value in fields.items()), "}"]

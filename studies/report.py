"""What the scripts of this folder share: the results of a study, and tables that the pages of ``docs/`` quote."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import xarray as xr

import fastcoil as fc

HERE = Path(__file__).parent
TABLES = HERE / "tables"
PAGES = HERE.parent / "docs"


def results(name: str) -> xr.Dataset:
    """Open the results of a study of this folder; run the study first if they are missing or incomplete."""
    return fc.run_study(HERE / f"{name}.toml", HERE.parent / "results" / name)


def markdown(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown."""
    head = list(head)
    lines = [head, ["---"] * len(head), *map(list, rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines) + "\n"


def write_table(name: str, title: str, head: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Write a table to ``tables/NAME.md``, and into every page that quotes it."""
    text = f"**{title}**\n\n{markdown(head, rows)}"
    path = TABLES / f"{name}.md"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    for page in PAGES.glob("*.md"):
        old = page.read_text(encoding="utf-8")
        new = quoting(old, name, text)
        if new != old:
            page.write_text(new, encoding="utf-8")
    print(path)


def quoting(page: str, name: str, table: str) -> str:
    """The text of a page with ``table`` between its marks ``<!-- table NAME -->`` and ``<!-- end NAME -->``."""
    between = re.compile(rf"(?<=<!-- table {name} -->\n).*?(?=<!-- end {name} -->)", re.DOTALL)
    return between.sub(lambda _: f"\n{table}\n", page)

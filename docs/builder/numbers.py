"""Fill the pages with the numbers and tables of the studies: ``python docs/builder/numbers.py``, or ``make pages``.

A page marks each number that it quotes from ``studies/*/tables/NAME.md``; a code host does not show the marks::

    <!-- number hunting_rules | hunting index | predicted right -->98.9 % (98.4 to 99.3)<!-- /number -->
    <!-- table hunting_rules -->  the whole table  <!-- end hunting_rules -->

The parts of a number are the table, the row, the column, and optionally how to write the cell (see ``FORMS``).  A row
is named by the beginning of one of its cells, or of several joined by ``&``; a column by the beginning of its head.
Exactly one row and column must fit, or several rows with the form ``range``.  ``title`` instead of a row takes the
group of a regular expression from the title of the table.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
NUMBER = re.compile(r"<!-- number (.+?) -->(.*?)<!-- /number -->", re.DOTALL)
TABLE = re.compile(r"<!-- table (\w+) -->\n.*?<!-- end \1 -->", re.DOTALL)
FIRST = re.compile(r"-?\d[\d,]*(?:\.\d+)?")
Row = dict[str, str]


def pages(root: Path) -> list[Path]:
    """Pages that may quote tables."""
    return [*sorted((root / "docs").rglob("*.md")), root / "README.md", root / "studies" / "README.md"]


def table_file(root: Path, name: str) -> Path:
    """File of a table, in whichever folder of ``studies/``."""
    paths = [path for path in (root / "studies").rglob("tables/*.md") if path.stem == name]
    if len(paths) != 1:
        raise ValueError(f"{len(paths)} tables are called {name!r}")
    return paths[0]


def rows(text: str) -> Iterator[Row]:
    """Column → cell of each row; an empty cell repeats the one above, and of equal heads the first counts."""
    lines = [re.split(r"(?<!\\)\|", line.strip().strip("|")) for line in text.splitlines() if line.startswith("|")]
    head, _, *body = [[cell.strip() for cell in line] for line in lines]
    above = head
    for cells in body:
        above = [cell or old for cell, old in zip(cells, above, strict=True)]
        yield dict(reversed(list(zip(head, above, strict=True))))


def _matching_names(name: str, names: Iterable[str]) -> list[str]:
    """Those of ``names`` that are ``name``; if none is, those that begin with it."""
    names = list(names)
    return [candidate for candidate in names if candidate == name] or [
        candidate for candidate in names if candidate.startswith(name)
    ]


def _matching_rows(rows_left: list[Row], row: str) -> list[Row]:
    for part in row.split(" & "):
        exact_rows = [cells for cells in rows_left if part in cells.values()]
        rows_left = exact_rows or [cells for cells in rows_left if _matching_names(part, cells.values())]
    return rows_left


def _unsigned_cell(cell: str) -> str:
    """``30 % (25 to 34)`` of ``-30 % (-34 to -25)``."""
    swapped = re.sub(r"\((-[\d.]+) to (-[\d.]+)\)", r"(\2 to \1)", cell)
    return re.sub(r"[-+](?=\d)", "", swapped)


def _rounded_cell(cell: str) -> str:
    """``95 %`` of ``95.4%``."""
    return f"{float(FIRST.findall(cell)[0]):.0f}" + (" %" if "%" in cell else "")


FORMS: dict[str, Callable[[str], str]] = {
    "short": lambda cell: cell.split(" (")[0],
    "unsigned": _unsigned_cell,
    "whole": _rounded_cell,
    "bare": lambda cell: FIRST.findall(cell)[0],
    **{f"part {k}": lambda cell, k=k: cell.split(", ")[k - 1] for k in (1, 2, 3)},  # type: ignore[misc]
}
"""How to write a cell.  Besides these, ``range`` gives the least and the most of several rows, and ``of`` a regular
expression takes its group from the cell."""


def _first_group(pattern: str, text: str) -> str:
    match = re.search(pattern, text)
    if match is None:
        raise ValueError(f"nothing in {text!r} fits {pattern!r}")
    return match[1]


def number(root: Path, mark: str) -> str:
    """What the mark of a number stands for."""
    name, row, column, *forms = (part.strip() for part in " ".join(mark.split()).split(" | "))
    text = table_file(root, name).read_text(encoding="utf-8")
    if row == "title":
        return _first_group(column, text.splitlines()[0])
    matching = _matching_rows(list(rows(text)), row)
    columns = _matching_names(column, matching[0]) if matching else []
    forms = forms[0].split(", ") if forms else []
    if len(columns) != 1 or (len(matching) != 1 and "range" not in forms):
        raise ValueError(f"{mark!r}: {len(matching)} rows and {len(columns)} columns fit")
    cells = [cells[columns[0]] for cells in matching]
    for form in forms:
        if form == "range":
            ordered = sorted(cells, key=lambda cell: float(FIRST.findall(cell)[0].replace(",", "")))
            is_one = ordered[0] == ordered[-1]
            cells = [ordered[-1] if is_one else f"{FIRST.findall(ordered[0])[0]} to {ordered[-1]}"]
        elif form.startswith("of "):
            cells = [_first_group(form.removeprefix("of "), cell) for cell in cells]
        else:
            cells = [FORMS[form](cell) for cell in cells]
    return cells[0]


def fill_page(root: Path, page: str) -> str:
    """The text of a page with every marked number and table as ``studies/`` has it now."""

    def table(mark: re.Match[str]) -> str:
        text = table_file(root, mark[1]).read_text(encoding="utf-8")
        return f"<!-- table {mark[1]} -->\n\n{text}\n<!-- end {mark[1]} -->"

    page = TABLE.sub(table, page)
    return NUMBER.sub(lambda mark: f"<!-- number {mark[1]} -->{number(root, mark[1])}<!-- /number -->", page)


def main() -> None:
    """Refill all pages, and name those that changed."""
    for page in pages(ROOT):
        old = page.read_text(encoding="utf-8")
        new = fill_page(ROOT, old)
        if new != old:
            page.write_text(new, encoding="utf-8")
            sys.stdout.write(f"{page.relative_to(ROOT)}\n")


if __name__ == "__main__":
    main()

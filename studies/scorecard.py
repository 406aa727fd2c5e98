"""The scorecard of the paper's claims as a table.

Run with ``python studies/scorecard.py`` in the repository: does what ``fastcoil paper`` does, into ``results/paper``.
"""

from __future__ import annotations

from report import HERE, write_table

from fastcoil.paper.regenerate import regenerate


def first_table(text: str) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the first table in a Markdown text."""
    table, _, _ = text[text.index("\n| ") + 1 :].partition("\n\n")
    lines = table.splitlines()
    head, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    return head, rows


def main(*, quick: bool = False) -> None:
    """Regenerate the paper's figures and scorecard, and write the table."""
    folder = HERE.parent / "results" / "paper"
    regenerate(folder, quick=quick)
    head, rows = first_table((folder / "scorecard.md").read_text(encoding="utf-8"))
    write_table("scorecard", "What holds of the paper's claims", head, rows)


if __name__ == "__main__":
    main()

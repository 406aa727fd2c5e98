"""``fastcoil cite``: how to cite fastcoil, the paper, and results."""

from __future__ import annotations

from pathlib import Path

import click

from fastcoil.cli.paths import PATH
from fastcoil.cli.terminal import say


@click.command()
@click.argument("folder", type=PATH, required=False)
@click.option("--bibtex", "as_bibtex", is_flag=True, help="BibTeX instead of plain text.")
def cite(folder: Path | None, as_bibtex: bool) -> None:
    """Say how to cite fastcoil and the paper; with a FOLDER, its results and the version that made them, too."""
    from fastcoil.deliver.report.citation import bibtex, citation

    results = None
    if folder is not None:
        from fastcoil.study.folder.results import open_finished

        results = {str(name): value for name, value in open_finished(folder).attrs.items()}
    say(*(bibtex if as_bibtex else citation)(results))

"""What the studies share: results of a study file, tables and figures."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import matplotlib.pyplot as plt
import xarray as xr
from matplotlib.figure import Figure

import fastcoil as fc

STUDIES = Path(__file__).parent
RESULTS = STUDIES.parent / "results"
WRITTEN = STUDIES
"""Where tables and figures are written, each in the folder of its question."""


def results(name: str) -> xr.Dataset:
    """Open the results of the study file called ``name``; run the study first if they are missing or incomplete."""
    return fc.run_study(study_file(name), RESULTS / name)


def study_file(name: str) -> Path:
    """The study file called ``name``, in whichever folder."""
    (path,) = STUDIES.glob(f"*/{name}.toml")
    return path


def markdown(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown."""
    head = list(head)
    lines = [head, ["---"] * len(head), *map(list, rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines) + "\n"


def write_table(name: str, title: str, head: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Write the table ``FOLDER/NAME`` to ``FOLDER/tables/NAME.md``, from where ``make pages`` puts it into pages."""
    folder, name = name.split("/")
    text = f"**{title}**\n\n{markdown(head, rows)}"
    path = WRITTEN / folder / "tables" / f"{name}.md"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    print(path)


def save_figure(figure: Figure, name: str, dpi: int = 150) -> None:
    """Write the figure ``FOLDER/NAME.png`` and close it."""
    path = WRITTEN / name
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
    print(path)

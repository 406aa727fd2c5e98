"""``fastcoil plot``: the figures of a finished study, as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fastcoil.cli.paths import PATH
from fastcoil.cli.terminal import say
from fastcoil.errors import InputError
from fastcoil.files import make_folder, storage_errors

if TYPE_CHECKING:
    import xarray as xr


@click.command()
@click.argument("folder", type=PATH)
@click.option("--metric", "metrics", multiple=True, help="Metric to draw; may be repeated.  rmse, … by default.")
@click.option("-x", help="Swept parameter along the x axis.")
@click.option("-y", help="Second swept parameter: a map instead of a curve.")
@click.option("--by", help="Second swept parameter: a row of panels for each of some of its values.")
@click.option("--format", default="png", show_default=True, help="png, pdf or svg.")
@click.option("--dpi", default="200", show_default=True, help="Dots per inch, 50 to 1200.")
def plot(
    folder: Path, metrics: tuple[str, ...], x: str | None, y: str | None, by: str | None, format: str, dpi: str
) -> None:
    """Draw the figures of the finished study in FOLDER, or, with -x, one of your choice."""
    from fastcoil.plots.files import check_format
    from fastcoil.study.folder.folder import StudyFolder

    dots = int(dpi) if dpi.isdecimal() else dpi
    check_format(format, dots)
    store = StudyFolder(folder)
    store.require_manifest()  # so that nothing is left in a folder that is none of a study
    if x is None and (metrics or y or by):
        raise InputError("--metric, -y and --by need -x: name the swept parameter along the x axis")
    if y and by:
        raise InputError(f"-y {y} and --by {by}: give one of them, -y for a map or --by for curves")
    with store.hold():
        for path in _draw(folder, metrics, x, y, by, format, int(dots)):
            say(path)


def _draw(
    folder: Path, metrics: tuple[str, ...], x: str | None, y: str | None, by: str | None, format: str, dpi: int
) -> list[Path]:
    """Draw figures of the study in a folder that is held.  Returns their paths."""
    from fastcoil.plots import study as plots
    from fastcoil.plots.files import FIGURES, write
    from fastcoil.study.folder.results import open_study

    ds = open_study(folder)
    if x is None:
        figures = {name: draw() for name, draw in plots.standard_figures(ds).items()}
    else:
        wanted = metrics or plots.STANDARD_METRICS
        name = "_".join([*metrics, *(n for n in (y, by) if n), x])
        figures = {name: plots.maps(ds, x, y, wanted) if y else plots.bands(ds, x, by, wanted)}
    if not figures:
        say("Nothing is swept in this study: there is nothing to draw.")
    drawn_from = ds.attrs.get("content_sha256")  # an unfinished study has none
    if figures:
        _make_figures_folder(folder / FIGURES)
    return write(figures, folder / FIGURES, format=format, dpi=dpi, drawn_from=drawn_from)


def draw_standard_figures(folder: Path, ds: xr.Dataset) -> list[Path]:
    """Draw the standard figures of the results ``ds`` in ``folder`` that are missing, or were drawn from other results.

    The folder is held.  Returns the PNG figures there that show these results.
    """
    from fastcoil.plots import study as plots
    from fastcoil.plots.files import FIGURES, current_figures, write

    drawn_from = ds.attrs["content_sha256"]
    there = {path.name for path in current_figures(folder, drawn_from)}
    for name, draw in plots.standard_figures(ds).items():
        if f"{name}.png" not in there:
            _make_figures_folder(folder / FIGURES)
            write({name: draw()}, folder / FIGURES, drawn_from=drawn_from)
    return [path for path in current_figures(folder, drawn_from) if path.suffix == ".png"]


def _make_figures_folder(path: Path) -> None:
    with storage_errors(path, "made"):
        make_folder(path)

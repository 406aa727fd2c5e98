"""``regenerate``: all simulations, figures and the scorecard into one folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from fastcoil.base.errors import InputError, StorageError
from fastcoil.base.figures import write
from fastcoil.base.files import commit, exists, is_folder
from fastcoil.loops.netcdf import save
from fastcoil.loops.simulate import workers
from fastcoil.study.paper import figures, grid, runs
from fastcoil.study.paper.kinds import KINDS, Days, words
from fastcoil.study.paper.report import markdown, screen
from fastcoil.study.paper.scorecard import COMMAND, scorecard

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def captions(*, quick: bool) -> dict[str, str]:
    """Captions of the figures, by file name without suffix."""
    spread = (
        "Line: median over two days; thin lines: each day, with each of two noise realisations where there is noise.  "
        if quick
        else "Line: median over ten days; band: 10th to 90th percentile, over three noise realisations, too, where "
        "there is noise.  "
    )
    return {
        "fig01": "**Fig 1.** (a) Backlash, Eq (1): opening over command, driven open and closed, with a small loop "
        "inside.  (b) Valve curve, Eq (2).",
        "fig07": "**Fig 7.** A plain PI controller with 7 % backlash (grey) and without (blue): it hunts with the "
        "backlash, and not without.  Dotted: set-point.",
        "fig09": "**Fig 9.** An inverse with 60 % of the backlash (blue) against the plain PI (grey).  "
        "Dotted: set-point.",
        "fig10": "**Fig 10.** An inverse with 95 % of the backlash (blue) against the plain PI (grey).  "
        "Dotted: set-point.",
        "fig11": "**Fig 11.** Mode switches and tracking error over the estimate relative to the backlash.  " + spread
        + "Dotted: the estimate is the backlash.  The buffer is six standard deviations of the noise on the PI's "
        "output.",
        "fig12": "**Fig 12.** (a, b) The estimate learned by the rule as printed.  (c, d) The mode switches that it "
        "saw.  (e, f) Variants, each until its first step down, which the dot marks.  Why the rule as printed cannot "
        "keep the paper's three hours: " + runs.arithmetic(),
        "scorecard": "**Scorecard.** Share of the grid in which each claim holds, by kind of day (marks), and its 95 % "
        "interval over days (lines).  Above the line: claims that hold more often on one kind of day than on another.  "
        "Dotted: 5 and 95 %, the limits of the verdicts.",
    }  # fmt: skip


def regenerate(
    folder: Path,
    *,
    quick: bool = False,
    n_jobs: int | None = None,
    report: Callable[[str], None] = lambda line: None,
    kinds: Mapping[str, Days] = KINDS,
    command: str = COMMAND,
) -> tuple[list[str], list[Path]]:
    """Write figures (NetCDF, PNG, SVG) and the scorecard (Markdown, JSON) into ``folder``.

    quick: a few tunings and days only.  report: is called with a line for each stage.  kinds: the days on which claims
    are judged, the paper's first.  command: how the reader gets the same.
    Returns the verdicts in lines, and the paths of the files written.

    Raises
    ------
    InputError
        If ``folder`` is a file or ``n_jobs`` is not a number of threads.
    StorageError
        If a file cannot be written.
    """
    n_jobs = workers(n_jobs)
    _make_folder(folder)
    captioned = captions(quick=quick)
    paths: list[Path] = []

    def save_data(name: str, ds: xr.Dataset) -> xr.Dataset:
        caption = captioned.get(name, "").replace("**", "")
        ds = runs.rehashed(ds, caption=caption) if caption else ds
        paths.append(folder / f"{name}.nc")
        save(ds, paths[-1])
        return ds

    def save_figure(name: str, figure: Figure) -> None:
        for suffix in ("png", "svg"):
            paths.extend(write({name: figure}, folder, format=suffix))

    report("Figures …")
    save_figure("fig01", figures.valve_curves(save_data("fig01", runs.valve_curves())))
    days = runs.tracking()
    for name, other in (("fig07", "no backlash"), ("fig09", "60 %"), ("fig10", "95 %")):
        save_figure(name, figures.tracking(save_data(name, days.sel(case=["plain PI", other])), other))
    save_figure("fig11", figures.estimates(save_data("fig11", runs.estimates(quick=quick, n_jobs=n_jobs))))
    save_figure("fig12", figures.staircases(save_data("fig12", runs.staircases())))

    loop = grid.tunings(quick=quick)
    evidence: dict[str, xr.Dataset] = {}
    how: Any = {"kinds": kinds, "quick": quick, "n_jobs": n_jobs}
    stages: dict[str, Callable[[], xr.Dataset]] = {
        "quiet": lambda: grid.quiet(loop, n_jobs),
        # gains are best on the usual kinds, so that a further one changes nothing of the others
        "days": lambda: grid.on_days(loop, grid.best_gains(loop, quick=quick, n_jobs=n_jobs), **how),
        "learning": lambda: grid.learning(loop, **how),
        "starts": lambda: grid.starts(loop, **how),
        "coils": lambda: grid.coils(quick=quick),
    }
    for name, simulated in stages.items():
        report(f"Grid of {loop.sizes['tuning']} tunings: {name} …")
        evidence[name] = save_data(f"grid_{name}", simulated())
    card = scorecard(evidence, {name: words(days) for name, days in kinds.items()}, command=command, quick=quick)
    save_figure("scorecard", figures.shares(card))
    for suffix, text in (
        ("md", markdown(card, captioned)),
        ("json", json.dumps(card, indent=1, ensure_ascii=False, allow_nan=False) + "\n"),
    ):
        paths.append(folder / f"scorecard.{suffix}")
        commit(paths[-1], text.encode())
    return screen(card), paths


def _make_folder(folder: Path) -> None:
    if exists(folder) and not is_folder(folder):
        raise InputError(f"{folder} is a file: choose another folder with -o")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{folder} cannot be made: {error.strerror}") from error

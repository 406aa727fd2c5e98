"""``regenerate``: all simulations, figures and the scorecard into one folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from fastcoil.errors import InputError, StorageError
from fastcoil.files import commit
from fastcoil.paper import figures, grid, runs
from fastcoil.paper.scorecard import markdown, scorecard, screen
from fastcoil.simulation.netcdf import save
from fastcoil.simulation.simulate import workers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAPTIONS = {
    "fig01": "**Fig 1.** (a) Backlash, Eq (1): opening over command, driven open and closed, with a small loop inside. "
    "(b) Valve curve, Eq (2).",
    "fig07": "**Fig 7.** A conventional PI controller with 7 % backlash (grey) and without (dark): it hunts with "
    "backlash, and does not without.",
    "fig09": "**Fig 9.** An inverse with 60 % of the backlash (dark) against the plain PI (grey).",
    "fig10": "**Fig 10.** An inverse with 95 % of the backlash (dark) against the plain PI (grey).",
    "fig11": "**Fig 11.** Mode switches and tracking error over the estimate relative to the backlash: median and "
    "10–90 % band over ten days, and over three noise realisations where there is noise.  The buffer is six standard "
    "deviations of the noise on the PI's output.",
    "fig12": "**Fig 12.** (a, b) The learned estimate with the rule as printed. (c, d) The mode switches that it saw. "
    "(e, f) Variants, each until its first step down, which the dot marks.  Why the rule as printed cannot keep the "
    "paper's three hours: " + runs.arithmetic(),
    "scorecard": "**Scorecard.** Share of the grid in which each claim holds, and its 95 % interval over days.",
}


def regenerate(
    folder: Path, *, quick: bool = False, n_jobs: int | None = None, tell: Callable[[str], None] = lambda line: None
) -> tuple[list[str], list[Path]]:
    """Write figures (NetCDF, PNG, SVG) and the scorecard (Markdown, JSON) into ``folder``.

    quick: a few tunings and days only.  tell: is called with a line for each stage.
    Returns the verdicts in lines, and the paths of what was written.

    Raises
    ------
    InputError
        If ``folder`` is a file or ``n_jobs`` no number of threads.
    StorageError
        If something cannot be written.
    """
    n_jobs = workers(n_jobs)
    _make(folder)
    written: list[Path] = []

    def keep(name: str, ds: xr.Dataset) -> xr.Dataset:
        caption = CAPTIONS.get(name, "").replace("**", "")
        ds = runs.rehashed(ds, caption=caption) if caption else ds
        written.append(folder / f"{name}.nc")
        save(ds, written[-1])
        return ds

    def draw(name: str, figure: Figure) -> None:
        for suffix in ("png", "svg"):
            written.append(folder / f"{name}.{suffix}")
            commit(written[-1], figures.image(figure, suffix))

    tell("Figures …")
    draw("fig01", figures.valve_curves(keep("fig01", runs.valve_curves())))
    days = runs.tracking()
    for name, other in (("fig07", "no backlash"), ("fig09", "60 %"), ("fig10", "95 %")):
        draw(name, figures.tracking(keep(name, days.sel(case=["plain PI", other])), other))
    draw("fig11", figures.estimates(keep("fig11", runs.estimates(quick=quick, n_jobs=n_jobs))))
    draw("fig12", figures.staircases(keep("fig12", runs.staircases())))

    loop = grid.tunings(quick=quick)
    evidence: dict[str, xr.Dataset] = {}
    how: Any = {"quick": quick, "n_jobs": n_jobs}
    stages: dict[str, Callable[[], xr.Dataset]] = {
        "quiet": lambda: grid.quiet(loop, n_jobs),
        "days": lambda: grid.on_days(loop, **how),
        "learning": lambda: grid.learning(loop, **how),
        "starts": lambda: grid.starts(loop, **how),
        "coils": lambda: grid.coils(quick=quick),
    }
    for name, simulated in stages.items():
        tell(f"Grid of {loop.sizes['tuning']} tunings: {name} …")
        evidence[name] = keep(f"grid_{name}", simulated())
    card = scorecard(evidence, quick=quick)
    draw("scorecard", figures.shares(card))
    for suffix, text in (
        ("md", markdown(card, CAPTIONS)),
        ("json", json.dumps(card, indent=1, ensure_ascii=False, allow_nan=False) + "\n"),
    ):
        written.append(folder / f"scorecard.{suffix}")
        commit(written[-1], text.encode())
    return screen(card), written


def _make(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file: choose another folder with -o")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{folder} cannot be made: {error.strerror}") from error

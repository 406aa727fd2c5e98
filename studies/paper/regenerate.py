"""All simulations, figures and the scorecard in one folder, as a page, in Markdown, JSON and on one screen."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from fastcoil.base.figures import write_figures
from fastcoil.base.files import make_folder, write_atomically
from fastcoil.base.text import format_share
from fastcoil.loops.netcdf import save
from studies.paper import figures, grid
from studies.paper.grid import KINDS, Days
from studies.paper.page import captions, page_to_markdown, paper_page
from studies.paper.scorecard import scorecard

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def screen_lines(card: Mapping[str, Any]) -> list[str]:
    """Write the shares, a line for each claim; what changes with the kind of day first."""
    grid_facts, kinds = card["grid"], card["kinds"]
    lines = [
        f"{card['title']}: {grid_facts['n_tunings']} tunings × {len(grid_facts['day_seeds'])} days of each kind "
        f"({grid_facts['n_left_out']} of {grid_facts['n_tunings_tried']} left out: they hunt without backlash)",
        *(f"  {name}: {words}" for name, words in kinds.items()),
        "Shares in which a claim holds, by kind of day:",
    ]
    head = "".join(f"{name:>10}" for name in kinds)
    for title, changes in (("changes with the kind of day", True), ("does not", False)):
        lines.append(f"{head}  {title}")
        for c in card["claims"]:
            if bool(c["change"]) == changes:
                cells = "".join(f"{format_share(verdict['share']):>10}" for verdict in c["kinds"].values()).ljust(
                    len(head)
                )
                lines.append(f"{cells}  {c['claim']}")
    lines += [f"{'no share':>10}".ljust(len(head)) + f"  {c['claim']}  It {c['verdict']}." for c in card["identities"]]
    return lines


def regenerate(
    folder: Path,
    *,
    quick: bool = False,
    n_jobs: int | None = None,
    report: Callable[[str], None] = lambda line: None,
    kinds: Mapping[str, Days] = KINDS,
) -> tuple[list[str], list[Path]]:
    """Write figures (NetCDF, PNG, SVG) and the scorecard (Markdown, JSON, HTML) into ``folder``.

    Parameters
    ----------
    folder
        Made if need be.
    quick
        A few tunings and days only.
    n_jobs
        Number of threads; all cores by default.
    report
        Called with a line for each stage.
    kinds
        The days on which claims are judged, the paper's first.

    Returns
    -------
    tuple
        The verdicts in lines, and the paths of the files written.
    """
    make_folder(folder, parents=True)
    captions_by_name = captions(quick=quick)
    paths: list[Path] = []

    def save_data(name: str, ds: xr.Dataset) -> xr.Dataset:
        caption = captions_by_name.get(name, "")
        ds = grid.with_new_hash(ds, caption=caption) if caption else ds
        paths.append(folder / f"{name}.nc")
        save(ds, paths[-1])
        return ds

    def save_figure(name: str, figure: Figure) -> None:
        for suffix in ("png", "svg"):
            paths.extend(write_figures({name: figure}, folder, format=suffix))

    report("Figures …")
    save_figure("fig01", figures.draw_valve_curves(save_data("fig01", grid.simulate_valve_curves())))
    days = grid.simulate_tracking()
    for name, front_case in (("fig07", "no backlash"), ("fig09", "60 %"), ("fig10", "95 %")):
        save_figure(name, figures.draw_tracking(save_data(name, days.sel(case=["plain PI", front_case])), front_case))
    save_figure(
        "fig11", figures.draw_estimates(save_data("fig11", grid.simulate_estimates(quick=quick, n_jobs=n_jobs)))
    )
    save_figure("fig12", figures.draw_staircases(save_data("fig12", grid.simulate_staircases())))

    loop = grid.tunings(quick=quick)
    evidence: dict[str, xr.Dataset] = {}
    options: Any = {"kinds": kinds, "quick": quick, "n_jobs": n_jobs}
    stages: dict[str, Callable[[], xr.Dataset]] = {
        "quiet": lambda: grid.simulate_quiet_day(loop, n_jobs),
        # gains are best on the usual kinds, so that a further one changes nothing of the others
        "days": lambda: grid.simulate_days(loop, grid.best_gains(loop, quick=quick, n_jobs=n_jobs), **options),
        "learning": lambda: grid.simulate_learning(loop, **options),
        "starts": lambda: grid.simulate_starts(loop, **options),
        "coils": lambda: grid.find_stable_volumes(quick=quick),
    }
    for name, simulate in stages.items():
        report(f"Grid of {loop.sizes['tuning']} tunings: {name} …")
        evidence[name] = save_data(f"grid_{name}", simulate())
    card = scorecard(evidence, {name: grid.kind_in_words(days) for name, days in kinds.items()}, quick=quick)
    save_figure("scorecard", figures.draw_shares(card))
    page = paper_page(card, folder)
    texts = {"scorecard.json": json.dumps(card, indent=1, ensure_ascii=False, allow_nan=False) + "\n"}
    texts |= {"scorecard.md": page_to_markdown(page), "report.html": page.html()}
    for name, text in texts.items():
        paths.append(folder / name)
        write_atomically(paths[-1], text.encode())
    return screen_lines(card), paths

"""``fastcoil paper``: all simulations, figures and the scorecard in one folder, in Markdown, JSON and on one screen."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from fastcoil.base.errors import InputError, StorageError
from fastcoil.base.figures import write
from fastcoil.base.files import commit, exists, is_folder
from fastcoil.base.text import percent
from fastcoil.deliver.figures import paper as figures
from fastcoil.loops.netcdf import save
from fastcoil.loops.simulate import workers
from fastcoil.study.paper import grid
from fastcoil.study.paper.grid import KINDS, Days
from fastcoil.study.paper.scorecard import COMMAND, scorecard

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    head = list(head)
    return ["| " + " | ".join(r) + " |" for r in (head, ["---"] * len(head), *map(list, rows))]


def _percent(share: float | None, limits: tuple[float, float] | None = None) -> str:
    """Write a share, with its interval if it has one."""
    within = f" ({100 * limits[0]:.0f} to {100 * limits[1]:.0f})" if limits else ""
    return "—" if share is None else percent(share) + within


def _number(value: float | None) -> str:
    return "never" if value is None else f"{value:.3g}"


def _seeds(seeds: list[int]) -> str:
    return f"{len(seeds)} days (seeds {seeds[0]} to {seeds[-1]})"


def verdicts(card: Mapping[str, Any], claims: Iterable[Mapping[str, Any]]) -> list[str]:
    """A table of verdicts: a row for each claim and kind of day, presets in the last columns."""
    presets, rows = card["grid"]["presets"], []
    for claim in claims:
        for k, (kind, c) in enumerate(claim["kinds"].items()):
            first = [claim["section"], claim["claim"]] if k == 0 else ["", ""]
            rows.append(
                [*first, kind, c["verdict_text"], _percent(c["share"], c["share_interval"]),
                 _percent(c["share_of_hunting"], c["share_of_hunting_interval"]),
                 *(f"{c['share_of_days'][p] * claim['n_days']:.0f} of {claim['n_days']}" for p in presets)]
            )  # fmt: skip
    return _table(["section", "claim", "days", "verdict", "share", "hunting", *(f"`{p}`" for p in presets)], rows)


def markdown(card: Mapping[str, Any], captions: Mapping[str, str]) -> str:
    """Write the scorecard: tables of verdicts, what changes with the days first, then claim by claim, then figures."""
    grid, claims = card["grid"], card["claims"]
    kinds = "; ".join(f"*{name}*: {words}" for name, words in card["kinds"].items())
    best = "; ".join(
        f"`{p}`: "
        + ", ".join(f"{name} {g[p]['kp']:.3g}/K and {g[p]['ti']:.3g} s" for name, g in grid["best_gains"].items())
        for p in grid["presets"]
    )
    lines = [
        f"# {card['title']}", "",
        f"Made by `{card['command']}`, every number by simulation.  {card['caveat']}", "",
        f"The grid: {grid['n_tunings_tried']} tunings ({', '.join(grid['presets'])}, and gains × sample times × an "
        f"ideal loop and one with sensor lag and stroke time).  {grid['n_left_out']} of them hunt without any backlash "
        f"and are left out.  The other {grid['n_tunings']} run on {_seeds(grid['day_seeds'])} of 8 h of each kind.  "
        f"Where start and step of the learner vary, they run on {_seeds(grid['long_day_seeds'])} of 24 h.  Noise seed "
        f"{grid['noise_seed']}, backlash {percent(grid['backlash'])}.  The share is of tunings × days.  In brackets: "
        "its 95 % interval over other such days with the same tunings, where the days differ.", "",
        f"Kinds of days: {kinds}.  *quiet* and *coils* are no kinds of days: the share is of tunings on a day without "
        "disturbances, and of coils.", "",
        "Best gains are those of lowest error for the same plant and sample time, found on other days, of all with "
        f"which the loop does not hunt without backlash.  {best}.", "",
        "A claim *holds* at a share of 95 % or more, and *does not hold* at 5 % or less.  Between, the verdict names "
        "the region of tunings, of those tried on this same grid, that predicts best where it holds.  If the share "
        "elsewhere is 5 % or less, it *holds only if* a tuning lies there; else it *holds in part, more often if* it "
        "does.", "",
        "## What changes with the kind of day", "",
        "The share differs between two kinds by 10 points or more, and by more than chance; largest differences first.",
        "", *verdicts(card, [c for c in claims if c["change"]]), "",
        "## What does not", "", *verdicts(card, [c for c in claims if not c["change"]]),
        "", f"Under *hunting*: the share among the {grid['n_hunting']} tunings that hunt by themselves with the "
        "backlash, as the paper's does.  Under the presets: days on which the claim holds.", "",
        "## What contradicts itself", "",
        *(f"* \"{c['claim']}\" ({c['section']}) {c['verdict']}.  {c['why']}" for c in card["identities"]), "",
        "## Claim by claim", "",
    ]  # fmt: skip
    for c in claims:
        lines += [f"### {c['claim']} ({c['section']})", ""]
        lines += [f"Counts as holding: {c['counts_as_holding']}  {c['note']}".rstrip(), ""]
        rows = []
        for kind, found in c["kinds"].items():
            share = f"{percent(found['share'], decimals=1)} of {c['n_tunings']} × {c['n_days']}"
            lines.append(f"* {kind}: **{found['verdict_text']}**; {share}.")
            of = found["measured"]
            rows += [[n, kind, *(_number(of[p][n]) for p in (*grid["presets"], "grid"))] for n in of["grid"]]
        head = ["median over days", "days", *(f"`{p}`" for p in grid["presets"]), "grid"]
        lines += ["", *_table(head, rows), ""]
    lines += ["## Figures", "", card["caveat"], ""]
    for name, caption in captions.items():
        lines += [f"![{name}]({name}.png)", "", caption, ""]
    lines += ["## Not simulated", "", *(f"* {text}" for text in card["not_simulated"])]
    return "\n".join(lines) + "\n"


def screen(card: Mapping[str, Any]) -> list[str]:
    """Write the shares, a line for each claim; what changes with the kind of day first."""
    grid, kinds = card["grid"], card["kinds"]
    lines = [
        f"{card['title']}: {grid['n_tunings']} tunings × {len(grid['day_seeds'])} days of each kind "
        f"({grid['n_left_out']} of {grid['n_tunings_tried']} left out: they hunt without backlash)",
        *(f"  {name}: {words}" for name, words in kinds.items()),
        "Shares in which a claim holds, by kind of day:",
    ]
    head = "".join(f"{name:>10}" for name in kinds)
    for title, changes in (("changes with the kind of day", True), ("does not", False)):
        lines.append(f"{head}  {title}")
        for c in card["claims"]:
            if bool(c["change"]) == changes:
                cells = "".join(f"{percent(found['share']):>10}" for found in c["kinds"].values()).ljust(len(head))
                lines.append(f"{cells}  {c['claim']}")
    lines += [f"{'no share':>10}".ljust(len(head)) + f"  {c['claim']}  It {c['verdict']}." for c in card["identities"]]
    return lines


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
        "keep the paper's three hours: " + grid.arithmetic(),
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
    command
        What the reader may run to get the same.

    Returns
    -------
    tuple
        The verdicts in lines, and the paths of the files written.

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
        ds = grid.rehashed(ds, caption=caption) if caption else ds
        paths.append(folder / f"{name}.nc")
        save(ds, paths[-1])
        return ds

    def save_figure(name: str, figure: Figure) -> None:
        for suffix in ("png", "svg"):
            paths.extend(write({name: figure}, folder, format=suffix))

    report("Figures …")
    save_figure("fig01", figures.valve_curves(save_data("fig01", grid.valve_curves())))
    days = grid.tracking()
    for name, other in (("fig07", "no backlash"), ("fig09", "60 %"), ("fig10", "95 %")):
        save_figure(name, figures.tracking(save_data(name, days.sel(case=["plain PI", other])), other))
    save_figure("fig11", figures.estimates(save_data("fig11", grid.estimates(quick=quick, n_jobs=n_jobs))))
    save_figure("fig12", figures.staircases(save_data("fig12", grid.staircases())))

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
    card = scorecard(evidence, {name: grid.words(days) for name, days in kinds.items()}, command=command, quick=quick)
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

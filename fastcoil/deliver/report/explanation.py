"""The report of an explanation: will this loop hunt, why, and what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import xarray as xr

from fastcoil.base.text import NONE
from fastcoil.deliver.report.computed import changed, here
from fastcoil.deliver.report.numbers import change, number, setting
from fastcoil.deliver.report.page import Block, Code, Facts, Page, Section, Table, Words
from fastcoil.deliver.report.pictures import picture
from fastcoil.deliver.report.study import cited
from fastcoil.loops.provenance import content_sha256

if TYPE_CHECKING:
    from fastcoil.design.explanation.result import Explanation

_CAPTION = (
    "Top left: gain of the loop over its phase (blue line) and of the gap, -1/N (red, dashed); the loop hunts where it "
    "is above, and the distance between the two dots is the margin.  Top right: which gains hunt (shaded), with lines "
    "of equal margin, the loop as it is (red dot) and other tunings (marks).  Bottom: supply air as it is (red), with "
    "the recommended cure (blue) if there is one, and the set-point (dashed)."
)
_DO = ("Do this", "If the error matters", "Leave it", "None of these")
"""How an advice begins."""
_DAY = "Supply air as it is (red), with the recommended cure (blue) if there is one, and the set-point (dashed)."


def explanation_page(e: Explanation) -> Page:
    """The report of an explanation."""
    first, *middle, last = "\n".join(e.text.splitlines()).split("\n\n")
    advice = last.split("\n")[2 + e.cures.sizes["cure"] :]
    do = [line for line in advice if line.startswith(_DO)]
    drawn: list[Block] = [picture(e.plot(), _DAY if e.phase is None else _CAPTION, "Margin, gains and the day")]
    loop, boundary = e._found.loop, e._found.boundary
    facts = [
        ("Day", boundary.describe()),
        ("Foretold by", "the describing function of the gap in a linear model of the loop at each operating point"),
        ("Simulated with", "a time step of 1 s, on this day, with each cure"),
    ]
    phase: list[Block] = [] if e.phase is None else [_phase(e.phase, middle[0].split("\n")[0] if middle else "")]
    parameters: list[Block] = [Facts(facts)]
    own = changed(loop.constants, "paper_like", "default")
    parameters += [own] if own.rows else []
    parameters.append(Code("fastcoil explain TARGET --report explanation.html"))
    sections = [
        Section("The loop in one figure", drawn),
        Section("What can be done", [_cures(e.cures), Words([line for line in advice if line not in do])]),
        Section("Where the phase goes", phase),
        Section("How it was computed", parameters),
        here(),
        cited(),
    ]
    gains = ", ".join(f"{name} = {setting(name, loop[name])}" for name in ("kp", "ti"))
    title = f"Will this loop hunt? {gains}"
    question = "Will it hunt on this day, why, what would cure it, and what does that cost?"
    return Page(
        "Explanation", title, question, list(e.doubts), [*first.split("\n"), *do], sections, content_sha256(e.cures)
    )


def _cures(ds: xr.Dataset) -> Table:
    rows = []
    for k in range(ds.sizes["cure"]):
        one, now = ds.isel(cure=k), ds.isel(cure=0)
        error, travel = float(one["rmse"]), float(one["motor_travel"])
        before = float(now["motor_travel"])
        margin, swing = float(one["margin"]), float(one["hunting_swing"])
        rows.append([
            str(one["words"].item()), number(margin, 2), f"{number(error)} K",
            change(error / float(now["rmse"]) - 1.0) if k else "", f"{number(swing, 2)} K",
            f"{number(travel)}", f"× {number(travel / before, 2)}" if k and before > 0.0 else "",
            str(one["verdict"].item()) if k else "",
        ])  # fmt: skip
    head = ["", "margin", "RMS error", "change", "swing", "motor travel", "change", "verdict"]
    note = (
        "Each cure alone, on the same day.  Margin: above 0.85 a loop hunts.  Swing: peak to peak, settled.  Motor "
        f"travel: strokes.  {NONE}: cannot be told."
    )
    return Table("The loop as it is and with each cure", head, rows, note)


def _phase(phase: xr.DataArray, title: str) -> Table:
    order = phase.values.argsort()[::-1]
    rows = [[str(phase["part"].values[k]), f"{float(phase[k]):.0f}°"] for k in order if abs(float(phase[k])) >= 0.5]
    return Table(title.removesuffix(":") or "Phase", ["part of the loop", "takes"], rows)

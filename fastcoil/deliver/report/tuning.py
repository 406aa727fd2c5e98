"""The report of a tuning: which settings to take, and what they do on valves and days that the search never saw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import xarray as xr

from fastcoil.deliver.report.computed import here
from fastcoil.deliver.report.numbers import number, picked
from fastcoil.deliver.report.page import Block, Code, Facts, Page, Section, Table, Words
from fastcoil.deliver.report.pictures import picture
from fastcoil.deliver.report.study import cited
from fastcoil.design.tuning.words import table_rows
from fastcoil.loops.labels import quantity
from fastcoil.loops.provenance import content_sha256
from fastcoil.model.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from fastcoil.design.tuning.measures import Limit
    from fastcoil.design.tuning.result import Tuning

_CAPTION = (
    "Dots joined by a line: every tuning that no other beats in both error and motor travel, on the valves and days of "
    "the search; a grey line leads from each to its hollow dot, the same tuning held out.  Marks with bars: the tuning "
    "of now, the chosen one and that of the SIMC rule, held out; bars are 95 % intervals for other valves and days.  "
    "Dotted: a limit."
)
_NOTE = "In brackets: 95 % interval over valves and days, by bootstrap."


def tuning_page(t: Tuning) -> Page:
    """The report of a tuning."""
    lines = t.summary()
    answer = [lines[0], next(line for line in lines if line.startswith("Held out, "))]
    warnings = [] if t.meets_limits else [
        "No tuning keeps every limit: the one shown breaks them least, and is no recommendation."
    ]  # fmt: skip
    warnings += t.notes
    drawn: list[Block] = [picture(t.plot(), _CAPTION, "Error against motor travel of the tunings")]
    numbers: list[Block] = [_table("Held out", t.held_out, t), _table("Searched on", t.trained, t)]
    facts = [
        ("Sought", f"lowest {next(iter(t.held_out.data_vars.values())).attrs['long_name']}"),
        ("Limits", "; ".join(_limit(t, each) for each in t.limits) or "none"),
        ("Tried", f"{t.evaluations.sizes['evaluation']:,} tunings"),
        ("Searched on", str(t.trained.attrs["group"])),
        ("Held out", str(t.held_out.attrs["group"])),
    ]
    command = "fastcoil tune STUDY.toml -o results/tuning --report tuning.html"
    include = 'Save this as tuning.toml; in a study file, [loop] include = ["tuning.toml"] takes the settings.'
    sections = [
        Section("The choice", drawn),
        Section("Now and then", numbers),
        Section("The front", [_front(t.front)]),
        Section("How it was computed", [Facts(facts), Code(command)]),
        Section("For a study", [Words([include]), Code(t.to_toml())]),
        here(),
        cited(),
    ]
    title = "Tuning of " + ", ".join(quantity(name).text for name in t.parameters)
    question = "Which settings suit all these valves and days, and what do they do on valves and days not searched on?"
    return Page("Tuning", title, question, warnings, answer, sections, content_sha256(t.evaluations))


def _limit(t: Tuning, each: Limit) -> str:
    words = t.held_out[each.measure.name].attrs["long_name"]
    return f"{words}: {'as now' if each.as_now else each.measure.shown(each.most)}"


def _table(title: str, ds: xr.Dataset, t: Tuning) -> Table:
    head, *rows = table_rows(ds, t.limits)
    return Table(f"{title}: {ds.attrs['group']}", ["measure", *head[1:]], rows, _NOTE)


def _front(front: xr.Dataset) -> Table:
    names = [str(n) for n, v in {**front.coords, **front.data_vars}.items() if v.dims == ("point",) and n != "point"]
    shown = picked(front.sizes["point"], most=15)
    rows = [[str(k + 1), *(number(float(front[name][k])) for name in names)] for k in shown]
    head = [quantity(n).axis if n in PARAMETERS else str(front[n].attrs.get("long_name", n)) for n in names]
    note = "" if len(rows) == front.sizes["point"] else f"{len(rows)} of {front.sizes['point']} are shown."
    return Table("Tunings that no other beats in both error and travel", ["", *head], rows, note)

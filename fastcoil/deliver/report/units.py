"""Reports of air handlers: one page a unit, readable by a client, and a ranking of many units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.base.text import MISSING_VALUE, escape_control_characters
from fastcoil.deliver.report.page import Code, Page, Paragraphs, Section, Table, format_significant, make_picture
from fastcoil.loops.provenance import content_sha256
from fastcoil.measured.air_handler.finding import KINDS, Finding
from fastcoil.measured.air_handler.inspect import inspect
from fastcoil.measured.air_handler.unit import AirHandler

_COLUMNS = ("air_handler", "component", "kind", "size", "unit", "hours", "days", "first", "last", "cause", "text",
            "action")  # fmt: skip
_NO_FINDING = dict.fromkeys(_COLUMNS, "") | {"kind": "none", "size": np.nan, "hours": 0.0, "days": 0.0}
UNITS_MARK = b"air_handler,component,kind,"  # begins the header of a table of findings


def unit_page(unit: AirHandler) -> Page:
    """Return the page of an air handler."""
    counts = f"{len(unit.findings)} findings" if unit.findings else "no fault found"
    caption = (
        "Above: supply air, entering air and set-points.  Middle: commands to the valves.  Below: when each finding "
        "holds, the worst at the top."
    )
    picture = make_picture(unit.plot(), caption, f"temperatures, commands and findings of {unit.source}")
    rows = [
        [f.component, KINDS[f.kind], f"{format_significant(f.size, 2)} {f.unit}", f"{f.hours:.1f} h", f.text, f.action]
        for f in unit.findings
    ]
    head = ["component", "finding", "size", "hours", "what shows it", "what to do"]
    sections = [
        Section("Clock times", [picture]),
        Section("Findings, the worst first", [Table("", head, rows)] if rows else []),
        Section("The loops", [Paragraphs(unit.describe_control(), bullets=True)]),
        Section("How the log was read", [Paragraphs(unit.notes, bullets=True)]),
        Section("Columns and findings as a file", [Code(unit.to_toml())]),
    ]
    question = "Which valve, sensor or loop of this air handler is at fault, when, and what is to be done?"
    answer = [unit.headline, *(["See the other findings below."] if len(unit.findings) > 1 else [])]
    data = findings_dataset({unit.source: unit.findings})
    return Page("Air handler", f"{unit.source}: {counts}", question, [], answer, sections, content_sha256(data))


def require_no_valve_options(options: Mapping[str, Any]) -> None:
    """Refuse options of `diagnose`, which are for one valve, beside the log of an air handler."""
    for name in [name for name, value in options.items() if value is not None]:
        sentence = f"{name} is for the log of one valve: leave it out, or say which valve, with the column command"
        raise InputError(sentence, name, "conflict")


def find_in_unit(log: Any, answers: Any) -> list[Finding]:
    """Return the findings in the log of an air handler."""
    return inspect(log, answers=answers).findings


def rows_to_dataset(rows: Sequence[Mapping[str, Any]], dim: str, columns: Sequence[str]) -> xr.Dataset:
    """Return rows as a Dataset along ``dim``, with control characters of texts escaped: names hold any byte."""
    ds = xr.Dataset()
    for name in columns:
        values = [escape_control_characters(row[name]) if isinstance(row[name], str) else row[name] for row in rows]
        is_text = all(isinstance(value, str) for value in values)
        ds[name] = (dim, np.array(values, dtype=object if is_text else None))
    return ds


def findings_dataset(results: Mapping[str, Sequence[Finding] | str]) -> xr.Dataset:
    """Return findings along ``finding``, units with most kelvin-hours first; ``problem`` along ``unread``.

    ``air_handler`` names the unit; a unit without findings has a row with the kind ``none``.  results: by unit, its
    findings, or why its log cannot be read.
    """
    found = [(name, result) for name, result in results.items() if not isinstance(result, str)]
    found.sort(key=lambda pair: (-sum(abs(f.size) * f.hours for f in pair[1] if f.unit == "K"), pair[0]))
    rows = [{**row, "air_handler": name} for name, its in found for row in [*map(_finding_row, its)] or [_NO_FINDING]]
    ds = rows_to_dataset(rows, "finding", _COLUMNS).assign_attrs(title="fastcoil survey of air handlers")
    ds["hours"].attrs["units"] = "h"
    problems = [{"unread": name, "problem": result} for name, result in results.items() if isinstance(result, str)]
    return ds.merge(rows_to_dataset(problems, "unread", ("unread", "problem"))).set_coords("unread")


def _finding_row(f: Finding) -> dict[str, Any]:
    days = {str(first)[:10] if isinstance(first, np.datetime64) else int(first // 86400) for first, _ in f.windows}
    values = {name: getattr(f, name) for name in _COLUMNS if hasattr(f, name)}
    return values | {"days": float(len(days)), "first": str(f.windows[0][0]), "last": str(f.windows[-1][1])}


RANKING_HEADER = ("air handler", "component", "finding", "size", "hours", "days")


def ranked_findings(ds: xr.Dataset) -> list[list[str]]:
    """Return the cells of ``RANKING_HEADER`` for each finding."""
    rows = []
    for k in range(ds.sizes["finding"]):
        f = {str(name): ds[name].values[k] for name in _COLUMNS}
        size = MISSING_VALUE if f["kind"] == "none" else f"{format_significant(f['size'], 2)} {f['unit']}"
        what = "no fault found" if f["kind"] == "none" else KINDS[f["kind"]]
        rows.append([f["air_handler"], f["component"], what, size, f"{f['hours']:.1f}", f"{f['days']:.0f}"])
    return rows


def describe_units(ds: xr.Dataset) -> str:
    """Count the units with and without findings, in a sentence."""
    names, kinds = ds["air_handler"].values, ds["kind"].values
    n_units, n_sound = len(set(names)), int(np.sum(kinds == "none"))
    unread = f", {ds.sizes['unread']} not read" if ds.sizes["unread"] else ""
    return f"{n_units + ds.sizes['unread']} air handlers: {n_units - n_sound} with findings, {n_sound} without{unread}"


def unread_section(what: str, names: Iterable[str], problems: Iterable[str]) -> Section:
    """Return the section on logs of a survey that could not be read; ``what``: valves, or air handlers."""
    rows = list(zip(names, problems, strict=True))
    return Section("Logs that could not be read", [Table("", [what, "reason"], rows)] if rows else [])


def units_page(ds: xr.Dataset) -> Page:
    """Return the page of a survey of air handlers."""
    rows = [[*row, str(ds["text"].values[k]), str(ds["action"].values[k])] for k, row in enumerate(ranked_findings(ds))]
    tables = [Table("", [*RANKING_HEADER, "what shows it", "what to do"], rows)] if rows else []
    unread = unread_section("air handler", ds["unread"].values, ds["problem"].values)
    sections = [Section("Units with most to gain first", tables), unread]
    question = "Which air handlers need work, and which part of each?"
    return Page("Survey", "Survey of air handlers", question, [], [describe_units(ds)], sections, content_sha256(ds))

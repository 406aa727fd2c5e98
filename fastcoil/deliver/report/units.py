"""Reports of air handlers: one page a unit, readable by a client, and a ranking of many units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_flag
from fastcoil.base.errors import FastcoilError, InputError
from fastcoil.base.files import convert_os_errors, make_folder, write_atomically
from fastcoil.base.progress import Advance, display_for_call
from fastcoil.base.text import MISSING_VALUE, escape_control_characters, escape_formulas
from fastcoil.deliver.report.page import Code, Page, Paragraphs, Section, Table, format_significant, make_picture
from fastcoil.logs.log import Log, read_log
from fastcoil.loops.provenance import content_sha256
from fastcoil.measured.air_handler.finding import KINDS, Finding
from fastcoil.measured.air_handler.inspect import inspect
from fastcoil.measured.air_handler.unit import AirHandler

_FINDING_COLUMNS = ("component", "kind", "size", "unit", "hours", "days", "first", "last", "cause", "text", "action")
_TEXT_COLUMNS = ("component", "kind", "unit", "first", "last", "cause", "text", "action")
_NO_FINDING: dict[str, Any] = dict.fromkeys(_TEXT_COLUMNS, "") | {
    "kind": "none",
    "size": np.nan,
    "hours": 0.0,
    "days": 0,
}
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
    data = findings_dataset({unit.source: unit.findings}, {})
    return Page("Air handler", f"{unit.source}: {counts}", question, [], answer, sections, content_sha256(data))


def require_no_valve_options(options: Mapping[str, Any]) -> None:
    """Refuse options of `diagnose`, which are for one valve, beside the log of an air handler."""
    for name in [name for name, value in options.items() if value is not None]:
        sentence = f"{name} is for the log of one valve: leave it out, or say which valve, with the column command"
        raise InputError(sentence, name, "conflict")


def survey_units(
    logs: Mapping[str, Any], targets: Sequence[Path], *, n_jobs: int, read: Mapping[str, Any], answers: Any,
    progress: bool | None,
) -> xr.Dataset:  # fmt: skip
    """Inspect the air handlers of a building; see `survey`."""
    with argument_checks() as check:
        progress = check.unless_none(require_flag, "progress", progress)
    with display_for_call(progress) as display:
        advance = display.start(len(logs), items="logs")
        results = dict(_inspect_logs(logs, read, answers, n_jobs, advance))
    findings = {name: result for name, result in results.items() if not isinstance(result, str)}
    ds = findings_dataset(findings, {name: text for name, text in results.items() if isinstance(text, str)})
    for target in targets:
        with convert_os_errors(target.parent, "written"):
            make_folder(target.parent, parents=True)
        is_table = target.suffix.lower() == ".csv"
        write_atomically(target, (_csv_text(ds) if is_table else _units_page(ds).html()).encode())
    return ds


def _inspect_logs(
    logs: Mapping[str, Any], read: Mapping[str, Any], answers: Any, n_jobs: int, advance: Advance
) -> Iterator[tuple[str, list[Finding] | str]]:
    """Inspect logs and yield the findings of each, or why it cannot be read; in processes."""
    tasks = (joblib.delayed(_findings_of)(log, read, answers) for log in logs.values())
    n_processes = max(1, min(n_jobs, len(logs) // 2))
    for name, result in zip(logs, joblib.Parallel(n_processes, return_as="generator")(tasks), strict=True):
        yield name, result
        advance(1)


def _findings_of(log: Any, read: Mapping[str, Any], answers: Any) -> list[Finding] | str:
    try:
        return inspect(log if isinstance(log, Log) or not read else read_log(log, **read), answers=answers).findings
    except Exception as error:  # one log must not end the survey of all others
        bug_text = "" if isinstance(error, FastcoilError) else f"please report this error: {type(error).__name__}: "
        return bug_text + "; ".join(str(error).split("\n"))


def findings_dataset(findings_by_unit: Mapping[str, Sequence[Finding]], problems: Mapping[str, str]) -> xr.Dataset:
    """Return findings along ``finding``, units with most kelvin-hours first; ``problem`` along ``unread``.

    ``air_handler`` names the unit; a unit without findings has a row with the kind ``none``.
    """

    def badness(name: str) -> float:
        return sum(abs(f.size) * f.hours for f in findings_by_unit[name] if f.unit == "K")

    rows: list[dict[str, Any]] = []
    for name in sorted(findings_by_unit, key=lambda name: (-badness(name), name)):
        its_rows = [_finding_row(f) for f in findings_by_unit[name]] or [_NO_FINDING]
        rows += [{"air_handler": name, **row} for row in its_rows]
    ds = xr.Dataset(attrs={"title": "fastcoil survey of air handlers"})
    for column in ("air_handler", *_FINDING_COLUMNS):
        is_text = column in ("air_handler", *_TEXT_COLUMNS)
        values = [escape_control_characters(row[column]) if is_text else row[column] for row in rows]
        units = {"hours": {"units": "h"}}.get(column, {})
        ds[column] = ("finding", np.array(values, dtype=object if is_text else float), units)
    unread = [escape_control_characters(name) for name in problems]
    texts = [escape_control_characters(text) for text in problems.values()]
    ds["problem"] = ("unread", np.array(texts, dtype=object))
    return ds.assign_coords(unread=("unread", np.array(unread, dtype=object)))


def _finding_row(f: Finding) -> dict[str, Any]:
    days = {str(first)[:10] if isinstance(first, np.datetime64) else int(first // 86400) for first, _ in f.windows}
    values = {
        name: getattr(f, name) for name in ("component", "kind", "size", "unit", "hours", "cause", "text", "action")
    }
    return values | {"days": len(days), "first": str(f.windows[0][0]), "last": str(f.windows[-1][1])}


def _csv_text(ds: xr.Dataset) -> str:
    frame = ds.drop_dims("unread").to_dataframe()[["air_handler", *_FINDING_COLUMNS]]
    for name in ("air_handler", *_TEXT_COLUMNS):
        frame[name] = frame[name].map(escape_formulas)
    return str(frame.rename(columns={"hours": "hours [h]"}).to_csv(index=False, lineterminator="\n"))


RANKING_HEADER = ("air handler", "component", "finding", "size", "hours", "days")


def ranked_findings(ds: xr.Dataset) -> list[list[str]]:
    """Return the cells of ``RANKING_HEADER`` for each finding."""
    rows = []
    for k in range(ds.sizes["finding"]):
        f = {str(name): ds[name].values[k] for name in ("air_handler", *_FINDING_COLUMNS)}
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


def _units_page(ds: xr.Dataset) -> Page:
    rows = [[*row, str(ds["text"].values[k]), str(ds["action"].values[k])] for k, row in enumerate(ranked_findings(ds))]
    tables = [Table("", [*RANKING_HEADER, "what shows it", "what to do"], rows)] if rows else []
    problems = [Table("", ["air handler", "reason"], list(zip(ds["unread"].values, ds["problem"].values, strict=True)))]
    sections = [Section("Units with most to gain first", tables)]
    sections.append(Section("Logs that could not be read", problems if ds.sizes["unread"] else []))
    question = "Which air handlers need work, and which part of each?"
    return Page("Survey", "Survey of air handlers", question, [], [describe_units(ds)], sections, content_sha256(ds))

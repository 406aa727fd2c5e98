"""``report``: one HTML file that a client can open, of a study, a diagnosis, a tuning or an explanation.

Each has question, answer, figure and all numbers.  A report of a study compares every estimate with the plain PI, and
every gap with the sound valve, within pairs of scenarios that differ in nothing else.  Intervals are bootstrap
intervals over drawn valves or days, where the study has several; swept values are chosen, so they get a range instead.
"""

import math
import os
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from fastcoil.base.arguments import require_path
from fastcoil.base.errors import InputError
from fastcoil.base.text import format_share
from fastcoil.deliver.figures.swept import standard_figures
from fastcoil.deliver.report import page
from fastcoil.deliver.report.units import unit_page
from fastcoil.design.explain import Explanation
from fastcoil.design.tuning_result import Tuning
from fastcoil.loops.labels import coordinate_quantity, is_parameter, plain_pi_label, quantity, values_quantity
from fastcoil.loops.provenance import content_sha256, provenance
from fastcoil.measured.air_handler.unit import AirHandler
from fastcoil.measured.diagnosis import Diagnosis
from fastcoil.model.metric_table import METRICS, STATUS_MEANINGS, STATUS_OK
from fastcoil.study.analysis.answer import find_answer
from fastcoil.study.analysis.choices import describe_place
from fastcoil.study.analysis.compare import mask_off_days
from fastcoil.study.analysis.paired import paired_change, summarise_median
from fastcoil.study.analysis.selected import mask_dataset, reduction_metrics, swept_dims
from fastcoil.study.analysis.summary import cautions
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.results import open_finished

_CHANCE_DIMS = {"sample": "drawn valves", "day": "days", "replicate": "noise realisations"}
"""Dims of chance, and what varies along them; an interval is over the first of them that a study has."""
_COLUMN_HEADS = {
    "rmse_settled": "settled RMS error [K]",
    "hunts": "share that hunts",
    "motor_travel": "motor travel [strokes]",
    "switch_frequency": "mode switches per 10 min",
}
_MAX_NAME_ROWS = 40  # most rows of a table along a dim of names


def comparison_tables(ds: xr.Dataset) -> list[page.Table]:
    """Return a table for every swept dimension of a study, at the recommended labels of the other choices."""
    place, pi = find_answer(ds).place, plain_pi_label(ds)
    ds = mask_off_days(ds[[n for n in ("rmse", *_COLUMN_HEADS, *reduction_metrics(ds), "status") if n in ds]])
    ds = mask_dataset(ds.drop_vars("status"), ds["status"] == STATUS_OK)
    tables = []
    for dim in swept_dims(ds, "rmse"):
        labels, others = ds[dim].values, {d: label for d, label in place.items() if d != dim}
        part, at = ds.sel(others, drop=True), describe_place(ds, others)
        zero, best = int((labels == 0.0).argmax()), int((labels == place[dim]).argmax()) if dim in place else None
        if dim in ("estimate_ratio", "backlash_estimate") and labels[zero] == 0.0:
            tables.append(_comparison_table(part, dim, at, zero, f"the {pi} of the same loop", best))
        elif dim == "backlash" and labels[zero] == 0.0:
            tables.append(_comparison_table(part, dim, at, zero, "the sound valve"))
        elif labels.dtype.kind in "OUST" and labels.size <= _MAX_NAME_ROWS:
            tables.append(_comparison_table(part, dim, at, 0, f"{labels[0]}, the first", best))
        elif is_parameter(ds, dim):
            tables.append(_comparison_table(part, dim, at, None, "", best))
    return tables


def _comparison_table(
    ds: xr.Dataset, dim: str, condition: str, baseline_row: int | None = None, baseline_words: str = "",
    recommended_row: int | None = None,
) -> page.Table:  # fmt: skip
    """Return a table of medians with a row for every label, or for some, among them baseline and recommendation."""
    chance = next((d for d in _CHANCE_DIMS if ds.sizes.get(d, 1) > 1), "") if baseline_row is not None else ""
    n, has_names, to_text = ds.sizes[dim], ds[dim].dtype.kind in "OUST", page.format_significant
    base = ds["rmse"].isel({dim: baseline_row or 0}, drop=True)
    median_by_label = ds["rmse"].median([d for d in ds["rmse"].dims if d != dim]).fillna(math.inf)
    keep = tuple(k for k in (baseline_row, recommended_row, int(median_by_label.values.argmin())) if k is not None)
    other_metrics = {str(name): values for name, values in ds.data_vars.items() if name != "rmse"}
    rows = []
    for k in page.select_rows(n, keep, _MAX_NAME_ROWS if has_names else page.MOST_ROWS):
        rmse, label = ds["rmse"].isel({dim: k}, drop=True), ds[dim].values[k]
        cells = [str(label) if isinstance(label, str) else coordinate_quantity(ds, dim).number(float(label))]
        cells.append(to_text(float(rmse.median())))
        if baseline_row is None:
            cells.append(" to ".join(to_text(float(rmse.quantile(q))) for q in (0.05, 0.95)))
        elif k == baseline_row:
            cells += ["baseline", *[""] * (2 + bool(chance))]
        else:
            change = summarise_median(paired_change(rmse, base).rename("rmse"), chance)
            is_lower = ((rmse < base) + 0.5 * (rmse == base)).where(rmse.notnull() & base.notnull())
            cells += [page.format_change(change.median)]
            cells += [page.format_change_range(change.low, change.high)] if chance else []
            cells += [page.format_change_range(change.q05, change.q95), format_share(float(is_lower.mean()))]
        for name, values in other_metrics.items():
            label_values = values.isel({dim: k})
            median = values_quantity(values).factor * float(label_values.median())
            cells.append(format_share(float(label_values.mean())) if name == "hunts" else to_text(median))
        rows.append(cells)
    dim_text = coordinate_quantity(ds, dim).text
    omission = page.omission_note(n, len(rows), "names" if has_names else "values")
    spread = ["change", *(["95 % interval"] if chance else []), "5 to 95 % of pairs", "lower in"]
    header = [dim_text, "RMS error [K]", *(["5 to 95 % of scenarios"] if baseline_row is None else spread)]
    header += [_COLUMN_HEADS.get(name) or values_quantity(values).axis for name, values in other_metrics.items()]
    if baseline_row is None:
        note = f"Medians{condition} over everything else.  {omission}".strip()
        return page.Table(f"Along {dim_text}", header, rows, note)
    note = (
        f"RMS error: median{condition}.  Change: median within pairs that differ in nothing else.  "
        f"{f'95 % interval: of the median change, over {ds.sizes[chance]} {_CHANCE_DIMS[chance]}.  ' if chance else ''}"
        f"5 to 95 % of pairs: how much the change differs from loop to loop.  Lower in: share of pairs with less "
        f"error, ties half.  {omission}"
    ).strip()
    return page.Table(f"{dim_text.capitalize()}: against {baseline_words}", header, rows, note)


def metrics_table(ds: xr.Dataset) -> page.Table:
    """Return a table of the metrics of a single scenario, with units."""
    rows = []
    for name, output in METRICS.items():
        if name in ds and name != "hunts" and not output.flags and bool(ds[name].notnull().any()):
            value, axis = float(ds[name].max()), quantity(name)
            text = f"{page.format_significant(value * axis.factor)} {axis.unit}".rstrip()
            rows.append([output.long_name, f"{value:.0f}" if name in ("reversals", "half_periods") else text, name])
    for name in reduction_metrics(ds):
        axis = values_quantity(ds[name])
        rows.append([axis.text, f"{page.format_significant(float(ds[name].max()))} {axis.unit}".rstrip(), name])
    return page.Table("Every metric", ["metric", "value", "name in results.nc"], rows)


def study_page(folder: Path) -> page.Page:
    """Return the report of the finished study in a folder; errors are those of ``open_finished``."""
    ds = open_finished(folder)
    warnings = []
    counts = Counter(ds["status"].values[ds["status"].values != STATUS_OK].tolist())
    n_failed = counts.total()
    if n_failed:
        why = ", ".join(f"{n:,} {STATUS_MEANINGS[code]}" for code, n in sorted(counts.items()))
        failures = f"{n_failed:,} of {ds['status'].size:,} scenarios failed ({why})"
        warnings.append(f"{failures}. They are in no number of this page; status in results.nc says which they are.")
    title = str(ds.attrs["title"])
    sections: list[page.Section] = []
    answer = ["Every scenario failed: there is no answer."]
    if n_failed < ds["status"].size:
        warnings += cautions(ds)
        answer = find_answer(ds).summary()
        numbers = [metrics_table(ds)] if ds["status"].size == 1 else comparison_tables(ds)
        sections += [page.Section("Figures", _make_pictures(ds, title)), page.Section("In numbers", numbers)]
    sections += [page.method_section(ds), page.versions_section(ds.attrs)]
    sections.append(page.Section("The study file", [page.Code(ds.attrs["study_toml"])]))
    sections += [_reproduction_section(folder, ds), page.citation_section(ds)]
    question, origin = str(ds.attrs.get("summary", "")).strip(), str(ds.attrs["content_sha256"])
    return page.Page("Study", title, question, warnings, answer, sections, origin)


def _make_pictures(ds: xr.Dataset, title: str) -> list[page.Block]:
    """Draw the standard figures of a study; the meaning of the marks moves from their titles to the captions."""
    pictures: list[page.Block] = []
    for k, (name, draw) in enumerate(standard_figures(ds).items(), 1):
        figure = draw()
        caption = " ".join(figure.get_suptitle().split()).removeprefix(" ".join(title.split())).strip()
        pictures.append(page.make_picture(figure, f"Figure {k}.  {caption}.", f"{name} of the study"))
    return pictures


def _reproduction_section(folder: Path, ds: xr.Dataset) -> page.Section:
    name = shlex.quote(folder.absolute().name or "study")
    lines = [
        f"python -m pip install fastcoil=={ds.attrs.get('fastcoil_version', '')}",
        f"fastcoil run study.toml -o results/{name}",
        f"fastcoil verify results/{name}",
        f"fastcoil report results/{name}",
    ]
    instruction = (
        "Save the study file above as study.toml, with the files that it names beside it.  On one kind of processor "
        "and with the same versions, content_sha256 is the same to the last digit."
    )
    return page.Section("Do it again", [page.Paragraphs([instruction]), page.Code("\n".join(lines))])


def _result_page(
    label: str, title: str, question: str, answer: Sequence[str], warnings: Sequence[str], picture: page.Picture,
    hashed_data: xr.Dataset, extra_sections: Sequence[page.Section],
) -> page.Page:  # fmt: skip
    """Assemble the report of a single result; hashed_data: what its hash is of; extra_sections: after the figure."""
    versions = page.versions_section({name: value for name, value in provenance().items() if name != "date_created"})
    sections = [page.Section("In one figure", [picture]), *extra_sections, versions, page.citation_section()]
    return page.Page(label, title, question, warnings, answer, sections, content_sha256(hashed_data))


def _study_sections(name: str, toml: str, notes: Sequence[str]) -> list[page.Section]:
    """Return the section of notes, and one with all numbers as a file that a study can include."""
    instruction = f'Save this as {name}.toml; in a study file, [loop] include = ["{name}.toml"] takes it.'
    return [
        page.Section("What to mind", [page.Paragraphs(notes, bullets=True)] if notes else []),
        page.Section("All numbers, for a study", [page.Paragraphs([instruction]), page.Code(toml)]),
    ]


def diagnosis_page(d: Diagnosis) -> page.Page:
    """Return the report of a diagnosis."""
    caption = (
        "From the top: what each hour was like; supply air (line) and its set-point (dashed) in the two hours in which "
        "the motor moves most; the command of the controller; the probability of each size of the gap (bars) with its "
        "95 % interval (grey band), grey bars where the log does not identify it; what the loop fitted to this log "
        "would do with another valve, gain or controller, present value = 100 %."
    )
    warnings = [] if d.identified else [f"The log does not identify the size of the gap: {d.reason}"]
    return _result_page(
        "Diagnosis", f"Is it the valve? {d.source}",
        "How large is the gap of this valve, does its loop hunt, and is the valve to blame?", d.findings, warnings,
        page.make_picture(d.plot(), caption, "Signals, probability of each gap, predictions"), d.signals,
        _study_sections("diagnosis", d.to_toml(), d.notes),
    )  # fmt: skip


def tuning_page(t: Tuning) -> page.Page:
    """Return the report of a tuning."""
    limits_warning = "No tuning keeps every limit: the one shown breaks them least, and is not a recommendation."
    caption = (
        "Dots joined by a line: every tuning that no other beats in both error and motor travel, on the valves and "
        "days of the search; a grey line leads from each to its hollow dot, the same tuning held out.  Marks with "
        "bars: the tuning of now, the chosen one and that of the SIMC rule, held out; bars are 95 % intervals for "
        "other valves and days.  Dotted: a limit."
    )
    first_line, *lines = t.summary()
    answer = [first_line, next(line for line in lines if line.startswith("Held out, ")), t.advice]
    return _result_page(
        "Tuning", "Tuning of " + ", ".join(quantity(name).text for name in t.parameters),
        "Which settings suit all these valves and days, and what do they do on valves and days not searched on?",
        answer, [*([] if t.meets_limits else [limits_warning]), *t.notes],
        page.make_picture(t.plot(), caption, "Error against motor travel of the tunings"), t.evaluations,
        _study_sections("tuning", t.to_toml(), ()),
    )  # fmt: skip


def explanation_page(e: Explanation) -> page.Page:
    """Return the report of an explanation."""
    lines, changed_table = e.text.splitlines(), page.changed_parameters(e.loop.constants, "paper_like", "default")
    loop_facts = [page.facts_table(("Day", e.boundary.describe())), *([changed_table] if changed_table.rows else [])]
    answer = [*lines[: lines.index("")], *filter(None, [e.advice])]
    gains = ", ".join(f"{name} = {page.format_parameter(name, e.loop[name])}" for name in ("kp", "ti"))
    day = "upply air as it is (red), with the recommended cure (blue) if there is one, and the set-point (dashed)."
    caption = f"S{day}" if e.phase is None else (
        "Top: gains that make the loop hunt (shaded), with lines of equal hunting index, the loop as it is (red dot) "
        f"and other tunings (marks).  Bottom: s{day}"
    )  # fmt: skip
    return _result_page(
        "Explanation", f"Will this loop hunt? {gains}",
        "Will it hunt on this day, why, what would cure it, and what does that cost?", answer, list(e.doubts),
        page.make_picture(e.plot(), caption, "Hunting index, gains and the day"), e.cures,
        [page.Section("In full", [page.Code(e.text)]), page.Section("Which loop, on which day", loop_facts)],
    )  # fmt: skip


PAGE_MAKERS: Mapping[type, Callable[[Any], page.Page]] = {
    AirHandler: unit_page, Diagnosis: diagnosis_page, Tuning: tuning_page, Explanation: explanation_page,
}  # fmt: skip


def report(what: Any, path: str | os.PathLike[str] | None = None) -> Path:
    """Write a report: one HTML file that needs no other file, no script and no network.

    Parameters
    ----------
    what
        The folder of a finished study, as `run_study` writes it; or the result of `diagnose`, `inspect`, `tune` or
        `explain`.
    path
        The file to write, NAME.html; for a folder, ``report.html`` in it by default.

    Returns
    -------
    pathlib.Path
        The file.  The same results give the same bytes.

    Raises
    ------
    InputError
        If ``what`` has another type, the study is unfinished, or ``path`` is not possible.
    StorageError, IntegrityError
        If a file cannot be read or written; if results are damaged.  No partial file remains.

    Examples
    --------
    >>> fc.report(fc.explain(fc.Loop(), fc.constant_day(hours=2)), "loop.html").name
    'loop.html'
    """
    result_functions = "fc.diagnose, fc.inspect, fc.tune or fc.explain"
    cure = f"give the folder of a study, or what {result_functions} returned"
    make: Callable[[Any], page.Page] | None
    if isinstance(what, (str, os.PathLike)):
        what, make = require_path("what", what, cure), study_page
        StudyFolder(what).require_manifest()
        path = what / "report.html" if path is None else path
    else:
        make = next((maker for kind, maker in PAGE_MAKERS.items() if isinstance(what, kind)), None)
    if make is None:
        raise InputError(f"what is a {type(what).__name__}: {cure}", "what", "type")
    cure = "give a file NAME.html, such as 'report.html'"
    if path is None:
        raise InputError(f"path is missing: {cure}", "path", "missing")
    target = require_path("path", path, cure)
    page.require_page(target)
    return make(what).write(target)

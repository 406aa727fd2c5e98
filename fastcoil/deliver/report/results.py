"""``report``: one HTML file that a client can open, of a study, a fit, a diagnosis, a tuning or an explanation.

Each says what was asked, the answer, a figure, and all numbers.  That of a study compares every estimate with the plain
PI, every gap with the sound valve, within pairs of scenarios that differ in nothing else.  An interval is by bootstrap
over drawn valves or days, where the study has several; swept values were chosen, so they get a range instead.
"""

import math
import os
import shlex
import tomllib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from fastcoil.base.arguments import require_path
from fastcoil.base.errors import InputError, WrongTypeMessage
from fastcoil.base.text import format_share
from fastcoil.deliver.figures.swept import standard_figures
from fastcoil.deliver.report import page
from fastcoil.design.explain import Explanation
from fastcoil.design.tuning_result import Tuning
from fastcoil.loops.labels import coordinate_quantity, is_parameter, plain_pi_label, quantity, values_quantity
from fastcoil.loops.provenance import content_sha256, provenance
from fastcoil.measured.diagnosis import Diagnosis
from fastcoil.measured.fit import Fit
from fastcoil.measured.part import FITTING, VALIDATION
from fastcoil.model.metric_table import METRICS, STATUS_MEANINGS, STATUS_OK
from fastcoil.study.analysis.compare import mask_off_days
from fastcoil.study.analysis.paired import paired_change, summarise_median
from fastcoil.study.analysis.selected import mask_dataset, reduction_metrics
from fastcoil.study.analysis.summary import cautions, estimate_dim, findings, keep_comparable, recommended_estimate
from fastcoil.study.file.spec import parse_billing
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.results import open_finished

_CHANCE_DIMS = {"sample": "drawn valves", "day": "days", "replicate": "noise realisations"}
"""Dims that are chance, the first of them is what an interval is over."""
_COLUMN_HEADS = {
    "rmse_settled": "settled RMS error [K]",
    "hunts": "share that hunts",
    "motor_travel": "motor travel [strokes]",
    "switch_frequency": "mode switches per 10 min",
}
_TABLE_METRICS = ("rmse", *_COLUMN_HEADS)
_MAX_NAME_ROWS = 40


def comparison_tables(ds: xr.Dataset) -> list[page.Table]:
    """A table for every dimension with labels."""
    ratio, pi = estimate_dim(ds), plain_pi_label(ds)
    ds = mask_off_days(ds[[name for name in (*_TABLE_METRICS, *reduction_metrics(ds), "status") if name in ds]])
    ds = mask_dataset(ds.drop_vars("status"), ds["status"] == STATUS_OK)
    dims = [str(d) for d in ds["rmse"].dims if ds.sizes[d] > 1 and d not in _CHANCE_DIMS and d in ds.coords]
    without_inverse, condition = (ds, "") if ratio is None else (ds.sel({ratio: 0.0}, drop=True), f" with the {pi}")
    tables = []
    for dim in dims:
        labels = ds[dim].values
        zero = int((labels == 0.0).argmax())
        if dim == ratio:
            comparable_ds = keep_comparable(ds)
            chosen = int((labels == recommended_estimate(comparable_ds, dim)).argmax())
            tables.append(_comparison_table(comparable_ds, dim, "", zero, f"the {pi} of the same loop", chosen))
        elif dim == "backlash" and labels[zero] == 0.0:
            tables.append(_comparison_table(without_inverse, dim, condition, zero, "the sound valve"))
        elif labels.dtype.kind in "OUST" and labels.size <= _MAX_NAME_ROWS:
            tables.append(_comparison_table(without_inverse, dim, condition, 0, f"{labels[0]}, the first"))
        elif is_parameter(ds, dim):
            tables.append(_comparison_table(without_inverse, dim, condition))
    return tables


def _comparison_table(
    ds: xr.Dataset,
    dim: str,
    condition: str,
    baseline_row: int | None = None,
    baseline_words: str = "",
    recommended_row: int | None = None,
) -> page.Table:
    """A row for every label, or some, with medians; ``baseline_row``: the baseline, ``baseline_words``; ``recommended_row``: a label to keep."""
    unit = next((unit for unit in _CHANCE_DIMS if ds.sizes.get(unit, 1) > 1), "") if baseline_row is not None else ""
    base, n, has_names = ds.isel({dim: baseline_row or 0}, drop=True), ds.sizes[dim], ds[dim].dtype.kind in "OUST"
    best = ds["rmse"].median([d for d in ds["rmse"].dims if d != dim]).fillna(math.inf)
    keep = [k for k in (baseline_row, recommended_row, int(best.values.argmin())) if k is not None]
    row_numbers = page.select_rows(n, tuple(keep), _MAX_NAME_ROWS if has_names else page.MOST_ROWS)
    rows = []
    for k in row_numbers:
        scenarios, label = ds.isel({dim: k}, drop=True), ds[dim].values[k]
        cells = [str(label) if isinstance(label, str) else coordinate_quantity(ds, dim).number(float(label))]
        cells.append(page.format_significant(float(scenarios["rmse"].median())))
        if baseline_row is None:
            cells.append(
                " to ".join(page.format_significant(float(scenarios["rmse"].quantile(q))) for q in (0.05, 0.95))
            )
        elif k == baseline_row:
            cells += ["baseline", *[""] * (2 + bool(unit))]
        else:
            middle = summarise_median(paired_change(scenarios["rmse"], base["rmse"]).rename("rmse"), unit)
            pair = scenarios["rmse"].notnull() & base["rmse"].notnull()
            is_lower = (scenarios["rmse"] < base["rmse"]) + 0.5 * (scenarios["rmse"] == base["rmse"])
            cells += [
                page.format_change(middle.median),
                *([page.format_change_range(middle.low, middle.high)] if unit else []),
            ]
            cells += [
                page.format_change_range(middle.q05, middle.q95),
                format_share(float(is_lower.where(pair).mean())),
            ]
        for name in (name for name in scenarios.data_vars if name != "rmse"):
            values = scenarios[name]
            typical = values_quantity(values).factor * float(values.median())
            cells.append(format_share(float(values.mean())) if name == "hunts" else page.format_significant(typical))
        rows.append(cells)
    dim_text = coordinate_quantity(ds, dim).text
    other_heads = [
        _COLUMN_HEADS.get(str(name)) or values_quantity(ds[name]).axis for name in ds.data_vars if name != "rmse"
    ]
    omitted = page.omission_note(n, len(rows), "names" if has_names else "values")
    spread = ["change", *(["95 % interval"] if unit else []), "5 to 95 % of pairs", "lower in"]
    head = [dim_text, "RMS error [K]", *(["5 to 95 % of scenarios"] if baseline_row is None else spread), *other_heads]
    if baseline_row is None:
        return page.Table(
            f"Along {dim_text}", head, rows, f"Medians{condition} over everything else.  {omitted}".strip()
        )
    note = (
        f"RMS error: median{condition}.  Change: median within pairs that differ in nothing else.  "
        f"{f'95 % interval: of the median change, over {ds.sizes[unit]} {_CHANCE_DIMS[unit]}.  ' if unit else ''}"
        f"5 to 95 % of pairs: how much the change differs from loop to loop.  Lower in: share of pairs with less "
        f"error, ties half.  {omitted}"
    ).strip()
    return page.Table(f"{dim_text.capitalize()}: against {baseline_words}", head, rows, note)


def metrics_table(ds: xr.Dataset) -> page.Table:
    """Every metric of a single scenario that is known, with its unit."""
    rows = []
    for name, output in METRICS.items():
        if name in ds and name != "hunts" and not output.flags and bool(ds[name].notnull().any()):
            value, axis_quantity = float(ds[name].max()), quantity(name)
            is_count = name in ("reversals", "half_periods")
            text = (
                f"{value:.0f}"
                if is_count
                else f"{page.format_significant(value * axis_quantity.factor)} {axis_quantity.unit}"
            )
            rows.append([output.long_name, text.rstrip(), name])
    for name in reduction_metrics(ds):
        axis_quantity = values_quantity(ds[name])
        rows.append(
            [
                axis_quantity.text,
                f"{page.format_significant(float(ds[name].max()))} {axis_quantity.unit}".rstrip(),
                name,
            ]
        )
    return page.Table("Every metric", ["metric", "value", "name in results.nc"], rows)


def study_page(folder: Path) -> page.Page:
    """The report of the finished study in a folder; raises as ``open_finished``."""
    ds = open_finished(folder)
    tariff, warnings = tomllib.loads(ds.attrs["study_toml"]).get("tariff"), []
    counts = Counter(ds["status"].values[ds["status"].values != STATUS_OK].tolist())
    n_failed = counts.total()
    if n_failed:
        why = ", ".join(f"{n:,} {STATUS_MEANINGS[code]}" for code, n in sorted(counts.items()))
        failed = f"{n_failed:,} of {ds['status'].size:,} scenarios failed ({why})"
        warnings.append(f"{failed}. They are in no number of this page; status in results.nc says which they are.")
    title = str(ds.attrs["title"])
    sections: list[page.Section] = []
    answer = ["Every scenario failed: there is no answer."]
    if n_failed < ds["status"].size:
        warnings += cautions(ds)
        answer = findings(ds, None if tariff is None else parse_billing(tariff, None))
        numbers = [metrics_table(ds)] if ds["status"].size == 1 else comparison_tables(ds)
        sections += [page.Section("Figures", _pictures(ds, title)), page.Section("In numbers", numbers)]
    file = page.Section("The study file", [page.Code(ds.attrs["study_toml"])])
    sections += [
        page.method_section(ds),
        page.versions_section(ds.attrs),
        file,
        _reproduction_section(folder, ds),
        page.citation_section(ds),
    ]
    question, origin = str(ds.attrs.get("summary", "")).strip(), str(ds.attrs["content_sha256"])
    return page.Page("Study", title, question, warnings, answer, sections, origin)


def _pictures(ds: xr.Dataset, title: str) -> list[page.Block]:
    """The standard figures; their heads, the title and what the marks mean, become captions."""
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
    return page.Section("Do it again", [page.Words([instruction]), page.Code("\n".join(lines))])


def _result_page(
    label: str, title: str, question: str, answer: Sequence[str], warnings: Sequence[str], picture: page.Picture,
    hashed_data: xr.Dataset, extra_sections: Sequence[page.Section],
) -> page.Page:  # fmt: skip
    """The page of a single result.  found: what its hash is of.  more: the sections behind the figure."""
    provenance_here = {name: value for name, value in provenance().items() if name != "date_created"}
    sections = [
        page.Section("In one figure", [picture]),
        *extra_sections,
        page.versions_section(provenance_here),
        page.citation_section(),
    ]
    return page.Page(label, title, question, warnings, answer, sections, content_sha256(hashed_data))


def _study_sections(name: str, toml: str, notes: Sequence[str]) -> list[page.Section]:
    """All numbers, as a study takes them, behind what to mind."""
    instruction = f'Save this as {name}.toml; in a study file, [loop] include = ["{name}.toml"] takes it.'
    return [
        page.Section("What to mind", [page.Words(notes, bullets=True)] if notes else []),
        page.Section("All numbers, for a study", [page.Words([instruction]), page.Code(toml)]),
    ]


_QUESTIONS = {
    "valve": "Which backlash and which flow curve does this valve have?",
    "coil": "Which heat transfer and which heat capacity does this coil have?",
    "loop": "Which backlash does this valve have, seen from the supply air temperature?",
}
_FIT_CAPTION = (
    "Measured (broad line) and (dashed) as the fitted model gives it, over their difference; on the left the part that "
    "was fitted, on the right the part held back.  Grey: not compared."
)


def fit_page(fit: Fit) -> page.Page:
    """The report of a fit."""
    known_together = [line for line in fit.summary() if " are identified only in combination " in line]
    warnings = [f"{name}: {why}" for name, why in fit.held.items() if why != "given"]
    return _result_page(
        "Fit", f"{fit.kind.capitalize()} fitted to {fit.source}", _QUESTIONS[fit.kind], _fit_answer(fit), warnings,
        page.make_picture(fit.plot(), _FIT_CAPTION, f"Measured and modelled {fit.kind}"), fit.residuals,
        _study_sections(fit.kind, fit.to_toml(), [*known_together, *fit.notes]),
    )  # fmt: skip


def _fit_answer(fit: Fit) -> list[str]:
    """The size of the gap, and the error of the model where it was fitted, where it was not, and without the gap."""
    rmse, unit, lines = fit.rmse, fit.unit, []
    fitting = page.format_significant(rmse[FITTING])
    if "backlash" in fit.intervals:
        gap, low, high = (
            page.format_significant(100 * v) for v in (fit.parameters["backlash"], *fit.intervals["backlash"])
        )
        lines.append(f"The gap is {gap} % of the stroke (95 %: {low} to {high} %).")
    elif fit.kind != "coil" and "backlash" not in fit.parameters:
        why = fit.held.get("backlash", "see what to mind")
        lines.append(f"The log does not identify the size of the gap: {why}.")
    if VALIDATION not in rmse:
        return [*lines, f"The RMS error of the model is {fitting} {unit}.  Nothing was held back to check it."]
    rmse_without_gap, validation = rmse.get(f"{VALIDATION}_without_backlash"), page.format_significant(rmse[VALIDATION])
    without = (
        ""
        if rmse_without_gap is None
        else f"; without a gap it would be {page.format_significant(rmse_without_gap)} {unit}"
    )
    sentence = f"On the part of the log held back, the RMS error of the model is {validation} {unit}{without}."
    return [*lines, f"{sentence}  On the part that it was fitted to, it is {fitting} {unit}."]


_DIAGNOSIS_CAPTION = (
    "From the top: what each hour was like; supply air (line) and its set-point (dashed) in the two hours in which the "
    "motor moves most; the command of the controller; the probability of each size of the gap (bars) with its 95 % "
    "interval (grey band), grey bars where the log does not identify it; what the loop fitted to this log would do "
    "with another valve, gain or controller, present value = 100 %."
)
_TUNING_CAPTION = (
    "Dots joined by a line: every tuning that no other beats in both error and motor travel, on the valves and days of "
    "the search; a grey line leads from each to its hollow dot, the same tuning held out.  Marks with bars: the tuning "
    "of now, the chosen one and that of the SIMC rule, held out; bars are 95 % intervals for other valves and days.  "
    "Dotted: a limit."
)
_DAY_CAPTION = "upply air as it is (red), with the recommended cure (blue) if there is one, and the set-point (dashed)."
_EXPLANATION_CAPTION = (
    "Top: gains that make the loop hunt (shaded), with lines of equal hunting index, the loop as it is (red dot) and other "
    f"tunings (marks).  Bottom: s{_DAY_CAPTION}"
)


def diagnosis_page(d: Diagnosis) -> page.Page:
    """The report of a diagnosis."""
    warnings = [] if d.identified else [f"The log does not identify the size of the gap: {d.reason}"]
    answer = [line for line in d.summary() if not line.startswith("Note: ")]
    return _result_page(
        "Diagnosis", f"Is it the valve? {d.source}",
        "How large is the gap of this valve, does its loop hunt, and is the valve to blame?", answer, warnings,
        page.make_picture(d.plot(), _DIAGNOSIS_CAPTION, "Signals, probability of each gap, predictions"), d.signals,
        _study_sections("diagnosis", d.to_toml(), d.notes),
    )  # fmt: skip


def tuning_page(t: Tuning) -> page.Page:
    """The report of a tuning."""
    limits_warning = "No tuning keeps every limit: the one shown breaks them least, and is not a recommendation."
    first, *lines = t.summary()
    answer = [first, next(line for line in lines if line.startswith("Held out, ")), t.advice]
    return _result_page(
        "Tuning", "Tuning of " + ", ".join(quantity(name).text for name in t.parameters),
        "Which settings suit all these valves and days, and what do they do on valves and days not searched on?",
        answer, [*([] if t.meets_limits else [limits_warning]), *t.notes],
        page.make_picture(t.plot(), _TUNING_CAPTION, "Error against motor travel of the tunings"), t.evaluations,
        _study_sections("tuning", t.to_toml(), ()),
    )  # fmt: skip


def explanation_page(e: Explanation) -> page.Page:
    """The report of an explanation."""
    lines, parameter_table = e.text.splitlines(), page.changed_parameters(e.loop.constants, "paper_like", "default")
    loop_facts = [
        page.facts_table(("Day", e.boundary.describe())),
        *([parameter_table] if parameter_table.rows else []),
    ]
    answer = [*lines[: lines.index("")], *filter(None, [e.advice])]
    return _result_page(
        "Explanation",
        "Will this loop hunt? " + ", ".join(f"{name} = {page.format_parameter(name, e.loop[name])}" for name in ("kp", "ti")),
        "Will it hunt on this day, why, what would cure it, and what does that cost?", answer, list(e.doubts),
        page.make_picture(e.plot(), f"S{_DAY_CAPTION}" if e.phase is None else _EXPLANATION_CAPTION, "Hunting index, gains and the day"), e.cures,
        [page.Section("In full", [page.Code(e.text)]), page.Section("Which loop, on which day", loop_facts)],
    )  # fmt: skip


PAGE_MAKERS: Mapping[type, Callable[[Any], page.Page]] = {
    Fit: fit_page, Diagnosis: diagnosis_page, Tuning: tuning_page, Explanation: explanation_page,
}  # fmt: skip


REPORT_NAME = "report.html"  # name of the page in a folder
_WHAT_CURE = (
    "give the folder of a study, or what fc.diagnose, fc.fit_valve, fc.fit_coil, fc.fit_loop, fc.tune or fc.explain "
    "returned"
)
_PATH_CURE = "give a file NAME.html, such as 'report.html'"


def report(what: Any, path: str | os.PathLike[str] | None = None) -> Path:
    """Write a report: one HTML file that needs no other file, no script and no network.

    Parameters
    ----------
    what
        The folder of a finished study, as `run_study` writes it; or the result of `diagnose`, `fit_valve`, `fit_coil`,
        `fit_loop`, `tune` or `explain`.
    path
        The file to write, NAME.html.  For a folder ``report.html`` in it by default.

    Returns
    -------
    pathlib.Path
        The file.  The same results give the same bytes.

    Raises
    ------
    InputError
        If ``what`` is nothing of the kind, the study is unfinished, or ``path`` cannot be written.
    StorageError, IntegrityError
        If a file cannot be read or written; if results are damaged.  Nothing half-written is left behind.
    """
    make: Callable[[Any], page.Page] | None
    if isinstance(what, (str, os.PathLike)):
        what, make = require_path("what", what, _WHAT_CURE), study_page
        StudyFolder(what).require_manifest()
        path = what / REPORT_NAME if path is None else path
    else:
        make = next((maker for kind, maker in PAGE_MAKERS.items() if isinstance(what, kind)), None)
    if make is None:
        raise InputError(WrongTypeMessage(f"what is a {type(what).__name__}: {_WHAT_CURE}"))
    if path is None:
        raise InputError(f"path is missing: {_PATH_CURE}")
    target = require_path("path", path, _PATH_CURE)
    page.require_page(target)
    return make(what).write(target)

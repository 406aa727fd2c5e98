"""``report``: one HTML file that a client can open, of a study, a fit, a diagnosis, a tuning or an explanation.

Those of single results are here; each says what was asked, the answer, a figure, tables, how it was computed, and what
a study takes of it.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import path_of
from fastcoil.base.errors import InputError, WrongType
from fastcoil.base.text import NONE
from fastcoil.deliver.report.page import (
    Block,
    Code,
    Page,
    Picture,
    Section,
    Table,
    Words,
    changed,
    cited,
    facts,
    here,
    number,
    picture,
    require_page,
    setting,
)
from fastcoil.deliver.report.study import study_page
from fastcoil.design.explain import Explanation
from fastcoil.design.tuning_result import Tuning, table_rows
from fastcoil.loops.labels import quantity, unit_in_words
from fastcoil.loops.provenance import content_sha256
from fastcoil.measured.cause import WORDS
from fastcoil.measured.diagnosis import Diagnosis
from fastcoil.measured.fit import Fit
from fastcoil.measured.part import FITTING, VALIDATION
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.folder.folder import StudyFolder


def _sections(
    drawn: Picture,
    tables: Sequence[Section],
    notes: Sequence[str],
    computed: Sequence[Block],
    study: Sequence[str] = (),
) -> list[Section]:
    """All below the answer.  study: what a study takes of the result, in words and as TOML."""
    own = 'Save this as {0}.toml; in a study file, [loop] include = ["{0}.toml"] takes {1}.'
    return [
        Section("In one figure", [drawn]),
        *tables,
        Section("What to mind", [Words(notes, bullets=True)] if notes else []),
        Section("How it was computed", computed),
        Section("For a study", [Words([own.format(*study)]), Code(study[-1])] if study else []),
        here(),
        cited(),
    ]


# --- a fit ------------------------------------------------------------------------------------------------------------

_QUESTIONS = {
    "valve": "Which backlash and which flow curve does this valve have?",
    "coil": "Which heat transfer and which heat capacity does this coil have?",
    "loop": "Which backlash does this valve have, seen from the supply air temperature?",
}
_CAPTION = (
    "Measured (broad line) and (dashed) as the fitted model gives it, over their difference; on the left the part that "
    "was fitted, on the right the part held back.  Grey: not compared."
)


def fit_page(fit: Fit) -> Page:
    """The report of a fit."""
    kind = fit.kind
    known_together = [line for line in fit.summary() if " are known only together " in line]
    method = "least squares of the model behind the logged inputs; intervals allow for correlated errors"
    if kind == "loop":
        method = "the emulator behind the logged command, with each size of the gap"
    log = f"{fit.source}: {fit.n_used:,} samples compared, worth {fit.n_effective:,.0f} independent ones"
    command = f"fastcoil fit {kind} LOG.csv{' --loop PRESET' * (kind == 'loop')} -o {kind}.toml --report {kind}.html"
    errors = [[name.replace("_", " "), f"{number(value, 4)} {fit.unit}"] for name, value in fit.rmse.items()]
    note = "Fit: the part that the parameters were fitted to.  Validation: a part that they never saw."
    numbers = [_fitted_parameters(fit), Table("Error of the model, RMS", ["part of the log", "error"], errors, note)]
    sections = _sections(
        picture(fit.plot(), _CAPTION, f"Measured and modelled {kind}"), [Section("In numbers", numbers)],
        [*known_together, *fit.notes], [facts(("Log", log), ("Method", method)), Code(command)],
        (kind, "it", fit.to_toml()),
    )  # fmt: skip
    warnings = [f"{name}: {why}" for name, why in fit.held.items() if why != "given"]
    title = f"{kind.capitalize()} fitted to {fit.source}"
    return Page("Fit", title, _QUESTIONS[kind], warnings, _answer_of(fit), sections, content_sha256(fit.residuals))


def _answer_of(fit: Fit) -> list[str]:
    """The size of the gap, and the error of the model where it was fitted, where it was not, and without the gap."""
    rmse, unit, lines = fit.rmse, fit.unit, []
    if "backlash" in fit.intervals:
        gap, low, high = (number(100 * v) for v in (fit.parameters["backlash"], *fit.intervals["backlash"]))
        lines.append(f"The gap is {gap} % of the stroke (95 %: {low} to {high} %).")
    elif fit.kind != "coil" and "backlash" not in fit.parameters:
        why = fit.held.get("backlash", "see what to mind")
        lines.append(f"The log does not identify the size of the gap: {why}.")
    if VALIDATION not in rmse:
        return [*lines, f"The model errs by {number(rmse[FITTING])} {unit} (RMS).  Nothing was held back to check it."]
    plain = rmse.get(f"{VALIDATION}_without_backlash")
    without = "" if plain is None else f"; without a gap it would be {number(plain)} {unit}"
    lines.append(
        f"On the part of the log that it never saw, the model errs by {number(rmse[VALIDATION])} {unit} (RMS){without}."
        f"  On the part that it was fitted to, by {number(rmse[FITTING])} {unit}."
    )
    return lines


def _fitted_parameters(fit: Fit) -> Table:
    rows = []
    for name, value in fit.parameters.items():
        of = quantity(name)
        cells = [NONE, fit.held.get(name, "")]
        if name in fit.intervals:
            low, high = (f"{number(bound * of.factor, 4)}" for bound in fit.intervals[name])
            cells = [number(fit.standard_errors[name] * of.factor, 2), f"{low} to {high}"]
        value_cell = f"{number(value * of.factor, 4)} {of.unit}".rstrip()
        rows.append([name, value_cell, *cells, PARAMETERS[name].text])
    return Table("Parameters", ["name", "value", "standard error", "95 % interval", "meaning"], rows)


# --- a diagnosis ------------------------------------------------------------------------------------------------------

_ONE_PAGE = (
    "From the top: what each hour was like; supply air (line) and its set-point (dashed) in the two hours in which the "
    "motor moves most; the command of the controller; the probability of each size of the gap (bars) with its 95 % "
    "interval (grey band), grey bars where the log does not identify it; what the loop fitted to this log would do "
    "with another valve, gain or controller, as found = 100 %."
)


def diagnosis_page(d: Diagnosis) -> Page:
    """The report of a diagnosis."""
    low, high = d.interval
    gap = f"each size is tried on the log; 95 % interval {100 * low:.3g} to {100 * high:.3g} % of the stroke"
    computed = facts(
        ("Log", f"{d.source}: {d.signals.attrs['hours']:.1f} h, a sample every {d.signals.attrs['interval']:.4g} s"),
        ("Gap", gap if np.isfinite(low) else "no size could be tried"),
        ("Cause", f"{d.cause}: {d.because}" if d.because else d.cause),
        ("Predictions", "valve and coil as a curve behind two lags and a delay, fitted to the log, with the controller "
                        "recovered from the same log"),
    )  # fmt: skip
    sections = _sections(
        picture(d.plot(), _ONE_PAGE, "Signals, probability of each gap, predictions"),
        [Section("What would help", [_predictions(d)]), Section("Indices of the loop", [_indices(d.indices)])],
        d.notes, [computed, Code("fastcoil diagnose LOG.csv -o diagnosis.toml --report diagnosis.html")],
        ("diagnosis", "the gap", d.to_toml()),
    )  # fmt: skip
    warnings = [] if d.identified else [f"The log does not identify the size of the gap: {d.reason}"]
    answer = [line for line in d.summary()[1:] if not line.startswith("Note: ")]
    question = "How large is the gap of this valve, does its loop hunt, and is the valve to blame?"
    title = f"Is it the valve? {d.source}"
    return Page("Diagnosis", title, question, warnings, answer, sections, content_sha256(d.signals))


def _predictions(d: Diagnosis) -> Block:
    if d.predictions is None:
        return Words(["No model of the loop could be fitted to this log, so nothing is predicted: see what to mind."])
    rows = []
    for k, case in enumerate(d.predictions["case"].values):
        one = d.predictions.isel(case=k)
        doubt = str(one["doubt"].values)
        cells = [f"{number(float(one['rmse']))} K", number(float(one["travel_per_day"])),
                 number(float(one["reversals_per_day"])), "yes" if float(one["hunts"]) > 0 else "no"]  # fmt: skip
        rows.append([WORDS[str(case)], *([NONE] * 4 if doubt else cells), doubt])
    head = ["", "RMS error", "motor, strokes a day", "stem, turns a day", "hunts", "doubt"]
    if not any(row[-1] for row in rows):
        head, rows = head[:-1], [row[:-1] for row in rows]
    note = "What the loop that was fitted to this log does on the day of the log.  A dash: unknown."
    return Table("With another valve, gain or controller", head, rows, note)


def _indices(ds: xr.Dataset) -> Table:
    rows = []
    for name, value in ds.data_vars.items():
        unit, size = str(value.attrs.get("units", "1")), float(value)
        if not np.isfinite(size):
            text = NONE
        elif "backlash" in str(name) and unit == "1":
            text = f"{number(100 * size)} %"
        else:
            text = f"{number(size)} {'a day' if unit == 'd-1' else unit_in_words(unit)}".rstrip()
        rows.append([str(value.attrs.get("long_name", quantity(str(name)).text)), text])
    return Table("Single numbers", ["index", "value"], rows, "A dash: this log does not show it.")


# --- a tuning ---------------------------------------------------------------------------------------------------------

_CHOICE = (
    "Dots joined by a line: every tuning that no other beats in both error and motor travel, on the valves and days of "
    "the search; a grey line leads from each to its hollow dot, the same tuning held out.  Marks with bars: the tuning "
    "of now, the chosen one and that of the SIMC rule, held out; bars are 95 % intervals for other valves and days.  "
    "Dotted: a limit."
)


def tuning_page(t: Tuning) -> Page:
    """The report of a tuning."""
    limits = []
    for each in t.limits:
        words = t.held_out[each.measure.name].attrs["long_name"]
        limits.append(f"{words}: {'as now' if each.as_now else each.measure.shown(each.most)}")
    computed = facts(
        ("Sought", f"lowest {next(iter(t.held_out.data_vars.values())).attrs['long_name']}"),
        ("Limits", "; ".join(limits) or "none"),
        ("Tried", f"{t.evaluations.sizes['evaluation']:,} tunings"),
        ("Searched on", str(t.trained.attrs["group"])),
        ("Held out", str(t.held_out.attrs["group"])),
    )
    tables = []
    for title, ds in (("Held out", t.held_out), ("Searched on", t.trained)):
        head, *rows = table_rows(ds, t.limits)
        note = "In brackets: 95 % interval over valves and days, by bootstrap."
        tables.append(Table(f"{title}: {ds.attrs['group']}", ["measure", *head[1:]], rows, note))
    sections = _sections(
        picture(t.plot(), _CHOICE, "Error against motor travel of the tunings"),
        [Section("Now and then", tables)], (),
        [computed, Code("fastcoil tune STUDY.toml -o results/tuning --report tuning.html")],
        ("tuning", "the settings", t.to_toml()),
    )  # fmt: skip
    broken = "No tuning keeps every limit: the one shown breaks them least, and is no recommendation."
    warnings = [*([] if t.meets_limits else [broken]), *t.notes]
    first, *lines = t.summary()
    answer = [first, next(line for line in lines if line.startswith("Held out, ")), t.advice]
    title = "Tuning of " + ", ".join(quantity(name).text for name in t.parameters)
    question = "Which settings suit all these valves and days, and what do they do on valves and days not searched on?"
    return Page("Tuning", title, question, warnings, answer, sections, content_sha256(t.evaluations))


# --- an explanation ---------------------------------------------------------------------------------------------------

_DAY = "upply air as it is (red), with the recommended cure (blue) if there is one, and the set-point (dashed)."
_TWO_PANELS = (
    "Top: which gains hunt (shaded), with lines of equal margin, the loop as it is (red dot) and other tunings "
    f"(marks).  Bottom: s{_DAY}"
)


def explanation_page(e: Explanation) -> Page:
    """The report of an explanation."""
    loop, boundary = e.loop, e.boundary
    computed: list[Block] = [facts(
        ("Day", boundary.describe()),
        ("Predicted by", "the describing function of the gap in a linear model of the loop at each operating point"),
        ("Simulated with", "a time step of 1 s, on this day, with each cure"),
    )]  # fmt: skip
    own = changed(loop.constants, "paper_like", "default")
    computed += [own] * bool(own.rows) + [Code("fastcoil explain TARGET --report explanation.html")]
    sections = _sections(
        picture(e.plot(), f"S{_DAY}" if e.phase is None else _TWO_PANELS, "Margin, gains and the day"),
        [Section("In full", [Code(e.text)])], (), computed,
    )  # fmt: skip
    title = "Will this loop hunt? " + ", ".join(f"{name} = {setting(name, loop[name])}" for name in ("kp", "ti"))
    question = "Will it hunt on this day, why, what would cure it, and what does that cost?"
    lines = e.text.splitlines()
    answer = [*lines[: lines.index("")], *filter(None, [e.advice])]
    return Page("Explanation", title, question, list(e.doubts), answer, sections, content_sha256(e.cures))


PAGES: Mapping[type, Callable[[Any], Page]] = {
    Fit: fit_page, Diagnosis: diagnosis_page, Tuning: tuning_page, Explanation: explanation_page,
}  # fmt: skip


REPORT = "report.html"
"""Name of the page in a folder."""
_CURE = (
    "give the folder of a study, or what fc.diagnose, fc.fit_valve, fc.fit_coil, fc.fit_loop, fc.tune or fc.explain "
    "returned"
)
_FILE = "give a file NAME.html, such as 'report.html'"


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
    make: Callable[[Any], Page] | None
    if isinstance(what, (str, os.PathLike)):
        what, make = path_of("what", what, _CURE), study_page
        StudyFolder(what).require_manifest()
        path = what / REPORT if path is None else path
    else:
        make = next((page for kind, page in PAGES.items() if isinstance(what, kind)), None)
    if make is None:
        raise InputError(WrongType(f"what is a {type(what).__name__}: {_CURE}"))
    if path is None:
        raise InputError(f"path is missing: {_FILE}")
    where = path_of("path", path, _FILE)
    require_page(where)
    return make(what).write(where)

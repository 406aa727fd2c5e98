"""``report``: one HTML file that a client can open, of a study, a fit, a diagnosis, a tuning or an explanation.

Those of single results are here; each says what was asked, the answer, a figure, and all numbers as TOML.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from fastcoil.base.arguments import path_of
from fastcoil.base.errors import InputError, WrongType
from fastcoil.deliver.report import page
from fastcoil.deliver.report.study import study_page
from fastcoil.design.explain import Explanation
from fastcoil.design.tuning_result import Tuning
from fastcoil.loops.labels import quantity
from fastcoil.loops.provenance import content_sha256, provenance
from fastcoil.measured.diagnosis import Diagnosis
from fastcoil.measured.fit import Fit
from fastcoil.measured.part import FITTING, VALIDATION
from fastcoil.study.folder.folder import StudyFolder


def _page(
    label: str, title: str, question: str, answer: Sequence[str], warnings: Sequence[str], drawn: page.Picture,
    found: xr.Dataset, more: Sequence[page.Section],
) -> page.Page:  # fmt: skip
    """The page of a single result.  found: what its hash is of.  more: the sections behind the figure."""
    made_here = {name: value for name, value in provenance().items() if name != "date_created"}
    sections = [page.Section("In one figure", [drawn]), *more, page.versions(made_here), page.cited()]
    return page.Page(label, title, question, warnings, answer, sections, content_sha256(found))


def _for_a_study(name: str, toml: str, notes: Sequence[str]) -> list[page.Section]:
    """All numbers, as a study takes them, behind what to mind."""
    words = f'Save this as {name}.toml; in a study file, [loop] include = ["{name}.toml"] takes it.'
    return [
        page.Section("What to mind", [page.Words(notes, bullets=True)] if notes else []),
        page.Section("All numbers, for a study", [page.Words([words]), page.Code(toml)]),
    ]


_QUESTIONS = {
    "valve": "Which backlash and which flow curve does this valve have?",
    "coil": "Which heat transfer and which heat capacity does this coil have?",
    "loop": "Which backlash does this valve have, seen from the supply air temperature?",
}
_CAPTION = (
    "Measured (broad line) and (dashed) as the fitted model gives it, over their difference; on the left the part that "
    "was fitted, on the right the part held back.  Grey: not compared."
)


def fit_page(fit: Fit) -> page.Page:
    """The report of a fit."""
    known_together = [line for line in fit.summary() if " are known only together " in line]
    warnings = [f"{name}: {why}" for name, why in fit.held.items() if why != "given"]
    return _page(
        "Fit", f"{fit.kind.capitalize()} fitted to {fit.source}", _QUESTIONS[fit.kind], _answer_of(fit), warnings,
        page.picture(fit.plot(), _CAPTION, f"Measured and modelled {fit.kind}"), fit.residuals,
        _for_a_study(fit.kind, fit.to_toml(), [*known_together, *fit.notes]),
    )  # fmt: skip


def _answer_of(fit: Fit) -> list[str]:
    """The size of the gap, and the error of the model where it was fitted, where it was not, and without the gap."""
    rmse, unit, lines = fit.rmse, fit.unit, []
    fitting = page.number(rmse[FITTING])
    if "backlash" in fit.intervals:
        gap, low, high = (page.number(100 * v) for v in (fit.parameters["backlash"], *fit.intervals["backlash"]))
        lines.append(f"The gap is {gap} % of the stroke (95 %: {low} to {high} %).")
    elif fit.kind != "coil" and "backlash" not in fit.parameters:
        why = fit.held.get("backlash", "see what to mind")
        lines.append(f"The log does not identify the size of the gap: {why}.")
    if VALIDATION not in rmse:
        return [*lines, f"The model errs by {fitting} {unit} (RMS).  Nothing was held back to check it."]
    plain, unseen = rmse.get(f"{VALIDATION}_without_backlash"), page.number(rmse[VALIDATION])
    without = "" if plain is None else f"; without a gap it would be {page.number(plain)} {unit}"
    said = f"On the part of the log that it never saw, the model errs by {unseen} {unit} (RMS){without}."
    return [*lines, f"{said}  On the part that it was fitted to, by {fitting} {unit}."]


_ONE_PAGE = (
    "From the top: what each hour was like; supply air (line) and its set-point (dashed) in the two hours in which the "
    "motor moves most; the command of the controller; the probability of each size of the gap (bars) with its 95 % "
    "interval (grey band), grey bars where the log does not identify it; what the loop fitted to this log would do "
    "with another valve, gain or controller, as found = 100 %."
)
_CHOICE = (
    "Dots joined by a line: every tuning that no other beats in both error and motor travel, on the valves and days of "
    "the search; a grey line leads from each to its hollow dot, the same tuning held out.  Marks with bars: the tuning "
    "of now, the chosen one and that of the SIMC rule, held out; bars are 95 % intervals for other valves and days.  "
    "Dotted: a limit."
)
_DAY = "upply air as it is (red), with the recommended cure (blue) if there is one, and the set-point (dashed)."
_TWO_PANELS = (
    "Top: which gains hunt (shaded), with lines of equal margin, the loop as it is (red dot) and other tunings "
    f"(marks).  Bottom: s{_DAY}"
)


def diagnosis_page(d: Diagnosis) -> page.Page:
    """The report of a diagnosis."""
    warnings = [] if d.identified else [f"The log does not identify the size of the gap: {d.reason}"]
    answer = [line for line in d.summary() if not line.startswith("Note: ")]
    return _page(
        "Diagnosis", f"Is it the valve? {d.source}",
        "How large is the gap of this valve, does its loop hunt, and is the valve to blame?", answer, warnings,
        page.picture(d.plot(), _ONE_PAGE, "Signals, probability of each gap, predictions"), d.signals,
        _for_a_study("diagnosis", d.to_toml(), d.notes),
    )  # fmt: skip


def tuning_page(t: Tuning) -> page.Page:
    """The report of a tuning."""
    broken = "No tuning keeps every limit: the one shown breaks them least, and is no recommendation."
    first, *lines = t.summary()
    answer = [first, next(line for line in lines if line.startswith("Held out, ")), t.advice]
    return _page(
        "Tuning", "Tuning of " + ", ".join(quantity(name).text for name in t.parameters),
        "Which settings suit all these valves and days, and what do they do on valves and days not searched on?",
        answer, [*([] if t.meets_limits else [broken]), *t.notes],
        page.picture(t.plot(), _CHOICE, "Error against motor travel of the tunings"), t.evaluations,
        _for_a_study("tuning", t.to_toml(), ()),
    )  # fmt: skip


def explanation_page(e: Explanation) -> page.Page:
    """The report of an explanation."""
    lines, own = e.text.splitlines(), page.changed(e.loop.constants, "paper_like", "default")
    which = [page.facts(("Day", e.boundary.describe())), *([own] if own.rows else [])]
    answer = [*lines[: lines.index("")], *filter(None, [e.advice])]
    return _page(
        "Explanation",
        "Will this loop hunt? " + ", ".join(f"{name} = {page.setting(name, e.loop[name])}" for name in ("kp", "ti")),
        "Will it hunt on this day, why, what would cure it, and what does that cost?", answer, list(e.doubts),
        page.picture(e.plot(), f"S{_DAY}" if e.phase is None else _TWO_PANELS, "Margin, gains and the day"), e.cures,
        [page.Section("In full", [page.Code(e.text)]), page.Section("Which loop, on which day", which)],
    )  # fmt: skip


PAGES: Mapping[type, Callable[[Any], page.Page]] = {
    Fit: fit_page, Diagnosis: diagnosis_page, Tuning: tuning_page, Explanation: explanation_page,
}  # fmt: skip


REPORT = "report.html"  # name of the page in a folder
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
    make: Callable[[Any], page.Page] | None
    if isinstance(what, (str, os.PathLike)):
        what, make = path_of("what", what, _CURE), study_page
        StudyFolder(what).require_manifest()
        path = what / REPORT if path is None else path
    else:
        make = next((made for kind, made in PAGES.items() if isinstance(what, kind)), None)
    if make is None:
        raise InputError(WrongType(f"what is a {type(what).__name__}: {_CURE}"))
    if path is None:
        raise InputError(f"path is missing: {_FILE}")
    where = path_of("path", path, _FILE)
    page.require_page(where)
    return make(what).write(where)

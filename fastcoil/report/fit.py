"""The report of a fit: a valve, a coil, or the gap of a valve without a flow meter."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fastcoil.calibrate.loop_result import LoopFit
from fastcoil.parameter_table import PARAMETERS
from fastcoil.plots.labels import quantity
from fastcoil.report.computed import here
from fastcoil.report.numbers import NOTHING, number
from fastcoil.report.page import Block, Code, Facts, Page, Section, Table, Words
from fastcoil.report.pictures import picture
from fastcoil.report.study import cited
from fastcoil.simulation.dataset import content_sha256

if TYPE_CHECKING:
    from fastcoil.calibrate.result import Fit

_QUESTIONS = {
    "valve": "Which backlash and which flow curve does this valve have?",
    "coil": "Which heat transfer and which heat capacity does this coil have?",
    "loop": "Which backlash does this valve have, seen from the supply air temperature?",
}
_CAPTIONS = {
    "valve": "Flow over command, measured and as the fitted valve gives it; both over time; and the error that is left "
    "with the backlash held at each size: sizes below the limit are within the 95 % interval.",
    "coil": "Measured and modelled temperatures over time and against each other; the line is where they are equal.",
    "loop": "Measured and modelled supply air; and the error that is left with the backlash held at each size: sizes "
    "below the limit are within the 95 % interval.",
}


def fit_page(fit: Fit) -> Page:
    """The report of a fit."""
    lines = fit.summary()
    notes = [line.removeprefix("Note: ") for line in lines if line.startswith("Note: ")]
    answer = [line for line in lines[1:] if not line.startswith(("Note: ", "RMSE, "))]
    warnings = [f"{name}: {why}" for name, why in fit.held.items() if why != "given"]
    drawn: list[Block] = [picture(fit.plot(), _CAPTIONS[fit.kind], f"Measured and modelled {fit.kind}")]
    include = f'Save this as {fit.kind}.toml; in a study file, [loop] include = ["{fit.kind}.toml"] takes it.'
    sections = [
        Section("Measured and modelled", drawn),
        Section("In numbers", [_parameters(fit), _errors(fit)]),
        Section("What to mind", [Words(notes, bullets=True)] if notes else []),
        _how(fit),
        Section("For a study", [Words([include]), Code(fit.to_toml())]),
        here(),
        cited(),
    ]
    title = f"{fit.kind.capitalize()} fitted to {fit.source}"
    return Page("Fit", title, _QUESTIONS[fit.kind], warnings, answer, sections, content_sha256(fit.residuals))


def _parameters(fit: Fit) -> Table:
    rows = []
    for name, value in fit.parameters.items():
        shown = quantity(name)
        cells = [f"{number(value * shown.factor, 4)} {shown.unit}".rstrip()]
        if name in fit.intervals:
            low, high = (f"{number(bound * shown.factor, 4)}" for bound in fit.intervals[name])
            cells += [number(fit.standard_errors[name] * shown.factor, 2), f"{low} to {high}"]
        else:
            cells += [NOTHING, fit.held[name]]
        rows.append([name, *cells, PARAMETERS[name].text])
    return Table("Parameters", ["name", "value", "standard error", "95 % interval", "meaning"], rows)


def _errors(fit: Fit) -> Table:
    rows = [[name.replace("_", " "), f"{number(value, 4)} {fit.unit}"] for name, value in fit.rmse.items()]
    return Table(
        "Error of the model, RMS", ["part of the log", "error"], rows,
        "Fit: the part that the parameters were fitted to.  Validation: a part that they never saw.",
    )  # fmt: skip


def _how(fit: Fit) -> Section:
    log = f"{fit.source}: {fit.n_used:,} samples compared, worth {fit.n_effective:,.0f} independent ones"
    method = "the emulator behind the logged command, with each size of the gap" if isinstance(fit, LoopFit) else (
        "least squares of the model behind the logged inputs; intervals allow for correlated errors"
    )  # fmt: skip
    others = " --loop PRESET" if fit.kind == "loop" else ""
    command = f"fastcoil fit {fit.kind} LOG.csv{others} -o {fit.kind}.toml --report {fit.kind}.html"
    return Section("How it was computed", [Facts([("Log", log), ("Method", method)]), Code(command)])

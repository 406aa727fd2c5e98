"""The report of a fit: a valve, a coil, or the gap of a valve without a flow meter."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fastcoil.base.text import NONE
from fastcoil.deliver.report.computed import here
from fastcoil.deliver.report.numbers import number
from fastcoil.deliver.report.page import Block, Code, Facts, Page, Section, Table, Words
from fastcoil.deliver.report.pictures import picture
from fastcoil.deliver.report.study import cited
from fastcoil.loops.labels import quantity
from fastcoil.loops.provenance import content_sha256
from fastcoil.measured.fit.loop_result import LoopFit
from fastcoil.measured.fit.split import FITTING, VALIDATION
from fastcoil.model.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from fastcoil.measured.fit.result import Fit

_QUESTIONS = {
    "valve": "Which backlash and which flow curve does this valve have?",
    "coil": "Which heat transfer and which heat capacity does this coil have?",
    "loop": "Which backlash does this valve have, seen from the supply air temperature?",
}
_CAPTIONS = {
    "valve": "Left: modelled over measured flow; on the line they are equal.  Middle: flow over command, dots as "
    "measured, lines as the fitted valve gives it, opening and (dashed) closing.  Right: the error that is left with "
    "the backlash held at each size; sizes below the dotted limit are within the 95 % interval.",
    "coil": "Supply air, leaving water if it was logged, and flows over time, measured and (dashed) as the fitted coil "
    "gives them; on the left the part that was fitted, on the right the part held back.  Grey: not compared.",
    "loop": "Left: supply air, measured (broad line) and as the fitted loop gives it, with the gap (dashed) and "
    "without (dotted), over the command.  Right: the error that is left with the backlash held at each size; shaded: "
    "the 95 % interval.  Grey: not compared.",
}


def fit_page(fit: Fit) -> Page:
    """The report of a fit."""
    lines = fit.summary()
    answer = [*_size(fit), *_held_back(fit)]
    together = [line for line in lines if " are known only together " in line]
    minded = [*together, *fit.notes]
    warnings = [f"{name}: {why}" for name, why in fit.held.items() if why != "given"]
    drawn: list[Block] = [picture(fit.plot(), _CAPTIONS[fit.kind], f"Measured and modelled {fit.kind}")]
    include = f'Save this as {fit.kind}.toml; in a study file, [loop] include = ["{fit.kind}.toml"] takes it.'
    sections = [
        Section("Measured and modelled", drawn),
        Section("In numbers", [_parameters(fit), _errors(fit)]),
        Section("What to mind", [Words(minded, bullets=True)] if minded else []),
        _how(fit),
        Section("For a study", [Words([include]), Code(fit.to_toml())]),
        here(),
        cited(),
    ]
    title = f"{fit.kind.capitalize()} fitted to {fit.source}"
    return Page("Fit", title, _QUESTIONS[fit.kind], warnings, answer, sections, content_sha256(fit.residuals))


def _size(fit: Fit) -> list[str]:
    """The size of the gap, which a coil has not."""
    if fit.kind == "coil":
        return []
    if "backlash" not in fit.parameters:
        return [f"The log does not tell the size of the gap: {fit.held.get('backlash', 'see what to mind')}."]
    low, high = (f"{number(100 * bound)}" for bound in fit.intervals["backlash"])
    return [f"The gap is {number(100 * fit.parameters['backlash'])} % of the stroke (95 %: {low} to {high} %)."]


def _held_back(fit: Fit) -> list[str]:
    """How far the model errs where it was fitted, where it was not, and without the gap."""
    rmse, unit = fit.rmse, fit.unit
    if VALIDATION not in rmse:
        return [f"The model errs by {number(rmse[FITTING])} {unit} (RMS).  Nothing was held back to check it."]
    plain = rmse.get(f"{VALIDATION}_without_backlash")
    without = "" if plain is None else f"; without a gap it would be {number(plain)} {unit}"
    return [
        f"On the part of the log that it never saw, the model errs by {number(rmse[VALIDATION])} {unit} (RMS){without}."
        f"  On the part that it was fitted to, by {number(rmse[FITTING])} {unit}."
    ]


def _parameters(fit: Fit) -> Table:
    rows = []
    for name, value in fit.parameters.items():
        shown = quantity(name)
        cells = [f"{number(value * shown.factor, 4)} {shown.unit}".rstrip()]
        if name in fit.intervals:
            low, high = (f"{number(bound * shown.factor, 4)}" for bound in fit.intervals[name])
            cells += [number(fit.standard_errors[name] * shown.factor, 2), f"{low} to {high}"]
        else:
            cells += [NONE, fit.held[name]]
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

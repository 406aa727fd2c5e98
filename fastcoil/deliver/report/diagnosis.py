"""The report of a diagnosis: whether it is the valve."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fastcoil.base.text import NONE
from fastcoil.deliver.report.computed import here
from fastcoil.deliver.report.numbers import number, share
from fastcoil.deliver.report.page import Block, Code, Facts, Page, Section, Table, Words
from fastcoil.deliver.report.pictures import picture
from fastcoil.deliver.report.study import cited
from fastcoil.loops.labels import quantity, unit_in_words
from fastcoil.loops.provenance import content_sha256
from fastcoil.measured.diagnosis.remedies import WORDS
from fastcoil.measured.diagnosis.words import in_words

if TYPE_CHECKING:
    from fastcoil.measured.diagnosis.result import Diagnosis

_SPOKEN = {"d-1": "a day"}
_CAPTION = (
    "From the top: supply air (line) and its set-point (dashed) in the two hours in which the motor moves most; the "
    "command of the controller; the opening of the valve over the position of its motor as the model has it, where the "
    "dotted lines are the two sides of the gap and the distance between them is its size; the probability of each size "
    "of the gap (bars) with its 95 % interval (grey band), grey bars where the log does not identify it; what the loop "
    "fitted to this log would do with another valve, gain or controller, as found = 100 %; indices of the loop."
)


def diagnosis_page(d: Diagnosis) -> Page:
    """The report of a diagnosis."""
    lines = [line for line in in_words(d)[1:] if not line.startswith("Note: ")]
    warnings = [] if d.identified else [f"The log does not tell the size of the gap: {d.reason}"]
    blocks: list[Block] = [picture(d.plot(), _CAPTION, "Signals, gap, probability, predictions and indices")]
    sections = [Section("The diagnosis on one page", blocks), Section("What would help", _predictions(d))]
    sections += [
        Section("Indices of the loop", [_indices(d.indices)]),
        Section("What to mind", [Words(list(d.notes), bullets=True)] if d.notes else []),
        _how(d),
        Section("For a study", [
            Words(['Save this as diagnosis.toml; in a study file, [loop] include = ["diagnosis.toml"] takes the gap.']),
            Code(d.to_toml()),
        ]),
        here(),
        cited(),
    ]  # fmt: skip
    question = "How large is the gap of this valve, does its loop hunt, and is the valve to blame?"
    return Page(
        "Diagnosis", f"Is it the valve? {d.source}", question, warnings, lines, sections, content_sha256(d.signals)
    )


def _predictions(d: Diagnosis) -> list[Block]:
    if d.predictions is None:
        return [Words(["No model of the loop could be fitted to this log, so nothing is foretold: see what to mind."])]
    found, rows = d.predictions, []
    for k, case in enumerate(found["case"].values):
        one = found.isel(case=k)
        doubt = str(one["doubt"].values)
        cells = [f"{number(float(one['rmse']))} K", number(float(one["travel_per_day"])),
                 number(float(one["reversals_per_day"])), "yes" if float(one["hunts"]) > 0 else "no"]  # fmt: skip
        rows.append([WORDS[str(case)], *([NONE] * 4 if doubt else cells), doubt])
    head = ["", "RMS error", "motor, strokes a day", "stem, turns a day", "hunts", "doubt"]
    if not any(row[-1] for row in rows):
        head, rows = head[:-1], [row[:-1] for row in rows]
    note = "What the loop that was fitted to this log does on the day of the log.  A dash: cannot be told."
    return [Table("With another valve, gain or controller", head, rows, note)]


def _indices(ds: xr.Dataset) -> Table:
    rows = []
    for name, value in ds.data_vars.items():
        unit = str(value.attrs.get("units", "1"))
        shown, size = quantity(str(name)), float(value)
        if not np.isfinite(size):
            text = NONE
        elif "backlash" in str(name) and unit == "1":
            text = share(size) if size >= 0.995 else f"{number(100 * size)} %"
        else:
            text = f"{number(size)} {_SPOKEN.get(unit) or unit_in_words(unit)}".rstrip()
        rows.append([str(value.attrs.get("long_name", shown.text)), text])
    return Table("Single numbers", ["index", "value"], rows, "A dash: it cannot be told from this log.")


def _how(d: Diagnosis) -> Section:
    hours, interval = d.signals.attrs["hours"], d.signals.attrs["interval"]
    low, high = d.interval
    facts = [
        ("Log", f"{d.source}: {hours:.1f} h, a sample every {interval:g} s"),
        ("Gap", f"each size is tried on the log; 95 % interval {100 * low:.3g} to {100 * high:.3g} % of the stroke"
                if np.isfinite(low) else "no size could be tried"),
        ("Cause", f"{d.cause}: {d.because}" if d.because else d.cause),
        ("Predictions", "valve and coil as a curve behind two lags and a delay, fitted to the log, with the controller "
                        "recovered from the same log"),
    ]  # fmt: skip
    command = "fastcoil diagnose LOG.csv -o diagnosis.toml --report diagnosis.html"
    return Section("How it was computed", [Facts(facts), Code(command)])

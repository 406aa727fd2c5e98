"""The result of a diagnosis: backlash, cause, indices, predictions; in words, as TOML, as a figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from fastcoil.base.results import Result, as_toml, in_toml
from fastcoil.measured.diagnosis.findings import Findings
from fastcoil.measured.diagnosis.words import in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Diagnosis(Result, Findings):
    """What a trend log tells of a loop and its valve.

    Attributes
    ----------
    source
        Name of the log.
    backlash, interval
        Most probable backlash and its 95 % interval, fractions of stroke; NaN and everything where the log was not fit
        to compare any.
    identified, reason
        Whether the backlash is right, to 20 % of itself or 1 % of the stroke, with 95 % probability; why not, and what
        to do to find out, else empty.
    cause, because
        Why the loop hunts: ``none`` (it does not), ``backlash`` (without the gap it would not), ``tuning`` (it would
        with a perfect valve, too), ``disturbance`` (something from outside swings), ``unknown``; and a sentence.
    hunts
        Whether the log shows a swing that comes back regularly.
    profile
        Dataset over ``backlash``: the ``probability`` of each size.
    indices
        Dataset of single numbers with units: errors, the swing, Thornhill's regularity, Hägglund's oscillation index
        and backlash, the normalised Harris index, travel and turns of the motor; gain, integral time and sample time of
        the controller, gain of the plant and margin, where the loop could be modelled.
    predictions
        Dataset over ``case`` (``as_found``, ``no_gap``, ``half_gap``, ``half_gain``, ``inverse``): what the fitted loop
        does on this log's day; NaN where that cannot be told, with the ``doubt``.  None where there is no model.
    signals
        Dataset over ``elapsed_time``: the log at equal intervals, as it was used.
    notes
        What was left out of the log, what was assumed, and what could not be computed.
    """

    def summary(self) -> list[str]:
        """The diagnosis in words, line by line."""
        return in_words(self)

    def plot(self) -> Figure:
        """The diagnosis on one page, as a matplotlib ``Figure``."""
        from fastcoil.measured.diagnosis.figure import page

        return page(self)

    def to_toml(self, path: str | Path | None = None) -> str:
        """The backlash as TOML, written to ``path`` if one is given; for ``include`` in the ``[loop]`` of a study file.

        ``[loop]`` has the backlash if it is identified, and nothing else; ``[fit]`` is for readers.
        """
        return as_toml(_toml(self), path)


def _toml(d: Findings) -> list[str]:
    lines = [f"# backlash fitted to {d.source} by fastcoil diagnose"]
    lines += [f"# {line}" for line in in_words(d)[1:]]
    lines += ["", "[loop]"] + ([f"backlash = {d.backlash!r}"] if d.identified else [])
    lines += ["", "[fit]", 'kind = "diagnosis"', f"source = {in_toml(d.source)}"]
    lines += [f"identified = {in_toml(d.identified)}", f"reason = {in_toml(d.reason)}"]
    lines += [f"cause = {in_toml(d.cause)}", f"because = {in_toml(d.because)}"]
    lines += [f"notes = {in_toml(list(d.notes))}"]
    low, high = d.interval
    lines += ["", "[fit.interval_95]", f"backlash = {in_toml([low, high])}"]
    lines += ["", "[fit.indices]"] + [f"{name} = {in_toml(float(value))}" for name, value in d.indices.items()]
    if d.predictions is not None:
        for case in d.predictions["case"].values:
            one = d.predictions.sel(case=case)
            lines += ["", f"[fit.predictions.{case}]", f"doubt = {in_toml(str(one['doubt'].values))}"]
            numbers = one.drop_vars("doubt").data_vars.items()
            lines += [f"{name} = {in_toml(float(value))}" for name, value in numbers]
    return lines


def scalars(values: Mapping[str, tuple[float, str, str]]) -> xr.Dataset:
    """Single numbers by name, with unit and meaning, as a Dataset."""
    return xr.Dataset(
        {name: ((), value, {"units": unit, "long_name": meaning}) for name, (value, unit, meaning) in values.items()}
    )

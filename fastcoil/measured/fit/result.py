"""The result of a fit: parameters, their uncertainty, residuals; in words, as TOML, as a figure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base.files import read_bytes
from fastcoil.base.results import Result, as_toml, in_toml
from fastcoil.measured.fit.split import FITTING, VALIDATION
from fastcoil.model.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fastcoil.base.arrays import Array
    from fastcoil.logs import Log

AT_BOUND = "at the bound of its range: the data do not limit it"
NOT_UNIQUE = "one of many that fit as well: the data do not identify it"
_POOR = 0.8
"""A model of the right thing explains at least this share of the variance."""
_MUCH = 2.0
_ROUND_OFF = 1e-9

_LARGEST = 2**20
"""Bytes of a file that a fit wrote."""


@dataclass(frozen=True, repr=False)
class Fit(Result):
    """A fitted valve or coil.

    Attributes
    ----------
    kind, source
        ``valve`` or ``coil``, and the name of the log.
    parameters
        Name → value, ready for ``loop.assign(**fit.parameters)``; with the held ones, without unidentified ones that
        have no prior.
    standard_errors, intervals
        Standard error and 95 % interval of each estimated parameter; they allow for correlated residuals.
    covariance, correlation
        DataArrays (``parameter``, ``parameter_2``) over the estimated parameters.
    profile
        Dataset over ``backlash``: least RMSE of the fitted part with the backlash held at each value, and the ``limit``
        that the 95 % interval stays below.  None for a coil.
    residuals
        Dataset over ``elapsed_time``: measured and modelled values, their difference, the ``part`` (fit, validation,
        unused), the ``batch`` (unbroken piece), the ``row`` in the file, and the name of the ``log``; seconds
        count from the first row of that log.
    rmse
        By part, in ``unit``; also of the model without backlash (valve) and of the leaving water (coil).
    n_used, n_effective, seconds
        Samples compared; how many independent ones they are worth; duration of the fit [s].
    held
        Name → why the data do not give it, and what is taken instead.
    notes
        What was left out of the log, and remarks on the result.
    """

    kind: str
    source: str
    parameters: dict[str, float]
    standard_errors: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    covariance: xr.DataArray
    profile: xr.Dataset | None
    residuals: xr.Dataset
    rmse: dict[str, float]
    unit: str
    n_used: int
    n_effective: float
    held: dict[str, str]
    notes: list[str]
    seconds: float
    extras: Mapping[str, Array] = field(default_factory=dict, repr=False)

    @property
    def correlation(self) -> xr.DataArray:
        """Correlations of the estimates."""
        s = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return self.covariance / np.outer(s, s)

    def plot(self) -> Figure:
        """Figs 2 (valve) or 4 and 5 (coil) of the paper for this fit, as a matplotlib ``Figure``."""
        from fastcoil.measured.fit.figures import coil_figure, valve_figure

        if self.kind == "coil":
            return coil_figure(self.residuals, self.rmse)
        assert self.profile is not None
        curve, floor = self.extras["curve"], float(self.extras["floor"])
        return valve_figure(self.residuals, self.profile, curve, floor, identified="backlash" in self.parameters)

    def summary(self) -> list[str]:
        """The fit in words, line by line."""
        lines = [
            f"{self.source}: {self.n_used:,} samples compared, worth {self.n_effective:,.0f} independent ones; "
            f"{self.seconds:.1f} s"
        ]
        for name, value in self.parameters.items():
            unit = "" if PARAMETERS[name].unit == "1" else f" {PARAMETERS[name].unit}"
            if name in self.intervals:
                low, high = self.intervals[name]
                error = self.standard_errors[name]
                lines.append(f"{name} = {value:.4g}{unit} ± {error:.2g} (95 %: {low:.4g} to {high:.4g})")
            else:
                lines.append(f"{name} = {value:.4g}{unit}, {self.held[name]}")
        lines += [f"{name}: {why}" for name, why in self.held.items() if name not in self.parameters]
        correlation = self.correlation.values
        for i, j in zip(*np.nonzero(np.triu(np.abs(np.nan_to_num(correlation)) > 0.95, 1)), strict=True):
            names = self.covariance["parameter"].values
            lines.append(
                f"{names[i]} and {names[j]} are known only together (correlation {correlation[i, j]:.3f}): "
                "keep them as a pair"
            )
        for name, value in self.rmse.items():
            part, _, what = name.partition("_")
            what = what if what.startswith("T_") else what.replace("_", " ")
            lines.append(f"RMSE, {part}{', ' if what else ''}{what}: {value:.4g} {self.unit}")
        return lines + [f"Note: {note}" for note in self.notes]

    def to_toml(self, path: str | Path | None = None) -> str:
        """The fit as TOML, written to ``path`` if one is given; for ``include`` in the ``[loop]`` of a study file.

        ``[loop]`` holds the parameters; ``[fit]`` and its tables are for readers.
        """
        lines = [f"# {self.kind} fitted to {self.source} by fastcoil"]
        lines += [f"# {line}" for line in self.summary()[1:]]
        lines += ["", "[loop]"] + [f"{name} = {value!r}" for name, value in self.parameters.items()]
        lines += ["", "[fit]", f"kind = {in_toml(self.kind)}", f"source = {in_toml(self.source)}"]
        lines += [f"samples = {self.n_used}", f"effective_samples = {self.n_effective:.1f}"]
        lines += [f"held = {in_toml([f'{name}: {why}' for name, why in self.held.items()])}"]
        lines += [f"notes = {in_toml(list(self.notes))}", "", f"[fit.rmse]  # {self.unit}"]
        lines += [f"{name} = {in_toml(value)}" for name, value in self.rmse.items()]
        lines += ["", "[fit.standard_error]"]
        lines += [f"{name} = {in_toml(value)}" for name, value in self.standard_errors.items()]
        lines += ["", "[fit.interval_95]"]
        lines += [f"{name} = {in_toml([low, high])}" for name, (low, high) in self.intervals.items()]
        lines += ["", "[fit.correlation]"]
        names = [str(name) for name in self.covariance["parameter"].values]
        for name, row in zip(names, self.correlation.values, strict=True):
            cells = (f"{other} = {value:.4f}" for other, value in zip(names, row, strict=True))
            lines.append(f"{name} = {{ {', '.join(cells)} }}")
        return as_toml(lines, path)


def is_fit(path: Path) -> bool:
    """Whether a file was written by ``to_toml``."""
    try:
        return b" fitted to " in read_bytes(path, _LARGEST).partition(b"\n")[0]
    except (OSError, ValueError):
        return False


def labelled(covariance: Array, names: list[str]) -> xr.DataArray:
    """A covariance matrix with its names."""
    return xr.DataArray(
        covariance, dims=("parameter", "parameter_2"), coords={"parameter": names, "parameter_2": names}
    )


def natural_interval(middle: float, half: float, of_logarithm: bool) -> tuple[float, float]:
    """95 % interval of a parameter that may be searched by its logarithm."""
    low, high = middle - half, middle + half
    return (math.exp(low), math.exp(min(high, 700.0))) if of_logarithm else (low, high)


def sample_variables(data: Log, part: NDArray[np.str_]) -> dict[str, Any]:
    """Part, batch, row and name of the log of every sample."""
    columns = {"part": part, "batch": data.batch, "row": data.rows, "log": np.array(data.names)[data.source]}
    return {name: ("elapsed_time", values) for name, values in columns.items()}


def poor(rmse: Mapping[str, float], fitted: Array, name: str, check: str) -> list[str]:
    """Notes if the model explains little of the fitted data, if nothing validates it, if the validation fails."""
    notes = []
    if VALIDATION not in rmse:
        notes.append("nothing was held back: the fit is not validated")
    elif (ratio := rmse[VALIDATION] / max(rmse[FITTING], _ROUND_OFF * float(np.std(fitted)))) > _MUCH:
        notes.append(f"the validation errs {ratio:.1f} times as much as the fit: do not rely on it in other operation")
    explained = 1.0 - (rmse[FITTING] / float(np.std(fitted))) ** 2
    if explained < _POOR:
        notes.append(
            f"the model explains only {100 * max(explained, 0.0):.0f} % of the variance of {name}: check {check}"
        )
    return notes


def rms(r: Array) -> float:
    """Root mean square; NaN without values."""
    return float(np.sqrt(np.mean(r**2))) if r.size else math.nan

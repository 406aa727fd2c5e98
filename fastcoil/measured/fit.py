"""Result of a fit: parameters, their uncertainty and residuals, as text, TOML and figure."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Mask
from fastcoil.base.figures import BLUE, RED, SHADE_GREY, YELLOW, apply_style
from fastcoil.base.results import Result, toml_document, toml_table
from fastcoil.logs import CheckedLog
from fastcoil.measured.part import PART_FITTED, PART_UNUSED, PART_VALIDATION
from fastcoil.model.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AT_BOUND = "at the bound of its range: the data do not limit it"  # why a parameter has no uncertainty
NOT_UNIQUE = "one of many that fit as well: the data do not identify it"
_SERIES_BY_KIND = {
    "valve": ("m_w", "flow [kg/s]", "", "whether the pump ran"),
    "coil": ("T_sup", "supply air [°C]", "T_sup_", "how the inputs run between samples"),
}
"""By kind of fit: measured series, its label, prefix of the modelled one and the residual, what may be wrong."""


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
        that it stays below in the 95 % interval, if parts of the log do not widen that.  None for a coil.
    residuals
        Dataset over ``elapsed_time``: measured and modelled values, their difference, the ``part`` (fit, validation,
        unused), the ``batch`` (unbroken piece), and the ``row`` in the file; seconds count from the first row.
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
    parameters: dict[str, Any]
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

    @property
    def correlation(self) -> xr.DataArray:
        """Correlation matrix of the estimated parameters."""
        s = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return self.covariance / np.outer(s, s)

    @property
    def backlash(self) -> float:
        """Most probable backlash of a valve, fraction of stroke, identified or not; NaN of a coil."""
        return float("nan") if self.profile is None else float(self.profile.attrs["backlash"])

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the backlash; NaN of a coil."""
        low, high = (float("nan"),) * 2 if self.profile is None else self.profile.attrs["interval_95"]
        return low, high

    @property
    def identified(self) -> bool:
        """Whether the log resolves the backlash."""
        return "backlash" in self.parameters

    @property
    def reason(self) -> str:
        """Why the log does not resolve the backlash; empty if it does."""
        return self.held.get("backlash", "")

    @apply_style()
    def plot(self) -> Figure:
        """Plot measured and fitted values over time, the residual below, a column for each part of the log."""
        from matplotlib.figure import Figure

        measured_name, label, prefix, _ = _SERIES_BY_KIND[self.kind]
        ds, parts = self.residuals, [part for part in (PART_FITTED, PART_VALIDATION) if part in self.rmse]
        fig = Figure(figsize=(5.2 * max(len(parts), 1.4), 4.6), layout="constrained")
        rows = fig.subplots(2, len(parts), squeeze=False, sharex="col", sharey="row", height_ratios=(3, 2))
        for part, (upper, lower) in zip(parts, rows.T, strict=True):
            part_rows = np.flatnonzero(ds["part"].values == part)
            first = int(part_rows[0]) if part == PART_VALIDATION else 0  # the warm-up before a fit is worth a look
            excerpt = ds.isel(elapsed_time=slice(first, int(part_rows[-1]) + 1))
            _plot_over_hours(upper, excerpt, measured_name, color=YELLOW, lw=2.2, label="measured")
            _plot_over_hours(upper, excerpt, f"{prefix}modelled", color=BLUE, lw=1, ls="--", label="fitted")
            _plot_over_hours(lower, excerpt, f"{prefix}residual", color=RED, lw=1)
            upper.set_title(f"{part}: RMSE {self.rmse[part]:.2g} {self.unit}", loc="left")
            upper.legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False)
            lower.set_xlabel("time [h]")
            is_unused = excerpt["part"].values == PART_UNUSED
            is_unused[1:] |= is_unused[:-1]  # up to the next sample
            hours = excerpt["elapsed_time"].values / 3600
            for axes in (upper, lower):
                across = axes.get_xaxis_transform()
                axes.fill_between(hours, 0.0, 1.0, where=is_unused, transform=across, color=SHADE_GREY, lw=0, zorder=0)
        rows[0, 0].set_ylabel(label)
        rows[1, 0].set_ylabel(f"measured - fitted [{self.unit}]")
        if (ds["part"] == PART_UNUSED).any():
            fig.supxlabel("Grey: not compared", fontsize=8)
        return fig

    def summary(self) -> list[str]:
        """The fit as lines of text."""
        sample_count = f"{self.n_used:,} samples compared, equivalent to {self.n_effective:,.0f} independent ones"
        lines = [f"{self.source}: {sample_count}; {self.seconds:.1f} s"]
        for name, value in self.parameters.items():
            if name not in self.intervals and name not in self.held:
                lines.append(f"{name} = {value}" + ", as given" * (name != "curve"))
                continue
            unit = "" if PARAMETERS[name].unit == "1" else f" {PARAMETERS[name].unit}"
            if name in self.intervals:
                low, high = self.intervals[name]
                unit += f" ± {self.standard_errors[name]:.2g} (95 %: {low:.4g} to {high:.4g})"
            else:
                unit += f", {self.held[name]}"
            lines.append(f"{name} = {value:.4g}{unit}")
        lines += [f"{name}: {why}" for name, why in self.held.items() if name not in self.parameters]
        names, correlation = self.covariance["parameter"].values, self.correlation.values
        for i, j in np.argwhere(np.triu(np.abs(np.nan_to_num(correlation)) > 0.95, 1)):
            sentence = f"{names[i]} and {names[j]} are identified only in combination"
            lines.append(f"{sentence} (correlation {correlation[i, j]:.3f}): use them as a pair")
        for name, value in self.rmse.items():
            part, _, quantity = name.partition("_")
            quantity = quantity if quantity.startswith("T_") else quantity.replace("_", " ")
            lines.append(f"RMSE, {part}{', ' if quantity else ''}{quantity}: {value:.4g} {self.unit}")
        return lines + [f"Note: {note}" for note in self.notes]

    def to_toml(self, path: str | Path | None = None) -> str:
        """Return the fit as TOML; write it to ``path`` if given.

        For ``include`` in the ``[loop]`` of a study file: ``[loop]`` holds the parameters; ``[fit]`` and its tables are
        for readers.
        """
        held = [f"{name}: {why}" for name, why in self.held.items()]
        fit_table = {"kind": self.kind, "source": self.source, "samples": self.n_used,
                     "effective_samples": round(self.n_effective, 1), "held": held, "notes": self.notes}  # fmt: skip
        lines = [f"# {self.kind} fitted to {self.source} by fastcoil", *(f"# {line}" for line in self.summary()[1:])]
        lines += toml_table("loop", self.parameters) + toml_table("fit", fit_table)
        lines += toml_table("fit.rmse", self.rmse, self.unit) + toml_table("fit.standard_error", self.standard_errors)
        lines += toml_table("fit.interval_95", self.intervals)
        return toml_document(lines, path)


def build_fit(
    data: CheckedLog, start_time: float, compared: Mask, fitting: Mask, errors: Mapping[str, Array],
    series: Mapping[str, tuple[Array, str]], names: Sequence[str], covariance: Array, held: dict[str, str],
    intervals: Sequence[tuple[float, float]], *, kind: str, notes: list[str], **fields: Any,
) -> Fit:  # fmt: skip
    """Assemble the fit of a log; ``errors`` by their ending in ``rmse``, NaN where they do not count.

    covariance, intervals: of all ``names``; those of the ``held`` ones do not count.
    """
    part_of_sample = np.where(fitting, PART_FITTED, PART_VALIDATION)
    part, rmse = np.where(compared, part_of_sample, PART_UNUSED), {}
    for name in (PART_FITTED, PART_VALIDATION):
        for suffix, error in errors.items():
            is_counted = (part_of_sample == name) & np.isfinite(error)
            if is_counted.any():
                rmse[f"{name}{suffix}"] = float(np.sqrt(np.mean(error[is_counted] ** 2)))
    measured_name, _, _, cause_to_check = _SERIES_BY_KIND[kind]
    fitted_values = series[measured_name][0][compared & fitting]
    free = [k for k, name in enumerate(names) if name not in held]
    free_names, covariance = [names[k] for k in free], covariance[np.ix_(free, free)]
    columns = {"part": part, "batch": data.batch, "row": data.rows}
    residuals: dict[str, Any] = {n: ("elapsed_time", values, {"units": unit}) for n, (values, unit) in series.items()}
    residuals |= {name: ("elapsed_time", values) for name, values in columns.items()}
    return Fit(
        kind=kind, source=data.name, unit="kg/s" if kind == "valve" else "K", rmse=rmse,
        notes=notes + fit_warnings(rmse, fitted_values, measured_name, f"units, columns, and {cause_to_check}"),
        residuals=xr.Dataset(residuals, {"elapsed_time": ("elapsed_time", data.time, {"units": "s"})}),
        standard_errors=dict(zip(free_names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance=xr.DataArray(covariance, [("parameter", free_names), ("parameter_2", free_names)]),
        intervals={names[k]: intervals[k] for k in free}, held=held,
        seconds=time.perf_counter() - start_time, **fields,
    )  # fmt: skip


def natural_intervals(estimates: Array, half_widths: Array, is_logarithmic: Mask) -> list[tuple[float, float]]:
    """Return the 95 % intervals of parameters, of which some were estimated as their logarithm."""
    ends = zip((estimates - half_widths).tolist(), (estimates + half_widths).tolist(), is_logarithmic, strict=True)
    return [(math.exp(low), math.exp(min(high, 700.0))) if is_log else (low, high) for low, high, is_log in ends]


def fit_warnings(rmse: Mapping[str, float], fitted: Array, name: str, check: str) -> list[str]:
    """Return a note on each reason to doubt a fit: little explained, not validated, or the validation failed."""
    notes = []
    if PART_VALIDATION not in rmse:
        notes.append("nothing was held back: the fit is not validated")
    elif (ratio := rmse[PART_VALIDATION] / max(rmse[PART_FITTED], 1e-9 * float(np.std(fitted)))) > 2.0:
        cure = "do not rely on the fit under other operating conditions"
        notes.append(f"the validation error is {ratio:.1f} times the fitting error: {cure}")
    explained_share = max(1.0 - (rmse[PART_FITTED] / float(np.std(fitted))) ** 2, 0.0)
    if explained_share < 0.8:
        notes.append(f"the model explains only {100 * explained_share:.0f} % of the variance of {name}: check {check}")
    return notes


def _plot_over_hours(axes: Axes, ds: xr.Dataset, name: str, **style: Any) -> None:
    """Plot a series with a break at each gap of the record."""
    breaks = np.flatnonzero(np.diff(ds["batch"])) + 1
    hours, values = (np.insert(ds[n].values.astype(float), breaks, np.nan) for n in ("elapsed_time", name))
    axes.plot(hours / 3600, values, **style)

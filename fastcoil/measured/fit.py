"""The result of a fit: parameters, their uncertainty and residuals, with its words, TOML and figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.figures import COLOURS, DOTTED, FAINT, apply_style
from fastcoil.base.files import read_bytes
from fastcoil.base.results import Result, as_toml, in_toml
from fastcoil.measured.part import FITTING, UNUSED, VALIDATION
from fastcoil.model.engine.recorded import valve_flows
from fastcoil.model.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fastcoil.base.arrays import Array
    from fastcoil.logs import Log


_MODEL, _FITTED, _HELD_BACK = COLOURS
_MOST_POINTS = 4000
_LEGEND: Any = {"framealpha": 0.8, "edgecolor": "none"}


class Branches(NamedTuple):
    """Flow over the command from 0 to 1, kg/s, opening and closing."""

    rising: Array
    falling: Array


@apply_style()
def valve_figure(residuals: xr.Dataset, profile: xr.Dataset, curve: Array, floor: float, *, identified: bool) -> Figure:
    """Parity, data over the hysteresis curves, and profile.

    Parameters
    ----------
    residuals, profile
        As in the fit.
    curve, floor
        x_BL, m_max, a, b, c of Eqs (1) and (2), and the lowest reading of the flow meter [kg/s].
    identified
        Whether the data identify the backlash.
    """
    from matplotlib.figure import Figure

    fig = Figure(figsize=(10.5, 3.6), layout="constrained")
    parity, curves, profile_axes = fig.subplots(1, 3)
    looks = ((FITTING, _FITTED, "o"), (VALIDATION, _HELD_BACK, "x"))
    for part, colour, marker in looks:
        here = _thinned(residuals["part"].values == part)
        if here.size:
            style = {"color": colour, "marker": marker, "s": 10, "alpha": 0.6, "lw": 0.8 * (marker == "x")}
            parity.scatter(residuals["m_w"][here], residuals["modelled"][here], label=part, **style)
            curves.scatter(100 * residuals["command"][here], residuals["m_w"][here], label=part, **style)
    top = 1.05 * float(np.nanmax(residuals["m_w"]))
    parity.plot([0, top], [0, top], color="black", lw=0.8)
    parity.set(xlabel="measured flow [kg/s]", ylabel="modelled flow [kg/s]", title="Parity", aspect="equal")
    parity.set(xlim=(0, top), ylim=(0, top))
    branches = _branches(curve, floor)
    command = np.linspace(0.0, 100.0, branches.rising.size)
    curves.plot(command, branches.rising, color=_MODEL, lw=1.5, label="model, opening")
    curves.plot(command, branches.falling, color=_MODEL, lw=1.5, ls="--", label="model, closing")
    curves.set(xlabel="command [%]", ylabel="flow [kg/s]", title="Data over the hysteresis curves")
    curves.set_ylim(0, top)
    for axes in (parity, curves):
        axes.legend(loc="lower right", fontsize=8, **_LEGEND)
    _profile(profile_axes, profile, identified)
    return fig


@apply_style()
def coil_figure(residuals: xr.Dataset, rmse: Mapping[str, float]) -> Figure:
    """Supply air, leaving water and flows over time, a column for each part; ``rmse``: by part, as in the fit."""
    from matplotlib.figure import Figure

    parts = [part for part in (FITTING, VALIDATION) if (residuals["part"] == part).any()]
    fig = Figure(figsize=(5.2 * max(len(parts), 1.4), 5.6), layout="constrained")
    rows = fig.subplots(3, len(parts), squeeze=False, sharex="col", height_ratios=(3, 2, 1.2))
    for column, part in zip(rows.T, parts, strict=True):
        span = np.flatnonzero(residuals["part"].values == part)
        # the warm-up before the fitted part is worth a look
        own = residuals["log"].values == str(residuals["log"][span[0]].values)
        first = int(span[0]) if part == VALIDATION and own[0] else int(np.argmax(own))
        one = residuals.isel(elapsed_time=slice(first, int(span[-1]) + 1))
        _temperature(column[0], one, "T_sup", f"{part}: RMSE {rmse[part]:.2g} K", "supply air [°C]")
        measured = f", RMSE {rmse[part + '_T_w_out']:.2g} K" if part + "_T_w_out" in rmse else ", not measured"
        _temperature(column[1], one, "T_w_out", f"leaving water{measured}", "leaving water [°C]")
        flows: tuple[tuple[str, Any], ...] = (("water", {"color": _MODEL}), ("air", {"color": _HELD_BACK, "ls": "--"}))
        for name, style in flows:
            by_piece(column[2], one, f"m_{name[0]}", lw=1, label=name, **style)
        column[2].set(xlabel="time [h]", ylabel="flow [kg/s]")
        column[2].set_ylim(bottom=0.0)
        _entitled(column[2], "flows")
        for axes in column:
            _shaded(axes, one)
    if (residuals["part"] == UNUSED).any():
        fig.supxlabel("Grey: not compared", fontsize=8)
    return fig


def _branches(curve: Array, floor: float) -> Branches:
    up = np.linspace(0.0, 1.0, 201)
    flows = []
    for command, start in ((up, 1.0), (up[::-1], 0.0)):
        openings, flow = np.empty((up.size, 1)), np.empty((up.size, 1))
        batch = np.zeros(up.size, dtype=np.int64)
        valve_flows(np.ascontiguousarray(command), batch, curve[:, None].copy(), np.full((1, 1), start), openings, flow)
        flows.append(np.maximum(flow[:, 0], floor))
    return Branches(rising=flows[0], falling=flows[1][::-1])


def _profile(axes: Axes, ds: xr.Dataset, identified: bool) -> None:
    axes.plot(100 * ds["backlash"], ds["rmse"], color=_MODEL, marker=".", ms=4)
    axes.axhline(ds.attrs["limit"], color="black", lw=0.8, ls=DOTTED, label="limit of the 95 % interval")
    low, high = ds.attrs["interval_95"]
    axes.axvspan(100 * low, 100 * high, color=_FITTED, alpha=0.3, lw=0, label="95 % interval")
    axes.set(
        xlabel="backlash [%]",
        ylabel="least RMSE of the fitted part [kg/s]",
        title=f"Profile: 95 % interval {100 * low:.3g} to {100 * high:.3g} %"
        if identified
        else "Profile: the backlash is not identified",
    )
    axes.legend(loc="upper center", fontsize=8, **_LEGEND)


def _temperature(axes: Axes, ds: xr.Dataset, name: str, title: str, label: str) -> None:
    if np.isfinite(ds[name]).any():
        by_piece(axes, ds, name, color=_HELD_BACK, lw=2.2, label="measured")
    by_piece(axes, ds, f"{name}_modelled", color=_MODEL, lw=1, ls="--", label="modelled")
    axes.set_ylabel(label)
    _entitled(axes, title)


def _entitled(axes: Axes, title: str) -> None:
    """Title and legend above the axes, so that they hide nothing."""
    axes.set_title(title, loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=8, frameon=False, borderaxespad=0.2)


def by_piece(axes: Axes, ds: xr.Dataset, name: str, scale: float = 1.0, **style: Any) -> None:
    """Plot a series over the hours, with a break wherever the record has one."""
    breaks = np.flatnonzero(np.diff(ds["batch"])) + 1
    hours, values = (np.insert(ds[n].values.astype(float), breaks, np.nan) for n in ("elapsed_time", name))
    axes.plot(hours / 3600, scale * values, **style)


def _shaded(axes: Axes, ds: xr.Dataset) -> None:
    """Samples that are not compared, in grey."""
    hours, unused = ds["elapsed_time"].values / 3600, ds["part"].values == UNUSED
    unused[1:] |= unused[:-1]  # up to the next sample
    bottom_to_top = axes.get_xaxis_transform()
    axes.fill_between(hours, 0.0, 1.0, where=unused, transform=bottom_to_top, color=FAINT, lw=0, zorder=0)


def _thinned(here: Mask) -> Index:
    index = np.flatnonzero(here)
    return index[:: max(index.size // _MOST_POINTS, 1)]


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


def residuals_of(data: Log, part: NDArray[np.str_], series: Mapping[str, tuple[Array, str]]) -> xr.Dataset:
    """The ``residuals`` of a fit: each series with its unit; part, batch, row and name of the log of every sample."""
    columns = {"part": part, "batch": data.batch, "row": data.rows, "log": np.array(data.names)[data.source]}
    return xr.Dataset(
        {name: ("elapsed_time", values, {"units": unit}) for name, (values, unit) in series.items()}
        | {name: ("elapsed_time", values) for name, values in columns.items()},
        {"elapsed_time": ("elapsed_time", data.time, {"units": "s"})},
    )


def rmse_of(part: NDArray[np.str_], errors: Mapping[str, Array]) -> dict[str, float]:
    """RMSE by part of the log, for each of the ``errors``, whose names are endings."""
    found = {}
    for name in (FITTING, VALIDATION):
        for ending, error in errors.items():
            here = (part == name) & np.isfinite(error)
            if here.any():
                found[f"{name}{ending}"] = rms(error[here])
    return found


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

"""Summarise a study: how much was run, cautions, its answer, and costs by a tariff."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.loops.labels import sizes_in_words
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.study.analysis.answer import find_answer
from fastcoil.study.analysis.cost import MONTH_DAYS, Tariff, compute_costs
from fastcoil.study.analysis.paired import summarise_median
from fastcoil.study.analysis.precision import read_precision


def summary(ds: xr.Dataset, billing: Billing | None = None) -> list[str]:
    """Return lines of text: how much was run, how fast, and the answer; with ``billing`` also costs."""
    n, failed = ds["status"].size, int((ds["status"].values != STATUS_OK).sum())
    sizes = sizes_in_words(ds["status"].sizes)
    lines = [str(ds.attrs.get("title", "")), f"{n:,} scenario-days ({sizes})" if sizes else "1 scenario-day"]
    if ds.attrs.get("scenario_days_per_s"):
        backend, n_jobs = ds.attrs.get("engine", "threads"), ds.attrs["n_jobs"]
        workers = ("thread" if backend == "threads" else f"{backend} worker") + ("" if n_jobs == 1 else "s")
        seconds, rate = ds.attrs["wall_time_s"], ds.attrs["scenario_days_per_s"]
        resumed = ", the last of them" if seconds * rate < 0.99 * n else ""  # a run of fewer resumed an earlier one
        lines[-1] += f"{resumed} in {seconds:.1f} s on {n_jobs} {workers}: {rate:,.0f} scenario-days/s"
    if failed:
        lines.append(f"{failed:,} scenarios failed: their status says why, their results are NaN")
    if failed == n:
        return lines
    question = " ".join(str(ds.attrs.get("summary", "")).split())
    lines += [precision.describe_result(ds)] if (precision := read_precision(ds)) else []
    return [*lines, *cautions(ds), *([f"Asked: {question}"] if question else []), *findings(ds, billing)]


def cautions(ds: xr.Dataset) -> list[str]:
    """Warn of days off, set-points not held and frost in results of which not everything failed."""
    lines, size = [], f"{ds['status'].size:,}"
    if "rmse" in ds and (n := int((ds["rmse"].isnull() & (ds["status"] == STATUS_OK)).sum())):
        lines.append(f"In {n:,} of {size} the loop was off all day: they have no RMSE, and count in no median.")
    off = ds["share_off"] > 0.5 if "share_off" in ds else xr.DataArray(False)
    if bool(off.any()):
        hunts = int((off & (ds["hunts"] > 0.0)).sum()) if "hunts" in ds else 0
        lines.append(
            f"{int(off.sum()):,} of {size} are more than 0.5 K off their set-point for over half of the time, "
            f"{hunts:,} of them hunting: no opening may hold it, or the gains do not suit the plant (see fastcoil "
            "explain)."
        )
    # earlier versions have no such metrics
    for name, what in (("frost_time", "Frost forms on the coil"), ("freeze_time", "Water freezes in the coil")):
        seconds = ds[name].values if name in ds else np.zeros(1)
        if n := int((seconds > 0.0).sum()):
            often = f"{n:,} of {size} scenario-days, for up to {np.nanmax(seconds) / 3600.0:.1f} h"
            lines.append(f"{what} in {often}; it is reported, not simulated.")
    return lines


def findings(ds: xr.Dataset, billing: Billing | None = None) -> list[str]:
    """Return the answer of results of which not everything failed, with ``billing`` also costs: a sentence a line."""
    lines = find_answer(ds).summary()
    return lines if billing is None else lines + cost_lines(ds, billing)


# --- costs ------------------------------------------------------------------------------------------------------------

_MAX_COST_LINES = 6  # compared with the baseline, a line each


class Billing(NamedTuple):
    """The prices, and the label of one dim with which the others are compared; empty: the one without backlash."""

    tariff: Tariff
    baseline: Mapping[str, Any]


def cost_lines(ds: xr.Dataset, billing: Billing) -> list[str]:
    """Describe the costs of a result with at least one scenario that did not fail, a sentence a line."""
    costs, currency = compute_costs(ds, billing.tariff), billing.tariff.currency
    days, years = int(costs["n_days"].sum()), costs.attrs["years"]
    scaled = "" if abs(years - 1.0) < 1e-6 else f"; scaled from {days:,} day{'s' * (days != 1)} to a year"
    months = "months of the calendar" if "start" in ds.coords else f"no dates, so {MONTH_DAYS} days are a month"
    lines = [f"Cost by [tariff], of coil, demand, reheat and recooling, without fan and pumps ({months}{scaled})."]
    baseline = dict(billing.baseline) or find_loops_without_backlash(ds)
    if not baseline:
        total = summarise_median(costs["yearly_cost"])
        median, low, high = map(_format_money, (total.median, total.q05, total.q95))
        lines.append(
            f"A loop costs {median} {currency} a year (median; 5 to 95 % of them: {low} to {high}).  Add loops with "
            "backlash = 0 to see what of it the backlash costs."
        )
        return lines
    ((dim, label),) = baseline.items()
    base_costs = costs.sel(baseline, drop=True)
    base = _format_money(float(base_costs["yearly_cost"].median()))
    lines.append(f"A loop with {_format_label(dim, label)} costs {base} {currency} a year (median).")
    labels = [each for each in costs[dim].values if each != label]
    for k in np.unique(np.linspace(0, len(labels) - 1, min(len(labels), _MAX_COST_LINES)).round().astype(int)):
        extra_costs = costs.sel({dim: labels[k]}) - base_costs
        lines.append(_extra_cost_line(extra_costs, _format_label(dim, labels[k]), currency))
    return lines


def _extra_cost_line(extra_costs: xr.Dataset, name: str, currency: str) -> str:
    """Describe what a label costs more a year than the baseline, how far the loops differ, and where it goes."""
    total = summarise_median(extra_costs["yearly_cost"])
    median, low, high, q05, q95 = map(_format_signed_money, total)
    interval = "" if np.isnan(total.low) else f"between {low} and {high}, 95 % sure; "
    costs = {"coil": "coil_cost", "demand": "demand_cost", "reheat": "reheat_cost", "recooling": "recool_cost"}
    means = {word: float(extra_costs[f"yearly_{cost}"].mean()) for word, cost in costs.items()}
    parts = ", ".join(f"{word} {_format_signed_money(mean)}" for word, mean in means.items())
    return (
        f"With {name}: {median} {currency} a year (median of the same loops; {interval}5 to 95 % of them: {q05} to "
        f"{q95}; on average {parts})."
    )


def find_loops_without_backlash(ds: xr.Dataset) -> dict[str, Any]:
    """Return dim and label of the loops without backlash, if each of the others has a partner there."""
    backlash = ds.coords.get("backlash")
    if backlash is None or backlash.ndim != 1:
        return {}
    (dim,) = backlash.dims
    at = np.flatnonzero(backlash.values == 0.0)
    if at.size != 1 or backlash.size == 1 or dim == "sample":
        return {}
    return {str(dim): ds[dim].values[at[0]].item()}


def _format_label(dim: str, label: object) -> str:
    if dim == "backlash" and isinstance(label, float):
        return f"a gap of {100.0 * label:g} %" if label else "no gap"
    return f"{dim} {label}" if isinstance(label, str) else f"{dim} {label:g}"


def _format_signed_money(value: float) -> str:
    return f"{'-' if value < 0.0 else '+'}{_format_money(abs(value))}"


def _format_money(value: float) -> str:
    """Format an amount with three digits, whole from a hundred on."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}" if abs(value) >= 0.005 else "0"

"""The findings of a study in a few lines."""

from __future__ import annotations

from collections.abc import Hashable, Mapping

import numpy as np
import xarray as xr

from fastcoil.model.metric_table import STATUS_OK
from fastcoil.study.analysis.baselines import best_plain_pi, dead_bands, without_dead_band
from fastcoil.study.analysis.cost_summary import Billing, cost_lines
from fastcoil.study.analysis.panels import numeric_dims

_WHOLE = 0.99
"""Of the scenarios: whoever ran fewer had others from an earlier run."""


def summary(ds: xr.Dataset, billing: Billing | None = None) -> list[str]:
    """Return a few lines: how much was run, how fast, and the answer; with ``billing`` what it costs, too."""
    n, failed = ds["status"].size, int((ds["status"].values != STATUS_OK).sum())
    sizes = " × ".join(f"{size} {dim}" for dim, size in ds["status"].sizes.items())
    lines = [str(ds.attrs.get("title", "")), f"{n:,} scenario-days ({sizes})" if sizes else "1 scenario-day"]
    if "wall_time_s" in ds.attrs:
        backend, one = ds.attrs.get("engine", "threads"), ds.attrs["n_jobs"] == 1
        workers = "thread" if backend == "threads" else f"{backend} worker"
        workers += "" if one else "s"
        seconds, rate = ds.attrs["wall_time_s"], ds.attrs["scenario_days_per_s"]
        resumed = ", the last of them" if seconds * rate < _WHOLE * n else ""
        lines[-1] += f"{resumed} in {seconds:.1f} s on {ds.attrs['n_jobs']} {workers}: {rate:,.0f} scenario-days/s"
    if failed:
        lines.append(f"{failed:,} scenarios failed: their status says why, their results are NaN")
    return lines if failed == n else lines + cautions(ds) + findings(ds, billing)


def cautions(ds: xr.Dataset) -> list[str]:
    """What is odd about results of which not everything failed: days off, set-points not held, frost."""
    return _idle(ds) + _off(ds) + _frozen(ds)


def findings(ds: xr.Dataset, billing: Billing | None = None) -> list[str]:
    """The answer of results of which not everything failed, with ``billing`` its costs too: a sentence a line."""
    lines = _foretold(ds)
    costs = [] if billing is None else cost_lines(ds, billing)
    ratio = next((d for d in ("estimate_ratio", "backlash_estimate") if d in numeric_dims(ds["status"])), None)
    if ratio and bool((ds[ratio] == 0.0).any()):
        return lines + _against_plain_pi(ds, ratio) + costs
    return lines + _extremes(ds) + costs


def _idle(ds: xr.Dataset) -> list[str]:
    """Days without a second that counts: they have no metrics of control, and are in no median."""
    if "rmse" not in ds:
        return []
    n = int((ds["rmse"].isnull() & (ds["status"] == STATUS_OK)).sum())
    if not n:
        return []
    return [
        f"In {n:,} of {ds['status'].size:,} the loop was off all day: they have no RMSE, and count in no median of it."
    ]


def _off(ds: xr.Dataset) -> list[str]:
    """Scenarios that hardly ever hold their set-point: nobody would look for them in a mean."""
    if "share_off" not in ds:
        return []
    off = ds["share_off"] > 0.5
    n = int(off.sum())
    if not n:
        return []
    hunts = int((off & (ds["hunts"] > 0.0)).sum()) if "hunts" in ds else 0
    return [
        f"{n:,} of {off.size:,} are more than 0.5 K off their set-point for over half of the time, "
        f"{hunts:,} of them hunting: no opening may hold it, or the gains do not suit the coil (see fastcoil explain)."
    ]


def _foretold(ds: xr.Dataset) -> list[str]:
    """The hunting that theory foretold and the one that was seen."""
    if "predicted_hunts" not in ds:
        return []
    told = ds["predicted_hunts"].notnull() & (ds["status"] == STATUS_OK)
    n = int(told.sum())
    if not n:
        return ["Hunting: theory says nothing about these loops."]
    foretold, seen = (ds[name].where(told) > 0.0 for name in ("predicted_hunts", "hunts"))
    agree = float((foretold == seen).where(told).mean())
    return [
        f"Hunting: foretold for {int(foretold.sum()):,} of {n:,} loops, seen in {int(seen.sum()):,}; "
        f"{_cut(agree)} % agree."
    ]


def _frozen(ds: xr.Dataset) -> list[str]:
    """Days with frost, and with ice, if there are any; results of earlier versions do not tell."""
    lines = []
    for name, what in (("frost_time", "Frost forms on the coil"), ("freeze_time", "Water freezes in the coil")):
        hours = ds[name].values / 3600.0 if name in ds else np.zeros(1)
        n = int((hours > 0.0).sum())
        if n:
            lines.append(
                f"{what} in {n:,} of {hours.size:,} scenario-days, for up to {np.nanmax(hours):.1f} h; "
                "it is reported, not simulated."
            )
    return lines


def _cut(share: float) -> str:
    """Per cent with one decimal; 100 only if nothing is missing."""
    return f"{min(share, 1.0) * 100:.1f}" if share in (0.0, 1.0) else f"{min(share * 100, 99.9):.1f}"


def _against_plain_pi(ds: xr.Dataset, ratio: str) -> list[str]:
    """The inverse against the plain PI of the same loop, estimate by estimate."""
    name = ratio.replace("_", " ")
    ds = ds[["rmse", "rmse_settled", "switch_frequency", "motor_travel"]]
    if "backlash" in ds.coords:
        ds = ds.where(ds["backlash"] > 0.0)
    with_dead_bands, ds = ds, without_dead_band(ds)
    others = [d for d in ds["rmse"].dims if d != ratio]
    plain = ds["rmse"].sel({ratio: 0.0})
    relative = ds["rmse"] / plain
    middle = relative.median(others)
    best = float(middle.idxmin(ratio))
    better = _share(ds["rmse"].sel({ratio: best}) < plain, plain)
    lines = [
        f"Lowest error at {name} {best:g}: RMSE is {_percent(middle.sel({ratio: best}) - 1)} against the plain PI "
        f"(median), and lower in {100 * better:.0f} % of the loops."
    ]
    settled = ds["rmse_settled"].sel({ratio: 0.0})
    if settled.notnull().any():
        change = (ds["rmse_settled"].sel({ratio: best}) / settled).where(settled > 0.0).median()
        lines.append(f"Settled, away from set-point steps: {_percent(change - 1)} (median).")
    switches = ds["switch_frequency"].median(others)
    at_most = switches.where(switches[ratio] <= (1.0 if ratio == "estimate_ratio" else best)).max()
    last = ds[ratio].values[-1]
    lines.append(
        f"Mode switches per 10 min (median): {float(switches.sel({ratio: 0.0})):.1f} with the plain PI, "
        f"at most {float(at_most):.1f} up to {name} {1.0 if ratio == 'estimate_ratio' else best:g}, "
        f"{float(switches.sel({ratio: last})):.1f} at {last:g}."
    )
    travel = (ds["motor_travel"].sel({ratio: best}) / ds["motor_travel"].sel({ratio: 0.0})).median()
    lines.append(f"The motor then travels {float(travel):.1f} times as far as with the plain PI (median).")
    if ratio == "estimate_ratio" and last > 1.0:
        worse = _share(ds["rmse"].sel({ratio: last}) > ds["rmse"].sel({ratio: 1.0}, method="nearest"), plain)
        lines.append(f"Overestimated to {last:g}, the error is larger than at 1 in {100 * worse:.0f} % of the loops.")
    return lines + _against_best_pi(ds, ratio, best) + _against_dead_bands(with_dead_bands, ratio, best)


def _against_best_pi(ds: xr.Dataset, ratio: str, best: float) -> list[str]:
    """The best plain PI of the tunings against the others, and the inverse against it."""
    plain, inverse = ds.sel({ratio: 0.0}, drop=True), ds.sel({ratio: best}, drop=True)
    at = best_plain_pi(plain)
    if at is None:
        return []
    chosen = plain["rmse"].isel(at, drop=True)
    n = int((plain["rmse"].count([d for d in plain["rmse"].dims if d not in at]) > 0).sum())
    alone = _percent((chosen / plain["rmse"]).median() - 1)
    lower = _share(inverse["rmse"] < chosen, plain["rmse"])
    with_it = _percent((inverse["rmse"].isel(at, drop=True) / chosen).median() - 1)
    travel = float((inverse["motor_travel"] / plain["motor_travel"]).isel(at, drop=True).median())
    return [
        f"The best plain PI of {n} tunings ({_label(ds, at)}): RMSE is {alone} than with the plain PI of the same loop "
        f"(median); the inverse is lower than that in {100 * lower:.0f} % of the loops.",
        f"An inverse on top of the best plain PI: RMSE is {with_it} (median), at {travel:.1f} times the motor travel.",
    ]


def _against_dead_bands(ds: xr.Dataset, ratio: str, best: float) -> list[str]:
    """Plain PIs with an error dead band against the same without, and against the inverse without."""
    plain, inverse, lines = ds.sel({ratio: 0.0}, drop=True), ds.sel({ratio: best}, drop=True), []
    for at, partner in dead_bands(plain):
        banded, own = plain.isel(at, drop=True), plain.isel(partner, drop=True)
        error, travel = (float((banded[m] / own[m]).median()) for m in ("rmse", "motor_travel"))
        gain = (inverse["rmse"].isel(partner, drop=True) / banded["rmse"]).median() - 1
        lines.append(
            f"An error dead band of {float(plain['error_dead_band'].isel(at)):g} K ({_label(ds, at)}): RMSE is "
            f"{_percent(error - 1)} than without it, at {travel:.2f} times the motor travel (median); with "
            f"the inverse instead it is {_percent(gain)} than with the dead band."
        )
    return lines


def _label(ds: xr.Dataset, at: Mapping[Hashable, int]) -> str:
    """The labels of one tuning: a name, or the values of what is swept."""
    labels = {d: ds[d].values[k] for d, k in at.items()}
    return ", ".join(str(v) if isinstance(v, str) else f"{d} = {v:g}" for d, v in labels.items())


def _share(holds: xr.DataArray, valid: xr.DataArray) -> float:
    """Share of the valid loops in which the condition holds."""
    return float(holds.where(valid.notnull()).mean())


def _extremes(ds: xr.Dataset) -> list[str]:
    rmse = ds["rmse"]
    flat = rmse.values.ravel()
    lines = [f"RMSE from {np.nanmin(flat):.3g} to {np.nanmax(flat):.3g} K, median {np.nanmedian(flat):.3g} K."]
    for dim in numeric_dims(ds["status"]):
        middle = rmse.median([d for d in rmse.dims if d != dim])
        lines.append(
            f"Along {dim} the median RMSE is lowest at {float(middle.idxmin(dim)):g}: {float(middle.min()):.3g} K."
        )
    return lines


def _percent(change: xr.DataArray | float) -> str:
    value = 100.0 * float(change)
    return f"{abs(value):.0f} % {'lower' if value < 0.0 else 'higher'}"

"""The findings of a study in sentences: the inverse against plain PIs and dead bands, cautions, costs."""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.model.metric_table import STATUS_OK
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.analysis.cost import MONTH, Tariff, costs_of
from fastcoil.study.analysis.paired import Middle, middle_of
from fastcoil.study.analysis.selected import numeric_dims

PLANT = ("coil", "valve", "actuator", "sensor")  # groups of parameters that a controller cannot choose


def tuning_dims(ds: xr.Dataset) -> list[Hashable]:
    """Dims along which gains differ and the plant does not, so that the best of them can be chosen."""
    plant = {d for n in ds.coords if n in PARAMETERS and PARAMETERS[str(n)].group in PLANT for d in ds[n].dims}
    gains = {d for n in ("kp", "ti") if n in ds.coords for d in ds[n].dims}
    return [d for d in ds["rmse"].dims if d in gains - plant and ds.sizes[d] > 1]


def without_dead_band(ds: xr.Dataset) -> xr.Dataset:
    """The scenarios without an error dead band, NaN elsewhere; all of them where none or every one has one."""
    if "error_dead_band" not in ds.coords or not bool((ds["error_dead_band"] == 0.0).any()):
        return ds
    return ds.where(ds["error_dead_band"] == 0.0)


def best_plain_pi(plain: xr.Dataset) -> dict[Hashable, int] | None:
    """The tuning of lowest error; None where there is no choice.

    Lowest is the mean, over all else, of the RMSE relative to the best one of the same plant; days count together.
    """
    dims = tuning_dims(plain)
    if not dims:
        return None
    error = plain["rmse"].mean([d for d in ("day", "replicate") if d in plain["rmse"].dims])
    relative = error / error.min(dims)
    cost = relative.mean([d for d in relative.dims if d not in dims]).fillna(np.inf)
    return {d: int(k) for d, k in cost.argmin(dims).items()}


def dead_bands(plain: xr.Dataset) -> list[tuple[dict[Hashable, int], dict[Hashable, int]]]:
    """Pairs of tunings that differ in nothing but the error dead band: with one, and without.

    Only a dead band that differs along a single dim, as swept or as one of named alternatives, is looked at.
    """
    band = plain.coords.get("error_dead_band")
    if band is None or band.ndim != 1:
        return []
    (dim,) = band.dims
    others = [n for n, c in plain.coords.items() if c.dims == (dim,) and n not in (dim, "error_dead_band")]
    alike = [tuple(plain[n].values[k] for n in others) for k in range(band.size)]
    without = [k for k in range(band.size) if band.values[k] == 0.0]
    return [
        ({dim: k}, {dim: partner})
        for k in range(band.size)
        if band.values[k] > 0.0
        for partner in without
        if alike[partner] == alike[k]
    ]


_MOST_GROUPS, _MOST_LABELS = 4, 6
"""Labels of other dims that get sentences of their own; labels that one sentence compares."""
_GROWN = 1e-4  # fraction of stroke; less is no wear
_WHOLE = 0.99  # of the scenarios: a run of fewer resumed an earlier one


class Billing(NamedTuple):
    """The prices, and the label of one dim with which the others are compared; empty: that without backlash."""

    tariff: Tariff
    baseline: Mapping[str, Any]


def cost_lines(ds: xr.Dataset, billing: Billing) -> list[str]:
    """The sentences on the costs of a result with at least one scenario that did not fail."""
    costs, currency = costs_of(ds, billing.tariff), billing.tariff.currency
    days, years = int(costs["n_days"].sum()), costs.attrs["years"]
    scaled = "" if abs(years - 1.0) < 1e-6 else f"; scaled from {days:,} day{'s' * (days != 1)} to a year"
    months = "months of the calendar" if "start" in ds.coords else f"no dates, so {MONTH} days are a month"
    lines = [f"Cost by [tariff], of coil, demand, reheat and recooling, without fan and pumps ({months}{scaled})."]
    baseline = dict(billing.baseline) or sound(ds)
    if not baseline:
        paid = middle_of(costs["yearly_cost"])
        lines.append(
            f"A loop costs {_money(paid.median)} {currency} a year (median; 5 to 95 % of them: {_money(paid.q05)} to "
            f"{_money(paid.q95)}).  Add loops with backlash = 0 to see what of it the backlash costs."
        )
        return lines + _wear(ds, {})
    # every combination of the words along other dims
    dims = [d for d in costs["status"].dims if d not in baseline and costs[d].dtype.kind in "UO"]
    groups = list(itertools.product(*(costs[d].values for d in dims)))
    for labels in groups if len(groups) <= _MOST_GROUPS else [()]:
        at = dict(zip(dims, labels, strict=False))
        lines += _compared(ds.sel(at), costs.sel(at), baseline, currency, ", ".join(map(str, labels)))
    return lines + _wear(ds, baseline)


def sound(ds: xr.Dataset) -> dict[str, Any]:
    """Dim and label of the loops without backlash, if each of the others has a partner there."""
    backlash = ds.coords.get("backlash")
    if backlash is None or backlash.ndim != 1:
        return {}
    (dim,) = backlash.dims
    at = np.flatnonzero(backlash.values == 0.0)
    if at.size != 1 or backlash.size == 1 or dim == "sample":
        return {}
    return {str(dim): ds[dim].values[at[0]].item()}


def _compared(ds: xr.Dataset, costs: xr.Dataset, baseline: dict[str, Any], currency: str, name: str) -> Iterator[str]:
    """What the other labels cost more than the baseline, and what becomes of valve and temperature."""
    ((dim, label),) = baseline.items()
    others = [each for each in costs[dim].values if each != label]
    spread = {round(k) for k in np.linspace(0, len(others) - 1, _MOST_LABELS)}
    others = [each for k, each in enumerate(others) if len(others) <= _MOST_LABELS or k in spread]
    extra = costs - costs.sel(baseline, drop=True)
    found = {each: middle_of(extra["yearly_cost"].sel({dim: each})) for each in others}
    base = float(costs["yearly_cost"].sel(baseline).median())
    (first, of_first), *rest = ((_called(dim, each), m.median) for each, m in found.items())
    said = "".join(f", {each} {_more(value)}" for each, value in rest)
    first = first if name else first[0].upper() + first[1:]
    yield (
        f"{name + ': ' if name else ''}{first} costs {_more(of_first, currency)} a year than {_called(dim, label)}"
        f"{said} (medians of the same loops; {_called(dim, label)}: {_money(base)} {currency} a year)."
    )
    worst = max(found, key=lambda each: found[each].median)
    yield _detail(extra.sel({dim: worst}), found[worst], _called(dim, worst), currency)
    yield _mechanics(ds, baseline, {dim: worst})


def _detail(extra: xr.Dataset, of: Middle, name: str, currency: str) -> str:
    """Where the money of the dearest label goes, and how it differs between valves."""
    parts = {"coil": "coil_cost", "demand": "demand_cost", "reheat": "reheat_cost", "recooling": "recool_cost"}
    listed = ", ".join(f"{word} {_signed(float(extra[f'yearly_{part}'].mean()))}" for word, part in parts.items())
    sure = "" if np.isnan(of.low) else f"; the median lies between {_signed(of.low)} and {_signed(of.high)}, 95 % sure"
    return (
        f"With {name}, 5 to 95 % of the loops: {_signed(of.q05)} to {_signed(of.q95)} {currency} a year{sure}.  "
        f"On average: {listed}."
    )


def _mechanics(ds: xr.Dataset, baseline: dict[str, Any], other: dict[str, Any]) -> str:
    """Time off the set-point and travel of the motor of one label beside the baseline."""
    good = ds[["share_off", "motor_travel"]].where(ds["status"] == STATUS_OK)
    off, travel = (good[name].mean("day") if "day" in good[name].dims else good[name] for name in good)
    now, before = (100.0 * float(off.sel(at).median()) for at in (other, baseline))
    ratio = float((travel.sel(other) / travel.sel(baseline, drop=True)).median())
    moved = f", and its motor travels {ratio:.1f} times as far" if np.isfinite(ratio) else ""
    off_it = f"{now:.1f} % of the time instead of {before:.1f} %, mean of the days"
    return f"Its air is more than 0.5 K off the set-point {off_it}{moved}."


def _wear(ds: xr.Dataset, baseline: dict[str, Any]) -> list[str]:
    """How far the gaps grew from the first day to the last, where the days are a sequence."""
    if not ds.attrs.get("carry_over") or "backlash_final" not in ds or "day" not in ds["backlash_final"].dims:
        return []
    gap = ds["backlash_final"].where(ds["status"] == STATUS_OK)
    partners = float(gap.sel(baseline).isel(day=-1).median())
    gap = gap.drop_sel(baseline)
    first, last = 100.0 * gap.isel(day=0), 100.0 * gap.isel(day=-1)
    if not bool((last - first > 100.0 * _GROWN).any()):
        return []
    lines = [
        f"From the first day to the last the gap grows from {float(first.median()):.2f} to {float(last.median()):.2f} "
        f"% of stroke (medians); by more than {middle_of(last - first).q95:.2f} % of stroke in 5 % of the loops."
    ]
    if baseline and baseline == sound(ds) and partners > _GROWN:
        lines.append(f"The loops without a gap wear, too: {100.0 * partners:.2f} % in the end (median).")
    return lines


def _called(dim: str, label: object) -> str:
    if dim == "backlash" and isinstance(label, float):
        return f"a gap of {100.0 * label:g} %" if label else "no gap"
    return str(label) if isinstance(label, str) else f"{dim} {label:g}"


def _more(value: float, currency: str = "") -> str:
    return f"{f'{_money(abs(value))} {currency}'.rstrip()} {'less' if value < 0.0 else 'more'}"


def _signed(value: float) -> str:
    return f"{'-' if value < 0.0 else '+'}{_money(abs(value))}"


def _money(value: float) -> str:
    """Three digits, whole from a hundred on."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}" if abs(value) >= 0.005 else "0"


def summary(ds: xr.Dataset, billing: Billing | None = None) -> list[str]:
    """Return a few lines: how much was run, how fast, and the answer; with ``billing`` also what it costs."""
    n, failed = ds["status"].size, int((ds["status"].values != STATUS_OK).sum())
    sizes = " × ".join(f"{size} {dim}" for dim, size in ds["status"].sizes.items())
    lines = [str(ds.attrs.get("title", "")), f"{n:,} scenario-days ({sizes})" if sizes else "1 scenario-day"]
    if "wall_time_s" in ds.attrs:
        backend, n_jobs = ds.attrs.get("engine", "threads"), ds.attrs["n_jobs"]
        workers = ("thread" if backend == "threads" else f"{backend} worker") + ("" if n_jobs == 1 else "s")
        seconds, rate = ds.attrs["wall_time_s"], ds.attrs["scenario_days_per_s"]
        resumed = ", the last of them" if seconds * rate < _WHOLE * n else ""
        lines[-1] += f"{resumed} in {seconds:.1f} s on {n_jobs} {workers}: {rate:,.0f} scenario-days/s"
    if failed:
        lines.append(f"{failed:,} scenarios failed: their status says why, their results are NaN")
    return lines if failed == n else lines + cautions(ds) + findings(ds, billing)


def cautions(ds: xr.Dataset) -> list[str]:
    """What is odd about results of which not everything failed: days off, set-points not held, frost."""
    lines, size = [], f"{ds['status'].size:,}"
    if "rmse" in ds and (n := int((ds["rmse"].isnull() & (ds["status"] == STATUS_OK)).sum())):
        lines.append(f"In {n:,} of {size} the loop was off all day: they have no RMSE, and count in no median of it.")
    off = ds["share_off"] > 0.5 if "share_off" in ds else xr.DataArray(False)
    if bool(off.any()):
        hunts = int((off & (ds["hunts"] > 0.0)).sum()) if "hunts" in ds else 0
        lines.append(
            f"{int(off.sum()):,} of {size} are more than 0.5 K off their set-point for over half of the time, "
            f"{hunts:,} of them hunting: no opening may hold it, or the gains do not suit the coil (see fastcoil "
            "explain)."
        )
    # earlier versions have no such metrics
    for name, what in (("frost_time", "Frost forms on the coil"), ("freeze_time", "Water freezes in the coil")):
        hours = ds[name].values / 3600.0 if name in ds else np.zeros(1)
        if (hours > 0.0).any():
            lines.append(
                f"{what} in {int((hours > 0.0).sum()):,} of {size} scenario-days, for up to {np.nanmax(hours):.1f} h; "
                "it is reported, not simulated."
            )
    return lines


def findings(ds: xr.Dataset, billing: Billing | None = None) -> list[str]:
    """The answer of results of which not everything failed, with ``billing`` also its costs: a sentence a line."""
    lines = _predicted(ds)
    ratio = next((d for d in ("estimate_ratio", "backlash_estimate") if d in numeric_dims(ds["status"])), None)
    lines += _against_plain_pi(ds, ratio) if ratio and bool((ds[ratio] == 0.0).any()) else _extremes(ds)
    return lines if billing is None else lines + cost_lines(ds, billing)


def _predicted(ds: xr.Dataset) -> list[str]:
    """The hunting that theory predicted and that was simulated."""
    if "predicted_hunts" not in ds:
        return []
    known = ds["predicted_hunts"].notnull() & (ds["status"] == STATUS_OK)
    n = int(known.sum())
    if not n:
        return ["Hunting: theory says nothing about these loops."]
    predicted, seen = (ds[name].where(known) > 0.0 for name in ("predicted_hunts", "hunts"))
    agree = 100.0 * float((predicted == seen).where(known).mean())
    cut = agree if agree in (0.0, 100.0) else min(agree, 99.9)  # 100 only if nothing is missing
    return [
        f"Hunting: predicted for {int(predicted.sum()):,} of {n:,} loops, seen in {int(seen.sum()):,}; "
        f"{cut:.1f} % agree."
    ]


def _against_plain_pi(ds: xr.Dataset, ratio: str) -> list[str]:
    """The inverse against the plain PI of the same loop, estimate by estimate."""
    name = ratio.replace("_", " ")
    ds = ds[["rmse", "rmse_settled", "switch_frequency", "motor_travel"]]
    if "backlash" in ds.coords:
        ds = ds.where(ds["backlash"] > 0.0)
    with_dead_bands, ds = ds, without_dead_band(ds)
    others = [d for d in ds["rmse"].dims if d != ratio]
    middle = (ds["rmse"] / ds["rmse"].sel({ratio: 0.0})).median(others)
    best, last = float(middle.idxmin(ratio)), ds[ratio].values[-1]
    plain, inverse = ds.sel({ratio: 0.0}, drop=True), ds.sel({ratio: best}, drop=True)
    better = _share(inverse["rmse"] < plain["rmse"], plain)
    lines = [
        f"Lowest error at {name} {best:g}: RMSE is {_percent(middle.sel({ratio: best}))} against the plain PI "
        f"(median), and lower in {better} of the loops."
    ]
    settled = plain["rmse_settled"]
    if settled.notnull().any():
        change = (inverse["rmse_settled"] / settled).where(settled > 0.0).median()
        lines.append(f"Settled, away from set-point steps: {_percent(change)} (median).")
    switches = ds["switch_frequency"].median(others)
    limit = 1.0 if ratio == "estimate_ratio" else best
    at_most = switches.where(switches[ratio] <= limit).max()
    travel = (inverse["motor_travel"] / plain["motor_travel"]).median()
    lines += [
        f"Mode switches per 10 min (median): {float(switches.sel({ratio: 0.0})):.1f} with the plain PI, "
        f"at most {float(at_most):.1f} up to {name} {limit:g}, {float(switches.sel({ratio: last})):.1f} at {last:g}.",
        f"The motor then travels {float(travel):.1f} times as far as with the plain PI (median).",
    ]
    if ratio == "estimate_ratio" and last > 1.0:
        exact = ds["rmse"].sel({ratio: 1.0}, method="nearest")
        worse = _share(ds["rmse"].sel({ratio: last}) > exact, plain)
        lines.append(f"Overestimated to {last:g}, the error is larger than at 1 in {worse} of the loops.")
    at_zero, at_best = (with_dead_bands.sel({ratio: x}, drop=True) for x in (0.0, best))
    return lines + _against_best_pi(plain, inverse) + list(_against_dead_bands(at_zero, at_best))


def _against_best_pi(plain: xr.Dataset, inverse: xr.Dataset) -> list[str]:
    """The best plain PI of the tunings against the others, and the inverse against it."""
    at = best_plain_pi(plain)
    if at is None:
        return []
    chosen = plain["rmse"].isel(at, drop=True)
    n = int((plain["rmse"].count([d for d in plain["rmse"].dims if d not in at]) > 0).sum())
    lower = _share(inverse["rmse"] < chosen, plain)
    travel = float((inverse["motor_travel"] / plain["motor_travel"]).isel(at, drop=True).median())
    alone = _percent((chosen / plain["rmse"]).median())
    with_it = _percent((inverse["rmse"].isel(at, drop=True) / chosen).median())
    return [
        f"The best plain PI of {n} tunings ({_label(plain, at)}): RMSE is {alone} than with the plain PI of the same "
        f"loop (median); the inverse is lower than that in {lower} of the loops.",
        f"An inverse on top of the best plain PI: RMSE is {with_it} (median), at {travel:.1f} times the motor travel.",
    ]


def _against_dead_bands(plain: xr.Dataset, inverse: xr.Dataset) -> Iterator[str]:
    """Plain PIs with an error dead band against the same without, and against the inverse without."""
    for at, partner in dead_bands(plain):
        banded, own = plain.isel(at, drop=True), plain.isel(partner, drop=True)
        error, travel = ((banded[m] / own[m]).median() for m in ("rmse", "motor_travel"))
        gain = (inverse["rmse"].isel(partner, drop=True) / banded["rmse"]).median()
        yield (
            f"An error dead band of {float(plain['error_dead_band'].isel(at)):g} K ({_label(plain, at)}): RMSE is "
            f"{_percent(error)} than without it, at {float(travel):.2f} times the motor travel (median); with "
            f"the inverse instead it is {_percent(gain)} than with the dead band."
        )


def _label(ds: xr.Dataset, at: Mapping[Hashable, int]) -> str:
    """The labels of one tuning: a name, or the values of what is swept."""
    labels = {d: ds[d].values[k] for d, k in at.items()}
    return ", ".join(str(v) if isinstance(v, str) else f"{d} = {v:g}" for d, v in labels.items())


def _share(holds: xr.DataArray, plain: xr.Dataset) -> str:
    """In how many of the loops that have a plain PI the condition holds."""
    return f"{100 * float(holds.where(plain['rmse'].notnull()).mean()):.0f} %"


def _extremes(ds: xr.Dataset) -> list[str]:
    rmse = ds["rmse"]
    low, middle, high = (float(f(rmse.values)) for f in (np.nanmin, np.nanmedian, np.nanmax))
    lines = [f"RMSE from {low:.3g} to {high:.3g} K, median {middle:.3g} K."]
    for dim in numeric_dims(ds["status"]):
        along = rmse.median([d for d in rmse.dims if d != dim])
        lines.append(
            f"Along {dim} the median RMSE is lowest at {float(along.idxmin(dim)):g}: {float(along.min()):.3g} K."
        )
    return lines


def _percent(ratio: xr.DataArray) -> str:
    value = 100.0 * float(ratio - 1)
    return f"{abs(value):.0f} % {'lower' if value < 0.0 else 'higher'}"

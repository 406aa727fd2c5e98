"""Summarise a study: its answer in five sentences, cautions, and costs by a tariff."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.loops.labels import coordinate_quantity, label_in_words, plain_pi_label, sizes_in_words
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.model.parameter_table import CHANCE_DIMS, PARAMETERS
from fastcoil.study.analysis.compare import mask_off_days
from fastcoil.study.analysis.cost import MONTH_DAYS, Tariff, compute_costs
from fastcoil.study.analysis.paired import paired_change, summarise_median
from fastcoil.study.analysis.precision import read_precision
from fastcoil.study.analysis.selected import mask_dataset, numeric_dims

_SUMMARY_METRICS = ("rmse", "hunts", "hunting_swing", "motor_travel", "switch_frequency")
PLANT_GROUPS = ("coil", "valve", "actuator", "sensor")  # of parameters that a controller cannot choose


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
            f"{hunts:,} of them hunting: no opening may hold it, or the gains do not suit the coil (see fastcoil "
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
    # without traces and other metrics, which comparisons would load
    masked = mask_off_days(ds[[name for name in _SUMMARY_METRICS if name in ds]])
    if ds["status"].size == 1:
        answer = _answer_single(masked)
    elif not bool(masked["rmse"].notnull().any()):
        answer = {"Found": "no RMS error is known."}
    elif ratio := estimate_dim(ds):
        answer = _answer_against_plain_pi(masked, ratio)
    else:
        answer = _answer_choices(masked)
    lines = [f"{head}: {sentence}" for head, sentence in answer.items()] + _prediction_lines(ds)
    return lines if billing is None else lines + cost_lines(ds, billing)


# --- the inverse against the plain PI ---------------------------------------------------------------------------------

_SHARE_OF_GAIN = 0.9  # that the recommended estimate has to bring: the last tenth may cost a lot of travel
_MIN_GAIN = 0.01  # a smaller change of the RMS error is none
_SIMILAR_CHANGE = 0.05  # of changes that differ by less, the simpler remedy is recommended


def estimate_dim(ds: xr.Dataset) -> str | None:
    """Return the dim of estimates with a plain PI, an estimate of 0, among them."""
    known = [d for d in ("estimate_ratio", "backlash_estimate") if d in numeric_dims(ds["status"])]
    return next((d for d in known if bool((ds[d] == 0.0).any())), None)


def keep_comparable(ds: xr.Dataset) -> xr.Dataset:
    """Mask the loops in which an inverse has nothing to do: without backlash, or with an error dead band.

    Where every loop has a dead band, all of them count.
    """
    if "backlash" in ds.coords and not bool((ds["backlash"] > 0.0).all()):
        ds = mask_dataset(ds, ds["backlash"] > 0.0)
    band = ds.coords.get("error_dead_band")
    return ds if band is None or not bool((band == 0.0).any()) else mask_dataset(ds, band == 0.0)


def recommended_estimate(ds: xr.Dataset, ratio: str) -> float:
    """Return the estimate of least motor travel among those with nine tenths of the largest gain; 0 if none has any.

    Gain and travel are medians of the changes against the plain PI of the same loop.
    """
    plain = ds.sel({ratio: 0.0}, drop=True)
    others = [d for d in ds["rmse"].dims if d != ratio]
    gain = -paired_change(ds["rmse"], plain["rmse"]).median(others)
    if not float(gain.max()) > 0.0:
        return 0.0
    travel = paired_change(ds["motor_travel"], plain["motor_travel"]).median(others).fillna(np.inf)
    return float(travel.where(gain >= _SHARE_OF_GAIN * gain.max()).idxmin(ratio))


def _plant_dims(ds: xr.Dataset) -> set[Hashable]:
    return {d for n in ds.coords if n in PARAMETERS and PARAMETERS[str(n)].group in PLANT_GROUPS for d in ds[n].dims}


def best_plain_pi(plain: xr.Dataset) -> dict[Hashable, int] | None:
    """Find the tuning of lowest error, along dims where gains differ and the plant does not; None without a choice.

    Lowest is the mean, over all else, of the RMSE relative to the best one of the same plant; days count together.
    """
    gains = {d for n in ("kp", "ti") if n in plain.coords for d in plain[n].dims}
    dims = [d for d in plain["rmse"].dims if d in gains - _plant_dims(plain) and plain.sizes[d] > 1]
    if not dims:
        return None
    error = plain["rmse"].mean([d for d in ("day", "replicate") if d in plain["rmse"].dims])
    relative = error / error.min(dims)
    cost = relative.mean([d for d in relative.dims if d not in dims]).fillna(np.inf)
    return {d: int(k) for d, k in cost.argmin(dims).items()}


def _answer_against_plain_pi(ds: xr.Dataset, ratio: str) -> dict[str, str]:
    """Recommend what to do about the backlash: tune the PI, put an inverse behind it, or both."""
    loops, pi = keep_comparable(ds), plain_pi_label(ds)
    best, plain = recommended_estimate(loops, ratio), loops.sel({ratio: 0.0}, drop=True)
    at, inverse = best_plain_pi(plain), loops.sel({ratio: best}, drop=True)
    tune = "" if at is None else f"tune the PI to {_describe_labels(plain, at)}"
    options = {}
    if at is not None:
        options["the tuning alone"] = tune, plain.isel(at, drop=True)
    if best:
        options["the inverse alone"] = _inverse_text(ds, ratio, best), inverse
    if at is not None and best:
        options["both"] = f"{tune}; then {_inverse_text(ds, ratio, best)}", inverse.isel(at, drop=True)
    errors = {name: paired_change(remedied["rmse"], plain["rmse"]) for name, (_, remedied) in options.items()}
    medians = {name: float(error.median()) for name, error in errors.items()}
    lowest = min(medians.values(), default=0.0)
    if not lowest < -_MIN_GAIN:
        return {"Do this": f"leave the {pi} as it is: nothing that was tried lowers its RMS error by 1 %."}
    chosen = next(name for name, median in medians.items() if median <= lowest + _SIMILAR_CHANGE)
    (advice, remedied), error = options[chosen], errors[chosen]
    lower = float((error < 0.0).where(error.notnull()).mean())
    change = _format_change(medians.pop(chosen))
    brings = f"the RMS error is {change} than with the {pi} of the same loop (median), and "
    rest = [f"with {name} {_format_change(median)}" for name, median in medians.items()]
    brings += "; ".join([f"lower in {_format_share(lower)} of the loops", *rest])
    travel = float((remedied["motor_travel"] / plain["motor_travel"]).median())
    switches = [float(part["switch_frequency"].median()) for part in (remedied, plain)]
    costs = f"the motor travels {travel:.3g} times as far (median), and the direction of the command changes "
    costs += f"{switches[0]:.1f} times in 10 min instead of {switches[1]:.1f}"
    costs += "; a larger buffer lowers that." if travel > 5.0 else "."
    fails = _describe_failures(loops, ratio, best, error)
    return {"Do this": f"{advice}.", "It brings": f"{brings}.", "It costs": costs, "It fails": fails}


def _describe_failures(ds: xr.Dataset, ratio: str, best: float, error: xr.DataArray) -> str:
    """Describe in which loops the recommended remedy does not lower the error, and what an overestimate does."""
    worse = (error >= 0.0).where(error.notnull())
    parts = []
    if float(worse.max()) > 0.0:
        where, share = _worst_label(worse, "mean")
        most = f", most often at {where} ({_format_share(share)})" if where else ""
        parts.append(f"the error is not lower in {_format_share(float(worse.mean()))} of the loops{most}")
    last = float(ds[ratio].max())
    if best and last > best:
        over, at, plain = (ds.sel({ratio: x}, drop=True) for x in (last, best, 0.0))
        travel = float((over["motor_travel"] / plain["motor_travel"]).median())
        higher = float((over["rmse"] > at["rmse"]).where(plain["rmse"].notnull()).mean())
        wrong, right = map(coordinate_quantity(ds, ratio).number, (last, best))
        parts.append(
            f"with an estimate of {wrong} instead of {right} the inverse makes the motor travel {travel:.3g} times as "
            f"far as the {plain_pi_label(ds)}, and its error is higher in {_format_share(higher)} of the loops"
        )
    return "; ".join(parts) + "." if parts else "in none of these loops does the error rise."


def _worst_label(values: xr.DataArray, method: str) -> tuple[str, float]:
    """Find the label with the largest mean or median; return it in words, empty where none differs."""
    worst = "", -np.inf
    for dim in values.dims:
        if values.sizes[dim] > 1 and dim in values.coords and dim not in CHANCE_DIMS:
            along = getattr(values, method)([d for d in values.dims if d != dim]).fillna(-np.inf)
            k = int(along.argmax(str(dim)))
            if float(along[k]) > worst[1]:
                worst = _describe_labels(values, {dim: k}), float(along[k])
    return worst


def _inverse_text(ds: xr.Dataset, ratio: str, best: float) -> str:
    of_what = " of the backlash" if ratio == "estimate_ratio" else ""
    return f"put an inverse behind the PI with an estimate of {coordinate_quantity(ds, ratio).number(best)}{of_what}"


def _describe_labels(ds: xr.Dataset | xr.DataArray, at: Mapping[Hashable, int]) -> str:
    """Describe labels in words: named alternatives by the parameters that differ, where all of these are numbers."""
    words = []
    for dim, k in at.items():
        along = {str(n): c.values for n, c in ds.coords.items() if c.dims == (dim,) and n in PARAMETERS}
        along = {n: v for n, v in along.items() if np.unique(v).size > 1 and (n != "error_dead_band" or v[k] > 0.0)}
        if along and all(values.dtype.kind in "if" for values in along.values()):
            words += [coordinate_quantity(ds, n).equals(float(values[k])) for n, values in along.items()]
        else:
            words.append(label_in_words(ds, str(dim), k))
    return ", ".join(words)


def _format_share(share: float, decimals: int = 0) -> str:
    """Format a share in per cent; 0 and 100 % are none and all."""
    least = 0.0 if share in (0.0, 1.0) else 10.0**-decimals
    return f"{np.clip(100.0 * share, least, 100.0 - least):.{decimals}f} %"


def _format_change(change: float) -> str:
    return f"{100.0 * abs(change):.0f} % {'lower' if change < 0.0 else 'higher'}"


# --- other studies ----------------------------------------------------------------------------------------------------


def _answer_single(ds: xr.Dataset) -> dict[str, str]:
    """Describe a single scenario: its error, whether it hunts, and the travel of the motor."""
    names = ("rmse", "hunts", "hunting_swing", "motor_travel")
    values = {name: float(ds[name].max()) for name in names if name in ds}
    sentence = f"the RMS error is {values['rmse']:.3g} K"
    if "hunts" in values:
        swing = f"hunts, {values['hunting_swing']:.2g} K peak to peak" if values["hunts"] else "does not hunt"
        sentence += f"; the loop {swing}"
    costs = {"It costs": f"the motor travels {values['motor_travel']:.3g} strokes."} if "motor_travel" in values else {}
    return {"Found": f"{sentence}."} | costs


def _answer_choices(ds: xr.Dataset) -> dict[str, str]:
    """Recommend the labels of lowest error along the dims that a controller can choose; say where it is largest."""
    rmse, plant = ds["rmse"], _plant_dims(ds)
    free = [d for d in rmse.dims if rmse.sizes[d] > 1 and d in ds.coords and d not in {*plant, *CHANCE_DIMS}]
    if free:
        of_choice = rmse.median([d for d in rmse.dims if d not in free])
        ends = of_choice.fillna(np.inf).argmin(free), of_choice.fillna(-np.inf).argmax(free)
        best, worst = ({d: int(k) for d, k in place.items()} for place in ends)
        answer = {
            "Do this": f"take {_describe_labels(ds, best)}.",
            "It brings": f"the RMS error is {float(of_choice.isel(best)):.3g} K (median), the lowest of these choices; "
            f"the highest is {float(of_choice.isel(worst)):.3g} K, with {_describe_labels(ds, worst)}.",
        }
        if "motor_travel" in ds:
            travel = [float(ds["motor_travel"].isel(place).median()) for place in (best, worst)]
            answer["It costs"] = f"the motor travels {travel[0]:.3g} strokes (median) instead of {travel[1]:.3g}."
        rmse = rmse.isel(best, drop=True)
    else:
        low, middle, high = (float(rmse.quantile(q)) for q in (0.05, 0.5, 0.95))
        spread = f"{middle:.3g} K in the median, {low:.3g} to {high:.3g} K in 5 to 95 % of the loops"
        answer = {"Found": f"the RMS error is {spread}."}
    where, error = _worst_label(rmse, "median")
    return answer | ({"It fails": f"the error is largest at {where}: {error:.3g} K (median)."} if where else {})


def _prediction_lines(ds: xr.Dataset) -> list[str]:
    """Compare the predicted and the simulated hunting."""
    if "predicted_hunts" not in ds:
        return []
    is_known = ds["predicted_hunts"].notnull() & (ds["status"] == STATUS_OK)
    n = int(is_known.sum())
    if not n:
        return ["Hunting: theory says nothing about these loops."]
    predicted, seen = (ds[name].where(is_known) > 0.0 for name in ("predicted_hunts", "hunts"))
    agree = _format_share(float((predicted == seen).where(is_known).mean()), decimals=1)
    counts = f"predicted for {int(predicted.sum()):,} of {n:,} loops, seen in {int(seen.sum()):,}"
    return [f"Hunting: {counts}; {agree} agree."]


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

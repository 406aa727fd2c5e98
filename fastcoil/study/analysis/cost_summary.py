"""What backlash costs a year, in a few sentences."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.model.metric_table import STATUS_OK
from fastcoil.study.analysis.cost import costs_of
from fastcoil.study.analysis.pairs import Middle, middle_of
from fastcoil.study.analysis.tariff import MONTH, Tariff

_MOST_GROUPS, _MOST_LABELS = 4, 6
"""Labels of other dims that get sentences of their own; labels that one sentence compares."""
_GROWN = 1e-4
"""Fraction of stroke; less is no wear."""


class Billing(NamedTuple):
    """The prices, and the label of one dim with which the others are compared; empty: that without backlash."""

    tariff: Tariff
    baseline: Mapping[str, Any]


def cost_lines(ds: xr.Dataset, billing: Billing) -> list[str]:
    """The sentences on the costs of a result with at least one scenario that did not fail."""
    costs, currency = costs_of(ds, billing.tariff), billing.tariff.currency
    baseline = dict(billing.baseline) or sound(ds)
    lines = [_basis(costs, ds)]
    if not baseline:
        paid = middle_of(costs["yearly_cost"])
        lines.append(
            f"A loop costs {_money(paid.median)} {currency} a year (median; 5 to 95 % of them: {_money(paid.q05)} to "
            f"{_money(paid.q95)}).  Add loops with backlash = 0 to see what of it the backlash costs."
        )
        return lines + _wear(ds, {})
    groups = list(_groups(costs, baseline))
    for name, at in groups if len(groups) <= _MOST_GROUPS else [("", {})]:
        lines += _compared(ds.sel(at), costs.sel(at), baseline, currency, name)
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


def _basis(costs: xr.Dataset, ds: xr.Dataset) -> str:
    """What the year is made of."""
    days, years = int(costs["n_days"].sum()), costs.attrs["years"]
    scaled = "" if abs(years - 1.0) < 1e-6 else f"; scaled from {days:,} day{'s' * (days != 1)} to a year"
    months = "months of the calendar" if "start" in ds.coords else f"no dates, so {MONTH} days are a month"
    return f"Cost by [tariff], of coil, demand, reheat and recooling, without fan and pumps ({months}{scaled})."


def _groups(costs: xr.Dataset, baseline: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every combination of the words along other dims, with its name."""
    dims = [d for d in costs["status"].dims if d not in baseline and costs[d].dtype.kind in "UO"]
    for labels in itertools.product(*(costs[d].values for d in dims)):
        yield ", ".join(map(str, labels)), dict(zip(map(str, dims), labels, strict=True))


def _compared(ds: xr.Dataset, costs: xr.Dataset, baseline: dict[str, Any], currency: str, name: str) -> Iterator[str]:
    """What the other labels cost more than the baseline, and what becomes of valve and temperature."""
    ((dim, label),) = baseline.items()
    others = [each for each in costs[dim].values if each != label]
    shown = others if len(others) <= _MOST_LABELS else [others[k] for k in _spread(len(others))]
    extra = costs - costs.sel(baseline, drop=True)
    found = {each: middle_of(extra["yearly_cost"].sel({dim: each})) for each in shown}
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


def _spread(n: int) -> list[int]:
    return sorted({round(k) for k in np.linspace(0, n - 1, _MOST_LABELS)})


def _detail(extra: xr.Dataset, of: Middle, name: str, currency: str) -> str:
    """Where the money of the dearest label goes, and how it differs between valves."""
    parts = {
        word: float(extra[f"yearly_{part}"].mean())
        for word, part in (
            ("coil", "coil_cost"), ("demand", "demand_cost"), ("reheat", "reheat_cost"), ("recooling", "recool_cost")
        )
    }  # fmt: skip
    listed = ", ".join(f"{word} {_signed(value)}" for word, value in parts.items())
    sure = "" if np.isnan(of.low) else f"; the median lies between {_signed(of.low)} and {_signed(of.high)}, 95 % sure"
    return (
        f"With {name}, 5 to 95 % of the loops: {_signed(of.q05)} to {_signed(of.q95)} {currency} a year{sure}.  "
        f"On average: {listed}."
    )


def _mechanics(ds: xr.Dataset, baseline: dict[str, Any], other: dict[str, Any]) -> str:
    """Time off the set-point and travel of the motor of one label beside the baseline."""
    good = ds[["share_off", "motor_travel"]].where(ds["status"] == STATUS_OK)
    off, travel = (good[name].mean("day") if "day" in good[name].dims else good[name] for name in good)
    now, before = (100.0 * float(off.sel(at).median()) for at in ({**baseline, **other}, baseline))
    ratio = float((travel.sel({**baseline, **other}) / travel.sel(baseline, drop=True)).median())
    moved = f", and its motor travels {ratio:.1f} times as far" if np.isfinite(ratio) else ""
    off_it = f"{now:.1f} % of the time instead of {before:.1f} %, mean of the days"
    return f"Its air is more than 0.5 K off the set-point {off_it}{moved}."


def _wear(ds: xr.Dataset, baseline: dict[str, Any]) -> list[str]:
    """How far the gaps grew from the first day to the last, where the days are a sequence."""
    if not ds.attrs.get("carry_over") or "backlash_final" not in ds or "day" not in ds["backlash_final"].dims:
        return []
    gap = ds["backlash_final"].where(ds["status"] == STATUS_OK)
    partners = float((gap if not baseline else gap.sel(baseline)).isel(day=-1).median())
    sound_once = baseline == sound(ds) and bool(baseline)
    for dim, label in baseline.items():
        gap = gap.sel({dim: [each for each in gap[dim].values if each != label]})
    first, last = 100.0 * gap.isel(day=0), 100.0 * gap.isel(day=-1)
    if not bool((last - first > 100.0 * _GROWN).any()):
        return []
    grown = middle_of(last - first)
    before, after = float(first.median()), float(last.median())
    lines = [
        f"From the first day to the last the gap grows from {before:.2f} to {after:.2f} % of stroke (medians); by "
        f"more than {grown.q95:.2f} % of stroke in 5 % of the loops."
    ]
    if sound_once and partners > _GROWN:
        lines.append(f"The loops without a gap wear, too: {100.0 * partners:.2f} % in the end (median).")
    return lines


def _called(dim: str, label: object) -> str:
    if dim == "backlash" and isinstance(label, float):
        return f"a gap of {100.0 * label:g} %" if label else "no gap"
    return str(label) if isinstance(label, str) else f"{dim} {label:g}"


def _more(value: float, currency: str = "") -> str:
    """How much more or less."""
    return f"{_money(abs(value))}{' ' * bool(currency)}{currency} {'less' if value < 0.0 else 'more'}"


def _signed(value: float) -> str:
    return f"{'-' if value < 0.0 else '+'}{_money(abs(value))}"


def _money(value: float) -> str:
    """Three digits, whole from a hundred on."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}" if abs(value) >= 0.005 else "0"

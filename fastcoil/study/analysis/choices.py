"""The choices of a study: one table over its swept axes, and which cell of it to recommend.

A swept axis is a *choice*, which a controller is free to make, or a *condition*, which the plant sets.  Only chance,
that is days, drawn valves and noise, is pooled.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.loops.labels import coordinate_quantity, label_in_words, plain_pi_label
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.model.parameter_table import CHANCE_DIMS, PARAMETERS
from fastcoil.study.analysis.compare import mask_off_days
from fastcoil.study.analysis.paired import paired_change
from fastcoil.study.analysis.selected import condition_dims, mask_dataset, swept_dims

TRAVEL_LIMIT = 2.0  # motor travel over that of the best plain PI up to which a choice is recommended
HUNTING_LIMIT = 0.05  # share of the scenarios of a condition that may hunt with a recommended choice
SIMILAR_ERROR = 1.05  # RMSE over the lowest up to which the simpler choice, or that of less travel, is recommended
CALM_ERROR = 1.25  # RMSE over the lowest up to which a plain PI of little travel sets the limit of travel
LEAST_ERROR_K = 0.01  # RMSE below which choices are alike: no sensor shows it, and on a constant day it may be 0
INVERSE_SHARE = 0.95  # largest estimate over the backlash that is recommended, where there is a choice
BUFFER_PER_NOISE = 6.0  # of a buffer over kp times noise, docs/findings/remedies.md
LEAST_BUFFER = 0.01  # of the stroke, where the noise asks for less

PLAIN_PI_VALUES: Mapping[str, Any] = {
    "estimate_ratio": 0.0, "backlash_estimate": 0.0, "learning_step": 0.0, "estimator": "none", "law": "pi",
}  # fmt: skip
"""What makes a controller a plain PI, where it varies."""
TABLE_METRICS = ("rmse", "hunts", "hunting_swing", "motor_travel", "switch_frequency")


def mask_plain_pi(ds: xr.Dataset) -> xr.DataArray:
    """Mark the plain PIs, over the dims along which only some controllers are one; a scalar where none differ."""
    is_plain, stored = xr.DataArray(True), json.loads(ds.attrs.get("parameters", "{}"))
    varied = [n for n in PLAIN_PI_VALUES if n in ds.coords and ds[n].ndim and not {*ds[n].dims} & {*CHANCE_DIMS}]
    for name in varied:
        is_plain = is_plain & (ds[name] == PLAIN_PI_VALUES[name])
    replaced = {"estimate_ratio": "backlash_estimate", "backlash_estimate": "estimate_ratio"}
    for name, value in PLAIN_PI_VALUES.items():
        given = ds[name].values.item() if name in ds.coords and ds[name].ndim == 0 else stored.get(name)
        if name not in varied and replaced.get(name) not in varied and given not in (None, value):
            is_plain = is_plain & False
    return is_plain.reset_coords(drop=True)


def make_table(ds: xr.Dataset) -> xr.Dataset:
    """Pool metrics over chance, and compare each cell with its partners under a plain PI."""
    dims = swept_dims(ds)
    chance = [d for d in ds["status"].dims if d not in dims]
    ds = mask_off_days(ds[[n for n in (*TABLE_METRICS, "status") if n in ds]])
    ds = mask_dataset(ds.drop_vars("status"), ds["status"] == STATUS_OK).assign_attrs(ds.attrs)
    pooled = {n: v.mean(chance) if n == "hunts" else v.median(chance) for n, v in ds.data_vars.items()}
    for name, q in (("rmse_q05", 0.05), ("rmse_q95", 0.95)):
        pooled[name] = ds["rmse"].quantile(q, chance).drop_vars("quantile")
    pooled["n"] = ds["rmse"].notnull().sum(chance)
    at = plain_place(ds)
    if at:
        partner = ds.isel(at, drop=True)
        change = paired_change(ds["rmse"], partner["rmse"])
        pooled["rmse_change"] = change.median(chance)
        lower = (change < 0.0) + 0.5 * (change == 0.0)  # a tie counts half, as in fc.compare
        pooled["share_lower"] = lower.where(change.notnull()).mean(chance)
        if "motor_travel" in ds:
            ratio = ds["motor_travel"] / partner["motor_travel"].where(partner["motor_travel"] > 0.0)
            pooled["travel_ratio"] = ratio.median(chance)
    coords = {n: c for n, c in ds.coords.items() if {*c.dims} <= {*dims}}
    table = xr.Dataset({n: v.transpose(*dims) for n, v in pooled.items()}, coords=coords)
    for metric, values in table.items():
        values.attrs = dict(ds[metric].attrs) if metric in ds else {}
    return table.assign_attrs({n: ds.attrs[n] for n in ("title", "summary", "parameters") if n in ds.attrs})


def plain_place(ds: xr.Dataset) -> dict[str, int]:
    """Return the place of the plain PI along the dims of the controllers; empty where there is none, or several."""
    is_plain = mask_plain_pi(ds)
    if is_plain.ndim == 0 or int(is_plain.sum()) != 1 or {*is_plain.dims} & condition_dims(ds):
        return {}  # controllers that come with a plant of their own have no partner
    return {str(d): int(k) for d, k in zip(is_plain.dims, np.argwhere(is_plain.values)[0], strict=True)}


def largest(values: xr.DataArray) -> dict[str, int]:
    """Return the place of the largest value; empty where there are no dims."""
    if not values.ndim:
        return {}
    return {str(d): int(k) for d, k in values.fillna(-np.inf).argmax([*values.dims]).items()}


class Choices:
    """The choices of a study and how they do: relative error, travel and hunting, over the conditions together."""

    def __init__(self, table: xr.Dataset) -> None:
        self.table, self.conditions = table, condition_dims(table)
        self.dims = [str(d) for d in table["rmse"].dims if d not in self.conditions]
        self.over = [d for d in table["rmse"].dims if d in self.conditions]
        self.rmse = rmse = table["rmse"].clip(min=LEAST_ERROR_K)
        # relative to the best choice of each condition, so that every condition counts alike
        self.error = (rmse / rmse.min(self.dims)).mean(self.over).fillna(np.inf)
        hunts = table["hunts"] if "hunts" in table else xr.zeros_like(rmse)
        self.hunting = hunts.max(self.over).fillna(np.inf)
        if float(self.hunting.min()) > HUNTING_LIMIT:  # no choice is calm everywhere
            self.hunting = hunts.mean(self.over).fillna(np.inf)
        is_plain = mask_plain_pi(table)
        is_plain = is_plain.all([d for d in is_plain.dims if d in self.conditions])
        self.is_plain = is_plain.broadcast_like(self.error)
        self.is_advisable = self._advisable()
        self.reference = self._find_reference()
        self.travel = self._travel_ratio()

    def _advisable(self) -> xr.DataArray:
        """Leave out inverses of more than 95 % of the backlash: nobody knows it better, and more may chatter."""
        ratio = self.table.coords.get("estimate_ratio", xr.DataArray(0.0))
        is_small = ratio <= INVERSE_SHARE + 1e-9
        has_choice = ratio.ndim and bool((is_small & (ratio > 0.0)).any())
        is_advisable: xr.DataArray = (is_small | (not has_choice)).reset_coords(drop=True)
        return is_advisable

    def _find_reference(self) -> dict[str, int]:
        """Find the plain PI with the least travel of those whose error is near the best; without one, of all."""
        candidates = self._calm(self.is_plain if bool(self.is_plain.any()) else xr.ones_like(self.is_plain))
        lowest = self.error.where(candidates).min()
        near = candidates & (self.error <= CALM_ERROR * lowest)
        if "motor_travel" not in self.table:
            return self._lowest(self.error, near)
        return self._lowest(self.table["motor_travel"].median(self.over), near)

    def _calm(self, mask: xr.DataArray) -> xr.DataArray:
        least = float(self.hunting.where(mask & self.is_advisable).min())
        return mask & self.is_advisable & (self.hunting <= max(HUNTING_LIMIT, least + HUNTING_LIMIT))

    def _travel_ratio(self) -> xr.DataArray:
        if "motor_travel" not in self.table:
            return xr.ones_like(self.error)
        travel = self.table["motor_travel"]
        reference = travel.isel(self.reference, drop=True)
        return (travel / reference.where(reference > 0.0)).median(self.over).fillna(np.inf)

    def _lowest(self, values: xr.DataArray, mask: xr.DataArray) -> dict[str, int]:
        return largest(-values.where(mask, np.inf))

    @property
    def best(self) -> dict[str, int]:
        """The lowest error within the limits of travel and hunting; of similar ones a plain PI, then least travel."""
        allowed = self._calm(self.travel <= TRAVEL_LIMIT)
        near = allowed & (self.error <= SIMILAR_ERROR * self.error.where(allowed).min())
        plain = near & self.is_plain
        return self._lowest(self.travel, plain if bool(plain.any()) else near)

    @property
    def unlimited(self) -> dict[str, int]:
        """The lowest error of all."""
        return self._lowest(self.error, self.is_advisable.broadcast_like(self.error))


# --- in words ---------------------------------------------------------------------------------------------------------


def describe_choice(choices: Choices, place: Mapping[str, int]) -> str:
    """Describe a choice in words: gains, then the inverse or the plain PI."""
    table, inverse, rest = choices.table, "", dict(place)
    for dim in ("estimate_ratio", "backlash_estimate"):
        if dim in rest and choices.is_plain.ndim:
            k = rest.pop(dim)
            of_what = " of the backlash" if dim == "estimate_ratio" else ""
            size = f"{coordinate_quantity(table, dim).number(float(table[dim].values[k]))}{of_what}"
            inverse = f"an inverse of {size}" if table[dim].values[k] else f"the {plain_pi_label(table)}"
    return f"take {' and '.join(filter(None, [describe_labels_at(table, rest), inverse]))}"


def shorten(words: str) -> str:
    """Shorten names of gains, which sentences have many of."""
    for name, short in {"proportional gain Kp": "Kp", "integral time Ti": "Ti"}.items():
        words = words.replace(f"{name} = ", f"{short} ").replace(name, short)
    return words


def describe_labels_at(ds: xr.Dataset | xr.DataArray, at: Mapping[str, int]) -> str:
    """Describe labels in words: named alternatives by the parameters that differ, where all of these are numbers."""
    words = []
    for dim, k in at.items():
        along = {str(n): c.values for n, c in ds.coords.items() if c.dims == (dim,) and n in PARAMETERS}
        along = {n: v for n, v in along.items() if np.unique(v).size > 1 and (n != "error_dead_band" or v[k] > 0.0)}
        if along and all(values.dtype.kind in "if" for values in along.values()):
            words += [coordinate_quantity(ds, n).equals(float(values[k])) for n, values in along.items()]
        else:
            words.append(label_in_words(ds, dim, k))
    return shorten(", ".join(words))


def describe_place(ds: xr.Dataset, place: Mapping[str, Any]) -> str:
    """Describe labels: `` at Kp = 0.05 1/K, ...``; empty without any."""
    at = {str(d): int((ds[d].values == label).argmax()) for d, label in place.items()}
    return f" at {describe_labels_at(ds, at)}" if at else ""


def recommended_buffer(table: xr.Dataset, place: Mapping[str, int]) -> float:
    """Return the buffer that noise asks for, docs/findings/remedies.md; the largest of the choice."""
    stored = json.loads(table.attrs.get("parameters", "{}"))
    values = [table.coords[n] if n in table.coords else xr.DataArray(stored.get(n, 0.0)) for n in ("kp", "noise_std")]
    kp, noise = (float(v.isel({d: k for d, k in place.items() if d in v.dims}).max()) for v in values)
    return float(f"{max(BUFFER_PER_NOISE * kp * noise, LEAST_BUFFER):.2g}")


def format_range(values: xr.DataArray, unit: str = "K") -> str:
    """Format a median, and its range over the conditions where it varies."""
    low, middle, high = (float(v) for v in (values.min(), values.median(), values.max()))
    condition = coordinate_quantity(values, str(values.dims[0])).text if values.ndim == 1 else "condition"
    over = f" ({low:.3g} to {high:.3g} by {condition})" if values.ndim and f"{low:.3g}" != f"{high:.3g}" else ""
    return f"{middle:.3g} {unit}{over}"


def change_in_words(ratio: xr.DataArray) -> str:
    """Format the median of a ratio as a change: ``38 % lower``."""
    change = float(ratio.median()) - 1.0
    return f"{100.0 * abs(change):.0f} % {'lower' if change < 0.0 else 'higher'}"

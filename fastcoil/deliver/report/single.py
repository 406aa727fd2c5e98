"""What a study of a single scenario says: every metric once."""

from __future__ import annotations

import xarray as xr

from fastcoil.deliver.report.numbers import number
from fastcoil.deliver.report.page import Table
from fastcoil.loops.labels import quantity
from fastcoil.model.metric_table import METRICS

_COUNTED = ("reversals", "half_periods")
"""Metrics that are whole numbers."""


def metrics(ds: xr.Dataset) -> Table:
    """Every metric that is known, with its unit."""
    rows = []
    for name, output in METRICS.items():
        if name not in ds or name == "hunts" or output.flags or not bool(ds[name].notnull().any()):
            continue
        shown = quantity(name)
        value = float(ds[name].max()) * shown.factor
        text = f"{value:.0f}" if name in _COUNTED else f"{number(value)} {shown.unit}".rstrip()
        rows.append([output.long_name, text, name])
    return Table("Every metric", ["metric", "value", "name in results.nc"], rows)


def answer(ds: xr.Dataset) -> list[str]:
    """The error, whether it hunts, and what the motor does for it."""
    found = {name: float(ds[name].max()) for name in ("rmse", "hunts", "hunting_swing", "motor_travel") if name in ds}
    lines = [f"RMS error {number(found['rmse'])} K."]
    if "hunts" in found:
        swing = f": {number(found['hunting_swing'], 2)} K peak to peak" if found["hunts"] else ""
        lines.append(f"The loop {'hunts' if found['hunts'] else 'does not hunt'}{swing}.")
    if "motor_travel" in found:
        lines.append(f"The motor travels {number(found['motor_travel'])} strokes.")
    return lines

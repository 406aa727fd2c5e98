"""A tuning in words and as a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import xarray as xr

from fastcoil.design.tuning.intervals import CHANGE
from fastcoil.design.tuning.measures import Limit
from fastcoil.loops.labels import quantity

NOW, CHOSEN, SIMC = "now", "chosen", "simc"
_HEADS = {NOW: "now", CHOSEN: "chosen", SIMC: "SIMC"}


class Findings(NamedTuple):
    """What a summary is made of; see ``Tuning``."""

    parameters: Mapping[str, float]
    meets_limits: bool
    trained: xr.Dataset
    held_out: xr.Dataset
    limits: tuple[Limit, ...]
    notes: tuple[str, ...]


def value_of(name: str, value: float) -> str:
    """A value as a study file takes it."""
    from fastcoil.model.parameter_table import PARAMETERS

    return repr(int(value)) if name in PARAMETERS and PARAMETERS[name].whole else repr(float(value))


def setting(name: str, value: float) -> str:
    """``kp = 0.061 1/K``."""
    unit = quantity(name).unit
    return f"{name} = {value_of(name, value)}" + (f" {unit}" if unit not in ("", "%") else "")


def in_words(found: Findings, tried: int) -> list[str]:
    """The chosen values, a table of every tuning on both groups, and the notes."""
    chosen = ", ".join(setting(name, value) for name, value in found.parameters.items())
    head = "Chosen" if found.meets_limits else "No tuning keeps the limits; nearest to them"
    lines = [f"{head}: {chosen} ({tried:,} tunings tried)", ""]
    for title, ds in (("Held out", found.held_out), ("Searched on", found.trained)):
        lines += [f"{title}: {ds.attrs['group']}", *_table(ds, found.limits), ""]
    value, low, high = found.held_out[CHANGE].sel(tuning=CHOSEN).values
    goal = next(iter(found.held_out.data_vars.values())).attrs["long_name"]
    interval = "" if math.isnan(low) else f" ({low:+.0%} to {high:+.0%} for other valves and days)"
    lines.append(f"Held out, {goal}: {value:+.0%} against now{interval}")
    return lines + list(found.notes)


def table_rows(ds: xr.Dataset, limits: tuple[Limit, ...]) -> list[list[str]]:
    """Every measure of every tuning and its limit as cells, the heads first."""
    limit = {}
    for each in limits:
        now = float(ds[each.measure.name].sel(tuning=NOW, edge="value"))
        limit[each.measure.name] = each.measure.shown(now if each.as_now else each.most)
    tunings = [str(t) for t in ds["tuning"].values]
    rows = [["", *(_HEADS[t] for t in tunings), *(["limit"] if limit else [])]]
    for name, variable in ds.data_vars.items():
        if name == CHANGE:
            continue
        cells = [_cell(str(name).rpartition("_")[0], variable.sel(tuning=t).values) for t in tunings]
        rows.append([variable.attrs["long_name"], *cells, *([limit.get(str(name), "")] if limit else [])])
    return rows


def _table(ds: xr.Dataset, limits: tuple[Limit, ...]) -> list[str]:
    rows = table_rows(ds, limits)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]


def _cell(metric: str, edges: object) -> str:
    factor = quantity(metric).factor
    value, low, high = (f"{factor * float(x):.3g}" for x in edges)  # type: ignore[attr-defined]
    return value if low == "nan" else f"{value} ({low} to {high})"

"""Summarise a study: how much was run, cautions, its answer."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fastcoil.loops.labels import sizes_in_words
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.study.analysis.answer import find_answer
from fastcoil.study.analysis.precision import read_precision


def summary(ds: xr.Dataset) -> list[str]:
    """Return lines of text: how much was run, how fast, and the answer."""
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
    return [*lines, *cautions(ds), *([f"Asked: {question}"] if question else []), *find_answer(ds).summary()]


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

"""What an inverse has to beat beside the plain PI of the same loop: the best plain PI, and an error dead band."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
import xarray as xr

from fastcoil.model.parameter_table import PARAMETERS

PLANT = ("coil", "valve", "actuator", "sensor")
"""Groups of parameters that a controller cannot choose."""


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

"""A result as changes against one of its cases: paired, so day with day, valve with valve, noise with noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.model.metric_table import METRICS, STATUS_OK
from fastcoil.study.analysis.paired import in_shares, relative_change


def relative_to(ds: xr.Dataset, case: Mapping[str, int], words: str) -> xr.Dataset:
    """Metrics as shares of their value in one case: -0.2 is a fifth lower.

    Parameters
    ----------
    ds
        A result.
    case
        Dimension → position of the case along it; it is left out of what is returned.
    words
        The case, for people.

    Returns
    -------
    xarray.Dataset
        Where the value in the case is 0, or either failed, NaN, but 0 where both are 0.  Flags are left out.  The
        attribute ``relative_to`` of a metric names the case.
    """
    ok = ds["status"] == STATUS_OK
    rest = {d: np.delete(np.arange(ds.sizes[d]), k) for d, k in case.items()}
    if any(keep.size == 0 for keep in rest.values()):
        raise InputError(f"--relative-to {words}: the study has no other case to compare with it")
    found = {}
    for name, variable in ds.data_vars.items():
        if name == "status" or variable.dims != ds["status"].dims or (name in METRICS and METRICS[name].flags):
            continue
        values = variable.where(ok)
        own, partner = xr.broadcast(values, values.isel(case, drop=True))
        change = own.copy(data=relative_change((own - partner).values, partner.values)).transpose(*variable.dims)
        change.attrs = {}
        found[name] = change.where(np.isfinite(change)).isel(rest).assign_attrs(in_shares(variable.attrs, words))
    return xr.Dataset(found | {"status": ds["status"].isel(rest)}, attrs=ds.attrs)

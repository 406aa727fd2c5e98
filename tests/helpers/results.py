"""Results in the form of ``simulate``, with given values."""

import numpy as np
import xarray as xr

from fastcoil.loops.scenarios import cf_attributes, coordinate_attrs
from fastcoil.model.metric_table import METRICS, STATUS_MEANINGS


def make_result(dims, coords=None, attrs=None, **metrics):
    """Make a result with these metrics along ``dims``; coords: labels and drawn parameters, numbered by default."""
    values = {name: np.asarray(v, dtype=float) for name, v in metrics.items()}
    ds = xr.Dataset({n: (dims, v, cf_attributes(METRICS[n])) for n, v in values.items()})
    flags = {"flag_values": np.arange(len(STATUS_MEANINGS)), "flag_meanings": " ".join(STATUS_MEANINGS)}
    ds["status"] = (dims, np.zeros(next(iter(values.values())).shape, dtype=np.int8), flags)
    ds = ds.assign_coords({d: np.arange(n) for d, n in ds.sizes.items()} | (coords or {}))
    for name in ds.coords:
        ds[name].attrs = coordinate_attrs(str(name))
    return ds.assign_attrs(attrs or {})


def drawn_result(n, seed=1, **others):
    """Make a result of ``n`` samples on two days with drawn kp, ti and sample_time."""
    rng = np.random.default_rng(seed)
    kp, ti = rng.lognormal(-4.0, 0.5, n), rng.uniform(10.0, 100.0, n)
    coords = {"kp": ("sample", kp), "ti": ("sample", ti), "sample_time": ("sample", rng.choice([5.0, 10.0, 30.0], n))}
    return make_result(("day", "sample"), coords, rmse=kp + 0.1 * rng.random((2, n)), iae=rng.random((2, n)), **others)

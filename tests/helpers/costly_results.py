"""Results with energies by hand: a number for each day and loop."""

import json

import numpy as np
import xarray as xr

PRICES = {"electricity": 0.24, "demand": 12.0, "heat": 0.05, "cop": 4.0}
METRICS = ("coil_energy", "coil_peak_power", "reheat_energy", "recool_energy", "motor_travel", "share_off", "rmse")


def days_from(first, n):
    """Return the dates of n consecutive days."""
    return np.datetime64(first, "s") + np.arange(n) * np.timedelta64(24 * 3600, "s")


def result(n_days, *dims, start=None, seed=1, action="cooling", **coords):
    """Make a result over (day, *dims), each dim (name, labels), with random energies."""
    draw, sizes = np.random.default_rng(seed), [n_days, *(len(labels) for _, labels in dims)]
    names = ["day", *(name for name, _ in dims)]
    ds = xr.Dataset(
        {name: (names, draw.uniform(1.0, 10.0, sizes)) for name in METRICS}
        | {"status": (names, np.zeros(sizes, dtype=np.int8))},
        coords={name: labels for name, labels in dims} | {"day": np.arange(n_days), **coords},
        attrs={"parameters": json.dumps({"action": action})},
    )
    return ds if start is None else ds.assign_coords(start=("day", days_from(start, n_days), {"time_zone": "UTC"}))

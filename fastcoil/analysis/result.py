"""What every function on a result asks of it."""

from __future__ import annotations

import xarray as xr

from fastcoil.arguments import instance_of
from fastcoil.errors import InputError


def check_result(ds: xr.Dataset) -> None:
    """Refuse anything but the result of a simulation or a study."""
    instance_of("ds", ds, xr.Dataset, "give a Dataset of fastcoil.simulate or open_study")
    if "status" not in ds:
        raise InputError("ds has no status: give a Dataset of fastcoil.simulate or open_study")

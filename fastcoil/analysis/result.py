"""What every function on a result asks of it."""

from __future__ import annotations

import xarray as xr

from fastcoil.errors import InputError


def check_result(ds: xr.Dataset) -> None:
    """Refuse anything but the result of a simulation or a study."""
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"ds is a {type(ds).__name__}: give a Dataset of fastcoil.simulate or open_study")
    if "status" not in ds:
        raise InputError("ds has no status: give a Dataset of fastcoil.simulate or open_study")

"""What every function on a result asks of it."""

from __future__ import annotations

import xarray as xr

from fastcoil.base.arguments import instance_of
from fastcoil.base.errors import InputError
from fastcoil.model.metric_table import METRICS

_CURE = "give a Dataset of fastcoil.simulate or open_study"


def check_result(ds: xr.Dataset) -> None:
    """Refuse anything but the result of a simulation or a study.

    Raises
    ------
    InputError
        If it is no Dataset, has no ``status``, or has something else than numbers under the name of a metric.
    """
    instance_of("ds", ds, xr.Dataset, _CURE)
    if "status" not in ds:
        raise InputError(f"ds has no status: {_CURE}")
    odd = [n for n in ("status", *METRICS) if n in ds and ds[n].dtype.kind not in "iuf"]
    if odd:
        raise InputError(f"ds has no numbers as {', '.join(odd)}: {_CURE}")

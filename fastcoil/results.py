"""Results as an xarray Dataset: names, units, provenance, one hash of the content, NetCDF on disk."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.errors import InputError, StorageError
from fastcoil.layout import Layout
from fastcoil.outputs import METRICS, STATUS_MEANINGS, TRACES, Output
from fastcoil.parameter_table import PARAMETERS

VOLATILE = (
    "date_created", "history", "command_line", "wall_time_s", "n_jobs", "scenario_days_per_s", "python_version",
    "package_versions", "platform", "content_sha256", "model_sha256", "fastcoil_version",
)  # fmt: skip
"""Attributes that may differ between two runs with the same content."""

_DIM_ATTRS = {
    "day": {"long_name": "label of the day", "units": "1"},
    "replicate": {"long_name": "replicate: number of the noise realisation", "units": "1"},
    "sample": {"long_name": "sample of the parameter space", "units": "1"},
    "volume": {"long_name": "control volume, numbered along the water", "units": "1"},
    "elapsed_time": {"long_name": "elapsed time", "units": "s"},
}
_COMPRESSION = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}


def wrap(
    layout: Layout, metrics: np.ndarray, status: np.ndarray, traces: Mapping[str, np.ndarray], trace_interval: int
) -> xr.Dataset:
    """Name everything.

    metrics: (len(METRICS), n) and status: (n,) by flat scenario index; traces: name → (n, n_points) or
    (n, N, n_points).
    """
    shape, dims = tuple(layout.sizes.values()), tuple(layout.sizes)
    ds = xr.Dataset(coords={n: c.assign_attrs(coordinate_attrs(n)) for n, c in layout.coordinates().items()})
    for k, output in enumerate(METRICS.values()):
        ds[output.name] = (dims, metrics[k].reshape(shape), attributes(output))
    flags = {"flag_values": np.arange(len(STATUS_MEANINGS), dtype=np.int8), "flag_meanings": " ".join(STATUS_MEANINGS)}
    ds["status"] = (dims, status.astype(np.int8).reshape(shape), {"long_name": "status of the scenario", **flags})
    for name, values in traces.items():
        output = TRACES[name]
        trace_dims = (*dims, "volume", "elapsed_time") if output.per_volume else (*dims, "elapsed_time")
        data = values.reshape(*shape, *values.shape[1:])
        if name == "mode":
            data = np.nan_to_num(data, nan=0.0).astype(np.int8)
        ds[name] = (trace_dims, data, attributes(output))
    if traces:
        points = trace_interval * np.arange(next(iter(traces.values())).shape[-1], dtype=float)
        ds = ds.assign_coords(elapsed_time=("elapsed_time", points, coordinate_attrs("elapsed_time")))
    if "volume" in ds.dims:
        ds = ds.assign_coords(volume=("volume", np.arange(1, ds.sizes["volume"] + 1), coordinate_attrs("volume")))
    return ds


def attributes(output: Output) -> dict[str, str]:
    """CF attributes of a result variable."""
    attrs = {"long_name": output.long_name, "units": output.unit}
    if output.difference:
        attrs["units_metadata"] = "temperature: difference"
    if output.comment:
        attrs["comment"] = output.comment
    return attrs


def coordinate_attrs(name: str) -> dict[str, str]:
    """CF attributes of a coordinate: a parameter, a reserved dimension, or a user's own."""
    if name in PARAMETERS:
        unit = PARAMETERS[name].unit
        return {"long_name": PARAMETERS[name].text} | ({"units": unit} if unit else {})
    return dict(_DIM_ATTRS.get(name, {"long_name": name}))


def provenance() -> dict[str, str]:
    """What made a result: versions and machine, no user and no path."""
    packages = {}
    for package in ("numpy", "numba", "llvmlite", "scipy", "xarray", "netCDF4"):
        try:
            packages[package] = version(package)
        except PackageNotFoundError:  # the package runs without this one
            packages[package] = "absent"
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "Conventions": "CF-1.11",
        "source": "fastcoil: closed-loop emulation of a coil valve with backlash",
        "references": "Cai, J. and Braun, J. E. (2016), Int. Refrigeration and Air Conditioning Conference, Purdue, "
        "paper 1801, https://docs.lib.purdue.edu/iracc/1801",
        "fastcoil_version": package_version(),
        "date_created": now,
        "history": f"{now} made by fastcoil {package_version()}",
        "python_version": platform.python_version(),
        "package_versions": json.dumps(packages),
        "platform": f"{sys.platform} {platform.machine()}",
    }


def package_version() -> str:
    """Version of the installed package."""
    try:
        return version("fastcoil")
    except PackageNotFoundError:  # run from a source tree that is not installed
        return "unknown"


def content_sha256(ds: xr.Dataset) -> str:
    """Hash of names, dims, values and the attributes that are not volatile: equal for equal results.

    It survives a round trip through NetCDF, where strings and attributes change their types.
    """
    digest = hashlib.sha256()
    for name in sorted(map(str, ds.variables)):
        variable = ds.variables[name]
        values = np.ascontiguousarray(variable.values)
        digest.update(f"{name} {variable.dims} {variable.shape}\n".encode())
        if values.dtype.kind in "OUS":
            digest.update("\0".join(map(str, values.ravel())).encode())
        else:
            # one NaN is as good as another, and integers may come back in another width
            digest.update(np.where(np.isnan(values), np.nan, values).astype("<f8").tobytes())
        _hash_attrs(digest, variable.attrs)
    _hash_attrs(digest, {k: v for k, v in ds.attrs.items() if k not in VOLATILE})
    return digest.hexdigest()


def _hash_attrs(digest: Any, attrs: Mapping[str, Any]) -> None:
    for key in sorted(attrs):
        value = attrs[key]
        text = str(np.asarray(value).tolist()) if not isinstance(value, str) else value
        digest.update(f"{key}={text}\n".encode())


def save(ds: xr.Dataset, path: Path) -> None:
    """Write a Dataset as NetCDF so that ``path`` is either the whole new file or what it was before.

    Raises
    ------
    StorageError
        If the file cannot be written; nothing half-written is left behind.
    """
    encoding = {
        n: dict(_COMPRESSION) for n, v in ds.variables.items() if v.dtype.kind in "fi" and v.ndim and v.size > 64
    }
    image = ds.to_netcdf(engine="netcdf4", encoding=encoding)  # in memory: a killed writer leaves no file that opens
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("xb") as file:
            file.write(image)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise StorageError(
            f"{path} cannot be written: {error.strerror}; free some space or choose another folder"
        ) from error


def load(path: Path) -> xr.Dataset:
    """Read a result into memory and check its ``content_sha256``.

    Raises
    ------
    InputError
        If there is no such file.
    StorageError
        If it cannot be read or is not what was written.
    """
    if not path.is_file():
        raise InputError(f"{path} does not exist: run the study first")
    try:
        with xr.open_dataset(path, engine="netcdf4", decode_times=False, decode_timedelta=False) as stored:
            ds = stored.load()
    except Exception as error:  # whatever the library makes of a damaged file
        raise StorageError(f"{path} cannot be read as NetCDF ({error}); delete it and run the study again") from error
    if ds.attrs.get("content_sha256") != content_sha256(ds):
        raise StorageError(
            f"{path} is not as it was written (content_sha256 differs); delete it and run the study again"
        )
    return ds

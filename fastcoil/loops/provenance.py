"""Origin of a result (versions, machine) and the hash of its content."""

import hashlib
import json
import platform
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.machine import VERSION
from fastcoil.loops.netcdf import cut_into_pieces, encode_times
from fastcoil.model.numerics.jit import numeric_environment

VOLATILE_ATTRIBUTES = (
    "date_created", "history", "command_line", "wall_time_s", "n_jobs", "scenario_days_per_s", "python_version",
    "package_versions", "platform", "content_sha256", "model_sha256", "fastcoil_version",
    "trace_sha256", "trace_file", "trace_layout", "computed_on", "engine",
    "user_code",
)  # fmt: skip
"""Attributes that may differ between two runs with the same content."""


def content_sha256(ds: xr.Dataset) -> str:
    """Hash names, dims, values and all but volatile attributes: equal for equal results, also through NetCDF."""
    return combined_sha256(ds, {str(n): variable_sha256(v) for n, v in ds.variables.items()})


def combined_sha256(ds: xr.Dataset, variables: Mapping[str, str] | None = None) -> str:
    """Combine hashes of variables, by default of ``ds`` and its traces in other files, to ``content_sha256``."""
    if variables is None:
        trace_hashes = json.loads(ds.attrs.get("trace_sha256", "{}"))
        variables = trace_hashes | {str(n): variable_sha256(v) for n, v in ds.variables.items()}
    digest = hashlib.sha256()
    for name in sorted(variables):
        digest.update(f"{name} {variables[name]}\n".encode())
    _hash_attrs(digest, {k: v for k, v in ds.attrs.items() if k not in VOLATILE_ATTRIBUTES})
    return digest.hexdigest()


def variable_sha256(variable: xr.Variable) -> str:
    """Hash dims, values and attributes of a variable; a variable on disk is read in pieces of 64 MiB."""
    digest = hashlib.sha256(f"{variable.dims} {variable.shape}\n".encode())
    for piece in cut_into_pieces(variable.shape, 2**23):
        flat = encode_times(variable[piece]).values.ravel()
        for start in range(0, flat.size, 2**16):
            chunk = flat[start : start + 2**16]
            if chunk.dtype.kind in "OUS":
                digest.update("".join(f"{v}\0" for v in chunk).encode())
            else:
                # the bits of NaN and the width of integers may change in a file
                digest.update(np.where(np.isnan(chunk), np.nan, chunk).astype("<f8").tobytes())
    _hash_attrs(digest, variable.attrs)
    return digest.hexdigest()


def _hash_attrs(digest: Any, attrs: Mapping[str, Any]) -> None:
    for key in sorted(attrs):
        text = attrs[key] if isinstance(attrs[key], str) else np.asarray(attrs[key]).tolist()
        digest.update(f"{key}={text}\n".encode())


RESULT_FORMAT = 1  # of results on disk; a file of a later one is refused
PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "xarray", "netCDF4")  # whose versions a result records


def provenance() -> dict[str, Any]:
    """Return the attributes on the origin of a result: versions and machine, no user and no path."""
    now, fastcoil_version = datetime.now(UTC).isoformat(timespec="seconds"), VERSION
    return {
        "Conventions": "CF-1.11",
        "fastcoil_format": RESULT_FORMAT,
        "source": "fastcoil: closed-loop emulation of a coil valve with backlash",
        "references": "Cai, J. and Braun, J. E. (2016), Int. Refrigeration and Air Conditioning Conference, Purdue, "
        "paper 1801, https://docs.lib.purdue.edu/iracc/1801",
        "fastcoil_version": fastcoil_version,
        "date_created": now,
        "history": f"{now} made by fastcoil {fastcoil_version}",
        "python_version": platform.python_version(),
        "package_versions": json.dumps(package_versions()),
        "platform": f"{sys.platform} {platform.machine()}",
        "computed_on": json.dumps([numeric_environment()]),
    }


@cache
def package_versions() -> dict[str, str]:
    """Return the versions of this installation by package."""
    return {package: version(package) for package in PACKAGES}


def environments_of(ds: xr.Dataset) -> list[dict[str, str]]:
    """Return the environments that computed a result, see ``numeric_environment``; an empty one if unknown."""
    try:
        environments = json.loads(ds.attrs.get("computed_on", "[{}]"))
        return [{str(k): str(v) for k, v in environment.items()} for environment in environments]
    except (ValueError, TypeError, AttributeError):  # not written by fastcoil
        return [{}]

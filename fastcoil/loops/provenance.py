"""What made a result: versions and machine, as its attributes say it."""

from __future__ import annotations

import json
import platform
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import xarray as xr

from fastcoil.base.machine import package_version
from fastcoil.model.numerics.jit import compiled_for

FORMAT = 1
"""Of results on disk; a file of a later one is refused."""


PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "xarray", "netCDF4")
"""Whose versions a result keeps."""
ABSENT = "absent"


def provenance() -> dict[str, Any]:
    """Attributes that say what made a result: versions and machine, no user and no path."""
    now, own = datetime.now(UTC).isoformat(timespec="seconds"), _own_version()
    return {
        "Conventions": "CF-1.11",
        "fastcoil_format": FORMAT,
        "source": "fastcoil: closed-loop emulation of a coil valve with backlash",
        "references": "Cai, J. and Braun, J. E. (2016), Int. Refrigeration and Air Conditioning Conference, Purdue, "
        "paper 1801, https://docs.lib.purdue.edu/iracc/1801",
        "fastcoil_version": own,
        "date_created": now,
        "history": f"{now} made by fastcoil {own}",
        "python_version": platform.python_version(),
        "package_versions": json.dumps(package_versions()),
        "platform": f"{sys.platform} {platform.machine()}",
        "computed_on": json.dumps([compiled_for()]),
    }


_own_version = cache(package_version)


@cache
def package_versions() -> dict[str, str]:
    """Versions of this installation by package."""
    packages = {}
    for package in PACKAGES:
        try:
            packages[package] = version(package)
        except PackageNotFoundError:  # the package runs without this one
            packages[package] = ABSENT
    return packages


def environments_of(ds: xr.Dataset) -> list[dict[str, str]]:
    """The environments that computed a result, see ``compiled_for``; an empty one if it does not say."""
    try:
        found = json.loads(ds.attrs.get("computed_on", "[{}]"))
        return [{str(k): str(v) for k, v in each.items()} for each in found]
    except (ValueError, TypeError, AttributeError):  # nothing that fastcoil wrote
        return [{}]

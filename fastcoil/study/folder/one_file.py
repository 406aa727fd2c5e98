"""Results by whatever a user has of them: the folder of a study, its results.nc, or a NetCDF file of its own."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.base.files import exists, is_file, is_folder
from fastcoil.loops.dataset import check_result
from fastcoil.loops.stored_file import try_reading
from fastcoil.study.folder.folder import require_no_archive
from fastcoil.study.folder.manifest import MANIFEST
from fastcoil.study.folder.result_files import RESULTS
from fastcoil.study.folder.results import open_study

_CURE = "give the folder of a study, its results.nc, or a result saved with ds.to_netcdf()"


def open_results(path: Path) -> xr.Dataset:
    """Open a result.

    Raises
    ------
    InputError
        If there is none.
    StorageError, IntegrityError
        If it cannot be read; if it is damaged.
    """
    if is_folder(path):
        return open_study(path)
    if path.name == RESULTS and exists(path.with_name(MANIFEST)):
        return open_study(path.parent)
    if not is_file(path):
        raise InputError(f"{path} does not exist: {_CURE}")
    require_no_archive(path)
    try:
        ds = try_reading(path, _CURE).load()
        check_result(ds)
    except IntegrityError:
        raise InputError(f"{path} is no NetCDF file, or it is damaged: {_CURE}") from None
    except InputError:
        raise InputError(f"{path} holds no result of fastcoil: {_CURE}") from None
    return ds

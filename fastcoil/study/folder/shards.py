"""Finished shards of a run, a file each: either whole or absent, and checked before they are used.

The name of a shard, ``FIRST-HASH.nc``, carries the SHA-256 of its bytes, so there is no list of shards that could be
torn, lost or disagree with them.
"""

import hashlib
import os
import re
import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.errors import IntegrityError, StorageError, out_of_memory
from fastcoil.base.files import (
    commit,
    entries,
    exists,
    is_folder,
    is_unfinished,
    make_folder,
    remove_unfinished,
    storage_errors,
)
from fastcoil.loops.netcdf import load, netcdf_bytes
from fastcoil.model.metric_table import METRICS, STATUS_MEANINGS, STATUS_NOT_RUN

SHARDS, QUARANTINE = "shards", "quarantine"
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
SHARD_NAME = re.compile(r"(\d{9,})-([0-9a-f]{32})\.nc")


class Inspection(NamedTuple):
    """A file among the shards: its content, or what is wrong with it."""

    path: Path
    part: xr.Dataset | None
    problem: str = ""


@dataclass(frozen=True)
class Shards:
    """The shards in the folder of a study that belong to the run ``key``."""

    folder: Path
    key: str

    @property
    def path(self) -> Path:
        return self.folder / SHARDS

    def commit(self, part: xr.Dataset) -> None:
        """Write the flat results of a shard."""
        try:
            data = netcdf_bytes(part.assign_attrs(study=self.key))
        except (OSError, RuntimeError) as error:  # no disk is involved
            raise out_of_memory(f"{self.path}: a shard cannot be made ({error})") from error
        with storage_errors(self.path, "made"):
            make_folder(self.path)
        name = f"{part['scenario'].values[0]:09d}-{hashlib.sha256(data).hexdigest()[:32]}.nc"
        commit(self.path / name, data)

    def any(self) -> bool:
        """Whether there is a file among them."""
        return bool(entries(self.path))

    def read(self, *, quarantine: bool, leave_out: Collection[str] = ()) -> Iterator[xr.Dataset]:
        """Read the sound shards, one by one, without the variables ``leave_out``, and warn of every other file.

        quarantine: move a file that is damaged, or not of this run, out of the way, so that its scenarios are
        computed again.
        """
        if quarantine and is_folder(self.path):
            remove_unfinished(self.path)
        for path, part, problem in self.inspect(leave_out):
            if part is not None:
                yield part
            elif quarantine:
                self._quarantine(path)
                warnings.warn(
                    f"{path} {problem}: moved to {QUARANTINE}/, its scenarios are computed again", stacklevel=2
                )
            else:
                warnings.warn(f"{path} {problem}: its scenarios would be computed again", stacklevel=2)

    def inspect(self, leave_out: Collection[str] = ()) -> Iterator[Inspection]:
        """Check every file among the shards; the variables ``leave_out`` are not decoded."""
        for path in entries(self.path):
            if is_unfinished(path):
                continue
            try:
                inspection = self._inspect(path, leave_out)
            except StorageError:
                if exists(path):
                    raise
                continue  # the run in progress here has finished meanwhile
            yield inspection

    def require_within(self, part: xr.Dataset, n_scenarios: int) -> None:
        """Refuse a sound shard with a scenario that the study does not have (``IntegrityError``)."""
        last = int(part["scenario"].values[-1])
        if last >= n_scenarios:
            raise IntegrityError(
                f"{self.path} holds scenario {last}, the study has {n_scenarios}: delete the folder and run again"
            )

    def discard(self) -> None:
        """Remove the shards; a foreign file among them is moved to quarantine."""
        if not is_folder(self.path):
            return
        remove_unfinished(self.path)
        with storage_errors(self.path, "removed"):
            for path in list(self.path.iterdir()):
                path.unlink() if SHARD_NAME.fullmatch(path.name) else self._quarantine(path)
            self.path.rmdir()

    def _inspect(self, path: Path, leave_out: Collection[str]) -> Inspection:
        named = SHARD_NAME.fullmatch(path.name)
        with storage_errors(path, "read"):
            if not named or (path.exists() and not path.is_file()):
                return Inspection(path, None, "is no shard")
            data = path.read_bytes()
        # before anything else: the HDF5 library may crash on damaged bytes
        if hashlib.sha256(data).hexdigest()[:32] != named[2]:
            return Inspection(path, None, "is damaged (its hash differs)")
        if not data.startswith(_SIGNATURE):
            return Inspection(path, None, "is no NetCDF file")
        try:
            part = load(data, leave_out)
        except (OSError, RuntimeError) as error:  # these are the bytes that were written
            raise out_of_memory(f"{path} is sound, and cannot be read ({error})") from error
        except ValueError:
            return Inspection(path, None, "is no NetCDF file")
        problem = self._problem(part, first=int(named[1]))
        return Inspection(path, None, problem) if problem else Inspection(path, part)

    def _problem(self, part: xr.Dataset, first: int) -> str:
        """What is wrong with the content of a shard, empty if nothing is."""
        if part.attrs.get("study") != self.key:
            return "belongs to another study or another version of the model"
        if not {"scenario", "status"} <= part.variables.keys() or part["scenario"].values[:1] != first:
            return "does not match its name"
        if not _is_flat(part):
            return "does not have the form of a shard"
        were_run = np.delete(np.arange(len(STATUS_MEANINGS)), STATUS_NOT_RUN)
        return "" if np.isin(part["status"], were_run).all() else "was never filled"

    def _quarantine(self, path: Path) -> None:
        place = self.folder / QUARANTINE
        with storage_errors(path, f"moved to {place}"):
            make_folder(place)
            names = chain([path.name], (f"{path.name}.{k}" for k in count(2)))
            os.replace(path, next(place / name for name in names if not (place / name).exists()))


def _is_flat(part: xr.Dataset) -> bool:
    """Whether a part has ascending scenarios, one status each, and metrics that are numbers."""
    index, status = part["scenario"], part["status"]
    if index.dtype.kind not in "iu" or status.dtype.kind not in "iu" or status.dims != ("scenario",):
        return False
    if index.size == 0 or int(index.values[0]) < 0 or not (np.diff(index.values) > 0).all():
        return False
    return all(part[n].dims == ("scenario",) and part[n].dtype == float for n in METRICS if n in part.data_vars)

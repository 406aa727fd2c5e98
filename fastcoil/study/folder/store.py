"""The folder of a study: one writer at a time, and shards that are either whole or not there.

::

    study.toml     the text that is run, verbatim
    run.json       what the run was begun with: hashes, and where relative paths start
    shards/        FIRST-HASH.nc, a file for each finished shard, until all of them are in results.nc
    quarantine/    files that were not what they should be
    results.nc     metrics and status, named and labelled
    traces-ID.nc   the traces, if any are asked for; ``trace_file`` in the attributes of results.nc names it
    figures/

The name of a shard carries the SHA-256 of its bytes, so there is no list of shards that could be torn, lost or
disagree with them.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path

import netCDF4
import numpy as np
import xarray as xr
from filelock import FileLock, Timeout

from fastcoil.errors import InputError, IntegrityError, LockedError, StorageError
from fastcoil.files import commit, is_unfinished, remove_unfinished, reported
from fastcoil.outputs import STATUS_MEANINGS, STATUS_NOT_RUN
from fastcoil.simulation.dataset import image

RESULTS, STUDY, BEGUN = "results.nc", "study.toml", "run.json"
SHARDS, QUARANTINE = "shards", "quarantine"
_LOCK, _HOLDER = ".lock", ".holder"
_SHARD_NAME = re.compile(r"(\d{9,})-([0-9a-f]{32})\.nc")

FORMAT = 1
"""Of the folder; another one is refused."""


@dataclass(frozen=True)
class Begun:
    """What a run was begun with.  ``relative_to``: folder from which the study's relative paths start."""

    study_sha256: str
    boundary_sha256: str
    model_sha256: str
    relative_to: str
    format: int = FORMAT

    @property
    def key(self) -> str:
        """Of the shards that belong to this run."""
        return hashlib.sha256(f"{self.format} {self.study_sha256} {self.model_sha256}".encode()).hexdigest()


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder for one writer; one that was made and stayed empty is removed again.

    Raises
    ------
    LockedError
        If another process holds it; the operating system frees it when that process ends, however it ends.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file: choose another folder with -o")
    try:
        str(folder.absolute()).encode()
    except UnicodeEncodeError:  # the NetCDF library refuses it, after everything was run
        raise InputError(f"{str(folder)!r} is not UTF-8: choose another folder with -o") from None
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    lock = FileLock(folder / _LOCK)
    try:
        with reported(folder, "written"):
            folder.mkdir(parents=True, exist_ok=True)
            _acquire(lock, folder)
            now = datetime.now(UTC).isoformat(timespec="seconds")
            holder = f"process {os.getpid()} on {platform.node()} since {now}"
            (folder / _HOLDER).write_text(holder, encoding="utf-8")
        remove_unfinished(folder)
        yield
    finally:
        if lock.is_locked:
            with suppress(OSError):  # whatever is left is in nobody's way
                (folder / _HOLDER).unlink(missing_ok=True)
                if made and [p.name for p in folder.iterdir()] == [_LOCK]:
                    (folder / _LOCK).unlink()
            lock.release()
        with suppress(OSError):  # one that is not empty stays
            for path in made:
                path.rmdir()


def _acquire(lock: FileLock, folder: Path) -> None:
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise LockedError(
            f"{folder} is in use by {_holder(folder)}: wait for it, or choose another folder with -o"
        ) from None
    except NotImplementedError:
        raise StorageError(f"{folder} is on a file system without locks: choose another folder with -o") from None


def in_use(folder: Path) -> str | None:
    """Who is writing to the folder, in words, or ``None``."""
    if not (folder / _LOCK).exists():
        return None
    lock = FileLock(folder / _LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return _holder(folder)
    except (OSError, NotImplementedError):  # nobody can write here
        return None
    lock.release()
    return None


def _holder(folder: Path) -> str:
    try:
        return f"another run ({(folder / _HOLDER).read_text(encoding='utf-8')})"
    except OSError:
        return "another run"


def begun(folder: Path) -> Begun | None:
    """What lies in ``run.json``, or ``None`` if nothing was begun here.

    Raises
    ------
    IntegrityError
        If it cannot be understood.
    """
    path = folder / BEGUN
    if not path.exists():
        return None
    try:
        with reported(path, "read"):
            text = path.read_bytes()
        found = json.loads(text)
        if found.get("format", 0) != FORMAT:
            raise IntegrityError(
                f"{folder} was written by another version of fastcoil (format {found.get('format')}, this one writes "
                f"{FORMAT}): use that version, or choose another folder with -o"
            )
        return Begun(**found)
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise IntegrityError(f"{path} is damaged ({error}): choose another folder with -o, or delete it") from error


def begin(folder: Path, run: Begun, text: str) -> None:
    """Write what is begun, before its first shard."""
    # in this order: if it is killed in between, the same command finds its own run, and writes the text again
    commit(folder / BEGUN, (json.dumps(asdict(run), indent=1) + "\n").encode())
    commit(folder / STUDY, text.encode())


def begun_text(folder: Path) -> str | None:
    """The text that was begun, or ``None`` where it is missing or cannot be understood."""
    try:
        with reported(folder / STUDY, "read"):
            return (folder / STUDY).read_bytes().decode()
    except UnicodeDecodeError:
        return None
    except StorageError:
        if (folder / STUDY).exists():
            raise
        return None


def commit_shard(folder: Path, part: xr.Dataset, key: str) -> None:
    """Keep the results of a shard (flat, see ``results.flat``) for good."""
    data = image(part.assign_attrs(study=key), compressed=False)  # it does not live long
    shards = folder / SHARDS
    with reported(shards, "made"):
        shards.mkdir(exist_ok=True)
    name = f"{part['scenario'].values[0]:09d}-{hashlib.sha256(data).hexdigest()[:32]}.nc"
    commit(shards / name, data)


def committed(folder: Path, key: str, *, mend: bool = True) -> Iterator[xr.Dataset]:
    """The shards of a run, one by one.

    A file that is damaged, or not of this run, is moved to ``quarantine/`` with a warning, so that its scenarios are
    computed again; where ``mend`` is false it is only warned of.
    """
    if mend and (folder / SHARDS).is_dir():
        remove_unfinished(folder / SHARDS)
    for path, part in inspected(folder, key):
        if isinstance(part, xr.Dataset):
            yield part
        elif mend:
            _set_aside(folder, path)
            warnings.warn(f"{path} {part}: moved to {QUARANTINE}/, its scenarios are computed again", stacklevel=2)
        else:
            warnings.warn(f"{path} {part}: its scenarios would be computed again", stacklevel=2)


def inspected(folder: Path, key: str) -> Iterator[tuple[Path, xr.Dataset | str]]:
    """Every file among the shards: its content, or what is wrong with it."""
    for path in sorted((folder / SHARDS).glob("*")):
        if is_unfinished(path):
            continue
        try:
            part = _opened(path, key)
        except StorageError:
            if path.exists():
                raise
            continue  # the run that is going on here has finished meanwhile
        yield path, part


def discard_shards(folder: Path) -> None:
    """Remove the shards: all of them are in ``results.nc``."""
    shards = folder / SHARDS
    if not shards.is_dir():
        return
    remove_unfinished(shards)
    with reported(shards, "removed"):
        for path in list(shards.iterdir()):
            path.unlink() if _SHARD_NAME.fullmatch(path.name) else _set_aside(folder, path)
        shards.rmdir()


def _opened(path: Path, key: str) -> xr.Dataset | str:
    """A shard, or what is wrong with it."""
    named = _SHARD_NAME.fullmatch(path.name)
    if not named or path.is_dir():
        return "is no shard"
    with reported(path, "read"):
        data = path.read_bytes()
    # before anything else: the HDF5 library may crash on damaged bytes
    if hashlib.sha256(data).hexdigest()[:32] != named[2]:
        return "is not as it was written"
    try:
        with netCDF4.Dataset(path.name, memory=data) as file:
            stored = xr.backends.NetCDF4DataStore(file)  # type: ignore[no-untyped-call]
            part = xr.open_dataset(stored, decode_times=False, decode_timedelta=False).load()
    except (OSError, RuntimeError, ValueError):  # whatever the library makes of something else
        return "is no NetCDF file"
    return _problem(part, key, int(named[1])) or part


def _problem(part: xr.Dataset, key: str, first: int) -> str | None:
    if part.attrs.get("study") != key:
        return "belongs to another study or another version of the model"
    if not {"scenario", "status"} <= part.variables.keys() or part["scenario"].values[:1] != first:
        return "is not what its name says"
    were_run = np.delete(np.arange(len(STATUS_MEANINGS)), STATUS_NOT_RUN)
    return None if np.isin(part["status"], were_run).all() else "was never filled"


def _set_aside(folder: Path, path: Path) -> None:
    quarantine = folder / QUARANTINE
    with reported(path, f"moved to {quarantine}"):
        quarantine.mkdir(exist_ok=True)
        names = chain([path.name], (f"{path.name}.{k}" for k in count(2)))
        os.replace(path, next(quarantine / name for name in names if not (quarantine / name).exists()))

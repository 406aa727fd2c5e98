"""The final files of a study, ``results.nc`` and the file of traces: written, opened and checked.

``run.json`` has the SHA-256 of each: of a new file before its name points to it, next to that of the file it replaces.
So a run that is killed at any moment leaves files with hashes that are recorded.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import xarray as xr

from fastcoil.base.errors import FastcoilError, InputError, IntegrityError, StorageError, shown
from fastcoil.base.files import commit_written, exists
from fastcoil.loops.netcdf import StoredFile, file_sha256, open_lazily, try_reading, write
from fastcoil.loops.provenance import FORMAT, combined_sha256, environments_of, variable_sha256
from fastcoil.loops.scenarios import check_result
from fastcoil.model.metric_table import TRACES
from fastcoil.study.folder.manifest import Manifest

RESULTS = "results.nc"
TRACE_FILES = "traces-*.nc"
WORDS = ("title", "summary", "study_toml")
"""Attributes of a study that no scenario depends on."""
_CURES = {True: "delete it and run the study again", False: f"delete {RESULTS} and run the study again"}
"""What to do about a damaged file, by whether it has the results."""


def publish(path: Path, write: Callable[[Path], object], manifest: Manifest) -> Manifest:
    """Write a final file, or replace it; ``write`` gets the name to use.  Returns the manifest with its hash."""
    recorded = manifest

    def record(unfinished: Path) -> None:
        nonlocal recorded
        known = manifest.outputs.get(path.name, ())
        kept = [found for found in known if path.exists() and found == file_sha256(path)]
        new = file_sha256(unfinished)
        hashes = [new, *(found for found in kept if found != new)]
        recorded = replace(manifest, outputs={**manifest.outputs, path.name: hashes}, finished=False)
        recorded.write(path.parent)

    commit_written(path, write, record)
    return recorded


def open_final(folder: Path, manifest: Manifest | None) -> xr.Dataset:
    """Open the results in a folder, checked against their hashes; traces stay on the disk until they are asked for.

    Raises
    ------
    InputError
        If there are none, or a later version of fastcoil wrote them.
    StorageError, IntegrityError
        If a file cannot be read; if its content is not what was written.
    """
    path = folder / RESULTS
    if not exists(path):
        raise InputError(f"{path} does not exist: run the study first")
    ds = _stored(path, manifest).load()
    try:
        if int(ds.attrs.get("fastcoil_format", 0)) > FORMAT:
            raise InputError(f"{path} was written by a later version of fastcoil: open it with that version")
        if ds.attrs.get("content_sha256") != combined_sha256(ds):
            raise IntegrityError(f"{path} is damaged (content_sha256 differs); {_CURES[True]}")
    except (ValueError, TypeError) as error:
        if isinstance(error, FastcoilError):
            raise
        raise IntegrityError(f"{path} cannot be understood ({error}); {_CURES[True]}") from error
    try:
        check_result(ds)
    except InputError:
        raise IntegrityError(
            f"{path} is no result of a study (its status or metrics are missing, or no numbers); {_CURES[True]}"
        ) from None
    return add_traces(ds, folder, manifest)


def add_traces(ds: xr.Dataset, folder: Path, manifest: Manifest | None) -> xr.Dataset:
    """Add to the results their traces, which stay on the disk until they are asked for; raises as ``open_final``."""
    file = trace_file(ds, folder, manifest)
    if file is None:
        return ds
    file.identity()  # it is there
    opened = ds.assign(open_lazily(file, json.loads(ds.attrs["trace_layout"])).data_vars)
    problems = [] if manifest else find_variable_problems(opened, file.path)  # without the hash of the whole file
    if problems:
        raise IntegrityError("\n".join(problems))
    return opened


def trace_file(ds: xr.Dataset, folder: Path, manifest: Manifest | None) -> StoredFile | None:
    """The file with the traces of the results ``ds``, if they have any."""
    if "trace_file" not in ds.attrs:
        return None
    name = str(ds.attrs["trace_file"])
    if not fnmatchcase(name, TRACE_FILES) or Path(name).name != name:
        raise IntegrityError(f"{folder / RESULTS} names traces in {shown(name)}, which holds none; {_CURES[True]}")
    return _stored(folder / name, manifest)


def reworded(ds: xr.Dataset, attrs: Mapping[str, Any], folder: Path, manifest: Manifest) -> tuple[xr.Dataset, Manifest]:
    """Write the complete results ``ds`` again with other words about the same study: title, question, text.

    attrs: the words.  Traces stay as they are.  Returns the results and their manifest.
    """
    plain = ds.drop_vars([name for name in ds.data_vars if name in TRACES]).load().assign_attrs(attrs)
    plain.attrs["content_sha256"] = combined_sha256(plain)
    recorded = publish(folder / RESULTS, lambda unfinished: write(plain, unfinished, mode="w"), manifest)
    result = add_traces(plain, folder, recorded)
    return result, finished_manifest(result, folder, recorded)


def find_variable_problems(ds: xr.Dataset, path: Path) -> list[str]:
    """What is wrong with the values of the traces in ``path``, a sentence each; reads all of them."""
    problems = []
    for name, digest in json.loads(ds.attrs.get("trace_sha256", "{}")).items():
        try:
            same = name in ds.variables and variable_sha256(ds[name].variable) == digest
        except (StorageError, MemoryError):
            raise
        except Exception:  # damaged bytes may raise anything in the library
            same = False
        if not same:
            problems.append(f"{path}: {name} is damaged (its hash differs); {_CURES[False]}")
    return problems


def find_problems(ds: xr.Dataset, folder: Path, manifest: Manifest) -> list[str]:
    """What is wrong with the results ``ds`` and their traces, a sentence each; hashes and reads all of them."""
    problems = []
    for file in filter(None, (_stored(folder / RESULTS, manifest), trace_file(ds, folder, manifest))):
        try:
            file.check(afresh=True)
        except IntegrityError as error:
            problems.append(str(error))
    return problems or find_variable_problems(ds, folder / ds.attrs.get("trace_file", RESULTS))


def finished_manifest(ds: xr.Dataset, folder: Path, manifest: Manifest) -> Manifest:
    """The manifest of a study whose complete results are ``ds``, with the hashes of their files."""
    files = [_stored(folder / RESULTS, manifest), trace_file(ds, folder, manifest)]
    outputs = {file.path.name: [file.check()] for file in files if file is not None}
    own_code = json.loads(ds.attrs.get("own_code", "{}"))
    return replace(manifest, outputs=outputs, computed_on=environments_of(ds), finished=True, own_code=own_code)


def _stored(path: Path, manifest: Manifest | None) -> StoredFile:
    """A final file by its recorded hash; without one, as where ``run.json`` was lost, a child process tries it."""
    accepted, cure = manifest.outputs.get(path.name) if manifest else None, _CURES[path.name == RESULTS]
    return StoredFile(path, accepted, cure) if accepted else try_reading(path, cure)

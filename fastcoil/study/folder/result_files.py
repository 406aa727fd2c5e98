"""The final files of a study, ``results.nc`` and the file of traces: written, opened and checked.

``run.json`` has the SHA-256 of each: of a new file before its name points to it, next to that of the file it replaces.
So a run that is killed at any moment leaves files with hashes that are recorded.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.errors import FastcoilError, InputError, IntegrityError, StorageError, shown
from fastcoil.base.files import commit_written, exists
from fastcoil.loops.netcdf import CLOCK, write
from fastcoil.loops.provenance import FORMAT, combined_sha256, environments_of, variable_sha256
from fastcoil.loops.stored_file import StoredFile, file_sha256, open_lazily, try_reading
from fastcoil.model.metric_table import METRICS, STATUS_MEANINGS, TRACES
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.folder.manifest import Manifest

_LONGEST_TITLE = 2**20
"""Characters; that of a whole study file."""
_TEXTS = ("study_toml", "study_sha256", "model_sha256", "engine", "trace_file", "trace_sha256", "trace_layout")
_SPEED = ("wall_time_s", "n_jobs", "scenario_days_per_s")
"""Attributes that may be absent."""


def malformed(ds: xr.Dataset) -> list[str]:
    """Names of the attributes, metrics, coordinates and other variables that no result of a study has like this."""
    checks: tuple[Callable[[xr.Dataset], Iterator[str]], ...] = (_attributes, _status, _metrics, _labels, _answers)
    return [name for check in checks for name in check(ds)]


def _attributes(ds: xr.Dataset) -> Iterator[str]:
    title = ds.attrs.get("title")
    if not isinstance(title, str) or len(title) > _LONGEST_TITLE:
        yield "title"
    yield from (name for name in _TEXTS if not isinstance(ds.attrs.get(name, ""), str))
    if any(name in ds.attrs for name in _SPEED):
        yield from (name for name in _SPEED if not isinstance(ds.attrs.get(name), Real))
    if not isinstance(_parsed(ds, "parameters"), dict):
        yield "parameters"
    for name in ("rules", "own_code"):
        if name in ds.attrs and not _is_table_of_texts(_parsed(ds, name)):
            yield name
    days = _parsed(ds, "day_sha256")
    if not isinstance(days, list) or len(days) != ds["status"].sizes.get("day", 1):
        yield "day_sha256"


def _parsed(ds: xr.Dataset, name: str) -> Any:
    try:
        return json.loads(ds.attrs[name])
    except (KeyError, TypeError, ValueError, RecursionError):
        return None


def _is_table_of_texts(value: Any) -> bool:
    """Whether it is name → name → text, as what is written of a study's own rules."""
    return isinstance(value, dict) and all(
        isinstance(each, dict) and all(isinstance(text, str) for text in each.values()) for each in value.values()
    )


def _status(ds: xr.Dataset) -> Iterator[str]:
    status = ds["status"]
    if status.dtype.kind not in "iu" or not np.isin(status.values, np.arange(len(STATUS_MEANINGS))).all():
        yield "status"


def _metrics(ds: xr.Dataset) -> Iterator[str]:
    known = [name for name in METRICS if name in ds.data_vars]  # an older version wrote fewer
    yield from (name for name in known if ds[name].dims != ds["status"].dims or ds[name].dtype != float)
    if "rmse" not in known:
        yield "rmse"


def _labels(ds: xr.Dataset) -> Iterator[str]:
    """Labels of every dimension of the status; what is swept along them, and labels of further dimensions."""
    dims = ds["status"].dims
    yield from (str(dim) for dim in dims if dim not in ds.coords)
    for name, label in ds.coords.items():
        kind, parameter = _kind(label.values), PARAMETERS.get(str(name))
        expected = "d" if name in CLOCK else "nt" if parameter is None else "t" if parameter.is_word else "n"
        placed = label.dims == (name,) or set(label.dims) <= set(dims)  # a rule's own parameters are in no table
        placed |= name == "time" and label.dims == ("elapsed_time",)
        if not placed or kind not in expected or (name in dims and not _tell_apart(label.values, kind)):
            yield str(name)


def _kind(values: np.ndarray) -> str:
    """``n`` for numbers, ``t`` for text, ``d`` for dates, ``?`` for anything else."""
    if values.dtype.kind in "iufM":
        return "d" if values.dtype.kind == "M" else "n"
    is_text = values.dtype.kind == "U" or all(isinstance(value, str) for value in values.ravel())
    return "t" if is_text else "?"


def _tell_apart(labels: np.ndarray, kind: str) -> bool:
    return np.unique(labels).size == labels.size and (kind == "t" or bool(np.isfinite(labels).all()))


def _answers(ds: xr.Dataset) -> Iterator[str]:
    """Traces, and what a function of the user returned."""
    dims = ds["status"].dims
    for name, variable in ds.data_vars.items():
        if name != "status" and (variable.dims[: len(dims)] != dims or variable.dtype.kind not in "biuf"):
            yield str(name)


RESULTS = "results.nc"
TRACE_FILES = "traces-*.nc"
WORDS = ("title", "summary", "study_toml")
"""Attributes that tell of a study what no scenario depends on."""
_CURES = {True: "delete it and run the study again", False: f"delete {RESULTS} and run the study again"}
"""What to do about a damaged file, by whether it has the results."""
_MOST_NAMES = 5
_sound: set[str] = set()
"""SHA-256 of files without a recorded one whose content was checked."""


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
    try:
        ds = _stored(path, manifest).load()
        if int(ds.attrs.get("fastcoil_format", 0)) > FORMAT:
            raise InputError(f"{path} was written by a later version of fastcoil: open it with that version")
        if ds.attrs.get("content_sha256") != combined_sha256(ds) or "status" not in ds:
            raise IntegrityError(f"{path} is damaged (content_sha256 differs); {_CURES[True]}")
        wrong = malformed(ds)
        if wrong:
            names = ", ".join(wrong[:_MOST_NAMES])
            raise IntegrityError(f"{path} is no result of a study: {names} is missing or damaged; {_CURES[True]}")
        return add_traces(ds, folder, manifest)
    except (FastcoilError, MemoryError):
        raise
    except Exception as error:  # attributes that no version of fastcoil wrote may raise anything
        raise IntegrityError(f"{path} cannot be understood ({error}); {_CURES[True]}") from error


def add_traces(ds: xr.Dataset, folder: Path, manifest: Manifest | None) -> xr.Dataset:
    """Add to the results their traces, which stay on the disk until they are asked for; raises as ``open_final``."""
    file = trace_file(ds, folder, manifest)
    if file is None:
        return ds
    file.identity()  # it is there
    traces = open_lazily(file, json.loads(ds.attrs["trace_layout"]))
    opened = ds.assign(traces.data_vars)
    if manifest is None or not manifest.outputs.get(file.path.name):
        sha256 = file.check()
        problems = [] if sha256 in _sound else find_variable_problems(opened, file.path)
        if problems:
            raise IntegrityError("\n".join(problems))
        _sound.add(sha256)
    return opened


def trace_file(ds: xr.Dataset, folder: Path, manifest: Manifest | None) -> StoredFile | None:
    """The file with the traces of the results ``ds``, if they have any."""
    name = ds.attrs.get("trace_file")
    if name is None:
        return None
    if not fnmatchcase(name, TRACE_FILES) or Path(name).name != name:
        raise IntegrityError(f"{folder / RESULTS} names traces in {shown(name)}, which holds none; {_CURES[True]}")
    return _stored(folder / name, manifest)


def reworded(ds: xr.Dataset, attrs: Mapping[str, Any], folder: Path, manifest: Manifest) -> tuple[xr.Dataset, Manifest]:
    """Write the complete results ``ds`` again with other words about the same study: title, question, text.

    attrs: the words.  Traces stay as they are.  Returns the results and their manifest.
    """
    path = folder / RESULTS
    plain = ds.drop_vars([name for name in ds.data_vars if name in TRACES]).load().assign_attrs(attrs)
    plain.attrs["content_sha256"] = combined_sha256(plain)
    recorded = publish(path, lambda unfinished: write(plain, unfinished, mode="w"), manifest)
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
    accepted, cure = manifest.outputs.get(path.name) if manifest else None, _CURES[path.name == RESULTS]
    return StoredFile(path, accepted, cure) if accepted else try_reading(path, cure)

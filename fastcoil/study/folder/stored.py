"""The files of a study that carry a hash: ``run.json``, the shards, ``results.nc`` and the file of traces.

Each is whole or absent, and its bytes are compared with their hash before a library parses them.  ``run.json`` has the
SHA-256 of the final files, while one is replaced also that of the new one; the name of a shard has its own.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from fnmatch import fnmatchcase
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from pydantic import TypeAdapter, ValidationError

from fastcoil.base import files
from fastcoil.base.errors import InputError, IntegrityError, StorageError, out_of_memory_error, short_repr
from fastcoil.base.machine import retry_while_locked
from fastcoil.loops.netcdf import StoredFile, load, netcdf_bytes, open_lazily, probe_file
from fastcoil.loops.plan import simulation_attributes
from fastcoil.loops.provenance import RESULT_FORMAT, combined_sha256, environments_of, provenance, variable_sha256
from fastcoil.loops.scenarios import check_result
from fastcoil.model.user_rules import RuleHashes
from fastcoil.study.file.spec import Study

MANIFEST_FILE = "run.json"
RESULTS_FILE = "results.nc"
TRACE_FILE_PATTERN = "traces-*.nc"
SHARDS_FOLDER = "shards"
QUARANTINE_FOLDER = "quarantine"
SHARD_NAME_PATTERN = re.compile(r"(\d{9,})-([0-9a-f]{32})\.nc")
_FOLDER_FORMAT = 2  # no other one is read
_CHECKSUM_KEY = "sha256"
_MAX_MANIFEST_BYTES = 2**20
_MAX_LOADED_BYTES = 2**28  # metrics of two million scenarios; more stay on the disk as traces do
_RESULTS_CURE = "move it away and run the study again"
_TRACES_CURE = f"move {RESULTS_FILE} away and run the study again"


# --- run.json ---------------------------------------------------------------------------------------------------------


Environment = Mapping[str, str]
"""What the bits of a result depend on besides the sources, see ``numeric_environment``."""


@dataclass(frozen=True)
class Manifest:
    """What a run computes, by which two runs are compared, and what is known of it so far."""

    study_sha256: str
    boundary_sha256: str
    model_sha256: str
    relative_to: str  # folder from which the study's relative paths start
    computed_on: Sequence[Environment] = field(default=(), compare=False)  # all that computed a part of it
    # for each final file the SHA-256 that its bytes may have, the newest first; two while a file is being replaced
    outputs: Mapping[str, Sequence[str]] = field(default_factory=dict, compare=False)
    finished: bool = field(default=False, compare=False)  # whether the results are complete
    user_code: RuleHashes = field(default_factory=dict, compare=False)  # of the rules, as they were compiled

    @property
    def key(self) -> str:
        """The name by which shards belong to this run."""
        return hashlib.sha256(f"1 {self.study_sha256} {self.model_sha256}".encode()).hexdigest()

    @classmethod
    def read(cls, folder: Path) -> Manifest | None:
        """Read ``run.json``; ``None`` if there is none, ``IntegrityError`` if it is damaged or of another format."""
        path = folder / MANIFEST_FILE
        if not files.exists(path):
            return None
        try:
            with files.convert_os_errors(path, "read"):
                data = files.read_bytes(path, _MAX_MANIFEST_BYTES)
            content = json.loads(data)
            folder_format = content.pop("format", 0)
            if folder_format != _FOLDER_FORMAT and isinstance(folder_format, int):
                raise IntegrityError(
                    f"{folder} was written by another version of fastcoil (format {folder_format}, this one reads and "
                    f"writes {_FOLDER_FORMAT}): use that version, or choose another folder with -o"
                )
            if content.pop(_CHECKSUM_KEY, None) != checksum(content):
                raise ValueError("its checksum differs")
            return TypeAdapter(cls).validate_json(json.dumps(content), strict=True)
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            reason = "it has values of the wrong type" if isinstance(error, ValidationError) else error
            cure = f"{_RESULTS_CURE}, or choose another folder with -o"
            raise IntegrityError(f"{path} is damaged ({reason}): {cure}") from error

    @property
    def text(self) -> str:
        content = asdict(self)
        return json.dumps({**content, "format": _FOLDER_FORMAT, _CHECKSUM_KEY: checksum(content)}, indent=1) + "\n"

    def write(self, folder: Path) -> None:
        files.write_atomically(folder / MANIFEST_FILE, self.text.encode())


def checksum(content: Mapping[str, Any]) -> str:
    """SHA-256 of a table, which reveals a later change of it."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def study_attributes(study: Study, manifest: Manifest, measured: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """All attributes of the results of a study: provenance, settings, which study it is, and what the run measured."""
    attrs = {
        "title": study.title,
        **provenance(),
        **simulation_attributes(study.plan),
        "summary": study.question,
        "study_toml": study.text,
        "study_sha256": study.sha256,
        "model_sha256": manifest.model_sha256,
        "computed_on": json.dumps(list(manifest.computed_on)),
    }
    traces = study.plan.traces
    if traces.names:
        attrs["traces"] = f"{', '.join(traces.names)} every {traces.interval} s"
    if study.reduction:
        attrs |= {"reduction": study.reduction.name, "reduction_sha256": study.reduction.sha256}
    if study.rules:
        attrs["rules"] = json.dumps({n: {"code": s.name, "sha256": s.sha256} for n, s in sorted(study.rules.items())})
    if study.precision:
        attrs["precision"] = study.precision.text
    if manifest.user_code:
        attrs["user_code"] = json.dumps(manifest.user_code)
    return attrs | dict(measured or {})


# --- shards -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shards:
    """The shards in the folder of a study that belong to the run ``key``."""

    folder: Path
    key: str

    @property
    def path(self) -> Path:
        return self.folder / SHARDS_FOLDER

    def commit(self, part: xr.Dataset) -> None:
        """Write the flat results of a shard."""
        try:
            data = netcdf_bytes(part.assign_attrs(study=self.key))
        except (OSError, RuntimeError) as error:  # no disk is involved
            raise out_of_memory_error(f"{self.path}: a shard cannot be made ({error})") from error
        with files.convert_os_errors(self.path, "made"):
            files.make_folder(self.path)
        name = f"{part['scenario'].values[0]:09d}-{hashlib.sha256(data).hexdigest()[:32]}.nc"
        files.write_atomically(self.path / name, data)

    def read(
        self, *, quarantine: bool, leave_out: Collection[str] = (), scenarios: np.ndarray | None = None
    ) -> Iterator[xr.Dataset]:
        """Read the sound shards, one by one, without the variables ``leave_out``, and warn of every other file.

        quarantine: move a file that is damaged, or not of this run, out of the way, so that its scenarios are
        computed again.  scenarios: only shards that begin with one of these.
        """
        if quarantine and files.is_folder(self.path):
            files.remove_temporary_files(self.path)
        for path, part, problem in self.inspect(leave_out, scenarios):
            if part is not None:
                yield part
                continue
            if quarantine:
                self._quarantine(path)
            action = f"moved to {QUARANTINE_FOLDER}/, its scenarios are" if quarantine else "its scenarios would be"
            warnings.warn(f"{path} {problem}: {action} computed again", stacklevel=2)

    def inspect(
        self, leave_out: Collection[str] = (), scenarios: np.ndarray | None = None
    ) -> Iterator[tuple[Path, xr.Dataset | None, str]]:
        """Every file among the shards: its content without the variables ``leave_out``, or what is wrong with it."""
        for path in files.list_folder(self.path):
            match = SHARD_NAME_PATTERN.fullmatch(path.name)
            if files.is_temporary_file(path) or (scenarios is not None and not (match and int(match[1]) in scenarios)):
                continue
            try:
                part_and_problem = self._inspect_file(path, leave_out)
            except StorageError:
                if files.exists(path):
                    raise
                continue  # the run in progress here has finished meanwhile
            yield path, *part_and_problem

    def discard(self) -> None:
        """Remove the shards; a foreign file among them is moved to quarantine."""
        if not files.is_folder(self.path):
            return
        files.remove_temporary_files(self.path)
        with files.convert_os_errors(self.path, "removed"):
            for path in list(self.path.iterdir()):
                retry_while_locked(path.unlink) if SHARD_NAME_PATTERN.fullmatch(path.name) else self._quarantine(path)
            retry_while_locked(self.path.rmdir)

    def _inspect_file(self, path: Path, leave_out: Collection[str]) -> tuple[xr.Dataset | None, str]:
        match = SHARD_NAME_PATTERN.fullmatch(path.name)
        with files.convert_os_errors(path, "read"):
            if not match or (path.exists() and not path.is_file()):
                return None, "is not a shard"
            data = path.read_bytes()
        # before anything else: the HDF5 library may crash on damaged bytes
        if hashlib.sha256(data).hexdigest()[:32] != match[2]:
            return None, "is damaged (its hash differs)"
        try:
            part = load(data, leave_out)
        except (OSError, RuntimeError) as error:  # these are the bytes that were written
            raise out_of_memory_error(f"{path} is sound, and cannot be read ({error})") from error
        if part.attrs.get("study") != self.key:
            return None, "belongs to another study or another version of the model"
        return part, ""

    def _quarantine(self, path: Path) -> None:
        place = self.folder / QUARANTINE_FOLDER
        with files.convert_os_errors(path, f"moved to {place}"):
            files.make_folder(place)
            names = chain([path.name], (f"{path.name}.{k}" for k in count(2)))
            free = next(place / name for name in names if not (place / name).exists())
            retry_while_locked(lambda: os.replace(path, free))


# --- final files ------------------------------------------------------------------------------------------------------


def open_final_results(folder: Path, manifest: Manifest | None) -> xr.Dataset:
    """Open the results in a folder, checked against their hashes; traces stay on the disk until they are read.

    ``InputError`` if there are none, or of a later version; ``StorageError``; ``IntegrityError`` if a file was changed.
    """
    path = folder / RESULTS_FILE
    if not files.exists(path):
        raise InputError(f"{path} does not exist: run the study first", str(path), "path")
    ds = _final_file(path, manifest).load(_MAX_LOADED_BYTES)
    try:
        is_later = int(ds.attrs.get("fastcoil_format", 0)) > RESULT_FORMAT
        is_damaged = not is_later and ds.attrs.get("content_sha256") != combined_sha256(ds)
        if not is_later and not is_damaged:
            check_result(ds)
    except (ValueError, TypeError) as error:
        reason = "its status or metrics are missing, or no numbers"
        raise IntegrityError(f"{path} is not a result of a study ({reason}); {_RESULTS_CURE}") from error
    if is_later:
        sentence = f"{path} was written by a later version of fastcoil: open it with that version"
        raise InputError(sentence, str(path), "format")
    if is_damaged:
        raise IntegrityError(f"{path} is damaged (content_sha256 differs); {_RESULTS_CURE}")
    file = _trace_file(ds, folder, manifest)
    if file is None:
        return ds
    file.identity()  # it is there
    opened = with_traces(ds, file.path, file.accepted)
    problems = [] if manifest else find_variable_problems(opened, file.path)  # without the hash of the whole file
    if problems:
        raise IntegrityError("\n".join(problems))
    return opened


def with_traces(ds: xr.Dataset, path: Path, accepted: Collection[str]) -> xr.Dataset:
    """Return the results with the traces in ``path``, whose SHA-256 is ``accepted``, left there until they are read."""
    file = StoredFile(path, accepted, _TRACES_CURE)
    return ds.assign(open_lazily(file, json.loads(ds.attrs["trace_layout"])).data_vars)


def _trace_file(ds: xr.Dataset, folder: Path, manifest: Manifest | None) -> StoredFile | None:
    """The file with the traces of the results ``ds``, if they have any."""
    if "trace_file" not in ds.attrs:
        return None
    name = str(ds.attrs["trace_file"])
    if not fnmatchcase(name, TRACE_FILE_PATTERN) or Path(name).name != name:
        sentence = f"{folder / RESULTS_FILE} names traces in {short_repr(name)}, which holds none"
        raise IntegrityError(f"{sentence}; {_RESULTS_CURE}")
    return _final_file(folder / name, manifest)


def find_variable_problems(ds: xr.Dataset, path: Path) -> list[str]:
    """Compare the values of the traces in ``path`` with their hashes; a sentence for each that differs."""
    problems = []
    for name, digest in json.loads(ds.attrs.get("trace_sha256", "{}")).items():
        try:
            same = name in ds.variables and variable_sha256(ds[name].variable) == digest
        except (StorageError, MemoryError):
            raise
        except Exception:  # damaged bytes may raise anything in the library
            same = False
        if not same:
            problems.append(f"{path}: {name} is damaged (its hash differs); {_TRACES_CURE}")
    return problems


def find_problems(ds: xr.Dataset, folder: Path, manifest: Manifest) -> list[str]:
    """Hash and read the results ``ds`` and their traces; a sentence for each problem."""
    problems = []
    for file in _final_files(ds, folder, manifest):
        try:
            file.check(afresh=True)
        except IntegrityError as error:
            problems.append(str(error))
    return problems or find_variable_problems(ds, folder / ds.attrs.get("trace_file", RESULTS_FILE))


def finished_manifest(ds: xr.Dataset, folder: Path, manifest: Manifest) -> Manifest:
    """The manifest of a study whose complete results are ``ds``, with the hashes of their files."""
    outputs = {file.path.name: [file.check()] for file in _final_files(ds, folder, manifest)}
    user_code = json.loads(ds.attrs.get("user_code", "{}"))
    return replace(manifest, outputs=outputs, computed_on=environments_of(ds), finished=True, user_code=user_code)


def _final_files(ds: xr.Dataset, folder: Path, manifest: Manifest) -> list[StoredFile]:
    traces = _trace_file(ds, folder, manifest)
    return [_final_file(folder / RESULTS_FILE, manifest), *([traces] if traces else [])]


def _final_file(path: Path, manifest: Manifest | None) -> StoredFile:
    """A final file by its recorded hash; without one, as where ``run.json`` was lost, a child process tries it."""
    accepted = manifest.outputs.get(path.name) if manifest else None
    cure = _RESULTS_CURE if path.name == RESULTS_FILE else _TRACES_CURE
    return StoredFile(path, accepted, cure) if accepted else probe_file(path, cure)

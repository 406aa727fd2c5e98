"""The folder of a study: everything in it, by name.

::

    study.toml     the text that is run, verbatim
    run.json       the manifest: hashes of what is run, and where relative paths start
    shards/        FIRST-HASH.nc, a file for each finished shard, until all of them are in results.nc
    quarantine/    damaged and foreign files from shards/
    results.nc     metrics and status, named and labelled
    traces-ID.nc   the traces, if any are asked for; ``trace_file`` in the attributes of results.nc names it
    figures/
"""

from __future__ import annotations

import json
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import xarray as xr

from fastcoil.errors import InputError, IntegrityError, StorageError
from fastcoil.files import commit, read_bytes, storage_errors
from fastcoil.simulation.dataset import variable_sha256
from fastcoil.simulation.netcdf import load, open_lazily
from fastcoil.study.file.spec import LARGEST_FILE, Study, read_study
from fastcoil.study.folder.lock import find_holder, hold
from fastcoil.study.folder.manifest import Manifest
from fastcoil.study.folder.shards import Shards

RESULTS, STUDY = "results.nc", "study.toml"


@dataclass(frozen=True)
class StudyFolder:
    """The folder ``path`` of a study; it need not exist yet."""

    path: Path

    @property
    def results(self) -> Path:
        return self.path / RESULTS

    @property
    def study(self) -> Path:
        return self.path / STUDY

    def hold(self) -> AbstractContextManager[None]:
        """Hold the folder for one writer, see ``lock.hold``."""
        return hold(self.path)

    def find_holder(self) -> str | None:
        """Who is writing to the folder, in words, or ``None``."""
        return find_holder(self.path)

    def read_manifest(self) -> Manifest | None:
        """The manifest of the run, ``None`` before its first shard; see ``Manifest.read``."""
        return Manifest.read(self.path)

    def require_manifest(self) -> Manifest:
        """The manifest of the run.

        Raises
        ------
        InputError
            If the folder holds no study.
        """
        manifest = self.read_manifest()
        if manifest is None:
            raise InputError(
                f"{self.path} holds no study: run one first, with `fastcoil run STUDY.toml -o {self.path}`"
            )
        return manifest

    def write_manifest(self, manifest: Manifest, text: str) -> None:
        """Record which study is run, before its first shard."""
        # in this order: if it is killed in between, the same command finds its own run, and writes the text again
        manifest.write(self.path)
        commit(self.study, text.encode())

    def read_text(self) -> str | None:
        """The text of the study that is run, or ``None`` if it is missing or damaged."""
        try:
            with storage_errors(self.study, "read"):
                return read_bytes(self.study, LARGEST_FILE).decode()
        except ValueError:  # not UTF-8, or too large
            return None
        except StorageError:
            if self.study.exists():
                raise
            return None

    def read_study(self, manifest: Manifest) -> Study:
        """Read the study that is run, from the text in the folder.

        Raises
        ------
        IntegrityError
            If it, or a file it reads, is not what it was when the run was started.
        """
        if self.read_text() is None:
            raise IntegrityError(f"{self.study} is missing or damaged: restore it, or run the study again")
        try:
            study = read_study(self.study, Path(manifest.relative_to))
        except InputError as error:
            raise IntegrityError(f"{self.path}: the study can no longer be read: restore its files\n{error}") from None
        if study.sha256 != manifest.study_sha256:
            what = (
                "the series of its [boundary]"
                if study.plan.layout.boundary.sha256 != manifest.boundary_sha256
                else f"{STUDY}, a file that it includes, or its reduction"
            )
            raise IntegrityError(
                f"{self.path}: {what} changed since the run was started: restore it, or use another folder"
            )
        return study

    def shards(self, manifest: Manifest) -> Shards:
        """The finished shards of a run."""
        return Shards(self.path, manifest.key)

    def open_results(self) -> xr.Dataset:
        """Open the results, checked against their hash; traces stay on the disk until they are asked for."""
        return self.add_traces(load(self.results))

    def add_traces(self, ds: xr.Dataset) -> xr.Dataset:
        """Add to the results their traces, which stay on the disk until they are asked for.

        Raises
        ------
        IntegrityError
            If their file cannot be opened.
        """
        if "trace_file" not in ds.attrs:
            return ds
        path = self.path / ds.attrs["trace_file"]
        try:
            traces = open_lazily(path)
        except Exception as error:  # damaged bytes may raise anything in the library
            raise IntegrityError(
                f"{path} cannot be read ({error}): delete {self.path} and run the study again"
            ) from error
        return ds.assign(traces.data_vars).assign_coords(traces.coords)

    def find_trace_problems(self, ds: xr.Dataset) -> list[str]:
        """What is wrong with the traces of the results, a sentence each; reads all of them."""
        stored = json.loads(ds.attrs.get("trace_sha256", "{}"))
        problems = []
        for name, digest in stored.items():
            try:
                same = name in ds.variables and variable_sha256(ds[name].variable) == digest
            except Exception:  # damaged bytes may raise anything in the library
                same = False
            if not same:
                problems.append(f"{self.path / ds.attrs['trace_file']}: {name} is damaged (its hash differs)")
        return problems

    def remove_superseded(self, ds: xr.Dataset, manifest: Manifest) -> None:
        """Remove shards and traces that the results ``ds`` replace."""
        with storage_errors(self.path, "cleaned up"):
            for path in self.path.glob("traces-*.nc"):
                if path.name != ds.attrs.get("trace_file"):
                    path.unlink()
        self.shards(manifest).discard()

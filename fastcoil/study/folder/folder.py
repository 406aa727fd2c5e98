"""The folder of a study: everything in it, by name.

::

    study.toml     the text that is run, verbatim
    run.json       the manifest: hashes of what is run and of the final files, and where it was computed
    shards/        FIRST-HASH.nc, a file for each finished shard, until all of them are in results.nc
    quarantine/    damaged and foreign files from shards/
    results.nc     metrics and status, named and labelled
    traces-ID.nc   the traces, if any are asked for; ``trace_file`` in the attributes of results.nc names it
    figures/
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import xarray as xr

from fastcoil.base.errors import InputError, IntegrityError, StorageError
from fastcoil.base.figures import FIGURES
from fastcoil.base.files import (
    commit,
    entries,
    exists,
    is_file,
    is_folder,
    read_bytes,
    remove_unfinished,
    storage_errors,
)
from fastcoil.study.file.spec import LARGEST_FILE, Study, read_study
from fastcoil.study.folder.lock import find_holder, hold
from fastcoil.study.folder.manifest import MANIFEST, Manifest
from fastcoil.study.folder.result_files import RESULTS, TRACE_FILES, open_final
from fastcoil.study.folder.shards import Shards

STUDY = "study.toml"
_PATIENCE = 1.0
"""Seconds that a run may need between two files that belong together."""
Read = TypeVar("Read")


def require_no_archive(path: Path) -> None:
    """Refuse the one file that ``fastcoil archive`` makes of a folder, where the folder is wanted."""
    if path.suffix == ".zip" and is_file(path):
        raise InputError(f"{path} is an archive: unpack it with `unzip {path}`, and give the folder that is in it")


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

    @property
    def has_results(self) -> bool:
        """Whether there is a file of results."""
        return exists(self.results)

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Hold the folder for one writer, of results or of figures; see ``lock.hold``."""
        with hold(self.path):
            if is_folder(self.path / FIGURES):
                remove_unfinished(self.path / FIGURES)
            yield

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
        IntegrityError
            If it holds results, and the manifest is lost.
        """
        manifest = self.read_manifest()
        if manifest is None and self.has_results:
            raise IntegrityError(
                f"{self.path / MANIFEST} is missing: run the study again, with -o {self.path}, which writes it; the "
                "results are kept"
            )
        if manifest is None:
            require_no_archive(self.path)
            raise InputError(
                f"{self.path} holds no study: run one first, with `fastcoil run STUDY.toml -o {self.path}`"
            )
        return manifest

    def write_manifest(self, manifest: Manifest, text: str) -> None:
        """Record which study is run, before its first shard."""
        # in this order: if it is killed in between, the manifest is still that of the results, or there is none
        commit(self.study, text.encode())
        manifest.write(self.path)

    def records(self, manifest: Manifest, text: str) -> bool:
        """Whether the folder says all this of the study that is run."""
        found = self.read_manifest()
        return found is not None and found.text == manifest.text and self.read_text() == text

    def read_text(self) -> str | None:
        """The text of the study that is run, or ``None`` if it is missing or damaged."""
        try:
            with storage_errors(self.study, "read"):
                return read_bytes(self.study, LARGEST_FILE).decode()
        except ValueError:  # not UTF-8, or too large
            return None
        except StorageError:
            if exists(self.study):
                raise
            return None

    def read_study(self, manifest: Manifest) -> Study:
        """Read the study that is run, from the text in the folder.

        Raises
        ------
        IntegrityError
            If it, or a file it reads, is not what it was when the run was started.
        """
        cure = f"`fastcoil run STUDY.toml -o {self.path}`, with the file the run was started from, restores {STUDY}"
        if self.read_text() is None:
            raise IntegrityError(f"{self.study} is missing or damaged: {cure}")
        try:
            # one that was unpacked from an archive has its files in the folder itself
            study = read_study(self.study, self.path / manifest.relative_to)
        except InputError as error:
            raise IntegrityError(
                f"{self.path}: the study can no longer be read: restore the files that it reads; {cure}\n"
                + "\n".join(error.problems)
            ) from None
        if study.sha256 != manifest.study_sha256:
            what = (
                "the series of its [boundary]"
                if study.plan.layout.boundary.sha256 != manifest.boundary_sha256
                else f"{STUDY}, a file that it includes, or its own code"
            )
            raise IntegrityError(
                f"{self.path}: {what} changed since the run was started: restore it, or use another folder; {cure}"
            )
        return study

    def shards(self, manifest: Manifest) -> Shards:
        """The finished shards of a run."""
        return Shards(self.path, manifest.key)

    def has_none_of(self, manifest: Manifest) -> bool:
        """Whether nothing of a run would be lost if the folder were used for another one."""
        return not self.has_results and not self.shards(manifest).any()

    def open_results(self) -> xr.Dataset:
        """Open the results, see ``open_final``."""
        return open_final(self.path, self.read_manifest())

    def settled(self, read: Callable[[], Read]) -> Read:
        """Read something that another run may be writing: again, as long as it is inconsistent and changes."""
        while True:
            before = self._state()
            try:
                return read()
            except IntegrityError:
                if not self._changes(before):
                    raise

    def _changes(self, before: list[object]) -> bool:
        patience = _PATIENCE if self.find_holder() else 0.0
        end = time.monotonic() + patience
        while (same := self._state() == before) and time.monotonic() < end:
            time.sleep(patience / 50)
        return not same

    def _state(self) -> list[object]:
        found: list[object] = []
        for name in (MANIFEST, STUDY, RESULTS):
            with suppress(OSError):
                status = (self.path / name).stat()
                found.append((name, status.st_ino, status.st_mtime_ns))
        return found

    def trace_files(self) -> list[Path]:
        """All files of traces, whether they are of these results or not."""
        return [path for path in entries(self.path) if path.match(TRACE_FILES)]

    def in_the_way(self) -> list[str]:
        """A sentence for each folder that has the name of a file of traces."""
        found = [path for path in self.trace_files() if is_folder(path)]
        return [f"{path} is a folder with the name of a file: move it away, then run the study again" for path in found]

    def remove_superseded(self, ds: xr.Dataset, manifest: Manifest) -> None:
        """Remove shards and traces that the results ``ds`` replace."""
        with storage_errors(self.path, "cleaned up"):
            for path in self.trace_files():
                if path.name != ds.attrs.get("trace_file"):
                    path.unlink()
        self.shards(manifest).discard()

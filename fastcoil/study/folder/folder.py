"""The folder of a study: its files by name, and the lock that admits one writer at a time.

::

    study.toml     the text that is run, verbatim
    run.json       the manifest: hashes of what is run and of the final files, and where it was computed
    shards/        FIRST-HASH.nc, a file for each finished shard, until all of them are in results.nc
    quarantine/    damaged and foreign files from shards/
    results.nc     metrics and status, named and labelled
    traces-ID.nc   the traces, if there are any; ``trace_file`` in the attributes of results.nc names it
    figures/
    .lock-K-of-N   the lock of a share that is run, or was since the last merge
"""

import errno
import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import xarray as xr
from filelock import BaseFileLock, FileLock, Timeout

from fastcoil.base import files
from fastcoil.base.arguments import is_storable_text
from fastcoil.base.errors import FastcoilError, InputError, IntegrityError, LockedError, StorageError, short_repr
from fastcoil.base.figures import FIGURES_FOLDER
from fastcoil.base.machine import retry_while_locked
from fastcoil.base.text import escape_control_characters
from fastcoil.study.file.spec import MAX_STUDY_FILE_BYTES, Study, read_study

from fastcoil.study.folder.stored import (  # isort: skip
    MANIFEST_FILE, RESULTS_FILE, SHARDS_FOLDER, TRACE_FILE_PATTERN, Manifest, Shards,
)  # fmt: skip

STUDY_FILE = "study.toml"
_LOCK_NAME = ".lock"
_HOLDER_NAME = ".holder"
_MAX_HOLDER_BYTES = 4096
_LOCK_TIMEOUT_S = 0.5  # a reader may hold the lock for a moment
_SLICE_LOCK_TIMEOUT_S = 10.0  # shares that are started together all look at the lock of the whole
_SETTLING_TIME_S = 1.0  # that a run may need between two files that belong together
_NOT_A_FILE_ERRORS = (errno.ELOOP, errno.EISDIR)
_NO_LOCK_ERRORS = (errno.EOPNOTSUPP, errno.ENOLCK, errno.ENOSYS, *_NOT_A_FILE_ERRORS)
Content = TypeVar("Content")


@dataclass(frozen=True)
class StudyFolder:
    """The folder ``path`` of a study; it need not exist yet."""

    path: Path

    @property
    def results_path(self) -> Path:
        return self.path / RESULTS_FILE

    @property
    def study_path(self) -> Path:
        return self.path / STUDY_FILE

    @property
    def has_results(self) -> bool:
        return files.exists(self.results_path)

    @property
    def has_shards(self) -> bool:
        return bool(files.list_folder(self.path / SHARDS_FOLDER))

    def require_manifest(self) -> Manifest:
        """Return the manifest of the run; ``InputError`` without a study, ``IntegrityError`` if it is lost."""
        manifest = Manifest.read(self.path)
        if manifest is None and self.has_results:
            raise self.missing_manifest_error()
        if manifest is None:
            cure = f"run one first, with `fastcoil run STUDY.toml -o {self.path}`"
            raise InputError(f"{self.path} holds no study: {cure}", str(self.path), "path")
        return manifest

    def missing_manifest_error(self) -> IntegrityError:
        """Error for results of which no manifest says what they are."""
        return IntegrityError(
            f"{self.path / MANIFEST_FILE} is missing: the results are of fastcoil 0.1, which that version opens, or it "
            f"was lost, and running the same study again with -o {self.path} writes it"
        )

    def write_manifest(self, manifest: Manifest, text: str) -> None:
        """Record which study is run, before its first shard, unless the folder says so."""
        # in this order: if it is killed in between, the manifest is still that of the results, or there is none
        if self.read_text() != text:
            files.write_atomically(self.study_path, text.encode())
        stored = Manifest.read(self.path)
        if stored is None or stored.text != manifest.text:
            manifest.write(self.path)

    def read_text(self) -> str | None:
        """Return the text of the study that is run, or ``None`` if it is missing or damaged."""
        if not files.exists(self.study_path):
            return None
        try:
            with files.convert_os_errors(self.study_path, "read"):
                return files.read_bytes(self.study_path, MAX_STUDY_FILE_BYTES).decode()
        except ValueError:  # not UTF-8, or too large
            return None

    def find_source(self) -> str:
        """Find the study file that the run was started from, by its text; ``STUDY.toml`` where it is not known."""
        folder, text = self.path / self.require_manifest().relative_to, self.read_text()
        for path in sorted(folder.glob("*.toml")):
            with suppress(FastcoilError):
                if files.read_text(path, "", MAX_STUDY_FILE_BYTES).replace("\r\n", "\n") == text:
                    return os.path.normpath(path)
        return "STUDY.toml"

    def read_study(self, manifest: Manifest) -> Study:
        """Read the study that is run, from the text in the folder; ``IntegrityError`` if it or its files changed."""
        command = f"`fastcoil run STUDY.toml -o {self.path}`"
        cure = f"{command}, with the file the run was started from, restores {STUDY_FILE}"
        if self.read_text() is None:
            raise IntegrityError(f"{self.study_path} is missing or damaged: {cure}")
        try:
            study = read_study(self.study_path, self.path / manifest.relative_to)
        except InputError as error:
            sentence = f"{self.path}: the study can no longer be read: restore the files that it reads; {cure}"
            raise IntegrityError("\n".join([sentence, *error.problems])) from None
        matching = study.find_by_hash(manifest.study_sha256)
        if matching is None:
            changed = "the series of its [boundary]"
            if study.plan.layout.boundary.sha256 == manifest.boundary_sha256:
                changed = f"{STUDY_FILE}, a file that it includes, or its own code"
            sentence = f"{self.path}: {changed} changed since the run was started"
            raise IntegrityError(f"{sentence}: restore it, or use another folder; {cure}")
        return matching

    def read_consistently(self, read: Callable[[], Content]) -> Content:
        """Call ``read`` again while what it reads is inconsistent and another run is writing it."""
        end = time.monotonic() + _SETTLING_TIME_S
        while time.monotonic() < end:
            is_held = find_holder(self.path)
            try:
                return read()
            except IntegrityError:
                if not is_held:
                    break
                time.sleep(_SETTLING_TIME_S / 50)
        return read()

    def trace_files(self) -> list[Path]:
        return [path for path in files.list_folder(self.path) if path.match(TRACE_FILE_PATTERN)]

    def remove_superseded(self, ds: xr.Dataset, manifest: Manifest) -> None:
        """Remove shards and traces that the results ``ds`` replace."""
        with files.convert_os_errors(self.path, "cleaned up"):
            for path in self.trace_files():
                if path.name != ds.attrs.get("trace_file"):
                    retry_while_locked(path.unlink)
        Shards(self.path, manifest.key).discard()


@contextmanager
def hold_folder(folder: Path, slice_name: str = "") -> Iterator[None]:
    """Hold the folder for one writer, make it if it is missing; one made here that stays empty is removed again.

    slice_name: hold only this share of the study, such as ``2-of-8``; without a lock where the file system has none.

    ``LockedError`` if another process holds it; the operating system frees it when that process ends, however it ends.
    """
    files.require_usable_path(folder, "choose another folder with -o")
    if "\\" in folder.as_posix() or not is_storable_text(str(folder.absolute())):
        sentence = f"{short_repr(str(folder))} holds a backslash or bytes that are not UTF-8, with which the NetCDF"
        raise InputError(f"{sentence} library cannot write: choose another folder with -o", "-o", "path")
    with files.convert_os_errors(folder, "written"):  # a folder above it may be closed to us
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder} is a file: choose another folder with -o", "-o", "path")
        made_folders = [p for p in (folder, *folder.parents) if not p.exists()]
    lock, holder = _make_lock(folder, slice_name), _slice_path(folder, _HOLDER_NAME, slice_name)
    is_noted = False
    try:
        with files.convert_os_errors(folder, "written"):
            files.make_folder(folder, parents=True)
            _acquire_lock(lock, folder, slice_name, for_slice=bool(slice_name))
            # a share and the whole look at each other's locks after they have their own: one of two sees the other
            for other_slice in [""] if slice_name else _find_started_slices(folder):
                other_lock = _make_lock(folder, other_slice)
                _acquire_lock(other_lock, folder, other_slice, for_slice=bool(slice_name))
                if other_slice:
                    with suppress(OSError):  # of Windows, where it is open
                        for name in (_HOLDER_NAME, _LOCK_NAME):
                            _slice_path(folder, name, other_slice).unlink(missing_ok=True)
                other_lock.release()
        now = datetime.now(UTC).isoformat(timespec="seconds")
        text = f"process {os.getpid()} on {platform.node()} since {now}"
        is_noted = True  # before it is: an interruption may come in between
        files.write_atomically(holder, text.encode(errors="replace"))
        for place in () if slice_name else filter(files.is_folder, (folder, folder / FIGURES_FOLDER)):
            files.remove_temporary_files(place)
        yield
    except LockedError:
        made_folders = []  # it is the other's too
        raise
    finally:
        with suppress(OSError):  # what is left does no harm
            if is_noted:
                holder.unlink(missing_ok=True)
            locks = {_slice_path(folder, _LOCK_NAME, slice_name), folder / _LOCK_NAME}
            if made_folders and {*folder.iterdir()} <= locks:
                for path in locks:
                    path.unlink(missing_ok=True)
        lock.release()
        with suppress(OSError):  # one that is not empty stays
            for path in made_folders:
                path.rmdir()


def _slice_path(folder: Path, name: str, slice_name: str) -> Path:
    return folder / (f"{name}-{slice_name}" if slice_name else name)


def _make_lock(folder: Path, slice_name: str) -> BaseFileLock:
    # a soft lock would outlive a kill
    return FileLock(_slice_path(folder, _LOCK_NAME, slice_name), fallback_to_soft=False)


def _find_started_slices(folder: Path) -> list[str]:
    """The shares that were begun since the folder was last held as a whole."""
    paths = files.list_folder(folder) if files.is_folder(folder) else []
    return [p.name.removeprefix(f"{_LOCK_NAME}-") for p in paths if p.match(f"{_LOCK_NAME}-*-of-*")]


def _acquire_lock(lock: BaseFileLock, folder: Path, slice_name: str, *, for_slice: bool) -> None:
    """Get the lock of the whole folder or of a share; a share goes without where the file system has no locks."""
    try:
        timeout = _SLICE_LOCK_TIMEOUT_S if for_slice and not slice_name else _LOCK_TIMEOUT_S
        lock.acquire(timeout=timeout, poll_interval=0.01)
    except Timeout:
        holder = _describe_holder(folder, slice_name) or "another run"
        place = f"share {slice_name.replace('-', ' ')} of {folder}" if slice_name else str(folder)
        raise LockedError(f"{place} is in use by {holder}: wait for it to end, or choose another folder") from None
    except (OSError, NotImplementedError) as error:
        if isinstance(error, OSError) and error.errno not in _NO_LOCK_ERRORS:
            raise
        if for_slice and getattr(error, "errno", None) not in _NOT_A_FILE_ERRORS:
            return
        reason = getattr(error, "strerror", None) or str(error)
        raise StorageError(
            f"{lock.lock_file} cannot be locked ({reason}), so that two runs could spoil each other's results: move "
            "it away if it is a link or a folder, otherwise choose a folder on another file system with -o"
        ) from None


def find_running_slices(folder: Path) -> dict[str, str]:
    """Share, such as ``2-of-8`` → who is running it, in words; empty if nobody is."""
    return {name: find_holder(folder, name) or "" for name in _find_started_slices(folder)}


def find_holder(folder: Path, slice_name: str = "") -> str | None:
    """Who is writing to the folder, or running a share of its study, in words, or ``None``."""
    lock = _make_lock(folder, slice_name)
    try:
        if not Path(lock.lock_file).is_file():
            return None
        with lock.acquire(timeout=0):
            return None
    except Timeout:
        return _describe_holder(folder, slice_name)
    except (OSError, NotImplementedError):  # nothing of ours can write here
        return None


def _describe_holder(folder: Path, slice_name: str) -> str | None:
    """The note of the run that holds the folder; ``None`` without one, as of a lock that somebody looks at."""
    try:
        note = files.read_bytes(_slice_path(folder, _HOLDER_NAME, slice_name), _MAX_HOLDER_BYTES, follow=False)
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return "another run"
    return f"another run ({escape_control_characters(note.decode(errors='replace'))})"

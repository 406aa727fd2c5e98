"""The folder of a study: its files by name, and the lock that admits one writer at a time.

::

    study.toml     the text that is run, verbatim
    run.json       the manifest: hashes of what is run and of the final files, and where it was computed
    shards/        FIRST-HASH.nc, a file for each finished shard, until all of them are in results.nc
    quarantine/    damaged and foreign files from shards/
    results.nc     metrics and status, named and labelled
    traces-ID.nc   the traces, if any are asked for; ``trace_file`` in the attributes of results.nc names it
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

from fastcoil.base.arguments import is_text
from fastcoil.base.errors import InputError, IntegrityError, LockedError, StorageError, shown
from fastcoil.base.figures import FIGURES
from fastcoil.base.files import (
    commit,
    entries,
    exists,
    is_file,
    is_folder,
    make_folder,
    read_bytes,
    remove_unfinished,
    require_usable,
    storage_errors,
)
from fastcoil.base.machine import patiently
from fastcoil.base.text import printable
from fastcoil.study.file.spec import LARGEST_FILE, Study, read_study
from fastcoil.study.folder.stored import MANIFEST, RESULTS, TRACE_FILES, Manifest, Shards, open_final

STUDY = "study.toml"
_LOCK, _HOLDER = ".lock", ".holder"
_LONGEST_HOLDER = 4096
_PATIENCE, _PATIENCE_OF_SHARE, _PAUSE = 0.5, 10.0, 0.01
"""Seconds to try to get the lock, which a reader may hold for a moment; seconds between two trials."""
_SETTLING = 1.0  # seconds that a run may need between two files that belong together
_NO_FILE = (errno.ELOOP, errno.EISDIR)
_CANNOT_LOCK = (errno.EOPNOTSUPP, errno.ENOLCK, errno.ENOSYS, *_NO_FILE)
"""Answers of a file system that has no locks, and where the lock is no file."""
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
        return exists(self.results)

    def require_manifest(self) -> Manifest:
        """The manifest of the run; ``InputError`` if the folder holds no study, ``IntegrityError`` if it is lost."""
        manifest = Manifest.read(self.path)
        if manifest is None and self.has_results:
            raise self.without_manifest()
        if manifest is None:
            require_no_archive(self.path)
            raise InputError(
                f"{self.path} holds no study: run one first, with `fastcoil run STUDY.toml -o {self.path}`"
            )
        return manifest

    def without_manifest(self) -> IntegrityError:
        """Error for results of which no manifest says what they are."""
        return IntegrityError(
            f"{self.path / MANIFEST} is missing: the results are of fastcoil 0.1, which that version opens, or it "
            f"was lost, and running the same study again with -o {self.path} writes it"
        )

    def write_manifest(self, manifest: Manifest, text: str) -> None:
        """Record which study is run, before its first shard."""
        # in this order: if it is killed in between, the manifest is still that of the results, or there is none
        commit(self.study, text.encode())
        manifest.write(self.path)

    def records(self, manifest: Manifest, text: str) -> bool:
        """Whether the folder says all this of the study that is run."""
        found = Manifest.read(self.path)
        return found is not None and found.text == manifest.text and self.read_text() == text

    def read_text(self) -> str | None:
        """The text of the study that is run, or ``None`` if it is missing or damaged."""
        if not exists(self.study):
            return None
        try:
            with storage_errors(self.study, "read"):
                return read_bytes(self.study, LARGEST_FILE).decode()
        except ValueError:  # not UTF-8, or too large
            return None

    def read_study(self, manifest: Manifest) -> Study:
        """Read the study that is run, from the text in the folder.

        ``IntegrityError`` if it, or a file it reads, is not what it was when the run was started.
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
        found = study.of_hash(manifest.study_sha256)
        if found is None:
            same_boundary = study.plan.layout.boundary.sha256 == manifest.boundary_sha256
            what = (
                f"{STUDY}, a file that it includes, or its own code"
                if same_boundary
                else "the series of its [boundary]"
            )
            raise IntegrityError(
                f"{self.path}: {what} changed since the run was started: restore it, or use another folder; {cure}"
            )
        return found

    def open_results(self) -> xr.Dataset:
        return open_final(self.path, Manifest.read(self.path))

    def settled(self, read: Callable[[], Read]) -> Read:
        """Read something that another run may be writing: again, as long as it is inconsistent and somebody writes."""
        end = time.monotonic() + _SETTLING
        while time.monotonic() < end:
            writing = find_holder(self.path)
            try:
                return read()
            except IntegrityError:
                if not writing:
                    break
                time.sleep(_SETTLING / 50)
        return read()

    def trace_files(self) -> list[Path]:
        return [path for path in entries(self.path) if path.match(TRACE_FILES)]

    def remove_superseded(self, ds: xr.Dataset, manifest: Manifest) -> None:
        """Remove shards and traces that the results ``ds`` replace."""
        with storage_errors(self.path, "cleaned up"):
            for path in self.trace_files():
                if path.name != ds.attrs.get("trace_file"):
                    patiently(path.unlink)
        Shards(self.path, manifest.key).discard()


@contextmanager
def hold(folder: Path, share: str = "") -> Iterator[None]:
    """Hold the folder for one writer, make it if it is missing; one made here that stays empty is removed again.

    share: hold only this share of the study, such as ``2-of-8``, beside other shares.  Where the file system has no
    locks, a share is not held: run twice at once, it is computed twice and counts once.

    ``InputError`` if there is a file of that name, or no folder of results can have that name.  ``LockedError`` if
    another process holds it; the operating system frees it when that process ends, however it ends.  ``StorageError``
    if it cannot be written or its file system has no locks.
    """
    require_usable(folder, "choose another folder with -o")
    if "\\" in folder.as_posix() or not is_text(str(folder.absolute())):
        raise InputError(
            f"{shown(str(folder))} holds a backslash or bytes that are not UTF-8, with which the NetCDF library cannot "
            "write: choose another folder with -o"
        )
    with storage_errors(folder, "written"):  # a folder above it may be closed to us
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder} is a file: choose another folder with -o")
        made = [p for p in (folder, *folder.parents) if not p.exists()]
    lock, holder = _lock(folder, share), _named(folder, _HOLDER, share)
    noted = False
    try:
        with storage_errors(folder, "written"):
            make_folder(folder, parents=True)
            _acquire(lock, folder, share, for_share=bool(share))
            # a share and the whole look at each other's locks after they have their own: one of two sees the other
            for other in [""] if share else _shares(folder):
                seen = _lock(folder, other)
                _acquire(seen, folder, other, for_share=bool(share))
                if other:
                    with suppress(OSError):  # of Windows, where it is open
                        for name in (_HOLDER, _LOCK):
                            _named(folder, name, other).unlink(missing_ok=True)
                seen.release()
        now = datetime.now(UTC).isoformat(timespec="seconds")
        text = f"process {os.getpid()} on {platform.node()} since {now}"
        noted = True  # before it is: an interruption may come in between
        commit(holder, text.encode(errors="replace"))
        for place in () if share else filter(is_folder, (folder, folder / FIGURES)):
            remove_unfinished(place)
        yield
    except LockedError:
        made = []  # it is the other's too
        raise
    finally:
        with suppress(OSError):  # what is left does no harm
            if noted:
                holder.unlink(missing_ok=True)
            locks = {_named(folder, _LOCK, share), folder / _LOCK}
            if made and {*folder.iterdir()} <= locks:
                for path in locks:
                    path.unlink(missing_ok=True)
        lock.release()
        with suppress(OSError):  # one that is not empty stays
            for path in made:
                path.rmdir()


def _named(folder: Path, name: str, share: str) -> Path:
    return folder / (f"{name}-{share}" if share else name)


def _lock(folder: Path, share: str) -> BaseFileLock:
    return FileLock(_named(folder, _LOCK, share), fallback_to_soft=False)  # a soft lock would outlive a kill


def _shares(folder: Path) -> list[str]:
    """The shares that were begun since the folder was last held as a whole."""
    return [path.name.removeprefix(f"{_LOCK}-") for path in entries(folder) if path.match(f"{_LOCK}-*-of-*")]


def _acquire(lock: BaseFileLock, folder: Path, share: str, *, for_share: bool) -> None:
    """Get the lock of the whole folder or of a share; for a share, one that the file system does not have is missed."""
    try:
        # shares that are started together all look at the lock of the whole
        lock.acquire(timeout=_PATIENCE_OF_SHARE if for_share and not share else _PATIENCE, poll_interval=_PAUSE)
    except Timeout:
        holder = _describe_holder(folder, share) or "another run"
        of = f"share {share.replace('-', ' ')} of " if share else ""
        raise LockedError(f"{of}{folder} is in use by {holder}: wait for it to end, or choose another folder") from None
    except (OSError, NotImplementedError) as error:
        if isinstance(error, OSError) and error.errno not in _CANNOT_LOCK:
            raise
        if for_share and getattr(error, "errno", None) not in _NO_FILE:
            return
        reason = getattr(error, "strerror", None) or str(error)
        raise StorageError(
            f"{lock.lock_file} cannot be locked ({reason}), so that two runs could spoil each other's results: delete "
            "it if it is a link or a folder, otherwise choose a folder on another file system with -o"
        ) from None


def running_shares(folder: Path) -> dict[str, str]:
    """Share, such as ``2-of-8`` → who is running it, in words; empty if nobody is."""
    return {share: find_holder(folder, share) or "" for share in (_shares(folder) if is_folder(folder) else ())}


def find_holder(folder: Path, share: str = "") -> str | None:
    """Who is writing to the folder, or running a share of its study, in words, or ``None``."""
    lock = _lock(folder, share)
    try:
        if not Path(lock.lock_file).is_file():
            return None
        with lock.acquire(timeout=0):
            return None
    except Timeout:
        return _describe_holder(folder, share)
    except (OSError, NotImplementedError):  # nothing of ours can write here
        return None


def _describe_holder(folder: Path, share: str) -> str | None:
    """The note of the run that holds the folder; ``None`` without one, as of a lock that somebody looks at."""
    try:
        text = read_bytes(_named(folder, _HOLDER, share), _LONGEST_HOLDER, follow=False).decode(errors="replace")
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return "another run"
    return f"another run ({printable(text)})"

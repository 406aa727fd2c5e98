"""What is wrong with an archive: nothing in it is trusted; names and hashes are checked before a byte is unpacked."""

from __future__ import annotations

import hashlib
import struct
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from fastcoil.base.errors import FastcoilError, shown
from fastcoil.base.files import make_folder, storage_errors
from fastcoil.study.archive.listing import HERE, LISTING, Listing, is_safe
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.manifest import MANIFEST, Manifest
from fastcoil.study.folder.verify import find_problems, problems_of_results

_CHUNK = 2**20
_LARGEST_DIRECTORY, _LARGEST_LISTING = 2**20, 2**20
"""Bytes of the list of members of the ZIP file, and of ours."""
_MOST_MEMBERS = 1000
_END, _END_64, _LOCATOR = b"PK\5\6", b"PK\6\6", b"PK\6\7"
_LOCAL = struct.Struct("<4s5H3L2H")
_UNREADABLE = (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError, struct.error, RuntimeError, OverflowError)
"""What the library raises on bytes that nobody wrote as a ZIP file."""


class _WrongError(Exception):
    """A sentence without the name of the archive; nothing after it can be checked."""


def archive_problems(path: Path) -> list[str]:
    """Check an archive: a sentence for each problem.  It is unpacked in a temporary folder, and nothing of it is run.

    Raises
    ------
    StorageError
        If it cannot be read, or there is no room to unpack it.
    """
    try:
        with path.open("rb") as file:
            _require_small_directory(file)
            with zipfile.ZipFile(file) as archive:
                return [f"{path}: {problem}" for problem in _problems(file, archive, path)]
    except _WrongError as wrong:
        return [f"{path} {wrong}"]
    except FastcoilError:
        raise
    except _UNREADABLE as error:
        return [f"{path} is damaged, or no archive of fastcoil ({error}): get it again from its author"]
    except OSError:
        with storage_errors(path, "read"):
            raise


def _require_small_directory(file: BinaryIO) -> None:
    """Look at the end of a ZIP file before the library reads as much as it says."""
    size = file.seek(0, 2)
    file.seek(max(0, size - 98))
    tail = file.read()
    end = tail[-22:]
    if len(end) < 22 or not end.startswith(_END) or end[-2:] != b"\0\0":
        raise _WrongError("is damaged, cut off, or no archive of fastcoil: get it again from its author")
    directory: int = struct.unpack_from("<L", end, 12)[0]
    if tail[-42:-38] == _LOCATOR:
        record = tail[-98:-42]
        if not record.startswith(_END_64):
            raise _WrongError("is damaged (its end leads nowhere): get it again from its author")
        directory = max(directory, struct.unpack_from("<Q", record, 40)[0])
    if directory > min(size, _LARGEST_DIRECTORY):
        raise _WrongError("has a list of members that no archive of fastcoil has: it is not used")


def _problems(file: BinaryIO, archive: zipfile.ZipFile, path: Path) -> list[str]:
    infos = archive.infolist()
    found = list(_of_members(infos)) or list(_of_places(file, archive))
    if found:
        return found
    name, listing = _listing(archive, infos)
    members = {info.filename.removeprefix(f"{name}/"): info for info in infos}
    wrong = [f"{shown(m)} is not on its list: somebody added it" for m in members if m not in {LISTING, *listing.files}]
    wrong += [f"{shown(m)} is missing" for m in listing.files if m not in members]
    wrong += [
        f"{shown(m)} is damaged (its bytes are not those that were packed)"
        for m, entry in listing.files.items()
        if m in members and (members[m].file_size != entry.size or _sha256(archive, members[m]) != entry.sha256)
    ]
    return wrong or _unpacked(archive, infos, name, listing, path)


def _of_members(infos: list[zipfile.ZipInfo]) -> Iterator[str]:
    """Members that no archive of ours has: names that lead elsewhere, links, compressed ones, the same name twice."""
    if not infos or len(infos) > _MOST_MEMBERS:
        yield f"it has {len(infos):,} members, an archive has 1 to {_MOST_MEMBERS:,}"
        return
    seen: set[str] = set()
    for info in infos:
        name, kind = info.orig_filename, info.external_attr >> 28
        if not is_safe(name) or name != info.filename or "/" not in name:
            yield f"{shown(name)} is no name of a file in the archive's own folder: it is not unpacked"
        elif kind != 0o10 or info.flag_bits & 0x1:
            yield f"{shown(name)} is a link, encrypted, or no plain file: it is not unpacked"
        elif info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            yield f"{shown(name)} is compressed, which fastcoil never does: it is not unpacked"
        elif name in seen:
            yield f"{shown(name)} is there twice"
        seen.add(name)
    parents = {str(parent) for info in infos for parent in PurePosixPath(info.filename).parents}
    yield from (f"{shown(i.filename)} is a file and a folder" for i in infos if i.filename in parents)
    tops = {info.filename.split("/")[0] for info in infos if is_safe(info.filename)}
    if len(tops) > 1 and all("/" in info.filename for info in infos):
        yield f"it has {len(tops)} folders side by side, an archive has one"


def _of_places(file: BinaryIO, archive: zipfile.ZipFile) -> Iterator[str]:
    """Bytes before, between or behind the members: other programs may see files there."""
    at = 0
    for info in sorted(archive.infolist(), key=lambda info: info.header_offset):
        if info.header_offset != at:
            yield "it has bytes that belong to no member"
            return
        file.seek(at)
        head = file.read(_LOCAL.size)
        if len(head) < _LOCAL.size:
            yield f"{shown(info.filename)} is cut off"
            return
        *_, n_name, n_extra = _LOCAL.unpack(head)
        at += _LOCAL.size + n_name + n_extra + info.file_size
    if at != archive.start_dir:
        yield "it has bytes that belong to no member"


def _listing(archive: zipfile.ZipFile, infos: list[zipfile.ZipInfo]) -> tuple[str, Listing]:
    name = infos[0].filename.split("/")[0]
    info = next((i for i in infos if i.filename == f"{name}/{LISTING}"), None)
    if info is None:
        raise _WrongError(f"has no {LISTING}: it is no archive of fastcoil")
    if info.file_size > _LARGEST_LISTING:
        raise _WrongError(f"has a {LISTING} of {info.file_size:,} bytes, no archive of fastcoil has: it is not used")
    try:
        return name, Listing.parse(archive.read(info))
    except zipfile.BadZipFile as error:
        raise _WrongError(f"has a damaged {LISTING} ({error}): get it again from its author") from None
    except ValueError as error:
        raise _WrongError(f"has a {LISTING} that {error}") from None


def _sha256(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> str:
    """SHA-256 of a member; empty where the library finds it damaged."""
    digest = hashlib.sha256()
    try:
        with archive.open(info) as member:
            while chunk := member.read(_CHUNK):
                digest.update(chunk)
    except _UNREADABLE:
        return ""
    return digest.hexdigest()


def _unpacked(
    archive: zipfile.ZipFile, infos: list[zipfile.ZipInfo], name: str, listing: Listing, path: Path
) -> list[str]:
    """What is wrong with the folder that comes out."""
    with tempfile.TemporaryDirectory(prefix="fastcoil-") as place, storage_errors(Path(place), "written"):
        for info in infos:
            to = Path(place) / info.filename
            make_folder(to.parent, parents=True)
            with archive.open(info) as member, to.open("xb") as file:
                while chunk := member.read(_CHUNK):
                    file.write(chunk)
        folder = Path(place) / name
        try:
            problems = _of_folder(folder, listing)
        except FastcoilError as error:
            problems = str(error).splitlines()
        return [problem.replace(place, str(path)) for problem in problems]


def _of_folder(folder: Path, listing: Listing) -> list[str]:
    manifest = Manifest.read(folder)
    if manifest is None:
        return [f"{MANIFEST} is missing"]
    if manifest.relative_to != HERE and not is_safe(manifest.relative_to):
        return [f"{MANIFEST} leads out of the archive, to {shown(manifest.relative_to)}"]
    store = StudyFolder(folder)
    # where paths of the study lead to its files on no other machine, it cannot be read
    problems = list(problems_of_results(store, manifest)) if listing.elsewhere else find_problems(store)
    if not problems and store.open_results().attrs["content_sha256"] != listing.content_sha256:
        problems = ["its results are not those of its list: content_sha256 differs"]
    return problems

"""Write an archive: plain ZIP, nothing compressed, the same bytes for the same results.

Large variables are compressed in their NetCDF files.  Without a second compression nobody needs to trust how large a
member becomes, and no version of a library changes the bytes.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import xarray as xr

from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.base.files import commit_written, exists, is_folder, storage_errors
from fastcoil.study.archive.inputs import Inputs, inputs_of
from fastcoil.study.archive.listing import LISTING, README, Entry, Listing, is_safe
from fastcoil.study.archive.readme import readme
from fastcoil.study.folder.folder import STUDY, StudyFolder
from fastcoil.study.folder.manifest import MANIFEST, Manifest
from fastcoil.study.folder.result_files import RESULTS
from fastcoil.study.folder.results import open_finished
from fastcoil.study.folder.verify import find_problems

_CHUNK = 2**20
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The first moment that a ZIP file knows."""
_REGULAR = 0o100644 << 16


class Packed(NamedTuple):
    """What was written, and the files of the study that another machine will not find by its paths."""

    path: Path
    listing: Listing


def pack(folder: Path, path: Path | None = None) -> Packed:
    """Write the finished study in a folder as one file; ``path``: FOLDER.zip beside the folder by default.

    Raises
    ------
    InputError
        If there is no finished study, or the file exists.
    StorageError, IntegrityError
        If a file cannot be read or written; if the folder is not sound.  Nothing half-written is left behind.
    """
    store = StudyFolder(folder)
    called = folder.absolute().name or "study"
    name = called if is_safe(called) else "study"
    path = path or (folder if folder.name else folder.absolute()).parent / f"{called}.zip"
    store.require_manifest()
    _require_new(path)
    ds = open_finished(folder)
    problems = find_problems(store)
    if problems:
        raise IntegrityError("\n".join(problems))
    manifest = store.require_manifest()
    inputs = inputs_of(store.read_study(manifest))
    members = _members(store, ds, manifest, inputs)
    listing = Listing(
        str(ds.attrs["content_sha256"]), _made_with(ds), inputs.elsewhere,
        {member: _entry(source) for member, source in members.items()},
    )  # fmt: skip
    guide = readme(name, ds.attrs, listing, inputs.base).encode()
    listing = replace(listing, files={README: _entry(guide), **listing.files})
    contents: dict[str, bytes | Path] = {LISTING: listing.data, README: guide, **members}

    def write(unfinished: Path) -> None:
        with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_STORED) as file:
            for member, source in contents.items():
                entry = Entry(len(listing.data), "") if member == LISTING else listing.files[member]
                _add(file, f"{name}/{member}", source, entry)

    commit_written(path, write)
    return Packed(path, listing)


def _require_new(path: Path) -> None:
    if path.suffix != ".zip" or not is_folder(path.absolute().parent):
        raise InputError(f"-o {path}: give a file NAME.zip in a folder that exists")
    if exists(path):
        raise InputError(f"{path} exists: choose another name with -o, or delete it")


def _members(store: StudyFolder, ds: xr.Dataset, manifest: Manifest, inputs: Inputs) -> dict[str, bytes | Path]:
    """What is packed, by path in the folder: bytes, or a file to copy.

    Shards are none of a finished study; figures and reports can be made again.
    """
    outputs = [RESULTS, *([str(ds.attrs["trace_file"])] if "trace_file" in ds.attrs else [])]
    # the folder of its author is nobody's business, and exists on no other machine
    moved = replace(manifest, relative_to=inputs.base, outputs={n: [manifest.outputs[n][0]] for n in outputs})
    text = (store.read_text() or "").encode()
    found: dict[str, bytes | Path] = {STUDY: text, MANIFEST: moved.text.encode()}
    if inputs.files:  # where it can be run
        found[f"{inputs.base}/{STUDY}"] = text
    found |= {name: store.path / name for name in outputs} | inputs.files
    return dict(sorted(found.items()))


def _made_with(ds: xr.Dataset) -> dict[str, object]:
    names = ("fastcoil_version", "python_version", "platform", "model_sha256", "date_created")
    made: dict[str, object] = {name: str(ds.attrs.get(name, "unknown")) for name in names}
    for name in ("package_versions", "computed_on"):
        try:
            made[name] = json.loads(ds.attrs.get(name, "null"))
        except ValueError:
            made[name] = None
    return made


def _entry(source: bytes | Path) -> Entry:
    digest, size = hashlib.sha256(), 0
    for chunk in _chunks(source):
        digest.update(chunk)
        size += len(chunk)
    return Entry(size, digest.hexdigest())


def _chunks(source: bytes | Path) -> Iterator[bytes]:
    if isinstance(source, bytes):
        yield source
        return
    with storage_errors(source, "read"), source.open("rb") as file:
        while chunk := file.read(_CHUNK):
            yield chunk


def _add(file: zipfile.ZipFile, name: str, source: bytes | Path, entry: Entry) -> None:
    """Copy a member; what is copied is what was hashed."""
    info = zipfile.ZipInfo(name, _EPOCH)
    info.external_attr, info.create_system, info.file_size = _REGULAR, 3, entry.size
    digest, size = hashlib.sha256(), 0
    with file.open(info, "w") as member:
        for chunk in _chunks(source):
            size += len(chunk)
            if size > entry.size:
                break
            digest.update(chunk)
            member.write(chunk)
    if entry.sha256 and (size, digest.hexdigest()) != entry:
        raise IntegrityError(f"{name} changed while it was packed: wait until nobody writes to it, then try again")

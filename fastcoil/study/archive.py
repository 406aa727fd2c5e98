"""A finished study in one file: its folder and the files that the study reads; and what is wrong with such a file.

An archive is a plain ZIP file with the same bytes for the same results; nothing in it is compressed, since large
variables already are in their NetCDF files.  ``run.json`` has the hashes of the results and of the study, and thereby
of what it reads.  An archive is checked unpacked, in a temporary folder, and nothing of it is run.
"""

from __future__ import annotations

import os
import posixpath
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import xarray as xr

from fastcoil.base.errors import FastcoilError, InputError, IntegrityError, StorageError, shown
from fastcoil.base.files import commit_written, exists, require_file, storage_errors
from fastcoil.base.text import printable
from fastcoil.loops.netcdf import file_sha256
from fastcoil.study.file.sample import files_of
from fastcoil.study.file.spec import Study
from fastcoil.study.folder.folder import STUDY, StudyFolder
from fastcoil.study.folder.results import open_finished, problems_of_folder, problems_of_results
from fastcoil.study.folder.stored import MANIFEST, RESULTS, Manifest

README = "README.txt"
INPUTS, HERE = "inputs", "."
"""Folder of the files that the study reads, and where its paths start if it reads none."""
_ELSEWHERE = f"{INPUTS}/elsewhere"
_LONGEST_NAME, _MOST_PARTS = 200, 30  # bytes of a part of a path; parts of a path
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first moment that a ZIP file can record
_REGULAR = 0o100644 << 16
_BLOCK = 2**20  # bytes


def is_safe(name: str) -> bool:
    """Whether a path can be unpacked anywhere, and leads nowhere but into the folder it is unpacked in."""
    parts = name.split("/")
    return len(parts) <= _MOST_PARTS and all(
        part not in ("", ".", "..")
        and part.isprintable()
        and not set(part) & set('\\:*?"<>|')
        and len(part.encode(errors="replace")) <= _LONGEST_NAME
        and part == part.strip(" ")
        for part in parts
    )


def inputs_of(study: Study) -> tuple[str, dict[str, Path], dict[str, str]]:
    """Place the files that a study reads in its archive, so that its relative paths lead to them again.

    A path that goes up from the study file does so in the archive as well: the study is placed deep enough.  An
    absolute path is part of the study and leads nowhere on another machine: its file is packed, and the README says
    where it must be.

    Returns the folder where paths of the study start, its files by member, and absolute path → member.
    """
    named = list(_named_files(study))
    if not named:
        return HERE, {}, {}
    base = "/".join([INPUTS, *["study"] * max(_steps_up(name) or 0 for name, _ in named)])
    files: dict[str, Path] = {}
    elsewhere: dict[str, str] = {}
    for name, path in named:
        member = posixpath.normpath(f"{base}/{name}")
        if _steps_up(name) is None:
            folders = ("", *(f"{k}/" for k in range(2, len(named) + 2)))
            places = (f"{_ELSEWHERE}/{folder}{path.name}" for folder in folders)
            member = elsewhere[name] = next(place for place in places if files.get(place, path) == path)
        if not is_safe(member):
            raise InputError(f"{shown(name)}: this name cannot be unpacked everywhere, rename the file and run again")
        files[member] = path
    return base, files, elsewhere


def _named_files(study: Study) -> Iterator[tuple[str, Path]]:
    """Each file as the study names it, and where it is."""
    tables = study.tables
    series = tables.get("boundary"), tables.get("tune", {}).get("holdout")
    names = [str(table["path"]) for table in series if isinstance(table, dict) and "path" in table]
    for name in (*names, *tables["loop"].get("include", []), *files_of(tables.get("sample"))):
        yield name, study.folder / name
    for code in (*study.rules.values(), *([study.reduction] if study.reduction else [])):
        module = code.name.partition(":")[0]
        yield f"{module.replace('.', '/')}.py", code.path


def _steps_up(name: str) -> int | None:
    """How many folders a relative path goes up, at its beginning; ``None`` for one that cannot be packed as it is."""
    parts = Path(name).parts
    up = next((k for k, part in enumerate(parts) if part != ".."), len(parts))
    return None if os.path.isabs(name) or ".." in parts[up:] else up


class Packed(NamedTuple):
    """An archive that was written.

    content_sha256: of its results.  inputs: members that the study reads.  elsewhere: files that it reads by a path
    that leads nowhere on another machine → member.
    """

    path: Path
    content_sha256: str
    inputs: list[str]
    elsewhere: dict[str, str]


def pack(folder: Path, path: Path | None = None) -> Packed:
    """Write the finished study in a folder as one file; ``path``: FOLDER.zip beside the folder by default.

    ``InputError`` if there is no finished study, or the file exists.  ``StorageError`` if a file cannot be read or
    written, ``IntegrityError`` if the folder is not sound.  Nothing half-written is left behind.
    """
    store = StudyFolder(folder)
    called = folder.absolute().name or "study"
    name = called if is_safe(called) else "study"
    path = path or (folder if folder.name else folder.absolute()).parent / f"{called}.zip"
    manifest = store.require_manifest()
    require_file("-o", path, ".zip")
    if exists(path):
        raise InputError(f"{path} exists: choose another name with -o, or delete it")
    ds = open_finished(folder)
    problems = problems_of_folder(store)
    if problems:
        raise IntegrityError("\n".join(problems))
    base, inputs, elsewhere = inputs_of(store.read_study(manifest))
    outputs = [RESULTS, *([str(ds.attrs["trace_file"])] if "trace_file" in ds.attrs else [])]
    # the folder of the author is private, and exists on no other machine
    moved = replace(manifest, relative_to=base, outputs={n: [file_sha256(store.path / n)] for n in outputs})
    text = (store.read_text() or "").encode()
    # a finished study has no shards; figures and reports can be made again
    members: dict[str, bytes | Path] = {STUDY: text, MANIFEST: moved.text.encode()}
    members |= {name: store.path / name for name in outputs} | inputs
    if inputs:  # where it can be run
        members[f"{base}/{STUDY}"] = text
    members = {README: _readme(name, ds, base, elsewhere).encode(), **dict(sorted(members.items()))}

    def write(unfinished: Path) -> None:
        with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_STORED) as archive:
            for member, source in members.items():
                _pack(archive, f"{name}/{member}", source)

    commit_written(path, write)
    read = [member for member in members if member.startswith(f"{INPUTS}/")]
    return Packed(path, str(ds.attrs["content_sha256"]), read, elsewhere)


def _pack(archive: zipfile.ZipFile, name: str, source: bytes | Path) -> None:
    """Write a member, bytes or a copy of a file."""
    info = zipfile.ZipInfo(name, _EPOCH)
    info.external_attr, info.create_system = _REGULAR, 3
    with storage_errors(Path(name) if isinstance(source, bytes) else source, "read"):
        file = BytesIO(source) if isinstance(source, bytes) else source.open("rb")
    with file:
        info.file_size = file.seek(0, os.SEEK_END)
        file.seek(0)
        with archive.open(info, "w") as member:
            shutil.copyfileobj(file, member, _BLOCK)


def _readme(name: str, ds: xr.Dataset, base: str, elsewhere: Mapping[str, str]) -> str:
    """How to check and use what is unpacked."""
    study = f"{name}/{STUDY}" if base == HERE else f"{name}/{base}/{STUDY}"
    lines = [
        printable(str(ds.attrs["title"])),
        "",
        f"A study made with fastcoil {ds.attrs['fastcoil_version']}; {MANIFEST} has the hashes of its files.",
        f"Check it:         fastcoil verify {name}",
        f"Look at it:       fastcoil report {name}",
        f"Compute it again: fastcoil run {study} -o again",
    ]
    lines += [f"To be there before: {printable(path)}   from {member}" for path, member in elsewhere.items()]
    return "\n".join(lines) + "\n"


def archive_problems(path: Path) -> list[str]:
    """Check an archive: a sentence for each problem.  It is unpacked in a temporary folder, and nothing of it is run.

    ``StorageError`` if it cannot be read, or there is no room to unpack it.
    """
    with storage_errors(path, "read"):
        path.open("rb").close()
    with tempfile.TemporaryDirectory(prefix="fastcoil-") as place:
        try:
            wrong = _problems(path, Path(place))
        except StorageError:
            raise
        except FastcoilError as error:
            wrong = str(error).splitlines()
        except Exception as error:  # the library raises many kinds where the bytes are no ZIP file
            wrong = [f"is not an archive ({error})"]
        return [f"{path}: {problem.replace(place, str(path))}" for problem in wrong]


def _problems(path: Path, place: Path) -> list[str]:
    """What is wrong with an archive, unpacked in ``place``: links become files there, and no name leads out of it."""
    with zipfile.ZipFile(path) as archive:
        if sum(info.file_size for info in archive.infolist()) > path.stat().st_size:
            return ["it has compressed members, as no archive of fastcoil has: nothing is unpacked"]
        unsafe = [name for name in archive.namelist() if not is_safe(name)]
        if unsafe:
            return [f"{shown(unsafe[0])} leads out of its folder: nothing is unpacked"]
        with storage_errors(place, "written"):
            archive.extractall(place)
    (folder,) = place.iterdir()
    manifest = Manifest.read(folder)
    if manifest is None:
        return [f"{MANIFEST} is missing"]
    if manifest.relative_to != HERE and not is_safe(manifest.relative_to):
        return [f"{MANIFEST} leads out of the archive, to {shown(manifest.relative_to)}"]
    store = StudyFolder(folder)
    # where paths of the study lead to its files on no other machine, it cannot be read
    return list(problems_of_results(store, manifest)) if exists(folder / _ELSEWHERE) else problems_of_folder(store)

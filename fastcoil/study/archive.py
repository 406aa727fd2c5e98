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

from fastcoil.base.errors import FastcoilError, InputError, IntegrityError, StorageError, short_repr
from fastcoil.base.files import convert_os_errors, exists, replace_atomically, require_output_file
from fastcoil.base.text import escape_control_characters
from fastcoil.loops.netcdf import file_sha256
from fastcoil.study.file.sample import sample_files
from fastcoil.study.file.spec import Study
from fastcoil.study.folder.folder import STUDY_FILE, StudyFolder
from fastcoil.study.folder.results import find_folder_problems, find_result_problems, open_finished
from fastcoil.study.folder.stored import MANIFEST_FILE, RESULTS_FILE, Manifest

README_FILE = "README.txt"
INPUTS_FOLDER, ARCHIVE_ROOT = "inputs", "."
"""Folder of the files that the study reads, and where its paths start if it reads none."""
_ELSEWHERE_FOLDER = f"{INPUTS_FOLDER}/elsewhere"
_MAX_NAME_BYTES, _MAX_PATH_PARTS = 200, 30  # bytes of a part of a path; parts of a path
_ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first moment that a ZIP file can record
_REGULAR_FILE_ATTRIBUTES = 0o100644 << 16
_COPY_BLOCK_BYTES = 2**20  # bytes


def is_safe_path(path: str) -> bool:
    """Whether a path can be unpacked anywhere, and leads nowhere but into the folder it is unpacked in."""
    parts = path.split("/")
    return len(parts) <= _MAX_PATH_PARTS and all(
        part not in ("", ".", "..")
        and part.isprintable()
        and not set(part) & set('\\:*?"<>|')
        and len(part.encode(errors="replace")) <= _MAX_NAME_BYTES
        and part == part.strip(" ")
        for part in parts
    )


def place_inputs(study: Study) -> tuple[str, dict[str, Path], dict[str, str]]:
    """Place the files that a study reads in its archive, so that its relative paths lead to them again.

    A path that goes up from the study file does so in the archive as well: the study is placed deep enough.  An
    absolute path is part of the study and leads nowhere on another machine: its file is packed, and the README says
    where it must be.

    Returns the folder where paths of the study start, its files by member, and absolute path → member.
    """
    named_files = list(_find_input_files(study))
    if not named_files:
        return ARCHIVE_ROOT, {}, {}
    base = "/".join([INPUTS_FOLDER, *["study"] * max(_count_parent_steps(name) or 0 for name, _ in named_files)])
    files: dict[str, Path] = {}
    elsewhere: dict[str, str] = {}
    for name, path in named_files:
        member = posixpath.normpath(f"{base}/{name}")
        if _count_parent_steps(name) is None:
            folders = ("", *(f"{k}/" for k in range(2, len(named_files) + 2)))
            places = (f"{_ELSEWHERE_FOLDER}/{folder}{path.name}" for folder in folders)
            member = elsewhere[name] = next(place for place in places if files.get(place, path) == path)
        if not is_safe_path(member):
            raise InputError(
                f"{short_repr(name)}: this name cannot be unpacked everywhere, rename the file and run again"
            )
        files[member] = path
    return base, files, elsewhere


def _find_input_files(study: Study) -> Iterator[tuple[str, Path]]:
    """Each file as the study names it, and where it is."""
    tables = study.tables
    series = tables.get("boundary"), tables.get("tune", {}).get("holdout")
    names = [str(table["path"]) for table in series if isinstance(table, dict) and "path" in table]
    for name in (*names, *tables["loop"].get("include", []), *sample_files(tables.get("sample"))):
        yield name, study.folder / name
    for code in (*study.rules.values(), *([study.reduction] if study.reduction else [])):
        module = code.name.partition(":")[0]
        yield f"{module.replace('.', '/')}.py", code.path


def _count_parent_steps(name: str) -> int | None:
    """How many folders a relative path goes up, at its beginning; ``None`` for one that cannot be packed as it is."""
    parts = Path(name).parts
    n_up = next((k for k, part in enumerate(parts) if part != ".."), len(parts))
    return None if os.path.isabs(name) or ".." in parts[n_up:] else n_up


class Archive(NamedTuple):
    """An archive that was written.

    content_sha256: of its results.  inputs: members that the study reads.  elsewhere: files that it reads by a path
    that leads nowhere on another machine → member.
    """

    path: Path
    content_sha256: str
    inputs: list[str]
    elsewhere: dict[str, str]


def write_archive(folder: Path, path: Path | None = None) -> Archive:
    """Write the finished study in a folder as one file; ``path``: FOLDER.zip beside the folder by default.

    ``InputError`` if there is no finished study, or the file exists.  ``StorageError`` if a file cannot be read or
    written, ``IntegrityError`` if the folder is not sound.  Nothing half-written is left behind.
    """
    store = StudyFolder(folder)
    folder_name = folder.absolute().name or "study"
    root_name = folder_name if is_safe_path(folder_name) else "study"
    path = path or (folder if folder.name else folder.absolute()).parent / f"{folder_name}.zip"
    manifest = store.require_manifest()
    require_output_file("-o", path, ".zip")
    if exists(path):
        raise InputError(f"{path} exists: choose another name with -o, or delete it")
    ds = open_finished(folder)
    problems = find_folder_problems(store)
    if problems:
        raise IntegrityError("\n".join(problems))
    base, inputs, elsewhere = place_inputs(store.read_study(manifest))
    outputs = [RESULTS_FILE, *([str(ds.attrs["trace_file"])] if "trace_file" in ds.attrs else [])]
    # the folder of the author is private, and exists on no other machine
    archive_manifest = replace(manifest, relative_to=base, outputs={n: [file_sha256(store.path / n)] for n in outputs})
    text = (store.read_text() or "").encode()
    # a finished study has no shards; figures and reports can be made again
    members: dict[str, bytes | Path] = {STUDY_FILE: text, MANIFEST_FILE: archive_manifest.text.encode()}
    members |= {root_name: store.path / root_name for root_name in outputs} | inputs
    if inputs:  # where it can be run
        members[f"{base}/{STUDY_FILE}"] = text
    members = {README_FILE: _readme_text(root_name, ds, base, elsewhere).encode(), **dict(sorted(members.items()))}

    def write(unfinished: Path) -> None:
        with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_STORED) as archive:
            for member, source in members.items():
                _write_member(archive, f"{root_name}/{member}", source)

    replace_atomically(path, write)
    input_members = [member for member in members if member.startswith(f"{INPUTS_FOLDER}/")]
    return Archive(path, str(ds.attrs["content_sha256"]), input_members, elsewhere)


def _write_member(archive: zipfile.ZipFile, name: str, source: bytes | Path) -> None:
    """Write a member, bytes or a copy of a file."""
    info = zipfile.ZipInfo(name, _ZIP_EPOCH)
    info.external_attr, info.create_system = _REGULAR_FILE_ATTRIBUTES, 3
    with convert_os_errors(Path(name) if isinstance(source, bytes) else source, "read"):
        file = BytesIO(source) if isinstance(source, bytes) else source.open("rb")
    with file:
        info.file_size = file.seek(0, os.SEEK_END)
        file.seek(0)
        with archive.open(info, "w") as member:
            shutil.copyfileobj(file, member, _COPY_BLOCK_BYTES)


def _readme_text(name: str, ds: xr.Dataset, base: str, elsewhere: Mapping[str, str]) -> str:
    """How to check and use what is unpacked."""
    study = f"{name}/{STUDY_FILE}" if base == ARCHIVE_ROOT else f"{name}/{base}/{STUDY_FILE}"
    lines = [
        escape_control_characters(str(ds.attrs["title"])),
        "",
        f"A study made with fastcoil {ds.attrs['fastcoil_version']}; {MANIFEST_FILE} has the hashes of its files.",
        f"Check it:         fastcoil verify {name}",
        f"Look at it:       fastcoil report {name}",
        f"Compute it again: fastcoil run {study} -o again",
    ]
    lines += [
        f"To be there before: {escape_control_characters(path)}   from {member}" for path, member in elsewhere.items()
    ]
    return "\n".join(lines) + "\n"


def find_archive_problems(path: Path) -> list[str]:
    """Check an archive: a sentence for each problem.  It is unpacked in a temporary folder, and nothing of it is run.

    ``StorageError`` if it cannot be read, or there is no room to unpack it.
    """
    with convert_os_errors(path, "read"):
        path.open("rb").close()
    with tempfile.TemporaryDirectory(prefix="fastcoil-") as place:
        try:
            problems = _find_unpacked_problems(path, Path(place))
        except StorageError:
            raise
        except FastcoilError as error:
            problems = str(error).splitlines()
        except Exception as error:  # the library raises many kinds where the bytes are no ZIP file
            problems = [f"is not an archive ({error})"]
        return [f"{path}: {problem.replace(place, str(path))}" for problem in problems]


def _find_unpacked_problems(path: Path, place: Path) -> list[str]:
    """What is wrong with an archive, unpacked in ``place``: links become files there, and no name leads out of it."""
    with zipfile.ZipFile(path) as archive:
        if sum(info.file_size for info in archive.infolist()) > path.stat().st_size:
            return ["it has compressed members, as no archive of fastcoil has: nothing is unpacked"]
        unsafe = [name for name in archive.namelist() if not is_safe_path(name)]
        if unsafe:
            return [f"{short_repr(unsafe[0])} leads out of its folder: nothing is unpacked"]
        with convert_os_errors(place, "written"):
            archive.extractall(place)
    (folder,) = place.iterdir()
    manifest = Manifest.read(folder)
    if manifest is None:
        return [f"{MANIFEST_FILE} is missing"]
    if manifest.relative_to != ARCHIVE_ROOT and not is_safe_path(manifest.relative_to):
        return [f"{MANIFEST_FILE} leads out of the archive, to {short_repr(manifest.relative_to)}"]
    store = StudyFolder(folder)
    # where paths of the study lead to its files on no other machine, it cannot be read
    return (
        list(find_result_problems(store, manifest))
        if exists(folder / _ELSEWHERE_FOLDER)
        else find_folder_problems(store)
    )

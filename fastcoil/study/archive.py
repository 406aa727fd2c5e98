"""A finished study in one file: study, results, inputs, environment and hashes; and what is wrong with such a file.

An archive is a plain ZIP file with the same bytes for the same results; nothing in it is compressed, since large
variables already are in their NetCDF files.  ``archive.json`` lists every member with its SHA-256.  Nothing in an
archive is trusted: names are checked before anything is unpacked, into a temporary folder, and nothing of it is run.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import IO, Any, NamedTuple

import xarray as xr

from fastcoil.base.errors import FastcoilError, InputError, IntegrityError, shown
from fastcoil.base.files import commit_written, exists, is_folder, make_folder, storage_errors
from fastcoil.base.text import printable
from fastcoil.loops.provenance import ABSENT, PACKAGES
from fastcoil.study.file.spec import Study
from fastcoil.study.folder.folder import STUDY, StudyFolder
from fastcoil.study.folder.manifest import MANIFEST, Manifest, checksum
from fastcoil.study.folder.result_files import RESULTS
from fastcoil.study.folder.results import open_finished
from fastcoil.study.folder.verify import find_problems, problems_of_results

LISTING, README = "archive.json", "README.txt"
INPUTS, HERE = "inputs", "."
"""Folder of the files that the study reads, and where its paths start if it reads none."""
FORMAT = 1
_KIND, _CHECKSUM = "fastcoil archive", "sha256"
_LONGEST_NAME, _MOST_PARTS = 200, 30  # bytes of a part of a path; parts of a path
_CHUNK = 2**20
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first moment that a ZIP file can record
_REGULAR = 0o100644 << 16
_MOST_MEMBERS, _LARGEST_LISTING = 1000, 2**20
_END_BYTES, _MEMBER_BYTES, _LARGEST_PLAIN = 22, 76, 2**31
"""Of a ZIP file: its end; two headers of a member, without the name; the size below which no 64-bit form is used."""
_UNREADABLE = (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError, RuntimeError)
"""What the library raises on bytes that are no ZIP file."""


class Entry(NamedTuple):
    """A file: how many bytes, and their SHA-256."""

    size: int
    sha256: str


@dataclass(frozen=True)
class Listing:
    """What an archive holds.

    files: by path in the folder of the study, ``archive.json`` itself left out.  elsewhere: files that the study reads
    by a path that leads nowhere on another machine → the member that has their bytes.  made_with: versions and machine.
    """

    content_sha256: str
    made_with: Mapping[str, Any]
    elsewhere: Mapping[str, str]
    files: Mapping[str, Entry]

    @property
    def data(self) -> bytes:
        """The content of ``archive.json``."""
        content = {
            "kind": _KIND,
            "format": FORMAT,
            "content_sha256": self.content_sha256,
            "made_with": dict(self.made_with),
            "elsewhere": dict(self.elsewhere),
            "files": {name: {"bytes": size, "sha256": sha256} for name, (size, sha256) in self.files.items()},
        }
        return (json.dumps({**content, _CHECKSUM: checksum(content)}, indent=1, ensure_ascii=False) + "\n").encode()

    @classmethod
    def parse(cls, data: bytes) -> Listing:
        """Read the content of ``archive.json``; raises ValueError, in words, where it is none."""
        try:
            found = json.loads(data)
            if found["kind"] != _KIND or type(found["format"]) is not int:
                raise ValueError("is no list of an archive")
            if found["format"] > FORMAT:
                raise ValueError("was written by a later version of fastcoil: check it with that version")
            if found.pop(_CHECKSUM) != checksum(found):
                raise ValueError("is damaged (its checksum differs)")
            files = {name: Entry(each["bytes"], each["sha256"]) for name, each in found["files"].items()}
            return cls(str(found["content_sha256"]), dict(found["made_with"]), dict(found["elsewhere"]), files)
        except (KeyError, TypeError, AttributeError, RecursionError, UnicodeDecodeError, json.JSONDecodeError):
            raise ValueError("is damaged (it is no list of an archive)") from None


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


@dataclass
class Inputs:
    """Where the paths of a study start in its archive, its files by member, and those that it will not find there."""

    base: str
    files: dict[str, Path] = field(default_factory=dict)
    elsewhere: dict[str, str] = field(default_factory=dict)


def inputs_of(study: Study) -> Inputs:
    """Place the files that a study reads in its archive, so that its relative paths lead to them again.

    A path that goes up from the study file does so in the archive as well: the study is placed deep enough.  An
    absolute path is part of the study and leads nowhere on another machine: its file is packed, and the README says
    where it must be.
    """
    named = list(_named_files(study))
    if not named:
        return Inputs(HERE)
    up = max((_steps_up(name) for name, _ in named if _is_relocatable(name)), default=0)
    found = Inputs("/".join([INPUTS, *["study"] * up]))
    for name, path in named:
        if _is_relocatable(name):
            member = os.path.normpath(f"{found.base}/{name}")
        else:
            places = (
                f"{INPUTS}/elsewhere/{folder}{path.name}" for folder in ("", *(f"{k}/" for k in range(2, 10_000)))
            )
            member = next(place for place in places if found.files.get(place, path) == path)
            found.elsewhere[name] = member
        if not is_safe(member):
            raise InputError(f"{shown(name)}: this name cannot be unpacked everywhere, rename the file and run again")
        found.files[member] = path
    return found


def _named_files(study: Study) -> Iterator[tuple[str, Path]]:
    """Each file as the study names it, and where it is."""
    tables = study.tables
    holdout = tables.get("tune", {}).get("holdout")
    names = [
        str(table["path"]) for table in (tables.get("boundary"), holdout) if isinstance(table, dict) and "path" in table
    ]
    for name in (*names, *tables["loop"].get("include", [])):
        yield name, study.folder / name
    for code in (*study.rules.values(), *([study.reduction] if study.reduction else [])):
        module = code.name.partition(":")[0]
        yield f"{module.replace('.', '/')}.py", code.path


def _is_relocatable(name: str) -> bool:
    """Whether a path is relative, and goes up only at its beginning."""
    return not os.path.isabs(name) and ".." not in Path(name).parts[_steps_up(name) :]


def _steps_up(name: str) -> int:
    parts = Path(name).parts
    return next((k for k, part in enumerate(parts) if part != ".."), len(parts))


class Packed(NamedTuple):
    """What was written, and what it holds."""

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
    manifest = store.require_manifest()
    if path.suffix != ".zip" or not is_folder(path.absolute().parent):
        raise InputError(f"-o {path}: give a file NAME.zip in a folder that exists")
    if exists(path):
        raise InputError(f"{path} exists: choose another name with -o, or delete it")
    ds = open_finished(folder)
    problems = find_problems(store)
    if problems:
        raise IntegrityError("\n".join(problems))
    inputs = inputs_of(store.read_study(manifest))
    members = _members(store, ds, manifest, inputs)
    entries = {member: _entry(source) for member, source in members.items()}
    listing = Listing(str(ds.attrs["content_sha256"]), _made_with(ds), inputs.elsewhere, entries)
    guide = _readme(name, ds.attrs, listing, inputs.base).encode()
    listing = replace(listing, files={README: _entry(guide), **entries})

    def write(unfinished: Path) -> None:
        with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_STORED) as file:
            for member, source in {LISTING: listing.data, README: guide, **members}.items():
                _add(file, f"{name}/{member}", source, listing.files.get(member) or _entry(listing.data))

    commit_written(path, write)
    return Packed(path, listing)


def _members(store: StudyFolder, ds: xr.Dataset, manifest: Manifest, inputs: Inputs) -> dict[str, bytes | Path]:
    """What is packed, by path in the folder: bytes, or a file to copy.

    A finished study has no shards; figures and reports can be made again.
    """
    outputs = [RESULTS, *([str(ds.attrs["trace_file"])] if "trace_file" in ds.attrs else [])]
    # the folder of the author is private, and exists on no other machine
    moved = replace(manifest, relative_to=inputs.base, outputs={n: [manifest.outputs[n][0]] for n in outputs})
    text = (store.read_text() or "").encode()
    found: dict[str, bytes | Path] = {STUDY: text, MANIFEST: moved.text.encode()}
    if inputs.files:  # where it can be run
        found[f"{inputs.base}/{STUDY}"] = text
    found |= {name: store.path / name for name in outputs} | inputs.files
    return dict(sorted(found.items()))


def _made_with(ds: xr.Dataset) -> dict[str, object]:
    texts = ("fastcoil_version", "python_version", "platform", "model_sha256", "date_created")
    tables = ("package_versions", "computed_on")
    return {n: str(ds.attrs[n]) for n in texts} | {n: json.loads(ds.attrs[n]) for n in tables}


def _entry(source: bytes | Path) -> Entry:
    return _copy(source, lambda chunk: None)


def _add(file: zipfile.ZipFile, name: str, source: bytes | Path, entry: Entry) -> None:
    info = zipfile.ZipInfo(name, _EPOCH)
    info.external_attr, info.create_system, info.file_size = _REGULAR, 3, entry.size
    with file.open(info, "w") as member:
        copied = _copy(source, member.write)
    if copied != entry:
        raise IntegrityError(f"{name} changed while it was packed: wait until nothing writes to it, then try again")


def _copy(source: bytes | Path | IO[bytes], write: Callable[[bytes], object]) -> Entry:
    """Hand all bytes to ``write``, piece by piece."""
    digest, size = hashlib.sha256(), 0
    if isinstance(source, Path):
        with storage_errors(source, "read"), source.open("rb") as file:
            return _copy(file, write)
    stream: IO[bytes] = io.BytesIO(source) if isinstance(source, bytes) else source
    while chunk := stream.read(_CHUNK):
        digest.update(chunk)
        size += len(chunk)
        write(chunk)
    return Entry(size, digest.hexdigest())


def _readme(name: str, attrs: Mapping[Any, Any], listing: Listing, base: str) -> str:
    """For readers in ten years: what the archive is, how to check it, read it and compute it again."""
    made = listing.made_with
    known = made["package_versions"]
    pinned = " ".join(f"{each}=={known[each]}" for each in PACKAGES if known.get(each, ABSENT) != ABSENT)
    study = f"{name}/{STUDY}" if base == HERE else f"{name}/{base}/{STUDY}"
    lines = [
        printable(str(attrs["title"])),
        "",
        "A study made with fastcoil: the study file, its results, the files that it reads, and their hashes.",
        "",
        f"content_sha256   {listing.content_sha256}",
        f"fastcoil         {made['fastcoil_version']}",
        f"Python           {made['python_version']}",
        f"machine          {made['platform']}",
        f"run on           {made['date_created']}",
        "",
        "Check it, before and after it is unpacked:",
        "",
        f"    fastcoil verify {name}.zip",
        f"    unzip {name}.zip",
        f"    fastcoil verify {name}",
        "",
        "Look at it:",
        "",
        f"    fastcoil report {name}",
        f"    python -c 'import fastcoil as fc; print(fc.open_study(\"{name}\"))'",
        "",
        "Compute it again, with the versions that made it:",
        "",
        f"    python -m pip install fastcoil=={made['fastcoil_version']} {pinned}".rstrip(),
        f"    fastcoil run {study} -o again",
        "",
        "On one kind of processor, content_sha256 is then the same to the last digit.",
        "One scenario alone, with all its traces: fastcoil rerun --help",
    ]
    if listing.elsewhere:
        lines += ["", "The study reads these files by a path of its author's machine.  Before it can be verified, once",
                  "unpacked, or computed again, they must be there:", ""]  # fmt: skip
        lines += [f"    {printable(path)}   from {member}" for path, member in listing.elsewhere.items()]
    lines += ["", "Files:", ""]
    lines += [f"    {entry.sha256}  {member}" for member, entry in listing.files.items()]
    return "\n".join(lines) + "\n"


def archive_problems(path: Path) -> list[str]:
    """Check an archive: a sentence for each problem.  It is unpacked in a temporary folder, and nothing of it is run.

    Raises
    ------
    StorageError
        If it cannot be read, or there is no room to unpack it.
    """
    try:
        with storage_errors(path, "read"), path.open("rb"):
            pass
        with zipfile.ZipFile(path) as archive:
            problems = list(_wrong_members(archive.infolist(), path.stat().st_size)) or _wrong_content(archive, path)
        return [f"{path}: {problem}" for problem in problems]
    except FastcoilError:
        raise
    except _UNREADABLE as error:
        return [f"{path} is damaged, or no archive of fastcoil ({error}): get it again from its author"]


def _wrong_members(infos: list[zipfile.ZipInfo], size: int) -> Iterator[str]:
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
    plain = _END_BYTES + sum(_MEMBER_BYTES + 2 * len(i.orig_filename.encode()) + i.compress_size for i in infos)
    if size != plain < _LARGEST_PLAIN:  # other programs may see files there
        yield "it has bytes that belong to no member"


def _wrong_content(archive: zipfile.ZipFile, path: Path) -> list[str]:
    name = archive.namelist()[0].split("/")[0]
    members = {info.filename.removeprefix(f"{name}/"): info for info in archive.infolist()}
    if LISTING not in members or members[LISTING].file_size > _LARGEST_LISTING:
        return [f"it has no {LISTING}, or one that is too large: it is no archive of fastcoil"]
    try:
        listing = Listing.parse(archive.read(members[LISTING]))
    except zipfile.BadZipFile as error:
        return [f"its {LISTING} is damaged ({error}): get it again from its author"]
    except ValueError as error:
        return [f"its {LISTING} {error}"]
    wrong = [f"{shown(m)} is not on its list: somebody added it" for m in members if m not in {LISTING, *listing.files}]
    wrong += [f"{shown(m)} is missing" for m in listing.files if m not in members]
    if wrong:
        return wrong
    with tempfile.TemporaryDirectory(prefix="fastcoil-") as place, storage_errors(Path(place), "written"):
        for member, info in members.items():
            to = Path(place) / info.filename
            make_folder(to.parent, parents=True)
            try:
                with archive.open(info) as packed, to.open("xb") as file:
                    found = _copy(packed, file.write)
            except _UNREADABLE:
                found = Entry(0, "")
            if member != LISTING and found != listing.files[member]:
                wrong.append(f"{shown(member)} is damaged (its bytes are not those that were packed)")
        try:
            wrong = wrong or _wrong_folder(Path(place) / name, listing)
        except FastcoilError as error:
            wrong = str(error).splitlines()
        return [problem.replace(place, str(path)) for problem in wrong]


def _wrong_folder(folder: Path, listing: Listing) -> list[str]:
    """What is wrong with the folder that was unpacked."""
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

"""Archives that somebody damaged or forged: one clear sentence, nothing unpacked beside its folder, nothing run."""

import hashlib
import io
import json
import random
import zipfile

import pytest
from helpers.commands import fastcoil
from helpers.damage import damaged
from helpers.studies import PLAIN, copied

from fastcoil.base.errors import IntegrityError
from fastcoil.study import maintenance
from fastcoil.study.archive import Entry, Listing, is_safe, pack
from fastcoil.study.folder.manifest import checksum

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """The bytes of a sound archive of the folder ``out``."""
    folder = tmp_path_factory.mktemp("author") / "out"
    copied(PLAIN, folder)
    return pack(folder).path.read_bytes()


@pytest.fixture
def members(sound):
    """Name → bytes of its members."""
    with zipfile.ZipFile(io.BytesIO(sound)) as file:
        return {name: file.read(name) for name in file.namelist()}


def zipped(path, contents, **looks):
    """A ZIP file as fastcoil writes it, but for what ``looks`` changes of a member: attributes of its ZipInfo."""
    with zipfile.ZipFile(path, "w") as file:
        for name, data in contents.items():
            info = zipfile.ZipInfo(name)
            info.external_attr, info.create_system = 0o100644 << 16, 3
            for key, value in looks.get(name, {}).items():
                setattr(info, key, value)
            file.writestr(info, data, compress_type=info.compress_type)
    return path


def relisted(members, **changes):
    """The members with a list that agrees with them, as a forger writes it; ``changes`` of the Listing."""
    listing = Listing.parse(members["out/archive.json"])
    files = {
        name.removeprefix("out/"): Entry(len(data), hashlib.sha256(data).hexdigest())
        for name, data in members.items()
        if name != "out/archive.json"
    }
    found = Listing(listing.content_sha256, listing.made_with, changes.get("elsewhere", {}), files)
    return members | {"out/archive.json": found.data}


def only(path):
    """The one sentence on an archive, which the command line gives with its exit code."""
    (problem,) = maintenance.verify(path)
    assert problem.startswith(str(path))
    done = fastcoil("verify", path)
    assert (done.exit_code, done.stderr) == (IntegrityError.exit_code, f"fastcoil: {problem}\n")
    return problem


def test_what_is_written_here_is_what_fastcoil_writes(members, tmp_path):
    """So that every test below fails for what it changes, and for nothing else."""
    assert maintenance.verify(zipped(tmp_path / "x.zip", members)) == []
    assert maintenance.verify(zipped(tmp_path / "y.zip", relisted(members))) == []


@pytest.mark.parametrize(
    "name",
    ["../evil", "/etc/evil", "out/../../evil", "out/a\\..\\evil", "C:/evil", "out//evil", "out/./evil", "out/\x1b[2J",
     "out/" + "x" * 300, "evil", "out/evil/", "out/study.toml/evil"],
)  # fmt: skip
def test_no_name_leads_out_of_the_folder(members, tmp_path, name):
    place = tmp_path / "deep" / "er"
    place.mkdir(parents=True)
    problem = only(zipped(place / "x.zip", members | {name: b"evil"}))
    assert "is no name of a file" in problem or "is a file and a folder" in problem or "no plain file" in problem
    assert [p.name for p in tmp_path.rglob("*") if p.is_file()] == ["x.zip"]


@pytest.mark.parametrize(
    ("look", "said"),
    [({"external_attr": 0o120777 << 16}, "is a link"), ({"compress_type": zipfile.ZIP_DEFLATED}, "is compressed")],
)
def test_links_and_compressed_members_are_not_unpacked(members, tmp_path, look, said):
    assert said in only(zipped(tmp_path / "x.zip", members, **{"out/README.txt": look}))


def test_a_bomb_is_not_unpacked(members, tmp_path):
    path = zipped(tmp_path / "x.zip", members | {"out/bomb": bytes(10**8)}, **{"out/bomb": {"compress_type": 8}})
    assert path.stat().st_size < 10**6
    assert "'out/bomb' is compressed" in only(path)


def test_a_name_twice(members, tmp_path):
    path = zipped(tmp_path / "x.zip", members)
    with zipfile.ZipFile(path, "a") as file:
        info = zipfile.ZipInfo("out/study.toml")
        info.external_attr = 0o100644 << 16
        with pytest.warns(UserWarning, match="Duplicate name"):
            file.writestr(info, members["out/study.toml"])
    assert "'out/study.toml' is there twice" in only(path)


def test_members_added_missing_and_changed(members, tmp_path):
    assert "'mine.py' is not on its list: somebody added it" in only(
        zipped(tmp_path / "a.zip", members | {"out/mine.py": b""})
    )
    fewer = {name: data for name, data in members.items() if name != "out/results.nc"}
    assert "'results.nc' is missing" in only(zipped(tmp_path / "b.zip", fewer))
    other = members | {"out/study.toml": members["out/study.toml"] + b"#"}
    assert "'study.toml' is damaged (its bytes are not those that were packed)" in only(
        zipped(tmp_path / "c.zip", other)
    )
    assert "it has no archive.json" in only(zipped(tmp_path / "d.zip", {"out/x": b""}))
    assert "2 folders side by side" in only(zipped(tmp_path / "e.zip", members | {"other/x": b""}))


def test_bytes_that_belong_to_no_member(sound, members, tmp_path):
    path = tmp_path / "x.zip"
    for data in (b"#!/bin/sh\n" + sound, sound + b"more", sound[:-22] + b"more" + sound[-22:]):
        path.write_bytes(data)
        assert only(path)
    # a file that a list of members leaves out, but a program that reads from the front finds
    with zipfile.ZipFile(path, "w") as file:
        for name, data in {"out/hidden": b"x", **members}.items():
            info = zipfile.ZipInfo(name)
            info.external_attr = 0o100644 << 16
            file.writestr(info, data)
        del file.filelist[0]
    assert "has bytes that belong to no member" in only(path)


def test_lists_that_agree_with_forged_members_do_not_help(members, tmp_path):
    """A forger can write every hash of ours; what he cannot do is lead us elsewhere or pass other results for these."""
    run = json.loads(members["out/run.json"])

    def forged(**changes):
        content = {n: v for n, v in run.items() if n not in ("format", "sha256")} | changes
        data = json.dumps({**content, "format": run["format"], "sha256": checksum(content)}).encode()
        return relisted(members | {"out/run.json": data})

    for place in ("/etc", "../..", "inputs/../.."):
        assert "run.json leads out of the archive" in only(zipped(tmp_path / "a.zip", forged(relative_to=place)))
    assert "hash of its bytes differs" in only(zipped(tmp_path / "b.zip", forged(outputs={"results.nc": ["0" * 64]})))
    text = members["out/study.toml"].replace(b"[0.0, 0.9]", b"[0.0, 0.8]")
    path = zipped(tmp_path / "c.zip", relisted(members | {"out/study.toml": text}))
    assert "changed since the run was started" in maintenance.verify(path)[0]
    other = Listing.parse(members["out/archive.json"])
    files = {n: e for n, e in other.files.items() if n != "archive.json"}
    for elsewhere in ({}, {"/etc/x.csv": "results.nc"}):
        claimed = Listing("0" * 64, other.made_with, elsewhere, files)
        path = zipped(tmp_path / "d.zip", members | {"out/archive.json": claimed.data})
        assert "content_sha256 differs" in only(path)


def test_whatever_happens_to_its_bytes_it_is_told_and_nothing_else_happens(sound, tmp_path):
    dice = random.Random(17)
    path = tmp_path / "x.zip"
    unseen = 0
    for _ in range(100):
        data = damaged(sound, dice)
        path.write_bytes(data)
        problems = maintenance.verify(path)
        assert all("\n" not in problem for problem in problems)
        unseen += data != sound and not problems
        assert list(tmp_path.iterdir()) == [path]
    # dates and versions of the ZIP format are all that nobody hashes
    assert unseen <= 2


@pytest.mark.parametrize("data", [b"", b"PK", b"PK\5\6" + bytes(18), b"x" * 200, b"<html></html>"])
def test_other_files_are_no_archives(tmp_path, data):
    path = tmp_path / "x.zip"
    path.write_bytes(data)
    assert only(path)


def test_safe_names():
    assert all(map(is_safe, ("study.toml", "inputs/day one.csv", "inputs/é.toml", ".lock")))
    assert not any(map(is_safe, ("", "a/", "/a", "a/../b", "a\\b", "c:x", "a\nb", " a", "a/" * 40 + "b")))

"""Damaged, foreign and lost shards: they are found and quarantined, and the next run repairs the study."""

import errno
import hashlib
import os
import random
import re
import shutil

import netCDF4
import pytest
import xarray as xr
from helpers.studies import DAYS, PLAIN, larger, quarantined, resume, run, run_until_interrupted, shards, verify

from fastcoil.base.errors import IntegrityError, StorageError
from fastcoil.loops.netcdf import netcdf_bytes
from fastcoil.study import maintenance
from fastcoil.study.folder import stored
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.stored import Shards

pytestmark = pytest.mark.kernel


def shards_of(folder):
    """The shards of the run in a folder."""
    store = StudyFolder(folder)
    return Shards(store.path, store.require_manifest().key)


def named(data, first=0):
    """The name of a shard with these bytes."""
    return f"{first:09d}-{hashlib.sha256(data).hexdigest()[:32]}.nc"


@pytest.mark.parametrize(
    "cut", [lambda d: d[:-1], lambda d: d[: len(d) // 2], lambda d: b"", lambda d: d + b"\0"],
    ids=["a byte less", "half", "nothing", "a byte more"],
)  # fmt: skip
def test_a_shard_of_another_length_is_quarantined_and_run_again(broken_off, cut):
    path = shards(broken_off)[0]
    path.write_bytes(cut(path.read_bytes()))
    (problem,) = verify(broken_off)
    assert str(path) in problem
    (warned,) = resume(broken_off)
    assert f"{path} is damaged (its hash differs): moved to quarantine/" in warned
    assert quarantined(broken_off) == [path.name]


def test_a_flipped_bit_anywhere_in_a_shard_is_found(broken_off):
    path, checked = shards(broken_off)[0], shards_of(broken_off)
    good = path.read_bytes()
    positions = random.Random(1).sample(range(8 * len(good)), 1000)
    for at in [0, 8 * len(good) - 1, *positions]:
        damaged = bytearray(good)
        damaged[at // 8] ^= 1 << at % 8
        path.write_bytes(damaged)
        assert next(checked.inspect()) == (path, None, "is damaged (its hash differs)"), at
    (warned,) = resume(broken_off)
    assert path.name in warned


def filled(path):
    """A file with the structure of a shard and none of its values, as a writer leaves it that is killed."""
    empty = netCDF4.Dataset("filled.nc", "w", memory=2**16)
    with netCDF4.Dataset(path) as file:
        for name, dimension in file.dimensions.items():
            empty.createDimension(name, len(dimension))
        for name, variable in file.variables.items():
            copy = empty.createVariable(name, variable.dtype, variable.dimensions)
            if name == "scenario":
                copy[:] = variable[:]
        empty.study = file.study
        image = empty.close()
    return bytes(image)


def test_a_shard_that_opens_but_was_never_filled_is_quarantined(broken_off):
    path = shards(broken_off)[0]
    data = filled(path)
    path.write_bytes(data)
    assert "is damaged (its hash differs)" in verify(broken_off)[0]
    path.rename(path.with_name(named(data)))
    assert "was never filled" in verify(broken_off)[0]
    (warned,) = resume(broken_off)
    assert named(data) in warned


def test_a_shard_of_another_study_is_quarantined(broken_off, tmp_path):
    other = tmp_path / "other" / "out"
    other.parent.mkdir()
    run_until_interrupted(larger(PLAIN), other, 1)
    (foreign,) = shards(other)
    shutil.copy(foreign, broken_off / "shards")
    (warned,) = resume(broken_off)
    assert f"{foreign.name} belongs to another study or another version of the model" in warned
    assert quarantined(broken_off) == [foreign.name]


@pytest.mark.parametrize(
    "forge",
    [
        lambda part: part.assign(status=part["status"].astype(float)),
        lambda part: part.assign(status=part["status"].expand_dims(day=2)),
        lambda part: part.isel(scenario=[0, *range(part["scenario"].size - 1, 0, -1)]),
        lambda part: part.isel(scenario=[0, 0, 1]),
        lambda part: part.assign_coords(scenario=part["scenario"].astype(float)),
        lambda part: part.assign(rmse=part["rmse"].astype("f4")),
        lambda part: part.assign(iae=part["iae"].expand_dims(day=2)),
    ],
    ids=["real status", "status by day", "descending", "twice", "real number", "short metric", "metric by day"],
)
def test_a_shard_of_another_form_is_named_by_verify_though_its_name_is_right(broken_off, forge):
    path = shards(broken_off)[0]
    forged = netcdf_bytes(forge(xr.load_dataset(path)))
    path.unlink()
    path = path.with_name(named(forged))
    path.write_bytes(forged)
    assert verify(broken_off) == [f"{path} does not have the form of a shard"]


def test_a_shard_beyond_the_study_is_found_by_every_command(broken_off):
    shard = next(shards_of(broken_off).inspect()).part
    shards_of(broken_off).commit(shard.assign_coords(scenario=shard["scenario"].values + 900))
    said = rf"shards holds scenario 90\d, the study has {4 * DAYS}: delete the folder and run again"
    (problem,) = verify(broken_off)
    assert re.search(said, problem)
    for command in (maintenance.status, lambda folder: run(PLAIN, folder)):
        with pytest.raises(IntegrityError, match=said):
            command(broken_off)


def test_a_renamed_shard_and_one_under_two_names_are_quarantined(broken_off):
    first, second = shards(broken_off)
    shutil.copy(first, first.with_name("000000001" + first.name[9:]))
    second.rename(second.with_name("000000003" + second.name[9:]))
    warned = resume(broken_off)
    assert len(warned) == 2
    assert all("does not match its name" in t for t in warned)
    assert quarantined(broken_off) == ["000000001" + first.name[9:], "000000003" + second.name[9:]]


def test_foreign_files_among_the_shards_are_kept_in_quarantine(broken_off):
    place = broken_off / "shards"
    (place / "notes.txt").write_text("mine")
    (place / "thesis.nc").write_bytes(b"CDF\1")
    (place / "folder").mkdir()
    (place / "folder" / "inside").write_text("mine too")
    (place / named(b"no NetCDF")).write_bytes(b"no NetCDF")
    xr.Dataset().to_netcdf(place / "empty.nc")
    empty = (place / "empty.nc").read_bytes()
    (place / "empty.nc").rename(place / named(empty))
    assert len(verify(broken_off)) == 5
    warned = resume(broken_off)
    assert len(warned) == 5
    assert len(quarantined(broken_off)) == 5
    assert (broken_off / "quarantine" / "notes.txt").read_text() == "mine"
    assert (broken_off / "quarantine" / "folder" / "inside").read_text() == "mine too"


def test_a_file_that_joins_the_shards_of_a_finished_study_is_not_deleted_with_them(broken_off, monkeypatch):
    monkeypatch.setattr(Shards, "discard", lambda _: None)  # as if it were killed there
    run(PLAIN, broken_off)
    monkeypatch.undo()
    (broken_off / "shards" / "notes.txt").write_text("mine")
    resume(broken_off)
    assert (broken_off / "quarantine" / "notes.txt").read_text() == "mine"


def test_half_written_files_of_a_killed_run_are_no_damage_and_are_removed(broken_off):
    for place in (broken_off, broken_off / "shards"):
        (place / ".results.nc.1.tmp").write_bytes(b"half")
    assert verify(broken_off) == []
    assert resume(broken_off) == []


@pytest.mark.parametrize("error", [OSError(-101, "NetCDF: HDF error"), RuntimeError("NetCDF: HDF error")], ids=repr)
def test_a_sound_shard_for_which_there_is_no_memory_is_not_set_aside(broken_off, monkeypatch, error):
    def refuse(*_):
        raise error

    monkeypatch.setattr(stored, "load", refuse)
    for look in (lambda: run(PLAIN, broken_off), lambda: maintenance.verify(broken_off)):
        with pytest.raises(StorageError, match="is sound, and cannot be read .*: the memory ran out") as refused:
            look()
        assert refused.value.exit_code == 4
    assert quarantined(broken_off) == []
    monkeypatch.undo()
    assert resume(broken_off) == []


def test_a_shard_that_cannot_be_made_for_lack_of_memory_ends_the_run_in_a_sentence(broken_off, monkeypatch):
    def refuse(_):
        raise OSError(-101, "NetCDF: HDF error")

    monkeypatch.setattr(stored, "netcdf_bytes", refuse)
    with pytest.raises(StorageError, match="a shard cannot be made .*: the memory ran out") as refused:
        run(PLAIN, broken_off)
    assert refused.value.errno == errno.ENOMEM
    monkeypatch.undo()
    assert resume(broken_off) == []


def test_shards_that_cannot_be_listed_are_not_taken_for_none(broken_off, monkeypatch):
    listdir = os.listdir

    def refuse(path="."):
        if str(path).endswith("shards"):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return listdir(path)

    monkeypatch.setattr(os, "listdir", refuse)
    for look in (maintenance.status, maintenance.verify, lambda out: run(PLAIN, out)):
        with pytest.raises(StorageError, match=r"shards cannot be (read|cleaned up): Permission denied"):
            look(broken_off)
    monkeypatch.undo()
    assert resume(broken_off) == []

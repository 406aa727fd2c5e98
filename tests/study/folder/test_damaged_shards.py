"""Damaged, foreign and lost shards: they are found and quarantined, and the next run repairs the study."""

import errno
import hashlib
import os
import random
import shutil

import pytest
import xarray as xr
from helpers.studies import PLAIN, larger, quarantined, resume, run, run_until_interrupted, shards, verify

from fastcoil.base.errors import StorageError
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


@pytest.mark.parametrize("cut", [lambda d: d[:-1], lambda d: b""], ids=["a byte less", "nothing"])
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
    positions = random.Random(1).sample(range(8 * len(good)), 300)
    for at in [0, 8 * len(good) - 1, *positions]:
        damaged = bytearray(good)
        damaged[at // 8] ^= 1 << at % 8
        path.write_bytes(damaged)
        assert next(checked.inspect()) == (path, None, "is damaged (its hash differs)"), at
    (warned,) = resume(broken_off)
    assert path.name in warned


def test_a_shard_of_another_study_is_quarantined(broken_off, tmp_path):
    other = tmp_path / "other" / "out"
    other.parent.mkdir()
    run_until_interrupted(larger(PLAIN), other, 1)
    (foreign,) = shards(other)
    shutil.copy(foreign, broken_off / "shards")
    (warned,) = resume(broken_off)
    assert f"{foreign.name} belongs to another study or another version of the model" in warned
    assert quarantined(broken_off) == [foreign.name]


def test_a_shard_under_two_names_counts_once(broken_off):
    first, _ = shards(broken_off)
    shutil.copy(first, first.with_name("000000001" + first.name[9:]))
    assert resume(broken_off) == []


def test_foreign_files_among_the_shards_are_kept_in_quarantine(broken_off):
    place = broken_off / "shards"
    (place / "notes.txt").write_text("mine")
    (place / "thesis.nc").write_bytes(b"CDF\1")
    (place / "folder").mkdir()
    (place / "folder" / "inside").write_text("mine too")
    xr.Dataset().to_netcdf(place / "empty.nc")
    empty = (place / "empty.nc").read_bytes()
    (place / "empty.nc").rename(place / named(empty))
    assert len(verify(broken_off)) == 4
    warned = resume(broken_off)
    assert len(warned) == 4
    assert len(quarantined(broken_off)) == 4
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


def test_a_sound_shard_for_which_there_is_no_memory_is_not_set_aside(broken_off, monkeypatch):
    for error in (OSError(-101, "NetCDF: HDF error"), RuntimeError("NetCDF: HDF error")):

        def refuse(*_, error=error):
            raise error

        monkeypatch.setattr(stored, "load", refuse)
        for look in (lambda out: run(PLAIN, out), maintenance.verify):
            with pytest.raises(StorageError, match="is sound, and cannot be read .*: the memory ran out") as refused:
                look(broken_off)
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

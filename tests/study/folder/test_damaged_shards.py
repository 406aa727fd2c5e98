"""Damaged, foreign and lost shards: they are found and quarantined, and the next run repairs the study."""

import errno
import hashlib
import os
import random
import shutil
from unittest.mock import Mock

import pytest
import xarray as xr
from helpers.studies import (
    PLAIN_STUDY,
    quarantined_names,
    resume_to_end,
    run,
    run_until_interrupted,
    shard_files,
    verify_unchanged,
    with_larger_sweep,
)

from fastcoil.base.errors import StorageError
from fastcoil.study import maintenance
from fastcoil.study.folder import stored
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.stored import Shards

pytestmark = pytest.mark.kernel


def open_shards(folder):
    """The shards of the run in a folder."""
    store = StudyFolder(folder)
    return Shards(store.path, store.require_manifest().key)


def shard_file_name(data, first=0):
    """The name of a shard with these bytes."""
    return f"{first:09d}-{hashlib.sha256(data).hexdigest()[:32]}.nc"


@pytest.mark.parametrize("cut", [lambda d: d[:-1], lambda d: b""], ids=["a byte less", "nothing"])
def test_a_shard_of_another_length_is_quarantined_and_run_again(interrupted_folder, cut):
    path = shard_files(interrupted_folder)[0]
    path.write_bytes(cut(path.read_bytes()))
    (problem,) = verify_unchanged(interrupted_folder)
    assert str(path) in problem
    (warned,) = resume_to_end(interrupted_folder)
    assert f"{path} is damaged (its hash differs): moved to quarantine/" in warned
    assert quarantined_names(interrupted_folder) == [path.name]


def test_a_flipped_bit_anywhere_in_a_shard_is_found(interrupted_folder):
    path, checked = shard_files(interrupted_folder)[0], open_shards(interrupted_folder)
    good = path.read_bytes()
    positions = random.Random(1).sample(range(8 * len(good)), 300)
    for at in [0, 8 * len(good) - 1, *positions]:
        damaged = bytearray(good)
        damaged[at // 8] ^= 1 << at % 8
        path.write_bytes(damaged)
        assert next(checked.inspect()) == (path, None, "is damaged (its hash differs)"), at
    (warned,) = resume_to_end(interrupted_folder)
    assert path.name in warned


def test_a_shard_of_another_study_is_quarantined(interrupted_folder, tmp_path):
    other = tmp_path / "other" / "out"
    other.parent.mkdir()
    run_until_interrupted(with_larger_sweep(PLAIN_STUDY), other, 1)
    (foreign,) = shard_files(other)
    shutil.copy(foreign, interrupted_folder / "shards")
    (warned,) = resume_to_end(interrupted_folder)
    assert f"{foreign.name} belongs to another study or another version of the model" in warned
    assert quarantined_names(interrupted_folder) == [foreign.name]


def test_a_shard_under_two_names_counts_once(interrupted_folder):
    first, _ = shard_files(interrupted_folder)
    shutil.copy(first, first.with_name("000000001" + first.name[9:]))
    assert resume_to_end(interrupted_folder) == []


def test_foreign_files_among_the_shards_are_kept_in_quarantine(interrupted_folder):
    place = interrupted_folder / "shards"
    (place / "notes.txt").write_text("mine")
    (place / "thesis.nc").write_bytes(b"CDF\1")
    (place / "folder").mkdir()
    (place / "folder" / "inside").write_text("mine too")
    xr.Dataset().to_netcdf(place / "empty.nc")
    empty = (place / "empty.nc").read_bytes()
    (place / "empty.nc").rename(place / shard_file_name(empty))
    assert len(verify_unchanged(interrupted_folder)) == 4
    warned = resume_to_end(interrupted_folder)
    assert len(warned) == 4
    assert len(quarantined_names(interrupted_folder)) == 4
    assert (interrupted_folder / "quarantine" / "notes.txt").read_text() == "mine"
    assert (interrupted_folder / "quarantine" / "folder" / "inside").read_text() == "mine too"


def test_a_file_that_joins_the_shards_of_a_finished_study_is_not_deleted_with_them(interrupted_folder, monkeypatch):
    monkeypatch.setattr(Shards, "discard", lambda _: None)  # as if it were killed there
    run(PLAIN_STUDY, interrupted_folder)
    monkeypatch.undo()
    (interrupted_folder / "shards" / "notes.txt").write_text("mine")
    resume_to_end(interrupted_folder)
    assert (interrupted_folder / "quarantine" / "notes.txt").read_text() == "mine"


def test_half_written_files_of_a_killed_run_are_no_damage_and_are_removed(interrupted_folder):
    for place in (interrupted_folder, interrupted_folder / "shards"):
        (place / ".results.nc.1.tmp").write_bytes(b"half")
    assert verify_unchanged(interrupted_folder) == []
    assert resume_to_end(interrupted_folder) == []


def test_a_sound_shard_for_which_there_is_no_memory_is_not_set_aside(interrupted_folder, monkeypatch):
    for error in (OSError(-101, "NetCDF: HDF error"), RuntimeError("NetCDF: HDF error")):
        monkeypatch.setattr(stored, "load", Mock(side_effect=error))
        for look in (lambda out: run(PLAIN_STUDY, out), maintenance.verify):
            with pytest.raises(StorageError, match="is sound, and cannot be read .*: the memory ran out") as refused:
                look(interrupted_folder)
            assert refused.value.exit_code == 4
    assert quarantined_names(interrupted_folder) == []
    monkeypatch.undo()
    assert resume_to_end(interrupted_folder) == []


def test_a_shard_that_cannot_be_made_for_lack_of_memory_ends_the_run_in_a_sentence(interrupted_folder, monkeypatch):
    monkeypatch.setattr(stored, "netcdf_bytes", Mock(side_effect=OSError(-101, "NetCDF: HDF error")))
    with pytest.raises(StorageError, match="a shard cannot be made .*: the memory ran out") as refused:
        run(PLAIN_STUDY, interrupted_folder)
    assert refused.value.errno == errno.ENOMEM
    monkeypatch.undo()
    assert resume_to_end(interrupted_folder) == []


def test_shards_that_cannot_be_listed_are_not_taken_for_none(interrupted_folder, monkeypatch):
    listdir = os.listdir

    def refuse(path="."):
        if str(path).endswith("shards"):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return listdir(path)

    monkeypatch.setattr(os, "listdir", refuse)
    for look in (maintenance.status, maintenance.verify, lambda out: run(PLAIN_STUDY, out)):
        with pytest.raises(StorageError, match=r"shards cannot be (read|cleaned up): Permission denied"):
            look(interrupted_folder)
    monkeypatch.undo()
    assert resume_to_end(interrupted_folder) == []

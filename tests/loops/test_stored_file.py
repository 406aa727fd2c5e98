"""Files that are hashed before they are parsed: what is read is what was hashed, whatever other threads do."""

from __future__ import annotations

import gc
import hashlib
import os
import time

import pytest
import xarray as xr

from fastcoil.loops import netcdf, stored_file
from fastcoil.loops.stored_file import Descriptor, StoredFile, file_sha256


def test_a_file_that_changed_is_hashed_again_though_its_size_and_time_are_as_before(tmp_path):
    path = tmp_path / "results.nc"
    path.write_bytes(b"one")
    before = path.stat()
    assert file_sha256(path) == hashlib.sha256(b"one").hexdigest()
    time.sleep(0.05)  # the clock of the file system is coarse
    path.write_bytes(b"two")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    after = path.stat()
    assert (after.st_ino, after.st_size, after.st_mtime_ns) == (before.st_ino, before.st_size, before.st_mtime_ns)
    assert file_sha256(path) == hashlib.sha256(b"two").hexdigest()


READINGS = {
    "load": lambda file: float(file.load()["x"]),
    "outline": lambda file: float(file.outline().attrs["x"]),
    "read": lambda file: float(file.read("x", (), ())),
}


def stored(path, value):
    """A file whose only value and attribute is ``value``."""
    netcdf.save(xr.Dataset({"x": float(value)}, attrs={"x": float(value)}), path)
    return StoredFile(path, [file_sha256(path)], "run the study again")


def let_go(file):
    """What another thread does that opens more files than are held."""
    file._descriptor = None
    gc.collect()


@pytest.mark.parametrize("reading", READINGS.values(), ids=READINGS)
def test_a_file_that_another_thread_lets_go_of_while_it_is_opened_is_not_taken_for_the_next_one(
    tmp_path, monkeypatch, reading
):
    file, others = stored(tmp_path / "1.nc", 1), [stored(tmp_path / "2.nc", 2) for _ in range(3)]

    def parse_later(source):
        let_go(file)
        for other in others:  # one of them gets the number of the descriptor, if it is free
            other.hold()
        return netcdf.parse(source)

    monkeypatch.setattr(stored_file, "parse", parse_later)
    assert reading(file) == 1


@pytest.mark.parametrize("reading", READINGS.values(), ids=READINGS)
def test_a_file_that_is_replaced_while_it_is_opened_is_read_as_it_was(tmp_path, monkeypatch, reading):
    file = stored(tmp_path / "1.nc", 1)
    os.link(tmp_path / "1.nc", tmp_path / "backup.nc")  # so that the file has a name still
    stored(tmp_path / "2.nc", 2)

    def parse_later(source):
        monkeypatch.setattr(stored_file, "parse", netcdf.parse)
        os.replace(tmp_path / "2.nc", tmp_path / "1.nc")
        return netcdf.parse(source)

    monkeypatch.setattr(stored_file, "parse", parse_later)
    assert reading(file) == 1


@pytest.mark.parametrize("reading", READINGS.values(), ids=READINGS)
def test_what_is_read_is_what_was_hashed(tmp_path, monkeypatch, reading):
    file, hashed = stored(tmp_path / "1.nc", 1), Descriptor.sha256

    def then_replaced(descriptor, **options):
        found = hashed(descriptor, **options)
        monkeypatch.setattr(Descriptor, "sha256", hashed)
        stored(tmp_path / "1.nc", 2)
        let_go(file)
        return found

    monkeypatch.setattr(Descriptor, "sha256", then_replaced)
    assert reading(file) == 1


def test_without_a_folder_of_descriptors_a_file_is_read_by_its_name_if_it_still_has_it(tmp_path, monkeypatch):
    file, exists = stored(tmp_path / "1.nc", 1), os.path.exists
    monkeypatch.setattr(os.path, "exists", lambda path: not str(path).startswith("/dev/fd") and exists(path))
    assert READINGS["load"](file) == 1
    stored(tmp_path / "1.nc", 2)
    assert READINGS["load"](file) == 1

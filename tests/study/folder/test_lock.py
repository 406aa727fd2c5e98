"""One writer at a time: neither the lock nor the note of its holder leads elsewhere, and both may be damaged."""

import errno
import fcntl
import os
import threading
from unittest.mock import Mock

import pytest

from fastcoil.base.errors import InputError, LockedError, StorageError
from fastcoil.study.folder.folder import find_holder, hold_folder


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def test_the_note_of_the_holder_does_not_follow_a_link(folder, tmp_path):
    other = tmp_path / "mine.txt"
    other.write_text("precious")
    (folder / ".holder").symlink_to(other)
    with hold_folder(folder):
        assert not (folder / ".holder").is_symlink()
        assert f"process {os.getpid()} on " in find_holder(folder)
    assert other.read_text() == "precious"
    (folder / ".holder").symlink_to(tmp_path / "absent")
    with hold_folder(folder):
        pass
    assert not (tmp_path / "absent").exists()


@pytest.mark.parametrize(
    ("note", "words"),
    [
        (b"process \xff\xfe", "another run (process \N{REPLACEMENT CHARACTER}\N{REPLACEMENT CHARACTER})"),
        (b"\x1b[2J\r\nfine", r"another run (\x1b[2J\r\nfine)"),
        (b"x" * 10_000, "another run"),
    ],
)
def test_a_note_of_any_bytes_is_shown_as_text(folder, monkeypatch, note, words):
    monkeypatch.setattr("fastcoil.study.folder.folder._LOCK_TIMEOUT_S", 0.1)
    with hold_folder(folder):
        (folder / ".holder").write_bytes(note)
        assert find_holder(folder) == words
        with pytest.raises(LockedError, match="is in use by another run"), hold_folder(folder):
            pass


@pytest.mark.timeout(20)
@pytest.mark.parametrize("make", [lambda p: p.symlink_to("absent"), lambda p: p.symlink_to("file"), os.mkdir])
def test_a_lock_that_is_no_file_is_refused(folder, make):
    (folder / "file").write_text("precious")
    make(folder / ".lock")
    with (
        pytest.raises(StorageError, match=r"\.lock cannot be locked \(.*move it away if it is a link or a folder"),
        hold_folder(folder),
    ):
        pass
    assert find_holder(folder) is None
    assert not (folder / "absent").exists()
    assert (folder / "file").read_text() == "precious"


@pytest.mark.filterwarnings("ignore:flock not supported")
@pytest.mark.parametrize("number", [errno.EOPNOTSUPP, errno.ENOLCK, errno.ENOSYS])
def test_a_file_system_without_locks_is_refused(tmp_path, monkeypatch, number):
    """A lock of a file alone would outlive a run that is killed."""
    monkeypatch.setattr(fcntl, "flock", Mock(side_effect=OSError(number, os.strerror(number))))
    with pytest.raises(StorageError) as refused, hold_folder(tmp_path / "out"):
        pass
    assert f".lock cannot be locked ({os.strerror(number)})" in str(refused.value)
    assert "choose a folder on another file system with -o" in str(refused.value)
    assert "free some space" not in str(refused.value)
    assert not (tmp_path / "out").exists()


def test_who_only_looks_does_not_stop_a_run_that_starts(folder):
    (folder / ".lock").touch()
    with (folder / ".lock").open() as looking:
        fcntl.flock(looking, fcntl.LOCK_SH)
        release = threading.Timer(0.1, fcntl.flock, [looking, fcntl.LOCK_UN])
        release.start()
        with hold_folder(folder):
            pass
        release.join()


def test_a_lock_whose_file_was_removed_is_not_held(folder, monkeypatch):
    """Another run may remove its own folder between our opening of the lock and our taking it."""
    real, calls = fcntl.flock, []

    def flock(lock, how):
        if not calls:
            (folder / ".lock").unlink()
        calls.append(how)
        real(lock, how)

    monkeypatch.setattr(fcntl, "flock", flock)
    with hold_folder(folder):
        assert len(calls) >= 2
        monkeypatch.undo()
        assert find_holder(folder) is not None


@pytest.mark.parametrize("name", ["a\0b", "a" * 300, "\ud800"])
def test_a_folder_that_cannot_be_is_refused(tmp_path, name):
    with pytest.raises(InputError, match="choose another folder with -o$"), hold_folder(tmp_path / name):
        pass
    assert list(tmp_path.iterdir()) == []

"""Text files that a user names: what they hold comes back, and what cannot be read is refused in one sentence."""

import errno
import os
import socket
from pathlib import Path

import pytest
from helpers.refusals import assert_refused

from fastcoil.base.errors import StorageError
from fastcoil.base.files import IrregularFileError, TooLargeError, read_bytes, read_text, write_atomically


def test_a_byte_order_mark_is_dropped_and_line_ends_are_kept(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes("\ufeffGröße\r\nΔ\n".encode())
    assert read_text(path, "a CSV file", limit=100) == "Größe\r\nΔ\n"


@pytest.mark.parametrize(("data", "code"), [(b"123456", "path"), (b"ab\xe9", "format"), (None, "path")])
def test_a_file_that_cannot_be_used_is_refused(tmp_path, data, code):
    path = tmp_path / "log.csv"
    if data is not None:
        path.write_bytes(data)
    assert_refused(str(path), code, read_text, path, "a CSV file", limit=5)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["folder", "/dev/zero", "pipe", "socket"])
def test_what_is_no_file_is_refused_immediately(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)  # the name of a socket must be short
    Path("folder").mkdir()
    os.mkfifo("pipe")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("socket")
        assert_refused(name, "path", read_text, Path(name), "a CSV file", limit=1000)


@pytest.mark.timeout(20)
def test_a_pipe_that_takes_the_place_of_a_file_is_not_waited_for(tmp_path, monkeypatch):
    """It may do so between the look at it and its opening."""
    pipe, file = tmp_path / "pipe", tmp_path / "file"
    os.mkfifo(pipe)
    file.write_text("a")
    real_stat = os.stat
    monkeypatch.setattr(os, "stat", lambda path, **options: real_stat(file if path == pipe else path, **options))
    with pytest.raises(IrregularFileError, match="is not a regular"):
        read_bytes(pipe, limit=1000)


def test_a_file_without_a_size_is_read_up_to_the_limit():
    """Files of the kernel say 0 bytes."""
    if not Path("/proc/self/status").exists():
        pytest.skip("no files of the kernel here")
    with pytest.raises(TooLargeError, match="has more than 10 bytes"):
        read_bytes(Path("/proc/self/status"), limit=10)


def test_a_link_is_followed_only_where_it_may_be(tmp_path):
    (tmp_path / "file").write_text("a")
    (tmp_path / "link").symlink_to("file")
    assert read_bytes(tmp_path / "link", limit=5) == b"a"
    with pytest.raises(IrregularFileError, match="is not a regular"):
        read_bytes(tmp_path / "link", limit=5, follow=False)


@pytest.mark.parametrize("name", ["a\0b", "a\ud800", "é" * 150, "folder/" * 1000, "s3://bucket/x", "loop"])
def test_a_path_that_no_file_has_is_refused_in_one_short_sentence(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    error = assert_refused(str(Path(name)), "path", read_text, Path(name), "a CSV file", limit=1000)
    assert len(error.problems[0]) < 240


def test_a_committed_file_is_whole_and_a_failed_commit_leaves_the_earlier_one(tmp_path, monkeypatch):
    path = tmp_path / "run.json"
    write_atomically(path, b"first")
    assert path.read_bytes() == b"first"

    def raise_disk_full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", raise_disk_full)
    with pytest.raises(StorageError, match="No space left"):
        write_atomically(path, b"second")
    assert path.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [path]

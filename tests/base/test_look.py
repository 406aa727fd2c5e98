"""What cannot be looked at is a sentence, and not an absent file."""

import errno
import os
from pathlib import Path

import pytest

from fastcoil.base.errors import StorageError
from fastcoil.base.files import exists, is_file, is_folder
from fastcoil.cli.logs import require_fit_file
from fastcoil.loops.plan import check_disk
from fastcoil.study.file.user_code import find_function


@pytest.fixture
def closed_folder(tmp_path, monkeypatch):
    """A folder that may not be entered."""
    folder, real_stat = tmp_path / "closed", os.stat

    def stat(path, *args, **options):
        if not isinstance(path, int) and folder in Path(os.fsdecode(path)).parents:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return real_stat(path, *args, **options)

    folder.mkdir()
    monkeypatch.setattr(os, "stat", stat)
    return folder


@pytest.mark.parametrize(
    "ask",
    [
        exists,
        is_file,
        is_folder,
        lambda path: require_fit_file(path / "valve.toml"),
        lambda path: check_disk(1, path),
        lambda path: find_function("reduce", "mine:f", path),
    ],
)
def test_what_is_in_a_closed_folder_cannot_be_seen(closed_folder, ask):
    with pytest.raises(StorageError, match=r"closed.* cannot be read: Permission denied"):
        ask(closed_folder / "inside")


def test_what_is_there_and_what_is_not(tmp_path):
    file = tmp_path / "file"
    file.touch()
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    existence = {path: (exists(path), is_file(path), is_folder(path)) for path in (tmp_path, file)}
    assert existence == {tmp_path: (True, False, True), file: (True, True, False)}
    for absent in (tmp_path / "none", file / "below", tmp_path / "circle", tmp_path / "a\0b"):
        assert [exists(absent), is_file(absent), is_folder(absent)] == [False] * 3

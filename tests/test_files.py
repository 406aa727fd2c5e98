"""Text files that a user names: what they hold comes back, and what cannot be read is refused in one sentence."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fastcoil.errors import InputError
from fastcoil.files import read_text


def test_a_byte_order_mark_is_dropped_and_line_ends_are_kept(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes("\ufeffGröße\r\nΔ\n".encode())
    assert read_text(path, "a CSV file", limit=100) == "Größe\r\nΔ\n"


def test_a_file_of_just_the_limit_is_read(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"12345")
    assert read_text(path, "a CSV file", limit=5) == "12345"


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"123456", "has more than 5 bytes: give a CSV file"),
        (b"ab\xe9", r"is not UTF-8 \(byte 2\): save it as 'CSV UTF-8'"),
        (None, "does not exist: give a CSV file"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(tmp_path, data, sentence):
    path = tmp_path / "log.csv"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(InputError, match=f"^{path} {sentence}$"):
        read_text(path, "a CSV file", limit=5)


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match=f"^{tmp_path} is a folder: give a CSV file$"):
        read_text(tmp_path, "a CSV file", limit=5)


def test_a_file_without_permission_is_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("1")
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("root may read everything")
    with pytest.raises(InputError, match=r"cannot be read \(Permission denied\): give a CSV file$"):
        read_text(path, "a CSV file", limit=5)


def test_a_device_without_end_is_refused_at_once():
    with pytest.raises(InputError, match="has more than 1,000 bytes"):
        read_text(Path("/dev/zero"), "a CSV file", limit=1000)


def test_a_text_that_is_no_csv_file_is_to_be_saved_as_utf_8(tmp_path):
    (tmp_path / "study.toml").write_bytes(b"\xe9")
    with pytest.raises(InputError, match=r"is not UTF-8 \(byte 0\): save it as UTF-8$"):
        read_text(tmp_path / "study.toml", "a study file", limit=5)

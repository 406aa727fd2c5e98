"""Files that are hashed before they are parsed: the hash that is remembered is that of the bytes of now."""

from __future__ import annotations

import hashlib
import os
import time

from fastcoil.simulation.stored_file import file_sha256


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

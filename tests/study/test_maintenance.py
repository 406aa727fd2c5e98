"""Looking after a study's folder: what is said can be typed as it stands."""

import errno
import os
import shlex
from unittest.mock import Mock

import pytest
from helpers.commands import fastcoil
from helpers.studies import PLAIN_STUDY, copy_run, run_until_interrupted, write_study

from fastcoil.base.errors import StorageError
from fastcoil.study import maintenance
from fastcoil.study.folder.folder import hold_folder

pytestmark = pytest.mark.kernel


def test_status_suggests_a_command_that_takes_the_folder_for_one_word(tmp_path):
    out = tmp_path / "my study; and 'more'"
    run_until_interrupted(PLAIN_STUDY, out, 1)
    command = maintenance.status(out)[-1].removeprefix("To resume: ")
    assert shlex.split(command) == ["fastcoil", "run", str(tmp_path / "study.toml"), "-o", str(out)]
    (tmp_path / "study.toml").rename(tmp_path / "renamed study.toml")
    assert shlex.split(maintenance.status(out)[-1])[4] == str(tmp_path / "renamed study.toml")
    (tmp_path / "renamed study.toml").write_text("edited")
    assert shlex.split(maintenance.status(out)[-1])[4] == "STUDY.toml"


def test_an_interrupt_before_the_first_shard_promises_nothing_and_status_agrees(tmp_path, monkeypatch):
    out = tmp_path / "out"
    (out / "notes").mkdir(parents=True)
    write_study(PLAIN_STUDY, out)
    monkeypatch.setattr("fastcoil.study.run.make_pool", Mock(side_effect=KeyboardInterrupt))
    lines = fastcoil("run", tmp_path / "study.toml", "-o", out).stderr.splitlines()
    assert lines[-1].startswith("fastcoil: interrupted; nothing is finished yet, to start again: fastcoil run ")
    assert "holds no study" in fastcoil("status", out).stderr
    with hold_folder(out):
        assert maintenance.status(out)[0] == "Nothing is finished yet."


def test_a_rerun_that_cannot_be_written_is_refused_before_it_computes(tmp_path, monkeypatch):
    copy_run(PLAIN_STUDY, tmp_path, 1)
    read_only = OSError(errno.EROFS, os.strerror(errno.EROFS))
    monkeypatch.setattr("fastcoil.study.folder.folder._acquire_lock", Mock(side_effect=read_only))
    monkeypatch.setattr(maintenance, "run_shard", None)
    with pytest.raises(StorageError, match="Read-only file system"):
        maintenance.rerun(tmp_path, {"backlash": "0.02", "estimate_ratio": "0.0", "day": "1"})

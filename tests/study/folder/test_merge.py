"""Shards become one result: on disk or in memory, all of them or none, and while others read."""

import errno
import os
import shutil
from unittest.mock import Mock

import pytest
import xarray as xr
from helpers.studies import (
    DAYS,
    PLAIN_STUDY,
    TRACED_STUDY,
    copy_run,
    resume_to_end,
    run,
    shard_files,
    undisturbed_hash,
    unfinished_files,
    with_larger_sweep,
)

import fastcoil as fc
from fastcoil.base import arrays
from fastcoil.base.errors import IntegrityError, StorageError
from fastcoil.study.folder.merged import StudyRun

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize("text", [PLAIN_STUDY, TRACED_STUDY], ids=["plain", "traced"])
def test_shards_lost_before_the_merge_make_no_finished_result(out, monkeypatch, text):
    original = StudyRun.parts

    def parts(self, leave_out=(), **options):
        if text == PLAIN_STUDY or "rmse" in leave_out:  # of a study with traces, after its metrics were read
            shutil.rmtree(out / "shards")
        return original(self, leave_out, **options)

    monkeypatch.setattr(StudyRun, "parts", parts)
    with pytest.raises(IntegrityError, match="scenarios were lost after they had been run: run the study again"):
        run(text, out)
    assert not (out / "results.nc").exists()
    monkeypatch.undo()
    resume_to_end(out, text)


def test_a_reader_of_results_keeps_its_metrics_while_an_extension_replaces_them(out):
    copy_run(TRACED_STUDY, out)
    with fc.open_study(out) as old, xr.open_dataset(out / "results.nc") as raw:
        assert run(with_larger_sweep(TRACED_STUDY), out, extend=True) == undisturbed_hash(
            with_larger_sweep(TRACED_STUDY)
        )
        assert old["T_sup"].sizes["backlash"] == raw["rmse"].sizes["backlash"] == 2
        with fc.open_study(out) as new:
            assert raw["rmse"].equals(new["rmse"].sel(backlash=raw["backlash"]))
            assert old["rmse"].equals(new["rmse"].sel(backlash=old["backlash"]))
        with pytest.raises(IntegrityError, match="is missing, open the study again or move"):
            old["T_sup"].load()


@pytest.mark.parametrize(
    "text", [pytest.param(PLAIN_STUDY, marks=pytest.mark.full), TRACED_STUDY], ids=["plain", "traced"]
)
def test_a_study_merged_on_the_disk_is_the_one_merged_in_memory(out, text, monkeypatch):
    monkeypatch.setattr(arrays, "MEMMAP_MIN_BYTES", 0)
    before = set(os.listdir("/proc/self/fd"))
    assert run(text, out) == undisturbed_hash(text)
    # nameless files are gone with their arrays; the traces stay open with the results
    assert {p.name for p in out.iterdir()} <= {".lock", "results.nc", "answer.json", "run.json", "study.toml"} | {
        p.name for p in out.glob("traces-*.nc")
    }
    assert len(set(os.listdir("/proc/self/fd")) - before) <= 1
    assert run(with_larger_sweep(text), out, extend=True) == undisturbed_hash(with_larger_sweep(text))


@pytest.mark.parametrize(
    "text", [PLAIN_STUDY, pytest.param(TRACED_STUDY, marks=pytest.mark.full)], ids=["plain", "traced"]
)
def test_room_for_the_merge_is_taken_before_it_is_used(out, text, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(arrays, "MEMMAP_MIN_BYTES", 0)
        patched.setattr(os, "posix_fallocate", Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))))
        with pytest.raises(StorageError, match="No space left on device"):
            run(text, out)
    assert unfinished_files(out) == []
    assert len(shard_files(out)) == DAYS
    resume_to_end(out, text)

"""``verify``: it finds damage in a result, none where there is none, and changes nothing."""

import errno
import os
import shutil

import netCDF4
import pytest
from helpers.commands import fastcoil
from helpers.studies import (
    DAYS,
    PLAIN_STUDY,
    TRACED_STUDY,
    copy_run,
    folder_contents,
    resume_to_end,
    run,
    verify_unchanged,
    with_larger_sweep,
)

from fastcoil.base.errors import IntegrityError
from fastcoil.loops import netcdf
from fastcoil.study import maintenance
from fastcoil.study.folder.results import open_study
from fastcoil.study.folder.stored import Shards

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize(("name", "share"), [("results.nc", 0.5), ("traces", 1.0)])  # 1: all but the last byte
def test_a_truncated_result_is_found(out, name, share):
    copy_run(TRACED_STUDY, out)
    path = next(out.glob(f"{name}*"))
    whole = path.read_bytes().rstrip(b"\0")  # the library fills up a small file with zeros
    path.write_bytes(whole[: min(int(share * len(whole)), len(whole) - 1)])
    (problem,) = verify_unchanged(out)
    assert path.name in problem
    with pytest.raises(IntegrityError, match="run the study again"):
        run(TRACED_STUDY, out)
    path.unlink()
    if name == "traces":
        assert len(verify_unchanged(out)) == 1
        (out / "results.nc").unlink()
    resume_to_end(out, TRACED_STUDY)


def test_damaged_traces_are_not_written_again_by_an_extension(out):
    copy_run(TRACED_STUDY, out)
    path = next(out.glob("traces-*.nc"))
    with netCDF4.Dataset(path, "a") as file:
        file["mode"][0] = 9 - file["mode"][0]
    assert f"{path} is damaged" in verify_unchanged(out)[0]
    before = folder_contents(out)["results.nc"]
    with pytest.raises(IntegrityError, match="is damaged"):
        run(with_larger_sweep(TRACED_STUDY), out, extend=True)
    assert folder_contents(out)["results.nc"] == before
    (out / "results.nc").unlink()
    resume_to_end(out, with_larger_sweep(TRACED_STUDY), extend=True)


def test_a_look_at_a_study_while_its_run_finishes_finds_no_damage(out, monkeypatch):
    copy_run(PLAIN_STUDY, out, DAYS - 1)
    real = Shards._inspect_file

    def finishing(self, *words):  # before the first shard is read
        monkeypatch.setattr(Shards, "_inspect_file", real)
        run(PLAIN_STUDY, out)
        return real(self, *words)

    monkeypatch.setattr(Shards, "_inspect_file", finishing)
    assert maintenance.verify(out) == []


@pytest.mark.parametrize("name", ["results.nc", "traces", "run.json", "study.toml"])
def test_a_file_that_a_finished_study_must_have_is_missed(out, name):
    copy_run(TRACED_STUDY, out)
    path = next(out.glob(f"{name}*"))
    good = path.read_bytes()
    path.unlink()
    result = fastcoil("verify", out)
    assert result.exit_code == 6
    assert f"{path} is missing" in result.output
    if name == "results.nc":
        with pytest.raises(IntegrityError, match="is missing: run the study again"):
            open_study(out)
    if name != "traces":
        resume_to_end(out, TRACED_STUDY)
        assert name != "study.toml" or path.read_bytes() == good


def test_files_of_other_runs_in_a_finished_study_are_named(out, tmp_path):
    copy_run(TRACED_STUDY, out)
    other = tmp_path / "other"
    run(with_larger_sweep(TRACED_STUDY), other)
    shutil.copy(next(other.glob("traces-*.nc")), out)
    (problem,) = verify_unchanged(out)
    assert "is not of this run" in problem
    resume_to_end(out, TRACED_STUDY)
    shutil.copy(other / "results.nc", out)
    assert "results.nc is damaged, or not of this run" in verify_unchanged(out)[0]
    shutil.copy(other / "study.toml", out)
    assert len(verify_unchanged(out)) >= 2


def test_results_that_cannot_be_read_are_no_damage(out, monkeypatch):
    copy_run(PLAIN_STUDY, out)

    def closed(path, *rest, plain=open, **options):
        if str(path).endswith("results.nc"):
            raise OSError(errno.EACCES, os.strerror(errno.EACCES))
        return plain(path, *rest, **options)

    monkeypatch.setattr(netcdf, "open", closed, raising=False)
    done = fastcoil("verify", out)
    assert done.exit_code == 4, done.output
    assert "cannot be read: Permission denied; check its permissions" in done.output

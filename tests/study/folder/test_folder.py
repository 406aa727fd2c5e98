"""The folder of a study: any name will do, links are followed, and one run at a time is in it."""

import os
import shutil
import time

import pytest
from helpers.commands import fastcoil
from helpers.refusals import refuses
from helpers.studies import (
    PLAIN_STUDY,
    TRACED_STUDY,
    copy_run,
    folder_contents,
    resume_to_end,
    run,
    run_until_interrupted,
    undisturbed_hash,
    write_study,
)

from fastcoil.base.errors import FastcoilError, LockedError, StorageError
from fastcoil.study import maintenance
from fastcoil.study import run as runner
from fastcoil.study.file.spec import read_study
from fastcoil.study.folder import folder
from fastcoil.study.folder.folder import find_holder, hold_folder

pytestmark = pytest.mark.kernel


def write_text(path, text=PLAIN_STUDY):
    path.write_text(text)
    return path


def test_any_name_of_a_folder_will_do(tmp_path):
    out = tmp_path / ("with space, ünï-冷, new\nline, #mode=bytes?x=%20 and '\";$(x)" + "x" * 180) / "out"
    out.parent.mkdir()
    run_until_interrupted(TRACED_STUDY, out, 1)
    resume_to_end(out, TRACED_STUDY)
    assert any("Finished" in line for line in maintenance.status(out))


def test_a_folder_whose_name_is_no_text_is_refused_before_anything_is_run(tmp_path):
    out = tmp_path / os.fsdecode(b"caf\xe9") / "out"
    try:
        out.parent.mkdir()
    except OSError:
        pytest.skip("the file system takes only UTF-8")
    with refuses(("-o", "path")):
        runner.execute(read_study(write_text(tmp_path / "study.toml")), out)
    assert not out.exists()


def test_a_link_to_a_folder_is_followed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    run_until_interrupted(PLAIN_STUDY, tmp_path / "out", 1)
    resume_to_end(tmp_path / "out")
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "elsewhere" / "results.nc").is_file()


def test_a_link_to_nowhere_is_refused(tmp_path):
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FastcoilError) as refused:
        run(PLAIN_STUDY, tmp_path / "out")
    assert refused.value.exit_code in (2, 4)
    assert [p.name for p in tmp_path.iterdir() if p.name != "study.toml"] == ["out"]


def test_temporary_files_elsewhere_are_not_used(out, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "absent"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "absent"))
    assert run(TRACED_STUDY, out) is not None


def test_a_folder_removed_in_the_middle_of_a_run_ends_it_with_4(out):
    def remove(_):
        shutil.rmtree(out)

    with pytest.raises(StorageError, match=r"study\.toml cannot be written: No such file or directory"):
        runner.execute(write_study(PLAIN_STUDY, out), out, n_jobs=1, progress=lambda *_: remove)
    assert not out.exists()
    resume_to_end(out)


def test_leftover_locks_of_a_dead_run_hold_nobody_up(interrupted_folder):
    (interrupted_folder / ".lock").write_text("")
    (interrupted_folder / ".holder").write_text("process 1 on elsewhere since 1970")
    assert not any("being run" in line for line in maintenance.status(interrupted_folder))
    resume_to_end(interrupted_folder)


def test_a_second_run_is_refused_at_once_and_disturbs_nothing(out, monkeypatch):
    monkeypatch.setattr(folder, "_LOCK_TIMEOUT_S", 0.1)

    def second(_):
        before = folder_contents(out)
        start = time.monotonic()
        with pytest.raises(LockedError, match=f"in use by another run .process {os.getpid()} on ") as refused:
            run(PLAIN_STUDY, out)
        assert refused.value.exit_code == 5
        assert time.monotonic() - start < 5.0
        assert {n: b for n, (b, _) in folder_contents(out).items()} == {n: b for n, (b, _) in before.items()}
        assert any(f"being run by another run (process {os.getpid()}" in line for line in maintenance.status(out))
        assert maintenance.verify(out) == []

    finished = runner.execute(write_study(PLAIN_STUDY, out), out, n_jobs=1, progress=lambda *_: second)
    assert finished.results.attrs["content_sha256"] == undisturbed_hash(PLAIN_STUDY)


@pytest.mark.usefixtures("blank_figures")
def test_figures_are_drawn_while_the_folder_is_held(out, monkeypatch):
    monkeypatch.setattr(folder, "_LOCK_TIMEOUT_S", 0.1)
    holders = []

    def present(finished):
        holders.append(find_holder(out))
        assert fastcoil("plot", out).exit_code == 5
        with pytest.raises(LockedError):
            run(PLAIN_STUDY, out)

    for _ in range(2):  # the second time it is found finished
        runner.execute(write_study(PLAIN_STUDY, out), out, n_jobs=1, present=present)
    assert len(holders) == 2
    assert all(holders)
    assert not (out / "figures").exists()
    assert fastcoil("plot", out).exit_code == 0


@pytest.mark.parametrize("command", ["run", pytest.param("plot", marks=pytest.mark.full)])
def test_half_written_figures_are_removed(out, command):
    study = write_study(PLAIN_STUDY, out)
    run(PLAIN_STUDY, out)
    half = out / "figures" / ".bands.png.123.tmp"
    half.parent.mkdir()
    half.write_bytes(b"half")
    if command == "run":
        runner.execute(study, out)
    else:
        assert fastcoil("plot", out).exit_code == 0
    assert not half.exists()


AT = {"backlash": "0.07", "estimate_ratio": "0.9", "day": "1"}


def test_half_written_reruns_are_removed_and_a_rerun_waits_for_no_run(out):
    copy_run(PLAIN_STUDY, out)
    half = out / "reruns" / ".backlash.nc.123.tmp"
    half.parent.mkdir()
    half.write_bytes(b"half")
    with hold_folder(out):
        path, _ = maintenance.rerun(out, AT)
    assert [p.name for p in half.parent.glob("[!.]*")] == [path.name]
    assert not half.exists()

"""Damage on the disk and operations that fail: what is found, what is told, and that the next run mends it."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import random
import shutil
import stat
import time
import warnings

import netCDF4
import pytest
import xarray as xr
from faults import (
    DAYS,
    PLAIN,
    TRACED,
    Nth,
    contents,
    golden,
    interrupted,
    larger,
    operations,
    ran,
    shards,
    studied,
    unfinished,
)  # fmt: skip

import fastcoil as fc
from fastcoil.errors import FastcoilError, InputError, IntegrityError, LockedError, StorageError
from fastcoil.results import image
from fastcoil.study import care, merge, runner, store
from fastcoil.study.contents import open_study
from fastcoil.study.spec import read_study

pytestmark = pytest.mark.kernel


@pytest.fixture
def out(tmp_path):
    """The folder of a study."""
    return tmp_path / "out"


@pytest.fixture
def broken_off(out):
    """The folder of a study that was interrupted with one shard to go."""
    interrupted(PLAIN, out, DAYS - 1)
    assert len(shards(out)) == DAYS - 1
    return out


def written(path, text=PLAIN):
    path.write_text(text)
    return path


def quarantined(folder):
    return sorted(p.name for p in (folder / "quarantine").glob("*"))


def verified(folder):
    """What ``verify`` finds; it changes nothing."""
    before = contents(folder)
    problems = care.verify(folder)
    assert contents(folder) == before
    return problems


def resumed(folder, text=PLAIN, **options):
    """Go on with a study, to the end, and find what an undisturbed run finds.  Returns the warnings."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert ran(text, folder, **options) == golden(text)
    assert verified(folder) == []
    assert unfinished(folder) == []
    assert shards(folder) == []
    return [str(w.message) for w in told]


def named(data, first=0):
    """The name of a shard with these bytes."""
    return f"{first:09d}-{hashlib.sha256(data).hexdigest()[:32]}.nc"


# --- damaged shards ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "cut", [lambda d: d[:-1], lambda d: d[: len(d) // 2], lambda d: b"", lambda d: d + b"\0"],
    ids=["a byte less", "half", "nothing", "a byte more"],
)  # fmt: skip
def test_a_shard_of_another_length_is_set_aside_and_run_again(broken_off, cut):
    path = shards(broken_off)[0]
    path.write_bytes(cut(path.read_bytes()))
    (problem,) = verified(broken_off)
    assert str(path) in problem
    (told,) = resumed(broken_off)
    assert f"{path} is not as it was written: moved to quarantine/" in told
    assert quarantined(broken_off) == [path.name]


def test_a_flipped_bit_anywhere_in_a_shard_is_found(broken_off):
    path, run = shards(broken_off)[0], store.begun(broken_off)
    good = path.read_bytes()
    positions = random.Random(1).sample(range(8 * len(good)), 1000)
    for at in [0, 8 * len(good) - 1, *positions]:
        damaged = bytearray(good)
        damaged[at // 8] ^= 1 << at % 8
        path.write_bytes(damaged)
        assert next(store.inspected(broken_off, run.key)) == (path, "is not as it was written"), at
    (told,) = resumed(broken_off)
    assert path.name in told


def filled(path):
    """A file with the structure of a shard and none of its values, as a writer leaves it that is killed."""
    empty = netCDF4.Dataset("filled.nc", "w", memory=2**16)
    with netCDF4.Dataset(path) as file:
        for name, dimension in file.dimensions.items():
            empty.createDimension(name, len(dimension))
        for name, variable in file.variables.items():
            copy = empty.createVariable(name, variable.dtype, variable.dimensions)
            if name == "scenario":
                copy[:] = variable[:]
        empty.study = file.study
        image = empty.close()
    return bytes(image)


def test_a_shard_that_opens_but_was_never_filled_is_set_aside(broken_off):
    path = shards(broken_off)[0]
    data = filled(path)
    path.write_bytes(data)
    assert "is not as it was written" in verified(broken_off)[0]
    path.rename(path.with_name(named(data)))
    assert "was never filled" in verified(broken_off)[0]
    (told,) = resumed(broken_off)
    assert named(data) in told


def test_a_shard_of_another_study_is_set_aside(broken_off, tmp_path):
    other = tmp_path / "other" / "out"
    other.parent.mkdir()
    interrupted(larger(PLAIN), other, 1)
    (foreign,) = shards(other)
    shutil.copy(foreign, broken_off / "shards")
    (told,) = resumed(broken_off)
    assert f"{foreign.name} belongs to another study or another version of the model" in told
    assert quarantined(broken_off) == [foreign.name]


def test_a_shard_of_the_same_study_cut_otherwise_is_taken_for_what_it_adds(broken_off, monkeypatch):
    first = xr.load_dataset(shards(broken_off)[0])
    data = image(first.isel(scenario=slice(1, 3)), compressed=False)
    (broken_off / "shards" / named(data, 1)).write_bytes(data)
    assert resumed(broken_off) == []


def test_a_renamed_shard_and_one_under_two_names_are_set_aside(broken_off):
    first, second = shards(broken_off)
    shutil.copy(first, first.with_name("000000001" + first.name[9:]))
    second.rename(second.with_name("000000003" + second.name[9:]))
    told = resumed(broken_off)
    assert len(told) == 2
    assert all("is not what its name says" in t for t in told)
    assert quarantined(broken_off) == ["000000001" + first.name[9:], "000000003" + second.name[9:]]


def test_foreign_files_among_the_shards_are_kept_in_quarantine(broken_off):
    place = broken_off / "shards"
    (place / "notes.txt").write_text("mine")
    (place / "thesis.nc").write_bytes(b"CDF\1")
    (place / "folder").mkdir()
    (place / "folder" / "inside").write_text("mine too")
    (place / named(b"no NetCDF")).write_bytes(b"no NetCDF")
    xr.Dataset().to_netcdf(place / "empty.nc")
    empty = (place / "empty.nc").read_bytes()
    (place / "empty.nc").rename(place / named(empty))
    assert len(verified(broken_off)) == 5
    told = resumed(broken_off)
    assert len(told) == 5
    assert len(quarantined(broken_off)) == 5
    assert (broken_off / "quarantine" / "notes.txt").read_text() == "mine"
    assert (broken_off / "quarantine" / "folder" / "inside").read_text() == "mine too"


def test_what_is_set_aside_twice_is_kept_twice(broken_off):
    for text in ("one", "two"):
        (broken_off / "shards" / "notes.txt").write_text(text)
        with pytest.warns(UserWarning, match=r"notes\.txt is no shard"):
            list(store.committed(broken_off, store.begun(broken_off).key))
    assert quarantined(broken_off) == ["notes.txt", "notes.txt.2"]


def test_a_file_that_joins_the_shards_of_a_finished_study_is_not_deleted_with_them(broken_off, monkeypatch):
    monkeypatch.setattr("fastcoil.study.merge.discard_shards", lambda _: None)  # as if it were killed there
    ran(PLAIN, broken_off)
    monkeypatch.undo()
    (broken_off / "shards" / "notes.txt").write_text("mine")
    resumed(broken_off)
    assert (broken_off / "quarantine" / "notes.txt").read_text() == "mine"


def test_half_written_files_of_a_killed_run_are_no_damage_and_are_removed(broken_off):
    for place in (broken_off, broken_off / "shards"):
        (place / ".results.nc.1.tmp").write_bytes(b"half")
    assert verified(broken_off) == []
    assert resumed(broken_off) == []


def test_a_deleted_shard_is_run_again(broken_off):
    shards(broken_off)[0].unlink()
    assert resumed(broken_off) == []


@pytest.mark.parametrize("text", [PLAIN, TRACED], ids=["plain", "traced"])
def test_shards_lost_before_the_merge_make_no_finished_result(out, monkeypatch, text):
    original = runner.merge

    def merge(folder, plan, parts, traces, *args, **options):
        def losing(names):
            if text == PLAIN or names:  # of a study with traces, after its metrics were read
                shutil.rmtree(folder / "shards")
            return parts(names)

        return original(folder, plan, losing, traces, *args, **options)

    monkeypatch.setattr(runner, "merge", merge)
    with pytest.raises(IntegrityError, match="scenarios were lost after they had been run: run the study again"):
        ran(text, out)
    assert not (out / "results.nc").exists()
    monkeypatch.undo()
    resumed(out, text)


# --- what a run was begun with ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "run.json is damaged"),
        (b'{"study_sha', "run.json is damaged"),
        (b"\xff\xfe", "run.json is damaged"),
        (b"[1]", "run.json is damaged"),
        (b"[" * 100_000, "run.json is damaged"),
        (b'{"format": 1}', "run.json is damaged"),
        (b'{"format": 2}', "another version of fastcoil"),
    ],
)
def test_a_damaged_run_json_is_refused_and_nothing_is_lost(broken_off, data, sentence):
    path = broken_off / "run.json"
    good = path.read_bytes()
    path.write_bytes(data)
    before = {name: found for name, found in contents(broken_off).items() if name != ".lock"}
    for what in (lambda: ran(PLAIN, broken_off), lambda: care.verify(broken_off), lambda: care.status(broken_off)):
        with pytest.raises(IntegrityError, match=sentence) as refused:
            what()
        assert refused.value.exit_code == 6
    assert {name: found for name, found in contents(broken_off).items() if name != ".lock"} == before
    path.write_bytes(good)
    assert resumed(broken_off) == []


def test_without_run_json_the_shards_are_found_by_their_key(broken_off, monkeypatch):
    (broken_off / "run.json").unlink()
    asked = []
    monkeypatch.setattr(runner, "compile_kernel", lambda: asked.append(True))
    finished = runner.execute(studied(PLAIN, broken_off), broken_off, n_jobs=1)
    assert finished.n_run == finished.results["status"].size // DAYS
    assert finished.results.attrs["content_sha256"] == golden(PLAIN)
    assert verified(broken_off) == []


@pytest.mark.parametrize("name", ["run.json", "study.toml"])
def test_what_was_begun_is_written_again_for_a_finished_study(out, name):
    ran(PLAIN, out)
    good = (out / name).read_bytes()
    (out / name).unlink()
    resumed(out)
    assert (out / name).read_bytes() == good


@pytest.mark.parametrize("data", [None, b"", b"[loop", b"\xff", b"[loop]\n"], ids=str)
def test_a_damaged_study_toml_is_told_and_written_again(broken_off, data):
    path = broken_off / "study.toml"
    path.unlink() if data is None else path.write_bytes(data)
    assert len(verified(broken_off)) >= 1
    for what in (care.status, open_study):
        with pytest.raises(IntegrityError):
            what(broken_off)
    with pytest.raises(IntegrityError):
        ran(larger(PLAIN), broken_off, extend=True)
    with pytest.raises(IntegrityError if data in (None, b"\xff") else InputError):
        ran(larger(PLAIN), broken_off)
    assert resumed(broken_off) == []
    assert path.read_text() == PLAIN


def test_a_boundary_file_that_changes_between_a_run_and_its_resume_is_refused(out, tmp_path):
    log = tmp_path / "log.csv"
    head = "elapsed_time [s],m_a [kg/s],T_a_in [degC],W_a_in [g/kg],T_w_in [degC],T_set [degC]\n"
    good = head + "".join(f"{t},1.2,25,10,7,14\n" for t in range(0, 960, 60))
    log.write_text(good)
    text = PLAIN.replace("hours = 0.25", "kind = 'csv'\npath = 'log.csv'")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("seed"))
    text = text.replace("[run]", "[run]\nreplicates = 33")  # two blocks
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fastcoil.plan._LANE_STEPS_PER_SHARD", 1)
        interrupted(text, out, 1)
    before = [p.read_bytes() for p in shards(out)]
    log.write_text(good.replace(",25,", ",26,", 1))
    with pytest.raises(IntegrityError, match="a file that the study reads changed") as refused:
        ran(text, out)
    assert refused.value.exit_code == 6
    assert "the series of its [boundary] changed" in " ".join(verified(out))
    assert [p.read_bytes() for p in shards(out)] == before
    log.unlink()
    assert "log.csv" in " ".join(verified(out))
    log.write_text(good)
    assert ran(text, out)
    assert verified(out) == []


def test_other_sources_of_the_model_between_run_and_resume_run_everything_again(broken_off, monkeypatch):
    done = [p.name for p in shards(broken_off)]
    monkeypatch.setattr(runner, "model_sha256", lambda: "another model")
    with pytest.warns(UserWarning, match="other sources of the model|another version of the model") as told:
        finished = runner.execute(studied(PLAIN, broken_off), broken_off, n_jobs=1)
    assert "other sources of the model" in str(told[0].message)
    assert len(told) == 1 + len(done)
    assert finished.n_run == finished.results["status"].size
    assert quarantined(broken_off) == done


# --- operations that fail ---------------------------------------------------------------------------------------------

SITUATIONS = {
    "plain": (PLAIN, lambda folder: None),
    "traced": (TRACED, lambda folder: None),
    "extended": (larger(TRACED), lambda folder: ran(TRACED, folder)),
    "extended, unfinished": (larger(TRACED), lambda folder: interrupted(TRACED, folder, DAYS - 1)),
}


def sweep(tmp_path, situation, *, lasting=False, stride=1):
    """Let the n-th operation on files fail, n = 1, 2, … until none is left; each time the next run must mend it."""
    text, prepare = SITUATIONS[situation]
    out, before = tmp_path / "out", tmp_path / "before"
    study = studied(text, out)
    prepare(out)
    study = studied(text, out)
    if out.exists():
        shutil.copytree(out, before)
    n, reached = 1, True
    while reached:
        error = (errno.EIO, errno.ENOSPC)[n % 2]

        def fail(error=error):
            raise OSError(error, os.strerror(error))

        shutil.rmtree(out, ignore_errors=True)
        if before.exists():
            shutil.copytree(before, out)
        nth = Nth(n, fail, lasting=lasting)
        was = {p.name: p.read_bytes() for p in shards(out)}
        try:
            with operations(out, nth):
                finished = runner.execute(study, out, n_jobs=1, extend=True)
        except StorageError as refused:
            told = str(refused)
        except IntegrityError as refused:  # what was begun is checked before it is extended
            told = str(refused)
            assert "cannot be read" in told  # noqa: PT017
            assert nth.done[n - 1] == "open for reading"
        else:  # nothing failed, or what nobody needs
            assert finished.results.attrs["content_sha256"] == golden(text), (n, nth.done)
            told = ""
        assert not told or os.strerror(error) in told, (n, nth.done)
        reached = len(nth.done) >= n
        assert lasting or unfinished(out) == [], (n, nth.done)
        assert all(p.read_bytes() == was[p.name] for p in shards(out) if p.name in was), (n, nth.done)
        assert not out.exists() or not (out / "run.json").exists() or all(map(store._SHARD_NAME.fullmatch, (
            p.name for p in shards(out) if not p.name.endswith(".tmp")))), (n, nth.done)  # fmt: skip
        assert resumed(out, text, extend=True) == [], (n, nth.done)
        n += stride
    return n


@pytest.mark.parametrize(("situation", "stride"), [("plain", 2), ("traced", 5), ("extended, unfinished", 11)])
def test_whichever_operation_fails_the_run_ends_with_4_and_the_next_one_completes_it(tmp_path, situation, stride):
    assert sweep(tmp_path, situation, stride=stride) > 50


@pytest.mark.full
@pytest.mark.parametrize("lasting", [False, True], ids=["once", "from then on"])
@pytest.mark.parametrize("situation", SITUATIONS)
def test_whichever_operation_fails_in_whatever_situation(tmp_path, situation, lasting):
    assert sweep(tmp_path, situation, lasting=lasting) > 50


def test_a_shard_whose_fsync_fails_once_is_not_written_and_fsync_is_not_tried_again(out, monkeypatch):
    interrupted(PLAIN, out, 1)
    calls, real = [], os.fsync

    def fsync(descriptor):
        calls.append(descriptor)
        if len(calls) == 1:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        real(descriptor)

    before = shards(out)
    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(StorageError, match="Input/output error"):
        ran(PLAIN, out)
    assert len(calls) == 1
    assert shards(out) == before
    monkeypatch.undo()
    resumed(out)


def test_bytes_are_on_the_disk_before_a_name_points_to_them(out):
    done = []
    with operations(out, done.append):
        ran(TRACED, out)
    replaced = [k for k, name in enumerate(done) if name == "replace"]
    assert len(replaced) == 2 + DAYS + 2  # run.json, study.toml, shards, traces, results.nc
    for k in replaced:
        assert done[k - 2 : k + 3] == ["open", "fsync", "replace", "open", "fsync"]


# --- folders ----------------------------------------------------------------------------------------------------------


def test_a_reader_of_results_keeps_its_data_while_an_extension_replaces_them(out):
    ran(TRACED, out)
    with fc.open_study(out) as old, xr.open_dataset(out / "results.nc") as raw:
        assert ran(larger(TRACED), out, extend=True) == golden(larger(TRACED))
        assert old["T_sup"].sizes["backlash"] == raw["rmse"].sizes["backlash"] == 2
        with fc.open_study(out) as new:
            assert raw["rmse"].equals(new["rmse"].sel(backlash=raw["backlash"]))
            assert old["T_sup"].equals(new["T_sup"].sel(backlash=old["backlash"]))


@pytest.mark.parametrize("name", ["with space", "ünï-冷", "new\nline", "#mode=bytes?x=%20", "'\";$(x)", "x" * 200])
def test_any_name_of_a_folder_will_do(tmp_path, name):
    out = tmp_path / name / "out"
    out.parent.mkdir()
    interrupted(TRACED, out, 1)
    resumed(out, TRACED)
    assert any("Finished" in line for line in care.status(out))


def test_a_folder_whose_name_is_no_text_is_refused_before_anything_is_run(tmp_path):
    out = tmp_path / os.fsdecode(b"caf\xe9") / "out"
    try:
        out.parent.mkdir()
    except OSError:
        pytest.skip("the file system takes only UTF-8")
    with pytest.raises(InputError, match="is not UTF-8: choose another folder"):
        runner.execute(read_study(written(tmp_path / "study.toml")), out)
    assert not out.exists()


def test_a_link_to_a_folder_is_followed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    interrupted(PLAIN, tmp_path / "out", 1)
    resumed(tmp_path / "out")
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "elsewhere" / "results.nc").is_file()


def test_a_link_to_nowhere_is_refused(tmp_path):
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FastcoilError) as refused:
        ran(PLAIN, tmp_path / "out")
    assert refused.value.exit_code in (2, 4)
    assert [p.name for p in tmp_path.iterdir() if p.name != "study.toml"] == ["out"]


def test_temporary_files_elsewhere_are_not_used(out, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "absent"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "absent"))
    assert ran(TRACED, out) is not None


def test_a_folder_removed_in_the_middle_of_a_run_ends_it_with_4(out):
    def remove(_):
        shutil.rmtree(out)

    with pytest.raises(StorageError, match="cannot be made: No such file or directory"):
        runner.execute(studied(PLAIN, out), out, n_jobs=1, progress=lambda _: remove)
    assert not out.exists()
    resumed(out)


def test_a_file_system_without_locks_is_refused(out, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr("fcntl.flock", refuse)
    # by its version, the library of locks refuses, or makes do with the file alone
    try:
        with pytest.warns(UserWarning, match="flock not supported"):
            assert ran(PLAIN, out) == golden(PLAIN)
    except StorageError as refused:
        assert "on a file system without locks: choose another folder" in str(refused)  # noqa: PT017
        assert not out.exists()


def test_leftover_locks_of_a_dead_run_hold_nobody_up(broken_off):
    (broken_off / ".lock").write_text("")
    (broken_off / ".holder").write_text("process 1 on elsewhere since 1970")
    assert not any("being run" in line for line in care.status(broken_off))
    resumed(broken_off)


def test_a_second_run_is_refused_at_once_and_disturbs_nothing(out):
    def second(_):
        before = contents(out)
        start = time.monotonic()
        with pytest.raises(LockedError, match=f"in use by another run .process {os.getpid()} on ") as refused:
            ran(PLAIN, out)
        assert refused.value.exit_code == 5
        assert time.monotonic() - start < 5.0
        assert {n: b for n, (b, _) in contents(out).items()} == {n: b for n, (b, _) in before.items()}
        assert any(f"being run by another run (process {os.getpid()}" in line for line in care.status(out))
        assert care.verify(out) == []

    finished = runner.execute(studied(PLAIN, out), out, n_jobs=1, progress=lambda _: second)
    assert finished.results.attrs["content_sha256"] == golden(PLAIN)


def test_a_look_at_a_study_while_its_run_finishes_finds_no_damage(out, monkeypatch):
    interrupted(PLAIN, out, DAYS - 1)
    real = store._opened

    def finishing(path, key):  # before the first shard is read
        monkeypatch.setattr(store, "_opened", real)
        ran(PLAIN, out)
        return real(path, key)

    monkeypatch.setattr(store, "_opened", finishing)
    assert care.verify(out) == []


# --- verify -----------------------------------------------------------------------------------------------------------


def test_verify_finds_nothing_in_a_finished_and_in_an_unfinished_study(out):
    interrupted(TRACED, out, 1)
    assert verified(out) == []
    ran(TRACED, out)
    assert verified(out) == []


def replaced(path, data):
    """Another file in its place: the library may still have the old one open, and in its cache."""
    path.with_suffix(".other").write_bytes(data)
    path.with_suffix(".other").replace(path)


@pytest.mark.parametrize("name", ["results.nc", "traces"])
def test_no_flipped_bit_of_a_result_changes_a_value_unnoticed(out, name):
    ran(TRACED, out)
    path = next(out.glob(f"{name}*"))
    with fc.open_study(out) as ds:
        right = ds.load()
    good = path.read_bytes()
    used = len(good.rstrip(b"\0"))
    found = 0
    for at in random.Random(2).sample(range(8 * used), 60):
        damaged = bytearray(good)
        damaged[at // 8] ^= 1 << at % 8
        replaced(path, damaged)
        if care.verify(out):
            found += 1
        else:  # a gap, or a number of the format that nobody reads
            with fc.open_study(out) as ds:
                assert ds.identical(right), at
    replaced(path, good)
    assert found >= 5
    assert verified(out) == []


@pytest.mark.parametrize("cut", [lambda d: d[:-1], lambda d: d[: len(d) // 2], lambda d: b""], ids=["1", "half", "all"])
@pytest.mark.parametrize("name", ["results.nc", "traces"])
def test_a_truncated_result_is_found(out, name, cut):
    ran(TRACED, out)
    path = next(out.glob(f"{name}*"))
    path.write_bytes(cut(path.read_bytes().rstrip(b"\0")))  # the library fills up a small file with zeros
    (problem,) = verified(out)
    assert path.name in problem
    with pytest.raises(IntegrityError, match="run the study again"):
        ran(TRACED, out)
    path.unlink()
    if name == "traces":
        assert len(verified(out)) == 1
        (out / "results.nc").unlink()
    resumed(out, TRACED)


def test_damaged_traces_are_not_written_again_by_an_extension(out):
    ran(TRACED, out)
    path = next(out.glob("traces-*.nc"))
    with netCDF4.Dataset(path, "a") as file:
        file["mode"][0] = 9 - file["mode"][0]
    assert "mode is not as it was written" in verified(out)[0]
    before = contents(out)["results.nc"]
    with pytest.raises(IntegrityError, match="mode is not as it was written"):
        ran(larger(TRACED), out, extend=True)
    assert contents(out)["results.nc"] == before
    (out / "results.nc").unlink()
    resumed(out, larger(TRACED), extend=True)


def test_a_study_that_is_read_only_can_be_verified_and_opened(broken_off):
    for path in [broken_off, *broken_off.rglob("*")]:
        path.chmod(stat.S_IREAD | (stat.S_IEXEC if path.is_dir() else 0))
    try:
        assert verified(broken_off) == []
        with open_study(broken_off) as ds:
            assert int((ds["status"] == 0).sum()) == ds["status"].size * (DAYS - 1) // DAYS
    finally:
        for path in [broken_off, *broken_off.rglob("*")]:
            path.chmod(0o755)


# --- extension --------------------------------------------------------------------------------------------------------


def test_an_extension_of_a_run_that_has_no_shard_yet_begins_anew(out):
    interrupted(PLAIN, out, 1)
    shards(out)[0].unlink()
    resumed(out, larger(PLAIN), extend=True)


def test_an_extension_that_was_begun_and_cut_off_goes_on_and_keeps_what_was_there(out):
    ran(TRACED, out)
    interrupted(larger(TRACED), out, 1, extend=True)
    with open_study(out) as ds:
        assert int((ds["status"] == 0).sum()) == 4 * DAYS + 2
    assert verified(out) == []
    resumed(out, larger(TRACED))
    assert len(list(out.glob("traces-*.nc"))) == 1


def test_run_json_is_valid_json_for_others(broken_off):
    found = json.loads((broken_off / "run.json").read_text())
    assert set(found) == {"study_sha256", "boundary_sha256", "model_sha256", "relative_to", "format"}


# --- arrays in files --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [PLAIN, TRACED], ids=["plain", "traced"])
def test_a_study_merged_on_the_disk_is_the_one_merged_in_memory(out, text, monkeypatch):
    monkeypatch.setattr(merge, "_LARGE", 0)
    before = set(os.listdir("/proc/self/fd"))
    assert ran(text, out) == golden(text)
    # nameless files are gone with their arrays; the traces stay open with the results
    assert {p.name for p in out.iterdir()} <= {".lock", "results.nc", "run.json", "study.toml"} | {
        p.name for p in out.glob("traces-*.nc")
    }
    assert len(set(os.listdir("/proc/self/fd")) - before) <= 1
    assert ran(larger(text), out, extend=True) == golden(larger(text))


@pytest.mark.parametrize("text", [PLAIN, TRACED], ids=["plain", "traced"])
def test_room_for_the_merge_is_taken_before_it_is_used(out, text, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(merge, "_LARGE", 0)
        patched.setattr(os, "posix_fallocate", full)
        with pytest.raises(StorageError, match="No space left on device"):
            ran(text, out)
    assert unfinished(out) == []
    assert len(shards(out)) == DAYS
    resumed(out, text)

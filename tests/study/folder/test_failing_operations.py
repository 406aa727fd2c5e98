"""Operations on files that fail: the run ends with a sentence, and the next one completes it."""

import errno
import os
import shutil

import pytest
from helpers.failing_files import NthOperation, intercept_operations
from helpers.studies import (
    DAYS,
    PLAIN_STUDY,
    SITUATIONS,
    TRACED_STUDY,
    copy_run,
    resume_to_end,
    run,
    shard_files,
    undisturbed_hash,
    unfinished_files,
    write_study,
)

from fastcoil.base.errors import IntegrityError, StorageError
from fastcoil.study import run as runner
from fastcoil.study.folder.stored import SHARD_NAME_PATTERN

pytestmark = pytest.mark.kernel


def fail_each_operation(tmp_path, situation, *, lasting=False, stride=1):
    """Let the n-th operation on files fail, n = 1, 2, … until none is left; each time the next run must repair it."""
    text, prepare = SITUATIONS[situation]
    out, before = tmp_path / "out", tmp_path / "before"
    study = write_study(text, out)
    prepare(out)
    study = write_study(text, out)
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
        nth = NthOperation(n, fail, lasting=lasting)
        shards_before = {p.name: p.read_bytes() for p in shard_files(out)}
        try:
            with intercept_operations(out, nth):
                finished = runner.execute(study, out, n_jobs=1, extend=True)
        except StorageError as refused:
            message = str(refused)
        except IntegrityError as refused:  # the stored study is checked before it is extended
            message = str(refused)
            assert "cannot be read" in message  # noqa: PT017
            assert nth.done[n - 1] == "open for reading"
        else:  # nothing failed, or what nobody needs
            assert finished.results.attrs["content_sha256"] == undisturbed_hash(text), (n, nth.done)
            message = ""
        assert not message or os.strerror(error) in message, (n, nth.done)
        reached = len(nth.done) >= n
        assert lasting or unfinished_files(out) == [], (n, nth.done)
        assert all(p.read_bytes() == shards_before[p.name] for p in shard_files(out) if p.name in shards_before), (
            n,
            nth.done,
        )
        assert not out.exists() or not (out / "run.json").exists() or all(map(SHARD_NAME_PATTERN.fullmatch, (
            p.name for p in shard_files(out) if not p.name.endswith(".tmp")))), (n, nth.done)  # fmt: skip
        assert resume_to_end(out, text, extend=True) == [], (n, nth.done)
        n += stride
    return n


@pytest.mark.parametrize(
    ("situation", "stride"),
    [("extended", 127), *(pytest.param(name, 1, marks=pytest.mark.full) for name in SITUATIONS)],
)
def test_whichever_operation_fails_the_run_ends_with_4_and_the_next_one_completes_it(tmp_path, situation, stride):
    assert fail_each_operation(tmp_path, situation, stride=stride) > 50


def test_a_shard_whose_fsync_fails_once_is_not_written_and_fsync_is_not_tried_again(out, monkeypatch):
    copy_run(PLAIN_STUDY, out, 1)
    calls, real = [], os.fsync

    def fsync(descriptor):
        calls.append(descriptor)
        if len(calls) == 1:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        real(descriptor)

    before = shard_files(out)
    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(StorageError, match="Input/output error"):
        run(PLAIN_STUDY, out)
    assert len(calls) == 1
    assert shard_files(out) == before
    monkeypatch.undo()
    resume_to_end(out)


def test_bytes_are_on_the_disk_before_a_name_points_to_them(out):
    done = []
    with intercept_operations(out, done.append):
        run(TRACED_STUDY, out)
    # .holder; run.json, study.toml, shards; traces and results.nc, each after its hash in run.json; run.json
    replaced = [k for k, name in enumerate(done) if name == "replace"]
    assert len(replaced) == 1 + 2 + DAYS + 4 + 1 + 1  # the last: answer.json
    after_a_hash = [replaced[k] for k in (-4, -2)]
    for k in replaced:
        assert done[k + 1 : k + 3] == ["open", "fsync"]
        if k not in after_a_hash:
            assert done[k - 2 : k] == ["open", "fsync"]
    for k in after_a_hash:
        assert done[:k].count("fsync") >= 2 * done[:k].count("replace") + 1


def test_a_folder_is_on_the_disk_before_anything_is_in_it(out):
    done = []
    with intercept_operations(out, done.append):
        run(PLAIN_STUDY, out)
    mkdir_steps = [k for k, name in enumerate(done) if name == "mkdir"]
    for k in (mkdir_steps[0], mkdir_steps[-1]):  # the folder and shards/; the library of locks asks for the folder, too
        assert "fsync" in done[k + 1 : k + 3]

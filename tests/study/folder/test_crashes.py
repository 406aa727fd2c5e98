"""Runs that are killed, at every step and at any time, and disks that are full: the next run finds the same."""

import os
import random
import re
import shutil
import subprocess

import pytest
from helpers.studies import (
    DAYS,
    PLAIN_STUDY,
    SITUATIONS,
    TRACED_STUDY,
    resume_to_end,
    shard_files,
    unfinished_files,
)

from fastcoil.study import maintenance

pytestmark = pytest.mark.kernel


def finish(folder, text, **options):
    """Go on to the end: nothing is found damaged, and the result is that of an undisturbed run."""
    if (folder / "run.json").exists() and (folder / "study.toml").exists():
        assert all("study.toml" in p or "can no longer be read" in p for p in maintenance.verify(folder))
    assert resume_to_end(folder, text, **options) == []
    assert not (folder / "shards").exists()
    assert not (folder / "quarantine").exists()


# --- kill -9 ----------------------------------------------------------------------------------------------------------


def kill_before_each_operation(run_forked, tmp_path, situation, stride=1):
    """Kill a run before its n-th operation on files, n = 1, 2, …: half-written files and all."""
    text, prepare = SITUATIONS[situation]
    before, out = tmp_path / "before", tmp_path / "out"
    prepare(out)
    if out.exists():
        shutil.copytree(out, before)
    n, code = 1, -9
    while code == -9:
        shutil.rmtree(out, ignore_errors=True)
        if before.exists():
            shutil.copytree(before, out)
        code, done, output = run_forked(text, out, extend=True, kill_before=n)
        assert (code, done) == (-9, n) or code == 0, output
        finish(out, text, extend=True)
        n += stride
    return n


@pytest.mark.parametrize(
    ("situation", "stride"),
    [("extended", 131), *(pytest.param(name, 1, marks=pytest.mark.full) for name in SITUATIONS)],
)
def test_a_run_killed_at_any_step_is_completed_by_the_next(run_forked, tmp_path, situation, stride):
    assert kill_before_each_operation(run_forked, tmp_path, situation, stride) > 60


def kill_at_random_times(run_forked, tmp_path, times, seed):
    """Kill a study with traces again and again until it is finished, then start another, ``times`` kills in total."""
    random_time, n_kills, k = random.Random(seed), 0, 0
    while n_kills < times:
        out = tmp_path / f"out{k}"
        code = -9
        while code == -9 and n_kills < times:
            code, _, output = run_forked(TRACED_STUDY, out, kill_after=random_time.uniform(0.0, 0.4))
            assert code in (-9, 0), output
            n_kills += 1
        finish(out, TRACED_STUDY)
        shutil.rmtree(out)
        k += 1


@pytest.mark.full
def test_a_run_killed_at_any_time_is_completed_by_the_next(run_forked, tmp_path):
    kill_at_random_times(run_forked, tmp_path, 10, seed=1)


# --- limits -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("limit", [1000, 30_000, 66_000])
def test_a_limit_on_the_size_of_files_ends_a_run_with_4(run_forked, tmp_path, limit):
    out = tmp_path / "out"
    # Python ignores the signal, so that a write fails with EFBIG
    code, _, output = run_forked(
        TRACED_STUDY.replace("[0.0, 0.9]", "[0.0, 0.5, 0.9]"), out, limits={"RLIMIT_FSIZE": limit}
    )
    assert code == (4 if limit < 66_000 else 0), output
    if code:
        assert "Traceback" not in output
        assert not out.exists() or unfinished_files(out) == []
    finish(out, TRACED_STUDY.replace("[0.0, 0.9]", "[0.0, 0.5, 0.9]"))


def test_too_few_open_files_end_a_run_with_4_or_are_enough(run_forked, tmp_path):
    out = tmp_path / "out"
    codes = set()
    for limit in range(4, 20):
        code, _, output = run_forked(TRACED_STUDY, out, limits={"RLIMIT_NOFILE": limit})
        assert "Traceback" not in output, output
        assert code in (0, 4), output
        codes.add(code)
        if code == 0:
            break
    assert codes == {0, 4}
    finish(out, TRACED_STUDY)


def allow_other_users(folder):
    """Let every user enter a folder of a test."""
    for parent in [folder, *folder.parents][:4]:
        parent.chmod(parent.stat().st_mode | 0o755)


def test_a_folder_that_must_not_be_written_ends_a_run_with_4(run_forked, tmp_path):
    if os.getuid():
        pytest.skip("only root can become another user")
    out = tmp_path / "out"
    out.mkdir(mode=0o755)
    allow_other_users(tmp_path)
    code, _, output = run_forked(PLAIN_STUDY, out, user=65534)
    assert code == 4, output
    assert "Permission denied" in output
    assert list(out.iterdir()) == []
    finish(out, PLAIN_STUDY)


# --- full disks -------------------------------------------------------------------------------------------------------


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 2 MiB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=2m", "none", str(place)], capture_output=True, check=False, timeout=60
    )
    if mount.returncode:
        pytest.skip("mounting a small file system needs root")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True, timeout=60)


@pytest.mark.parametrize("interval", [50, pytest.param(1, marks=pytest.mark.full)])
def test_a_full_disk_ends_a_run_with_4_and_freeing_space_lets_it_go_on(run_forked, small_disk, interval):
    codes, kept, text = set(), set(), TRACED_STUDY.replace("interval = 50", f"interval = {interval}")
    ballast = small_disk / "ballast"
    for free_kib in range(8, 1400, 120):
        out = small_disk / f"out{free_kib}"
        room = shutil.disk_usage(small_disk).free - 1024 * free_kib
        with ballast.open("wb") as file:
            os.posix_fallocate(file.fileno(), 0, room)
        code, _, output = run_forked(text, out, unchecked=True)
        codes.add(code)
        assert code in (0, 4), output
        assert not code or re.search("No space left on device", output), output
        assert "Traceback" not in output
        if out.exists():
            assert unfinished_files(out) == []
        before = {p.name: p.read_bytes() for p in shard_files(out)}
        kept.add(len(before))
        ballast.unlink()
        assert {p.name: p.read_bytes() for p in shard_files(out)} == before
        finish(out, text)
        shutil.rmtree(out)
        if code == 0:
            break
    assert codes == {0, 4}
    # it was full before, among and after the shards: while they were merged
    assert kept >= {0, DAYS}

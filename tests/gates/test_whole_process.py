"""What a process leaves behind and takes for itself: nothing that grows, nothing that stays, no rights it has not."""

import gc
import os
import re
import stat
import tempfile
from pathlib import Path

import pytest
from helpers.processes import wait_for
from helpers.studies import TRACED_STUDY, copy_run, run

import fastcoil as fc
from fastcoil.base.errors import EXIT_INPUT, EXIT_INTEGRITY, EXIT_STORAGE
from fastcoil.study import maintenance

pytestmark = pytest.mark.kernel

NOBODY = 65534


def open_files_and_threads():
    """Open files and threads of this process."""
    gc.collect()
    return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="only Linux lists the open files of a process in /proc")
@pytest.mark.parametrize("times", [4, pytest.param(200, marks=pytest.mark.full)])
def test_open_files_and_threads_do_not_grow(out, half_hour_day, times):
    copy_run(TRACED_STUDY, out)

    def use(times):
        for _ in range(times):
            fc.open_study(out)["T_sup"].load()
            fc.simulate(fc.Loop(backlash=[0.0, 0.07]), half_hour_day, warm_up=60, n_jobs=2)

    use(3)
    before = open_files_and_threads()
    use(times)
    wait_for(lambda: open_files_and_threads() <= before, seconds=5)  # a thread needs a moment to end


@pytest.mark.parametrize("mask", [0o027, pytest.param(0o002, marks=pytest.mark.full)], ids=oct)
def test_files_get_the_rights_that_the_user_gives_new_files(out, mask):
    before = os.umask(mask)
    try:
        run(TRACED_STUDY, out)
        maintenance.rerun(out, {"backlash": "0.07", "estimate_ratio": "0.9", "day": "1"})
    finally:
        os.umask(before)
    rights = {p: stat.S_IMODE(p.stat().st_mode) for p in [out, *out.rglob("*")]}
    assert rights == {p: (0o777 if p.is_dir() else 0o666) & ~mask for p in rights}


@pytest.fixture
def elsewhere():
    """A folder that others may enter; those of pytest are closed to them."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.fixture
def as_nobody(run_forked):
    """Run a command as a user who owns nothing: exit code, what it said."""
    if os.getuid():
        pytest.skip("only root can become another user")
    if not all(folder.stat().st_mode & stat.S_IXOTH for folder in Path(__file__).parents):
        pytest.skip("another user cannot enter the folder of this checkout")

    def run(place, *words):
        code, _, output = run_forked(TRACED_STUDY, place / "other", arguments=list(map(str, words)), user=NOBODY)
        assert "Traceback" not in output, output
        return code, output

    return run


def test_a_folder_in_which_one_cannot_write_can_be_looked_at(as_nobody, elsewhere):
    out = elsewhere / "out"
    run(TRACED_STUDY, out)
    for path in [out, *out.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    before = {p: p.stat().st_mtime_ns for p in [out, *out.rglob("*")]}
    code, output = as_nobody(elsewhere, "status", out)
    assert (code, "Finished: 12 of 12" in output) == (0, True), output
    code, output = as_nobody(elsewhere, "verify", out)
    assert (code, "is sound" in output) == (0, True), output
    assert {p: p.stat().st_mtime_ns for p in [out, *out.rglob("*")]} == before


@pytest.mark.parametrize("closed", [pytest.param("place", marks=pytest.mark.full), "folder", "files"])
def test_a_folder_that_one_cannot_read_is_refused_with_a_sentence(as_nobody, elsewhere, closed):
    out = elsewhere / "place" / "out"
    out.parent.mkdir()
    run(TRACED_STUDY, out)
    for path in {"place": [out.parent], "folder": [out]}.get(closed, out.rglob("*")):
        path.chmod(0o700 if path.is_dir() else 0o600)
    for command in ("status", "verify", "plot"):
        code, output = as_nobody(elsewhere, command, out)
        assert code in (EXIT_INPUT, EXIT_STORAGE, EXIT_INTEGRITY), (command, code, output)
        assert re.search("Permission denied|not readable", output)

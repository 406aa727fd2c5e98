"""Whichever system call fails, in the package or in a library: one sentence, and the same command completes the run."""

import errno
import re
import shutil
import signal
import warnings

import pytest
from helpers.calls import CHANGES, FROM_THEN_ON, SHORT, Call
from helpers.studies import TRACED, golden, run, unfinished

from fastcoil.base.errors import EXIT_INTEGRITY, EXIT_STORAGE
from fastcoil.study import maintenance

pytestmark = pytest.mark.kernel

FAILING = [Call.OPEN, Call.WRITE, Call.SYNC, Call.RENAME, Call.UNLINK, Call.MKDIR, Call.RMDIR]
REASONS = (errno.ENOSPC, errno.EIO, errno.EDQUOT)
"""Disk full, broken, or used up by this user."""


@pytest.fixture
def command(watched, out):
    """Run the study in an empty folder while calls fail as ordered: exit code, number of calls, what it said."""

    def run(**calls):
        shutil.rmtree(out, ignore_errors=True)
        words = ["run", str(out.with_name("study.toml")), "-o", str(out), "-j", "1", "--no-figures"]
        return watched(TRACED, out, arguments=words, calls={"folder": str(out), **calls})

    return run


def check_completed(out):
    """The same command, undisturbed, finds nothing damaged and gives the results of an undisturbed run."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert run(TRACED, out) == golden(TRACED)
    assert maintenance.verify(out) == []
    assert unfinished(out) == []
    assert not (out / "quarantine").exists()


def crashed_in_hdf5(said):
    """Whether a crash was in a call of the NetCDF library, which does not look whether it got its memory.

    Nor does it look whether the last write of a file that it closes was done.
    """
    _, found, stack = said.partition("Current thread")
    return found and re.search("netcdf|file_manager", "".join(stack.splitlines(keepends=True)[1:4]), re.IGNORECASE)


def check_ended(code, said, out):
    """A command ended well, or with one sentence; in either case the folder is sound."""
    assert "Traceback" not in said, said
    if code == 0:
        assert maintenance.verify(out) == []
    elif code == -signal.SIGSEGV:
        assert crashed_in_hdf5(said), said
    else:
        # what cannot be read cannot be checked
        assert code == EXIT_STORAGE or (code == EXIT_INTEGRITY and "cannot be read" in said), (code, said)
        sentences = [line for line in said.splitlines() if not line.startswith("Compiling")]
        assert len(sentences) == 1, said
        assert sentences[0].startswith("fastcoil: "), said
    check_completed(out)


def fail(command, out, kinds, n):
    """Let the n-th call of some kinds fail.  Returns the exit code."""
    code, seen, said = command(kinds=int(kinds), nth=n, reason=REASONS[n % len(REASONS)])
    try:
        assert seen >= n, "it did not come so far"
        check_ended(code, said, out)
    except BaseException as error:
        error.add_note(f"call {n} of {kinds!r}, errno {REASONS[n % len(REASONS)]}, exit code {code}")
        raise
    return code


def test_whichever_kind_of_call_fails_the_run_ends_with_4(command, out):
    for kind in (Call.WRITE, Call.RENAME):
        code, n_calls, said = command(kinds=int(kind))
        assert code == 0, said
        assert n_calls > 0
        fail(command, out, kind, n_calls * 2 // 3 + 1)


@pytest.mark.full
def test_whichever_call_fails_the_run_ends_with_4(command, out):
    n_calls = command(kinds=int(CHANGES))[1]
    assert n_calls > 300
    codes = [fail(command, out, CHANGES, n) for n in range(1, n_calls + 1)]
    assert codes.count(-signal.SIGSEGV) <= 3  # in closing the traces, twice, and the results


@pytest.mark.full
@pytest.mark.parametrize("kind", FAILING, ids=lambda kind: kind.name.lower())
def test_calls_that_fail_from_then_on_end_the_run_with_4(command, out, kind):
    n_calls = command(kinds=int(kind))[1]
    for n in range(1, n_calls + 1, max(1, n_calls // 40)):
        code, _, said = command(kinds=int(kind), nth=n, reason=errno.EIO, often=FROM_THEN_ON)
        check_ended(code, said, out)


def test_writes_that_are_cut_short_are_completed(command, out):
    every = command(kinds=int(Call.WRITE))[1]
    code, seen, said = command(kinds=int(Call.WRITE), nth=1, reason=SHORT, often=FROM_THEN_ON)
    assert (code, seen > every) == (0, True), said
    check_ended(code, said, out)

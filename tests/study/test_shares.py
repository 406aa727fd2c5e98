"""`fastcoil run --shard K/N`: shares of a study, run by several commands in any order, and merged by one without it."""

import errno
import fcntl
import os
import re
import shutil
import subprocess
import sys
from itertools import pairwise
from unittest.mock import Mock

import numpy as np
import pytest
from helpers.commands import fastcoil
from helpers.full import full_except
from helpers.processes import child_environment, cut_studies
from helpers.refusals import assert_refused
from helpers.sentences import assert_worded
from helpers.studies import (
    PLAIN_STUDY,
    TRACED_STUDY,
    folder_contents,
    resume_to_end,
    shard_files,
    verify_unchanged,
    with_larger_sweep,
    write_study,
)
from hypothesis import given, settings
from hypothesis import strategies as st

import fastcoil as fc
from fastcoil.base.errors import LockedError
from fastcoil.loops.plan import JobSlice, plan_simulation
from fastcoil.study import run as runner
from fastcoil.study.folder.folder import hold_folder
from fastcoil.study.folder.stored import Manifest
from fastcoil.study.maintenance import status

pytestmark = pytest.mark.kernel

SEQUENCE = TRACED_STUDY + "carry_over = true\n"


def run_slice(text, out, word, **options):
    """Run a share, with one worker; how many scenarios it ran."""
    return runner.execute_slice(write_study(text, out), out, JobSlice.parse(word), n_jobs=1, **options)


def interrupt_slice(text, out, word):
    """Run a share, which ends as by a kill after its first shard."""
    with pytest.raises(KeyboardInterrupt):
        run_slice(text, out, word, progress=lambda *_: Mock(side_effect=KeyboardInterrupt))


@settings(max_examples=25)
@given(st.integers(1, 40), st.integers(1, 9), st.booleans())
def test_shares_are_all_scenarios_once_and_of_days_in_sequence_whole_lanes(n_loops, n, carry_over):
    loop = fc.Loop(backlash=("sample", np.linspace(0.0, 0.1, n_loops)))
    day = fc.Boundary(m_a=np.full((3, 120), 1.0), T_a_in=25.0, W_a_in=0.01, T_w_in=7.0, T_set=14.0)
    plan = plan_simulation(loop, day, warm_up=60, carry_over=carry_over)
    slices = [JobSlice(k, n).index(plan) for k in range(1, n + 1)]
    assert np.sort(np.concatenate(slices)).tolist() == [*range(3 * n_loops)]
    assert all(np.all(np.diff(index) > 0) for index in slices)
    if carry_over:
        assert all(np.bincount(index % n_loops).max() == 3 for index in slices if index.size)
    else:
        assert all(a[-1] < b[0] for a, b in pairwise(index for index in slices if index.size))


@pytest.mark.parametrize(
    "text", [pytest.param(TRACED_STUDY, marks=pytest.mark.full), SEQUENCE], ids=["traced", "sequence"]
)
def test_shares_in_any_order_one_twice_and_one_killed_make_the_study(out, text, monkeypatch):
    if text != SEQUENCE:
        cut_studies(monkeypatch, 2)
    assert run_slice(text, out, "3/3") > 0
    before = folder_contents(out / "shards")
    assert run_slice(text, out, "3/3") == 0
    assert folder_contents(out / "shards") == before
    interrupt_slice(text, out, "1/3")
    done = {int(found[1]) for path in shard_files(out) if (found := re.match(r"(\d+)-", path.name))}
    assert len(done) >= 2
    status_text = "\n".join(status(out))
    assert "Unfinished: " in status_text
    assert re.search(r"Of 3 shares [12] are to be run: (1/3, )?2/3\.", status_text)
    assert run_slice(text, out, "1/3") < 12 // 3 + (text == SEQUENCE)
    assert run_slice(text, out, "2/3") > 0
    assert "Of 3 shares" not in "\n".join(status(out))
    assert any(line.startswith("Unfinished: 12 of 12") for line in status(out))  # not merged yet
    assert verify_unchanged(out) == []
    resume_to_end(out, text)
    assert not list(out.glob(".lock-*"))
    files = folder_contents(out)
    assert run_slice(text, out, "2/3") is None
    assert folder_contents(out) == files


def test_what_no_share_ran_is_run_by_the_merge_and_shares_of_other_numbers_may_overlap(out, monkeypatch):
    cut_studies(monkeypatch, 2)
    run_slice(TRACED_STUDY, out, "1/2")
    run_slice(TRACED_STUDY, out, "4/9")
    assert run_slice(TRACED_STUDY, out, "9/9") == 2
    resume_to_end(out, TRACED_STUDY)


@pytest.mark.full
def test_a_damaged_shard_of_a_share_is_computed_again_and_one_of_another_left_alone(out, monkeypatch):
    cut_studies(monkeypatch, 2)
    run_slice(PLAIN_STUDY, out, "1/2")
    run_slice(PLAIN_STUDY, out, "2/2")
    own_shard, other_shard = shard_files(out)[-1], shard_files(out)[0]
    sound = own_shard.read_bytes()
    for path in (own_shard, other_shard):
        path.write_bytes(b"damaged")
    with pytest.warns(UserWarning, match=re.escape(own_shard.name)) as warned:
        assert run_slice(PLAIN_STUDY, out, "2/2") == 2
    assert len(warned) == 1
    # under another name once a second has passed, which the library writes into the file
    (new_shard,) = (p for p in shard_files(out) if p.name[:9] == own_shard.name[:9] and p.read_bytes() != b"damaged")
    assert new_shard.stat().st_size == len(sound)
    assert other_shard.read_bytes() == b"damaged"


def test_a_share_on_another_cpu_is_told(out, monkeypatch):
    run_slice(PLAIN_STUDY, out, "1/3")
    monkeypatch.setattr("fastcoil.loops.simulate.numeric_environment", lambda: {"cpu": "another"})
    with pytest.warns(UserWarning, match="was computed elsewhere .*cpu .*, now another"):
        run_slice(PLAIN_STUDY, out, "2/3")
    monkeypatch.undo()
    run_slice(PLAIN_STUDY, out, "3/3")
    runner.execute(write_study(PLAIN_STUDY, out), out)
    manifest = Manifest.read(out)
    assert {"cpu": "another"} in manifest.computed_on
    assert len(manifest.computed_on) == 2


# --- at the same time -------------------------------------------------------------------------------------------------


def test_shares_run_at_the_same_time_in_processes_of_their_own(out):
    write_study(TRACED_STUDY, out)
    command = [sys.executable, "-m", "fastcoil", "run", "study.toml", "-o", "out", "-j", "1", "--shard"]
    options = {"cwd": out.parent, "env": child_environment(), "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    running = [subprocess.Popen([*command, word], **options, text=True) for word in ("1/2", "2/2")]
    for process in running:
        stdout, complaint = process.communicate(timeout=120)
        assert process.returncode == 0, complaint
        assert (
            "is finished: 6 scenario-days were run.\n"
            "When all shares are finished, merge them with: fastcoil run study.toml -o out\n" in stdout
        )
    resume_to_end(out, TRACED_STUDY)


def test_the_same_share_is_not_run_twice_at_once_and_not_beside_a_run_of_all(out, monkeypatch):
    monkeypatch.setattr("fastcoil.study.folder.folder._SLICE_LOCK_TIMEOUT_S", 0.1)
    monkeypatch.setattr("fastcoil.study.folder.folder._LOCK_TIMEOUT_S", 0.1)
    with hold_folder(out, "1-of-2"):
        with pytest.raises(LockedError, match=f"share 1 of 2 of .*out is in use by another run .process {os.getpid()}"):
            run_slice(PLAIN_STUDY, out, "1/2")
        assert "Shares that are being run: 1/2." in status(out)
        assert run_slice(PLAIN_STUDY, out, "2/2") == 6
        assert "Of 2 shares 0 are to be run." in status(out)
        with pytest.raises(LockedError, match="share 1 of 2 of .*wait for it to end"):
            runner.execute(write_study(PLAIN_STUDY, out), out)
    with hold_folder(out), pytest.raises(LockedError, match=f"^{out} is in use by another run"):
        run_slice(PLAIN_STUDY, out, "1/2")
    assert run_slice(PLAIN_STUDY, out, "1/2") == 6
    resume_to_end(out, PLAIN_STUDY)


@pytest.mark.filterwarnings("ignore:flock not supported")
@pytest.mark.parametrize("number", full_except([errno.EOPNOTSUPP, errno.ENOLCK, errno.ENOSYS], [errno.ENOLCK]))
def test_a_file_system_without_locks_takes_shares_and_another_one_merges_them(out, monkeypatch, number):
    with monkeypatch.context() as patched:
        patched.setattr(fcntl, "flock", Mock(side_effect=OSError(number, os.strerror(number))))
        run_slice(PLAIN_STUDY, out, "1/2")
        run_slice(PLAIN_STUDY, out, "2/2")
        command = fastcoil("run", out.with_name("study.toml"), "-o", out)
        assert command.exit_code == 4
        assert "choose a folder on another file system" in command.output
    copy = out.with_name("copy")
    shutil.copytree(out, copy)
    resume_to_end(copy, PLAIN_STUDY)


# --- refused ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        *(["--shard", word] for word in ("0/3", "4/3", "1", "a/b", "1/0", "-1/2", "1/2/3")),
        ["--shard", "1/2", "--extend"],
        ["--shard", "1/2", "-o", "s3://bucket/out"],
    ],
)
def test_a_bad_share_is_refused_in_a_sentence(out, words):
    write_study(PLAIN_STUDY, out)
    command = fastcoil("run", out.with_name("study.toml"), "-o", out, *words)
    assert command.exit_code == 2
    assert_worded(command.stderr)
    assert not out.exists()


def test_a_share_of_a_study_with_precision_or_of_another_study_is_refused(out):
    precise = PLAIN_STUDY.replace(
        "[sweep]\nbacklash = [0.02, 0.07]", "[sample]\nmethod = 'sobol'\nsize = 4\nbacklash = { uniform = [0.0, 0.1] }"
    )
    precise = precise.replace("estimate_ratio = [0.0, 0.9]\n", "")
    precise += 'precision = { metric = "rmse", half_width = 1.0 }\n'
    assert_refused("--shard", "unsupported", run_slice, precise, out, "1/2")
    assert not out.exists()
    run_slice(PLAIN_STUDY, out, "1/2")
    before = folder_contents(out)
    assert_refused("-o", "conflict", run_slice, with_larger_sweep(PLAIN_STUDY), out, "1/2")
    assert folder_contents(out) == before

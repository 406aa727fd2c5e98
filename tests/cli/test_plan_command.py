"""`fastcoil plan`, and commands for which the memory does not suffice."""

import re

import pytest
from helpers.commands import fastcoil

from fastcoil.loops import plan as resources
from fastcoil.study import run as runner

pytestmark = pytest.mark.kernel

MANY_DAYS_STUDY = f"[loop]\n[boundary]\nhours = 0.1\nseed = {list(range(300))}\n[run]\nwarm_up = 60\n"


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(MANY_DAYS_STUDY)
    return path


def test_plan_counts_a_day_with_one_scenario_as_a_block_and_says_what_it_takes(study):
    result = fastcoil("plan", study, "-j", 2)
    assert result.exit_code == 0, result.output
    assert ", 8 shards" in result.output
    seconds = float(re.search(r"Time: +about ([0-9.]+) s on 2 threads without figures", result.output)[1])
    assert 0.3 < seconds < 100.0
    assert float(re.search(r"Memory: +about ([0-9.]+) MiB \(", result.output)[1]) > 150.0
    assert re.search(r"Disk: +about ([0-9.]+) [KM]iB during the merge, ([0-9.]+) KiB afterwards\n", result.output)


def test_workers_that_do_not_fit_are_refused_before_anything_is_written(study, monkeypatch):
    monkeypatch.setattr(resources, "available_memory", lambda: 500 * 2**20)
    result = fastcoil("run", study, "-j", 8, "--backend", "loky", "-o", study.with_name("out"))
    assert result.exit_code == 2
    assert re.search(r"8 workers need 1\.\d GiB of memory, 500\.0 MiB are available: use -j 2\n", result.output)
    assert not list(study.with_name("out").glob("[!.]*"))


def test_memory_that_runs_out_is_one_sentence_and_keeps_what_is_finished(study, monkeypatch):
    out = study.with_name("out")
    with monkeypatch.context() as patched:
        patched.setattr(runner, "merge_metrics", lambda *_: (_ for _ in ()).throw(MemoryError))
        result = fastcoil("run", study, "-j", 2, "-o", out, "--no-figures")
    assert result.exit_code == 4
    sentence = "the command ended: the memory ran out; finished scenarios are kept: use fewer workers with -j"
    assert f"fastcoil: {sentence}" in result.output
    assert len(list((out / "shards").glob("*.nc"))) == 8
    assert fastcoil("run", study, "-o", out, "--no-figures").exit_code == 0

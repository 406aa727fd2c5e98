"""A rule that takes a value from elsewhere: what was computed with another value is never joined with it."""

import numpy as np
import pytest
from helpers.processes import cut_studies
from helpers.refusals import refuses
from helpers.rules import RULE_HEADER

import fastcoil as fc
from fastcoil.loops.plan import Shard
from fastcoil.model.user_rules import hash_user_code
from fastcoil.study import maintenance
from fastcoil.study import workers as worker
from fastcoil.study.file.spec import read_study
from fastcoil.study.file.user_code import load_function
from fastcoil.study.run import execute

STUDY = """
[loop]
estimator = "mine:steps"
[sweep]
backlash = [0.02, 0.07]
[boundary]
kind = "constant_day"
hours = 0.2
T_set = 14
[run]
warm_up = 60
"""
SOURCE = (
    f"import pathlib\n{RULE_HEADER.replace('0.01', '1.0')}"
    + """\
def steps(now, p, memory):
    return min(now.estimate + STEP * p.gain, 0.2), memory

STEP = float(pathlib.Path({value!r}).read_text())
"""
)
CHANGED = ("steps", "code")  # field and code of a rule with another value
pytestmark = pytest.mark.kernel


@pytest.fixture
def value(tmp_path):
    """The file that the rule reads as it is loaded."""
    file = tmp_path / "value"
    file.write_text("0.001")
    load_function.cache_clear()
    yield file
    load_function.cache_clear()


@pytest.fixture
def path(tmp_path, value):
    (tmp_path / "mine.py").write_text(SOURCE.format(value=str(value)))
    file = tmp_path / "study.toml"
    file.write_text(STUDY)
    return file


def change_value(value):
    value.write_text("0.002")
    load_function.cache_clear()


def run_until_first_shard(path, out, monkeypatch):
    """Run the study until one of its shards is there."""
    cut_studies(monkeypatch, 1)

    def stop(n):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        execute(read_study(path, prepare=load_function), out, n_jobs=1, progress=lambda *_: stop)


def test_a_study_goes_on_with_the_same_value_alone(path, value, tmp_path, monkeypatch):
    out = tmp_path / "out"
    run_until_first_shard(path, out, monkeypatch)
    change_value(value)
    with refuses(CHANGED):
        fc.run_study(path, out, n_jobs=1)
    value.write_text("0.001")
    load_function.cache_clear()
    ds = fc.run_study(path, out, n_jobs=1)
    assert ds.attrs["content_sha256"] == fc.run_study(path, tmp_path / "other", n_jobs=1).attrs["content_sha256"]


def test_finished_results_of_another_value_are_neither_shown_nor_run_again_nor_extended(path, value, tmp_path):
    out = tmp_path / "out"
    fc.run_study(path, out, n_jobs=1).close()
    change_value(value)
    with refuses(CHANGED):
        fc.run_study(path, out, n_jobs=1)
    with refuses(CHANGED):
        maintenance.rerun(out, {"backlash": "0.02"})
    path.write_text(STUDY.replace("0.07]", "0.07, 0.12]"))
    with refuses(CHANGED):
        fc.run_study(path, out, n_jobs=1, extend=True)
    assert fc.open_study(out).sizes["backlash"] == 2
    value.write_text("0.001")
    load_function.cache_clear()
    assert fc.run_study(path, out, n_jobs=1, extend=True).sizes["backlash"] == 3


def test_a_worker_with_another_value_computes_nothing(path, value, monkeypatch):
    study = read_study(path, prepare=load_function)
    here = hash_user_code(study.plan.layout.loop.rules.values(), {})
    assert here["steps"]
    elsewhere = {"steps": {version: "another" for version in here["steps"]}}
    job = worker.Job(study.plan, None, study.rules, elsewhere)
    with refuses(CHANGED):
        worker.run_received_job(job, Shard(np.array([0])))

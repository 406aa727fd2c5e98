"""A study or a folder of a stranger: looking at it runs nothing of theirs, and running it says so first."""

from dataclasses import replace

import pytest
from helpers.commands import fastcoil, plan_and_run
from helpers.refusals import refuses
from helpers.studies import PLAIN_STUDY, TRACED_STUDY

import fastcoil as fc
from fastcoil.base.errors import InputError
from fastcoil.study.file.spec import read_study
from fastcoil.study.file.user_code import load_function
from fastcoil.study.folder.stored import Manifest
from fastcoil.study.run import execute

pytestmark = pytest.mark.kernel

STUDY = TRACED_STUDY + 'reduce = "mine:spread"\n'
SOURCE = """
import pathlib, xarray as xr
pathlib.Path({trace!r}).touch()
def spread(traces):
    values = traces["T_sup"]
    return xr.Dataset({{"spread": values.max("elapsed_time") - values.min("elapsed_time")}})
"""
AT = "backlash=0.07,estimate_ratio=0.9,day=1"


@pytest.fixture
def path(with_code):
    """A study with a function of its own."""
    return with_code(STUDY, SOURCE)


@pytest.fixture
def run_before(path, trace, tmp_path):
    """The folder of that study, run by somebody else."""
    out = tmp_path / "out"
    fc.run_study(path, out, n_jobs=1).close()
    assert trace.exists(), "run_study runs it"
    trace.unlink()
    load_function.cache_clear()
    return out


def test_plan_and_run_say_whose_code_they_run(path, trace, tmp_path):
    sentence = f"This study runs its own code: spread from {tmp_path / 'mine.py'}."
    for done in plan_and_run(path, tmp_path / "out"):
        assert done.stderr.splitlines()[0] == sentence
        assert trace.exists()
        trace.unlink()


def test_reading_a_study_runs_nothing(path, trace):
    read_study(path)
    assert not trace.exists()


def test_mistakes_in_the_code_are_found_before_anything_is_computed_together_with_all_others(path, tmp_path):
    path.write_text(STUDY.replace("[sweep]", "kpp = 1\n[sweep]"))
    (tmp_path / "mine.py").write_text("raise ValueError('unripe')")
    for command in (["plan", path], ["run", path, "-o", tmp_path / "out"]):
        done = fastcoil(*command)
        assert done.exit_code == 2
        assert "kpp" in done.stderr
        assert "[run] reduce = 'mine:spread': its module does not run: ValueError: unripe" in done.stderr
    with pytest.raises(InputError) as refused:
        fc.run_study(path, tmp_path / "out")
    assert len(refused.value.problems) == 2
    path.write_text(STUDY)
    study = read_study(path)
    with refuses(("reduce", "code")):
        execute(study, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_looking_at_a_folder_runs_no_code_of_its_study(path, trace, run_before):
    # nothing of it is current, so that every command reads the study again
    (run_before / "results.nc").unlink()
    forged = replace(Manifest.read(run_before), relative_to=str(path.parent), finished=False)
    forged.write(run_before)
    outputs = [
        fastcoil(*command).output
        for command in (["status", run_before], ["verify", run_before], ["rerun", run_before, "--at", AT])
    ]
    assert "Nothing is finished yet" in outputs[0]
    assert "Traces:" in outputs[2]
    with refuses((str(run_before), "data")):
        fc.open_study(run_before)
    fastcoil("plot", run_before)
    assert not trace.exists()


LAW = """
import pathlib
from typing import NamedTuple
import fastcoil as fc
pathlib.Path({trace!r}).touch()
class Parameters(NamedTuple):
    kp: float
class Memory(NamedTuple):
    last: float = 0.0
@fc.law(Parameters=Parameters, Memory=Memory)
def rule(now, p, memory):
    return p.kp * now.e, memory
"""


def test_explain_says_whose_law_it_runs_and_runs_none_for_another_scenario(with_code, trace, tmp_path):
    path = with_code(
        PLAIN_STUDY.replace("[sweep]", '[cases.controller]\nown = { law = "mine:rule" }\npi = { law = "pi" }\n[sweep]'),
        LAW,
    )
    fc.run_study(path, tmp_path / "out", n_jobs=1).close()
    trace.unlink()
    at = ["--at", "backlash=0.02,estimate_ratio=0.9,day=1"]
    for target in (path, tmp_path / "out"):
        assert fastcoil("explain", target, *at, "--at", "controller=pi").stderr == ""
        assert not trace.exists()
        load_function.cache_clear()
        explained = fastcoil("explain", target, *at, "--at", "controller=own")
        assert explained.exit_code == 0, explained.output
        assert explained.stderr == f"This study runs its own code: rule from {tmp_path / 'mine.py'}.\n"
        trace.unlink()

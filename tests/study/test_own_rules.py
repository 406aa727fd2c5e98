"""Estimators and control laws of a study's own: found as text, part of its hash, run by workers alone."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from helpers.commands import fastcoil
from helpers.processes import child_environment
from helpers.refusals import refuses

import fastcoil as fc
from fastcoil.base.errors import InputError
from fastcoil.study.file.spec import read_study
from fastcoil.study.file.user_code import load_function
from fastcoil.study.run import execute

STUDY = """
[loop]
sample_time = 10
gain = 1e-3
[sweep]
noise_std = [0.0, 0.02]
[cases.controller]
plain = { estimator = "none" }
own = { estimator = "mine:by_error" }
fast = { estimator = "mine:by_error", gain = 2e-3, law = "mine:own_pi" }
[boundary]
kind = "constant_day"
hours = 0.6
T_set = 14
"""
SOURCE = """
from typing import NamedTuple
import pathlib
import fastcoil as fc
pathlib.Path({trace!r}).touch()

class Parameters(NamedTuple):
    sample_time: float
    kp: float
    gain: float = fc.parameter(3e-4, unit="K-1 s-1", lower=0.0, text="how fast it moves")

class Memory(NamedTuple):
    integral: float = -0.0

@fc.estimator(Parameters, Memory)
def by_error(now, p, memory):
    return limited(now.estimate + p.gain * abs(now.e) * p.sample_time, 0.2), memory

@fc.law(Parameters, Memory)
def own_pi(now, p, memory):
    integral = limited(memory.integral + p.gain * now.e * p.sample_time, 1.0)
    return p.kp * now.e + integral, Memory(integral)

def limited(x, largest):
    return min(max(x, 0.0), largest)
"""
AT = "controller=own,noise_std=0.02"


@pytest.fixture
def path(with_code):
    return with_code(STUDY, SOURCE)


def test_a_study_is_read_with_its_rules_and_runs_nothing(path, trace):
    loop = read_study(path).plan.layout.loop
    assert loop["estimator"].values.tolist() == ["none", "by_error", "by_error"]
    assert loop["gain"].values.tolist() == [1e-3, 1e-3, 2e-3]
    assert loop["law"].values.tolist() == ["pi", "pi", "own_pi"]
    assert loop.parameters["gain"].unit == "K-1 s-1"
    assert not trace.exists()


def test_the_source_of_its_rules_is_part_of_the_identity_of_a_study(path):
    before = read_study(path).sha256
    mine = path.parent / "mine.py"
    mine.write_text(mine.read_text() + "# changed\n")
    assert read_study(path).sha256 != before
    path.write_text(STUDY.replace("mine:by_error", "none").replace(', law = "mine:own_pi"', "").replace("gain", "kp"))
    plain = read_study(path).sha256
    mine.unlink()
    assert read_study(path).sha256 == plain


@pytest.mark.kernel
def test_a_study_gives_what_simulate_gives_on_every_backend(path, trace, tmp_path):
    ds = fc.run_study(path, tmp_path / "out", n_jobs=1)
    assert trace.exists()
    day = fc.constant_day(hours=0.6, T_set=14)
    scope = {}
    exec((tmp_path / "mine.py").read_text(), scope)
    for controller, parameters in {
        "plain": {},
        "own": {"estimator": scope["by_error"], "gain": 1e-3},
        "fast": {"estimator": scope["by_error"], "gain": 2e-3, "law": scope["own_pi"]},
    }.items():
        alone = fc.simulate(fc.Loop(sample_time=10, noise_std=[0.0, 0.02], **parameters), day)
        of_controller = ds.sel(controller=controller)
        np.testing.assert_array_equal(of_controller.rmse, alone.rmse)
        np.testing.assert_array_equal(of_controller.estimate_final, alone.estimate_final)
    assert ds["gain"].attrs["comment"] == "how fast it moves"
    assert json.loads(ds.attrs["rules"])["own_pi"]["code"] == "mine:own_pi"
    assert len(set(ds.rmse.values.ravel())) == 6
    loop = fc.Loop.from_dataset(ds, rules=[scope["by_error"], scope["own_pi"]])
    assert loop["gain"].values.tolist() == [1e-3, 1e-3, 2e-3]


@pytest.mark.kernel
def test_looking_at_a_folder_runs_none_of_it_and_rerun_says_so(path, trace, tmp_path):
    out = tmp_path / "out"
    execute(read_study(path, prepare=load_function), out, n_jobs=1).results.close()
    assert trace.exists()
    trace.unlink()
    load_function.cache_clear()
    for command in ("status", "verify"):
        assert fastcoil(command, out).exit_code == 0
    fc.open_study(out).close()
    assert not trace.exists()
    done = fastcoil("rerun", out, "--at", AT)
    assert done.exit_code == 0, done.output
    assert f"This study runs its own code: by_error from {tmp_path / 'mine.py'}." in done.stderr
    assert trace.exists()


@pytest.mark.kernel
def test_an_extension_keeps_what_its_rules_did_not_change(path, tmp_path):
    out = tmp_path / "out"
    before = fc.run_study(path, out, n_jobs=1).rmse.load()
    path.write_text(path.read_text().replace("[0.0, 0.02]", "[0.0, 0.02, 0.04]"))
    finished = execute(read_study(path, prepare=load_function), out, n_jobs=1, extend=True)
    assert finished.n_run == 3
    np.testing.assert_array_equal(finished.results.rmse.sel(noise_std=[0.0, 0.02]), before)
    finished.results.close()
    text = path.read_text()
    path.write_text(text.replace("gain = 1e-3", "gain = 5e-3"))
    with refuses(("--extend", "conflict")):
        execute(read_study(path, prepare=load_function), out, n_jobs=1, extend=True)
    path.write_text(text)
    mine = path.parent / "mine.py"
    mine.write_text(mine.read_text().replace("abs(now.e)", "0.5"))
    path.write_text(path.read_text().replace("0.04]", "0.04, 0.05]"))
    with refuses(("--extend", "conflict")):
        execute(read_study(path, prepare=load_function), out, n_jobs=1, extend=True)


@pytest.mark.kernel
def test_mistakes_are_found_before_anything_is_computed(path, tmp_path):
    mine = path.parent / "mine.py"
    good = mine.read_text()
    for change, sentence in (
        (("3e-4", "1e-4 * 3"), "the default of gain is not a number: write one, so that the study can be read without"),
        (("@fc.estimator(Parameters, Memory)", ""), r"put @fc.estimator\(Parameters, Memory\) before by_error"),
        (("def by_error", "def other"), "mine.py has no function by_error"),
        (("kp: float", "backlash: float"), "by_error reads backlash, which a rule must not know"),
        (("lower=0.0", "lower=1.0"), r"default = 0.0003: give a number \(at least 1\)"),
        (("def limited(x", "def limited(x:"), "mine.py is not Python: SyntaxError"),
        (("abs(now.e)", "abs(now.ee)"), r"by_error does not compile, line \d+ of .*mine.*: Unknown attribute 'ee'"),
        (("import pathlib", "import pathlib\nraise ValueError('unripe')"), "does not run: ValueError: unripe"),
        (("class Memory", "Parameters._field_defaults['gain'] = 1.0\nclass Memory"),
         "by_error is not the estimator that its source declares"),
    ):  # fmt: skip
        mine.write_text(good.replace(*change))
        assert mine.read_text() != good
        with pytest.raises(InputError, match=sentence):
            fc.run_study(path, tmp_path / "out", n_jobs=1)
    assert not os.path.exists(tmp_path / "out")
    mine.write_text(good)
    path.write_text(STUDY.replace("mine:by_error", "absent:rule"))
    with refuses(("estimator", "path")):
        read_study(path)


@pytest.mark.kernel
@pytest.mark.parametrize("backend", ["threads", pytest.param("loky", marks=pytest.mark.full)])
def test_a_rule_in_a_file_named_like_a_module_of_python_takes_the_place_of_none(tmp_path, backend):
    code = "if __name__ == 'csv': raise SystemExit(1)\ndef last(t): return t.max('elapsed_time').rename(T_sup='most')\n"
    (tmp_path / "csv.py").write_text(code)
    (tmp_path / "s.toml").write_text(
        '[loop]\n[boundary]\nhours = 0.6\n[run]\ntraces = ["T_sup"]\nreduce = "csv:last"\n'
    )
    words = [sys.executable, "-m", "fastcoil", "run", "s.toml", "--no-figures", "--backend", backend]
    subprocess.run(words, cwd=tmp_path, env=child_environment(), capture_output=True, check=True, timeout=120)

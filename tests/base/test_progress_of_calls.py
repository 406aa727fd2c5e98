"""``simulate``, ``run_study`` and ``tune`` tell how many scenario-days they have done."""

import ast
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.processes import environment

import fastcoil as fc
from fastcoil.base.progress import Shown

STUDY = """
[loop]
backlash = 0.05
[sweep]
kp = [0.01, 0.02]
[boundary]
hours = 0.05
seed = [1, 2, 3]
[run]
warm_up = 60
"""
SEARCH = {
    "search": {"kp": (0.005, 0.1)},
    "evaluations": 16,
    "warm_up": 60,
    "limits": {},
}


@pytest.fixture
def calls(tmp_path):
    """Three calls that run 6, 6 and some more scenario-days."""
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    days = fc.paper_day(hours=0.05, seed=range(1, 4))
    loop = fc.Loop(kp=[0.01, 0.02])
    valves = fc.Loop(backlash=("sample", [0.02, 0.04, 0.06, 0.08]))
    return {
        "simulate": lambda **how: fc.simulate(loop, days, warm_up=60, **how),
        "run_study": lambda **how: fc.run_study(path, tmp_path / "out", **how),
        "tune": lambda **how: fc.tune(valves, days, **SEARCH, **how),
    }


@pytest.mark.kernel
@pytest.mark.parametrize("name", ["simulate", "run_study", "tune"])
def test_every_scenario_day_is_told_once(calls, name, monkeypatch):
    started, told = [], []

    def start(shown, of, before=0):
        if shown.silent:  # a simulation of the package's own
            return lambda _: None
        started.append(of - before)
        return told.append

    monkeypatch.setattr(Shown, "start", start)
    calls[name](progress=True)
    assert started == [{"simulate": 6, "run_study": 6, "tune": 16 * 3 * 2}[name]]
    assert sum(told) == started[0]
    calls[name](progress=True)
    assert len(started) == (1 if name == "run_study" else 2), "a finished study has nothing to do"


@pytest.mark.kernel
def test_on_request_even_a_short_call_says_in_a_script_what_it_did(calls, capfd):
    calls["simulate"](progress=True)
    said = capfd.readouterr().err
    assert said.startswith("6 scenario-days in "), said
    assert said.count("\n") == 1


@pytest.mark.parametrize("name", ["simulate", "run_study", "tune"])
@pytest.mark.parametrize("given", [1, "yes", [True]])
def test_what_is_neither_yes_nor_no_is_refused(calls, name, given):
    with pytest.raises(fc.InputTypeError, match=r"progress = .*: give True(,| or) False"):
        calls[name](progress=given)


def test_the_package_itself_simulates_in_silence():
    found = []
    for path in Path(fc.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("simulate", "run_study", "tune"):
                found.append(path.name)
                assert any(word.arg == "progress" for word in node.keywords), path
    assert len(found) > 4


@pytest.mark.full
@pytest.mark.kernel
def test_ctrl_c_on_a_terminal_ends_the_bar_before_pythons_own_words(tmp_path):
    code = (
        "import numpy as np, fastcoil as fc\n"
        "loop = fc.Loop(kp=np.linspace(0.01, 0.05, 40_000))\n"
        "fc.simulate(loop, fc.paper_day(), n_jobs=1)\n"
    )
    env = {name: value for name, value in environment().items() if not name.startswith("PYTEST")}
    ours, theirs = pty.openpty()
    with subprocess.Popen([sys.executable, "-c", code], stderr=theirs, cwd=tmp_path, env=env) as running:
        os.close(theirs)
        said = b""
        while b"/40000" not in said:
            said += os.read(ours, 4096)
        running.send_signal(signal.SIGINT)
        while True:
            try:
                said += os.read(ours, 4096)
            except OSError:  # the other end is closed
                break
        assert running.wait(60) == -signal.SIGINT
    os.close(ours)
    bar, _, after = said.partition(b"Traceback")
    assert bar.endswith(b"\n\x1b[?25h"), bar[-200:]
    assert after.rstrip().endswith(b"KeyboardInterrupt")

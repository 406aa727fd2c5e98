"""``simulate``, ``run_study`` and ``tune`` tell how many scenario-days they have done."""

import ast
from pathlib import Path

import pytest

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
SEARCH = {"search": {"kp": (0.005, 0.1)}, "evaluations": 16, "warm_up": 60, "limits": {}}


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

    def start(shown, of, *_):
        if shown.silent:  # a simulation of the package's own
            return lambda _: None
        started.append(of)
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


def test_the_package_itself_simulates_in_silence():
    found = []
    for path in Path(fc.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("simulate", "run_study", "tune"):
                found.append(path.name)
                assert any(word.arg == "progress" for word in node.keywords), path
    assert len(found) > 4

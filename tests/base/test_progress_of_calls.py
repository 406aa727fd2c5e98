"""``simulate``, ``run_study`` and ``tune`` tell how many scenario-days they have done."""

import ast
from pathlib import Path

import pytest

import fastcoil as fc
from fastcoil.base.progress import ProgressDisplay

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
        "simulate": lambda **options: fc.simulate(loop, days, warm_up=60, **options),
        "run_study": lambda **options: fc.run_study(path, tmp_path / "out", **options),
        "tune": lambda **options: fc.tune(valves, days, **SEARCH, **options),
    }


@pytest.mark.kernel
@pytest.mark.parametrize("name", ["simulate", "run_study", pytest.param("tune", marks=pytest.mark.full)])
def test_every_scenario_day_is_told_once(calls, name, monkeypatch):
    started, advances = [], []

    def start(display, total, *_):
        if display.silent:  # a simulation of the package's own
            return lambda _: None
        started.append(total)
        return advances.append

    monkeypatch.setattr(ProgressDisplay, "start", start)
    calls[name](progress=True)
    assert started == [{"simulate": 6, "run_study": 6, "tune": 16 * 3 * 2}[name]]
    assert sum(advances) == started[0]
    calls[name](progress=True)
    assert len(started) == (1 if name == "run_study" else 2), "a finished study has nothing to do"


@pytest.mark.kernel
def test_on_request_even_a_short_call_says_in_a_script_what_it_did(calls, capfd):
    calls["simulate"](progress=True)
    output = capfd.readouterr().err
    assert output.startswith("6 scenario-days in "), output
    assert output.count("\n") == 1


def test_the_package_itself_simulates_in_silence():
    file_names = []
    for path in Path(fc.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("simulate", "run_study", "tune"):
                file_names.append(path.name)
                assert any(word.arg == "progress" for word in node.keywords), path
    assert len(file_names) > 4

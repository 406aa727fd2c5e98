"""``fc.export_controller`` and ``fastcoil export``: what is in the files, a start without a bump, what is refused."""

import math
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
from helpers.commands import fastcoil
from helpers.exported import load_module
from helpers.refusals import assert_refused
from helpers.sentences import assert_worded
from helpers.structured_text import Project
from helpers.studies import folder_contents

import fastcoil as fc

pytestmark = pytest.mark.kernel

LEARNER = {"learning_step": 0.01, "learning_interval": 600.0}


def export(folder, language="python", name="valve", **values):
    """Path of the exported code."""
    path = folder / (name + {"c": ".c", "st": ".st", "python": ".py"}[language])
    return fc.export_controller(fc.Loop(**values), path, language)[0]


def structured_text(path):
    """An exported block that is called like the Python, and whose state is its own."""
    block = Project(path.read_text()).block("FB_valve")

    def step(s, T_sup, T_set, enabled, reset, start_command):
        block(T_sup=T_sup, T_set=T_set, enabled=enabled, reset=reset, start_command=start_command)
        return block.command

    return SimpleNamespace(step=step, State=lambda: block)


@pytest.fixture(params=["python", "st"])
def make_controller(request, tmp_path):
    """Makes a controller that runs, of an exported Python file or function block."""

    def make(**values):
        path = export(tmp_path, request.param, **values)
        return load_module(path) if request.param == "python" else structured_text(path)

    return make


@pytest.mark.parametrize("compensation", ["inverse", "additive", "smooth"])
def test_it_takes_over_a_loop_without_a_bump(make_controller, compensation):
    x, kp, ti, sample_time = 0.06, 0.02, 60.0, 10.0
    values = {"backlash_estimate": x, "kp": kp, "ti": ti, "sample_time": sample_time, "compensation": compensation}
    controller = make_controller(**values)
    for e in (0.0, -0.5, 3.0):
        command = controller.step(controller.State(), 14.0 + e, 14.0, True, True, 0.4)
        one_sample = kp * sample_time / ti * e  # what the integral adds in the first cycle, as in every one
        if compensation == "inverse":
            expected = 0.4 + (1.0 - x) * one_sample + (x if e > 0.0 else 0.0)  # up: it crosses the gap
        elif compensation == "additive":
            expected = 0.4 + one_sample + (x if e > 0.0 else 0.0)
        else:
            rate = one_sample / sample_time
            expected = 0.4 + (1.0 - x) * one_sample + x * 0.5 * math.tanh(2.0 / 1e-4 * rate)
        assert command == pytest.approx(expected, abs=1e-12)


def test_in_hand_it_follows_and_then_goes_on_from_there(make_controller):
    controller = make_controller(backlash_estimate=0.05, kp=0.02, ti=60.0, sample_time=10.0)
    s = controller.State()
    for hand in (0.2, 0.35, 0.6):
        assert controller.step(s, 13.0, 14.0, True, True, hand) == pytest.approx(hand - 0.95 * 0.02 / 6.0, abs=1e-12)
    assert controller.step(s, 13.0, 14.0, True, False, 0.0) == pytest.approx(0.6 - 2.0 * 0.95 * 0.02 / 6.0, abs=1e-12)


def test_bad_readings_change_nothing_but_the_clock(make_controller):
    controller = make_controller(backlash_estimate=0.05)
    s = controller.State()
    first = controller.step(s, 16.0, 14.0, True, True, 0.0)
    before = (s.u, s.integral_part, s.rising, s.switches)
    for bad in (math.nan, math.inf, -math.inf, 150.0, -50.0):
        assert controller.step(s, bad, 14.0, True, False, 0.0) == first
        assert controller.step(s, 14.0, bad, True, False, 0.0) == first
    assert (s.u, s.integral_part, s.rising, s.switches) == before
    assert s.clock == 11 * 30.0
    assert 0.0 < controller.step(s, 15.0, 14.0, True, True, math.nan) < 1.0


def test_what_a_controller_does_not_need_is_left_out(tmp_path):
    inverse_only = export(tmp_path, "c", backlash_estimate=0.05).read_text().split("#ifdef")[0]
    assert not re.search(r"learning|LEARN|ESTIMATE_SHARE|noise|DEAD_BAND|m_a\b|\bexp\b", inverse_only)
    learner = export(tmp_path, "c", **LEARNER).read_text()
    assert "LEARNING_STEP 0.01" in learner
    assert not re.search("ERROR_RATIO|squares|settled|stop", learner.split("#ifdef")[0])
    for text in (inverse_only, learner):
        assert not re.search(r"malloc|calloc|alloca|goto", text)


@pytest.mark.parametrize(
    ("values", "path", "language", "field", "code"),
    [
        ({"kp": [0.01, 0.02]}, "valve.c", "c", "kp", "shape"),
        ({**LEARNER, "sample_time": 7.0}, "valve.c", "c", "learning_interval", "conflict"),
        ({}, "valve.c", "fortran", "language", "choice"),
        ({}, "valve.py", "c", "path", "path"),
        ({}, "a\nT_sup,T_set\n1.c", "c", "path", "path"),
        ({}, "a\x1b[2J.py", "python", "path", "path"),
    ],
)
def test_what_cannot_be_exported_is_refused_and_nothing_is_written(tmp_path, values, path, language, field, code):
    assert_refused(field, code, fc.export_controller, fc.Loop(**values), tmp_path / path, language)
    assert not list(tmp_path.iterdir())


def test_the_command_writes_the_files_of_a_study_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "controller.toml").write_text('[loop]\npreset = "lbnl"\nbacklash_estimate = 0.05\nbuffer = 0.005\n')
    result = fastcoil("export", "controller.toml")
    assert result.exit_code == 0, result.output
    assert result.output.splitlines()[-2:] == ["Written: controller.c", "Written: controller_vectors.csv"]
    same_loop = fc.Loop.preset("lbnl").assign(backlash_estimate=0.05, buffer=0.005)
    (tmp_path / "python").mkdir()
    exported_file, _ = fc.export_controller(same_loop, tmp_path / "python" / "controller.c")
    assert (tmp_path / "controller.c").read_text() == exported_file.read_text()
    result = fastcoil("export", "controller.toml", "--language", "st", "-o", "AHU2.st")
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in tmp_path.glob("AHU2*")) == ["AHU2.st", "AHU2_check.st", "AHU2_vectors.csv"]


@pytest.mark.parametrize(("name", "language"), [("mine.py", "python"), ("mine_check.st", "st")])
def test_a_file_that_fastcoil_did_not_write_is_never_replaced(tmp_path, name, language):
    """As the rule in mine.py would be by the controller of mine.toml; earlier exports are replaced."""
    path = tmp_path / f"mine.{'py' if language == 'python' else language}"
    assert fc.export_controller(fc.Loop(kp=0.02), path, language) == fc.export_controller(fc.Loop(), path, language)
    (tmp_path / name).write_text("# a day's work\n")
    before = folder_contents(tmp_path)
    assert_refused("path", "path", fc.export_controller, fc.Loop(kp=0.03), path, language)
    assert folder_contents(tmp_path) == before


def test_the_check_in_python_says_what_it_cannot_read(tmp_path):
    code = export(tmp_path, "python", backlash_estimate=0.05)
    (tmp_path / "binary.csv").write_bytes(b"\xff\n")
    for name in ("missing.csv", "binary.csv"):
        command = [sys.executable, code, tmp_path / name]
        process = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert process.returncode == 1
        assert_worded(process.stderr)

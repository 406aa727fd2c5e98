"""An exported controller runs the valve test as the kernel does: its command during it, after it, and why it ended."""

import ctypes
import math
import subprocess
from itertools import product

import numpy as np
import pytest
from helpers import exported, rules
from helpers.commands import assert_command_refused, fastcoil
from helpers.full import full_except
from helpers.sentences import assert_worded
from test_same_controller import break_law

import fastcoil as fc
from fastcoil.deliver.export.export import SUFFIXES

pytestmark = pytest.mark.kernel

START, HOURS = 2400, 2
SHORT = {"minutes": 15.0, "settle": 90.0, "hold": 60.0, "excursion": 3.0}
LOOPS = {
    "inverse": {"backlash_estimate": 0.07, "buffer": 0.01, "sensor_resolution": 0.05},
    "additive": {"compensation": "additive", "backlash_estimate": 0.07, "error_dead_band": 0.1},
    "smooth": {"compensation": "smooth", "backlash_estimate": 0.07},
    "learner": {"learning_step": 0.01, "learning_interval": 600.0, "estimate_share": 0.8},
    "heating": {"preset": "heating", "backlash_estimate": 0.04, "sample_time": 7.0, "kp": 0.01},
}
MORE_LOOPS = {
    "pi": {},
    "measured": {
        "backlash_estimate": 0.07, "buffer_ratio": 3.0, "buffer_noise": "measured", "buffer_swing": 0.5,
        "plant_gain": 15.0,
    },
    "hagglund": {"estimator": "hagglund", "plant_gain": 15.0},
    "gradient": {"estimator": "gradient", "compensation": "additive"},
    "identify": {"estimator": "identify", "sample_time": 15.0},
    "warming": {"preset": "heating", "learning_step": 0.01, "compensation": "smooth"},
}  # fmt: skip


def loop_of(name):
    values = {"preset": "lbnl", "sample_time": 5.0, "noise_std": 0.02, "backlash": 0.05} | (LOOPS | MORE_LOOPS)[name]
    return fc.Loop.preset(values.pop("preset")).assign(**values)


def export(folder, name, language, **values):
    path = folder / f"valve{SUFFIXES[language]}"
    return fc.export_controller(loop_of(name), path, language, test=fc.ValveTest(**SHORT | values))


def simulate_test_day(name, off_seconds, **values):
    """The loop with a test, simulated: a row for each sample, what the controller sees and what it answers."""
    loop = loop_of(name)
    day = (fc.heating_day if name in ("heating", "warming") else fc.paper_day)(hours=HOURS, seed=5)
    enabled = np.ones(3600 * HOURS)
    enabled[off_seconds] = 0.0
    dt = int(loop["sample_time"])
    T_set = day.series["T_set"][0]
    day = day.assign(enabled=enabled, T_set=T_set[0] + 0.3 * (T_set - T_set[0]))
    options = {"traces": ["T_measured", "command", "test"], "trace_interval": dt, "warm_up": 0}
    ds = fc.simulate(loop, day, test=fc.ValveTest(start=START, **SHORT | values), **options)
    inputs = {n: np.ravel(day.series[n])[::dt] for n in ("T_set", "m_a")} | {"T_sup": ds["T_measured"].values}
    return inputs | {"enabled": enabled[::dt] > 0.0, "start_test": np.arange(0, enabled.size, dt) >= START}, ds


def answers_of_python(code, rows):
    """Commands of the exported Python; it sees only the inputs that it has."""
    laws = exported.load_module(code)
    s = laws.State()
    return np.array([(laws.step(s, **row, reset=False, start_command=0.0), s.test, s.test_aborted) for row in rows])


def answers_of_c(code, rows):
    """Commands of the exported C, as a shared library."""
    library = code.with_suffix(".so")
    subprocess.run(["gcc", *exported.COMPILER_FLAGS, "-shared", "-fPIC", code, "-lm", "-o", library], check=True)
    step, state = ctypes.CDLL(str(library)).valve_step, ctypes.create_string_buffer(2**16)
    step.restype = ctypes.c_double
    kinds = {"enabled": ctypes.c_bool, "start_test": ctypes.c_bool}
    step.argtypes = [ctypes.c_void_p, *(kinds.get(n, ctypes.c_double) for n in rows[0]), ctypes.c_bool, ctypes.c_double]
    return np.array([[step(state, *row.values(), False, 0.0)] for row in rows])


CASES = {"to its end": (0.0, slice(0), {}), "excursion": (1.0, slice(0), {"excursion": 0.35})}
CASES["disabled"] = (4.0, slice(START + 100, START + 600), {})
PYTHON = [("python", name) for name in LOOPS]
KERNEL_CASES = [(*each, "to its end") for each in PYTHON]
KERNEL_CASES += [("python", "additive", "excursion"), ("c", "learner", "disabled")]


@pytest.mark.parametrize(
    ("language", "name", "case"), full_except(list(product(("python", "c"), LOOPS | MORE_LOOPS, CASES)), KERNEL_CASES)
)
def test_fed_with_the_kernels_temperatures_it_gives_the_kernels_commands(tmp_path, name, case, language):
    exported.skip_without_compiler(language)
    aborted, off_seconds, values = CASES[case]
    record, ds = simulate_test_day(name, off_seconds, **values)
    code, stored = export(tmp_path, name, language, **values)
    inputs = [n for n in exported.read_vectors(stored)[0] if n in record]
    rows = [dict(zip(inputs, row, strict=True)) for row in zip(*(record[n].tolist() for n in inputs), strict=True)]
    answers = (answers_of_python if language == "python" else answers_of_c)(code, rows)
    np.testing.assert_allclose(answers[:, 0], ds["command"].values, rtol=0.0, atol=1e-12)
    assert float(ds["test_aborted"]) == aborted
    assert ds["test"].values.sum() > 5.0
    assert not ds["test"].values[-20:].any()
    if language == "python":
        assert answers[:, 1].tolist() == ds["test"].values.tolist()
        assert answers[-1, 2] == aborted


@pytest.mark.parametrize(
    ("language", "name"),
    full_except(
        list(product(exported.WORST_DIFFERENCE, LOOPS | MORE_LOOPS)), [*PYTHON, ("c", "learner"), ("st", "smooth")]
    ),
)
def test_every_language_passes_vectors_that_hold_a_test_of_every_end(tmp_path, language, name):
    exported.skip_without_compiler(language)
    files = export(tmp_path, name, language)
    assert exported.WORST_DIFFERENCE[language](*files) <= 1e-12
    rows = exported.read_vectors(files[1])
    ended = {b["test_aborted"] for a, b in zip(rows, rows[1:], strict=False) if a["test"] > b["test"]}
    assert ended == {0.0, 1.0, 2.0, 3.0, 4.0}
    assert files[0].read_text().isascii()


BREAKS = [
    ("s.test_asked = start_test", "s.test_asked = False"), ("start_test and not s.test_asked", "start_test"),
    ("s.test_asked = True", "s.test_asked = False"), ("target_overshoot / …", "target_overshoot + 0.0 * …"),
    ("> LARGEST_CALM…", "> 0.0 * LARGEST_CALM…"),
    ("= FIRST_RAMP…", "= 1.0 + 0.0 * FIRST_RAMP…"), ("u_2 - KP * e_3", "u_2"), (" and s.test == 0.0", ""),
    (">= TEST_HOLD", "> TEST_HOLD"), ("s.u_ext = u_2", "s.u_ext = s.u_ext"),
    ("= ABORTED_DISABLED", "= 0.0 * ABORTED_DISABLED"),
    ("x_hat = ESTIMATE_SHARE * s.estimate", "x_hat = s.estimate"), ("s.rising = mode_2 > 0.0", "s.rising = s.rising"),
    ("> LONGEST_WAIT_S", "> 2.0 * LONGEST_WAIT_S"), ("= CHANGED_AIR_LIMIT_RATIO", "= 0.0 * CHANGED_AIR_LIMIT_RATIO"),
    ("-SAMPLE_TIME", "0.0"), ("mean = s.test_mean + weight", "mean = s.test_mean + 0.9 * weight"),
]  # fmt: skip


def test_a_broken_test_is_found_by_the_vectors(tmp_path):
    code, stored = export(tmp_path, "learner", "python")
    text = code.read_text()
    for law, broken_law in BREAKS:
        assert exported.has_differences(exported.python_runner(break_law(text, law, broken_law)), stored), law


def test_it_begins_at_an_edge_alone_and_bad_readings_hold_it(tmp_path):
    laws = exported.load_module(export(tmp_path, "inverse", "python")[0])
    s = laws.State()
    run = [laws.step(s, 14.0, 14.0, 1.2, True, True, False, 0.5) for _ in range(3)]
    assert s.test == 0.0  # on from the start is no edge
    for start_test in (False, True):
        run.append(laws.step(s, 14.0, 14.0, 1.2, True, start_test, False, 0.0))
    elapsed = s.test_elapsed
    assert laws.step(s, math.nan, 14.0, 1.2, True, True, False, 0.0) == run[-1]
    assert (s.test, s.test_elapsed) == (1.0, elapsed)


def test_a_law_of_your_own_and_a_motor_slower_than_the_ramps_are_refused(tmp_path):
    @fc.law(rules.Parameters, rules.Memory)
    def law(now, p, memory):
        return 0.5, memory

    for loop in (fc.Loop(law=law), fc.Loop(stroke_time=400)):
        with pytest.raises(fc.InputError) as caught:
            fc.export_controller(loop, tmp_path / "valve.c", test=fc.ValveTest())
        assert_worded(*caught.value.problems)
    assert not list(tmp_path.iterdir())


def test_the_command_has_it_by_an_option_or_by_the_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bare.toml").write_text('[loop]\npreset = "lbnl"\n')
    (tmp_path / "full.toml").write_text('[loop]\npreset = "lbnl"\ntest_start = 0\ntest_hold = 150\n')
    for name, options in (("bare", ["--test"]), ("full", []), ("full", ["--test"])):
        result = fastcoil("export", f"{name}.toml", "-o", "valve.c", *options)
        assert result.exit_code == 0, result.output
        assert f"TEST_HOLD {150 if name == 'full' else 120}.0" in (tmp_path / "valve.c").read_text()
    assert_command_refused("export", ".", "--test")

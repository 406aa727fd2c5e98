"""The open loop as it is sampled: beside python-control, and beside the emulator where it begins to swing."""

from itertools import cycle

import numpy as np
import pytest
from helpers.linear_loops import LINEAR_LOOPS, plants_at, rest_plants, rest_points, state_space

import fastcoil as fc
from fastcoil.design.linearise import first_order, margins_of, simc
from fastcoil.design.plants import linearise_plants, loop_response

pytestmark = pytest.mark.kernel

SAMPLED = {
    "30 s": {"sample_time": 30, "ti": 40.0, "kp": 0.02},
    "5 s, sensor": {"sample_time": 5, "sensor_time_constant": 25.0, "ti": 60.0, "kp": 0.05},
    "1 s": {"sample_time": 1, "ti": 25.0, "kp": 0.06},
}
EACH = list(zip(LINEAR_LOOPS, cycle(SAMPLED)))
"""Every kind of loop, and every way of sampling."""


def sampled_loop(control, columns, conditions):
    """L of python-control, from A and B alone: sensor, sample and hold, PI with the new error added before use."""
    of_plant, from_opening, seen = state_space(columns, conditions)
    n, ts = from_opening.size, int(columns["sample_time"][0])
    tau = columns["sensor_time_constant"][0]
    decay = np.exp(-1.0 / tau) if tau > 0.0 else 0.0
    seen = np.append((1.0 - decay) * seen, decay)
    A = np.zeros((n + 1, n + 1))
    A[:n, :n], A[n] = of_plant, seen
    B = np.append(from_opening, 0.0)
    held = sum(np.linalg.matrix_power(A, k) @ B for k in range(ts))
    plant = control.ss(np.linalg.matrix_power(A, ts), held[:, None], seen[None, :], 0.0, float(ts))
    kp, ti = columns["kp"][0], columns["ti"][0]
    pi = control.ss(1.0, 1.0, kp * ts / ti, kp * (1.0 + ts / ti), float(ts))
    sign = 1.0 if columns["action"][0] == "heating" else -1.0
    return control.series(plant, pi) * (sign / (1.0 - columns["backlash"][0]))


@pytest.mark.parametrize(("name", "sampling"), EACH)
def test_open_loop_and_margins_are_those_of_python_control(name, sampling):
    control = pytest.importorskip("control")
    columns, conditions = rest_points(name, backlash=0.05, **SAMPLED[sampling])
    theirs, plant = sampled_loop(control, columns, conditions), linearise_plants(columns, conditions)
    w = np.geomspace(1e-4, np.pi / SAMPLED[sampling]["sample_time"], 50)
    expected = theirs.frequency_response(w).complex.ravel()
    np.testing.assert_allclose(loop_response(columns, plant, w)[0], expected, rtol=2e-3, atol=1e-5)
    margins = margins_of(columns, plant)
    w = np.geomspace(1e-5, np.pi / SAMPLED[sampling]["sample_time"], 400)[:-1]
    gain, phase, _, _ = control.margin(control.frd(theirs, w))
    # where the sampled loop ends on the negative real axis, python-control looks no further
    end = -theirs(-1.0 + 0.0j).real
    gain = min(gain, 1.0 / end) if end > 0.0 else gain
    assert margins.gain_margin[0] == pytest.approx(gain, rel=5e-3)
    assert margins.phase_margin[0] == pytest.approx(phase, abs=0.3)


def test_the_gap_opens_the_valve_faster_behind_it():
    w = np.array([0.001, 0.03])
    plain = loop_response(*rest_plants("wet, lagged"), w)
    np.testing.assert_allclose(loop_response(*rest_plants("wet, lagged", backlash=0.2), w), plain / 0.8, rtol=1e-12)


def test_a_loop_that_acts_the_wrong_way_has_neither_margins_nor_tunings():
    columns, plant = rest_plants("heating", action="cooling")
    margins = margins_of(columns, plant)
    for value in (*margins, *simc(columns, plant, first_order(columns, plant))):
        assert np.isnan(value[0])


@pytest.mark.parametrize(("name", "sampling"), EACH)
def test_the_emulator_answers_a_small_step_of_the_set_point_as_the_closed_loop(name, sampling):
    """Every delay of one step counts: sensor, sample, actuator and march in their order."""
    control = pytest.importorskip("control")
    step, before, after = 0.005, 6000, 900
    columns, conditions = rest_points(name, stroke_time=0.0, **SAMPLED[sampling])
    margin = margins_of(columns, linearise_plants(columns, conditions)).gain_margin
    # a coil whose air does not lag bears gains that would open the valve widely
    columns["kp"] = min(0.3 * margin, 20.0) * columns["kp"]
    theirs = sampled_loop(control, columns, conditions)
    ts = SAMPLED[sampling]["sample_time"]
    expected = control.step_response(control.feedback(theirs), np.arange(0.0, after, ts)).outputs
    loop, entering = LINEAR_LOOPS[name]
    T_set = np.full(before + after, entering.get("T_set", 14.0))
    T_set[before:] += step
    day = fc.constant_day((before + after) / 3600, **entering | {"T_set": T_set})
    tuned = loop.assign(backlash=0.0, stroke_time=0.0, **SAMPLED[sampling] | {"kp": float(columns["kp"][0])})
    ds = fc.simulate(tuned, day, traces=["T_measured"], trace_interval=ts, warm_up=0, n_jobs=1)
    answer = (ds.T_measured.values[before // ts :] - T_set[0]) / step
    assert abs(answer[0]) < 1e-3
    assert np.ptp(answer) > 0.5
    np.testing.assert_allclose(answer, expected, atol=0.01)


ULTIMATE = {
    "paper_like": {},
    "lbnl": {"stroke_time": 0.0, "ti": 10.0, "sample_time": 5},
    "g36": {"stroke_time": 0.0},
    "paper_like, quasistatic": {
        "sample_time": 10, "ti": 60.0, "air_march": "quasistatic", "sensor_time_constant": 20.0,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", ULTIMATE)
def test_the_emulator_begins_to_swing_at_the_gain_that_the_margin_says(name):
    """1 % below it a swing dies away; 1 % above it one stays."""
    loop = fc.Loop.preset(name.split(",")[0]).assign(backlash=0.0, **ULTIMATE[name])
    columns, at_rest = plants_at(loop, fc.constant_day(0.6))
    ultimate = columns["kp"][0] * margins_of(columns, at_rest).gain_margin[0]
    swept = loop.assign(kp=("share", ultimate * np.array([0.99, 1.01])))
    T = fc.simulate(swept, fc.constant_day(8.0), traces=["T_sup"], n_jobs=1).T_sup
    swings = [T.isel(elapsed_time=slice(h * 3600, (h + 1) * 3600)) for h in (5, 7)]
    early, late = (np.ptp(part.values, axis=1) for part in swings)
    assert late[0] < max(0.7 * early[0], 1e-6)
    assert late[1] > 0.1
    assert late[1] > 0.85 * early[1]

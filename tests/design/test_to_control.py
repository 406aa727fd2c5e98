"""``fc.to_control``: systems of python-control that have the numbers of ``linearise``."""

import sys

import numpy as np
import pytest
from helpers.linear_loops import LINEAR_LOOPS
from helpers.refusals import assert_refused

import fastcoil as fc

pytestmark = pytest.mark.kernel
control = pytest.importorskip("control", reason="python-control is an extra")

SAMPLED = {
    "wet, lagged": {"sample_time": 30, "ti": 40.0, "kp": 0.02},
    "mixed, quasistatic": {"sample_time": 5, "sensor_time_constant": 25.0, "ti": 60.0, "kp": 0.05},
    "heating": {"sample_time": 15, "ti": 60.0, "kp": 0.02, "sensor_time_constant": 10.0},
}


def linearise_kind(name, **changes):
    """A loop, and what ``linearise`` makes of it."""
    loop, entering = LINEAR_LOOPS[name]
    loop = loop.assign(**{"backlash": 0.05} | SAMPLED[name] | changes)
    w = np.geomspace(1e-5, np.pi / SAMPLED[name]["sample_time"], 400)[:-1]
    return loop, fc.linearise(loop, fc.constant_day(0.6, **entering), at=0, state_space=True, frequency=w)


@pytest.mark.parametrize("name", SAMPLED)
def test_responses_and_margins_are_those_of_linearise(name):
    loop, ds = linearise_kind(name)
    plant, L, w = fc.to_control(ds), fc.to_control(ds, loop), ds.frequency.values
    for system, part in ((plant, "plant"), (L, "loop")):
        expected = (ds[f"{part}_magnitude"] * np.exp(1j * np.radians(ds[f"{part}_phase"]))).values
        np.testing.assert_allclose(system.frequency_response(w).complex.ravel(), expected, rtol=2e-3, atol=1e-5)
    assert plant.dcgain() == pytest.approx(float(ds.gain), rel=1e-3)
    gain, phase, _, _ = control.margin(control.frd(L, w))
    end = -L(-1.0 + 0.0j).real  # python-control looks no further than before it
    gain = min(gain, 1.0 / end) if end > 0.0 else gain
    assert gain == pytest.approx(float(ds.gain_margin), rel=5e-3)
    assert phase == pytest.approx(float(ds.phase_margin), abs=0.3)


def test_states_in_another_order_are_the_same_plant_and_missing_ones_are_refused():
    _, ds = linearise_kind("mixed, quasistatic")
    w = ds.frequency.values
    expected = fc.to_control(ds).frequency_response(w).complex
    backwards = fc.to_control(ds.isel(state=slice(None, None, -1)))
    np.testing.assert_allclose(backwards.frequency_response(w).complex, expected, rtol=1e-9)
    for states in ([0, 0, 1], [], slice(1, None)):
        assert_refused("linearised", "shape", fc.to_control, ds.isel(state=states))


def test_they_have_sample_times_and_names():
    loop, ds = linearise_kind("heating")
    plant, L = fc.to_control(ds), fc.to_control(ds, loop)
    assert (plant.dt, plant.input_labels, plant.output_labels) == (1.0, ["opening"], ["T_sup"])
    assert plant.state_labels == ds.state.values.tolist()
    assert (L.dt, L.input_labels, L.output_labels) == (15.0, ["T_set"], ["T_measured"])


def test_a_point_of_a_sweep_has_its_own_parameters():
    loop, day = fc.Loop(kp=[0.01, 0.02]), fc.constant_day(0.6)
    ds = fc.linearise(loop, day, at=[0, 100], state_space=True)
    low, high = (fc.to_control(ds.isel(kp=k, elapsed_time=0), loop) for k in (0, 1))
    w = np.array([0.001, 0.01])
    np.testing.assert_allclose(high(np.exp(30j * w)), 2.0 * low(np.exp(30j * w)), rtol=1e-12)
    assert_refused("linearised", "shape", fc.to_control, ds, loop)
    assert_refused("linearised", "missing", fc.to_control, ds.isel(kp=0, elapsed_time=0, drop=True), loop)
    assert_refused("linearised", "missing", fc.to_control, fc.linearise(fc.Loop(), day))


def test_without_python_control_a_sentence_names_the_extra(monkeypatch):
    _, ds = linearise_kind("heating")
    monkeypatch.setitem(sys.modules, "control", None)
    assert_refused("control", "package", fc.to_control, ds)

"""``fc.linearise``: dims, labels, where on the day, what is refused."""

import numpy as np
import pytest
from helpers.advice_checks import integrate
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.design.operating_points import OperatingPoints
from fastcoil.design.plants import frequency_response, linearise_plants

pytestmark = pytest.mark.kernel

DAYS = fc.paper_day(hours=1.0, seed=[3, 8])
SWEEP = fc.Loop(kp=[0.01, 0.05], backlash=("valve", [0.0, 0.07, 0.1]), m_max=("valve", [1.5, 1.8, 2.0]))


@pytest.fixture(scope="module")
def linearised():
    return fc.linearise(SWEEP, DAYS, at=[100, 3000], frequency=[0.001, 0.02, 0.2])


def test_the_dims_are_those_of_the_loop_then_day_then_time(linearised):
    assert linearised.opening.dims == ("kp", "valve", "day", "elapsed_time")
    assert linearised.opening.shape == (2, 3, 2, 2)
    assert linearised.loop_phase.dims == (*linearised.opening.dims, "frequency")
    np.testing.assert_array_equal(linearised.day, [3, 8])
    np.testing.assert_array_equal(linearised.elapsed_time, [100, 3000])
    np.testing.assert_allclose(linearised.m_max, [1.5, 1.8, 2.0])


def test_each_point_is_what_it_is_alone(linearised):
    day, loop = fc.Boundary.from_dataset(DAYS.to_dataset().isel(day=[1])), fc.Loop(kp=0.05, backlash=0.07, m_max=1.8)
    alone = fc.linearise(loop, day, at=3000, frequency=[0.001, 0.02, 0.2])
    there = linearised.sel(kp=0.05).isel(valve=1, day=1, elapsed_time=1)
    for name in alone:
        np.testing.assert_allclose(there[name], alone[name].isel(day=0), rtol=1e-6, err_msg=name)


def test_what_enters_is_what_the_boundary_says_at_that_second(linearised):
    T_sup = linearised.T_sup.transpose("day", "elapsed_time", ...).values[..., 0, 0]
    np.testing.assert_allclose(T_sup, DAYS.series["T_set"][:, [100, 3000]], atol=1e-8)


def test_without_at_the_means_of_the_enabled_seconds_after_the_warm_up_count():
    T_set = np.concatenate([np.full(1800, 10.0), np.full(600, 14.0), np.full(600, 15.0), np.full(600, 11.0)])
    enabled = np.where(np.arange(3600) < 3000, 1.0, 0.0)
    m_a = np.linspace(1.0, 1.2, 3600)
    day = fc.Boundary(m_a=m_a, T_a_in=25.0, W_a_in=0.01, T_w_in=7.0, T_set=T_set, enabled=enabled)
    same = fc.constant_day(0.1, T_set=14.5, W_a_in=0.01, m_a=float(m_a[1800:3000].mean()))
    mean, alone = fc.linearise(fc.Loop(), day), fc.linearise(fc.Loop(), same, at=0)
    assert float(mean.T_sup) == pytest.approx(14.5, abs=1e-8)
    assert mean.sizes == {}
    for name in mean:
        np.testing.assert_allclose(mean[name], alone[name], rtol=1e-6, err_msg=name)


def test_phase_and_magnitude_are_those_of_the_response():
    """Far apart on the axis, the phase still has no jumps: from 180° of a cooling coil on downwards."""
    w = np.array([1e-5, 2.0])
    ds = fc.linearise(SWEEP, DAYS, at=5, frequency=w)
    points = OperatingPoints(SWEEP, DAYS, 5)
    index = np.arange(points.size)
    plants = linearise_plants(points.columns(index), points.conditions(index))
    G = frequency_response(plants.response, w)
    polar = ds.plant_magnitude * np.exp(1j * np.radians(ds.plant_phase))
    np.testing.assert_allclose(polar.values.reshape(G.shape), G, rtol=1e-9)
    assert (ds.plant_phase.isel(frequency=0) > 170.0).all()
    dense = frequency_response(plants.response, np.linspace(1e-5, 2.0, 4000))
    turned = np.degrees(np.unwrap(np.angle(dense), axis=1)[:, -1])
    np.testing.assert_allclose(ds.plant_phase.values[..., 1].ravel(), turned, atol=1e-6)
    assert turned.max() < -30.0
    assert ds.loop_phase.isel(frequency=1).isnull().all()


@pytest.mark.parametrize(
    ("changes", "field", "code"),
    [
        ({"loop": 3}, "loop", "type"),
        ({"boundary": None}, "boundary", "type"),
        ({"at": -1}, "at", "value"),
        ({"at": 1.5}, "at", "value"),
        ({"at": []}, "at", "type"),
        ({"frequency": [0.1, 0.01]}, "frequency", "value"),
        ({"frequency": [[0.1]]}, "frequency", "type"),
        ({"frequency": [0.1], "loop": fc.Loop(law=integrate, ki=0.01)}, "law", "unsupported"),
        ({"boundary": fc.constant_day(0.5), "at": None}, "boundary", "data"),
        ({"loop": fc.Loop(kp=("gain", [0.1, 0.2]))}, "gain", "conflict"),
    ],
)
def test_a_wrong_call_gets_one_sentence(changes, field, code):
    assert_refused(field, code, fc.linearise, **{"loop": fc.Loop(), "boundary": DAYS, "at": 0} | changes)


def test_an_unstable_coil_is_refused():
    with pytest.raises(fc.InputError, match="unstable at dt = 1 s"):
        fc.linearise(fc.Loop(C_w=1.0), DAYS, at=0)

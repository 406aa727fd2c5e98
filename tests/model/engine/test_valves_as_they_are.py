"""Neutral zone, stick-slip and leakage in the loop; their formulas are tested in ``tests/model/physics``."""

import numpy as np
import pytest
import reference

import fastcoil as fc
from fastcoil.model.engine.valve import ActuatorFeatures
from fastcoil.model.parameter_table import PARAMETERS

GENTLE_PI = {"kp": 0.018, "ti": 30.0, "sample_time": 15}
VALVE_CURVE = (2.0, 0.7, 9.0, 0.38)


def count_motor_starts(positions):
    """Number of starts of a motor."""
    is_moving = np.diff(positions, prepend=0.0, axis=-1) != 0.0
    return np.count_nonzero(is_moving[..., 1:] & ~is_moving[..., :-1], axis=-1)


def simulate_openings(openings, **parameters):
    """Simulate flows and temperatures of a dry coil at given openings."""
    day = fc.constant_day(hours=openings.size / 3600, T_a_in=26.0, W_a_in=0.004)
    names = ["m_w", "T_w", "T_c", "T_a", "power", "opening"]
    return fc.simulate(fc.Loop(backlash=0.0, **parameters), day, command=openings, traces=names, warm_up=60)


@pytest.mark.parametrize(
    ("parameters", "features"),
    [
        ({}, []),
        ({"command_resolution": 0.01}, ["has_resolution"]),
        ({"neutral_zone": 0.01}, ["has_neutral_zone"]),
        ({"slip_jump": 0.01, "neutral_zone": 0.01}, ["has_neutral_zone", "has_stick_slip"]),
        ({"wear_rate": 0.001}, ["has_wear"]),
    ],
)
def test_a_block_compiles_the_parts_that_a_lane_of_it_needs(parameters, features):
    options = [p for p in PARAMETERS.values() if p.group == "actuator"]
    lanes = {p.name: np.array([p.default, parameters.get(p.name, p.default), p.default]) for p in options}
    assert ActuatorFeatures.of_lanes(lanes) == ActuatorFeatures(**dict.fromkeys(features, True))


@pytest.mark.kernel
def test_a_neutral_zone_starts_the_motor_less_often(one_hour_day):
    loop = fc.Loop(**GENTLE_PI, noise_std=0.05, stroke_time=90.0, neutral_zone=[0.0, 0.005, 0.02])
    ds = fc.simulate(loop, one_hour_day, traces=["position"], warm_up=600)
    counted = count_motor_starts(ds.position.values)
    assert counted[0] > 1.5 * counted[1] > 2.0 * counted[2] > 0


@pytest.mark.kernel
def test_without_a_zone_or_a_jump_the_loop_is_that_of_before_beside_those_that_have_one(one_hour_day):
    names = ["position", "opening", "m_w", "T_sup"]
    loop = fc.Loop(**GENTLE_PI, noise_std=0.02, stroke_time=[0.0, 90.0])
    plain = fc.simulate(loop, one_hour_day, traces=names, warm_up=600)
    loop = loop.assign(neutral_zone=[0.0, 0.01], slip_jump=[0.0, 0.03])
    mixed = fc.simulate(loop, one_hour_day, traces=names, warm_up=600)
    for name in [*names, "rmse", "motor_travel", "stem_travel", "reversals"]:
        values = mixed[name].sel(neutral_zone=0.0, slip_jump=0.0).values
        np.testing.assert_array_equal(values, plain[name].values, err_msg=name)
    assert np.all(mixed.rmse.stack(valve=("neutral_zone", "slip_jump")).values[:, 1:] != plain.rmse.values[:, None])


@pytest.mark.kernel
def test_the_stem_sticks_in_the_second_in_which_its_motor_stops_though_no_command_comes(one_hour_day):
    """The reference computes every second, the kernel only those in which something may happen."""
    loop = fc.Loop(**GENTLE_PI, backlash=0.1, slip_jump=0.04)
    ds = fc.simulate(loop, one_hour_day, traces=["position", "opening"], warm_up=600)
    twin = reference.StickSlip(0.1, 0.04)
    expected = [twin.move(position)[1] for position in ds.position.values.tolist()]
    np.testing.assert_allclose(ds.opening.values, expected, rtol=0.0, atol=1e-15)
    rests = np.diff(ds.position.values) == 0.0
    assert rests.mean() > 0.9


@pytest.mark.kernel
@pytest.mark.parametrize("valve", [{"neutral_zone": 0.03}, {"slip_jump": 0.02}])
def test_a_loop_that_settles_with_backlash_alone_hunts_with_a_neutral_zone_or_stick_slip(valve):
    """An integral part against a motor or a stem at rest; play alone needs a second integrator in the plant."""
    day = fc.constant_day(hours=6, T_set=16.0)
    loop = fc.Loop.preset("lbnl")
    play, real = (fc.simulate(loop.assign(**more), day, warm_up=7200) for more in ({}, valve))
    assert float(play.hunting_swing) < 0.05
    assert float(real.hunting_swing) > 0.3


# A gap that changes


@pytest.mark.kernel
@pytest.mark.parametrize("slip_jump", [0.0, 0.02])
@pytest.mark.parametrize("approach", [0.0, 1.0])
def test_a_gap_that_grows_moves_no_stem_while_its_motor_stands_still(slip_jump, approach):
    seconds = np.arange(3600)
    day = fc.constant_day(hours=1).assign(backlash_scale=np.select([seconds < 1800, seconds < 2700], [1.0, 3.0], 8.0))
    command = np.where(seconds < 600, approach, 0.5)
    loop = fc.Loop(backlash=0.05, slip_jump=slip_jump)
    ds = fc.simulate(loop, day, command=command, traces=["opening"], warm_up=1000)
    openings = ds.opening.values[700:]
    np.testing.assert_array_equal(openings, openings[0])
    # Eq (1) on the flank: α is that of 5 %, whatever the gap
    play = 0.05 - slip_jump
    assert openings[0] == pytest.approx((0.5 - (0.0 if approach else play)) / (1.0 - play), abs=1e-15)
    assert float(ds.backlash_final) == pytest.approx(0.4)


@pytest.mark.kernel
def test_a_worn_valve_no_longer_opens_fully_and_one_with_less_play_meets_its_stop():
    seconds = np.arange(3600)
    day = fc.constant_day(hours=1).assign(backlash_scale=np.where(seconds < 1800, 2.0, 0.5))
    command = np.interp(seconds % 1800, [0, 600, 1200, 1800], [0.0, 1.0, 1.0, 0.0])
    opening = fc.simulate(fc.Loop(backlash=0.1), day, command=command, traces=["opening"], warm_up=60).opening.values
    assert opening[:1800].max() == pytest.approx(0.8 / 0.9)
    assert opening[1800:].max() == 1.0
    # 5 % of play are left: it is fully open from 95 %, and leaves the stop where the motor has come back to 90 %
    open_ = np.flatnonzero(opening[1800:] == 1.0)
    assert command[1800:][open_[0]] == pytest.approx(0.95, abs=2e-3)
    assert command[1800:][open_[-1]] == pytest.approx(0.9, abs=2e-3)


# Leakage


@pytest.mark.kernel
@pytest.mark.parametrize("leakage", [0.0, 0.001, 0.03, 0.5])
def test_a_closed_valve_leaks_its_share_of_the_full_flow_exactly_and_flow_rises_with_opening(leakage):
    openings = np.linspace(0.0, 1.0, 1801)
    flow = simulate_openings(openings, leakage=leakage, C_w=10.0).m_w.values
    plain = simulate_openings(openings, C_w=10.0).m_w.values
    assert flow[-1] == plain[-1]
    assert flow[0] == leakage * flow[-1]
    assert np.all(np.diff(flow) > 0.0)
    expected = [reference.leaking_valve(x, leakage, *VALVE_CURVE) for x in openings.tolist()]
    np.testing.assert_allclose(flow, expected, rtol=0.0, atol=1e-14)


@pytest.mark.kernel
def test_the_leakage_of_the_printed_curve_gives_the_printed_curve():
    openings = np.linspace(0.0, 1.0, 1801)
    valve = {"rangeability": 50.0, "authority": 0.3, "m_full": 1.8}
    for curve, parameters in ((VALVE_CURVE, {}), (reference.valve_from_authority(*valve.values()), valve)):
        leakage = reference.richards_valve(0.0, *curve) / reference.richards_valve(1.0, *curve)
        leaking = simulate_openings(openings, **parameters, leakage=leakage).m_w
        plain = simulate_openings(openings, **parameters).m_w
        np.testing.assert_allclose(leaking, plain, rtol=1e-13, atol=0.0)


@pytest.mark.kernel
@pytest.mark.parametrize("beta2", [-5.0, -0.2, 0.0, 0.5])
def test_a_tight_valve_shuts_the_water_off_and_energy_closes(beta2):
    seconds = np.arange(5400)
    openings = np.select([seconds < 600, seconds < 4800], [1.0, 0.0], np.linspace(0.0, 0.02, 5400))
    ds = simulate_openings(openings, leakage=0.0, beta2=beta2, air_march="quasistatic")
    T_w, T_c, T_a, m_w = (ds[name].values for name in ("T_w", "T_c", "T_a", "m_w"))
    assert int(ds.status) == 0
    shut = slice(600, 4800)
    assert np.all(m_w[shut] == 0.0)
    assert np.all(ds.power.values[shut] == 0.0)
    np.testing.assert_array_equal(T_w[:, shut], np.broadcast_to(T_w[:, [600]], T_w[:, shut].shape))
    np.testing.assert_allclose(T_c[:, 4799], 26.0, atol=1e-9)
    assert m_w[-1] > 0.0
    stored = (8.8 * np.diff(T_w) + 30.0 * np.diff(T_c)).sum(axis=0)
    G_a = reference.effectiveness(1.15, 0.40, -0.45) * 1.15 * 1.02
    air = 1.15 * 1.02 * (26.0 - T_a[0, :-1]) - 0.5 * G_a * np.diff(T_c).sum(axis=0)
    water = m_w[:-1] * 4.186 * (7.0 - 0.5 * (T_w[-1, :-1] + T_w[-1, 1:]))
    np.testing.assert_allclose(stored, air + water, rtol=0.0, atol=1e-10)


# Refusals


@pytest.mark.parametrize(
    "parameters",
    [
        {"backlash": [0.04, 0.07], "slip_jump": 0.05},
        {"backlash": ("valve", [0.02, 0.07]), "slip_jump": ("valve", [0.01, 0.08])},
    ],
)
def test_a_jump_larger_than_the_band_is_refused_before_anything_runs(parameters, simulate_problems, half_hour_day):
    (problem,) = simulate_problems(fc.Loop(**parameters), half_hour_day, warm_up=60)
    assert "slip_jump is up to 0.01 above the backlash" in problem
    assert "lower slip_jump or raise backlash" in problem


@pytest.mark.kernel
def test_a_jump_larger_than_the_band_that_the_boundary_leaves_is_refused(simulate_problems, half_hour_day):
    (problem,) = simulate_problems(fc.Loop(slip_jump=0.05), half_hour_day.assign(backlash_scale=0.5), warm_up=60)
    assert "0.015 above the backlash, which backlash_scale makes 0.5 times as large" in problem
    fc.simulate(fc.Loop(slip_jump=0.05), half_hour_day.assign(backlash_scale=2.0), warm_up=60)

"""A day of operation: mixing, economiser, set-points, requests, flow, water: balances, closed forms, plain Python."""

import numpy as np
import pytest
from reference.trim_and_respond import set_points

from fastcoil.model.moist_air import enthalpy, mix
from studies.year import operation
from studies.year.operation import outdoor_share, zone_loads


@pytest.mark.parametrize("spread", [0.0, 0.3])
def test_trim_and_respond_is_that_of_the_guideline_zone_by_zone(spread):
    rng = np.random.default_rng(5)
    n, low, high, T_zone = 400, 13.0, 18.0, 24.0
    mean = 0.6 + 0.6 * np.sin(np.arange(n) / 40) + rng.normal(0, 0.02, n)
    loads = zone_loads(np.maximum(mean, 0.0), spread, rng.normal(0, 0.05, (n, 20)))
    T_out = 18.5 + 4 * np.sin(np.arange(n) / 30)
    share = operation.reset_line(T_out, 16.0, 21.0, 0.0, 1.0)
    tops = operation.trim_and_respond(low, high, share, operation.request_limits(loads, T_zone, low))
    options = {"T_zone": T_zone, "low": low, "high": high, "T_out_min": 16.0, "T_out_max": 21.0, "trim": 0.1}
    options |= {"respond": 0.2, "most": 0.6, "ignored": 2, "delay": 600, "step": 120}
    expected = set_points(loads.tolist(), T_out.tolist(), **options)
    np.testing.assert_allclose(tops + share * (low - tops), expected, atol=1e-9)
    assert min(expected) < 13.2
    assert max(expected) > 17.0


def test_zones_of_equal_load_take_what_the_load_needs():
    """Flow times temperature difference is the load, between the least and the full flow."""
    loads, T_set = np.array([[0.2] * 4, [0.5] * 4, [0.5] * 4, [0.9] * 4]), np.array([13.0, 13.0, 18.0, 18.0])
    share = operation.flow_share(loads, T_set, 24.0, 13.0, 0.3)
    np.testing.assert_allclose(share, [0.3, 0.5, 0.5 * 11 / 6, 1.0])


def test_loads_of_zones_lie_evenly_about_their_mean():
    loads = zone_loads(np.array([0.5, 1.0]), 0.4, np.zeros((2, 5)))
    np.testing.assert_allclose(loads, np.outer([0.5, 1.0], [0.6, 0.8, 1.0, 1.2, 1.4]))
    np.testing.assert_allclose(zone_loads(np.array([0.5]), 0.4, np.zeros((1, 1))), [[0.5]])
    assert (zone_loads(np.array([0.5]), 0.0, np.full((1, 3), -2.0)) == 0.0).all()


def test_the_economiser_holds_the_set_point_by_the_balance_of_enthalpy():
    T_out, W_out = np.array([-10.0, 5.0, 12.0, 12.9]), np.array([0.001, 0.004, 0.008, 0.002])
    T_set, least = np.full(4, 13.0), np.zeros(4)
    share = outdoor_share(T_out, W_out, 24.0, 0.009, T_set, least, 24.0)
    T, W = mix(share, T_out, W_out, 24.0, 0.009)
    np.testing.assert_allclose(T, 13.0, atol=1e-10)
    water = share * W_out + (1 - share) * 0.009
    heat = share * enthalpy(T_out, W_out) + (1 - share) * enthalpy(24.0, 0.009)
    np.testing.assert_allclose(W, water, rtol=1e-12)
    np.testing.assert_allclose(enthalpy(T, W), heat, rtol=1e-12)


@pytest.mark.parametrize(
    ("T_out", "limit", "expected"),
    [
        (14.0, 24.0, 1.0),  # cooler than the return air, warmer than the set-point: all from outdoors
        (23.99, 24.0, 1.0),
        (24.0, 24.0, 0.2),  # locked out
        (30.0, 24.0, 0.2),
        (20.0, 18.0, 0.2),
        (14.0, -np.inf, 0.2),  # no economiser
        (-30.0, 24.0, 11 / 54),
        (-40.0, 24.0, 0.2),  # the least is too much already
    ],
)
def test_when_the_economiser_opens(T_out, limit, expected):
    share = outdoor_share(np.array([T_out]), np.zeros(1), 24.0, 0.0, np.array([13.0]), np.array([0.2]), limit)
    assert share == pytest.approx([expected], rel=1e-12)


def test_dampers_take_their_time():
    share = operation.delay_by_dampers(np.repeat([0.2, 1.0], [50, 200]))
    np.testing.assert_allclose(share[:50], 0.2, rtol=1e-12)
    np.testing.assert_allclose(share[49:141], np.clip(0.2 + 0.8 * np.arange(92) / 90, 0.2, 1.0), rtol=1e-12)


def test_the_coil_goes_on_and_off_with_a_gap_between():
    beyond = np.array([0.4, 0.6, 0.4, 0.3, 0.21, 0.1, 0.3, 0.49, 0.51, -3.0, 0.4])
    on = [False, True, True, True, True, False, False, False, True, False, False]
    assert operation.is_coil_needed(beyond).tolist() == on


def test_the_noise_goes_on_over_midnight_and_is_as_strong_as_that_of_the_papers_day():
    days = [operation.plant_drifts(3, day) for day in range(1, 4)]
    for name, std in (("m_a", 0.013), ("T_a_in", 0.1), ("W_a_in", 0.009), ("T_w_in", 0.05)):
        whole = np.concatenate([day[name] for day in days])
        assert whole.std() == pytest.approx(std, rel=0.12)
        steps = np.abs(np.diff(whole))
        assert steps[86399::86400].max() <= steps.max() < 0.08 * std
    other = operation.plant_drifts(4, 1)["m_a"]
    assert abs(np.corrcoef(other, days[0]["m_a"])[0, 1]) < 0.2
    assert abs(np.corrcoef(days[1]["m_a"], days[0]["m_a"])[0, 1]) < 0.2
    assert operation._white_noise(60, 3, 1, 0, 1)[0, 0] != operation._white_noise(60, 3, 1, 1, 1)[0, 0]
    zones = operation.zone_drifts(3, 1, 6)
    assert zones.shape == (1440, 6)
    assert np.abs(np.corrcoef(zones.T) - np.eye(6)).max() < 0.5

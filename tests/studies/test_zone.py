"""``cost/zone.py``: rooms at rest close their energy balance, and sums are those of plain Python."""

from functools import cache

import numpy as np
import pytest
import xarray as xr

from studies.cost import zone


@cache
def at_rest(T_sup, T_set=14.0, hours=4):
    """Rooms with air of one temperature for so long that nothing moves any more; a lane of 1 kg/s."""
    usual = np.ones((1, hours * 3600))
    return zone.simulate_rooms(np.full(usual.shape, T_sup), usual, T_set)


@pytest.mark.parametrize("T_sup", [13.0, 15.0])
def test_rooms_at_rest_take_the_flow_that_carries_their_load_or_reheat(T_sup):
    room_state = at_rest(T_sup)
    core_load, other_load = zone.CP * (zone.ROOM_SET_POINT - 14.0) * zone.AIR_SHARES * zone.LOAD_SHARES
    core = core_load / (zone.CP * (zone.ROOM_SET_POINT - T_sup))
    least_flow = zone.LEAST_FLOWS[zone.PERIMETER] * zone.OVERSIZE_FACTOR * zone.AIR_SHARES[zone.PERIMETER]
    reheat = zone.CP * least_flow * (zone.HEATING_SET_POINT - T_sup) - other_load
    assert room_state.flow[0, -1] == pytest.approx(core + least_flow, rel=1e-3)
    assert room_state.reheat[0, -1] == pytest.approx(reheat, rel=1e-3)


def test_rooms_answer_warmer_air_with_more_air_and_less_heat():
    cold, warm = at_rest(13.0), at_rest(15.0)
    assert warm.flow[0, -1] > 1.1 * cold.flow[0, -1]
    assert warm.reheat[0, -1] < cold.reheat[0, -1]


def test_the_fan_takes_its_rated_power_at_its_greatest_flow_and_far_less_at_half():
    assert zone.fan_power(np.array(1.0)) == pytest.approx(1.0, abs=1e-3)
    assert 0.2 < zone.fan_power(np.array(0.5)) < 0.4


def test_the_demand_is_the_largest_mean_of_a_quarter_of_an_hour():
    warm_up, quarter = zone.WARM_UP_SECONDS, zone.QUARTER_SECONDS
    n = warm_up + 3 * quarter
    power = np.zeros((1, n))
    power[0, warm_up + quarter : warm_up + 3 * quarter // 2] = 2.0 * zone.COP
    coil = zone.Coil(np.full((1, n), 14.0), np.full((1, n), 0.5), power, np.zeros(1))
    sums = zone.daily_sums(zone.Rooms(np.ones((1, n)), np.full((1, n), 2.0)), coil, np.ones((1, n)))
    factor = zone.OVERSIZE_FACTOR
    base = zone.FAN_POWER * factor * zone.fan_power(np.array(1 / factor)) + zone.PUMP_POWER * 0.5
    assert sums["demand"] == pytest.approx(base + 1.0)
    assert sums["electricity"] == pytest.approx(base + 1.0 / 3.0)
    assert (sums["reheat"], sums["water"]) == (2.0, 0.5)


def test_loops_that_no_day_has_get_no_row():
    dims, random = ("worn", "sample", "day"), np.random.default_rng(1)
    series = {name: (dims, 1.0 + random.random((2, 4, 2))) for name in (*zone.SUM_NAMES, "moved")}
    calm = xr.Dataset(series | {"hunts": (dims, np.zeros((2, 4, 2)))}, {"worn": [True, False]})
    rows = zone.change_rows("constant", calm)
    assert [row[1] for row in rows] == [zone.CALM, zone.ALL_LOOPS]
    assert all(len(row) == len(zone.HEAD) for row in rows)

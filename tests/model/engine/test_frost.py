"""Frost and freezing water: metrics of the time in which they occur."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.moist_air import humidity_ratio

pytestmark = pytest.mark.kernel

SECONDS = 1500
SHUT_COMMAND, OPEN_COMMAND = np.zeros(SECONDS), np.full(SECONDS, 0.6)


def simulate_cold_day(command, warm_up=0, enabled=1.0, loop=None, **entering):
    series = {"m_a": 1.15, "T_a_in": -12.0, "W_a_in": 0.0012, "T_w_in": 7.0, "T_set": 14.0} | entering
    day = fc.Boundary(**{name: np.full(SECONDS, value) for name, value in series.items()}, enabled=enabled)
    tight_loop = fc.Loop(leakage=0.0, backlash=0.0) if loop is None else loop
    return fc.simulate(tight_loop, day, command=command, warm_up=warm_up, traces=["T_c", "T_w", "W_sup"])


def test_air_moister_than_ice_at_the_metal_frosts_it_and_drier_air_does_not():
    """A shut coil comes to the temperature of the air; its water stands and freezes, in moist air and in dry."""
    saturated = float(humidity_ratio(-12.0, 1.0))  # over water; over ice 0.89 of it
    moist, dry = (simulate_cold_day(SHUT_COMMAND, W_a_in=share * saturated) for share in (0.95, 0.8))
    assert float(moist.T_c.isel(elapsed_time=-1).max()) < -11.5
    assert float(moist.frost_time) > 1000.0
    assert float(dry.frost_time) == 0.0
    assert float(dry.freeze_time) == float(moist.freeze_time) > 1000.0


def test_the_times_are_those_of_the_traces_to_a_minute():
    ds = simulate_cold_day(SHUT_COMMAND, W_a_in=0.002)
    cold_seconds = int((ds.T_c.min("volume") < 0.0).sum())
    assert 300 < cold_seconds < SECONDS
    assert float(ds.frost_time) == pytest.approx(cold_seconds, abs=60.0)
    assert float(ds.freeze_time) == pytest.approx(cold_seconds, abs=60.0)


def test_water_that_flows_counts_with_its_own_temperature():
    ds = simulate_cold_day(OPEN_COMMAND)
    assert float(ds.T_c.min()) > 0.0
    assert float(ds.frost_time) == float(ds.freeze_time) == 0.0
    little_flow = simulate_cold_day(np.full(SECONDS, 0.02), loop=fc.Loop(leakage=0.005, backlash=0.0))
    cold_seconds = int((little_flow.T_w.min("volume") <= 0.0).sum())
    assert float(little_flow.freeze_time) == pytest.approx(cold_seconds, abs=60.0)
    assert cold_seconds > 300


def test_time_that_is_not_counted_is_seen_too():
    whole = simulate_cold_day(SHUT_COMMAND, W_a_in=0.002)
    late = simulate_cold_day(SHUT_COMMAND, W_a_in=0.002, warm_up=1200)
    off = simulate_cold_day(SHUT_COMMAND, W_a_in=0.002, enabled=np.where(np.arange(SECONDS) < 1400, 0.0, 1.0))
    assert float(whole.frost_time) == float(late.frost_time) == float(off.frost_time) > 0.0
    assert float(whole.freeze_time) == float(late.freeze_time) == float(off.freeze_time) > 0.0

"""Simulated air handlers obey energy and their truth, and the same seed gives the same log."""

import numpy as np
import pandas as pd
import pytest

from studies.air_handler import plant, truth, units
from studies.air_handler.truth import COOLING, ENTERING, HEATING, SUPPLY

pytestmark = pytest.mark.kernel
SEEDS = range(900, 906)


def celsius(unit, name):
    """A temperature as it was read, °C."""
    header = unit.columns[name]
    x = unit.log[header].to_numpy()
    return (x - 32.0) / 1.8 if header.endswith("[°F]") else x


def rows_of(unit, days):
    return np.isin(np.arange(len(unit.signals)) // truth.ROWS_PER_DAY, days)


def test_the_same_seed_gives_the_same_log_and_another_seed_another():
    first, again, other = (units.simulate_unit(seed, truth.LEAK, 0.2) for seed in (901, 901, 902))
    pd.testing.assert_frame_equal(first.log, again.log)
    assert first.truth == again.truth
    assert not first.log.iloc[:, 1:].equals(other.log.iloc[:, 1:])


@pytest.mark.parametrize("seed", SEEDS)
def test_coils_only_cool_or_heat_and_no_more_than_water_and_air_allow(seed):
    s = units.simulate_unit(seed).signals
    s = s[s.enabled > 0.5]
    unit = units.draw_unit(seed, 4)
    heating, cooling = s.T_heated - s.T_mixed, s.T_cooled - s.T_heated
    assert heating.min() >= -1e-9
    assert cooling.max() <= 0.05 * max(1.0, -cooling.min())  # water of 9 °C warms colder air a little
    assert s.T_heated.max() < max(np.max(unit.coil_series[1].T_w), s.T_mixed.max())
    assert s.T_cooled.min() > min(np.min(unit.coil_series[0].T_w), s.T_mixed.min()) - 1e-9


@pytest.mark.parametrize("m_w", [0.02, 0.2, 1.0])
def test_the_heat_of_a_coil_is_that_of_a_counterflow_coil(m_w):
    coil = units.draw_coil(np.random.default_rng(1), 2.0, heating=True)
    Q = plant.coil_heat(coil, coil.m_w * m_w, 2.0, 15.0, 60.0, 1.0)
    C_a, C_w = 1.02 * 2.0, 4.19 * coil.m_w * m_w
    d_in, d_out = 60.0 - Q / C_w - 15.0, 60.0 - (15.0 + Q / C_a)
    UA = coil.UA / (0.6 + 0.4 * m_w**-0.8)
    assert Q == pytest.approx(UA * (d_in - d_out) / np.log(d_in / d_out), rel=1e-6)


def test_the_zone_balances_in_the_mean():
    s, unit = units.simulate_unit(903).signals, units.draw_unit(903, 4)
    p, steps = unit.plant, plant.LOG_STEPS
    load = unit.series.load[::steps]
    T_sup_air = s.T_cooled + p.fan_heat * s.m_a / p.m_a
    reheat = 0.0 if p.is_cascade else np.clip(21.0 - s.T_zone, 0.0, 1.0) * 15.0 * 1.02 * s.m_a
    heat = load + reheat + p.zone_UA * (s.T_out - s.T_zone) + 1.02 * s.m_a * (T_sup_air - s.T_zone)
    stored = p.zone_capacity * (s.T_zone.iloc[-1] - s.T_zone.iloc[0])
    assert heat.sum() * 60.0 == pytest.approx(stored, abs=0.02 * abs(heat).sum() * 60.0)


@pytest.mark.parametrize(("component", "sign"), [(COOLING, -1.0), (HEATING, 1.0)])
def test_a_leak_moves_the_air_its_way_while_the_valve_is_shut(component, sign):
    effects = []
    for size in (0.05, 0.2, 0.5):
        unit = units.simulate_unit(904, truth.LEAK, size, component)
        s = unit.signals[rows_of(unit, unit.truth.days)]
        side = truth.SIDES[component]
        shut = s[(s.enabled > 0.5) & (s[f"{side}_command"] < 0.01)]
        assert (s[f"{side}_flow"] >= size - 1e-9).all()
        effect = shut.T_cooled - shut.T_heated if component == COOLING else shut.T_heated - shut.T_mixed
        effects.append(sign * effect.median())
        healthy = unit.signals[~rows_of(unit, unit.truth.days)]
        assert healthy[f"{side}_flow"].min() < 0.01
    assert 0.2 < effects[0] < effects[1] < effects[2]


@pytest.mark.parametrize(
    ("fault", "size", "flow"), [(truth.STUCK_OPEN, 0, 1.0), (truth.STUCK_SHUT, 0, 0.0), (truth.NO_WATER, 0, 0.0)]
)
def test_a_stuck_valve_passes_what_it_is_stuck_at(fault, size, flow):
    unit = units.simulate_unit(905, fault, size)
    s = unit.signals[rows_of(unit, unit.truth.days)].iloc[5:]
    assert s.cooling_flow.to_numpy() == pytest.approx(flow, abs=0.01)


def test_sensors_read_the_truth_within_their_offsets():
    for seed in SEEDS:
        unit = units.simulate_unit(seed)
        p = units.draw_unit(seed, 4).plant
        s = unit.signals.loc[pd.to_datetime(unit.log.iloc[:, 0])]
        assert celsius(unit, "T_sup") - s.T_sup.to_numpy() == pytest.approx(p.supply_offset, abs=0.5)
        streaks = 0.15 * 0.25 * abs(s.T_out - s.T_return).max()
        assert celsius(unit, "T_mixed") - s.T_mixed.to_numpy() == pytest.approx(p.mixed_offset, abs=0.6 + streaks)


def test_a_stuck_sensor_stands_still_and_an_offset_moves_it():
    for component, name in ((SUPPLY, "T_sup"), (ENTERING, "T_mixed")):
        unit = units.simulate_unit(901, truth.FROZEN, component=component)
        faulty = np.isin(pd.to_datetime(unit.log.iloc[:, 0]).map(unit.signals.index.get_loc) // 1440, unit.truth.days)
        assert np.ptp(celsius(unit, name)[faulty]) == 0.0
        assert np.ptp(celsius(unit, name)[~faulty]) > 1.0
    plain, moved = units.simulate_unit(901), units.simulate_unit(901, truth.OFFSET, -5.0, ENTERING)
    change = celsius(moved, "T_mixed") - celsius(plain, "T_mixed")
    assert sorted(set(np.round(change).tolist())) == [-5.0, 0.0]


def test_faults_show_only_on_their_days():
    for seed in SEEDS:
        for fault, size in ((truth.LEAK, 0.5), (truth.FIGHT, 2.0), (truth.UNOCCUPIED, 0.0), (truth.SWINGS, 2.0)):
            unit = units.simulate_unit(seed, fault, size)
            assert set(unit.truth.shown_days) <= set(unit.truth.days)
            assert len(unit.truth.days) < 4
            for start, end in unit.truth.windows:
                assert start <= end
                assert unit.signals.index.get_loc(start) // truth.ROWS_PER_DAY in unit.truth.days


def test_swings_are_seen_if_regular_and_large_and_of_a_moving_command():
    t = np.arange(1440.0)
    wave, moves = np.sin(2 * np.pi * t / 12.0) * (abs(t - 700) < 100), np.sin(t)
    found = truth.regular_swings(wave, moves, 0.4, 1, 25)
    assert 150 < found.sum() < 210
    assert found[650:750].all()
    few = np.where(abs(t - 700) < 14, wave, 0.0)
    assert not truth.regular_swings(few, moves, 0.4, 1, 25).any()
    assert not truth.regular_swings(wave, np.zeros(1440), 0.4, 1, 25).any()
    assert not truth.regular_swings(0.15 * wave, moves, 0.4, 1, 25).any()
    assert not truth.regular_swings(wave, moves, 0.4, 15, 60).any()


def test_a_loop_made_to_hunt_hunts_and_by_its_gap_only_with_it():
    unit = units.simulate_unit(307, truth.HUNT, component=COOLING, cause=units.GAP)
    assert unit.truth.cause == "gap"
    assert set(unit.truth.shown_days) <= set(unit.observed.hunting[COOLING])
    assert unit.truth.shown_days
    healthy = units.simulate_unit(307)
    assert not set(healthy.observed.hunting[COOLING]) & set(healthy.observed.calm[COOLING])

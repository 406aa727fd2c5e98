"""``hunts``: loops that oscillate, and loops that only noise and disturbances move."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.hunting import is_same_period


@pytest.mark.parametrize(
    ("period", "before", "sample_time", "expected"),
    [(200.0, 200.0, 0.0, True), (200.0, 160.0, 5.0, True), (160.0, 200.0, 5.0, True), (200.0, 150.0, 5.0, False),
     (200.0, 150.0, 40.0, True), (90.0, 60.0, 30.0, True), (200.0, 0.0, 30.0, False)],
)  # fmt: skip
def test_periods_are_alike_to_a_fifth_of_the_longer_or_a_sample(period, before, sample_time, expected):
    assert is_same_period(period, before, sample_time) == expected


LOOP, MEAN_OPENING = fc.Loop(backlash=0.0), 0.45


def rest_temperature():
    """Supply temperature, °C, with the valve at MEAN_OPENING."""
    command = np.full(1800, MEAN_OPENING)
    ds = fc.simulate(LOOP, fc.constant_day(hours=0.5), command=command, traces=["T_sup"], warm_up=600)
    return float(ds.T_sup[-1])


def hunts_with_waves(periods, height=0.2):
    """``hunts`` for a valve that moves up and down once in each of these periods, s, after 20 min at rest."""
    waves = [MEAN_OPENING - height * np.sin(2 * np.pi * np.arange(p) / p) for p in periods]
    command = np.concatenate([np.full(1200, MEAN_OPENING), *waves])
    day = fc.constant_day(hours=command.size / 3600, T_set=rest_temperature())
    return float(fc.simulate(LOOP, day, command=command, warm_up=600).hunts)


@pytest.mark.kernel
def test_ten_whole_periods_alike_count_and_nine_do_not():
    """The first wave starts from rest and the last one does not end in a crossing: two waves are not whole periods."""
    assert [hunts_with_waves([400] * n) for n in (11, 12)] == [0.0, 1.0]


@pytest.mark.kernel
def test_a_third_of_the_periods_may_differ():
    """Of twelve periods a long one spoils two pairs, and the first has none before it."""
    assert hunts_with_waves([400] * 6 + [700] + [400] * 6) == 1.0
    assert hunts_with_waves([400, 400, 400, 700] * 4) == 0.0


@pytest.mark.kernel
def test_a_swing_of_less_than_a_tenth_of_a_kelvin_is_no_hunting():
    assert [hunts_with_waves([400] * 14, height) for height in (0.2, 0.002)] == [1.0, 0.0]


@pytest.mark.kernel
def test_loops_that_hunt_and_loops_that_noise_and_disturbance_shake():
    """``paper_like`` hunts with 7 % backlash, and without it moves as much under noise without hunting."""
    loop = fc.Loop().assign(backlash=[0.0, 0.07], noise_std=[0.0, 0.02, 0.05])
    ds = fc.simulate(loop, fc.paper_day(hours=8, seed=31))
    assert ds.hunts.sel(backlash=0.07).values.tolist() == [1.0, 1.0, 1.0]
    assert ds.hunts.sel(backlash=0.0).values.tolist() == [0.0, 0.0, 0.0]
    assert float(ds.hunting_swing.sel(backlash=0.0, noise_std=0.05)) > 0.1


@pytest.mark.kernel
def test_no_period_reaches_across_a_set_point_step():
    """With a step every 15 min only 5 min are settled: a period of 400 s is never seen whole, one of 100 s is."""
    seconds, T = np.arange(8 * 3600), rest_temperature()
    day = fc.constant_day(hours=8, T_set=np.where(seconds // 900 % 2, T - 0.06, T))
    hunts = []
    for period in (100, 400):
        command = MEAN_OPENING + 0.2 * np.sin(2 * np.pi * seconds / period)
        hunts.append(float(fc.simulate(LOOP, day, command=command).hunts))
    assert hunts == [1.0, 0.0]


@pytest.mark.kernel
@pytest.mark.full
@pytest.mark.parametrize("preset", ["paper_like", "lbnl"])
def test_the_rule_agrees_with_the_loop_left_alone(preset):
    """A loop that swings after four hours of constant air and water without noise makes that swing itself."""
    draw, n = np.random.default_rng(77), 200
    loop = fc.Loop.preset(preset).assign(
        kp=("tuning", np.exp(draw.uniform(np.log(0.005), np.log(0.1), n))),
        ti=("tuning", np.exp(draw.uniform(np.log(5.0), np.log(600.0), n))),
        sample_time=("tuning", draw.choice([1.0, 5.0, 10.0, 30.0], n)),
        backlash=("tuning", draw.choice([0.0, 0.02, 0.04, 0.07, 0.1, 0.15], n)),
    )
    alone = fc.simulate(loop, fc.constant_day(hours=5), traces=["T_sup"], trace_interval=5).T_sup[..., 4 * 720 :]
    low, high = alone.min("elapsed_time"), alone.max("elapsed_time")
    swings_alone = ((high - low > 0.1) & (low < 14.0) & (high > 14.0)).values
    assert 0.05 < swings_alone.mean() < 0.5
    series = {name: values[0] for name, values in fc.paper_day(hours=8, seed=771).series.items()}
    disturbed = fc.Boundary(**series | {"T_set": np.full(8 * 3600, 14.0)})
    for day in (disturbed, fc.constant_day(hours=8)):
        for noise_std in (0.0, 0.05):
            hunts = fc.simulate(loop.assign(noise_std=noise_std), day).hunts.values > 0.0
            assert (hunts == swings_alone).mean() > 0.93
            assert (hunts & ~swings_alone).sum() <= 0.06 * (~swings_alone).sum()
            assert (~hunts & swings_alone).sum() <= 0.4 * swings_alone.sum()

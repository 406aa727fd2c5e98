"""``hunts``: loops that make their swing themselves, and loops that something else moves."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.hunting import N_SWING_ROWS, SWING_SIGNALS, is_same_period, judge_swing


@pytest.mark.parametrize(
    ("period", "before", "sample_time", "expected"),
    [(200.0, 200.0, 0.0, True), (200.0, 160.0, 5.0, True), (160.0, 200.0, 5.0, True), (200.0, 150.0, 5.0, False),
     (200.0, 150.0, 40.0, True), (90.0, 60.0, 30.0, True), (200.0, 0.0, 30.0, False)],
)  # fmt: skip
def test_periods_are_alike_to_a_fifth_of_the_longer_or_a_sample(period, before, sample_time, expected):
    assert is_same_period(period, before, sample_time) == expected


def block_of(h, *causes):
    """A block of one loop with this swing and these three causes."""
    signals = np.stack([np.ones_like(h), *causes, h])
    return np.concatenate([np.ravel(signals @ signals.T), [h.max(), h.min()]])[None, :, None]


PHASE = 2.0 * np.pi * np.arange(120) / 24


@pytest.mark.parametrize(
    ("swing", "forced", "expected"),
    [(0.11, 0.0, 1.0), (0.09, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, 0.05, 1.0), (0.09, 0.5, 0.0), (0.5, 0.42, 1.0),
     (0.5, 0.78, 0.0), (0.06, 0.04, 0.0)],
)  # fmt: skip
def test_a_swing_counts_where_its_own_part_is_visible_and_not_small(swing, forced, expected):
    """The own part has another period than the causes, so that the parts are known: 0.5² against forced²."""
    own = 0.5 * swing * np.sin(2.0 * PHASE)
    if forced == swing:
        own *= 0.0
    causes = np.sin(PHASE), np.cos(PHASE), np.zeros(120)
    h = own + 0.5 * forced * np.sin(PHASE + 0.4) + 0.3
    hunts, _ = judge_swing(block_of(h, *causes))
    assert hunts.tolist() == [expected]


def test_a_loop_hunts_where_half_of_its_blocks_do_and_its_swing_is_their_median():
    """Without causes; the products of a zero signal are zeros."""
    zeros = np.zeros(120)
    blocks = [block_of(0.5 * swing * np.sin(PHASE), zeros, zeros, zeros) for swing in (0.05, 0.06, 1.0, 3.0, 0.07)]
    for n, expected in ((4, 1.0), (5, 0.0)):
        hunts, swing = judge_swing(np.concatenate(blocks[:n]))
        assert hunts.tolist() == [expected]
        assert swing == pytest.approx(np.median([0.05, 0.06, 1.0, 3.0, 0.07][:n]), rel=0.01)
    assert N_SWING_ROWS == SWING_SIGNALS**2 + 2


LOOP, MEAN_OPENING = fc.Loop(backlash=0.0), 0.45


def hunts_with_waves(periods, height=0.2):
    """``hunts`` for a valve that moves up and down once in each of these periods, s, after 20 min at rest."""
    waves = [MEAN_OPENING - height * np.sin(2 * np.pi * np.arange(p) / p) for p in periods]
    command = np.concatenate([np.full(1200, MEAN_OPENING), *waves])
    day = fc.constant_day(hours=command.size / 3600)
    return float(fc.simulate(LOOP, day, command=command, warm_up=600).hunts)


@pytest.mark.kernel
def test_a_swing_need_not_be_regular():
    irregular = [200, 500, 300, 150, 600, 250] * 3
    assert [hunts_with_waves(irregular), hunts_with_waves(irregular, height=0.002)] == [1.0, 0.0]


@pytest.mark.kernel
@pytest.mark.parametrize(("hours", "is_known"), [(0.65, False), (1.0, True)])
def test_ten_settled_minutes_are_needed(hours, is_known):
    ds = fc.simulate(fc.Loop(), fc.constant_day(hours=hours))
    assert bool(np.isfinite(ds.hunts)) == is_known
    assert bool(np.isfinite(ds.hunting_swing)) == is_known


@pytest.mark.kernel
def test_a_cycle_of_three_samples_is_a_swing_of_its_own():
    """Its periods alternate on some days; the swing of a block is less than the extremes of the day."""
    loop = fc.Loop.preset("paper_like").assign(backlash=0.1, kp=0.059, ti=5.4)
    ds = fc.simulate(loop, fc.constant_day(hours=8))
    assert (float(ds.hunts), float(ds.hunting_period)) == (1.0, pytest.approx(90.0, abs=1.0))
    assert float(ds.hunting_swing) < float(ds.settled_range)


@pytest.mark.kernel
def test_a_loop_that_its_estimator_keeps_swinging_hunts():
    loop = fc.Loop.preset("lbnl").assign(kp=0.03, ti=10.0, estimator="identify")
    assert float(fc.simulate(loop, fc.constant_day(hours=8)).hunts) == 1.0


@pytest.mark.kernel
@pytest.mark.parametrize("name", ["m_a", "T_a_in", "W_a_in", "T_w_in"])
def test_what_air_or_water_swing_is_no_hunting(name):
    """A loop without backlash, moved every 10 min by 0.3 to 0.5 K; the swing is regular."""
    heights = {"m_a": 0.08 * 1.2, "T_a_in": 1.0, "W_a_in": 0.0008, "T_w_in": 0.8}
    series = {key: values[0] for key, values in fc.constant_day(hours=6).series.items()}
    series[name] = series[name] + heights[name] * np.sin(2.0 * np.pi * np.arange(6 * 3600) / 600)
    ds = fc.simulate(fc.Loop.preset("lbnl").assign(backlash=0.0), fc.Boundary(**series))
    assert float(ds.hunting_swing) > 0.2
    assert float(ds.swing_regularity) > 0.9
    assert float(ds.hunts) == 0.0


@pytest.mark.kernel
@pytest.mark.full
@pytest.mark.parametrize("preset", ["paper_like", "lbnl"])
def test_the_rule_agrees_with_the_loop_left_alone(preset):
    """A loop that swings after four hours of constant air and water makes that swing itself; seen from its traces."""
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
        hunts = fc.simulate(loop, day).hunts.values > 0.0
        assert (hunts == swings_alone).mean() > 0.9
        assert (~hunts & swings_alone).sum() <= 0.1 * swings_alone.sum()

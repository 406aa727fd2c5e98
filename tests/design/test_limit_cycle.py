"""Hunting indices and cycles predicted, compared with the emulator and with what theory must say."""

import numpy as np
import pytest
from helpers.refusals import assert_refused
from helpers.sentences import assert_worded

import fastcoil as fc
from fastcoil.design.describing_function import STEPS_PER_PERIOD, pi_output
from fastcoil.model.control import desired_opening, integral_part

LOOP = fc.Loop.preset("lbnl")
HOURS, STEP_AT = 9, 3600


def day(hours=HOURS):
    T_set = np.full(int(hours * 3600), 14.0)
    T_set[:STEP_AT] = 15.0
    return fc.constant_day(hours=hours, T_set=T_set)


@pytest.mark.parametrize("bias", [-0.6, -0.2, 0.3])
def test_a_pi_with_ends_is_what_its_law_does(bias):
    """Of a sinus with a mean; the law runs for 6 periods from the middle."""
    proportional, integral, many = 0.2, 0.6, 30
    steps = STEPS_PER_PERIOD * many
    phase = 2.0 * np.pi * (np.arange(6 * steps) + 0.5) / steps
    sums, expected = 0.5, []
    for e in (np.sin(phase) + bias).tolist():
        sums = integral_part(sums, e, integral * 2.0 * np.pi / steps)
        expected.append(desired_opening(e, sums, proportional))
    last = np.array(expected[-steps:]).reshape(STEPS_PER_PERIOD, many).mean(axis=1)
    u = pi_output(np.array([[proportional]]), np.array([[integral]]), np.array([[bias]]))[:, 0, 0]
    np.testing.assert_allclose(u, last, atol=0.07)
    assert u.min() == 0.0 or u.max() == 1.0


@pytest.mark.kernel
def test_what_is_predicted_happens_on_both_sides_of_the_boundary():
    """Fast and slow integral action; with and without sensor lag, motor and an inverse; X = 0 among them."""
    named = [
        {"ti": 5.0, "kp": 0.01}, {"ti": 8.0}, {"ti": 12.0}, {"ti": 30.0}, {"ti": 60.0, "kp": 0.03},
        {"ti": 8.0, "backlash": 0.02}, {"ti": 8.0, "backlash": 0.0}, {"ti": 12.0, "backlash_estimate": 0.035},
        {"ti": 8.0, "sensor_time_constant": 0.0, "stroke_time": 0.0}, {"ti": 12.0, "sample_time": 5.0},
        {"ti": 12.0, "sample_time": 30.0}, {"ti": 120.0, "sample_time": 60.0},
        {"ti": 12.0, "kp": 0.03}, {"ti": 8.0, "backlash_estimate": 0.05},
        {"ti": 15.0, "kp": 0.05, "sample_time": 5.0, "backlash": 0.03},
    ]  # fmt: skip
    names = sorted({name for case in named for name in case})
    loop = LOOP.assign(**{n: ("case", [case.get(n, LOOP[n]) for case in named]) for n in names})
    simulated = fc.simulate(loop, day(), warm_up=3 * 3600)
    predicted = fc.limit_cycle(loop, day(), at=HOURS * 3600 - 1)
    assert 4 <= int(simulated.hunts.sum()) < 10
    np.testing.assert_array_equal(predicted.hunts, simulated.hunts)
    hunting = simulated.hunts.values == 1.0
    np.testing.assert_allclose(predicted.period[hunting], simulated.hunting_period[hunting], rtol=0.15)
    ratio = (2.0 * predicted.amplitude / simulated.hunting_swing)[hunting]
    assert np.all(np.abs(np.log(ratio)) < np.log(1.5)), ratio.values
    assert np.isnan(predicted.period[~hunting]).all()
    assert np.isnan(predicted.amplitude[~hunting]).all()


@pytest.mark.kernel
def test_without_a_gap_the_hunting_index_is_that_of_the_linear_loop():
    loop = LOOP.assign(backlash=0.0, kp=[0.005, 0.02, 0.04], ti=20.0)
    predicted, linear = fc.limit_cycle(loop, fc.constant_day(hours=1)), fc.linearise(loop, fc.constant_day(hours=1))
    np.testing.assert_allclose(predicted.hunting_index, 1.0 / linear.gain_margin, rtol=0.02)
    np.testing.assert_array_equal(predicted.hunts, linear.gain_margin < 1.0)


@pytest.mark.kernel
def test_a_set_point_out_of_reach_is_no_hunting():
    predicted = fc.limit_cycle(LOOP.assign(ti=5.0), fc.constant_day(hours=1, T_set=5.0))
    assert (float(predicted.hunting_index), float(predicted.hunts)) == (0.0, 0.0)
    assert np.isnan(predicted.period)


@pytest.mark.kernel
def test_a_loop_that_is_unstable_from_one_sample_to_the_next_hunts():
    """Sampled slowly against its plant: a cycle of two samples, from end to end of the valve."""
    loop = LOOP.assign(stroke_time=0.0, sensor_time_constant=0.0, sample_time=[60.0, 120.0], backlash=[0.0, 0.05])
    loop = loop.assign(kp=0.1, ti=("ti", [60.0, 300.0]))
    predicted = fc.limit_cycle(loop, fc.constant_day(hours=4))
    simulated = fc.simulate(loop, fc.constant_day(hours=4), warm_up=7200)
    assert (predicted.hunting_index > 2.0).all()
    assert bool(simulated.hunts.all())
    np.testing.assert_array_equal(predicted.hunts, simulated.hunts)
    np.testing.assert_allclose(predicted.period, simulated.hunting_period, rtol=0.02)
    np.testing.assert_allclose(2.0 * predicted.amplitude, simulated.settled_range, rtol=0.7)


@pytest.mark.kernel
@pytest.mark.filterwarnings("error")
def test_a_gain_of_0_or_below_controls_nothing_and_is_no_hunting():
    """Without a warning of numpy."""
    loop = LOOP.assign(kp=[-0.05, 0.0], ti=8.0)
    predicted = fc.limit_cycle(loop, fc.constant_day(hours=1))
    assert predicted.hunting_index.values.tolist() == predicted.hunts.values.tolist() == [0.0, 0.0]
    assert not fc.simulate(loop, fc.constant_day(hours=1)).hunts.any()
    assert np.isnan(fc.linearise(loop.assign(kp=0.0), fc.constant_day(hours=1)).gain_margin)


@pytest.mark.kernel
def test_a_loop_alone_is_what_it_is_among_strangers():
    """The plant to the bit, the rest but for the order in which numbers are added up."""
    rng, n = np.random.default_rng(4), 16
    swept = {
        "sample_time": rng.choice([1, 2, 7, 30], n), "sensor_time_constant": rng.choice([0.0, 3.0, 47.0, 200.0], n),
        "C_w": rng.uniform(60.0, 600.0, n), "m_max": rng.uniform(1.0, 3.0, n), "kp": rng.uniform(0.01, 0.4, n),
        "backlash": rng.choice([0.0, 0.02, 0.2], n),
    }  # fmt: skip
    loop, here = LOOP.assign(**{name: ("stranger", values) for name, values in swept.items()}), day(1.5)
    strangers, plants = fc.limit_cycle(loop, here), fc.linearise(loop, here)
    assert 3 < strangers.hunts.sum() < 13
    for k in range(0, n, 8):
        loop_alone = LOOP.assign(**{name: values[k].item() for name, values in swept.items()})
        alone, plant = fc.limit_cycle(loop_alone, here), fc.linearise(loop_alone, here)
        for name in alone:
            np.testing.assert_allclose(strangers[name][k], alone[name], rtol=1e-9, err_msg=f"{name} of {k}")
        for name in ("opening", "T_sup", "gain"):
            assert plants[name][k] == plant[name]


UNPREDICTED = {
    "stick": {"slip_jump": 0.02},
    "zone": {"neutral_zone": 0.01},
    "learner": {"learning_step": 0.01},
    "dead band": {"error_dead_band": 0.2},
    "wear": {"wear_rate": 1e-4},
    "sensor": {"sensor_resolution": 0.1},
    "command": {"command_resolution": 0.01},
    "too large": {"backlash_estimate": 0.1, "buffer": 0.01},
    "smooth": {"backlash_estimate": 0.05, "compensation": "smooth", "smooth_rate": 1.0},
}


@pytest.mark.kernel
@pytest.mark.parametrize("changed", UNPREDICTED.values(), ids=UNPREDICTED)
def test_what_theory_does_not_predict_is_said(changed):
    """Refused where nothing is left to tell; else NaN, a warning and a note."""
    steady = fc.constant_day(hours=1)
    assert_refused("loop", "unsupported", fc.limit_cycle, LOOP.assign(ti=8.0, **changed), steady)
    mixed = {name: ("case", [value, LOOP[name]]) for name, value in changed.items()}
    with pytest.warns(UserWarning, match="NaN in 1 of 2 scenarios: ") as caught:
        predicted = fc.limit_cycle(LOOP.assign(ti=8.0, **mixed), steady)
    assert_worded(predicted.attrs["note"])
    assert str(caught[0].message) == predicted.attrs["note"]
    np.testing.assert_array_equal(predicted.hunts, [np.nan, 1.0])
    assert np.isnan(predicted.hunting_index[0])


@pytest.mark.parametrize("predict", [fc.limit_cycle, fc.linearise])
def test_a_boundary_that_changes_the_gap_is_refused(predict):
    loose = fc.constant_day(hours=1).assign(backlash_scale=np.linspace(1.0, 2.0, 3600))
    for boundary in (loose, loose.assign(backlash_scale=2.0)):
        assert_refused("backlash_scale", "unsupported", predict, LOOP, boundary)


@pytest.mark.kernel
def test_a_slow_motor_makes_a_large_cycle_slower_and_larger():
    """As in the emulator."""
    loop = LOOP.assign(ti=12.0, kp=0.04, sensor_time_constant=60.0, stroke_time=[0.0, 150.0])
    predicted = fc.limit_cycle(loop, day(), at=HOURS * 3600 - 1)
    simulated = fc.simulate(loop, day(), warm_up=3 * 3600)
    slower = [float(period[1] / period[0]) for period in (predicted.period, simulated.hunting_period)]
    larger = [float(swing[1] / swing[0]) for swing in (predicted.amplitude, simulated.hunting_swing)]
    assert slower[0] == pytest.approx(slower[1], rel=0.15)
    assert larger[0] == pytest.approx(larger[1], rel=0.25)
    assert slower[1] > 1.2

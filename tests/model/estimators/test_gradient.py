"""The adaptive inverse: what moves its estimate and what does not, and what it finds."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.estimators import gradient
from fastcoil.model.estimators.interface import Sample

PARAMETERS = gradient.Parameters(5.0, 0.0, 3e-4, 60.0, 60.0, 0.05, 400.0, 0.2)
SWING = np.where(np.arange(400) // 20 % 2 == 0, 1.0, -1.0)
"""Directions of a valve that turns every 100 s."""


def estimates_after(e, mode, p=PARAMETERS, u=0.5, estimate=0.03, T_set=14.0, m_a=1.0):
    """Estimate after each sample."""
    samples = np.broadcast_arrays(e, mode, u, T_set, m_a)
    sign, memory, estimates = 1.0 - 2.0 * p.action, gradient.initial_memory(p), []
    now_set = np.append(samples[3][1:], samples[3][-1])
    for k, (e_k, mode_k, u_k, set_k, m_a_k) in enumerate(zip(*samples, strict=True)):
        T = set_k + sign * e_k
        now = Sample((k + 1) * p.sample_time, now_set[k], m_a_k, T, e_k, u_k, 0.5, mode_k, 0.0, estimate, 0.0)
        estimate, memory = gradient.update_estimate(now, p, memory)
        estimates.append(float(estimate))
    return np.array(estimates)


def test_only_what_lies_beyond_the_dead_zone_acts():
    parts = [gradient.outside_dead_zone(e, 0.05) for e in (0.05, -0.05, 0.25, -0.25, 0.0)]
    assert parts == pytest.approx([0.0, 0.0, 0.2, -0.2, 0.0], abs=1e-16)


def test_one_step_is_the_normalised_gradient_within_0_and_the_cap():
    expected = 0.03 + 3e-4 * 5.0 * 0.2 * 0.5 / 1.25
    assert gradient.gradient_step(0.03, 3e-4, 5.0, 0.2, 0.5, 0.2) == pytest.approx(expected, rel=1e-15)
    assert gradient.gradient_step(0.03, 1.0, 5.0, -0.2, 0.5, 0.2) == 0.0
    assert gradient.gradient_step(0.03, 1.0, 5.0, 0.2, 0.5, 0.2) == 0.2


@pytest.mark.parametrize("e", [0.5, -0.5])
@pytest.mark.parametrize("mode", [1.0, -1.0])
def test_without_a_reversal_nothing_moves_whatever_the_error(e, mode):
    assert np.all(estimates_after(np.full(400, e), mode) == 0.03)


@pytest.mark.parametrize("action", [0.0, 1.0])
def test_the_estimate_grows_where_the_opening_lags_and_shrinks_where_it_leads(action):
    """Too little is assumed: the error wants more opening while the valve rises.  The same for heating."""
    p = PARAMETERS._replace(action=action)
    assert estimates_after(0.3 * SWING, SWING, p)[-1] > 0.035
    assert estimates_after(-0.3 * SWING, SWING, p)[-1] < 0.025


def test_it_pauses_after_the_start_and_after_steps_of_set_point_and_air_flow():
    k = np.arange(400)

    def rests(**series):
        return set(np.flatnonzero(np.diff(estimates_after(0.3 * SWING, SWING, **series)) == 0.0).tolist())

    at_start = rests()
    assert at_start == set(range(79))
    for series in ({"T_set": np.where(k < 200, 14.0, 14.2)}, {"m_a": np.where(k < 200, 1.0, 1.06)}):
        later = rests(**series) - at_start
        assert 79 <= len(later) <= 80
        assert min(later) in (198, 199)
    # a fan that takes its time counts when it has come so far
    assert min(rests(m_a=1.0 + 0.06 * np.clip((k - 200) / 60.0, 0.0, 1.0)) - at_start) in range(248, 252)
    # drifts and small steps are none
    assert rests(T_set=14.0 + 0.019 * k, m_a=np.where(k < 200, 1.0, 1.04)) == at_start


@pytest.mark.kernel
@pytest.mark.parametrize("preset", ["paper_like", "lbnl"])
def test_it_climbs_towards_the_backlash_and_stays_near_0_without(preset, working_day):
    loop = fc.Loop.preset(preset).assign(estimator="gradient", backlash=[0.0, 0.07], noise_std=0.02, buffer=0.01)
    ds = fc.simulate(loop, working_day)
    good_valve, worn_valve = ds.estimate_settled.values
    assert good_valve < 0.01
    assert 0.02 < worn_valve < 0.08
    plain = fc.simulate(loop.assign(estimator="none"), working_day)
    assert np.all(ds.rmse < [1.02, 0.85] * plain.rmse)

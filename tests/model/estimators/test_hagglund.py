"""Hägglund's estimate: the formula on a square wave, the rules of acceptance, the running median, and what it finds."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.estimators import hagglund
from fastcoil.model.estimators.interface import Sample

KP, TI, PLANT_GAIN, SAMPLE_TIME_S = 0.03, 8.0, 25.0, 4.0
PARAMETERS = hagglund.Parameters(SAMPLE_TIME_S, KP, TI, PLANT_GAIN, 0.0, 0.0, 5.0)


def estimates_after(errors, p=PARAMETERS, u=0.5, estimate=0.0):
    """Estimate after each error, and the memory at the end."""
    memory, estimates = hagglund.initial_memory(p), []
    for k, e in enumerate(errors):
        t = (k + 1.0) * p.sample_time
        now = Sample(t, 14.0, 1.0, 14.0 + e, e, u, 0.5, 1.0, 0.0, estimate, 0.0)
        estimate, memory = hagglund.update_estimate(now, p, memory)
        estimates.append(float(estimate))
    return np.array(estimates), memory


def square_wave(half_periods, samples=15, size=0.4):
    """One zero crossing more than there are half periods."""
    signs = np.resize([1.0, -1.0], half_periods + 2)
    return np.repeat(size * signs, samples)[: (half_periods + 1) * samples + 1]


def test_a_square_wave_gives_the_value_of_the_formula():
    """The first half period has no crossing at its start: five more are needed."""
    estimates, memory = estimates_after(square_wave(5))
    d = KP * (60.0 / TI - 1.0 / (KP * PLANT_GAIN)) * 0.4
    assert estimates[-1] == pytest.approx(d, rel=1e-14)
    assert np.all(estimates[:-1] == 0.0)
    assert memory.n_counted == 5.0
    assert hagglund.final_metrics(hagglund.Memory(*np.transpose([memory])))["half_period_spread"] == 0.0


def test_a_half_period_counts_if_it_is_long_square_and_its_gap_possible():
    assert hagglund.is_evidence(40.0, 16.0, 0.79, TI, 0.05)
    assert not hagglund.is_evidence(39.9, 16.0, 0.4, TI, 0.05)
    assert not hagglund.is_evidence(40.0, 16.0, 0.8, TI, 0.05)
    assert not any(hagglund.is_evidence(40.0, 16.0, 0.4, TI, d) for d in (0.0, 1.0))
    assert not hagglund.is_evidence(np.nan, 16.0, 0.4, TI, 0.05)


def test_one_gap_ten_times_too_large_does_not_move_the_estimate():
    wave = square_wave(12)
    disturbed = wave.copy()
    disturbed[90:105] *= 2.9
    assert estimates_after(disturbed)[0][-1] == estimates_after(wave)[0][-1] > 0.0
    assert estimates_after(disturbed)[1].n_counted == 12.0


def test_an_estimate_that_acts_is_final_and_one_that_does_not_goes_on():
    growing = square_wave(12) * np.linspace(1.0, 3.0, 196)
    passive, memory = estimates_after(growing)
    acting, final = estimates_after(growing, PARAMETERS._replace(estimate_share=0.8))
    assert (memory.n_counted, final.n_counted) == (12.0, 5.0)
    assert acting[-1] == passive[passive > 0.0][0] < passive[-1]


@pytest.mark.parametrize("u", [0.0, 1.0])
def test_nothing_counts_while_u_is_at_an_end(u):
    estimates, memory = estimates_after(square_wave(8), u=u)
    assert memory.n_counted == 0.0
    assert np.all(estimates == 0.0)


@pytest.fixture(scope="module")
def passive(working_day):
    loop = fc.Loop.preset("paper_like_fast").assign(
        backlash=[0.0, 0.03, 0.07, 0.12], estimator="hagglund", plant_gain=25.0, estimate_share=[0.0, 0.8]
    )
    return fc.simulate(loop, working_day)


@pytest.mark.kernel
def test_it_finds_the_backlash_of_a_loop_that_hunts(passive):
    """0.7, 3.3, 7.5 and 12.6 % in an independent build."""
    reported_only = passive.sel(estimate_share=0.0)
    np.testing.assert_allclose(reported_only.estimate_settled, [0.003, 0.033, 0.075, 0.126], atol=0.007)
    assert np.all(reported_only.half_periods > 100)
    assert np.all(reported_only.time_identified.sel(backlash=[0.03, 0.07, 0.12]) < 8 * 3600)


@pytest.mark.kernel
def test_acting_it_takes_half_of_the_error_away_and_does_not_harm_a_good_valve(passive):
    error_ratio = passive.rmse.sel(estimate_share=0.8) / passive.rmse.sel(estimate_share=0.0)
    assert error_ratio.sel(backlash=0.07) < 0.6
    assert error_ratio.sel(backlash=0.0) == pytest.approx(1.0, abs=0.02)
    assert np.all(passive.half_periods.sel(estimate_share=0.8) == 10.0)

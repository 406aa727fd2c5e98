"""Intervals of a valve fit allow for what a meter gets wrong over a whole batch."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.simulated_logs import VALVE_TRUTH, add_noise, make_valve_log, random_walk, valve_flows

import fastcoil as fc
from fastcoil.measured.least_squares import Model, minimise, number_blocks, uncertainty, widen_by_blocks

pytestmark = pytest.mark.kernel


def fit_line(seed, n_batches, n, common):
    """A straight line with white noise of 1 and an error of its slope for each batch: fit and uncertainties."""
    rng = np.random.default_rng(seed)
    x, batch = rng.uniform(0.0, 1.0, n_batches * n), np.repeat(np.arange(n_batches), n)
    y = 2.0 + (3.0 + common * rng.normal(size=n_batches)[batch]) * x + rng.normal(size=x.size)
    model = Model(
        residuals=lambda sets: sets[0] + np.outer(x, sets[1]) - y[:, None],
        lower=np.full(2, -100.0), upper=np.full(2, 100.0), step=np.full(2, 1e-3),
        segment=batch, used=np.ones(x.size, dtype=bool),
    )  # fmt: skip
    best = minimise(model, np.array([[2.0], [3.0]]))
    spread = uncertainty(model, best)
    return best, spread, widen_by_blocks(model, best, spread)


def test_an_error_common_to_a_batch_widens_the_interval_to_its_true_size():
    """The scatter of the slope over 40 sets of 20 batches is what the blocks say, not the plain error."""
    fits = [fit_line(seed, 20, 50, 2.0) for seed in range(100, 140)]
    scatter = np.std([best.x[1] for best, _, _ in fits])
    plain_error, block_error = (np.mean([np.sqrt(fit[k].covariance[1, 1]) for fit in fits]) for k in (1, 2))
    assert plain_error < 0.5 * scatter
    assert block_error == pytest.approx(scatter, rel=0.25)
    assert (fits[0][2].inflation >= fits[0][1].inflation).all()


def test_the_blocks_are_the_pieces_or_cut_from_them():
    ones = np.ones(600, dtype=bool)
    of_pieces = number_blocks(np.repeat(np.arange(12), 50), ones, 300.0)
    np.testing.assert_array_equal(of_pieces, np.repeat(np.arange(12), 50))
    cut = number_blocks(np.repeat([0, 1], 300), ones, 100.0)
    assert np.unique(cut).size == 20
    assert not set(cut[:300]) & set(cut[300:])
    assert np.unique(number_blocks(np.zeros(600, dtype=int), ones, 1.0)).size == 8


def test_a_single_sample_has_no_blocks_to_draw():
    best, spread, _ = fit_line(1, 20, 50, 0.0)
    model = SimpleNamespace(segment=np.zeros(1000, dtype=int), used=np.arange(1000) < 1, n_common=2)
    assert widen_by_blocks(model, best, spread) is spread


def logs_with_batch_errors(seed, sd=0.06, n_batches=12, n=50):
    """Batches of a valve, the meter wrong by a share of its own in each."""
    rng = np.random.default_rng(seed)
    commands = [random_walk(rng, n=n) for _ in range(n_batches)]
    flows = (add_noise(rng, valve_flows(c, start=rng.uniform()), 0.02, 0.5) for c in commands)
    measured = [flow * (1.0 + rng.normal(0.0, sd)) for flow in flows]
    batch = np.repeat(np.arange(float(n_batches)), n)
    return make_valve_log(np.concatenate(commands), np.concatenate(measured), batch=batch)


@pytest.mark.full
def test_intervals_cover_where_the_meter_errs_by_batch():
    """60 logs of 12 batches, 6 % error of the meter by batch: 88 % or more of the intervals hold the truth."""
    hits = {"backlash": 0, "m_max": 0, "valve_c": 0}
    for seed in range(60):
        fit = fc.fit_valve(logs_with_batch_errors(5200 + seed), split=1.0, lag=0, holds="command")
        for name in hits:
            low, high = fit.intervals[name]
            hits[name] += low <= VALVE_TRUTH[name] <= high
    print(hits)
    assert min(hits.values()) >= 0.88 * 60, hits

"""The linear model behind a candidate backlash."""

import numpy as np
import pytest

from fastcoil.measured.grid import motor_positions
from fastcoil.measured.identify import MODEL_ERROR, likelihoods

CANDIDATES = np.array([0.0, 0.05, 0.1, 0.15])
INTERVAL = 30.0


def simulate_log(noise, play=0.1, n=600, seed=3):
    """Positions and temperatures of a first-order plant behind a play, a sample each half minute."""
    draw = np.random.default_rng(seed)
    positions = motor_positions(np.repeat(draw.uniform(0.2, 0.8, n // 10), 10), 1.0, 1.0)
    q, T, temperatures = positions[0], 14.0, []
    for position in positions[:-1]:
        q = min(max(q, position - play), position)
        T += 0.3 * (24.0 - 20.0 * q / (1 - play) - T)
        temperatures.append(T)
    return positions, np.array(temperatures) + noise * draw.standard_normal(n)


def test_the_likelihood_is_that_of_a_least_squares_fit_with_the_coefficients_integrated_out():
    """Bayesian linear regression, written out for one candidate: marginal likelihood against that without a stem."""
    positions, T = simulate_log(0.1)
    result = likelihoods(T, positions, (), np.ones(T.size, bool), INTERVAL, CANDIDATES)
    assert CANDIDATES[result.without_command.argmax()] == 0.1
    q, stem = min(max(positions[0] - 0.05, 0), 0.9), []
    for position in positions:
        q = min(max(q, position - 0.1), position)
        stem.append(q / 0.9)
    between = (np.array(stem)[1:] + np.array(stem)[:-1]) / 2
    rows = np.arange(10, T.size)  # 8 lags and the change itself need ten samples
    motor = (positions[1:] + positions[:-1]) / 2
    d, do, ds, dm = (np.diff(series) for series in (T, between, between**2, motor))
    Z = np.stack([d[rows - 1 - lag] for lag in range(1, 9)] + [np.ones(rows.size)], 1)
    y = d[rows - 1] - Z @ np.linalg.lstsq(Z, d[rows - 1], rcond=None)[0]
    freedom = rows.size - 9
    ridge = 0.01 * (y @ y) / freedom
    for stem_series, likelihood in (((do, ds), result.without_command), ((do, ds, dm), result.with_command)):
        X = np.stack([series[rows - 2 - lag] for series in stem_series for lag in range(4)], 1)
        X = X - Z @ np.linalg.lstsq(Z, X, rcond=None)[0]
        k = X.shape[1]
        residual = y @ y - X.T @ y @ np.linalg.solve(X.T @ X + ridge * np.eye(k), X.T @ y)
        # the best of the candidates explains most
        expected = -freedom / 2 * np.log((residual + MODEL_ERROR * (y @ y - residual)) / (y @ y))
        expected -= np.linalg.slogdet(np.eye(k) + X.T @ X / ridge)[1] / 2
        assert likelihood[2] == pytest.approx(expected, rel=1e-6)
    assert result.rows == rows.size


def test_a_clean_log_is_not_believed_beyond_what_a_linear_model_can_know():
    positions, T = simulate_log(1e-4)
    likelihood = likelihoods(T, positions, (), np.ones(T.size, bool), INTERVAL, CANDIDATES)
    assert likelihood.without_command.argmax() == 2
    largest = likelihood.rows / 2 * np.log(1 / MODEL_ERROR + 1) + 20
    assert likelihood.without_command[2] - likelihood.without_command[0] < largest


def test_a_stem_that_follows_the_command_explains_little_once_the_command_has_coefficients_of_its_own():
    positions, T = simulate_log(0.1, play=0.0)
    likelihood = likelihoods(T, positions, (), np.ones(T.size, bool), INTERVAL, CANDIDATES)
    assert likelihood.without_command.argmax() == 0
    without, with_command = (values[0] - values[2] for values in likelihood[:2])
    assert with_command < 0.3 * without


def test_a_known_disturbance_takes_what_it_explains():
    positions, T = simulate_log(0.02)
    gust, good = np.cumsum(np.random.default_rng(8).normal(0, 0.3, T.size)), np.ones(T.size, bool)
    alone, known = (likelihoods(T + gust, positions, d, good, INTERVAL, CANDIDATES) for d in ((), (gust,)))
    assert np.ptp(known.without_command) > 2 * np.ptp(alone.without_command)

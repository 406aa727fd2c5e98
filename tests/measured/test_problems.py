"""How a fit is computed: the loops of the emulator, the Jacobian from lanes, the minimum, the autocorrelation."""

import math

import numpy as np
import pytest
from helpers.simulated_logs import (
    COIL_TRUTH,
    VALVE_TRUTH,
    add_noise,
    ar1_noise,
    build_coil_problem,
    coil_log,
    make_valve_log,
    random_walk,
    valve_flows,
)

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.logs.columns import ColumnSpec
from fastcoil.measured.least_squares import FORBIDDEN_RESIDUAL, Model, autocorrelation, evaluate, minimise, uncertainty
from fastcoil.measured.part import fitting_mask
from fastcoil.measured.valve_problem import ValveProblem
from fastcoil.model.engine.recorded import valve_flows as run_valve

pytestmark = pytest.mark.kernel


def to_search_space(problem, values):
    """The parameters as the search sees them."""
    y = np.array([np.log(v) if name not in ("beta2", "beta4", "beta6") else v for name, v in values.items()])
    return np.linalg.solve(problem.record.coil_matrix(), y)


def assert_jacobian_is_of_single_runs(model, x):
    r, J = evaluate(model, x)
    np.testing.assert_array_equal(r, model.compared_residuals(x[:, None])[:, 0])
    for k in range(x.size):
        up, down = x.copy(), x.copy()
        up[k] += model.step[k]
        down[k] -= model.step[k]
        above, below = (model.compared_residuals(side[:, None])[:, 0] for side in (up, down))
        np.testing.assert_allclose(J[:, k], (above - below) / (up[k] - down[k]), rtol=1e-9, atol=1e-9)


def test_the_loop_is_that_of_the_emulator():
    """A valve alone and the valve of an open-loop simulation, to round-off."""
    command = np.repeat(random_walk(np.random.default_rng(13), n=60), 60)
    ds = fc.simulate(fc.Loop(), fc.paper_day(hours=1, seed=1), command=command, traces=["m_w", "opening"], warm_up=0)
    sets = np.array([[VALVE_TRUTH[n] for n in ("backlash", "m_max", "valve_a", "valve_b", "valve_c")]]).T
    # the emulator starts with the gear at 0
    command0 = np.concatenate([[0.0], command])
    openings, valve_flow = np.empty((3601, 1)), np.empty((3601, 1))
    run_valve(command0, np.zeros(3601, dtype=np.int64), sets, np.zeros((1, 1)), openings, valve_flow)
    np.testing.assert_allclose(valve_flow[1:, 0], ds["m_w"], rtol=1e-13)
    np.testing.assert_allclose(openings[1:, 0], ds["opening"], atol=1e-15)
    assert np.allclose(valve_flows(command0), valve_flow[:, 0], rtol=1e-13)


def test_the_jacobian_of_a_valve_is_that_of_single_runs():
    rng = np.random.default_rng(14)
    command = random_walk(rng, n=120)
    log = make_valve_log(command, add_noise(rng, valve_flows(command), 0.01), batch=np.repeat([0.0, 1.0, 2.0, 3.0], 30))
    data = read_checked_log(log, ColumnSpec(required=("command", "m_w")))
    problem = ValveProblem(data, fitting_mask(data, 1.0))
    x = np.array([0.05, math.log(2.1), math.log(0.8), math.log(8.0), 0.4, 0.3, 0.5, 0.6, 0.7])
    assert_jacobian_is_of_single_runs(problem.model(), x)


def test_autocorrelation_of_an_ar_process_gives_its_effective_size():
    rng = np.random.default_rng(15)
    n, phi = 20000, 0.8
    rho = autocorrelation(ar1_noise(rng, n, 1.0, phi), np.zeros(n, dtype=np.int64), np.ones(n, dtype=bool))
    assert 1.0 + 2.0 * rho.sum() == pytest.approx((1 + phi) / (1 - phi), rel=0.15)
    assert abs(autocorrelation(rng.normal(size=n), np.zeros(n, dtype=np.int64), np.ones(n, dtype=bool)).sum()) < 0.1


def test_errors_allow_for_residuals_that_follow_each_other():
    """The scatter of a slope over 60 draws of AR(1) noise, not the fifth of it that white noise would give."""
    n, x = 400, np.linspace(-1.0, 1.0, 400)
    slopes, errors, white_errors = [], [], []
    for seed in range(60):
        y = ar1_noise(np.random.default_rng(seed), n, 1.0, 0.9)
        model = Model(
            lambda sets, y=y: np.outer(x, sets[0]) - y[:, None], np.array([-9.0]), np.array([9.0]), np.array([1e-3]),
            np.zeros(n, dtype=np.int64), np.ones(n, dtype=bool),
        )  # fmt: skip
        best = minimise(model, np.zeros((1, 1)))
        spread = uncertainty(model, best)
        slopes.append(best.x[0])
        errors.append(np.sqrt(spread.covariance[0, 0]))
        white_errors.append(np.sqrt(spread.covariance[0, 0] / spread.inflation[0]))
    assert np.mean(errors) == pytest.approx(np.std(slopes), rel=0.25)
    assert np.mean(white_errors) < 0.35 * np.std(slopes)


@pytest.mark.parametrize("form", [{}, {"n_volumes": 4}, {"air_march": "quasistatic"}])
def test_the_coil_alone_is_that_of_the_emulator(form):
    log = coil_log(hours=0.5, sd=0.0, **form)
    problem = build_coil_problem(log, 600.0, **form)
    x = to_search_space(problem, COIL_TRUTH)
    T_sup, T_w_out, wet = problem.record.run(np.repeat(x[:, None], 3, axis=1)).values()
    np.testing.assert_allclose(T_sup[:, 1], log["T_sup"], atol=1e-9)
    np.testing.assert_allclose(T_w_out[:, 2], log["T_w_out"], atol=1e-9)
    assert wet.max() > 0


def test_the_jacobian_of_a_coil_is_that_of_single_runs():
    problem = build_coil_problem(coil_log(hours=0.5), 600.0)
    assert_jacobian_is_of_single_runs(problem.model(), to_search_space(problem, COIL_TRUTH) + 0.05)


def test_an_unstable_trial_set_gets_a_large_residual_and_its_neighbours_do_not():
    problem = build_coil_problem(coil_log(hours=0.5), 600.0)
    model = problem.model()
    good = to_search_space(problem, COIL_TRUTH)
    bad = to_search_space(problem, COIL_TRUTH | {"C_c": 1.5})
    r = model.compared_residuals(np.stack([good, bad, good], axis=1))
    assert (np.abs(r[model.used, 1]) == FORBIDDEN_RESIDUAL).all()
    np.testing.assert_array_equal(r[:, 0], r[:, 2])
    assert np.abs(r[:, 0]).max() < 1.0

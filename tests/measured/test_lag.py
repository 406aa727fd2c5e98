"""A time shift between the columns of a log that is given is taken out."""

import numpy as np
import pytest
from helpers.full import full_except
from helpers.refusals import assert_refused
from helpers.simulated_logs import VALVE_TRUTH, ar1_noise, make_valve_log, random_walk, valve_flows

import fastcoil as fc

pytestmark = pytest.mark.kernel


def log_in_pieces(seed, shifts, n=60, sd=0.03, backlash=0.07):
    """Batches of ``n`` rows of a valve, the flow of each logged so many rows late."""
    rng = np.random.default_rng(seed)
    commands, logged = [], []
    for shift in shifts:
        command = random_walk(rng, n=n + 40)
        flow = valve_flows(command, start=rng.uniform(), backlash=backlash) + ar1_noise(rng, n + 40, sd, 0.5)
        commands.append(command[20 : n + 20])
        logged.append(np.maximum(flow[20 - shift : n + 20 - shift], 1e-3))
    batch = np.repeat(np.arange(float(len(shifts))), n)
    return make_valve_log(np.concatenate(commands), np.concatenate(logged), batch=batch)


@pytest.mark.parametrize(("shift", "lag"), full_except([(1, 60.0), (-1, -60.0), (0, -60.0)], [(-1, -60.0)]))
def test_nothing_that_is_held_back_changes_a_bit_of_the_fit(shift, lag):
    """Neither flows nor commands, also where a flow is logged before its command and that one is held back."""
    log, other_log = (log_in_pieces(seed, [shift], n=300) for seed in (7, 8))
    for name in ("command", "m_w"):
        other_log[name][:180] = log[name][:180]
    fit_1, fit_2 = (fc.fit_valve(data, split=0.6, lag=lag, holds="command") for data in (log, other_log))
    for name in ("parameters", "intervals", "standard_errors", "held", "n_used", "n_effective"):
        assert getattr(fit_1, name) == getattr(fit_2, name), name
    assert fit_1.rmse["fit"] == fit_2.rmse["fit"]
    assert fit_1.profile.identical(fit_2.profile)
    assert fit_1.rmse["validation"] != fit_2.rmse["validation"]


def test_a_given_lag_is_taken_as_it_is():
    log = log_in_pieces(4, [2, 2, 2])
    fit = fc.fit_valve(log, split=1.0, lag=np.float32(120.0), holds="command")
    assert "the flow is compared with the command 120 s before it, as given" in fit.notes
    assert fit.parameters["backlash"] == pytest.approx(VALVE_TRUTH["backlash"], abs=0.01)
    assert (fit.residuals["part"].values[:2] == "unused").all()  # no row says what the command was
    for wrong in ("later", True, 1e9, [60.0]):
        assert_refused("lag", "value" if wrong == 1e9 else "type", fc.fit_valve, log, lag=wrong)


def test_the_right_lag_has_the_smallest_error_of_the_fitted_part():
    log = log_in_pieces(2, [1] * 4)
    rmse = {lag: fc.fit_valve(log, lag=lag, holds="command").rmse["fit"] for lag in (-60.0, 0.0, 60.0, 120.0)}
    assert min(rmse, key=rmse.get) == 60.0
    assert rmse[60.0] < 0.7 * min(rmse[0.0], rmse[120.0])

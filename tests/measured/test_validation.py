"""Fits that are validated with a second log, joined to the first."""

import numpy as np
import pytest
from helpers.simulated_logs import (
    add_noise,
    assert_covered,
    coil_log,
    join_logs,
    make_valve_log,
    random_walk,
    shift_log,
    valve_flows,
)

import fastcoil as fc
from fastcoil.measured.fit import fit_warnings

pytestmark = pytest.mark.kernel


def join_batches(*logs):
    """Join logs of valves, with different numbers in ``batch``."""
    numbered = [
        log.assign(batch=("elapsed_time", np.full(log.sizes["elapsed_time"], k), {"units": "1"}))
        for k, log in enumerate(logs)
    ]
    return fc.read_log(join_logs(*numbered), jumps="split")


def first_share(first, second):
    n = first.sizes["elapsed_time"]
    return n / (n + second.sizes["elapsed_time"])


@pytest.fixture(scope="module")
def two_days():
    return coil_log(hours=1.5, seed=41), shift_log(coil_log(hours=1.5, seed=42), 20000.0)


@pytest.fixture(scope="module")
def validated(two_days):
    return fc.fit_coil(join_logs(*two_days), split=0.5)


def test_a_coil_is_validated_with_a_second_log(two_days, validated):
    fit, alone = validated, fc.fit_coil(two_days[0], split=1.0)
    assert fit.parameters == alone.parameters
    assert fit.intervals == alone.intervals
    assert fit.rmse["validation"] == pytest.approx(0.05, rel=0.1)
    ds = fit.residuals
    assert set(ds["part"].values[:5400]) == {"unused", "fit"}
    assert set(ds["part"].values[5400:]) == {"unused", "validation"}
    assert "nothing was held back: the fit is not validated" in alone.notes


def test_a_valve_is_validated_with_a_second_log():
    rng = np.random.default_rng(23)
    logs = [make_valve_log(c := random_walk(rng), add_noise(rng, valve_flows(c, start=s), 0.02)) for s in (0.3, 0.9)]
    fit = fc.fit_valve(join_batches(*logs), split=0.5)
    assert fit.parameters == fc.fit_valve(logs[0], split=1.0).parameters
    assert_covered(fit)
    assert fit.rmse["validation"] == pytest.approx(0.02, rel=0.2)
    other_valve = make_valve_log(c := random_walk(rng), valve_flows(c, backlash=0.2))
    notes = fc.fit_valve(join_batches(logs[0], other_valve), split=0.5).notes
    assert any("the validation error is" in note for note in notes)


def test_what_a_valve_is_validated_with_has_no_influence_on_its_fit():
    """Logs with larger flows, a floor, longer holds and intervals, a pump that is off: they change no bit."""
    rng = np.random.default_rng(25)
    command = np.repeat(random_walk(rng, n=40, top=0.6), 4)
    flow = np.maximum(add_noise(rng, valve_flows(command), 0.02), 0.1)
    flow[np.argsort(command)[-8:-4]] = 0.1  # the pump is off
    log, options = make_valve_log(command, flow), {"lag": 0, "holds": "command"}
    alone = fc.fit_valve(log, split=1.0, **options)
    assert any("flows left out, sensor or pump off" in note for note in alone.notes)
    assert any("taken as its floor" in note for note in alone.notes)
    assert any("flows not compared: less than 120 s" in note for note in alone.notes)
    long_holds = np.repeat(rng.permutation(np.linspace(0.0, 1.0, 80)), 10)
    for second_log in (
        make_valve_log(long_holds, np.where(long_holds < 0.5, 5e-4, 3.0 * valve_flows(long_holds)), interval=600.0),
        make_valve_log(long_holds, np.where(long_holds < 0.9, 0.1, 1.0)),
    ):
        fit = fc.fit_valve(join_batches(log, second_log), split=first_share(log, second_log), **options)
        assert fit.parameters == alone.parameters
        assert fit.intervals == alone.intervals
        assert fit.rmse["fit"] == alone.rmse["fit"]
        assert fit.n_used == alone.n_used


def test_scales_and_limits_of_a_coil_come_from_the_part_to_fit(two_days, validated):
    """A second log with five times the flows: the same fit would be unstable there, and says so."""
    first, second = two_days
    large = second.assign(m_w=5.0 * second["m_w"], m_a=5.0 * second["m_a"])
    fit = fc.fit_coil(fc.read_log(join_logs(first, large), units={"m_w": "kg/s", "m_a": "kg/s"}), split=0.5)
    assert fit.parameters == validated.parameters
    assert set(fit.rmse) == {"fit", "fit_T_w_out"}
    assert np.isnan(fit.residuals["T_sup_modelled"][5400:]).all()
    assert any(note.startswith("not validated: the coil is unstable at the flows") for note in fit.notes)
    assert len(fit.plot().axes) == 2


def test_a_model_that_explains_little_is_noted_and_a_fit_to_round_off_is_not_called_worse_in_validation():
    two = np.array([10.0, 20.0])
    for fit_rmse in (0.0, 1e-13):
        assert fit_warnings({"fit": fit_rmse, "validation": 3e-13}, two, "T_sup", "units") == []
    (_, warning) = fit_warnings({"fit": 4.0}, two, "T_sup", "units")
    assert "explains only 36 % of the variance of T_sup: check units" in warning

"""Columns that do not belong together, in one unit or in one order, are refused or lead to no claim."""

import re

import numpy as np
import pytest
import xarray as xr
from helpers.full import full_except
from helpers.loop_logs import make_loop_log
from helpers.refusals import assert_mistakes, assert_refused
from helpers.simulated_logs import coil_log, noisy_valve_log, random_walk

import fastcoil as fc
from fastcoil.measured.agreement import imply_pi

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def log():
    return make_loop_log(hours=3.0, kp=0.03, ti=40.0)


def test_a_log_of_two_units_or_of_a_row_a_day_is_refused(log):
    fahrenheit = log.assign(T_set=1.8 * log.T_set + 32.0)
    assert_refused("T_sup", "unit", fc.diagnose, fc.read_log(fahrenheit, units={"T_set": "degC"}), stroke_time=90.0)
    days = ("elapsed_time", 86400.0 * np.arange(20), {"units": "s"})
    daily = log.isel(elapsed_time=slice(None, 20)).assign_coords(elapsed_time=days)
    assert_refused("log", "time", fc.diagnose, daily, stroke_time=90.0)


def test_a_temperature_far_from_its_set_point_that_no_unit_explains_is_a_warning(log):
    diagnosis = fc.diagnose(log.assign(T_set=log.T_set + 20.0), stroke_time=90.0)
    assert any("T_sup 14" in warning and "do not agree: check the columns" in warning for warning in diagnosis.warnings)


def test_a_switch_that_is_logged_now_and_then_is_named_where_it_leaves_nothing(log):
    sparse = np.where(np.arange(log.sizes["elapsed_time"]) % 100, np.nan, 1.0)
    source, named = log.assign(enabled=("elapsed_time", sparse)), {"enabled": "enabled"}
    assert_refused("log", "data", fc.diagnose, fc.read_log(source, drop=True, columns=named))


def test_a_coil_whose_air_is_colder_than_its_water_is_refused():
    log = coil_log(hours=1.0, every=10)
    assert_refused("T_sup", "unit", fc.fit_coil, log.assign(T_sup=log.T_sup - 20.0))


@pytest.mark.parametrize("dry", [False, True], ids=["wet", "dry"])
def test_flows_whose_heat_differs_are_refused_with_the_ratio(dry):
    log = coil_log(hours=1.0, every=10, dry=dry)
    T_w, T_a = (log[name].values for name in ("T_w_in", "T_a_in"))
    ratio = np.median(4.186 * log.m_w * (log.T_w_out - T_w) / (1.02 * log.m_a * (T_a - log.T_sup)))
    for factor in (60.0, 15.85, 1 / 15.85):  # L/min and gpm under kg/s, and kg/s under gpm
        wrong = log.assign(m_w=(factor * log.m_w).assign_attrs(units="kg/s"))
        error = assert_refused("m_w", "unit", fc.fit_coil, wrong)
        reported = float(re.search(r"takes up ([\d.e-]+) times the heat of the air", str(error))[1])
        assert reported == pytest.approx(factor * ratio, rel=0.03 if dry else 0.5)
    for factor in (60.0, 1 / 60):
        without_outlet = log.drop_vars("T_w_out").assign(m_w=(factor * log.m_w).assign_attrs(units="kg/s"))
        assert_refused("m_w", "unit", fc.fit_coil, without_outlet)


def test_no_size_is_claimed_of_a_command_that_does_not_answer_this_temperature(log):
    """The command and set-point of one loop, the temperature of another on the same schedule."""
    assert fc.diagnose(log, stroke_time=90.0).identified
    other_loop = make_loop_log(hours=3.0, kp=0.03, ti=40.0, backlash=0.03, noise=0.02)
    diagnosis = fc.diagnose(log.assign(T_sup=other_loop.T_sup), stroke_time=90.0)
    assert not diagnosis.identified
    assert "% of the command's changes: check that both belong to the same loop and the same clock" in diagnosis.reason


@pytest.mark.parametrize("late", [-6, 0, 4])
def test_the_law_that_a_command_implies_shows_the_shift_of_the_clocks(late):
    """A calm loop: in a swing a shift is a change of phase, which another ti gives as well."""
    log = make_loop_log(kp=0.01, ti=120.0, noise=0.05, sample_time=10.0)
    command, T, T_set = (log[name].values for name in ("command", "T_sup", "T_set"))
    law = imply_pi(command, np.roll(T, late), np.roll(T_set, late), np.ones(T.size, bool), 10.0)
    assert law.temperature_lag == late
    assert law.explained > 0.99 > law.least_explained


@pytest.mark.parametrize("with_set_point", [True, False])
def test_the_law_of_a_log_backwards_has_a_negative_integral_time(with_set_point):
    """Δu = kp (Δe + ∫e dt / ti): from last to first the changes change sign, the integral does not."""
    log = make_loop_log(kp=0.02, ti=80.0, noise=0.02, sample_time=10.0)
    command, T, T_set = (log[name].values for name in ("command", "T_sup", "T_set"))
    for direction in (1, -1):
        set_point = T_set[::direction] if with_set_point else None
        law = imply_pi(command[::direction], T[::direction], set_point, np.ones(T.size, bool), 10.0)
        assert law.explained > law.least_explained
        assert direction * law.ti == pytest.approx(80.0, rel=0.2)


def test_what_a_law_leaves_of_its_own_temperature_is_noise_and_of_another_one_is_not():
    """The other temperature follows the own one but for a slow difference that explains little."""
    draw, n, window = np.random.default_rng(3), 1440, np.hanning(18)
    fast = np.convolve(draw.normal(0.0, 1.0, n + 7), np.ones(8) / 8**0.5, "valid")
    slow = np.convolve(draw.normal(0.0, 0.1, n + 17), window, "valid")
    command = 0.5 + 0.005 * (fast + np.cumsum(fast - fast.mean()) * 60.0 / 600.0)
    for difference, is_another in ((draw.normal(0.0, 0.1, n), False), (slow, True)):
        law = imply_pi(command, fast + difference, np.zeros(n), np.ones(n, bool), 60.0)
        assert 0.97 < law.explained < 0.995
        assert law.is_another == is_another


def test_labels_that_would_be_dropped_are_refused(log):
    assert_refused("stroke_time", "type", fc.diagnose, log, xr.DataArray(1.5, attrs={"units": "min"}))
    for series in (log.command, log.command.to_series()):
        assert_refused("log", "type", fc.diagnose, series)
    two_days = [(name, "shape") for name in ("command", "T_sup", "T_set")]
    assert_mistakes(two_days, fc.diagnose, log.expand_dims(day=[1, 2]))


def test_time_in_minutes_and_temperatures_in_fahrenheit_are_converted(log):
    minutes = log.assign_coords(elapsed_time=("elapsed_time", log.elapsed_time.values / 60, {"units": "min"}))
    fahrenheit = minutes.assign(T_sup=("elapsed_time", log.T_sup.values * 1.8 + 32.0, {"units": "degF"}))
    assert fc.diagnose(fahrenheit, stroke_time=90.0).backlash == fc.diagnose(log, stroke_time=90.0).backlash


@pytest.mark.parametrize("name", full_except(["diagnose", "fit_valve", "fit_coil", "replay"], ["fit_valve", "replay"]))
def test_numpys_error_state_changes_nothing(log, name):
    rng = np.random.default_rng(5)
    command = random_walk(rng, n=80)
    coil = coil_log(hours=1.0, every=10)
    valve = noisy_valve_log(rng, command, 0.02)
    calls = {
        "diagnose": lambda: fc.diagnose(make_loop_log(hours=30.0, kp=0.03, ti=40.0), stroke_time=90.0).profile,
        "fit_valve": lambda: fc.fit_valve(valve, holds="command").profile,
        "fit_coil": lambda: fc.fit_coil(coil).residuals,
        "replay": lambda: fc.replay(fc.Loop(), log[["T_sup", "T_set"]]),
    }
    with np.errstate(all="raise"):
        assert calls[name]().sizes

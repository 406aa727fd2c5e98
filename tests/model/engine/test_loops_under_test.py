"""The valve test in the loop: its commands, its end, and the PI after it."""

import numpy as np
import pytest
from reference.valve_test import valve_test, wait_for_calm_air

import fastcoil as fc

pytestmark = pytest.mark.kernel
START = 5400
TRACES = ["T_measured", "command", "u", "integral", "mode", "test"]
CALM_LOOP = {"kp": 0.02, "ti": 120.0, "noise_std": 0.01, "stroke_time": 60.0}


@pytest.fixture(scope="module")
def steady_day():
    """Three hours at one set-point."""
    return fc.Boundary(**{**fc.paper_day(hours=3, seed=3).series, "T_set": 14.0}).isel(0)


def simulate_test(day, test: fc.ValveTest | None = None, **parameters):
    """Simulate a loop with a test, recording all TRACES."""
    test = fc.ValveTest(start=START) if test is None else test
    loop = fc.Loop.preset("lbnl").assign(**CALM_LOOP | {"sample_time": 5} | parameters)
    return fc.simulate(loop, day, test=test, traces=TRACES, seed=1)


@pytest.mark.parametrize(
    ("kind", "parameters", "test"),
    [
        ("cooling", {"backlash": 0.08}, {}),
        ("cooling", {"backlash": 0.0, "sample_time": 30}, {"minutes": 30}),
        ("cooling", {"backlash": 0.05, "backlash_estimate": 0.04}, {"settle": 200, "hold": 45}),
        ("cooling", {"backlash": 0.03, "sensor_resolution": 0.05}, {"threshold": 0.1, "rate": 3e-4, "excursion": 0.6}),
        ("heating", {"backlash": 0.06, "kp": 0.006, "action": "heating"}, {"excursion": 3.0}),
    ],
)
def test_the_command_is_that_of_a_script_on_the_same_temperatures(steady_day, kind, parameters, test):
    day = steady_day
    if kind == "heating":
        day = fc.constant_day(hours=3, T_a_in=5.0, T_w_in=45.0, T_set=25.0, relative_humidity=0.3)
    test = fc.ValveTest(start=START, **test)
    ds = simulate_test(day, test, **parameters)
    sample_time = int(parameters.get("sample_time", 5))
    samples = ds.isel(elapsed_time=slice(None, None, sample_time))
    first = START // sample_time
    sign = -1.0 if kind == "heating" else 1.0
    errors = sign * (samples.T_measured.values[first:] - float(day.series["T_set"][0, 0]))
    before = samples.command.values[:first]
    mean = before[0]
    for command in before[1:]:
        mean += sample_time / (600 + sample_time) * (command - mean)
    held = mean if abs(before[-1] - mean) > 0.05 else before[-1]
    names = ("minutes", "rate", "threshold", "settle", "hold", "excursion")
    test_parameters = {name: test.parameters()[f"test_{name}"] for name in names}
    commands, end_reason = valve_test(errors, held, sample_time, **test_parameters)
    np.testing.assert_allclose(samples.command.values[first : first + len(commands)], commands, rtol=0, atol=1e-12)
    is_running = samples.test.values > 0
    assert np.flatnonzero(is_running).tolist() == list(range(first, first + len(commands)))
    assert abort_reason(ds) == (end_reason or "no")
    assert len(commands) > 20


@pytest.mark.parametrize("compensation", ["inverse", "additive", "smooth"])
@pytest.mark.parametrize("estimate", [0.0, 0.06])
def test_the_pi_goes_on_without_a_bump(steady_day, compensation, estimate):
    """A PI that turns at the end crosses the gap; the smooth inverse starts from its middle."""
    turned = []
    for minutes in (16, 17, 18, 19, 20):
        test = fc.ValveTest(start=START, minutes=minutes)
        ds = simulate_test(steady_day, test, backlash=0.06, backlash_estimate=estimate, compensation=compensation)
        end = int(np.flatnonzero(ds.test.values)[-1])
        after = end + 1
        e = ds.T_measured.values - 14.0
        kp, ki = CALM_LOOP["kp"], CALM_LOOP["kp"] * 5 / CALM_LOOP["ti"]
        step = kp * abs(e[after] - e[after - 5]) + ki * abs(e[after])
        assert abs(ds.u.values[after] - ds.u.values[end]) <= step + 1e-12
        turned.append(ds.mode.values[after] != ds.mode.values[end])
        crossed = estimate * (0.5 if compensation == "smooth" else turned[-1])
        assert abs(ds.command.values[after] - ds.command.values[end]) <= step + crossed + 1e-12
    assert not all(turned)


def test_the_set_point_of_the_start_counts(steady_day):
    moved = steady_day.assign(T_set=np.where(np.arange(10800) < START + 300, 14.0, 15.0))
    constant_run, moved_run = simulate_test(steady_day, backlash=0.05), simulate_test(moved, backlash=0.05)
    is_running = constant_run.test.values > 0
    np.testing.assert_array_equal(constant_run.command.values[is_running], moved_run.command.values[is_running])
    assert not np.array_equal(constant_run.command.values, moved_run.command.values)


def abort_reason(ds):
    return ds.test_aborted.attrs["flag_meanings"].split()[int(ds.test_aborted)]


def test_it_ends_where_the_temperature_leaves_its_limits_and_the_pi_goes_on(steady_day):
    hot = steady_day.assign(T_a_in=steady_day.series["T_a_in"][0] + np.where(np.arange(10800) > START + 400, 6.0, 0.0))
    ds = simulate_test(hot, backlash=0.05)
    end = int(np.flatnonzero(ds.test.values)[-1])
    assert abort_reason(ds) == "excursion"
    assert abs(ds.T_measured.values[end + 1] - 14.0) > 1.5 > abs(ds.T_measured.values[end - 4] - 14.0)
    assert ds.command.values[end + 600] > ds.command.values[end]


def test_it_ends_where_water_swings_while_the_command_is_held(steady_day):
    swing = steady_day.series["T_w_in"][0] + 3.0 * np.sin(2 * np.pi * np.arange(10800) / 200)
    ds = simulate_test(steady_day.assign(T_w_in=swing), fc.ValveTest(start=START, excursion=5.0), backlash=0.05)
    assert abort_reason(ds) == "swing"
    assert ds.test.values.sum() <= 60


@pytest.mark.parametrize("compensation", ["inverse", "additive", "smooth"])
def test_it_ends_where_a_shut_valve_leaves_the_air_too_cold(steady_day, compensation):
    cold = steady_day.assign(T_a_in=np.where(np.arange(10800) > START - 3000, 13.0, 25.0), W_a_in=0.006)
    ds = simulate_test(cold, backlash=0.05, backlash_estimate=0.05, compensation=compensation)
    assert abort_reason(ds) == "end_of_stroke"


def test_it_ends_where_the_loop_goes_off(steady_day):
    seconds = np.arange(10800)
    enabled = np.where((seconds > START + 302) & (seconds < START + 900), 0.0, 1.0)
    ds = simulate_test(steady_day.assign(enabled=enabled), backlash=0.05)
    assert abort_reason(ds) == "disabled"
    assert np.flatnonzero(ds.test.values)[-1] == START + 302
    assert (ds.command.values[START + 303 : START + 900] == 0.0).all()


@pytest.mark.parametrize(("share", "period", "waits"), [(0.03, 1200, False), (0.3, 2400, True), (0.3, 600, None)])
def test_it_waits_for_calm_air_and_moves_nothing_if_none_comes(steady_day, share, period, waits):
    seconds = np.arange(10800)
    air = 1.2 * (1.0 + share * np.sin(2 * np.pi * (seconds - START) / period))
    day = steady_day.assign(m_a=air)
    begin = wait_for_calm_air(air[::5], 5, START // 5)
    ds = simulate_test(day, backlash=0.05)
    if waits is None:
        assert begin is None
        assert abort_reason(ds) == "varying_air"
        assert not ds.test.values.any()
        loop = fc.Loop.preset("lbnl").assign(**CALM_LOOP | {"sample_time": 5, "backlash": 0.05})
        alone = fc.simulate(loop, day, traces=["command"], seed=1)
        np.testing.assert_array_equal(ds.command.values, alone.command.values)
    else:
        assert np.flatnonzero(ds.test.values)[0] == 5 * begin
        assert (5 * begin > START) == waits
        assert ds.test.values.sum() == 1200


def test_air_before_the_day_counts_as_calm(steady_day):
    ds = simulate_test(steady_day, fc.ValveTest(start=60, excursion=50.0), backlash=0.05)
    assert np.flatnonzero(ds.test.values)[0] == 60


def test_lanes_without_a_test_keep_their_bits_beside_lanes_with_one(steady_day):
    loop = fc.Loop.preset("lbnl").assign(**CALM_LOOP, sample_time=5, backlash=0.05)
    alone = fc.simulate(loop, steady_day, traces=["command"])
    with pytest.warns(UserWarning, match="there is no test"):
        beside = fc.simulate(loop.assign(test_start=[5400, 1e6]), steady_day, traces=["command", "test"])
    np.testing.assert_array_equal(beside.command.sel(test_start=1e6).values, alone.command.values)
    assert beside.test.sum("elapsed_time").values.tolist() == [1200.0, 0.0]
    assert (beside.test_aborted == 0).all()


def test_a_loop_that_swings_widely_is_held_at_its_mean_and_calms_down(steady_day):
    ds = simulate_test(steady_day, fc.ValveTest(start=START, settle=300, excursion=3), backlash=0.1, kp=0.06, ti=8.0)
    before = ds.command.values[START - 600 : START]
    assert np.ptp(before) > 0.3
    held = ds.command.values[START]
    assert abs(held - before.mean()) < 0.1 * np.ptp(before)
    assert (ds.command.values[START : START + 300] == held).all()
    T = ds.T_measured.values
    assert np.ptp(T[START - 600 : START]) > 2.0 > np.ptp(T[START + 200 : START + 300])
    assert abort_reason(ds) == "no"


@pytest.mark.parametrize("estimator", ["learner", "gradient", "hagglund"])
def test_estimators_pause_during_a_test(steady_day, estimator):
    parameters = {"learning_step": 0.005, "learning_interval": 600} if estimator == "learner" else {"plant_gain": 15.0}
    loop = fc.Loop.preset("lbnl").assign(sample_time=5, backlash=0.08, kp=0.06, ti=20, noise_std=0.02, **parameters)
    test = fc.ValveTest(start=START, excursion=5.0)
    ds = fc.simulate(loop.assign(estimator=estimator), steady_day, test=test, traces=["estimate", "test"], seed=1)
    during = ds.estimate.values[ds.test.values > 0]
    assert np.unique(during).size == 1
    assert np.unique(ds.estimate.values).size > 1


@pytest.mark.parametrize(("every", "tested"), [(0.0, [1, 0, 0, 0]), (0.25, [1, 0, 1, 0]), (0.125, [1, 1, 1, 1])])
def test_days_in_sequence_are_tested_as_often_as_asked(every, tested):
    days = fc.paper_day(hours=3, seed=[1, 2, 3, 4])
    loop = fc.Loop.preset("lbnl").assign(**CALM_LOOP, sample_time=5, backlash=0.05)
    test = fc.ValveTest(start=START, every=every, minutes=10, excursion=5.0)
    ds = fc.simulate(loop, days, test=test, traces=["test"], carry_over=True)
    assert (ds.test.sum("elapsed_time").values / 600).tolist() == tested


@pytest.mark.parametrize("size", [0.0, 0.04, 0.1])
def test_identify_learns_from_a_test_what_a_steady_day_does_not_tell(steady_day, size):
    loop = fc.Loop.preset("lbnl").assign(**CALM_LOOP, sample_time=5, backlash=size, estimator="identify")
    test = fc.ValveTest(start=START, minutes=45)
    without = fc.simulate(loop, steady_day, traces=["estimate"], seed=1)
    ds = fc.simulate(loop, steady_day, test=test, traces=["estimate", "test"], seed=1)
    assert float(without.estimate_final) == 0.0
    assert abs(float(ds.estimate_final) - size) <= max(0.2 * size, 0.01)
    assert (ds.estimate.values[:START] == 0.0).all()
    assert np.unique(ds.estimate.values[START + 45 * 60 + 1200 :]).size == 1

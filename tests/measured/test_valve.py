"""fit_valve: known valves are found within the stated intervals, and a backlash that is not identified says why."""

import tomllib

import numpy as np
import pandas as pd
import pytest
from helpers.shared_data import measured_file
from helpers.simulated_logs import add_noise, assert_covered, make_valve_log, noisy_valve_log, random_walk, valve_flows

import fastcoil as fc
from fastcoil.measured.fit_valve import has_live_zero

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize(("phi", "seed"), [(0.0, 2), (0.9, 5)])
def test_known_valves_with_white_and_autocorrelated_noise_are_found_within_the_intervals(phi, seed):
    rng = np.random.default_rng(seed)
    fit = fc.fit_valve(noisy_valve_log(rng, random_walk(rng, n=800), 0.03, phi, start=0.7))
    assert_covered(fit)
    assert fit.intervals["backlash"][1] - fit.intervals["backlash"][0] < 0.03
    assert (fit.n_effective < 0.5 * fit.n_used) == (phi > 0.5)


def test_rows_that_repeat_the_last_poll_make_no_interval_narrower():
    rng = np.random.default_rng(9)
    polled = noisy_valve_log(rng, random_walk(rng, n=400), 0.03)
    command, flow = (np.repeat(polled[name].values, 3) for name in ("command", "m_w"))
    fits = [fc.fit_valve(log) for log in (polled, make_valve_log(command, flow, interval=20.0))]
    widths = [np.ptp(fit.intervals["backlash"]) for fit in fits]
    assert widths[1] == pytest.approx(widths[0], rel=0.15)
    assert "m_w has values of its own only every 60 s: the rows between do not count" in fits[1].notes


def test_batches_start_anywhere_within_their_backlash():
    rng = np.random.default_rng(6)
    parts = [random_walk(rng, n=60) for _ in range(8)]
    flow = np.concatenate([valve_flows(c, start=s) for c, s in zip(parts, np.linspace(0, 1, 8), strict=True)])
    batch = np.repeat(np.arange(8.0), 60)
    fit = fc.fit_valve(make_valve_log(np.concatenate(parts), add_noise(rng, flow, 0.01), batch=batch), split=0.7)
    assert_covered(fit)
    assert fit.rmse["fit"] == pytest.approx(0.01, rel=0.2)
    assert set(fit.residuals["batch"].values[(fit.residuals["part"] == "validation")]) == {6, 7}


def test_no_backlash_is_not_an_unknown_backlash():
    rng = np.random.default_rng(7)
    fit = fc.fit_valve(noisy_valve_log(rng, random_walk(rng, n=500), 0.01, backlash=0.0))
    low, high = fit.intervals["backlash"]
    assert low == 0.0
    assert high < 0.02
    assert fit.parameters["backlash"] < 0.01


def test_holds_are_detected_and_only_settled_flows_compared():
    rng = np.random.default_rng(8)
    command = np.repeat(random_walk(rng, n=120), 10)
    flow, delivered = valve_flows(command), []
    for target in flow:  # a slow meter
        delivered.append(target if not delivered else delivered[-1] + 0.6 * (target - delivered[-1]))
    fit = fc.fit_valve(make_valve_log(command, add_noise(rng, np.array(delivered), 0.005), interval=30.0))
    assert fit.parameters["backlash"] == pytest.approx(0.07, abs=0.005)
    assert any("less than 150 s after the command changed" in note for note in fit.notes)
    assert (fit.residuals["part"] == "unused").sum() > 500
    ds = fit.residuals
    assert float(np.sqrt((ds["residual"].where(ds["part"] == "unused") ** 2).mean())) > 3 * fit.rmse["fit"]


def test_the_floor_of_the_flow_meter_is_found_and_a_pump_that_is_off_is_not_compared():
    rng = np.random.default_rng(9)
    command = random_walk(rng, n=600)
    flow = np.maximum(add_noise(rng, valve_flows(command), 0.01), 0.25)
    flow[command < 0.1] = 0.25
    off = np.flatnonzero(command > 0.8)[:7]
    flow[off] = 0.0
    fit = fc.fit_valve(make_valve_log(command, flow))
    assert_covered(fit, ["backlash"])
    (left_out,) = [note for note in fit.notes if note.startswith("7 flows left out, sensor or pump off")]
    assert f"row {off[0]})" in left_out
    assert any("0.25 kg/s" in note and "floor" in note for note in fit.notes)
    assert set(fit.residuals["part"].values[off]) == {"unused"}


def test_a_log_without_reversals_gives_no_backlash():
    command = np.linspace(0.0, 1.0, 100)
    fit = fc.fit_valve(noisy_valve_log(np.random.default_rng(11), command, 0.01), split=1.0)
    assert "backlash" not in fit.parameters
    assert "reverses only 0 times" in fit.held["backlash"]
    fc.Loop().assign(**fit.parameters)
    assert not any(line.startswith("backlash =") for line in fit.summary())


def test_a_backlash_that_is_only_noise_is_not_identified():
    """Some of these logs seem to exclude a backlash below 1 %: by chance, and their estimate is twice too large."""
    for seed in range(3):
        rng = np.random.default_rng(5000 + seed)
        fit = fc.fit_valve(noisy_valve_log(rng, random_walk(rng, n=100), 0.3, 0.5, backlash=0.02), split=1.0)
        assert "backlash" not in fit.parameters, seed
        assert "fits as well (95 %): give a longer log" in fit.held["backlash"]


def test_two_positions_identify_neither_the_backlash_nor_the_curve():
    command = np.where(np.arange(300) // 20 % 2, 0.8, 0.2)
    fit = fc.fit_valve(noisy_valve_log(np.random.default_rng(18), command, 0.02), split=1.0)
    assert "backlash" not in fit.parameters
    assert "from 0 to 0.25 fits as well" in fit.held["backlash"]
    assert any("one of many that fit as well" in why for why in fit.held.values())
    assert np.isfinite(list(fit.intervals.values())).all()
    tomllib.loads(fit.to_toml())


def test_an_inverted_command_is_suspected():
    command = random_walk(np.random.default_rng(20), n=100)
    hint = "the flow falls as the command rises: if a full command closes the valve, log 1 - command"
    inverted = fc.fit_valve(make_valve_log(1.0 - command, valve_flows(command)), split=1.0)
    assert hint in inverted.notes
    assert inverted.held["backlash"] == f"not identified: {hint}"
    assert hint not in fc.fit_valve(make_valve_log(command, valve_flows(command)), split=1.0).notes


def fit_curve(curve, noise, seed, hours=4, interval=30):
    """Fit a simulated valve with a straight or a logistic curve; return its loop as well."""
    loop = fc.Loop(curve=curve, m_max=1.2 if curve == "linear" else 2.0, backlash=0.07, kp=0.05)
    command = np.repeat(random_walk(np.random.default_rng(seed), n=hours * 3600 // interval), interval)
    day, traces = fc.paper_day(hours=hours), ["command", "m_w"]
    ds = fc.simulate(loop, day, command=command, traces=traces, trace_interval=interval)
    flow = add_noise(np.random.default_rng(100 + seed), ds.m_w.values, noise, 0.5)
    log = ds.assign(m_w=ds.m_w.copy(data=flow))
    return fc.fit_valve(log, holds="command"), loop


@pytest.mark.parametrize("noise", [0.005, 0.03])
@pytest.mark.parametrize("curve", ["linear", "richards"])
def test_the_curve_is_chosen_by_evidence_and_handed_on(curve, noise, tmp_path):
    for seed in range(3):
        fit, truth = fit_curve(curve, noise, seed)
        assert fit.parameters["curve"] == curve
        assert fit.identified
        assert f"curve = {curve}" in fit.summary()
        (note,) = [note for note in fit.notes if note.startswith("curve: ")]
        assert note.startswith("curve: a straight line" if curve == "linear" else "curve: Eq (2)")
        assert set(fit.intervals) == {"backlash", "m_max", *(["valve_a", "valve_b", "valve_c"] * (curve != "linear"))}
    assert tomllib.loads(fit.to_toml(tmp_path / "valve.toml"))["loop"] == fit.parameters
    command, day = np.repeat(np.linspace(0.05, 0.95, 20), 180), fc.paper_day(hours=1)
    loops = truth, fc.Loop(curve="linear" if curve == "richards" else "richards").assign(**fit.parameters)
    flows = [fc.simulate(loop, day, command=command, traces=["m_w"]).m_w.values for loop in loops]
    np.testing.assert_allclose(*flows, atol=0.05)


def test_eq_2_stays_where_the_log_hardly_tells_the_curves_apart():
    """A straight line under noise of a third of the flow in an hour, and a nearly straight Eq (2) under as much."""
    for seed in range(3):
        fit, _ = fit_curve("linear", 0.4, seed, hours=1)
        assert fit.parameters["curve"] == "richards"
        rng = np.random.default_rng(seed)
        log = noisy_valve_log(rng, random_walk(rng, n=100), 0.15, 0.5, valve_a=0.5, valve_b=4.0, valve_c=0.5)
        assert fc.fit_valve(log, split=1.0, holds="command").parameters["curve"] == "richards"


def test_a_signal_of_2_to_10_V_read_as_one_of_0_to_10_V_is_suspected():
    """The valve is then closed at 20 %; a valve that merely passes no water below 20 % is below it at times."""
    rng = np.random.default_rng(21)
    command = random_walk(rng, n=150)
    command[[3, 70, 120]] = 0.0
    flow = add_noise(rng, valve_flows(command), 0.01)
    read_wrong = fc.fit_valve(make_valve_log(0.2 + 0.8 * command, flow), split=1.0, lag=0)
    (note,) = [text for text in read_wrong.notes if "2-10 V" in text]
    assert note.startswith("the valve is closed at a command of 0.2 and the command never falls below that")
    assert note.endswith("or log (command - 0.2) / 0.8")
    assert read_wrong.parameters["backlash"] == pytest.approx(0.8 * 0.07, abs=0.004)
    for right in (command, 0.3 + 0.7 * command):
        assert not has_live_zero(right, flow)
    assert not has_live_zero(0.2 + 0.8 * command, flow + 1.0)  # water flows at 20 %


@pytest.fixture(scope="module")
def fit():
    rng = np.random.default_rng(16)
    return fc.fit_valve(noisy_valve_log(rng, random_walk(rng, n=300), 0.02))


def test_the_result_has_what_is_promised(fit):
    assert fc.Loop().assign(**fit.parameters)["backlash"] == fit.parameters["backlash"]
    names = ["backlash", "m_max", "valve_a", "valve_b", "valve_c"]
    assert list(fit.covariance["parameter"].values) == names
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), [fit.standard_errors[n] for n in names])
    np.testing.assert_allclose(np.diag(fit.correlation), 1.0)
    best = fit.profile["backlash"][int(fit.profile["rmse"].values.argmin())]
    assert float(best) == pytest.approx(fit.parameters["backlash"], abs=0.005)
    ds = fit.residuals
    np.testing.assert_allclose(ds["residual"], ds["m_w"] - ds["modelled"])
    assert fit.rmse["fit"] == pytest.approx(float(np.sqrt((ds["residual"].where((ds["part"] == "fit")) ** 2).mean())))
    assert (ds["part"] == "validation").sum() == 90


def test_the_toml_reads_back(fit, tmp_path):
    path = tmp_path / "valve.toml"
    tables = tomllib.loads(fit.to_toml(path))
    assert path.read_text() == fit.to_toml()
    assert tables["loop"] == fit.parameters
    assert tables["fit"]["interval_95"]["backlash"] == list(fit.intervals["backlash"])
    assert tables["fit"]["rmse"] == fit.rmse


def test_the_interval_of_a_backlash_estimated_at_0_allows_for_correlated_noise():
    rng = np.random.default_rng(18)
    command = np.repeat(rng.uniform(0.0, 1.0, 60), 20)
    fit = fc.fit_valve(noisy_valve_log(rng, command, 0.06, 0.97, interval=30.0, backlash=0.005), split=1.0)
    assert fit.backlash < 1e-6
    low, high = fit.profile.attrs["interval_95"]
    assert low == 0.0
    assert high > 0.005


def test_a_log_in_degrees_and_litres_a_minute_is_that_in_usual_units():
    rng = np.random.default_rng(12)
    command = random_walk(rng, n=160)
    flow, batch = add_noise(rng, valve_flows(command), 0.01), np.arange(160) // 40
    usual = fc.fit_valve(make_valve_log(command, flow, batch=batch), split=0.5, holds="command")
    time = 60.0 * np.arange(160)
    theirs = pd.DataFrame({"t": time, "deg": 90.0 * command, "lpm": 60.0 * flow, "batch": batch})
    columns = {"elapsed_time": "t", "command": "deg", "m_w": "lpm", "batch": "batch"}
    units = {"elapsed_time": "s", "command": "deg", "m_w": "L/min"}
    fit = fc.fit_valve(fc.read_log(theirs, columns=columns, units=units), split=0.5, holds="command")
    assert fit.parameters.pop("curve") == usual.parameters.pop("curve")
    assert fit.parameters == pytest.approx(usual.parameters, rel=1e-6)


@pytest.mark.full
def test_on_a_hospitals_ahu_each_half_holds_the_other():
    """Maddalena et al. (2022): batches 0-12 and 13-25; in the second half the flow is logged one sample late."""
    log = pd.read_csv(measured_file("riskbr_ahu1.csv"))
    columns = {"elapsed_time": "time_s", "command": "valve_pos_deg", "m_w": "water_flow_l_min", "batch": "batch"}
    units = {"elapsed_time": "s", "command": "deg", "m_w": "L/min"}

    def fit_part(part, lag=0.0):
        part_log = fc.read_log(part, columns=columns, units=units, jumps="split")
        return fc.fit_valve(part_log, split=1.0, lag=lag, holds="command")

    halves = log[log["batch"] < 13], log[log["batch"] >= 13]
    first_fit, second_fit = fits = [fit_part(half, lag) for half, lag in zip(halves, (0.0, 600.0), strict=True)]
    for fit, backlash, interval in zip(fits, (0.148, 0.135), ((0.125, 0.171), (0.091, 0.179)), strict=True):
        assert fit.backlash == pytest.approx(backlash, abs=5e-4)
        assert fit.intervals["backlash"] == pytest.approx(interval, abs=1e-3)
        assert fit.parameters["curve"] == "richards"
        assert fit.rmse["fit"] < 0.9 * fit.rmse["fit_without_backlash"]
        assert any("0.1043 kg/s" in note and "floor" in note for note in fit.notes)
    assert first_fit.interval[0] < second_fit.backlash < first_fit.interval[1]
    assert second_fit.interval[0] < first_fit.backlash < second_fit.interval[1]
    assert fit_part(halves[1]).rmse["fit"] > 1.5 * second_fit.rmse["fit"]

"""fit_valve: twins are recovered within their stated intervals, what the data cannot tell is said, bad logs refused."""

import csv
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from fastcoil.calibrate.estimate import autocorrelation, evaluate
from fastcoil.calibrate.valve_problem import ValveProblem
from fastcoil.engine.valve_loop import valve_flows

DATA = Path(__file__).parents[2] / "shared" / "data"
TRUTH = {"backlash": 0.07, "m_max": 2.0, "valve_a": 0.7, "valve_b": 9.0, "valve_c": 0.38}
pytestmark = pytest.mark.kernel


def flows(command, start=0.0, **truth):
    """Eqs (1) and (2) in plain Python; ``start`` is the place in the gap, 1 on the rising flank."""
    p = TRUTH | truth
    x_bl = p["backlash"]
    low, high = max(command[0] - x_bl, 0.0), min(command[0], 1.0 - x_bl)
    q, found = high - start * (high - low), []
    for position in command:
        q = min(max(q, position - x_bl), position)
        growth = math.exp(-p["valve_b"] * (q / (1.0 - x_bl) - p["valve_c"]))
        found.append(p["m_max"] * (1.0 + p["valve_a"] * growth) ** (-1.0 / p["valve_a"]))
    return np.array(found)


def walk(rng, n=400, top=1.0, largest=0.3):
    """A command that wanders: every sample another one, most moves small, so that the gap matters."""
    command = [rng.uniform(0.2, 0.8) * top]
    while len(command) < n:
        moved = command[-1] + rng.normal(0.0, largest / 2)
        command.append(min(max(moved, 0.0), top))
    return np.array(command)


def log_of(command, flow, interval=60.0, **others):
    t = ("elapsed_time", np.arange(command.size) * interval, {"units": "s"})
    variables = {"command": ("elapsed_time", command, {"units": "1"}), "m_w": ("elapsed_time", flow, {"units": "kg/s"})}
    variables |= {name: ("elapsed_time", values) for name, values in others.items()}
    return xr.Dataset(variables, {"elapsed_time": t})


def noisy(rng, flow, sd, phi=0.0):
    """Flow with AR(1) noise of standard deviation ``sd``."""
    e = rng.normal(0.0, sd, flow.size)
    for t in range(1, e.size):
        e[t] = phi * e[t - 1] + math.sqrt(1 - phi**2) * e[t]
    return np.maximum(flow + e, 1e-3)


def assert_covered(fit, truth, names=tuple(TRUTH)):
    for name in names:
        low, high = fit.intervals[name]
        assert low <= truth[name] <= high, f"{name} = {truth[name]} is not in {low:.4g} to {high:.4g}"


# ------------------------------------------------------------------------------------------------ what is recovered


def test_a_twin_without_noise_is_recovered_from_an_unknown_start():
    rng = np.random.default_rng(1)
    command = walk(rng)
    fit = fc.fit_valve(log_of(command, flows(command, start=0.4)))
    for name, value in TRUTH.items():
        assert fit.parameters[name] == pytest.approx(value, rel=2e-3), name
    assert fit.rmse["validation"] < 1e-4
    assert fit.rmse["validation_without_backlash"] > 0.01


@pytest.mark.parametrize(("phi", "seed"), [(0.0, 2), (0.0, 3), (0.8, 4), (0.9, 5)])
def test_twins_with_white_and_autocorrelated_noise_lie_in_their_intervals(phi, seed):
    rng = np.random.default_rng(seed)
    command = walk(rng, n=800)
    fit = fc.fit_valve(log_of(command, noisy(rng, flows(command, start=0.7), 0.03, phi)))
    assert_covered(fit, TRUTH)
    assert fit.intervals["backlash"][1] - fit.intervals["backlash"][0] < 0.03
    assert (fit.n_effective < 0.5 * fit.n_used) == (phi > 0.5)


def test_batches_start_anywhere_in_their_gap():
    rng = np.random.default_rng(6)
    parts = [walk(rng, n=60) for _ in range(8)]
    flow = np.concatenate([flows(c, start=s) for c, s in zip(parts, np.linspace(0, 1, 8), strict=True)])
    batch = np.repeat(np.arange(8.0), 60)
    log = log_of(np.concatenate(parts), noisy(rng, flow, 0.01), batch=batch)
    fit = fc.fit_valve(log, split=0.7)
    assert_covered(fit, TRUTH)
    assert fit.rmse["fit"] == pytest.approx(0.01, rel=0.2)
    here = fit.residuals["part"] == "validation"
    assert set(fit.residuals["batch"].values[here]) == {6, 7}


def test_a_valve_without_backlash_is_told_from_one_that_is_unknown():
    rng = np.random.default_rng(7)
    command = walk(rng, n=500)
    fit = fc.fit_valve(log_of(command, noisy(rng, flows(command, backlash=0.0), 0.01)))
    low, high = fit.intervals["backlash"]
    assert low == 0.0
    assert high < 0.02
    assert fit.parameters["backlash"] < 0.01


def test_holds_are_detected_and_only_settled_flows_compared():
    rng = np.random.default_rng(8)
    command = np.repeat(walk(rng, n=120), 10)
    flow, delivered = flows(command), []
    for wanted in flow:  # a slow meter
        delivered.append(wanted if not delivered else delivered[-1] + 0.6 * (wanted - delivered[-1]))
    log = log_of(command, noisy(rng, np.array(delivered), 0.005), interval=30.0)
    fit = fc.fit_valve(log)
    assert fit.parameters["backlash"] == pytest.approx(0.07, abs=0.005)
    assert any("less than 150 s after the command changed" in note for note in fit.notes)
    assert (fit.residuals["part"] == "unused").sum() > 500
    raw = fc.fit_valve(log, settle=0.0)
    assert raw.rmse["fit"] > 3 * fit.rmse["fit"]


def test_the_floor_of_the_flow_meter_is_found_and_a_pump_that_is_off_is_not_the_valves_doing():
    rng = np.random.default_rng(9)
    command = walk(rng, n=600)
    flow = np.maximum(noisy(rng, flows(command), 0.01), 0.25)
    flow[command < 0.1] = 0.25
    off = np.flatnonzero(command > 0.8)[:7]
    flow[off] = 0.0
    fit = fc.fit_valve(log_of(command, flow))
    assert_covered(fit, TRUTH, ["backlash"])
    assert any(
        note.startswith("7 flows left out, sensor or pump off") and f"row {off[0]})" in note for note in fit.notes
    )
    assert any("0.25 kg/s" in note and "floor" in note for note in fit.notes)
    assert set(fit.residuals["part"].values[off]) == {"unused"}


def test_a_known_asymptotic_flow_is_held():
    rng = np.random.default_rng(10)
    command = walk(rng, top=0.5)
    fit = fc.fit_valve(log_of(command, noisy(rng, flows(command), 0.005)), m_max=2.0)
    assert fit.parameters["m_max"] == 2.0
    assert fit.held == {"m_max": "given"}
    assert "m_max" not in fit.intervals
    assert_covered(fit, TRUTH, ["backlash", "valve_a", "valve_b", "valve_c"])
    assert any("commands reach 0.5: beyond it" in note for note in fit.notes)
    wrong = fc.fit_valve(log_of(command, noisy(rng, flows(command), 0.005)), m_max=2.5)
    assert wrong.parameters["m_max"] == 2.5
    assert float(wrong.profile["rmse"].min()) > (1.0 - 1e-6) * wrong.rmse["fit"]


@pytest.mark.full
def test_intervals_of_95_per_cent_cover_the_truth_that_often():
    """120 short twins with AR(1) noise: between 90 and 100 % of the intervals of x_BL and c hold the truth."""
    hits = {"backlash": 0, "valve_c": 0}
    n = 120
    for seed in range(n):
        rng = np.random.default_rng(1000 + seed)
        command = walk(rng, n=200)
        phi = (0.0, 0.5, 0.8)[seed % 3]
        fit = fc.fit_valve(log_of(command, noisy(rng, flows(command, start=rng.uniform()), 0.03, phi)), split=1.0)
        for name in hits:
            low, high = fit.intervals.get(name, (0.0, 1.0))
            hits[name] += low <= TRUTH[name] <= high
    shares = {name: count / n for name, count in hits.items()}
    assert all(0.90 <= share <= 1.0 for share in shares.values()), shares


# ---------------------------------------------------------------------------------------------- what cannot be told


def test_a_log_without_reversals_gives_no_backlash():
    command = np.linspace(0.0, 1.0, 100)
    rng = np.random.default_rng(11)
    fit = fc.fit_valve(log_of(command, noisy(rng, flows(command), 0.01)), split=1.0)
    assert "backlash" not in fit.parameters
    assert "turns 0 times" in fit.held["backlash"]
    fc.Loop().assign(**fit.parameters)
    assert not any(line.startswith("backlash =") for line in fit.summary())


def test_noise_larger_than_the_effect_of_the_gap_gives_no_backlash():
    rng = np.random.default_rng(12)
    command = walk(rng, n=60)
    fit = fc.fit_valve(log_of(command, noisy(rng, flows(command, backlash=0.02) + 1.0, 0.5)), split=1.0)
    assert "backlash" not in fit.parameters
    assert "noise is larger" in fit.held["backlash"]
    assert "not identified" in fit.plot().axes[2].get_title()


def test_two_positions_tell_neither_the_gap_nor_the_curve():
    rng = np.random.default_rng(18)
    command = np.where(np.arange(300) // 20 % 2, 0.8, 0.2)
    fit = fc.fit_valve(log_of(command, noisy(rng, flows(command), 0.02)), split=1.0)
    assert "backlash" not in fit.parameters
    assert "the most that is tried" in fit.held["backlash"]
    assert any("one of many that fit as well" in why for why in fit.held.values())
    assert np.isfinite(list(fit.intervals.values())).all()
    tomllib.loads(fit.to_toml())


# ------------------------------------------------------------------------------------------------- how it is computed


def test_the_loop_is_that_of_the_emulator():
    """A valve alone and the valve of an open-loop simulation, to round-off."""
    rng = np.random.default_rng(13)
    command = np.repeat(walk(rng, n=60), 60)
    day = fc.paper_day(hours=1, seed=1)
    ds = fc.simulate(fc.Loop(), day, command=command, traces=["m_w", "opening"], warm_up=0)
    sets = np.array([[TRUTH[n] for n in ("backlash", "m_max", "valve_a", "valve_b", "valve_c")]]).T
    # the emulator starts with the gear at 0
    command0 = np.concatenate([[0.0], command])
    openings, found = np.empty((3601, 1)), np.empty((3601, 1))
    valve_flows(command0, np.zeros(3601, dtype=np.int64), sets, np.zeros((1, 1)), openings, found)
    np.testing.assert_allclose(found[1:, 0], ds["m_w"], rtol=1e-13)
    np.testing.assert_allclose(openings[1:, 0], ds["opening"], atol=1e-15)
    assert np.allclose(flows(command0), found[:, 0], rtol=1e-13)


def test_the_jacobian_of_lanes_is_that_of_single_runs():
    rng = np.random.default_rng(14)
    command = walk(rng, n=120)
    batch = np.repeat([0.0, 1.0, 2.0, 3.0], 30)
    log = log_of(command, noisy(rng, flows(command), 0.01), batch=batch)
    from fastcoil.calibrate.data import read_log

    problem = ValveProblem(read_log(log, ["command", "m_w"]), None, None, 1.0, None)
    model, _ = problem.model(None, "unknown")
    x = np.array([0.05, math.log(2.1), math.log(0.8), math.log(8.0), 0.4, 0.3, 0.5, 0.6, 0.7])
    r, J = evaluate(model, x)
    np.testing.assert_array_equal(r, model.residuals(x[:, None])[:, 0])
    for k in range(x.size):
        up, down = x.copy(), x.copy()
        up[k] += model.step[k]
        down[k] -= model.step[k]
        single = (model.residuals(up[:, None]) - model.residuals(down[:, None]))[:, 0] / (up[k] - down[k])
        np.testing.assert_allclose(J[:, k], single, rtol=1e-9, atol=1e-9)


def test_autocorrelation_of_an_ar_process_gives_its_effective_size():
    rng = np.random.default_rng(15)
    n, phi = 20000, 0.8
    r = noisy(rng, np.full(n, 100.0), 1.0, phi) - 100.0
    rho = autocorrelation(r, np.zeros(n, dtype=np.int64), np.ones(n, dtype=bool))
    assert 1.0 + 2.0 * rho.sum() == pytest.approx((1 + phi) / (1 - phi), rel=0.15)
    white = autocorrelation(rng.normal(size=n), np.zeros(n, dtype=np.int64), np.ones(n, dtype=bool))
    assert abs(white.sum()) < 0.1


# ------------------------------------------------------------------------------------------------------ what comes out


@pytest.fixture(scope="module")
def fit():
    rng = np.random.default_rng(16)
    command = walk(rng, n=300)
    return fc.fit_valve(log_of(command, noisy(rng, flows(command), 0.02)))


def test_the_result_has_what_is_promised(fit):
    assert fc.Loop().assign(**fit.parameters)["backlash"] == fit.parameters["backlash"]
    names = list(TRUTH)
    assert list(fit.covariance["parameter"].values) == names
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), [fit.standard_errors[n] for n in names])
    np.testing.assert_allclose(np.diag(fit.correlation), 1.0)
    best = fit.profile["backlash"][int(fit.profile["rmse"].values.argmin())]
    assert float(best) == pytest.approx(fit.parameters["backlash"], abs=0.005)
    ds = fit.residuals
    np.testing.assert_allclose(ds["residual"], ds["m_w"] - ds["modelled"])
    used = ds["part"] == "fit"
    assert fit.rmse["fit"] == pytest.approx(float(np.sqrt((ds["residual"].where(used) ** 2).mean())))
    assert (ds["part"] == "validation").sum() == 90


def test_the_toml_reads_back(fit, tmp_path):
    path = tmp_path / "valve.toml"
    read = tomllib.loads(fit.to_toml(path))
    assert path.read_text() == fit.to_toml()
    assert read["loop"] == fit.parameters
    assert read["fit"]["interval_95"]["backlash"] == list(fit.intervals["backlash"])
    assert read["fit"]["rmse"] == fit.rmse
    with pytest.raises(fc.InputError, match="cannot be written"):
        fit.to_toml(tmp_path / "no" / "valve.toml")


def test_the_figure_has_parity_curves_and_profile(fit):
    titles = [axes.get_title() for axes in fit.plot().axes]
    assert titles[:2] == ["Parity", "Data over the hysteresis curves"]
    assert titles[2].startswith("Profile, 95 %")


# ------------------------------------------------------------------------------------------------- what is refused

HEADER = ["elapsed_time [s]", "command [1]", "m_w [kg/s]"]


def rows(n=60):
    rng = np.random.default_rng(17)
    command = walk(rng, n=n)
    return [[60 * i, f"{c:.4f}", f"{m:.4f}"] for i, (c, m) in enumerate(zip(command, flows(command), strict=True))]


@pytest.fixture
def write(tmp_path):
    def write_csv(header, body):
        path = tmp_path / "valve.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([header, *body])
        return path

    return write_csv


def changed(body, row, column, value):
    body = [list(r) for r in body]
    body[row][column] = value
    return body


def refused(log, **options):
    with pytest.raises(fc.InputError) as caught:
        fc.fit_valve(log, **options)
    return "\n".join(caught.value.problems)


@pytest.mark.parametrize(
    ("header", "change", "words"),
    [
        (["elapsed_time [s]", "command", "m_w [kg/s]"], None, ["command has no unit", "'command [1]'", "deg"]),
        (["elapsed_time [s]", "command [1]", "m_w [L/sec]"], None, ["m_w is in 'L/sec'", "L/s"]),
        (["elapsed_time [s]", "command [1]", "flow [kg/s]"], None, ["'flow [kg/s]' is unknown", "m_w is missing"]),
        (["t [s]", "command [1]", "m_w [kg/s]"], None, ["elapsed_time or timestamp is missing", "--column"]),
        (HEADER, (5, 2, "nan"), ["m_w is nan in row 7", "--drop"]),
        (HEADER, (5, 1, ""), ["command is blank in row 7", "--drop"]),
        (HEADER, (5, 1, "1.7"), ["command = 1.7 in row 7", "from 0 to 1", "check its unit"]),
        (HEADER, (5, 2, "-999"), ["m_w = -999 kg/s in row 7", "missing value"]),
        (HEADER, (5, 0, "240"), ["elapsed_time: row 7 is at the same time as row 6", "--jumps split"]),
        (HEADER, (5, 0, "10"), ["elapsed_time: row 7 is earlier than row 6"]),
    ],
)
def test_bad_logs_are_refused_with_column_row_and_cure(write, header, change, words):
    body = rows() if change is None else changed(rows(), *change)
    text = refused(write(header, body))
    for word in words:
        assert word in text, text


def test_constants_and_short_logs_are_refused(write):
    still = [[t, "0.5", m] for t, _, m in rows()]
    assert "command is 0.5 from row 2 to row 61" in refused(write(HEADER, still))
    flat = [[t, c, "1.0"] for t, c, _ in rows()]
    assert "m_w is 1 from row" in refused(write(HEADER, flat))
    assert "at least 20" in refused(write(HEADER, rows(12)))


def test_bad_arguments_are_refused(write):
    path = write(HEADER, rows())
    assert "split = 2.0" in refused(path, split=2.0)
    assert "initial = 'up'" in refused(path, initial="up")
    assert "m_max = -1" in refused(path, m_max=-1)
    assert "jumps = 'x'" in refused(path, jumps="x")
    assert "fit_until = 0" in refused(path, fit_until=0)


def test_dropped_rows_gaps_and_jumps_are_counted(write):
    body = changed(changed(changed(rows(), 5, 2, "nan"), 6, 2, "-999"), 9, 1, "off")
    fit = fc.fit_valve(write(HEADER, body), drop=True)
    assert "1 rows left out: command is no admissible number (first in row 11)" in fit.notes
    assert any(note.startswith("2 values left out: m_w") for note in fit.notes)
    gappy = [[t + 3600 * (i > 30), c, m] for i, (t, c, m) in enumerate(rows())]
    fit = fc.fit_valve(write(HEADER, gappy))
    assert any("1 gaps in time (first: 3660 s between rows 32 and 33)" in note for note in fit.notes)
    back = [[t - 900 * (i > 30), c, m] for i, (t, c, m) in enumerate(rows())]
    fit = fc.fit_valve(write(HEADER, back), jumps="split")
    assert any("goes back or stands still 1 times" in note for note in fit.notes)


@pytest.mark.parametrize(("unit", "factor"), [("%", 100), ("percent", 100), ("deg", 90), ("V", 10), ("1", 1)])
def test_travel_in_every_unit(write, unit, factor):
    body = [[t, float(c) * factor, m] for t, c, m in rows()]
    expected = fc.fit_valve(write(HEADER, rows())).parameters["backlash"]
    found = fc.fit_valve(write(["elapsed_time [s]", f"command [{unit}]", "m_w [kg/s]"], body))
    assert found.parameters["backlash"] == pytest.approx(expected, abs=1e-4)


# --------------------------------------------------------------------------------------------------------- real data


@pytest.mark.skipif(not DATA.is_dir(), reason="the measured series are not beside this checkout")
def test_on_a_hospitals_ahu_the_backlash_model_beats_the_one_without():
    """Maddalena et al. (2022): batches 0-12 are fitted, 13-25 tested."""
    fit = fc.fit_valve(
        DATA / "riskbr_ahu1.csv",
        columns={"elapsed_time": "time_s", "command": "valve_pos_deg", "m_w": "water_flow_l_min", "batch": "batch"},
        units={"elapsed_time": "s", "command": "deg", "m_w": "L/min"},
        split=0.5,
        jumps="split",
    )
    assert fit.rmse["validation"] < 0.9 * fit.rmse["validation_without_backlash"]
    assert 0.12 < fit.parameters["backlash"] < 0.18
    assert any("0.1043 kg/s" in note and "floor" in note for note in fit.notes)

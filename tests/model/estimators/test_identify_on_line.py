"""The identification: sums and fit by a textbook's formulas, and what it makes of good, worn and wearing valves."""

import math

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.estimators import identify
from fastcoil.model.estimators.identify import ESTIMATOR, N_CANDIDATES, N_FLOATS, N_LAGS, N_MOVES, Memory, Parameters
from fastcoil.model.estimators.interface import Sample

KERNEL = pytest.mark.kernel
INTERPRETED = pytest.mark.usefixtures("interpreted")
FIELD_LOOP = {"noise_std": 0.02, "stroke_time": 60.0, "sensor_time_constant": 20.0, "sample_time": 10.0}
ACTING = {"estimator": "identify", "estimate_share": 0.95, "buffer": 0.0025}


@pytest.fixture
def interpreted(monkeypatch):
    """The formulas in plain Python: compiling each for a call from a test would take longer than all the tests."""
    for name, function in vars(identify).copy().items():
        if hasattr(function, "py_func"):
            monkeypatch.setattr(identify, name, {"exp": math.exp, "log": math.log}.get(name, function.py_func))


def array_with_probabilities(**of_sizes):
    """An array whose log-likelihoods give these probabilities to candidates, by their number."""
    w = np.zeros(N_FLOATS)
    w[identify.P_AT : identify.P_AT + N_CANDIDATES] = -1e4
    for number, probability in of_sizes.items():
        w[identify.P_AT + int(number[1:])] = np.log(probability) / identify.LIKELIHOOD_WEIGHT
    return w


def test_a_field_controller_can_hold_it():
    """All that it remembers: 10 kB in double precision, 5 kB in single."""
    assert 8 * (ESTIMATOR.n_floats + len(Memory._fields)) < 10.6e3


def test_candidates_leave_no_size_without_a_right_one():
    sizes = np.linspace(0.0, 0.25, 2001)
    nearest = np.abs(sizes[:, np.newaxis] - identify.CANDIDATES).min(axis=1)
    assert np.all(nearest <= 0.5 * np.maximum(0.2 * sizes, 0.01) + 1e-12)
    assert identify.CANDIDATES.size == N_CANDIDATES
    assert np.all(np.diff(identify.CANDIDATES[1:]) > 0.0)


@INTERPRETED
def test_the_evidence_is_that_of_a_linear_model_with_a_normal_prior():
    """By the covariance of the changes themselves, one row a horizon, all candidates with openings of their own."""
    rng, rows, decay = np.random.default_rng(4), 90, 0.99
    changes, deviations = rng.normal(size=rows + N_LAGS), rng.normal(size=rows)
    moves = 0.1 * rng.normal(size=(rows, N_MOVES, N_CANDIDATES))
    w = np.zeros(N_FLOATS)
    for k in range(rows + N_LAGS):
        identify.remember_change(w, changes[k])
        if k >= N_LAGS:
            w[identify.LAGS_AT + identify.DEVIATION_AT] = deviations[k - N_LAGS]
            w[identify.MOVES_AT : identify.MOVES_AT + N_MOVES * N_CANDIDATES] = moves[k - N_LAGS].ravel()
            identify.add_row(w, decay)
    ages = np.arange(rows - 1, -1, -1.0)
    # a horizon in which the motor moved by 3 % of the stroke has twice the variance
    root = np.sqrt(decay**ages / (1.0 + (np.abs(moves[:, :, 1]).sum(axis=1) / 0.03) ** 2))[:, np.newaxis]
    n_rows = float(np.sum(decay**ages))
    assert identify.compare_candidates(w, n_rows)
    Z = np.stack([*(changes[N_LAGS - i : N_LAGS - i + rows] for i in range(1, N_LAGS + 1)), np.ones(rows), deviations])
    Z, freedom = root * Z.T, n_rows - len(Z)
    y = root[:, 0] * changes[N_LAGS:]
    y = y - Z @ np.linalg.lstsq(Z, y)[0]
    for c in (0, 7, N_CANDIDATES - 1):
        D = root * moves[:, :, c]
        D = D - Z @ np.linalg.lstsq(Z, D)[0]
        covariance = np.eye(rows) + D @ D.T / (identify.PRIOR_PRECISION * (y @ y) / freedom)
        residual_sum = y @ np.linalg.solve(covariance, y)
        expected = -0.5 * freedom * np.log(residual_sum / (y @ y)) - 0.5 * np.linalg.slogdet(covariance)[1]
        assert w[identify.P_AT + c] == pytest.approx(expected, abs=1e-9)


@INTERPRETED
@pytest.mark.parametrize("width", [1, 3])
def test_a_horizon_is_explained_by_what_is_known_when_it_begins(width):
    """Readings and openings of whole horizons, by hand from the commands; no gap, and no motor or an immediate one."""
    rng, n = np.random.default_rng(5), 6 * width + 1
    T, command = rng.normal(14.0, 1.0, n), rng.uniform(0.2, 0.8, n)
    p = Parameters(30.0 / width, 0.0, 86400.0, 600.0, 0.7)
    w, memory = np.zeros(N_FLOATS), identify.initial_memory(p)
    for k in range(n):
        now = Sample(30.0 / width * (k + 1), 14.0, 1.0, T[k], 0.0, 0.5, command[k], 1.0, 0.0, 0.0, 0.0)
        _, memory = identify.update_estimate(now, p, memory, w)
    means = command[: 6 * width].reshape(6, width).mean(axis=1)
    first = 6 * width  # number of the reading with which the last horizon begins
    lags = w[identify.LAGS_AT : identify.LAGS_AT + identify.N_COMMON]
    np.testing.assert_allclose(lags[:N_LAGS], [*np.diff(T[: first + 1 : width])[::-1]])
    assert lags[identify.DEVIATION_AT] == pytest.approx(T[first] - T[first - width : first].mean())
    moves = w[identify.MOVES_AT : identify.MOVES_AT + N_MOVES * N_CANDIDATES].reshape(N_MOVES, N_CANDIDATES)
    for c in (0, 1):
        # as if the valve stayed where the first command of the horizon puts it
        expected = [command[first] - means[-1], means[-1] - means[-2], means[-2] - means[-3]]
        np.testing.assert_allclose(moves[:, c], expected)


@INTERPRETED
def test_a_temperature_that_stands_still_explains_nothing():
    w = np.zeros(N_FLOATS)
    for _ in range(100):
        identify.remember_change(w, 0.0)
        identify.add_row(w, 1.0)
    assert not identify.compare_candidates(w, 100.0)


@INTERPRETED
@pytest.mark.parametrize(
    ("estimate", "expected", "probabilities"),
    [
        pytest.param(0.0, 0.03, {"c7": 1.0}, id="sure"),
        pytest.param(0.0, 0.0, {"c7": 0.5, "c15": 0.5}, id="unsure"),
        pytest.param(0.0, 0.0, {"c7": 0.98, "c1": 0.02}, id="perhaps good"),
        pytest.param(0.0, 0.0, {"c7": 0.98, "c0": 0.02}, id="perhaps good, its motor faster"),
        pytest.param(0.035, 0.035, {"c7": 0.5, "c15": 0.5}, id="kept"),
        pytest.param(0.05, 0.0, {"c1": 0.5, "c3": 0.5}, id="good"),
        pytest.param(0.15, 0.05, {"c5": 0.4, "c7": 0.2, "c15": 0.4}, id="too large"),
        pytest.param(0.15, 0.0, {"c1": 0.4, "c7": 0.2, "c15": 0.4}, id="too large, perhaps good"),
        pytest.param(0.07, 0.07, {"c5": 0.4, "c7": 0.3, "c13": 0.3}, id="perhaps not"),
    ],
)
def test_an_estimate_is_taken_over_if_it_is_right_and_given_up_if_it_is_too_large(estimate, expected, probabilities):
    w = array_with_probabilities(**probabilities)
    assert identify.decide_estimate(w, estimate, 0.8) == pytest.approx(expected, abs=1e-12)


@INTERPRETED
@pytest.mark.parametrize("stroke_time", [0.0, 90.0])
def test_the_mean_place_of_a_stem_is_that_of_its_path(stroke_time):
    """A motor runs by 0.2; the stem waits for the first half of that."""
    seconds = np.linspace(0.0, 30.0, 300_001)
    position = np.minimum(0.4 + seconds / stroke_time, 0.6) if stroke_time else np.full_like(seconds, 0.6)
    path = np.maximum(position - 0.1, 0.4)
    expected = np.trapezoid(path, seconds) / 30.0
    assert identify.mean_position(0.4, 0.5, 0.2 * stroke_time, stroke_time, 30.0) == pytest.approx(expected, abs=1e-7)


@pytest.fixture(scope="module")
def day():
    """Four hours with a set-point step every half hour."""
    return fc.paper_day(hours=4, seed=11)


@KERNEL
def test_it_finds_each_backlash_within_hours_and_none_where_there_is_none(day):
    loop = fc.Loop.preset("lbnl").assign(backlash=[0.0, 0.03, 0.07, 0.12], **FIELD_LOOP)
    plain, ds = fc.simulate(loop, day), fc.simulate(loop.assign(**ACTING), day, traces=["estimate"])
    np.testing.assert_allclose(ds.estimate_final, loop["backlash"], atol=0.003)
    assert np.all(ds.time_identified[1:] < 2.5 * 3600)
    assert not ds.estimate.sel(backlash=0.0).any()
    assert np.all(ds.rmse[1:] < plain.rmse[1:])
    # a good valve is left alone: not even the buffer acts
    np.testing.assert_allclose(ds.rmse.sel(backlash=0.0), plain.rmse.sel(backlash=0.0), rtol=1e-3)


@KERNEL
def test_it_gives_up_an_estimate_that_is_too_large(day):
    loop = fc.Loop.preset("lbnl").assign(backlash=[0.0, 0.03], **FIELD_LOOP, **ACTING, backlash_estimate=0.2)
    assert np.all(fc.simulate(loop, day).estimate_final <= [0.0, 0.04])


@KERNEL
def test_a_constant_set_point_tells_nothing_and_changes_nothing(day):
    constant = fc.Boundary(**{n: s[0] for n, s in day.series.items()} | {"T_set": np.full(4 * 3600, 14.0)})
    loop = fc.Loop.preset("lbnl").assign(backlash=[0.0, 0.07], **FIELD_LOOP)
    plain, ds = fc.simulate(loop, constant), fc.simulate(loop.assign(**ACTING), constant)
    assert not ds.estimate_final.any()
    np.testing.assert_allclose(ds.rmse, plain.rmse, rtol=1e-3)


@KERNEL
def test_only_blocks_of_lanes_that_identify_have_the_arrays():
    from fastcoil.model.engine.lanes import cut_into_blocks, parameter_matrix, work_space
    from fastcoil.model.engine.rows import LANES
    from fastcoil.model.parameter_table import PARAMETERS

    words = np.array(["none", "gradient", "identify"])
    columns = {p.name: np.full(3, np.nan if p.default is None else p.default) for p in PARAMETERS.values()}
    cut = cut_into_blocks(parameter_matrix(columns | {"replicate": np.zeros(3), "estimator": words}))
    sizes = {block.estimator and block.estimator.name: work_space(block)[2].size for _, block in cut}
    assert sizes[None] == 0
    assert sizes["gradient"] < 20 * LANES
    assert sizes["identify"] == LANES * (len(Parameters._fields) + len(Memory._fields) + ESTIMATOR.n_floats)


@KERNEL
def test_a_good_valve_is_left_alone_where_the_command_follows_the_noise(day):
    """Sampled every 5 s with a noise of 0.05 K, by gains after SIMC: the command is busy, and a gap would calm it."""
    small_steps = fc.Boundary(**day.series | {"T_set": 14.0 + 0.25 * np.sign(day.series["T_set"] - 14.0)})
    loop = fc.Loop.preset("lbnl").assign(backlash=[0.0, 0.07], noise_std=0.05, sample_time=5.0, kp=0.048, ti=35.0)
    for boundary in (day, small_steps):
        plain, ds = fc.simulate(loop, boundary), fc.simulate(loop.assign(**ACTING), boundary, traces=["estimate"])
        assert not ds.estimate.sel(backlash=0.0).any()
        np.testing.assert_allclose(ds.rmse.sel(backlash=0.0), plain.rmse.sel(backlash=0.0), rtol=1e-3)
    assert float(ds.estimate_final.sel(backlash=0.07).squeeze()) == pytest.approx(0.07, abs=0.014)

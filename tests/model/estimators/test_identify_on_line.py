"""The identification: sums and fit by a textbook's formulas, and what it makes of good, worn and wearing valves."""

import math

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.estimators import identify
from fastcoil.model.estimators.identify import ESTIMATOR, N_CANDIDATES, N_FLOATS, N_LAGS, N_MOVES, Memory, Parameters

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
    for at in (identify.P_AT, identify.P_EARLIER_AT):
        w[at : at + N_CANDIDATES] = -1e4
        for number, probability in of_sizes.items():
            w[at + int(number[1:])] = np.log(probability) / identify.LIKELIHOOD_WEIGHT
    return w


def test_a_field_controller_can_hold_it():
    """All that it remembers: 10 kB in double precision, 5 kB in single."""
    assert 8 * (ESTIMATOR.n_floats + len(Memory._fields)) < 10.6e3


def test_candidates_leave_no_size_without_a_right_one():
    sizes = np.linspace(0.0, 0.25, 2001)
    nearest = np.abs(sizes[:, np.newaxis] - identify.CANDIDATES).min(axis=1)
    assert np.all(nearest <= 0.5 * np.maximum(0.2 * sizes, 0.01) + 1e-12)
    assert identify.CANDIDATES.size == N_CANDIDATES
    assert np.all(np.diff(identify.CANDIDATES) > 0.0)


@INTERPRETED
def test_the_evidence_is_that_of_a_linear_model_with_a_normal_prior():
    """By the covariance of the changes themselves, one row a horizon, all candidates with openings of their own."""
    rng, rows, decay = np.random.default_rng(4), 90, 0.99
    changes, motor = rng.normal(size=rows + N_LAGS + 1), rng.normal(size=rows)
    moves = 0.1 * rng.normal(size=(rows, N_MOVES, N_CANDIDATES))
    w = np.zeros(N_FLOATS)
    for k in range(rows + N_LAGS):
        identify.remember_change(w, changes[k], motor[k - N_LAGS])
        if k >= N_LAGS:
            w[identify.MOVES_AT : identify.MOVES_AT + N_MOVES * N_CANDIDATES] = moves[k - N_LAGS].ravel()
            identify.add_row(w, decay)
    root = np.sqrt(decay ** np.arange(rows - 1, -1, -1.0))[:, np.newaxis]
    n_rows = float(np.sum(root**2))
    assert identify.compare_candidates(w, n_rows)
    common = [*(changes[N_LAGS - i : N_LAGS - i + rows] for i in range(1, N_LAGS + 1)), np.ones(rows)]
    for at, columns, first in ((identify.P_AT, common, 0), (identify.P_EARLIER_AT, [*common, motor], 1)):
        Z, freedom = root * np.stack(columns, axis=1), n_rows - len(columns)
        y = root[:, 0] * changes[N_LAGS : N_LAGS + rows]
        y = y - Z @ np.linalg.lstsq(Z, y)[0]
        for c in (0, 7, N_CANDIDATES - 1):
            D = root * moves[:, first:, c]
            D = D - Z @ np.linalg.lstsq(Z, D)[0]
            covariance = np.eye(rows) + D @ D.T / (identify.PRIOR_PRECISION * (y @ y) / freedom)
            residual_sum = y @ np.linalg.solve(covariance, y)
            expected = -0.5 * freedom * np.log(residual_sum / (y @ y)) - 0.5 * np.linalg.slogdet(covariance)[1]
            assert w[at + c] == pytest.approx(expected, abs=1e-9)


@INTERPRETED
def test_a_temperature_that_stands_still_explains_nothing():
    w = np.zeros(N_FLOATS)
    for _ in range(100):
        identify.remember_change(w, 0.0, 0.0)
        identify.add_row(w, 1.0)
    assert not identify.compare_candidates(w, 100.0)


@INTERPRETED
@pytest.mark.parametrize(
    ("estimate", "expected", "probabilities"),
    [
        pytest.param(0.0, 0.03, {"c6": 1.0}, id="sure"),
        pytest.param(0.0, 0.0, {"c6": 0.5, "c14": 0.5}, id="unsure"),
        pytest.param(0.0, 0.0, {"c6": 0.98, "c0": 0.02}, id="perhaps good"),
        pytest.param(0.035, 0.035, {"c6": 0.5, "c14": 0.5}, id="kept"),
        pytest.param(0.05, 0.0, {"c0": 0.5, "c2": 0.5}, id="good"),
        pytest.param(0.15, 0.05, {"c4": 0.4, "c6": 0.2, "c14": 0.4}, id="too large"),
        pytest.param(0.15, 0.0, {"c0": 0.4, "c6": 0.2, "c14": 0.4}, id="too large, perhaps good"),
        pytest.param(0.07, 0.07, {"c4": 0.4, "c6": 0.3, "c12": 0.3}, id="perhaps not"),
    ],
)
def test_an_estimate_is_taken_over_if_it_is_right_and_given_up_if_it_is_too_large(estimate, expected, probabilities):
    w = array_with_probabilities(**probabilities)
    assert identify.decide_estimate(w, estimate, 0.8, True) == pytest.approx(expected, abs=1e-12)


@INTERPRETED
def test_a_controller_that_answers_within_a_horizon_needs_earlier_openings_to_say_so_too():
    for answers, expected in ((True, 0.0), (False, 0.05)):
        w = array_with_probabilities(c10=1.0)
        w[identify.P_EARLIER_AT] = w[identify.P_EARLIER_AT + 10]
        assert identify.decide_estimate(w, 0.0, 0.8, answers) == pytest.approx(expected, abs=1e-12)


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
    np.testing.assert_allclose(ds.rmse[0], plain.rmse[0], rtol=1e-3)


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

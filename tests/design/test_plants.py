"""Plants at rest and their answer to a small step, beside the emulator itself."""

import numpy as np
import pytest
from helpers.linear_loops import LINEAR_LOOPS, conditions_of, rest_plants, rest_points, state_space

import fastcoil as fc
from fastcoil.design.operating_points import CONDITION_SERIES
from fastcoil.design.plants import LONGEST_RESPONSE, frequency_response, linearise_plants

pytestmark = pytest.mark.kernel

AT_REST = 5000
"""Seconds after which an emulated coil is at rest."""


def emulate(name, openings, seconds):
    """Traces of the emulator in open loop, one run for each series of openings, (n, n_steps)."""
    loop, entering = LINEAR_LOOPS[name]
    day = fc.constant_day(seconds / 3600, **entering)
    days = fc.Boundary(**{n: np.repeat(day.series[n], len(openings), 0) for n in CONDITION_SERIES})
    traces = ["T_sup", "m_w", "wet_volumes", "opening"]
    return fc.simulate(loop.assign(backlash=0.0), days, command=openings, traces=traces, warm_up=0, n_jobs=1)


@pytest.mark.parametrize("name", LINEAR_LOOPS)
def test_the_emulator_rests_where_the_theory_says(name):
    _, plant = rest_plants(name)
    ds = emulate(name, np.full((1, AT_REST), plant.opening[0]), AT_REST).isel(day=0, elapsed_time=-1)
    assert plant.reachable[0]
    T_set = LINEAR_LOOPS[name][1].get("T_set", 14.0)
    assert (plant.T_sup[0], float(ds.T_sup)) == (pytest.approx(T_set, abs=1e-8), pytest.approx(T_set, abs=1e-6))
    assert (float(ds.m_w), float(ds.wet_volumes)) == (pytest.approx(plant.m_w[0], rel=1e-12), plant.wet_volumes[0])


def test_the_kinds_are_dry_wet_and_partly_wet():
    wet = [rest_plants(name)[1].wet_volumes[0] for name in LINEAR_LOOPS]
    assert min(wet) == 0.0
    assert any(0.0 < count < 8.0 for count in wet)


@pytest.mark.parametrize("name", LINEAR_LOOPS)
def test_the_response_is_that_of_the_emulator_to_a_small_step_and_that_of_the_linear_map(name):
    columns, conditions = rest_points(name)
    plant, (A, B, C) = linearise_plants(columns, conditions), state_space(columns, conditions)
    size, after = 1e-4, 400
    openings = np.full((2, AT_REST + after), plant.opening[0])
    openings[0, AT_REST:] += size
    openings[1, AT_REST:] -= size
    T = emulate(name, openings, AT_REST + after).T_sup.values
    expected = (T[0] - T[1])[AT_REST + 1 :] / (2.0 * size)
    n = min(after - 1, plant.response.shape[1])
    np.testing.assert_allclose(plant.response[0, :n], expected[:n], atol=1e-6 * abs(plant.gain[0]))
    assert plant.response[0, -1] == pytest.approx(plant.gain[0], rel=2e-4)
    x, T = np.zeros(B.size), []
    for _ in range(plant.response.shape[1]):
        x = A @ x + B
        T.append(C @ x)
    np.testing.assert_allclose(plant.response[0], T, atol=1e-6 * abs(plant.gain[0]))
    assert np.abs(np.linalg.eigvals(A)).max() < 1.0


def test_a_response_that_outlasts_the_longest_goes_on_as_a_geometric_series():
    """A nearly closed valve: its water takes an hour to pass."""
    control = pytest.importorskip("control")
    columns, conditions = conditions_of(fc.Loop(m_max=0.2, C_w=250.0, backlash=0.0), fc.constant_day(0.6, T_set=19.5))
    plant, (A, B, C) = linearise_plants(columns, conditions), state_space(columns, conditions)
    assert plant.response.shape[1] == LONGEST_RESPONSE
    assert plant.response[0, -1] / plant.gain[0] < 0.99
    w = np.geomspace(1e-5, 0.1, 40)
    expected = control.ss(A, B[:, None], C[None, :], 0.0, 1.0).frequency_response(w).complex.ravel()
    np.testing.assert_allclose(frequency_response(plant.response, w)[0], expected, rtol=0.02)


def test_a_volume_at_its_dew_point_is_wet_to_the_share_that_the_emulator_shows():
    T_set = np.linspace(14.0, 16.0, 41)
    days = fc.Boundary(m_a=1.15, T_a_in=25.0, W_a_in=0.011, T_w_in=7.0, T_set=np.tile(T_set[:, None], (1, 1900)))
    plant = linearise_plants(*conditions_of(fc.Loop(backlash=0.0), days))
    share = plant.wet_volumes % 1.0
    at_edge = np.flatnonzero((share > 0.2) & (share < 0.8))
    assert at_edge.size > 1
    size, seconds = 0.0005, 5000
    held = fc.Boundary(m_a=1.15, T_a_in=25.0, W_a_in=0.011, T_w_in=7.0, T_set=np.full((at_edge.size, seconds), 14.0))
    late = []
    for step in (0.0, size, -size):
        opening = np.repeat(plant.opening[at_edge, None] + step, seconds, axis=1)
        options = {"traces": ["T_sup", "wet_volumes"], "warm_up": 0, "n_jobs": 1}
        ds = fc.simulate(fc.Loop(backlash=0.0), held, command=opening, **options)
        late.append(ds.isel(elapsed_time=slice(3000, None)))
    rest, up, down = (ds.T_sup.mean("elapsed_time").values for ds in late)
    assert (late[0].wet_volumes.std("elapsed_time") > 0.1).all()
    np.testing.assert_allclose(late[0].wet_volumes.mean("elapsed_time"), plant.wet_volumes[at_edge], atol=0.1)
    np.testing.assert_allclose(rest, T_set[at_edge], atol=0.005)
    np.testing.assert_allclose((up - down) / (2.0 * size), plant.gain[at_edge], rtol=0.1)


def test_equal_plants_are_found_once_and_their_order_does_not_matter():
    rng = np.random.default_rng(3)
    n = 150
    loop = fc.Loop(
        C_c=("sample", rng.choice([12.0, 30.0, 41.0], n)), kp=("sample", rng.uniform(0.01, 0.1, n)),
        air_march=("sample", rng.choice(["lagged", "quasistatic"], n)), backlash=("sample", rng.uniform(0, 0.1, n)),
    )  # fmt: skip
    columns, conditions = conditions_of(loop, fc.constant_day(0.6))
    plant = linearise_plants(columns, conditions)
    assert plant.kind.max() == 5
    order = rng.permutation(n)
    shuffled = linearise_plants({k: v[order] for k, v in columns.items()}, {k: v[order] for k, v in conditions.items()})
    np.testing.assert_array_equal(shuffled.response, plant.response[order])
    np.testing.assert_array_equal(shuffled.opening, plant.opening[order])


@pytest.mark.parametrize(
    ("name", "T_set", "opening"),
    [("wet, lagged", 3.0, 1.0), ("wet, lagged", 26.0, 0.0), ("heating", 70.0, 1.0), ("heating", 9.0, 0.0)],
)
def test_out_of_reach_the_nearest_end_is_taken(name, T_set, opening):
    loop, entering = LINEAR_LOOPS[name]
    plant = linearise_plants(*conditions_of(loop, fc.constant_day(0.6, **entering | {"T_set": T_set})))
    assert not plant.reachable[0]
    assert plant.opening[0] == opening
    assert (plant.T_sup[0] > T_set) == ((name == "heating") == (opening == 0.0))
    assert np.isfinite(plant.response).all()


def test_water_as_warm_as_the_air_reaches_nothing_and_answers_nothing():
    plant = linearise_plants(*conditions_of(fc.Loop(), fc.constant_day(0.6, T_w_in=25.0, relative_humidity=0.1)))
    assert not plant.reachable[0]
    assert abs(plant.gain[0]) < 1e-6


def test_a_coil_that_exchanges_less_when_wet_may_jump_past_the_set_point():
    """Then no opening holds it, and there is nothing to linearise; the others stay as they are."""
    T_set = np.linspace(13.0, 16.0, 31)
    days = fc.Boundary(m_a=1.15, T_a_in=25.0, W_a_in=0.011, T_w_in=7.0, T_set=np.tile(T_set[:, None], (1, 1900)))
    plant = linearise_plants(*conditions_of(fc.Loop(backlash=0.0, beta5=0.3), days))
    jumps = ~plant.reachable
    assert 0 < jumps.sum() < 15
    assert np.isnan(plant.gain[jumps]).all()
    assert np.isnan(plant.response[jumps]).all()
    assert (plant.gain[~jumps] < 0.0).all()
    np.testing.assert_allclose(plant.T_sup[~jumps], T_set[~jumps], atol=1e-4)
    levels = np.linspace(0.2, 0.3, 101)
    held = fc.Boundary(m_a=1.15, T_a_in=25.0, W_a_in=0.011, T_w_in=7.0, T_set=np.full((levels.size, 2500), 14.0))
    opening = np.repeat(levels[:, None], 2500, axis=1)
    ds = fc.simulate(fc.Loop(backlash=0.0, beta5=0.3), held, command=opening, traces=["T_sup"], warm_up=0, n_jobs=1)
    steps = np.abs(np.diff(ds.T_sup.isel(elapsed_time=-1).values))
    assert steps.max() > 2.5 * np.median(steps), "the emulator jumps, too"

"""Eqs (3) and (4): balances, limits without flow, closed-form steady state, maximum principle."""

import numpy as np
import pytest
import reference

import fastcoil as fc
from fastcoil.model import physics

CP_W, CP_A = 4.186, 1.02
EXPONENTS = [-5.0, -0.45, -0.2, 0.0, 0.3, 5.0]
VOLUME_TRACES = ["T_w", "T_c", "T_a", "W_a"]


# Eq (4)


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("m", [0.0, -0.0, -0.1])
def test_effectiveness_without_flow_is_1(m, exponent):
    with np.errstate(over="ignore"):  # the interpreter notices that integers wrap around
        assert physics.effectiveness(0.32, exponent, m) == 1.0


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_effectiveness_is_the_printed_formula(exponent):
    for m in np.geomspace(1e-3, 50.0, 61).tolist():
        expected = reference.effectiveness(m, 0.32, exponent)
        assert physics.effectiveness(0.32, exponent, m) == pytest.approx(expected, rel=1e-13, abs=2e-16)


def test_effectiveness_lies_between_0_and_1_even_for_absurd_flows():
    values = [physics.effectiveness(0.32, k, m) for k in EXPONENTS for m in (1e-300, 1e-9, 1.0, 1e9)]
    assert all(0.0 <= eps <= 1.0 for eps in values)


# Eq (3), one volume


def random_volumes(n=200):
    """(T_w, T_w_in, T_c, T_in, W_in, m_w, m_a) in all combinations that a coil may meet, wet and dry."""
    rng = np.random.default_rng(3)
    temperatures = rng.uniform([2, 2, 5, 8], [50, 50, 40, 45], (n, 4))
    return np.column_stack([temperatures, rng.uniform(0.002, 0.025, n), rng.uniform(0, 3, (n, 2))]).tolist()


@pytest.mark.parametrize("wet", [False, True])
def test_one_volume_stores_what_air_and_water_bring(wet):
    C_w, C_c = 8.8, 30.0
    for T_w, T_w_in, T_c, T_in, W_in, m_w, m_a in random_volumes():
        G_w = physics.effectiveness(0.32, -0.2, m_w) * m_w * CP_W
        eps_a, eps_star = physics.effectiveness(0.40, -0.45, m_a), physics.effectiveness(0.42, -0.42, m_a)
        W_s = physics.saturation_humidity_ratio(T_c, 101325.0)
        cooled, dried = eps_a * (T_in - T_c), eps_star * physics.enthalpy_difference(T_in, W_in, T_c, W_s)
        Q_a, Q_w = physics.air_heat(wet, m_a, cooled, dried, CP_A), physics.water_heat(G_w, T_c, T_w_in)
        stored = C_c * (physics.next_metal_temperature(T_c, Q_a, Q_w, 1.0 / C_c) - T_c)
        stored += C_w * (physics.next_water_temperature(T_w, T_w_in, Q_w, m_w * CP_W, 1.0 / C_w) - T_w)
        lost_by_air = m_a * dried if wet else m_a * CP_A * cooled
        assert stored == pytest.approx(lost_by_air + m_w * CP_W * (T_w_in - T_w), abs=1e-11)


def test_dry_air_keeps_its_humidity_and_wet_air_gains_none():
    for *_, T_c, T_in, W_in, _, m_a in random_volumes():
        h_in = reference.enthalpy(T_in, W_in)
        h_s = reference.enthalpy(T_c, physics.saturation_humidity_ratio(T_c, 101325.0))
        cooled = physics.effectiveness(0.4, -0.45, m_a) * (T_in - T_c)
        dried = physics.effectiveness(0.42, -0.42, m_a) * (h_in - h_s)
        T_out = T_in - cooled
        W_out = min(reference.humidity_ratio(h_in - dried, T_out), W_in)
        assert physics.condensed_water(False, W_in, cooled, dried, T_out) == 0.0
        assert W_in - physics.condensed_water(True, W_in, cooled, dried, T_out) == pytest.approx(W_out, abs=1e-16)


# The whole coil


def simulate_open_loop(day, opening, **parameters):
    """All volumes over a day at a constant or given opening, no backlash."""
    command = np.broadcast_to(opening, day.n_steps)
    names = [*VOLUME_TRACES, "m_w", "T_sup", "T_w_out", "wet_volumes"]
    loop = fc.Loop(backlash=0.0, **parameters)
    return fc.simulate(loop, day, command=command, traces=names, warm_up=60)


@pytest.fixture(scope="module")
def dry_day():
    return fc.constant_day(hours=1.5, T_a_in=26.0, W_a_in=0.004, m_a=1.3)


@pytest.fixture(scope="module")
def wet_day():
    return fc.constant_day(hours=1.5, T_a_in=26.0, W_a_in=0.016, m_a=1.3, T_w_in=5.0)


@pytest.mark.kernel
@pytest.mark.parametrize("air_march", ["lagged", "quasistatic"])
@pytest.mark.parametrize(("n_volumes", "opening"), [(1, 0.4), (3, 0.2), (8, 0.4), (8, 1.0), (20, 0.4)])
def test_dry_steady_state_is_the_closed_form(dry_day, n_volumes, opening, air_march):
    ds = simulate_open_loop(dry_day, opening, n_volumes=n_volumes, air_march=air_march, C_w=max(8.8, 1.1 * n_volumes))
    parameters = reference.PAPER_LIKE | {"n_volumes": n_volumes}
    T_sup, T_w_out = reference.steady_state_dry(parameters, float(ds.m_w[-1]), 1.3, 7.0, 26.0)
    assert float(ds.T_sup[-1]) == pytest.approx(T_sup, abs=1e-9)
    assert float(ds.T_w_out[-1]) == pytest.approx(T_w_out, abs=1e-9)


@pytest.mark.kernel
@pytest.mark.parametrize("day", ["dry_day", "wet_day"])
def test_lagged_and_quasistatic_settle_alike(day, request):
    day = request.getfixturevalue(day)
    lagged, quasistatic = (simulate_open_loop(day, 0.5, air_march=march) for march in ("lagged", "quasistatic"))
    for name in VOLUME_TRACES:
        np.testing.assert_allclose(lagged[name][:, -1], quasistatic[name][:, -1], rtol=0.0, atol=1e-9)
    assert np.abs(lagged.T_sup - quasistatic.T_sup).max() > 0.1


@pytest.mark.kernel
def test_number_of_volumes_keeps_the_totals(dry_day):
    """More volumes approach the ideal counter-flow coil with the same total conductances."""
    settled = {n: float(simulate_open_loop(dry_day, 0.4, n_volumes=n, C_w=70.0).T_sup[-1]) for n in (4, 8, 16, 32, 64)}
    refinement = np.diff(list(settled.values()))
    assert abs(settled[8] - settled[64]) < 0.1
    np.testing.assert_allclose(refinement[1:] / refinement[:-1], 0.25, atol=0.002)


@pytest.mark.kernel
@pytest.mark.parametrize("n_volumes", [1, 5, 8])
@pytest.mark.parametrize("day", ["dry_day", "wet_day"])
def test_energy_closes_to_round_off_over_a_run(day, n_volumes, request):
    """What air and water bring is stored in metal and water; quasistatic, so no air is under way.

    Water and metal exchange at their means over a second, air and metal at the metal's start, but for G_a ΔT_c / 2.
    """
    day = request.getfixturevalue(day)
    opening = 0.45 + 0.35 * np.sin(np.arange(day.n_steps) / 120.0)
    ds = simulate_open_loop(day, opening, air_march="quasistatic", n_volumes=n_volumes)
    T_w, T_c, T_a, W_a, m_w = (ds[name].values for name in (*VOLUME_TRACES, "m_w"))
    m_a, T_a_in, W_a_in, T_w_in = (day.series[name][0, 0] for name in ("m_a", "T_a_in", "W_a_in", "T_w_in"))
    T_out, W_out, T_metal = T_a[:, :-1], W_a[:, :-1], T_c[:, :-1]
    T_in = np.vstack([T_out[1:], np.full_like(T_out[:1], T_a_in)])
    W_in = np.vstack([W_out[1:], np.full_like(W_out[:1], W_a_in)])
    T_w_mean = 0.5 * (T_w[:, :-1] + T_w[:, 1:])
    T_water_in = np.vstack([np.full_like(T_out[:1], T_w_in), T_w_mean[:-1]])

    W_s = np.vectorize(reference.saturation_humidity_ratio)(T_metal, 101325.0)
    wet = W_in > W_s
    dry_heat = m_a * CP_A * (T_in - T_out)
    wet_heat = m_a * (reference.enthalpy(T_in, W_in) - reference.enthalpy(T_out, W_out))
    scale = 8.0 / n_volumes
    stored = np.diff(8.8 * scale * T_w + 30.0 * scale * T_c)
    less_heat = 0.5 * reference.effectiveness(m_a, 0.40 * scale, -0.45) * m_a * CP_A * np.diff(T_c)
    air = np.where(wet, wet_heat, dry_heat) - less_heat
    residual = stored - m_w[:-1] * CP_W * (T_water_in - T_w_mean) - air
    # where W_out is limited to W_in, the outlet does not show the h_out of the balance
    is_balance_visible = ~(wet & (W_out == W_in))
    assert np.count_nonzero(is_balance_visible) > 0.98 * is_balance_visible.size
    assert np.abs(residual[is_balance_visible]).max() < 1e-11
    assert np.abs(stored).max() > 0.1
    assert wet.any() == (W_a_in > 0.01)


@pytest.mark.kernel
@pytest.mark.parametrize("air_march", ["lagged", "quasistatic"])
def test_maximum_principle_up_to_the_stability_limit(air_march):
    """With γ = 1 at full opening and λ < 1 a dry coil stays between its coldest and warmest entry."""
    rng = np.random.default_rng(4)
    blocks = {
        name: rng.uniform(low, high, 90).repeat(40)
        for name, low, high in [("m_a", 0.2, 1.5), ("T_a_in", 18.0, 30.0), ("T_w_in", 5.0, 15.0)]
    }
    day = fc.Boundary(**blocks, W_a_in=0.001, T_set=14.0)
    C_w = CP_W * reference.richards_valve(1.0, 2.0, 0.7, 9.0, 0.38) * (1 + 1e-12)
    ds = simulate_open_loop(day, rng.choice([0.0, 0.3, 1.0], 180).repeat(20), air_march=air_march, C_w=C_w, C_c=6.0)
    low = min(blocks["T_w_in"].min(), 20.0)
    high = max(blocks["T_a_in"].max(), 20.0)
    for name in ("T_w", "T_c", "T_a"):
        assert ds[name].min() >= low
        assert ds[name].max() <= high


@pytest.mark.kernel
def test_next_to_no_water_flow_freezes_the_water(dry_day):
    """The Richards curve never reaches 0: a steep one comes to 1e-300 kg/s."""
    opening = np.where(np.arange(dry_day.n_steps) < 600, 1.0, 0.0)
    ds = simulate_open_loop(dry_day, opening, valve_b=2000.0, valve_c=0.5)
    assert float(ds.m_w[-1]) < 1e-300
    T_w = ds.T_w.values
    np.testing.assert_array_equal(T_w[:, 601:], np.broadcast_to(T_w[:, [600]], T_w[:, 601:].shape))
    np.testing.assert_allclose(ds.T_c.values[:, -1], 26.0, atol=1e-6)


@pytest.mark.kernel
def test_without_air_flow_every_volume_gives_the_temperature_of_its_metal():
    ds = simulate_open_loop(fc.constant_day(hours=0.5).assign(m_a=0.0, enabled=1), 0.5)
    np.testing.assert_allclose(ds.T_a.values[:, 1:], ds.T_c.values[:, :-1], rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(ds.T_c.values[:, -1], 7.0, atol=1e-6)


@pytest.mark.kernel
@pytest.mark.parametrize("W_a_in", [0.004, 0.016])
def test_quasistatic_march_approaches_runge_kutta_and_starts_a_tenth_as_far_away_as_the_printed_one(W_a_in):
    """T_sup over twenty minutes with steps of the valve; half the step leaves half the error."""
    day = fc.constant_day(hours=1 / 3, T_a_in=26.0, W_a_in=W_a_in, m_a=1.3)
    command = np.repeat([0.2, 0.7, 0.4, 0.0], 300)
    boundary = {name: np.broadcast_to(day.series[name][0], day.n_steps) for name in reference.INPUTS}
    parameters = reference.PAPER_LIKE | {"backlash": 0.0, "C_c": 10.0}
    traces, _ = reference.simulate(parameters | {"air_march": "runge_kutta"}, boundary, command=command, warm_up=60)
    loop = fc.Loop(backlash=0.0, C_c=10.0, air_march=["quasistatic", "lagged"], substeps=[1, 2, 4])
    ds = fc.simulate(loop, day, command=command, traces=["T_sup"], warm_up=60)
    error = np.abs(ds.T_sup - np.array(traces["T_sup"])).mean("elapsed_time").values
    assert error[0, 0] < 0.15 * error[1, 0]
    np.testing.assert_allclose(error[0, 1:] / error[0, :-1], 0.5, atol=0.02)

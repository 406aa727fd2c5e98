"""Ready-made days follow their formulas, and refuse what they cannot be."""

import numpy as np
import pytest
from helpers.refusals import assert_refused
from scipy.signal import lfilter

import fastcoil as fc
from fastcoil.loops.boundary import days
from fastcoil.loops.boundary.days import SET_POINTS, Drift, constant_day, design_day, paper_day, smooth_noise
from fastcoil.model import moist_air


def noise_of(drifts, seed, n_steps):
    return {name: smooth_noise(n_steps, drift, (seed, i)) for i, (name, drift) in enumerate(drifts.items())}


def slow_swing(n_steps):
    """A sine up to hour 8, mirrored there and at every further multiple of 8 h."""
    hours = (t / 3600 for t in range(n_steps))
    return np.array([np.sin(np.pi * ((x if x <= 8 else 16 - x) - 1) / 9) for x in (h % 16 for h in hours)])


def test_paper_day_is_its_formula_with_a_stream_of_noise_for_each_signal():
    n = 17 * 3600
    series = {name: values[0] for name, values in paper_day(17.0, 5).series.items()}
    h, D, noise = np.arange(n) / 3600, slow_swing(n), noise_of(days.DRIFTS, 5, n)
    expected = {
        "m_a": 1.15 + 0.18 * D + noise["m_a"],
        "T_a_in": 25 + 1.5 * D + noise["T_a_in"],
        "W_a_in": moist_air.humidity_ratio(series["T_a_in"], 0.56 - 0.05 * D + noise["RH"]),
        "T_w_in": 7 + 0.4 * np.sin(2 * np.pi * h / 1.5) + noise["T_w_in"],
        "T_set": np.resize(np.repeat(SET_POINTS, 1800), n),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(series[name], values, rtol=1e-12)


def test_heating_day_is_its_formula_with_a_stream_of_noise_for_each_signal():
    n = 9 * 3600
    series = {name: values[0] for name, values in fc.heating_day(9.0, 5, T_w_in=50.0).series.items()}
    h, D, noise = np.arange(n) / 3600, slow_swing(n), noise_of(days.HEATING_DRIFTS, 5, n)
    expected = {
        "m_a": 0.9 + 0.2 * D + noise["m_a"],
        "T_a_in": 12.0 + 2.0 * D + noise["T_a_in"],
        "T_w_in": 50.0 + np.sin(2 * np.pi * h / 1.5) + noise["T_w_in"],
        "T_set": np.resize(np.repeat(SET_POINTS, 1800), n) + 11.0,
    }
    for name, values in expected.items():
        np.testing.assert_allclose(series[name], values, rtol=1e-12)


@pytest.mark.parametrize("day", [paper_day, fc.heating_day])
@pytest.mark.parametrize("hours", [1 / 3600, 1.0, 8.0 - 1 / 3600])
def test_a_shorter_day_is_the_beginning_of_a_longer_one(day, hours):
    short, long = day(hours, [1, 77]), day(8.0, [77, 5, 1])
    assert short.n_steps == round(hours * 3600)
    for name, values in short.series.items():
        np.testing.assert_array_equal(values[0], long.series[name][2, : short.n_steps])
        np.testing.assert_array_equal(values[1], long.series[name][0, : short.n_steps])


def test_a_seed_gives_the_same_day_alone_and_among_others():
    several = paper_day(0.5, range(10, 13))
    np.testing.assert_array_equal(several.day, [10, 11, 12])
    np.testing.assert_array_equal(paper_day(0.5, 11).series["T_w_in"][0], several.series["T_w_in"][1])
    assert paper_day(0.5, np.int64(11)) == paper_day(0.5, 11) != paper_day(0.5, 12)
    assert paper_day(0.5, [11]).has_day_dim
    assert not paper_day(0.5, 11).has_day_dim


def test_noise_is_white_noise_through_two_filters_over_the_deviation_of_their_impulse_response():
    k = 1 - np.exp(-1 / 60)
    raw = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(2,))).standard_normal(601)
    impulse, filtered = (lfilter([k], [1, k - 1], lfilter([k], [1, k - 1], x)) for x in (np.eye(1, 4000)[0], raw))
    expected = filtered[-1] / np.sqrt(np.sum(impulse**2))
    assert smooth_noise(1, Drift(1.0, 60), (3, 2))[0] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(
    ("field", "code", "value"),
    [
        ("hours", "value", 0), ("hours", "value", float("nan")), ("hours", "type", None), ("hours", "value", 1 / 7000),
        ("hours", "value", 1e6), ("seed", "value", 2**32), ("seed", "type", "1"), ("seed", "duplicate", [4, 1, 4]),
        ("seed", "missing", []), ("seed", "size", range(10**7)),
    ],
)  # fmt: skip
def test_paper_day_refuses(field, code, value):
    assert_refused(field, code, paper_day, **{field: value})


def test_constant_day_is_constant_and_the_centre_of_paper_day():
    boundary = constant_day(0.5)
    for values in boundary.series.values():
        assert np.ptp(values) == 0.0
    first = {name: values[0, 0] for name, values in boundary.series.items()}
    W = float(moist_air.humidity_ratio(25.0, 0.56))
    driving = {"m_a": 1.15, "T_a_in": 25.0, "W_a_in": W, "T_w_in": 7.0, "T_set": 14.0}
    assert first == driving | {
        "noise": 0.0,
        "enabled": 1.0,
        "backlash_scale": 1.0,
        "T_out": 0.0,
        "Q_room": 0.0,
        "dp_ratio": 1.0,
    }
    assert constant_day(0.5, W_a_in=0.01).series["W_a_in"][0, 0] == 0.01
    assert constant_day(0.5, T_set=np.linspace(13, 14, 1800)).n_steps == 1800


def test_design_day_outdoors_follows_the_handbooks_profile():
    """With outdoor air only, the entering air is the outdoor air."""
    cooling = design_day(24.0, outdoor_fraction=1.0, start_hour=0.0).series
    T = cooling["T_a_in"][0]
    assert T.max() == pytest.approx(33.3, abs=1e-10)
    assert T.max() - T.min() == pytest.approx(10.5, abs=1e-10)
    assert T[14 * 3600] == T[15 * 3600] == T.max()
    assert np.argmin(T) == 5 * 3600
    assert T[9 * 3600] == pytest.approx(33.3 - 0.55 * 10.5, abs=1e-10)
    assert T[9 * 3600 + 1800] == pytest.approx(33.3 - (0.55 + 0.38) / 2 * 10.5, abs=1e-10)
    assert T[0] == pytest.approx(33.3 - 0.82 * 10.5, abs=1e-10)
    # Independent value of the humidity ratio: PsychroLib at 33.3/23.7 degC, 98 934 Pa.
    np.testing.assert_allclose(cooling["W_a_in"], 0.014935627057992496, rtol=1e-9)


def test_design_day_in_heating_is_coldest_at_hour_5():
    flat = design_day(24.0, "heating", outdoor_fraction=1.0).series["T_a_in"]
    np.testing.assert_allclose(flat, -20.0, atol=1e-10)
    T = design_day(24.0, "heating", outdoor_fraction=1.0, T_daily_range=8.0, start_hour=0.0).series["T_a_in"][0]
    assert np.argmin(T) == 5 * 3600
    assert T.min() == pytest.approx(-20.0, abs=1e-10)
    assert T.max() == pytest.approx(-12.0, abs=1e-10)


def test_design_day_mixes_with_return_air_and_starts_at_its_hour():
    mixed, outdoors = (design_day(2.0, outdoor_fraction=x, start_hour=23.0).series for x in (0.3, 1.0))
    whole = design_day(24.0, outdoor_fraction=1.0, start_hour=0.0).series["T_a_in"][0]
    np.testing.assert_allclose(outdoors["T_a_in"][0], np.roll(whole, 3600)[:7200], atol=1e-9)
    W_return = moist_air.humidity_ratio(24.0, 0.5, days.DESIGN_PRESSURE_PA)
    np.testing.assert_allclose(mixed["W_a_in"], 0.3 * outdoors["W_a_in"] + 0.7 * W_return, rtol=1e-12)
    assert (mixed["T_a_in"] < 0.3 * outdoors["T_a_in"] + 0.7 * 24.0 + 0.1).all()


@pytest.mark.parametrize(
    ("field", "code", "value"),
    [
        ("mode", "choice", "cool"), ("outdoor_fraction", "value", 30), ("T_design", "value", 92.0),
        ("T_wet_bulb", "conflict", 35.0), ("start_hour", "value", 25), ("T_w_in", "value", 44.6 + 273),
    ],
)  # fmt: skip
def test_design_day_refuses(field, code, value):
    assert_refused(field, code, design_day, **{field: value})


def test_two_humidities_are_refused():
    assert_refused("relative_humidity", "conflict", constant_day, W_a_in=0.01, relative_humidity=0.5)

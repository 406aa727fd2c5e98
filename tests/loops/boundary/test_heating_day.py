"""``heating_day``: what its docstring says, whatever its length and seeds."""

import numpy as np
import pytest
from helpers.refusals import assert_only_problem

import fastcoil as fc
from fastcoil.loops.boundary.days import HEATING_DRIFTS, SET_POINTS, smooth_noise


def test_the_series_are_those_of_the_docstring_but_for_small_noise():
    day = fc.heating_day(hours=8, seed=range(12), T_w_in=50.0).series
    h = np.arange(8 * 3600) / 3600
    D = np.sin(np.pi * (h - 1) / 9)
    for name, mean, std in (
        ("m_a", 0.9 + 0.2 * D, 0.015),
        ("T_a_in", 12.0 + 2.0 * D, 0.2),
        ("T_w_in", 50.0 + np.sin(2 * np.pi * h / 1.5), 0.3),
    ):
        noise = day[name] - mean
        assert abs(noise.mean()) < 0.3 * std
        assert noise.std() == pytest.approx(std, rel=0.15)
    assert np.array_equal(day["T_set"][0], np.repeat(SET_POINTS, 1800) + 11.0)


def test_a_shorter_day_is_the_beginning_of_a_longer_one():
    short, long = fc.heating_day(1.0, 7).series, fc.heating_day(9.0, [3, 7]).series
    for name, values in short.items():
        assert np.array_equal(values[0], long[name][-1][: values.shape[1]]), name


def test_several_seeds_are_days():
    day = fc.heating_day(0.5, [4, 2])
    assert list(day.day) == [4, 2]
    assert not np.array_equal(day.series["m_a"][0], day.series["m_a"][1])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"T_w_in": 400.0}, ["T_w_in = 400 degC"]),
        ({"T_w_in": "hot"}, ["T_w_in"]),
        ({"hours": 0.0}, ["hours"]),
        ({"seed": -1}, ["seed"]),
    ],
)
def test_a_wrong_argument_is_refused(arguments, words):
    assert_only_problem(words, fc.heating_day, **arguments)


def test_each_series_has_a_stream_of_noise_of_its_own():
    day = fc.heating_day(0.5, 5).series
    wanted = smooth_noise(1800, HEATING_DRIFTS["T_w_in"], (5, list(HEATING_DRIFTS).index("T_w_in")))
    h = np.arange(1800) / 3600
    np.testing.assert_allclose(day["T_w_in"][0], 60.0 + np.sin(2 * np.pi * h / 1.5) + wanted, rtol=0, atol=1e-12)

"""Constant and design days: the handbook's profile, return air, and what is refused."""

import numpy as np
import pytest
from helpers.refusals import assert_only_problem, only_problem, problems

from fastcoil.loops.boundary import days
from fastcoil.loops.boundary.days import constant_day, design_day
from fastcoil.model import moist_air


def test_constant_day_is_constant_and_the_centre_of_paper_day():
    boundary = constant_day(0.5)
    for values in boundary.series.values():
        assert np.ptp(values) == 0.0
    first = {name: values[0, 0] for name, values in boundary.series.items()}
    assert first == {
        "m_a": 1.15,
        "T_a_in": 25.0,
        "W_a_in": float(moist_air.humidity_ratio(25.0, 0.56)),
        "T_w_in": 7.0,
        "T_set": 14.0,
        "noise": 0.0,
        "enabled": 1.0,
        "backlash_scale": 1.0,
    }
    assert constant_day(0.5, W_a_in=0.01).series["W_a_in"][0, 0] == 0.01
    assert constant_day(0.5, T_set=np.linspace(13, 14, 1800)).n_steps == 1800


def test_constant_day_refuses():
    assert "give one of them" in only_problem(constant_day, W_a_in=0.01, relative_humidity=0.5)
    assert "relative_humidity = 56" in only_problem(constant_day, relative_humidity=56)
    found = problems(constant_day, m_a=-1.0, T_w_in=280.0, T_set=[14.0, 15.0])
    assert any("T_set has 2 samples" in text or "where T_set has 2" in text for text in found)
    assert any("T_w_in = 280 degC" in text for text in found)
    assert any("m_a = -1" in text for text in found)


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
    W_return = moist_air.humidity_ratio(24.0, 0.5, days.DESIGN_PRESSURE)
    np.testing.assert_allclose(mixed["W_a_in"], 0.3 * outdoors["W_a_in"] + 0.7 * W_return, rtol=1e-12)
    assert (mixed["T_a_in"] < 0.3 * outdoors["T_a_in"] + 0.7 * 24.0 + 0.1).all()


def test_design_day_outdoor_air_is_at_most_saturated():
    series = design_day(24.0, T_design=20.0, T_wet_bulb=19.5, T_daily_range=15.0, outdoor_fraction=1.0).series
    saturated = moist_air.saturation_humidity_ratio(series["T_a_in"], days.DESIGN_PRESSURE)
    assert (series["W_a_in"] <= saturated * (1 + 1e-12)).all()
    assert (series["W_a_in"] > 0.999 * saturated).any()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"mode": "cool"}, ["mode = 'cool'", "'cooling' or 'heating'"]),
        ({"hours": 0}, ["hours = 0 h"]),
        ({"outdoor_fraction": 30}, ["outdoor_fraction = 30", "from 0 to 1"]),
        ({"T_design": 92.0}, ["T_design = 92 degC", "from -40 to 60"]),
        ({"T_wet_bulb": 35.0}, ["T_wet_bulb = 35 degC", "T_design = 33.3"]),
        ({"start_hour": 25}, ["start_hour = 25 h", "from 0 to 24"]),
        ({"RH_return": 50}, ["RH_return = 50", "from 0 to 1"]),
        ({"pressure": 101.3}, ["pressure = 101.3 Pa"]),
        ({"T_w_in": 44.6 + 273}, ["T_w_in = 317.6 degC"]),
    ],
)
def test_design_day_refuses(arguments, words):
    assert_only_problem(words, design_day, **arguments)

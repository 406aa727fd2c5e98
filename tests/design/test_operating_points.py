"""Operating points of a day: every hour at every set-point, and nothing that does not count."""

import numpy as np
import pytest
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.design.operating_points import operating_points

AIR = {"m_a": 1.2, "W_a_in": 0.01, "T_w_in": 7.0}


def day(T_set, **changes):
    n = len(T_set)
    return fc.Boundary(**(AIR | {"T_a_in": 20.0 + np.arange(n) / 3600.0, "T_set": np.array(T_set, float)} | changes))


def test_each_hour_at_each_set_point_is_one_point_with_its_mean_conditions():
    points = operating_points(day(np.r_[np.full(5400, 14.0), np.full(5400, 16.0)]), warm_up=1800)
    assert (points.start.tolist(), points.seconds.tolist()) == ([1800, 3600, 5400, 7200], [1800, 1800, 1800, 3600])
    assert points.conditions["T_set"].tolist() == [14.0, 14.0, 16.0, 16.0]
    seconds = [range(1800, 3600), range(3600, 5400), range(5400, 7200), range(7200, 10800)]
    expected = [sum(20.0 + t / 3600.0 for t in each) / len(each) for each in seconds]
    assert points.conditions["T_a_in"] == pytest.approx(expected)


def test_a_set_point_that_drifts_counts_in_half_kelvins_and_one_held_for_a_minute_not_at_all():
    T_set = np.r_[np.linspace(14.0, 14.9, 3600), np.full(60, 18.0), np.full(3540, 14.9)]
    points = operating_points(day(T_set), warm_up=0)
    assert points.size == 4
    assert np.round(points.conditions["T_set"], 1).tolist() == [14.1, 14.5, 14.8, 14.9]
    assert points.conditions["T_set"].max() < 15.0


def test_seconds_off_and_of_the_warm_up_do_not_count():
    points = operating_points(day(np.full(7200, 14.0), enabled=np.r_[np.ones(4000), np.zeros(3200)]), warm_up=600)
    assert (points.start.tolist(), points.seconds.tolist()) == ([600, 3600], [3000, 400])


def test_a_second_is_the_conditions_of_that_second_and_one_that_is_off_is_refused():
    boundary = day(np.full(7200, 14.0), enabled=np.r_[np.ones(4000), np.zeros(3200)])
    points = operating_points(boundary, 1800, at=36)
    assert (points.size, points.conditions["T_a_in"].tolist()) == (1, [20.01])
    assert_refused("at", "value", operating_points, boundary, 1800, at=5000)
    assert_refused("boundary", "data", operating_points, day(np.full(7200, 14.0), enabled=0.0), 1800)

"""The figure of a boundary: what it shows of a day and of many, the clock on its axis, looks."""

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit

from fastcoil.loops.boundary import display
from fastcoil.loops.boundary.days import constant_day, paper_day

DAY = paper_day(2.0, 1)
DAYS = paper_day(0.5, range(9))


def panel(figure, label):
    (axes,) = [axes for axes in figure.axes if axes.get_ylabel().replace("\n", " ") == label]
    return axes


def curve(figure, label="air flow [kg/s]", k=0):
    return panel(figure, label).lines[k].get_xydata().T


def test_a_day_is_drawn_over_hours_with_all_its_samples_averaged():
    figure = DAY.plot()
    hours, flow = curve(figure)
    assert figure.axes[-1].get_xlabel() == "time since the start [h]"
    assert (hours[0], hours[-1]) == (0.0, 2.0 - 5 / 3600)
    np.testing.assert_allclose(flow, DAY.series["m_a"].reshape(-1, 5).mean(axis=1), rtol=1e-12)
    _, T_set = curve(figure, "temperature [°C]", 2)
    assert set(T_set) <= set(DAY.series["T_set"][0])
    humidity = curve(figure, "humidity ratio [g/kg]")[1]
    np.testing.assert_allclose(humidity.mean(), 1e3 * DAY.series["W_a_in"].mean(), rtol=1e-9)
    assert len(figure.axes) == 3


def test_series_that_do_something_have_a_panel():
    figure = DAY.assign(noise=0.1, enabled=(np.arange(7200) > 3600).astype(float), backlash_scale=2.0).plot()
    assert len(figure.axes) == 6
    assert set(curve(figure, "in operation [%]")[1]) <= {0.0, 80.0, 100.0}
    assert (curve(figure, "backlash scale")[1] == 2.0).all()


def test_days_that_follow_each_other_are_on_one_clock_and_others_on_top_of_each_other():
    from matplotlib.dates import num2date

    follow = DAYS.isel([0, 1]).assign(start="2024-05-01T08:00", time_zone="Europe/Berlin").plot()
    assert follow.axes[-1].get_xlabel() == "date and time (Europe/Berlin)"
    times, flow = curve(follow)
    assert num2date(times[0]).isoformat() == "2024-05-01T08:00:00+00:00"
    assert num2date(times[-1]).isoformat() == "2024-05-02T08:30:00+00:00"
    assert np.isnan(flow).sum() == 2
    over = DAYS.isel([0, 1]).plot()
    np.testing.assert_allclose(curve(over)[1], DAYS.series["m_a"][:2].reshape(2, -1, 2).mean(axis=(0, 2)), rtol=1e-12)
    pieces = DAYS.series["m_a"][:2].reshape(2, -1, 2)
    _, low, high = display._course(DAYS.isel([0, 1]))[-1]["m_a"]
    np.testing.assert_array_equal(low, pieces.min(axis=(0, 2)))
    np.testing.assert_array_equal(high, pieces.max(axis=(0, 2)))
    starts = ["2024-05-01T08:00", "2024-06-01T08:00"]
    clock = DAYS.isel([0, 1]).assign(start=starts).plot()
    assert clock.axes[-1].get_xlabel() == "hour of the day"
    assert curve(clock)[0][0] == 8.0


def test_many_days_have_few_points_and_gaps_between_them():
    seventy = paper_day(0.01, range(70)).assign(start="2024-05-01")
    times, flow = curve(seventy.plot())
    np.testing.assert_array_equal(np.isnan(flow), np.arange(times.size) % 19 == 18)  # a gap after each day
    assert flow.size == 70 * 19
    whole = display._course(constant_day(24.0).assign(day=range(5), start="2024-05-01"))
    assert (whole[0].size, whole[2]) == (5 * 288, "5 min")


@pytest.mark.parametrize("boundary", [DAY, DAYS.assign(start="2024-05-01T08:00", time_zone="UTC")])
def test_it_looks_as_all_figures_do(boundary):
    figure = boundary.plot()
    assert_texts_fit(figure)
    assert_palette(figure)

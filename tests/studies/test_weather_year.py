"""A year of weather with its operation: schedule, calendar, what acts on the coil on days with constant weather."""

import pickle

import numpy as np
import pytest
from helpers.made_weather import write_weather
from helpers.weather_years import epw, hours_from

from fastcoil.model.moist_air import humidity_ratio, humidity_ratio_from_dew_point
from studies.year.operation import weather_year

pytestmark = pytest.mark.filterwarnings("ignore:hourly weather")
CALM_YEAR = {"disturbances": 0.0, "year": 2023, "zone_spread": 0.0}


def series_on_day(path, k=2, **options):
    """Series of a day of a calm year by position; the third of January 2023 is a Tuesday."""
    return weather_year(path, **CALM_YEAR | options).of_day(k)


def noon_values(series):
    return {name: float(values[12 * 3600]) for name, values in series.items()}


def test_the_fan_runs_in_its_hours_on_weekdays_and_the_loop_is_off_outside(tmp_path):
    path = write_weather(tmp_path, 30.0, days=9)
    fan = {"fan_hours": (6.5, 18), "weekend_fan_hours": (8, 12)}
    year = weather_year(path, **CALM_YEAR, **fan, set_point="fixed")
    for k in range(9):  # 2023 begins with a Sunday
        begin, end = (8, 12) if k in (0, 6, 7) else (6.5, 18)
        clock = np.arange(86400) / 3600
        runs = (clock >= begin) & (clock < end)
        series = year.of_day(k)
        np.testing.assert_array_equal(series["m_a"] > 0, runs)
        np.testing.assert_array_equal(series["enabled"], runs)  # 30 degC outdoors: the coil always has to cool
    rests = weather_year(path, **CALM_YEAR).of_day(0)
    assert not (rests["m_a"] + rests["enabled"]).any()


def test_days_have_dates_and_labels_and_can_be_chosen(tmp_path):
    path = write_weather(tmp_path, 20.0, days=365)
    year = weather_year(path, **CALM_YEAR)
    assert year.is_streamed
    assert (year.n_days, year.hours) == (365, 24.0)
    np.testing.assert_array_equal(year.day, np.arange(1, 366))
    assert (str(year.start[0]), str(year.start[-1])) == ("2023-01-01T00:00:00", "2023-12-31T00:00:00")
    winter = weather_year(path, **CALM_YEAR, days=[364, 365, 1, 2])
    assert winter.day.tolist() == [364, 365, 1, 2]
    assert [str(start)[:10] for start in winter.start] == ["2023-12-30", "2023-12-31", "2024-01-01", "2024-01-02"]
    assert winter.of_day(2)["m_a"].any()  # a Monday in 2024
    few = weather_year(path, **CALM_YEAR, days=[40, 200])
    assert few.day.tolist() == [40, 200]
    np.testing.assert_array_equal(few.of_day(1)["m_a"], year.of_day(199)["m_a"])


def test_a_leap_year_has_its_day(tmp_path):
    path = tmp_path / "site.epw"
    path.write_text("\n".join(epw(hours_from(2, 28, 72, leap=True))))
    days = weather_year(path, year=2024)
    assert [str(start)[:10] for start in days.start] == ["2024-02-28", "2024-02-29", "2024-03-01"]
    whole = weather_year(write_weather(tmp_path, 20.0, days=366), **CALM_YEAR | {"year": 2024})
    assert (whole.n_days, str(whole.start[-1])[:10]) == (366, "2024-12-31")


def test_each_day_has_its_own_weather_straight_between_the_hours(tmp_path):
    path = write_weather(tmp_path, lambda h: h / 10, T_dew=-5.0)
    days = weather_year(path, **CALM_YEAR, economiser="none", outdoor_air_min=1.2, m_a_min=1.2, T_design=35.0)
    for k in (1, 2):
        series = days.of_day(k)
        for clock in (7.0, 12.5, 19.75):
            at = {name: values[int(3600 * clock)] for name, values in series.items()}
            share = 1.2 / at["m_a"]
            T_out = (24 * k + clock) / 10
            assert at["T_a_in"] == pytest.approx(share * T_out + (1 - share) * 24.0, abs=0.05)


def test_the_mixture_keeps_the_least_outdoor_air_and_its_water(tmp_path):
    path = write_weather(tmp_path, 32.0, T_dew=18.0)
    noon = noon_values(series_on_day(path, set_point="fixed", outdoor_air_min=0.26, T_balance=20.0, T_design=32.0))
    assert noon["m_a"] == pytest.approx(1.3)  # full load
    W = 0.2 * float(humidity_ratio_from_dew_point(18.0)) + 0.8 * float(humidity_ratio(24.0, 0.5))
    assert noon["W_a_in"] == pytest.approx(W, rel=1e-9)
    assert noon["T_a_in"] == pytest.approx(0.2 * 32 + 0.8 * 24, abs=0.03)  # a little off: moist air has more heat
    assert noon["enabled"] == 1.0


@pytest.mark.parametrize(("T_out", "enabled", "T_a_in"), [(8.0, 0.0, 13.0), (16.0, 1.0, 16.0), (26.0, 1.0, None)])
def test_the_coil_is_off_where_the_economiser_is_enough(tmp_path, T_out, enabled, T_a_in):
    noon = noon_values(series_on_day(write_weather(tmp_path, T_out), set_point="fixed", T_design=35.0))
    assert noon["enabled"] == enabled
    assert T_a_in is None or noon["T_a_in"] == pytest.approx(T_a_in, abs=1e-9)


def test_the_set_point_follows_the_outdoor_air_between_its_hours(tmp_path):
    path = write_weather(tmp_path, lambda h: 10.0 + h % 24)
    series = series_on_day(path, set_point="outdoor_reset", T_design=35.0)
    # straight between hours; at midnight from hour 23 to hour 24
    T_out = np.interp(np.arange(86400) / 3600, np.arange(25), [*(10.0 + np.arange(24)), 10.0])
    np.testing.assert_allclose(series["T_set"], np.interp(T_out, [16, 21], [18, 13]), atol=1e-9)


def test_air_flow_follows_the_load_between_least_and_design(tmp_path):
    path = write_weather(tmp_path, lambda h: 12.0 + 20.0 * (h % 24 == 13))
    series = series_on_day(path, set_point="fixed", T_set=12.0, T_balance=12.0, T_design=32.0, internal_load=0.4)
    assert series["m_a"][10 * 3600] == pytest.approx(0.4 * 1.3)  # people alone
    assert series["m_a"][13 * 3600] == pytest.approx(1.3)
    assert series["m_a"][13 * 3600 - 1800] == pytest.approx(0.7 * 1.3, rel=1e-9)
    assert series["m_a"][6 * 3600] == pytest.approx(0.5)  # the least; people are still to come


@pytest.mark.parametrize(
    ("mode", "water", "T_out", "expected"),
    [
        ("cooling", "fixed", 20.0, 7.0), ("cooling", "outdoor", 21.5, 9.5), ("cooling", "outdoor", 30.0, 7.0),
        ("cooling", "load", 22.0, 12.0 - 5.0 * 0.75), ("heating", "fixed", 0.0, 60.0),
        ("heating", "outdoor", 1.5, 50.0), ("heating", "load", 10.0, 45.0),
    ],
)  # fmt: skip
def test_water_is_fixed_or_follows_the_load_or_the_weather(tmp_path, mode, water, T_out, expected):
    shell = {"T_balance": 12.0, "T_design": 32.0} if mode == "cooling" else {"T_balance": 15.0, "T_design": -5.0}
    noon = noon_values(series_on_day(write_weather(tmp_path, T_out), mode=mode, water=water, **shell))
    assert noon["T_w_in"] == pytest.approx(expected, abs=1e-9)


def test_a_heating_coil_warms_cold_mixed_air(tmp_path):
    path = write_weather(tmp_path, 2.5)
    noon = noon_values(series_on_day(path, mode="heating", T_design=-10.0, outdoor_air_min=0.45))
    assert noon["T_set"] == pytest.approx(24.0)  # half way between -10 and 15 degC: between 30 and 18
    assert noon["m_a"] == pytest.approx(0.9)
    assert noon["T_a_in"] == pytest.approx((21.0 + 2.5) / 2, abs=0.03)
    assert noon["enabled"] == 1.0
    assert noon_values(series_on_day(write_weather(tmp_path, 20.0), mode="heating", T_design=-10.0))["enabled"] == 0.0
    helped = series_on_day(write_weather(tmp_path, 2.5), mode="heating", T_design=-10.0, internal_load=0.3)
    assert noon_values(helped)["m_a"] == pytest.approx(0.5 + 0.8 * 0.2)


def test_a_day_is_the_same_alone_in_any_order_and_pickled(tmp_path):
    path = write_weather(tmp_path, lambda h: 14.0 + 6 * np.sin(h / 4))
    options = {"year": 2023, "set_point": "trim_and_respond"}
    year, alone = weather_year(path, **options), weather_year(path, **options, days=[4])
    backwards = pickle.loads(pickle.dumps(year))
    for name, values in alone.of_day(0).items():
        np.testing.assert_array_equal(values, year.of_day(3)[name])
    rows = [backwards.of_day(k)["T_set"] for k in (6, 5, 4, 3)]
    np.testing.assert_array_equal(rows[3], alone.of_day(0)["T_set"])
    other = weather_year(path, **options, days=[4], seed=2).of_day(0)
    assert np.abs(other["m_a"] - alone.of_day(0)["m_a"]).max() > 0.01


def test_a_setting_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(TypeError, match="weather_year takes no T_retrun"):
        weather_year(write_weather(tmp_path, 20.0), year=2023, T_retrun=22.0)

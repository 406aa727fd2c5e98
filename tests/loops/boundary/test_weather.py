"""Hourly weather: exact at full hours, straight between, mixed with return air; every mistake."""

import numpy as np
import pytest
from helpers.refusals import assert_refused
from helpers.trend_logs import replace_column
from helpers.weather_years import CSV_HEADER as WEATHER_HEADER

from fastcoil.loops.boundary.weather import weather_day
from fastcoil.model import moist_air

pytestmark = pytest.mark.filterwarnings("ignore:hourly weather")
PLANT = {"m_a": 1.2, "T_w_in": 7.0, "T_set": 14.0, "outdoor_fraction": 0.25, "T_return": 24.0, "RH_return": 0.5}
WEATHER_ROWS = [
    [h, 1, 1 + (h - 1) // 24, (h - 1) % 24 + 1, 10.0 + h % 24 / 2, 5.0 + h % 24 / 4, 60 + h % 24, 100e3 + h]
    for h in range(1, 73)
]


def test_weather_is_exact_at_full_hours_and_straight_between(write_log):
    path = write_log(WEATHER_HEADER, WEATHER_ROWS)
    series = weather_day(path, days=2, hour=6, hours=3, **PLANT | {"outdoor_fraction": 1.0}).series
    for k, h in enumerate((30, 31, 32)):
        T, T_dew, p = WEATHER_ROWS[h - 1][4], WEATHER_ROWS[h - 1][5], WEATHER_ROWS[h - 1][7]
        assert series["T_a_in"][0, 3600 * k] == pytest.approx(T, abs=1e-10)
        expected = moist_air.saturation_humidity_ratio(T_dew, p)
        assert series["W_a_in"][0, 3600 * k] == pytest.approx(float(expected), rel=1e-10)
    for name in ("T_a_in", "W_a_in"):
        middle = (series[name][0, 0] + series[name][0, 3600]) / 2
        assert series[name][0, 1800] == pytest.approx(middle, rel=1e-9)
    assert (series["m_a"] == 1.2).all()
    assert (series["T_set"] == 14.0).all()


def test_weather_mixes_water_and_enthalpy_with_return_air(write_log):
    path = write_log(WEATHER_HEADER, WEATHER_ROWS)
    outdoors = weather_day(path, days=1, hour=12, hours=1, **PLANT | {"outdoor_fraction": 1.0}).series
    indoors = weather_day(path, days=1, hour=12, hours=1, **PLANT | {"outdoor_fraction": 0.0}).series
    mixed = weather_day(path, days=1, hour=12, hours=1, **PLANT).series
    np.testing.assert_allclose(indoors["T_a_in"], 24.0, atol=1e-10)
    p_start = 100e3 + 12
    assert indoors["W_a_in"][0, 0] == pytest.approx(float(moist_air.humidity_ratio(24.0, 0.5, p_start)), rel=1e-10)
    np.testing.assert_allclose(mixed["W_a_in"], 0.25 * outdoors["W_a_in"] + 0.75 * indoors["W_a_in"], rtol=1e-12)
    h = [moist_air.enthalpy(x["T_a_in"], x["W_a_in"]) for x in (outdoors, indoors, mixed)]
    np.testing.assert_allclose(h[2], 0.25 * h[0] + 0.75 * h[1], rtol=1e-12)
    stated = PLANT | {"outdoor_fraction": 0.0, "RH_return": None, "W_return": 0.004}
    dry = weather_day(path, days=1, hour=12, hours=1, **stated).series
    np.testing.assert_allclose(dry["W_a_in"], 0.004, rtol=1e-12)


def test_a_weather_day_alone_and_several(write_log):
    path = write_log(WEATHER_HEADER, WEATHER_ROWS)
    alone, days = (weather_day(path, days=days, hour=10, **PLANT) for days in (2, [3, 2]))
    assert (alone.has_day_dim, days.has_day_dim) == (False, True)
    np.testing.assert_array_equal(days.day, [3, 2])
    np.testing.assert_array_equal(days.series["T_a_in"][1], alone.series["T_a_in"][0])
    assert days.series["T_a_in"][1, 0] == pytest.approx(WEATHER_ROWS[33][4] * 0.25 + 24.0 * 0.75, abs=0.05)


@pytest.mark.parametrize(
    ("field", "code", "column", "value"),
    [
        ("T_dewpoint", "data", 5, 25.0), ("RH", "unit", 6, 0.0), ("RH", "unit", 6, 0.6),
        ("T_drybulb", "value", 4, 70.5), ("T_dewpoint", "value", 5, -999),
    ],
)  # fmt: skip
def test_impossible_weather_is_refused(write_log, field, code, column, value):
    header = ["d" if name == "T_dewpoint_C" and field == "RH" else name for name in WEATHER_HEADER]
    path = write_log(header, replace_column(column, [value] * 72, WEATHER_ROWS))
    assert_refused(field, code, weather_day, path, days=1, hour=9, **PLANT)


def test_weather_by_relative_humidity_other_headers_and_pressure(write_log):
    header = ["hour_of_year", "a", "b", "c", "OAT [degF]", "d", "OA RH", "p_Pa"]
    rows = [[*r[:4], r[4] * 1.8 + 32, "-", r[6] / 100, r[7]] for r in WEATHER_ROWS]
    reading = {"columns": {"T_drybulb": "OAT", "RH": "OA RH"}, "units": {"RH": "1"}, "pressure": 90e3}
    outdoors = PLANT | reading | {"outdoor_fraction": 1.0}
    series = weather_day(write_log(header, rows), days=2, hour=6, hours=1, **outdoors).series
    T, rh = WEATHER_ROWS[29][4], WEATHER_ROWS[29][6] / 100
    assert series["T_a_in"][0, 0] == pytest.approx(T, abs=1e-9)
    assert series["W_a_in"][0, 0] == pytest.approx(float(moist_air.humidity_ratio(T, rh, 90e3)), rel=1e-9)


@pytest.mark.parametrize(
    ("field", "code", "arguments"),
    [
        ("days", "type", {"days": None}), ("days", "value", {"days": 0}), ("days", "data", {"days": [1, 4]}),
        ("hour", "value", {"hour": 25}), ("days", "data", {"hour": 0}),
        ("outdoor_fraction", "value", {"outdoor_fraction": 1.5}), ("RH_return", "conflict", {"W_return": 0.008}),
        ("columns", "choice", {"columns": {"T": "T_drybulb_C"}}), ("columns", "name", {"columns": {"RH": "humidity"}}),
        ("T_drybulb", "unit", {"units": {"T_drybulb": "degF"}}),
        ("T_drybulb", "unit", {"units": {"T_drybulb": "Cel"}}),
        ("W_return", "unit", {"RH_return": None, "W_return": 0.05}),
    ],
)  # fmt: skip
def test_weather_day_refuses(write_log, field, code, arguments):
    path = write_log(WEATHER_HEADER, WEATHER_ROWS)
    assert_refused(field, code, weather_day, path, **{"days": 1, "hour": 8} | PLANT | arguments)


@pytest.mark.parametrize(
    ("field", "code", "header", "rows"),
    [
        ("T_drybulb", "missing", ["T" if n == "T_drybulb_C" else n for n in WEATHER_HEADER], WEATHER_ROWS),
        ("hour_of_year", "time", WEATHER_HEADER, WEATHER_ROWS[:5] + WEATHER_ROWS[6:]),
        ("T_dewpoint", "missing", [*WEATHER_HEADER[:5], "p_Pa"], [[*r[:5], r[7]] for r in WEATHER_ROWS]),
    ],
)
def test_bad_weather_files_are_refused(write_log, field, code, header, rows):
    assert_refused(field, code, weather_day, write_log(header, rows), days=1, hour=8, **PLANT)


def test_a_series_of_another_date_than_the_weather_is_refused(write_log):
    pd = pytest.importorskip("pandas")
    path, plant = write_log(WEATHER_HEADER, WEATHER_ROWS), {n: v for n, v in PLANT.items() if n != "T_set"}
    for date, fits in (("2023-01-02T10:00", True), ("2023-07-02T10:00", False)):
        T_set = pd.Series(14.0, pd.date_range(date, periods=3600, freq="s"))
        arguments = {"days": 2, "hour": 10, "hours": 1, "T_set": T_set} | plant
        if fits:
            assert weather_day(path, **arguments).start[0] == np.datetime64(date)
        else:
            assert_refused("days", "time", weather_day, path, **arguments)

"""EPW and TMY3 files as they are distributed: the same weather as in a CSV file, dates, gaps, every mistake."""

import numpy as np
import pytest
from helpers.refusals import assert_refused
from helpers.weather_years import CSV_HEADER, epw, hours_from, tmy3

from fastcoil.loops.boundary.weather import weather_day

pytestmark = pytest.mark.filterwarnings("ignore:hourly weather")
OUTDOORS = {"m_a": 1.2, "T_w_in": 7.0, "T_set": 14.0, "T_return": 24.0, "RH_return": 0.5, "outdoor_fraction": 1.0}
JUNE = hours_from(6, 14, 72)


def read_weather_day(path, **options):
    return weather_day(path, **OUTDOORS | options)


@pytest.fixture
def put(tmp_path):
    """Return a function that writes a file of these lines; nothing in its name says what is in it."""

    def put_lines(lines, encoding="utf-8", end="\n"):
        path = tmp_path / "weather.csv"
        path.write_bytes((end.join(lines) + end).encode(encoding))
        return path

    return put_lines


@pytest.mark.parametrize("form", [epw, tmy3])
def test_the_same_weather_in_another_format_is_the_same_day(put, write_log, form):
    in_csv = write_log(CSV_HEADER, [row.values() for row in JUNE], "own.csv")
    for start in ({"days": 166, "hour": 10}, {"days": [165, 166], "hour": 7}):
        ours, theirs = read_weather_day(in_csv, **start), read_weather_day(put(form(JUNE)), **start)
        assert ours.has_day_dim == theirs.has_day_dim
        for name in ("T_a_in", "W_a_in"):
            np.testing.assert_allclose(theirs.series[name], ours.series[name], rtol=1e-12)


@pytest.mark.parametrize("form", [epw, tmy3])
def test_a_row_holds_at_the_full_hour_that_ends_its_interval_with_the_humidity_of_psychrolib(put, psychrolib, form):
    series = read_weather_day(put(form(JUNE)), days=166, hour=23, hours=3).series
    for k, row in enumerate(JUNE[46:49]):  # hours 23 and 24, and hour 1 of the next day
        assert series["T_a_in"][0, 3600 * k : 3600 * k + 1] == pytest.approx([row["T"]], abs=1e-9)
        p_w = psychrolib.GetSatVapPres(row["T_dew"])
        assert series["W_a_in"][0, 3600 * k] == pytest.approx(0.621945 * p_w / (row["p"] - p_w), rel=2e-5)


def test_march_begins_a_day_later_in_a_file_with_the_29th_of_february(put):
    for leap in (True, False):
        rows = hours_from(2, 27, 96, leap=leap)
        path, first_of_march = put(epw(rows)), 61 if leap else 60
        assert read_weather_day(path, days=first_of_march, hour=5).start[0].astype(str).endswith("-03-01T05:00:00")
        assert read_weather_day(path, days=60, hour=5).series["T_a_in"][0, 0] == rows[52]["T"]


def test_letters_of_another_code_page_line_ends_of_windows_and_quotes_in_remarks_do_no_harm(put):
    lines = epw(JUNE)
    lines[0] = lines[0].replace("Testville", "Montréal")
    lines[5] = 'COMMENTS 1,"Custom – a quote that nothing ends…'
    plain = read_weather_day(put(epw(JUNE)), days=166, hour=10)
    assert read_weather_day(put(lines, "cp1252", "\r\n"), days=166, hour=10) == plain
    lines[13] = lines[13].replace(f",{JUNE[5]['T']},", ",99.9,")
    assert_refused("T_drybulb", "data", read_weather_day, put(lines, "cp1252", "\r\n"), days=166, hour=10)


@pytest.mark.parametrize(("form", "missing"), [(epw, "99.9"), (tmy3, "-9900.0")])
def test_where_only_the_dew_point_has_gaps_the_relative_humidity_serves(put, psychrolib, form, missing):
    rows = [row | {"T_dew": missing} if k in (3, 50) else row for k, row in enumerate(JUNE)]
    with (
        pytest.warns(UserWarning, match="hourly"),
        pytest.warns(UserWarning, match=r"dew point is missing in row \d+ \(2 samples in total\): the relative"),
    ):
        day = weather_day(put(form(rows)), days=166, hour=10, **OUTDOORS)
    row = JUNE[33]
    p_w = psychrolib.GetSatVapPres(row["T"]) * row["RH"] / 100
    assert day.series["W_a_in"][0, 0] == pytest.approx(0.621945 * p_w / (row["p"] - p_w), rel=2e-5)


@pytest.mark.parametrize(
    ("field", "code", "form", "gaps"),
    [
        ("T_drybulb", "data", epw, {"T": "99.9"}), ("T_dewpoint", "data", epw, {"T_dew": "99.9", "RH": "999"}),
        ("p", "data", epw, {"p": "999999"}), ("T_drybulb", "data", tmy3, {"T": ""}),
        ("p", "value", tmy3, {"p": "101325"}), ("row 14", "format", epw, {"day": "31"}),
        ("row 8", "format", tmy3, {"hour": "0"}), ("row 14", "time", epw, {"hour": "7"}),
    ],
)  # fmt: skip
def test_a_bad_row_is_refused(put, field, code, form, gaps):
    rows = [row | gaps if k == 5 else row for k, row in enumerate(JUNE)]
    assert_refused(field, code, read_weather_day, put(form(rows)), days=166, hour=10)


def drop_lines(lines, word):
    return [line for line in lines if word not in line]


@pytest.mark.parametrize(
    ("field", "code", "lines", "options"),
    [
        ("weather.csv", "data", epw(JUNE[:1]), {}),
        ("DATA PERIODS", "format", drop_lines(epw(JUNE), "DATA PERIODS"), {}),
        ("DATA PERIODS", "format", epw(JUNE, per_hour=4), {}),
        ("row 81", "format", [*epw(JUNE), "1999,6,17,1"], {}),
        ("Pressure (mbar)", "format", [line.replace("Pressure", "P") for line in tmy3(JUNE)], {}),
        ("columns", "conflict", epw(JUNE), {"columns": {"p": "p"}}),
        ("row 33", "time", epw(hours_from(12, 31, 48)), {}),
    ],
)
def test_a_file_that_is_not_as_it_was_distributed_is_refused(put, field, code, lines, options):
    assert_refused(field, code, read_weather_day, put(lines), **{"days": 166, "hour": 10} | options)


@pytest.mark.parametrize("form", [epw, tmy3])
def test_weather_is_read_from_70_degrees_below_zero_on(put, form):
    cold = [row | {"T": -70.0 + k / 3, "T_dew": -70.0 + k / 4} for k, row in enumerate(JUNE)]
    day = read_weather_day(put(form(cold)), days=166, hour=10, hours=4)
    assert -70.0 <= day.series["T_a_in"].min() < -46.0

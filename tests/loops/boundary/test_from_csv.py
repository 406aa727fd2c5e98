"""Trend logs: exact conversions of units, holds and straight lines, and a measured one."""

import csv
from datetime import datetime, timedelta

import numpy as np
import pytest
from helpers.shared_data import measured
from helpers.trend_logs import HEADER, ROWS, replaced, row

from fastcoil.logs.series import AIR_FLOW, DIFFERENCE, TEMPERATURE
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import paper_day
from fastcoil.model import moist_air


def test_continuous_series_run_straight_and_switches_hold(write):
    header = [*HEADER, "noise [K]", "enabled [1]"]
    rows = [[*r, noise, on] for r, noise, on in zip(ROWS, (0.0, 0.6, -0.6), (1, 0, 1), strict=True)]
    series = Boundary.from_csv(write(header, rows)).series
    t = np.arange(121)
    np.testing.assert_allclose(series["m_a"][0], np.where(t < 60, 1 + 0.01 * t, 1.6 - 0.01 * (t - 60)), atol=1e-12)
    np.testing.assert_allclose(series["T_a_in"][0], 25 + np.maximum(t - 60, 0) / 30, atol=1e-12)
    np.testing.assert_array_equal(series["T_set"][0], np.select([t < 60, t < 120], [14.0, 15.0], 14.0))
    np.testing.assert_array_equal(series["enabled"][0], np.select([t < 60, t < 120], [1.0, 0.0], 1.0))
    np.testing.assert_allclose(series["noise"][0, [30, 60, 90]], [0.3, 0.6, 0.0], atol=1e-12)


def test_a_log_of_1_s_samples_is_read_to_the_bit(write):
    boundary = paper_day(0.1, seed=0)  # its label, 0, is that of a log
    names = ["m_a", "T_a_in", "W_a_in", "T_w_in", "T_set"]
    columns = np.array([boundary.series[name][0] for name in names]).T
    rows = [[t, *map(repr, map(float, values))] for t, values in enumerate(columns)]
    assert Boundary.from_csv(write(HEADER, rows)) == boundary


@pytest.mark.parametrize(("unit", "scale"), [("s", 1.0), ("min", 60.0), ("h", 3600.0)])
def test_time_units_and_an_arbitrary_first_time(write, unit, scale):
    """A set-point changes on the very second that is meant, though 0.1 h is not exact in binary."""
    header = [f"elapsed_time [{unit}]", *HEADER[1:]]
    seconds = 720 * np.arange(12)
    rows = [row(1000.1 + t / scale, T_set=14.0 + i % 2) for i, t in enumerate(seconds)]
    T_set = Boundary.from_csv(write(header, rows)).series["T_set"][0]
    assert T_set.size == 720 * 11 + 1
    np.testing.assert_array_equal(np.flatnonzero(np.diff(T_set)) + 1, seconds[1:])


@pytest.mark.parametrize("form", ["%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M", "%Y-%m-%dT%H:%M:%S+02:00", "%Y-%m-%dT%TZ"])
def test_timestamps(write, form):
    begin = datetime(2024, 2, 28, 23, 59)
    rows = [[(begin + timedelta(seconds=r[0])).strftime(form), *r[1:]] for r in ROWS]
    expected = Boundary.from_csv(write(HEADER, ROWS))
    assert Boundary.from_csv(write(["timestamp", *HEADER[1:]], rows)) == expected


def test_start_and_hours_cut_a_window(write):
    path = write(HEADER, ROWS)
    whole = Boundary.from_csv(path).series
    part = Boundary.from_csv(path, start=30 / 3600, hours=45 / 3600).series
    for name, values in part.items():
        np.testing.assert_allclose(values[0], whole[name][0, 30:75], atol=1e-12)
    rest = Boundary.from_csv(path, start=30 / 3600)
    assert rest.n_steps == 91


@pytest.mark.parametrize(("unit", "value"), [("degC", 25.0), ("degF", 77.0), ("K", 298.15)])
def test_temperature_units(write, unit, value):
    header = [cell.replace("T_a_in [degC]", f"T_a_in [{unit}]") for cell in HEADER]
    series = Boundary.from_csv(write(header, replaced(2, [value] * 3))).series
    np.testing.assert_allclose(series["T_a_in"], 25.0, atol=1e-12)
    assert unit in TEMPERATURE


@pytest.mark.parametrize(
    ("unit", "value"),
    [
        ("kg s-1", 1.5),
        ("kg/s", 1.5),
        ("kg/h", 5400.0),
        ("lb/h", 5400 / 0.45359237),
        ("m3/s", 1.25),
        ("m3/h", 4500.0),
        ("L/s", 1250.0),
        ("cfm", 1.25 * 60 / 0.3048**3),
    ],
)
def test_air_flow_units_with_volumes_at_1_2_kg_m3(write, unit, value):
    header = [cell.replace("m_a [kg/s]", f"m_a [{unit}]") for cell in HEADER]
    series = Boundary.from_csv(write(header, replaced(1, [repr(value)] * 3))).series
    np.testing.assert_allclose(series["m_a"], 1.5, rtol=1e-12)
    assert unit in AIR_FLOW


def test_a_temperature_difference_in_fahrenheit_has_no_offset(write):
    rows = [[*r, 1.8] for r in ROWS]
    series = Boundary.from_csv(write([*HEADER, "noise [degF]"], rows)).series
    np.testing.assert_allclose(series["noise"], 1.0, rtol=1e-12)
    assert set(DIFFERENCE) == {"K", "degC", "degF"}


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("W_a_in [g/kg]", 10.0),
        ("W_a_in [kg/kg]", 0.01),
        ("RH_a_in [1]", "rh"),
        ("RH_a_in [percent]", "rh%"),
        ("RH_a_in [%]", "rh%"),
        ("T_dp_in [degC]", "dew"),
    ],
)
def test_humidity_in_every_form(write, column, value):
    pressure = 95e3
    T_dew = float(moist_air.dew_point(0.01, pressure))
    rh = 0.01 * pressure / (0.621945 + 0.01) / float(moist_air.saturation_pressure(25.0))
    value = {"rh": rh, "rh%": 100 * rh, "dew": T_dew}.get(value, value)
    header = [column if cell.startswith("W_a_in") else cell for cell in HEADER]
    rows = replaced(2, [25.0] * 3, replaced(3, [repr(value)] * 3))
    series = Boundary.from_csv(write(header, rows), pressure=pressure).series
    np.testing.assert_allclose(series["W_a_in"], 0.01, rtol=1e-9)


def test_columns_and_units_rename_and_declare(write):
    header = ["Time", "SAF", "AHU1 MAT [degF]", "OA hum", "CHW", "SAT SP", "Comment"]
    rows = [[*r[:2], 77, *r[3:], "fan on"] for r in ROWS]
    boundary = Boundary.from_csv(
        write(header, rows),
        columns={
            "elapsed_time": "Time",
            "m_a": "SAF",
            "T_a_in": "AHU1 MAT [degF]",
            "W_a_in": "OA hum",
            "T_w_in": "CHW",
            "T_set": "SAT SP",
        },
        units={"elapsed_time": "s", "m_a": "kg/s", "W_a_in": "1", "T_w_in": "degC", "T_set": "degC"},
    )
    assert boundary == Boundary.from_csv(write(HEADER, replaced(2, [25.0] * 3)))
    by_label = Boundary.from_csv(write(["x [s]", *HEADER[1:]], ROWS), columns={"elapsed_time": "x"})
    assert by_label == Boundary.from_csv(write(HEADER, ROWS))


def test_constants_stand_for_absent_columns(write):
    drop = [0, 1, 2, 3, 5]
    path = write([HEADER[i] for i in drop], [[r[i] for i in drop] for r in ROWS])
    assert Boundary.from_csv(path, constants={"T_w_in": 7.0}) == Boundary.from_csv(write(HEADER, ROWS, "full.csv"))


def test_a_byte_order_mark_spaces_windows_ends_and_empty_lines_are_harmless(write, tmp_path):
    lines = [" , ".join(map(str, r)) for r in [HEADER, *ROWS]]
    path = tmp_path / "bom.csv"
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join([*lines, "", ""]).encode())
    assert Boundary.from_csv(path) == Boundary.from_csv(write(HEADER, ROWS))


def test_a_measured_air_handler_log():
    """105 h of a hunting valve, 5 s; the log has no flows or humidity, which are given as numbers."""
    boundary = Boundary.from_csv(
        measured("b33_ahu2_5s.csv"),
        hours=24.0,
        start=24.0,
        columns={"elapsed_time": "time_s", "T_a_in": "T_out_C", "T_set": "T_sup_set_C", "enabled": "fan_enable"},
        units={"elapsed_time": "s", "T_a_in": "degC", "T_set": "degC", "enabled": "1"},
        constants={"m_a": 5.0, "W_a_in": 0.008, "T_w_in": 7.0},
    )
    assert boundary.hours == 24.0
    with measured("b33_ahu2_5s.csv").open() as file:
        log = {float(r["time_s"]): r for r in csv.DictReader(file)}
    for second in (0, 36_000, 86_395):
        recorded = log[86_400.0 + second]
        assert boundary.series["T_a_in"][0, second] == pytest.approx(float(recorded["T_out_C"]), abs=1e-9)
        assert boundary.series["T_set"][0, second] == pytest.approx(float(recorded["T_sup_set_C"]), abs=1e-12)
        assert boundary.series["enabled"][0, second + 4] == float(recorded["fan_enable"])


def test_humidity_may_be_a_constant_in_any_form(write):
    path = write([*HEADER[:3], *HEADER[4:]], [[*r[:3], *r[4:]] for r in ROWS])
    T_a_in = Boundary.from_csv(path, constants={"W_a_in": 0.01}).series["T_a_in"]
    found = Boundary.from_csv(path, constants={"RH_a_in": 0.5}, pressure=95e3).series["W_a_in"]
    np.testing.assert_allclose(found[0, [0, 60, 120]], moist_air.humidity_ratio(T_a_in[0, [0, 60, 120]], 0.5, 95e3))
    found = Boundary.from_csv(path, constants={"T_dp_in": 12.0}).series["W_a_in"]
    np.testing.assert_allclose(found, moist_air.humidity_ratio_from_dew_point(12.0))


def test_enabled_needs_no_unit(write):
    header, rows = [*HEADER, "enabled"], [[*r, on] for r, on in zip(ROWS, (1, 0, 1), strict=True)]
    assert Boundary.from_csv(write(header, rows)).series["enabled"][0, 90] == 0.0


def test_a_column_comes_before_a_constant_of_its_name(write):
    path = write(HEADER, ROWS)
    assert Boundary.from_csv(path, constants={"m_a": 9.0}) == Boundary.from_csv(path)

"""Columns and units of an air handler: found, proposed and said; what is not clear is asked at once."""

import numpy as np
import pytest
from helpers.air_handler_logs import HEADERS, make_unit_log
from helpers.refusals import assert_mistakes

import fastcoil as fc
from fastcoil.logs.air_handler import count_valves, read_air_handler
from fastcoil.logs.columns import interpret_header


@pytest.mark.parametrize(
    ("header", "name"),
    [
        ("AHU: Cooling Coil Valve Control Signal", "cooling_command"),
        ("RTU2 HHW VLV CMD", "heating_command"),
        ("Preheat Valve", "preheat_command"),
        ("AHU: Supply Air Temperature Heating Set Point", "T_set_heating"),
        ("Clg SAT Setpt", "T_set_cooling"),
        ("DAT SP", "T_set"),
        ("MAT", "T_mixed"),
        ("AHU-1/OAT", "T_out"),
        ("Return Air Temperature", "T_return"),
        ("Supply Air Fan Speed Control Signal", "fan_speed"),
        ("Occupancy Mode Indicator", "occupied"),
    ],
)
def test_a_header_names_a_point_of_the_air_handler(header, name):
    meaning = interpret_header(header, "air_handler_rules")
    assert (meaning.name, meaning.is_clear) == (name, True)


def test_headers_of_dampers_and_alarms_name_no_point():
    for header in ("Outdoor Air Damper Control Signal", "Supply Air Temperature Alarm", "Zone Temp", "CHW Pump Speed"):
        assert interpret_header(header, "air_handler_rules") is None


def test_units_are_proposed_from_the_numbers_and_said():
    frame = make_unit_log(0.1, cooling=0.4)
    celsius = frame[HEADERS["T_sup"]].to_numpy()
    for name in ("T_sup", "T_mixed"):
        frame[HEADERS[name]] = frame[HEADERS[name]] * 1.8 + 32.0
    frame[HEADERS["cooling_command"]] *= 100.0
    data, points = read_air_handler(fc.read_log(frame))
    assert data.values["T_sup"] == pytest.approx(celsius, abs=1e-9)
    assert data.values["cooling_command"] == pytest.approx(0.4)
    assert points.units["T_mixed"] == "degF"
    assert points.units["cooling_command"] == "percent"
    [note] = [note for note in points.notes if "units by the numbers" in note]
    assert "degF for T_sup, T_mixed" in note
    assert "percent for cooling_command" in note


def test_a_declared_unit_is_not_proposed():
    frame = make_unit_log(0.1).rename(columns={HEADERS["T_sup"]: "SAT [°C]"})
    _, points = read_air_handler(fc.read_log(frame, units={"T_mixed": "degC"}))
    assert not {"T_sup", "T_mixed"} & points.units.keys()


def test_an_air_flow_without_a_unit_is_left_out_and_named():
    _, points = read_air_handler(fc.read_log(make_unit_log(0.1, **{"Supply Air Flow": 900.0})))
    assert "m_a" not in points.headers
    assert any("m_a" in note for note in points.notes)


def test_all_that_is_not_clear_is_asked_together():
    frame = make_unit_log(0.1, T_set=14.0).rename(columns={HEADERS["T_sup"]: "Duct temperature B"})
    frame["AHU-3 SAT SP 2"] = 14.0
    assert_mistakes([("T_sup", "missing"), ("T_set", "missing")], fc.inspect, frame)


def test_two_cooling_valves_are_asked_about_and_named():
    frame = make_unit_log(0.1).assign(**{"AHU-3 Cooling Valve 2": 0.0})
    assert_mistakes([("cooling_command", "missing")], fc.inspect, frame)


def test_days_of_which_only_some_have_dates_are_refused():
    frame = make_unit_log(0.5)
    seconds = frame.drop(columns=frame.columns[0])
    seconds.insert(0, "elapsed_time [s]", 60.0 * np.arange(len(frame)))
    assert_mistakes([("log", "time")], fc.inspect, [frame, seconds])


def test_a_log_without_a_valve_says_how_to_name_one():
    frame = make_unit_log(0.1).drop(columns=[HEADERS["cooling_command"], HEADERS["heating_command"]])
    assert_mistakes([("cooling_command", "missing")], fc.inspect, frame)


def test_a_log_of_one_valve_counts_one():
    frame = make_unit_log(0.1)
    assert count_valves(fc.read_log(frame)) == 2
    assert count_valves(fc.read_log(frame.drop(columns=HEADERS["heating_command"]))) == 1


def test_the_answers_of_one_unit_serve_the_next(tmp_path):
    frame = make_unit_log(0.1, cooling=0.3)
    odd = {HEADERS["T_sup"]: "TI-17", HEADERS["cooling_command"]: "YV-4"}
    options = {"columns": {"T_sup": "TI-17", "cooling_command": "YV-4"}, "units": {"T_sup": "degC"}}
    fc.inspect(fc.read_log(frame.rename(columns=odd), **options)).to_toml(tmp_path / "columns.toml")
    next_unit = fc.inspect(frame.rename(columns=odd), answers=tmp_path / "columns.toml")
    assert next_unit.points.headers["T_sup"] == "TI-17"
    # a unit whose headers speak for themselves needs none of them
    assert fc.inspect(frame, answers=tmp_path / "columns.toml").points.headers["T_sup"] == HEADERS["T_sup"]


def test_a_file_that_holds_no_answers_is_refused(tmp_path):
    (tmp_path / "answers.toml").write_text("columns = 3\n")
    with pytest.raises(fc.InputError, match="columns"):
        fc.inspect(make_unit_log(0.1), answers=tmp_path / "answers.toml")


def test_values_that_cannot_be_read_are_left_out_and_counted():
    frame = make_unit_log(0.2).astype({HEADERS["T_mixed"]: object})
    frame.loc[5:9, HEADERS["T_mixed"]] = "#VALUE!"
    unit = fc.inspect(frame)
    assert any("5 values left out: T_mixed" in note for note in unit.notes)
    assert np.isnan(unit.series.get("T_mixed")).sum() == 5

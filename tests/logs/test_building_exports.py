"""Logs as building systems export them: their names, their layouts, a row for each value; nothing wrong in silence."""

import numpy as np
import pandas as pd
import pytest
from helpers.exports import COMMAND, ISO, ROWS, SECONDS, START, T_SUP, format_times, save_text
from helpers.refusals import assert_mistakes, assert_refused, refusal

import fastcoil as fc
from fastcoil.logs import ReadingOptions, read_checked_log
from fastcoil.logs.columns import ColumnSpec, interpret_header
from fastcoil.logs.series import COLUMNS

T_SET = np.where(SECONDS < 1800, 14.0, 13.5)
WANTED = ColumnSpec(("command", "T_sup"), ("T_set", "m_a", "T_a_in", "enabled"), ("T_sup", "T_set", "m_a", "T_a_in"))
US_TIMES = format_times("%m/%d/%Y %I:%M:%S %p")
FAHRENHEIT_TEXTS = [[f"{1.8 * one + 32:.4f}" for one in series] for series in (T_SUP, T_SET)]


def table_text(header, *columns, separator=",", before=""):
    lines = [header, *(separator.join(map(str, row)) for row in zip(*columns, strict=True))]
    return before + "\n".join(lines) + "\n"


def value_rows_text(header, row_format, newest_first=False):
    """Text of a file with a row for each value; ``row_format``: of a row, of time, point, value and unit."""
    points = (("VLV CMD", COMMAND, "%"), ("SAT", FAHRENHEIT_TEXTS[0], "°F"), ("SAT SP", FAHRENHEIT_TEXTS[1], "°F"))
    times = [(k, time, *point) for k, time in enumerate(US_TIMES) for point in points]
    lines = [row_format.format(time, name, series[k], unit) for k, time, name, series, unit in times]
    return "\n".join([header, *(lines[::-1] if newest_first else lines)]) + "\n"


def read(tmp_path, text, **options):
    reading = ReadingOptions(reader="read_log", **({"drop": False} | options))
    return read_checked_log(save_text(tmp_path, text), WANTED, reading)


def assert_same(log):
    np.testing.assert_array_equal(log.time, SECONDS)
    for name, values in {"command": COMMAND / 100, "T_sup": T_SUP, "T_set": T_SET}.items():
        np.testing.assert_allclose(log.values[name], values, atol=1e-4)
    assert log.start == np.datetime64(START)


EXPORTS = {
    "niagara": (table_text("Timestamp,AHU1_CHW_VLV (%),AHU1_SAT (°F),AHU1_SAT_SP (°F)",
                           format_times("%d-%b-%y %I:%M:%S %p EDT"),
                           *([f"{one} {{ok}}" for one in series] for series in (COMMAND, *FAHRENHEIT_TEXTS))), {}),
    "metasys": (value_rows_text("Date / Time,Name Path Reference,Object Name,Object Value",
                                "{0},NAE1:FC1.AHU-3.{1},{1},{2}"),
                {"units": {"command": "%", "T_sup": "degF", "T_set": "degF"}}),
    "historian": (value_rows_text("TIMESTAMP,point,value,unit,quality", "{0},AHU1 {1},{2},{3},Good", True), {}),
    "desigo": (table_text('"";"AHU01 Supply air temp";"AHU01 Cooling valve cmd";"AHU01 Supply air temp setpoint"\n'
                     '"";"°C";"%";"°C"', format_times('"%d.%m.%Y %H:%M:%S"'),
                     *([f'"{one}"'.replace(".", ",") for one in series] for series in (T_SUP, COMMAND, T_SET)),
                     separator=";"), {}),
    "webctrl": (table_text("Date,AHU-1 SAT (°F),AHU-1 CHW VLV (%),AHU-1 SAT SP (°F)", US_TIMES, FAHRENHEIT_TEXTS[0],
                           COMMAND, FAHRENHEIT_TEXTS[1], before="Trend report\nLocation: AHU-1\n\n"), {}),
    "skyspark": (table_text("ts,AHU-1 chilled water valve cmd,AHU-1 discharge air temp sensor,dischargeAirTempSp",
                       [f"{stamp}-04:00 New_York" for stamp in ISO], [f"{one}%" for one in COMMAND],
                       *([f"{one}°F" for one in series] for series in FAHRENHEIT_TEXTS)), {}),
    "brick": (table_text("Date,TIME,Supply_Air_Temperature_Sensor [degF],Valve_Command [%],"
                    "Discharge_Air_Temperature_Setpoint [degF]", format_times("%Y-%m-%d"), format_times("%H:%M:%S"),
                    FAHRENHEIT_TEXTS[0], COMMAND, FAHRENHEIT_TEXTS[1]), {}),
}  # fmt: skip


@pytest.mark.parametrize("system", EXPORTS)
def test_an_export_is_read_as_the_plain_log_and_what_is_read_as_what_is_said(tmp_path, system):
    text, options = EXPORTS[system]
    log = read(tmp_path, text, **options)
    assert_same(log)
    (command_note,) = [note for note in log.notes if "is read as command" in note]
    assert command_note.count("is read as T_s") == 2
    assert any("newest row is first" in note for note in log.notes) == (system == "historian")


NAMES = {
    "command": "VLV CMD, CHW VLV, CLG-O, CLG VLV, HTG-O, AO-1 CHW VLV CMD, coolingValveCmd, Valve_Position_Command, "
               "AHU: Cooling Coil Valve Control Signal",
    "T_sup": "SAT, DAT, DA-T, SA-T, S:NAE01/FC-1.AHU1.SA_TEMP, Discharge_Air_Temperature_Sensor, SA Temp",
    "T_set": "SAT SP, DAT-SP, DA-T-SP, SUPPLY AIR TEMP SETPOINT, discharge air temp effective sp, SA Temp Set Point, "
             "SupplyAirTempStPt, SATSP, SAT_SETPNT, SATSetPt, SAT Target, DischAirTempSetpt, dischargeAirTempSetPoint",
    "T_a_in": "MAT, MA-T, Mixed_Air_Temperature_Sensor, mixed air temp sensor",
    "m_a": "CFM, SA CFM, SF-1 Airflow, Supply_Air_Flow_Sensor, AHU2 SA Flow [cfm]",
    "enabled": "SF-STS, SF-S, Supply Fan Status, Fan_On_Off_Status, discharge fan run sensor",
    None: "RAT, OAT, ZN SAT SCHED, Sat Occ, SAT HI LIMIT, OA CFM, RF-STS, CHW ISO VLV CMD, HUM VLV CMD, SAT RESET SP, "
          "MIN SAT SP, SA RH, SA STATIC SP, OAD CMD, SF VFD CMD, CHW VLV [gpm], SAT [%], CHWST, SAT SCHED, Wheel SAT, "
          "CHW SP, CO2 SP, Test Point",
}  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_names_of_buildings_haystack_and_brick(name):
    for header in NAMES[name].split(", "):
        meaning = interpret_header(header)
        assert (meaning and (meaning.name, meaning.is_clear)) == (name and (name, True)), header


@pytest.mark.parametrize(
    ("header", "field"),
    [
        ("CLG VLV [%],HTG VLV [%],SAT [degC]", "command"),
        ("CLG VLV [%],DA-T 1 [degC],DA-T 2 [degC]", "T_sup"),
        ("CHW VLV POS [%],SAT [degC],ZN-T [degC]", "command"),
        ("CLG VLV [%],SAT LEFT [degC],ZN-T [degC]", "T_sup"),
        ("AHU1 CLG VLV [%],AHU2 SAT [degC],ZN-T [degC]", "T_sup"),
        ("CLG VLV [%],ZN SAT SCHED [1],SAT SP [degC]", "T_sup"),
    ],
)
def test_what_is_in_doubt_is_asked_about(tmp_path, header, field):
    text = table_text(f"TIMESTAMP,{header}", ISO, *[COMMAND if "[%]" in name else T_SUP for name in header.split(",")])
    assert_refused(field, "missing", read, tmp_path, text)


def test_an_answer_settles_the_plant_of_all_columns(tmp_path):
    points = "AHU-2 VLV CMD [%]", "AHU-1 VLV CMD [%]", "AHU-1 SAT [degC]", "AHU-2 SAT [degC]", "AHU-2 SAT SP [degC]"
    header = ",".join(["Time", *(f"NAE1.{point}" for point in points)])
    text = table_text(header, ISO, COMMAND, 0 * COMMAND, 0 * T_SUP, T_SUP, T_SET)
    assert_mistakes([("command", "missing"), ("T_sup", "missing")], read, tmp_path, text)
    assert_same(read(tmp_path, text, columns={"command": "NAE1.AHU-2 VLV CMD"}))


def test_among_thirty_other_points_in_any_order_the_right_ones_are_read_or_it_is_asked(tmp_path):
    rng = np.random.default_rng(7)
    other_points = "CHW VLV POS,OA DMPR CMD,SF SPD,FLT DP,RA RH,CO2,OCC,ZN-SP,RA-T,EF-STS,CHWS-T,CHWR-T,MODE,SAT ALM"
    other_names = NAMES[None].split(", ")[:16] + other_points.split(",")
    rivals = (("command", "HTG VLV CMD"), ("T_sup", "SAT 2"), ("T_set", "SAT SP 2"), ("", ""), ("", ""))
    for _ in range(25):
        right_names = [str(rng.choice(NAMES[name].split(", ")[:4])) for name in ("command", "T_sup", "T_set")]
        field, rival = rivals[rng.choice(5)]
        columns = dict(zip([f"AHU1 {header}" for header in right_names], (COMMAND / 100, T_SUP, T_SET), strict=True))
        columns |= {f"AHU1 {header}": rng.normal(50, 9, ROWS) for header in [*other_names, *filter(None, [rival])]}
        names = list(columns)
        rng.shuffle(names)
        text = table_text(",".join(["Date/Time", *names]), ISO, *(columns[name] for name in names))
        units = {"command": "1", "T_sup": "degC", "T_set": "degC"}
        if rival:
            assert_refused(field, "missing", read, tmp_path, text, units=units)
            continue
        assert_same(log := read(tmp_path, text, units=units))
        assert set(log.values) == {"command", "T_sup", "T_set"}
        assert any(note.startswith("left alone: ") and "27 more" in note for note in log.notes)


def test_points_of_a_long_log_keep_their_own_times(tmp_path):
    change_seconds = [3, 40, 41, 200, 1000, 1090, 2000, 2200]
    change_times = np.datetime64(START) + np.array(change_seconds) * np.timedelta64(1, "s")
    lines = [f"{time},AHU1 VLV CMD,{k} %,ok" for k, time in enumerate(change_times)]
    lines += [f"{time},AHU1 SAT,{temperature} °C,ok" for time, temperature in zip(ISO, T_SUP, strict=True)]
    text = "\n".join(["time,name,value,status", *lines]) + "\n"
    log = read(tmp_path, text)
    is_after_first = SECONDS >= 3
    np.testing.assert_array_equal(log.values["T_sup"], T_SUP[is_after_first])
    latest = np.searchsorted(change_seconds, SECONDS[is_after_first], side="right") - 1
    np.testing.assert_allclose(log.values["command"], latest / 100)
    bad = text.replace(f",{T_SUP[9]} °C,ok", f",{T_SUP[9]} °C,fault", 1)
    assert_refused("T_sup", "value", read, tmp_path, bad)
    note = "1 value left out: T_sup is not an admissible number (first in row 19)"
    assert note in read(tmp_path, bad, drop=True).notes


def test_a_frame_of_values_with_an_index_of_times_is_read_as_its_file(tmp_path):
    frame = pd.read_csv(save_text(tmp_path, EXPORTS["historian"][0]))
    frame = frame.set_index(pd.to_datetime(frame.pop("TIMESTAMP"), format="%m/%d/%Y %I:%M:%S %p"))
    for source in (frame, frame.tz_localize("America/New_York")):
        assert_same(read_checked_log(source, WANTED, ReadingOptions(drop=False)))


def test_the_set_point_of_our_own_name_is_read_with_any_unit():
    headers = [interpret_header(header) for header in ("T_sup_set", "T_sup_set_C", "T_sup_setpoint [degF]", "T_sup SP")]
    assert {(meaning.name, meaning.is_clear) for meaning in headers} == {("T_set", True)}


@pytest.mark.parametrize("header", ["Setpoint", "SupplyAirTempMySP", "Cooling SP"])
def test_what_may_be_the_set_point_is_asked_about_or_left_out_on_demand(tmp_path, header):
    text = table_text(f"TIMESTAMP,CLG VLV [%],SAT [degC],{header} [degC]", ISO, COMMAND, T_SUP, T_SET)
    assert_refused("T_set", "missing", read, tmp_path, text)
    assert_same(read(tmp_path, text, columns={"T_set": header}))
    for name in (header, "T_set"):
        assert set(read(tmp_path, text, ignore=[name]).values) == {"command", "T_sup"}


def test_a_unit_or_header_of_a_column_that_is_not_read_is_refused(tmp_path):
    path = save_text(tmp_path, table_text("TIMESTAMP,CLG VLV [%],SAT [degC],CHWST", ISO, COMMAND, T_SUP, T_SET))
    assert_refused("units", "name", fc.read_log, path, units={"T_set": "degC"})
    log = fc.read_log(path, columns={"T_w_in": "CHWST"}, units={"T_w_in": "degC"})
    log.read(ColumnSpec(("command",), ("T_sup",)))
    assert_mistakes([("columns", "name"), ("units", "name")], log.require_options_used)
    log.read(ColumnSpec(("T_w_in",)))
    log.require_options_used()


def test_an_optional_column_never_refuses_a_log(tmp_path):
    jump = np.where(SECONDS < 1800, T_SUP, 1.8 * T_SUP + 32)
    header = "TIMESTAMP,CLG VLV [%],SAT [degC],MAT [{}],SAT SP [degC]"
    for unit, values in (("degC", jump), ("bar", T_SUP), ("degC", ["?", *T_SUP[1:]]), ("degC", 500 + T_SUP)):
        text = table_text(header.format(unit), ISO, COMMAND, T_SUP, values, T_SET)
        assert_same(log := read(tmp_path, text))
        assert "T_a_in" not in log.values
        assert any(note.startswith("T_a_in is left out, it is not needed: ") for note in log.notes)
    text = table_text("TIMESTAMP,CLG VLV [%],SAT [degC],MAT 1 [degC],MAT 2 [degC]", ISO, COMMAND, T_SUP, T_SUP, T_SUP)
    assert any(note.startswith("T_a_in is not read, it may be ") for note in read(tmp_path, text).notes)
    text = table_text(header.format("degC"), ISO, COMMAND, T_SUP, T_SUP, ["?", *T_SET[1:]])
    assert_refused("T_set", "value", read, tmp_path, text)  # without it, answers are others


def test_units_as_bacnet_and_other_systems_name_them(tmp_path):
    fahrenheit = "degrees-fahrenheit degreesFahrenheit Degrees_Fahrenheit DEG_F unit:DEG_F ºF ℉ Fahrenheit"
    for unit in [*fahrenheit.split(), "Degrees Fahrenheit", "Deg. F"]:
        for form in ("SAT ({})", "SAT [{}]"):
            header = f"TIMESTAMP,CHW VLV CMD (Percent),{form.format(unit)}"
            log = read(tmp_path, table_text(header, ISO, COMMAND, FAHRENHEIT_TEXTS[0]))
            np.testing.assert_allclose(log.values["T_sup"], T_SUP, atol=1e-4)
    for name, unit, texts in (
        ("m_a", "cfm", "cubic-feet-per-minute cubicFeetPerMinute ft³/min CFM"), ("m_w", "gpm", "usGallonsPerMinute"),
        ("m_w", "L/s", "liters-per-second litresPerSecond l/s"), ("m_a", "m3/h", "m³/h m^3/h cubic-meters-per-hour"),
        ("m_a", "kg s-1", "kg·s⁻¹ kilogramsPerSecond kg/s"), ("W_a_in", "g/kg", "gramsOfWaterPerKilogramDryAir"),
        ("command", "percent", "percent pct per_cent Prozent"), ("command", "V 2-10", "2-10V 2–10_VDC"),
    ):  # fmt: skip
        for text in texts.split():
            assert COLUMNS[name].is_same_unit(text.replace("_", " "), unit), text
    for header in ("SAT (Grad Fahr)", "SAT [Grad Fahr]"):
        text = table_text(f"TIMESTAMP,CHW VLV CMD (%),{header}", ISO, COMMAND, T_SUP)
        assert "'Grad Fahr'" in refusal(read, tmp_path, text)


def test_units_behind_a_low_line(tmp_path):
    text = table_text("time_s,CHW_VLV_pct,SAT_C,SAT_SP_C", SECONDS, COMMAND, T_SUP, T_SET)
    log = read(tmp_path, text)
    np.testing.assert_array_equal(log.time, SECONDS)
    np.testing.assert_array_equal(log.values["T_set"], T_SET)
    assert interpret_header("SF_S").name == "enabled"  # a status, no seconds


@pytest.mark.parametrize("unit", ["S-7_", "OCC-3 ", "M-2:"])
def test_points_of_one_unit_of_plant_share_its_name(tmp_path, unit):
    text = table_text(f"TIMESTAMP,{unit}CLG-O [%],{unit}DA-T [degC],{unit}DA-T SP [degC]", ISO, COMMAND, T_SUP, T_SET)
    if unit.startswith("OCC"):  # a word that forbids a meaning
        mistakes = [("OCC-3 CLG-O [%]", "name"), ("command", "missing"), ("T_sup", "missing")]
        assert_mistakes(mistakes, read, tmp_path, text)
    else:
        assert_same(read(tmp_path, text))

"""Logs as building systems export them: their names, their layouts, a row for each value; nothing wrong in silence."""

import numpy as np
import pandas as pd
import pytest
from helpers.exports import COMMAND, ISO, ROWS, SECONDS, START, T_SUP, saved, times
from helpers.refusals import only_problem, problems

from fastcoil.logs import Reading, read_log
from fastcoil.logs.columns import Wanted, meaning_of

T_SET = np.where(SECONDS < 1800, 14.0, 13.5)
WANTED = Wanted(("command", "T_sup"), ("T_set", "m_a", "T_a_in", "enabled"), ("T_sup", "T_set", "m_a", "T_a_in"))
US = times("%m/%d/%Y %I:%M:%S %p")
IN_F = [[f"{1.8 * one + 32:.4f}" for one in series] for series in (T_SUP, T_SET)]


def table(header, *columns, separator=",", before=""):
    lines = [header, *(separator.join(map(str, row)) for row in zip(*columns, strict=True))]
    return before + "\n".join(lines) + "\n"


def long(header, form, newest_first=False):
    """Text of a file with a row for each value; ``form``: of a row, of time, point, value and unit."""
    points = (("VLV CMD", COMMAND, "%"), ("SAT", IN_F[0], "°F"), ("SAT SP", IN_F[1], "°F"))
    lines = [form.format(time, name, one[k], unit) for k, time in enumerate(US) for name, one, unit in points]
    return "\n".join([header, *(lines[::-1] if newest_first else lines)]) + "\n"


def read(tmp_path, text, **options):
    return read_log(saved(tmp_path, text), WANTED, Reading(has_command=True, **({"drop": False} | options)))


def assert_same(log):
    np.testing.assert_array_equal(log.time, SECONDS)
    for name, values in {"command": COMMAND / 100, "T_sup": T_SUP, "T_set": T_SET}.items():
        np.testing.assert_allclose(log.values[name], values, atol=1e-4)
    assert log.start == np.datetime64(START)


EXPORTS = {
    "niagara": (table("Timestamp,AHU1_CHW_VLV (%),AHU1_SAT (°F),AHU1_SAT_SP (°F)", times("%d-%b-%y %I:%M:%S %p EDT"),
                      *([f"{one} {{ok}}" for one in series] for series in (COMMAND, *IN_F))), {}),
    "metasys": (long("Date / Time,Name Path Reference,Object Name,Object Value", "{0},NAE1:FC1.AHU-3.{1},{1},{2}"),
                {"units": {"command": "%", "T_sup": "degF", "T_set": "degF"}}),
    "historian": (long("TIMESTAMP,point,value,unit,quality", "{0},AHU1 {1},{2},{3},Good", True), {}),
    "desigo": (table('"";"AHU01 Supply air temp";"AHU01 Cooling valve cmd";"AHU01 Supply air temp setpoint"\n'
                     '"";"°C";"%";"°C"', times('"%d.%m.%Y %H:%M:%S"'),
                     *([f'"{one}"'.replace(".", ",") for one in series] for series in (T_SUP, COMMAND, T_SET)),
                     separator=";"), {}),
    "webctrl": (table("Date,AHU-1 SAT (°F),AHU-1 CHW VLV (%),AHU-1 SAT SP (°F)", US, IN_F[0], COMMAND, IN_F[1],
                      before="Trend report\nLocation: AHU-1\n\n"), {}),
    "skyspark": (table("ts,AHU-1 chilled water valve cmd,AHU-1 discharge air temp sensor,dischargeAirTempSp",
                       [f"{stamp}-04:00 New_York" for stamp in ISO], [f"{one}%" for one in COMMAND],
                       *([f"{one}°F" for one in series] for series in IN_F)), {}),
    "brick": (table("Date,TIME,Supply_Air_Temperature_Sensor [degF],Valve_Command [%],"
                    "Discharge_Air_Temperature_Setpoint [degF]", times("%Y-%m-%d"), times("%H:%M:%S"),
                    IN_F[0], COMMAND, IN_F[1]), {}),
}  # fmt: skip


@pytest.mark.parametrize("system", EXPORTS)
def test_an_export_is_read_as_the_plain_log_and_what_is_read_as_what_is_said(tmp_path, system):
    text, options = EXPORTS[system]
    log = read(tmp_path, text, **options)
    assert_same(log)
    (said,) = [note for note in log.notes if "is read as command" in note]
    assert said.count("is read as T_s") == 2
    assert any("newest row is first" in note for note in log.notes) == (system == "historian")


NAMES = {
    "command": "VLV CMD, CHW VLV, CLG-O, CLG VLV, HTG-O, AO-1 CHW VLV CMD, coolingValveCmd, Valve_Position_Command",
    "T_sup": "SAT, DAT, DA-T, SA-T, S:NAE01/FC-1.AHU1.SA_TEMP, Discharge_Air_Temperature_Sensor, SA Temp",
    "T_set": "SAT SP, DAT-SP, DA-T-SP, SUPPLY AIR TEMP SETPOINT, discharge air temp effective sp, SA Temp Set Point",
    "T_a_in": "MAT, MA-T, Mixed_Air_Temperature_Sensor, mixed air temp sensor",
    "m_a": "CFM, SA CFM, SF-1 Airflow, Supply_Air_Flow_Sensor, AHU2 SA Flow [cfm]",
    "enabled": "SF-STS, SF-S, Supply Fan Status, Fan_On_Off_Status, discharge fan run sensor",
    None: "RAT, OAT, ZN SAT SCHED, Sat Occ, SAT HI LIMIT, OA CFM, RF-STS, CHW ISO VLV CMD, HUM VLV CMD, SAT RESET SP, "
          "MIN SAT SP, SA RH, SA STATIC SP, OAD CMD, SF VFD CMD, CHW VLV [gpm], SAT [%], CHWST, SAT SCHED, Wheel SAT",
}  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_names_of_buildings_haystack_and_brick(name):
    for header in NAMES[name].split(", "):
        meaning = meaning_of(header)
        assert (meaning and (meaning.name, meaning.is_clear)) == (name and (name, True)), header


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("CLG VLV [%],HTG VLV [%],SAT [degC]", "command may be 'CLG VLV [%]' or 'HTG VLV [%]': say which to read: "
         "columns={'command': 'CLG VLV [%]'}, --column command='CLG VLV [%]'"),
        ("CLG VLV [%],DA-T 1 [degC],DA-T 2 [degC]", "T_sup may be 'DA-T 1 [degC]' or 'DA-T 2 [degC]': say which"),
        ("CHW VLV POS [%],SAT [degC],ZN-T [degC]", "command is missing: 'CHW VLV POS [%]' is not clearly it: add a"),
        ("CLG VLV [%],SAT LEFT [degC],ZN-T [degC]", "T_sup is missing: 'SAT LEFT [degC]' is not clearly it: add a"),
        ("AHU1 CLG VLV [%],AHU2 SAT [degC],ZN-T [degC]", "T_sup is missing: 'AHU2 SAT [degC]' is not clearly it: add"),
        ("CLG VLV [%],ZN SAT SCHED [1],SAT SP [degC]", "T_sup is missing: add a column"),
    ],
)  # fmt: skip
def test_what_is_in_doubt_is_asked_about(tmp_path, header, words):
    text = table(f"TIMESTAMP,{header}", ISO, *[COMMAND if "[%]" in one else T_SUP for one in header.split(",")])
    assert words in only_problem(read, tmp_path, text)


def test_an_answer_settles_the_plant_of_all_columns(tmp_path):
    points = "AHU-2 VLV CMD [%]", "AHU-1 VLV CMD [%]", "AHU-1 SAT [degC]", "AHU-2 SAT [degC]", "AHU-2 SAT SP [degC]"
    header = ",".join(["Time", *(f"NAE1.{point}" for point in points)])
    text = table(header, ISO, COMMAND, 0 * COMMAND, 0 * T_SUP, T_SUP, T_SET)
    assert len(problems(read, tmp_path, text)) == 2
    assert_same(read(tmp_path, text, columns={"command": "NAE1.AHU-2 VLV CMD"}))


def test_among_thirty_other_points_in_any_order_the_right_ones_are_read_or_it_is_asked(tmp_path):
    rng = np.random.default_rng(7)
    more = "CHW VLV POS,OA DMPR CMD,SF SPD,FLT DP,RA RH,CO2,OCC,ZN-SP,RA-T,EF-STS,CHWS-T,CHWR-T,MODE,SAT ALM"
    others = NAMES[None].split(", ")[:16] + more.split(",")
    for _ in range(25):
        right = [str(rng.choice(NAMES[name].split(", ")[:4])) for name in ("command", "T_sup", "T_set")]
        second = str(rng.choice(["HTG VLV CMD", "SAT 2", "SAT SP 2", "", ""]))
        columns = dict(zip([f"AHU1 {one}" for one in right], (COMMAND / 100, T_SUP, T_SET), strict=True))
        columns |= {f"AHU1 {one}": rng.normal(50, 9, ROWS) for one in [*others, *filter(None, [second])]}
        names = list(columns)
        rng.shuffle(names)
        text = table(",".join(["Date/Time", *names]), ISO, *(columns[name] for name in names))
        units = {"command": "1", "T_sup": "degC", "T_set": "degC"}
        if second:
            assert f"'AHU1 {second}'" in only_problem(read, tmp_path, text, units=units)
            continue
        assert_same(log := read(tmp_path, text, units=units))
        assert set(log.values) == {"command", "T_sup", "T_set"}
        assert any(note.startswith("left alone: ") and "27 more" in note for note in log.notes)


def test_points_of_a_long_log_keep_their_own_times(tmp_path):
    at = [3, 40, 41, 200, 1000, 1090, 2000, 2200]
    moments = np.datetime64(START) + np.array(at) * np.timedelta64(1, "s")
    lines = [f"{time},AHU1 VLV CMD,{k} %,ok" for k, time in enumerate(moments)]
    lines += [f"{time},AHU1 SAT,{one} °C,ok" for time, one in zip(ISO, T_SUP, strict=True)]
    text = "\n".join(["time,name,value,status", *lines]) + "\n"
    log = read(tmp_path, text)
    after = SECONDS >= 3
    np.testing.assert_array_equal(log.values["T_sup"], T_SUP[after])
    np.testing.assert_allclose(log.values["command"], (np.searchsorted(at, SECONDS[after], side="right") - 1) / 100)
    bad = text.replace(f",{T_SUP[9]} °C,ok", f",{T_SUP[9]} °C,fault", 1)
    assert f"T_sup = '{T_SUP[9]} °C {{fault}}' in row 19, bad by its status" in only_problem(read, tmp_path, bad)
    said = "1 value left out: T_sup is not an admissible number (first in row 19)"
    assert said in read(tmp_path, bad, drop=True).notes


def test_a_frame_of_values_with_an_index_of_times_is_read_as_its_file(tmp_path):
    frame = pd.read_csv(saved(tmp_path, EXPORTS["historian"][0]))
    frame = frame.set_index(pd.to_datetime(frame.pop("TIMESTAMP"), format="%m/%d/%Y %I:%M:%S %p"))
    for one in (frame, frame.tz_localize("America/New_York")):
        assert_same(read_log(one, WANTED, Reading(drop=False)))

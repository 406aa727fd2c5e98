"""Logs whose numbers contradict the declared units, humidity above saturation, exchanged columns, rows out of order."""

import time

import numpy as np
import pytest
from helpers.refusals import assert_mistakes, assert_refused
from helpers.sentences import assert_worded

import fastcoil as fc
from fastcoil.logs import ReadingOptions, read_checked_log
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.join import join_points
from fastcoil.logs.plausibility import find_misread_units
from fastcoil.logs.readings import propose_unit
from fastcoil.logs.series import COLUMNS
from fastcoil.model.moist_air import humidity_ratio

N = 120
TEMPERATURES = ("T_sup", "T_set", "T_a_in", "T_w_in")
UNITS = dict.fromkeys(TEMPERATURES, "degC") | {"command": "%", "m_a": "kg/s", "RH_a_in": "%"}


def sound_log(rng, heats=False):
    """Columns of a cooling or heating coil by name, in the usual units."""
    k = np.arange(N)
    T_set = np.repeat(rng.uniform(22, 32, 4) if heats else rng.uniform(12, 16, 4), N // 4)
    return {
        "T_sup": T_set + rng.normal(0, 0.4, N),
        "T_set": T_set,
        "T_a_in": (rng.uniform(8, 18) if heats else rng.uniform(22, 27)) + np.sin(k / 20),
        "T_w_in": (rng.uniform(45, 75) if heats else rng.uniform(6, 9)) + 0.2 * np.sin(k / 9),
        "command": 50 + rng.uniform(10, 40) * np.sin(k / 7),
        "m_a": 1.2 + 0.1 * np.sin(k / 11),
        "RH_a_in": 50 + 5 * np.sin(k / 13),
    }


def log_text(log, units=UNITS, order=range(N), unit_row=None):
    header = ["timestamp", *(f"{name} [{units[name]}]" if units.get(name) else name for name in log)]
    stamps = [f"2024-07-25T{8 + i // 60:02}:{i % 60:02}:00" for i in range(N)]
    rows = [[stamps[i], *(f"{column[i]:.6g}" for column in log.values())] for i in order]
    return "\n".join(map(",".join, [header, *([unit_row] if unit_row else []), *rows]))


def read(tmp_path, text, log, **options):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    humidity = tuple({"RH_a_in", "W_a_in", "T_dp_in"} & set(log)) or ("RH_a_in",)
    spec = ColumnSpec(("command", "T_sup", "T_a_in", "T_w_in", "m_a", humidity), ("T_set",), ("T_sup",))
    return read_checked_log(path, spec, ReadingOptions(reader="read_log", **options))


def contradictory_log(kind, rng, heats):
    """A log with one contradiction, as a text, and its columns."""
    log, units, layout = sound_log(rng, heats), dict(UNITS), {}
    name, is_before = str(rng.choice(TEMPERATURES)), np.arange(N) < N // 2
    W = humidity_ratio(log["T_a_in"], log["RH_a_in"] / 100, 101325.0)
    T_sup, T_a_in, command = log["T_sup"], log["T_a_in"], log["command"]
    swing = 50 + 45 * np.sin(np.arange(N) / 7)
    columns_by_kind = {
        "all °F": {name_in_F: 1.8 * log[name_in_F] + 32 for name_in_F in TEMPERATURES},
        "one °F": {name: 1.8 * log[name] + 32},
        "RH as a fraction": {"RH_a_in": log["RH_a_in"] / 100},
        "command as a fraction": {"command": command / 100},
        "command in V as %": {"command": np.clip(5 + 6 * np.sin(np.arange(N) / 7), 0, 10)},
        "a fraction from here on": {"command": np.where(is_before, swing, swing / 100)},
        "V from here on": {"command": np.where(is_before, swing, swing / 10)},
        "exchanged": {"T_sup": log["T_set"], "T_set": T_sup},
        "°F from here on": {"T_a_in": np.where(is_before, T_a_in, 1.8 * T_a_in + 32)},
    }
    humidity_by_kind = {
        "W in g as kg": ("W_a_in", 1000 * W, "kg/kg"), "W in kg as g": ("W_a_in", W, "g/kg"),
        "W above saturation": ("W_a_in", 4 * W, "kg/kg"), "dew point": ("T_dp_in", T_a_in + 3, "degC"),
        "dew point in °C as °F": ("T_dp_in", T_a_in - 10, "degF"),
    }  # fmt: skip
    log |= columns_by_kind.get(kind, {})
    units |= {"one °C as °F": {name: "degF"}, "air flow in kg/s as kg/h": {"m_a": "kg/h"}}.get(kind, {})
    if kind == "unit row":
        layout["unit_row"] = ["", *("degF" if name_in_F == name else units[name_in_F] for name_in_F in log)]
    elif kind == "shuffled":
        layout["order"] = rng.permutation(N)
    elif kind in humidity_by_kind:
        del log["RH_a_in"]
        humidity, values, unit = humidity_by_kind[kind]
        log[humidity], units[humidity] = values, unit
    return log_text(log, units, **layout), log


CODES_BY_KIND = {
    **dict.fromkeys(("all °F", "unit row", "RH as a fraction", "command as a fraction", "command in V as %",
                     "a fraction from here on", "V from here on", "dew point in °C as °F", "°F from here on",
                     "air flow in kg/s as kg/h", "W in kg as g"), {"unit"}),
    **dict.fromkeys(("exchanged", "W above saturation", "dew point"), {"data"}),
    **dict.fromkeys(("one °F", "one °C as °F"), {"unit", "value"}),
    "W in g as kg": {"value"},
    "shuffled": {"time"},
}  # fmt: skip
"""More than one where what the numbers contradict depends on the column."""


@pytest.mark.parametrize("kind", CODES_BY_KIND)
@pytest.mark.parametrize("heats", [False, True], ids=["cooling", "heating"])
def test_a_log_with_a_contradiction_is_refused_with_value_row_and_cure(tmp_path, kind, heats):
    for seed in range(3):
        text, log = contradictory_log(kind, np.random.default_rng(seed), heats)
        for options in ({}, {"drop": True, "jumps": "split"}):
            with pytest.raises(fc.InputError, match="row") as raised:
                read(tmp_path, text, log, **options)
            assert CODES_BY_KIND[kind] & {problem.code for problem in raised.value.problems}
    assert_worded(*raised.value.problems)


@pytest.mark.parametrize(
    ("numbers", "found"),
    [
        ({"T_sup": (14, "degC"), "T_set": (40, "degC")}, {"T_set": "degF"}),
        ({"T_sup": (14, "degC"), "T_set": (25, "degC")}, {}),
        ({"T_sup": (14, "degC"), "T_set": (31, "degC")}, {}),  # 12 K apart, and no less in °F
        ({"T_set": (14, "degC"), "T_a_in": (25, "degC"), "T_w_in": (44, "degC")}, {"T_w_in": "degF"}),
        ({"T_set": (24, "degC"), "T_a_in": (12, "degC"), "T_w_in": (50, "degC")}, {}),
        ({"m_w": (0.7, "L/h")}, {"m_w": "kg/s"}),
        ({"m_w": (50, "L/h"), "m_a": (300, "m3/h")}, {}),
        ({"T_sup": (55, "degC"), "T_w_in": (70, "degC")}, {}),
        ({"T_sup": (27, "degC"), "T_a_in": (13, "degC"), "T_w_in": (113, "degC")}, {"T_w_in": "degF"}),
        ({"T_sup": (27, "degC"), "T_a_in": (13, "degC"), "T_w_in": (60, "degF")}, {"T_w_in": "degC"}),
    ],
)
def test_the_unit_with_which_nothing_contradicts_is_found(numbers, found):
    values = {name: COLUMNS[name].convert(np.full(9, float(n)), unit) for name, (n, unit) in numbers.items()}
    units = {name: unit for name, (_, unit) in numbers.items()}
    assert find_misread_units(values, units, ()) == found
    assert find_misread_units(values, units, list(numbers)) == {}


def test_only_the_time_in_control_counts():
    is_off = np.arange(90) < 60  # a heating coil that is off in most rows
    values = {"T_sup": np.where(is_off, 15.0, 38.0), "T_set": np.full(90, 40.0), "command": np.where(is_off, 0.0, 0.4)}
    units = {"T_sup": "degC", "T_set": "degC", "command": "%", "enabled": "1"}
    assert find_misread_units(values, units, ()) == {}
    values["command"] = np.full(90, 0.4)
    assert find_misread_units(values, units, ()) == {"T_set": "degF"}
    assert find_misread_units(values | {"enabled": 1.0 - is_off}, units, ()) == {}


@pytest.mark.parametrize("heats", [False, True], ids=["cooling", "heating"])
def test_a_sound_log_is_read_in_either_unit_without_a_word(tmp_path, heats):
    for seed in range(5):
        log = sound_log(np.random.default_rng(seed), heats)
        log_C = read(tmp_path, log_text(log), log)
        in_F = log | {name: 1.8 * log[name] + 32 for name in TEMPERATURES}
        log_F = read(tmp_path, log_text(in_F, UNITS | dict.fromkeys(TEMPERATURES, "degF")), log)
        assert not log_C.notes + log_F.notes
        np.testing.assert_allclose(log_F.values["T_sup"], log_C.values["T_sup"], atol=1e-3)


@pytest.mark.parametrize(("low", "high", "meant"), [(1, 9, "V"), (2.5, 9.6, "V 2-10"), (5, 19, "mA 4-20"), (3, 9, "")])
def test_a_command_in_percent_that_spans_a_signal_is_read_with_a_word(tmp_path, low, high, meant):
    log = sound_log(np.random.default_rng(0)) | {"command": np.linspace(low, high, N)}
    log_read = read(tmp_path, log_text(log), log)
    has_hint = [f"if it is a signal in {meant}, write '[{meant}]' in the header" in note for note in log_read.notes]
    assert has_hint == [True] * bool(meant)
    assert not read(tmp_path, log_text(log), log, units={"command": "%"}).notes


@pytest.mark.parametrize(("number", "n"), [(55, 1), (55, 9), (-17.5, 4)])
def test_a_temperature_that_leaps_away_and_back_is_a_sensor_that_is_off(tmp_path, number, n):
    log = sound_log(np.random.default_rng(0))
    log["T_sup"][20 : 20 + n] = number
    log_read = read(tmp_path, log_text(log), log)
    assert np.flatnonzero(np.isnan(log_read.values["T_sup"])).tolist() == [*range(20, 20 + n)]
    assert f"left out: T_sup is {number:g} degC, sensor off (first in row 22)" in log_read.notes[0]
    log["T_a_in"][20 : 20 + n] = number
    assert_refused("T_a_in", "data", read, tmp_path, log_text(log), log)


def test_a_temperature_of_zero_throughout_is_a_sensor_that_is_off(tmp_path):
    log = sound_log(np.random.default_rng(0)) | {"T_a_in": np.zeros(N)}
    assert_refused("T_a_in", "data", read, tmp_path, log_text(log), log)


def test_a_unit_that_header_and_caller_declare_is_trusted(tmp_path):
    log = sound_log(np.random.default_rng(0)) | {"RH_a_in": np.full(N, 0.6)}
    text = log_text(log)
    assert_refused("RH_a_in", "unit", read, tmp_path, text, log)
    assert read(tmp_path, text, log, units={"RH_a_in": "%"}).values["RH_a_in"][0] == pytest.approx(0.006)


def test_a_few_readings_above_saturation_are_bad_values(tmp_path):
    log = sound_log(np.random.default_rng(0))
    log["T_dp_in"] = log["T_a_in"] - 5
    log["T_dp_in"][[7, 30]] = 35
    del log["RH_a_in"]
    text = log_text(log, UNITS | {"T_dp_in": "degC"})
    assert_refused("T_dp_in", "data", read, tmp_path, text, log)
    log_read = read(tmp_path, text, log, drop=True)
    assert log_read.time.size == N - 2
    assert "2 rows left out: T_dp_in is not an admissible number (first in row 9)" in log_read.notes


@pytest.mark.parametrize("constants", [{"T_dp_in": 30}, {"W_a_in": 0.05}])
def test_a_constant_humidity_above_saturation_is_refused(tmp_path, constants):
    log = sound_log(np.random.default_rng(0))
    del log["RH_a_in"]
    spec = ColumnSpec(("T_a_in", tuple(constants)))
    path = tmp_path / "log.csv"
    path.write_text(log_text(log))
    options = ReadingOptions(columns={}, constants=constants, drop=True)
    assert_refused(*constants, "data", read_checked_log, path, spec, options)


def test_shuffled_rows_are_refused_before_any_work(write_log):
    rng = np.random.default_rng(1)
    rows = [[60 * k, rng.uniform(0, 100), 14 + rng.normal()] for k in rng.permutation(400)]
    start = time.monotonic()
    path = write_log(["elapsed_time [s]", "command [%]", "m_w [kg/s]"], rows)
    assert_refused("elapsed_time", "time", fc.fit_valve, fc.read_log(path, drop=True, jumps="split"))
    assert time.monotonic() - start < 5.0


def test_the_newest_row_first_is_turned_round_and_said(tmp_path):
    log = sound_log(np.random.default_rng(0))
    log_read = read(tmp_path, log_text(log, order=range(N)[::-1]), log)
    assert log_read.notes == ["the newest row is first: turned round"]
    assert (log_read.rows[0], log_read.start) == (N + 1, np.datetime64("2024-07-25T08:00:00"))
    np.testing.assert_array_equal(log_read.values["T_sup"], read(tmp_path, log_text(log), log).values["T_sup"])
    header, newest, *rows = log_text(log, order=range(N)[::-1]).splitlines()
    lines = [header, newest, rows[0].replace("2024-07-25T09:58", "?"), *rows[1:-1]]
    log_read = read(tmp_path, "\n".join(lines), log, drop=True)
    assert log_read.time.tolist() == [60.0 * k for k in range(N - 1) if k != N - 3]
    lines[-1] = ",".join([*lines[-1].split(",")[:-1], "off"])
    assert read(tmp_path, "\n".join(lines), log, drop=True).start == np.datetime64("2024-07-25T08:02:00")


@pytest.mark.parametrize("cell", ["1_5", "１５", "1_5 %", "٣"])
def test_digits_that_no_system_writes_are_no_numbers(write_log, cell):
    path = write_log(["elapsed_time [s]", "command [%]"], [[0, 10], [60, cell], [120, 20]])
    assert_refused("command", "value", read_checked_log, path, ColumnSpec(("command",)))


def test_files_to_join_are_checked_beside_each_other(tmp_path):
    log = sound_log(np.random.default_rng(0))
    paths = []
    for name, unit in (("T_sup", "degC"), ("T_set", "degF"), ("command", "%")):
        paths.append(tmp_path / f"{name}.csv")
        paths[-1].write_text(log_text({name: log[name]}, {name: unit}))
    assert_refused("T_set", "unit", join_points, paths, columns={}, units={})
    assert join_points(paths, columns={}, units={"T_set": "degF"})[0]


def test_a_log_without_units_is_asked_for_each(tmp_path):
    log = sound_log(np.random.default_rng(0))
    mistakes = [("timestamp", "time"), *((name, "unit") for name in log)]
    assert_mistakes(mistakes, read, tmp_path, log_text(log, {}).replace("2024-07-25T08:05:00", "?"), log)


@pytest.mark.parametrize(
    ("name", "values", "unit"),
    [
        ("command", [0.0, 0.4, 1.0], "1"), ("command", [0.0, 40.0, 100.0], "percent"),
        ("T_sup", [12.0, 14.0, 16.0], "degC"), ("T_sup", [54.0, 58.0, np.nan], "degF"),
        ("T_w_in", [60.0, 61.0], ""), ("m_a", [1.0, 1.2], ""), ("T_set", [np.nan], ""),
    ],
)  # fmt: skip
def test_a_missing_unit_is_proposed_where_the_numbers_show_it(name, values, unit):
    """Hot water in degC looks like cold air in degF, and a flow may be in anything."""
    assert propose_unit(COLUMNS[name], np.array(values)) == unit


@pytest.mark.kernel
def test_a_frame_is_read_as_a_file_is(tmp_path):
    pd = pytest.importorskip("pandas")
    rng = np.random.default_rng(2)
    command = np.round(np.repeat(rng.uniform(0, 100, 40), 5), 1)
    columns = {"command [%]": command, "m_w [kg/s]": np.round(command / 50 + rng.normal(0, 0.01, 200).clip(0), 4)}
    index = pd.date_range("2024-07-01T08:00", periods=200, freq="60s", name="when", tz="America/New_York")
    frame = pd.DataFrame(columns, index=index)
    path = tmp_path / "log.csv"
    frame.rename_axis("timestamp").to_csv(path)
    assert fc.fit_valve(frame).parameters == fc.fit_valve(path).parameters
    log = read_checked_log(frame, ColumnSpec(("command", "m_w")))
    assert (log.name, log.time_zone, log.start) == ("DataFrame", "UTC-04:00", np.datetime64("2024-07-01T08:00:00"))
    assert_refused("timestamp", "time", read_checked_log, frame.iloc[rng.permutation(200)], ColumnSpec(("command",)))
    doubled = pd.concat([frame, frame["m_w [kg/s]"]], axis=1)
    assert_refused("m_w [kg/s]", "duplicate", read_checked_log, doubled, ColumnSpec(("command",)))


def test_a_command_that_may_be_a_signal_is_not_proposed_in_per_cent(tmp_path):
    volts = np.round(np.clip(np.linspace(1.9, 10.1, N), 2.0, 10.0), 2)
    log = sound_log(np.random.default_rng(0)) | {"command": volts}
    with pytest.raises(fc.InputError, match=r"--unit command='V 2-10'"):
        read(tmp_path, log_text(log, UNITS | {"command": ""}), log)

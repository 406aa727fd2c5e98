"""Which columns of an export are read: date and time apart, times under another name, two columns for one series."""

import pytest
from helpers.exports import COMMAND, HEADER, ISO, T_SUP, assert_same_log, read, rows, saved, text_of, times
from helpers.refusals import only_problem, refusal

from fastcoil.logs.join import Files


@pytest.mark.parametrize(
    ("header", "date", "clock"),
    [
        (("Date", "Time"), "%m/%d/%Y", "%I:%M:%S %p"),
        (("Datum", "Uhrzeit"), "%d.%m.%Y", "%H:%M"),
        (("DATE", "TIME"), "%d-%b-%y", "%H:%M:%S"),
    ],
)
def test_date_and_time_of_day_in_columns_of_their_own_are_one_timestamp(tmp_path, header, date, clock):
    cells = [[day, *row[1:], hour] for day, hour, row in zip(times(date), times(clock), rows(), strict=True)]
    text = text_of(cells, (header[0], *HEADER[1:], header[1]))
    log = read(tmp_path, text)
    assert_same_log(log)
    assert f"{header[0]} and {header[1]} are read as one timestamp" in log.told
    assert_same_log(read(tmp_path, text, columns={"timestamp": header[1]}, time_format=f"{date} {clock}"))


def test_a_row_without_its_time_of_day_is_named(tmp_path):
    cells = [[day, hour, *row[1:]] for day, hour, row in zip(times("%Y-%m-%d"), times("%H:%M"), rows(), strict=True)]
    cells[7][1] = ""
    said = only_problem(read, tmp_path, text_of(cells, ("Date", "Time", *HEADER[1:])))
    assert "timestamp = '' in row 9" in said


def test_a_column_of_times_under_another_name_is_named_with_the_option(tmp_path):
    text = text_of(rows(), ("Date/Time", *HEADER[1:]))
    said = only_problem(read, tmp_path, text, columns={"command": "command"})
    assert "'Date/Time' has times" in said
    assert "--column timestamp='Date/Time'" in said


def test_two_columns_of_one_name_and_two_names_of_one_column_are_refused(tmp_path):
    text = text_of(rows(ISO, COMMAND, T_SUP, T_SUP), (*HEADER, "T_sup (°C)"))
    assert "T_sup is in two columns, 'T_sup [degC]' and 'T_sup (°C)'" in only_problem(read, tmp_path, text)
    assert_same_log(read(tmp_path, text, columns={"T_sup": "T_sup (°C)"}))
    said = refusal(read, tmp_path, text_of(rows()), columns={"enabled": "T_sup", "T_sup": "T_sup"})
    assert "enabled and T_sup are both read from the column 'T_sup [degC]'" in said


def test_a_file_to_join_may_have_date_and_time_apart(tmp_path):
    cells = [[day, hour, *row[1:]] for day, hour, row in zip(times("%d.%m.%Y"), times("%H:%M"), rows(), strict=True)]
    path = saved(tmp_path, text_of(cells, ("Date", "Time", *HEADER[1:])))
    point = Files([path], {}, {}, None).points[0]
    assert (point.name, point.times[-1] - point.times[0]) == ("command", 59 * 60_000_000)

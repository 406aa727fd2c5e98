"""Every way a trend log can be wrong, named with its value and the cure."""

import pytest
from helpers.refusals import assert_only_problem, problems
from helpers.trend_logs import HEADER, ROWS, replaced, row

from fastcoil.loops.boundary import Boundary


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (replaced(0, [0, 60, 60]), ["row 4 is at the same time as row 3", "drop doubles"]),
        (replaced(0, [0, 60, 30]), ["row 4 is earlier than row 3", "sort"]),
        ([*ROWS, row(180), row(500)], ["rows 5 and 6 are 320 s apart", "others 60 s", "max_gap=320"]),
        (replaced(0, [0, 0.5, 1.0]), ["rows are 0.5 s apart", "1 s or more"]),
        (replaced(2, [25, "nan", 25]), ["T_a_in is nan in row 3", "fill or cut"]),
        (replaced(2, [25, 25, "-inf"]), ["T_a_in is -inf in row 4"]),
        (replaced(2, [-999, 25, 25]), ["T_a_in = -999 degC in row 2", "missing value"]),
        (replaced(2, [25, "", 25]), ["T_a_in is blank in row 3", "fill or cut"]),
        (replaced(2, [25, "off", 25]), ["T_a_in = 'off' in row 3", "give a number"]),
        (replaced(2, [25, "24,5", 25]), ["T_a_in = '24,5' in row 3", "decimal point"]),
        (
            replaced(2, [77, 77, 77]),
            ["T_a_in = 77 degC in row 2", "from -40 to 60 degC", "check its unit", "3 samples"],
        ),
        (replaced(3, [0.01, 9.5, 9.5]), ["W_a_in = 9.5 in row 3", "from 0 to 0.1", "unit"]),
        (replaced(0, ["0", "1:00", "2:00"]), ["elapsed_time = '1:00' in row 3"]),
        (replaced(0, [0, 60, "inf"]), ["elapsed_time is inf in row 4"]),
        ([ROWS[0], ROWS[1][:-1], ROWS[2]], ["row 3 has 5 cells where the header has 6"]),
        ([ROWS[0]], ["one row of data", "at least two"]),
        ([], ["header but no data", "at least two"]),
    ],
)
def test_bad_rows_are_named_with_value_and_cure(write, rows, words):
    assert_only_problem(words, Boundary.from_csv, write(HEADER, rows))


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ([*HEADER[:2], "T_a_in", *HEADER[3:]], ["T_a_in has no unit", "'T_a_in [degC]'", "units={'T_a_in': 'degC'}"]),
        ([*HEADER[:2], "T_a_in [celsius]", *HEADER[3:]], ["T_a_in is in 'celsius'", "degC, degF, K"]),
        ([*HEADER[:1], "m_a [kg/min]", *HEADER[2:]], ["m_a is in 'kg/min', did you mean 'kg/", "cfm"]),
        ([*HEADER[:5], "T_a_in [degC]"], ["column 'T_a_in [degC]' appears twice"]),
        ([f"time {HEADER[0]}"], ["row 2 has 6 cells where the header has 1"]),
        (["elapsed_time [s];m_a [kg/s];T_a_in [degC]"], ["';'", "use commas"]),
    ],
)
def test_bad_headers_are_named_with_the_cure(write, header, words):
    assert_only_problem(words, Boundary.from_csv, write(header, ROWS))


def test_an_unknown_column_is_named_with_the_nearest_known_one(write):
    found = problems(Boundary.from_csv, write([*HEADER[:2], "T_a_inn [degC]", *HEADER[3:]], ROWS))
    assert "column 'T_a_inn [degC]' is unknown, did you mean 'T_a_in'?" in found[0]
    assert "T_a_in is missing: add a column 'T_a_in [degC]'" in found[1]


def test_humidity_and_time_are_given_once(write):
    both = [*HEADER, "RH_a_in [1]"], [[*r, 0.5] for r in ROWS]
    assert_only_problem(["W_a_in and RH_a_in are both given", "leave one out"], Boundary.from_csv, write(*both))
    neither = [[cell for i, cell in enumerate(r) if i != 3] for r in [HEADER, *ROWS]]
    assert_only_problem(
        ["W_a_in, RH_a_in or T_dp_in is missing", "constants={'W_a_in': NUMBER}"],
        Boundary.from_csv,
        write(neither[0], neither[1:]),
    )
    untimed = [r[1:] for r in [HEADER, *ROWS]]
    assert_only_problem(
        ["elapsed_time or timestamp is missing", "columns={'elapsed_time'"],
        Boundary.from_csv,
        write(untimed[0], untimed[1:]),
    )


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (["2024-07-01T08:00", "01/07/2024 08:01", "2024-07-01T08:02"], ["'01/07/2024 08:01' in row 3", "ISO 8601"]),
        (["2024-11-03T01:00", "2024-11-03T01:30-04:00", "2024-11-03T02:00"], ["row 3", "UTC offset"]),
        (["2024-11-03T01:00", "2024-11-03T01:30", "2024-11-03T01:00"], ["row 4 is earlier than row 3"]),
    ],
)
def test_bad_timestamps(write, stamps, words):
    path = write(["timestamp", *HEADER[1:]], replaced(0, stamps))
    assert_only_problem(words, Boundary.from_csv, path)


def test_a_gap_is_bridged_on_request(write):
    path = write(HEADER, [*ROWS, row(180, T_w_in=7.0), row(500, T_w_in=8.6)])
    boundary = Boundary.from_csv(path, max_gap=320)
    assert boundary.series["T_w_in"][0, 340] == pytest.approx(7.8)


def test_all_mistakes_of_a_file_are_raised_at_once(write):
    rows = replaced(1, [1, -2, 1], replaced(2, [25, 25, "x"], replaced(4, [7, 7, -999], replaced(0, [0, 60, 60]))))
    found = problems(Boundary.from_csv, write(HEADER, rows))
    assert len(found) == 4
    for text, words in zip(found, ("m_a = -2", "T_a_in = 'x'", "T_w_in = -999", "same time"), strict=True):
        assert words in text
        assert text.startswith("log.csv: ")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", ["is empty", "header row"]),
        (b"\n\n\n", ["is empty"]),
        ("m_a [kg/s],T_ä\n1,2\n".encode("latin-1"), ["not UTF-8", "CSV UTF-8"]),
        (b"\x00\x01\x02,\x00\n\x00,\x00\n", ["bytes.csv"]),
    ],
)
def test_bad_files(tmp_path, content, words):
    path = tmp_path / "bytes.csv"
    path.write_bytes(content)
    found = problems(Boundary.from_csv, path)
    for word in words:
        assert word in found[0]


def test_missing_files_and_directories(tmp_path):
    assert_only_problem(["none.csv", "does not exist", "give a CSV file"], Boundary.from_csv, tmp_path / "none.csv")
    assert_only_problem([str(tmp_path), "is a folder", "give a CSV file"], Boundary.from_csv, tmp_path)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"columns": {"T_a_inn": "x"}}, ["columns has unknown 'T_a_inn', did you mean 'T_a_in'?"]),
        ({"columns": {"T_a_in": "T_a_im [degC]"}}, ["T_a_in: there is no column", "did you mean 'T_a_in [degC]'?"]),
        ({"units": {"T_oa": "degC"}}, ["units has unknown 'T_oa'", "use m_a"]),
        ({"units": {"T_a_in": "degF"}}, ["T_a_in is in 'degC' by its header, in 'degF' by units"]),
        ({"constants": {"RH_a_in": 50}}, ["constants has RH_a_in = 50", "number from 0 to 1"]),
        ({"constants": {"T_sup": 14.0}}, ["constants has unknown 'T_sup'"]),
        ({"constants": {"noise": "0"}}, ["constants has noise = '0'", "number"]),
        ({"constants": {"noise": 60.0}}, ["noise = 60", "from -50 to 50 K"]),
        ({"hours": 1.0}, ["hours = 1", "120 s", "lower it"]),
        ({"start": 1.0}, ["start = 1 h", "120 s"]),
        ({"start": -1.0}, ["start = -1 h", "from 0"]),
        ({"hours": 0}, ["hours = 0 h"]),
        ({"pressure": 1013.25}, ["pressure = 1013.25 Pa"]),
        ({"max_gap": 0}, ["max_gap = 0 s"]),
    ],
)
def test_bad_arguments(write, arguments, words):
    path = write(HEADER, ROWS)
    found = problems(Boundary.from_csv, path, **arguments)
    for word in words:
        assert word in found[0], found

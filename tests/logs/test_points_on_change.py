"""Points that are logged when they change: in files of their own, and in columns that are blank between changes."""

import numpy as np
import pytest
from helpers.exports import ISO, ROWS, cell_rows, format_times, save_text, table_text
from helpers.refusals import assert_refused

from fastcoil.logs.join import join_points


@pytest.fixture
def join_with_log(tmp_path):
    """Return a function that joins a command and a temperature of every minute with another point."""
    clock = format_times("%Y-%m-%dT%H:%M:%S")
    paths = [
        save_text(tmp_path, table_text([[t, str(k)] for k, t in enumerate(clock)], ("timestamp", header)), name=name)
        for name, header in (("command.csv", "command [%]"), ("T_sup.csv", "T_sup [degC]"))
    ]

    def join(header, *changes):
        path = save_text(tmp_path, table_text([*map(list, changes)], ("timestamp", header)), name="point.csv")
        text, notes = join_points([*paths, path], columns={}, units={})
        head, *lines = text.splitlines()
        column = head.split(",").index(header)
        return [line.split(",")[column] for line in lines], notes

    return join


@pytest.mark.parametrize(
    ("header", "changes", "n_first"),
    [
        ("enabled [1]", [("2024-07-11T06:00", "0"), ("2024-07-11T23:40", "1")], 10),
        ("enabled [1]", [(f"2024-07-{d:02}T{h:02}:00", str(int(h < 12))) for d in (8, 9, 10, 11) for h in (6, 18)], 0),
        ("enabled [1]", [("2024-07-11T06:00", "1"), ("2024-07-11T18:00", "0"), ("2024-07-12T00:00", "1")], 30),
        ("T_set [degC]", [("2024-07-09T09:00", "13"), ("2024-07-11T05:00", "14")], 0),
        ("T_set [degC]", [("2024-06-01T09:00", "13")], 0),
    ],
)
def test_a_point_on_change_holds_from_its_last_change_to_the_end_of_the_log(join_with_log, header, changes, n_first):
    values, notes = join_with_log(header, *changes)
    before = [changes[-2][1]] * n_first if n_first else []
    assert values == before + [changes[-1][1]] * (ROWS - n_first)
    assert any(note.startswith(header.split()[0]) and "written when it changes" in note for note in notes)


def test_a_point_of_regular_samples_ends_with_them(join_with_log):
    values, _ = join_with_log("T_set [degC]", *((t, str(14 + k % 3)) for k, t in enumerate(ISO[:40])))
    assert len(values) == 40


STATUS = ["0"] * 10 + ["1"] * 30 + ["0"] * 20
ON_CHANGE = [new if k == 0 or new != STATUS[k - 1] else "" for k, new in enumerate(STATUS)]


@pytest.mark.parametrize("first", ["0", ""])
@pytest.mark.parametrize("place", [0, 1, 3])
@pytest.mark.parametrize("words", [{"0": "0", "1": "1"}, {"0": "Off", "1": "On"}])
def test_a_status_that_is_written_at_changes_alone_is_held(read_export, place, first, words):
    cells = [words.get(cell, "") for cell in [first, *ON_CHANGE[1:]]]
    rows = [[*row[:place], cell, *row[place:]] for row, cell in zip(cell_rows(), cells, strict=True)]
    header = ["timestamp", "command [%]", "T_sup [degC]"]
    header.insert(place, "SF Sts")
    for drop in (False, True):
        log = read_export(rows, header, drop=drop)
        np.testing.assert_array_equal(log.values["enabled"], np.array(STATUS, float))
        assert any(note.startswith("enabled has values at its changes") for note in log.notes)


def test_blanks_of_an_outage_are_not_held(read_export):
    cells = ["1" if k < 25 else "" for k in range(ROWS)]
    header = ("timestamp", "command [%]", "T_sup [degC]", "enabled")
    rows = cell_rows(ISO, *(np.linspace(10, 20, ROWS),) * 2, cells)
    assert_refused("enabled", "value", read_export, rows, header, columns={"enabled": "enabled"}, drop=False)
    log = read_export(rows, header, drop=False)
    assert "enabled" not in log.values
    assert any(note.startswith("enabled is left out, it is not needed: enabled = '' in row 27") for note in log.notes)


def test_a_column_is_left_out_by_header_or_name(read_export):
    header = ("timestamp", "command [%]", "T_sup [degC]", "SF Sts")
    rows = cell_rows(ISO, *(np.linspace(10, 20, ROWS),) * 2, ["broken"] * ROWS)
    for name in ("SF Sts", "enabled"):
        assert "enabled" not in read_export(rows, header, drop=False, ignore=[name]).values
    assert_refused("ignore", "name", read_export, rows, header, drop=False, ignore=["SF Stat"])

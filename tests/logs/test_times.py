"""Times as building systems write them, in one column or two."""

from datetime import datetime, timedelta

import numpy as np
import pytest
from helpers.exports import HEADER, ISO, ROWS, START, assert_same_log, cell_rows, format_times, table_text
from helpers.refusals import assert_refused

import fastcoil as fc


@pytest.fixture
def read_times(read_export):
    """Return a function that reads a log with these times."""
    return lambda stamps, **options: read_export(cell_rows([f'"{stamp}"' for stamp in stamps]), **options)


# ------------------------------------------------------------------------------------------------- day and month


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ("%m/%d/%Y %H:%M", "mm/dd/yyyy"),
        ("%d/%m/%y %I:%M %p", "dd/mm/yyyy"),
        ("%d-%m-%Y %H:%M", "dd/mm/yyyy"),
        ("%d.%m.%Y %H:%M", "dd.mm.yyyy"),
        ("%d.%m.%y, %H:%M:%S", "dd.mm.yyyy"),
        ("%Y/%m/%d %H:%M", None),
        ("%b %d, %Y %I:%M:%S\u202f%p", None),
        ("%Y%m%d%H%M%S", None),
        ("%A, %B %d, %Y %I:%M:%S %p", None),
        ("%Y-%m-%dT%H:%M:%S.000-04:00 New_York", None),
        ("%Y-%m-%dT%H:%M-04:00[America/New_York]", None),
    ],
)
@pytest.mark.parametrize("day", [11, 25], ids=["over midnight", "beyond the 12th"])
def test_dates_of_every_country_are_read_and_the_order_is_said(read_times, form, said, day):
    log = read_times(format_times(form, START.replace(day=day)))
    assert_same_log(log)
    orders = [note for note in log.notes if "timestamp read as" in note]
    assert len(orders) == (said is not None)
    if said:
        assert f"timestamp read as {said}" in orders[0]


@pytest.mark.parametrize(("form", "why"), [("%d/%m/%Y %H:%M", "dd/mm/yyyy"), ("%m/%d/%Y %H:%M", "mm/dd/yyyy")])
def test_the_note_says_what_shows_the_order(read_times, form, why):
    stamps = format_times(form, datetime(2024, 7, 12, 23, 30))
    assert f"timestamp read as {why}: a number exceeds 12 in row 32" in read_times(stamps).notes
    early = format_times(form, datetime(2024, 7, 11, 23, 30))
    assert any("in the other order time would jump" in note for note in read_times(early).notes)


def test_within_a_day_the_order_makes_no_difference_and_that_is_said(read_times):
    log = read_times(format_times("%d/%m/%Y %H:%M", datetime(2024, 7, 11, 8)))
    assert_same_log(log)
    assert any("makes no difference" in note for note in log.notes)


def test_an_order_that_nothing_shows_is_refused_with_the_cure_and_read_with_it(read_export, read_times):
    days = [f"{1 + k // 5:02}/{1 + k % 5:02}/2024 08:00" for k in range(ROWS)]  # as even in one order as in the other
    assert_refused("timestamp", "time", read_times, days)
    text = table_text(cell_rows([f"{1 + k:02}/07/2024" for k in range(12)], range(12), range(12)))
    assert_refused("timestamp", "time", read_export, text)
    assert read_export(text, time_format="%d/%m/%Y").time[-1] == 11 * 86400
    assert read_export(text, time_format="%m/%d/%Y").time[-1] == 335 * 86400


def test_both_orders_in_one_log_are_refused_with_their_rows(read_times):
    stamps = format_times("%d/%m/%Y %H:%M", START.replace(day=25))
    stamps[7] = "07/25/2024 23:37"
    assert_refused("timestamp", "time", read_times, stamps)


@pytest.mark.parametrize(
    "cell", ["31/02/2024 08:00", "midnight", "25/07/2024 25:00", "25/07/2024 08:61", "25/07/2024 0:30 PM"]
)
def test_a_cell_that_is_no_time_among_others_is_named(read_times, cell):
    stamps = format_times("%d/%m/%Y %H:%M", START.replace(day=25))
    stamps[7] = cell
    assert_refused("timestamp", "time", read_times, stamps)
    log = read_times(stamps, drop=True)
    assert log.time.size == ROWS - 1
    assert any("1 row left out: timestamp" in note for note in log.notes)


def test_noon_of_twelve_hours(read_times):
    assert_same_log(read_times(format_times("%m/%d/%Y %I:%M %p", datetime(2024, 7, 25, 11, 30))))


# ----------------------------------------------------------------------------------------------- numbers as times


def test_serial_days_of_a_spreadsheet_are_read_to_the_second(read_times):
    since = [(START + timedelta(seconds=60 * k) - datetime(1899, 12, 30)).total_seconds() / 86400 for k in range(ROWS)]
    log = read_times([f"{days:.5f}" for days in since])  # their last digit is 0.9 s
    assert_same_log(log)
    assert any("serial days of a spreadsheet: '45484.97917' is 2024-07-11T23:30:00" in note for note in log.notes)
    assert_same_log(read_times([f"{days:.5f}" for days in since], time_format="excel"))


@pytest.mark.parametrize(("scale", "said"), [(1, "seconds since 1970"), (1000, "milliseconds since 1970")])
def test_seconds_and_milliseconds_since_1970(read_times, scale, said):
    stamps = [str(scale * (int((START - datetime(1970, 1, 1)).total_seconds()) + 60 * k)) for k in range(ROWS)]
    log = read_times(stamps)
    assert_same_log(log)
    assert any(said in note and "2024-07-11T23:30:00" in note for note in log.notes)
    assert_same_log(read_times(stamps, time_format="epoch"))
    # small numbers are no timestamps
    assert_refused("timestamp", "time", read_times, [str(60 * k) for k in range(ROWS)])


# ------------------------------------------------------------------------------------------------------ time zones


@pytest.mark.parametrize(
    ("zone", "ahead"),
    [("UTC", "UTC"), ("CET", "UTC+01:00"), ("PST", "UTC-08:00"), ("MESZ", "UTC+02:00"), ("(CEST)", "UTC+02:00")],
)
def test_one_time_zone_throughout_is_read_and_said(read_times, zone, ahead):
    log = read_times(format_times(f"%d.%m.%Y %H:%M:%S {zone}"))
    assert_same_log(log)
    assert log.notes[-1] == f"timestamp is in {zone.strip('()')}: read by UTC offset"
    assert (log.time_zone, log.start) == (ahead, START)


@pytest.mark.parametrize("ahead", ["+14:30", "-13:00"])
def test_an_offset_that_no_clock_has_is_refused_and_the_last_one_is_read(read_times, ahead):
    assert_refused("time_zone", "choice", read_times, [f"{stamp}{ahead}" for stamp in ISO])
    stamps = [f"{stamp}{ahead}" for stamp in ISO[: ROWS // 2]]
    assert_refused("time_zone", "choice", read_times, [*(f"{stamp}+00:00" for stamp in ISO[ROWS // 2 :]), *stamps])
    assert read_times([f"{stamp}+14:00" for stamp in ISO]).time_zone == "UTC+14:00"


def test_a_zone_of_several_places_stays_a_local_clock(read_times):
    log = read_times(format_times("%d.%m.%Y %H:%M:%S CST"))
    assert_same_log(log)
    assert log.notes[-1:] == ["timestamp is in CST throughout: its times are read as they stand"]
    assert log.time_zone == ""


@pytest.mark.parametrize("zones", [("PDT", "PST"), ("CEST", "CET"), ("BST", "GMT")])
def test_the_summer_and_the_winter_time_of_one_place_are_one_time(read_times, zones):
    stamps = [f"{stamp} {zones[0]}" for stamp in format_times("%Y-%m-%d %H:%M")]
    back = [f"{stamp} {zones[1]}" for stamp in format_times("%Y-%m-%d %H:%M", START - timedelta(hours=1))]
    assert_same_log(read_times(stamps[:20] + back[20:]))
    # times of which some have a zone
    stamps = [f"{stamp}{' PST' if k else ''}" for k, stamp in enumerate(format_times("%d.%m.%Y %H:%M"))]
    assert_refused("timestamp", "time", read_times, stamps)


def test_utc_offsets_that_change_are_one_time(read_times):
    hour_earlier = format_times("%Y-%m-%dT%H:%M:%S", START - timedelta(hours=1))
    stamps = [f"{stamp}-04:00" for stamp in ISO[:20]] + [f"{stamp}-05:00" for stamp in hour_earlier[20:]]
    log = read_times(stamps)
    assert_same_log(log)
    assert any("another UTC offset from row 22 on: read in UTC" in note for note in log.notes)
    assert_refused("timestamp", "time", read_times, [stamps[0], *ISO[1:]])


# --------------------------------------------------------------------------------------- clocks changed, minutes only


def test_rows_out_of_order_are_refused_with_every_cure_and_split_where_asked(read_times):
    stamps = ISO[:40] + format_times("%Y-%m-%dT%H:%M:%S", START - timedelta(hours=1))[40:]
    assert_refused("timestamp", "time", read_times, stamps, jumps="refuse")
    assert read_times(stamps, jumps="split").n_batches == 2


@pytest.mark.parametrize(
    "stamps",
    [[s[:16] for s in format_times("%Y-%m-%dT%H:%M:%S", step=20)], format_times("%d/%m/%Y", START.replace(day=25))],
)
def test_several_rows_at_one_time_are_refused(read_times, stamps):
    assert_refused("timestamp", "time", read_times, stamps)


# ----------------------------------------------------------------------------------------------------- time_format


@pytest.mark.parametrize("form", ["%Y%m%d-%H.%M.%S", "%d %b %Y at %Hh%M", "%H:%M:%S %d/%m/%Y", "%Y-%j %H:%M"])
def test_any_pattern_can_be_given(read_times, form):
    log = read_times(format_times(form), time_format=form)
    assert_same_log(log)
    assert not log.notes


def test_a_time_that_is_not_as_the_pattern_says_is_named(read_times):
    assert_refused("timestamp", "time", read_times, ISO, time_format="%d/%m/%Y")
    assert_refused("timestamp", "time", read_times, ISO, time_format="excel")


@pytest.mark.parametrize("form", ["dd/mm/yyyy", "%Q", "", "%", "%d" * 99, "x%d%"])
def test_a_bad_pattern_is_refused_by_every_reader(write_log, form):
    path = write_log(["timestamp", "command [%]"], [[1, 2], [3, 4]])
    for function in (fc.read_log, fc.Boundary.from_csv):
        assert_refused("time_format", "format", function, path, time_format=form)


def test_a_format_without_timestamps_is_refused(write_log):
    path = write_log(["elapsed_time [s]", "T_sup [degC]", "T_set [degC]"], [[60 * k, 14, 14] for k in range(5)])
    assert_refused("time_format", "conflict", fc.replay, fc.Loop(), fc.read_log(path, time_format="epoch"))


@pytest.mark.kernel
def test_where_a_result_has_no_notes_a_warning_says_how_times_were_read(write_log):
    stamps = format_times("%d/%m/%Y %H:%M", START.replace(day=25))
    path = write_log(["timestamp", "T_sup [degC]", "T_set [degC]"], [[stamp, 14, 14] for stamp in stamps])
    with pytest.warns(UserWarning, match="log.csv: timestamp read as dd/mm/yyyy: a number exceeds 12 in row 2"):
        ds = fc.replay(fc.Loop(), path, trace_interval=600)
    assert ds.sizes["elapsed_time"] == 6
    header = ["timestamp", "m_a [kg/s]", "T_a_in [degC]", "W_a_in [1]", "T_w_in [degC]", "T_set [degC]"]
    with pytest.warns(UserWarning, match="dd/mm/yyyy"):
        day = fc.Boundary.from_csv(write_log(header, [[stamp, 1, 25, 0.01, 7, 14] for stamp in stamps]))
    assert day.n_steps == 60 * (ROWS - 1) + 1
    np.testing.assert_array_equal(day.series["m_a"], 1.0)


@pytest.mark.parametrize(
    ("header", "date", "clock"),
    [
        (("Date", "Time"), "%m/%d/%Y", "%I:%M:%S %p"),
        (("Datum", "Uhrzeit"), "%d.%m.%Y", "%H:%M"),
        (("DATE", "TIME"), "%d-%b-%y", "%H:%M:%S"),
    ],
)
def test_date_and_time_of_day_in_columns_of_their_own_are_one_timestamp(read_export, header, date, clock):
    times = zip(format_times(date), format_times(clock), cell_rows(), strict=True)
    cells = [[day, *row[1:], hour] for day, hour, row in times]
    text = table_text(cells, (header[0], *HEADER[1:], header[1]))
    log = read_export(text)
    assert_same_log(log)
    assert f"{header[0]} and {header[1]} are read as one timestamp" in log.notes
    assert_same_log(read_export(text, columns={"timestamp": header[1]}, time_format=f"{date} {clock}"))

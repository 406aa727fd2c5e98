"""The hour that comes twice in autumn: the order of rows shows which one is meant, or they are refused."""

from datetime import datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from helpers.exports import save_text, table_text
from helpers.refusals import assert_refused, refusal

import fastcoil as fc
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.join import join_points

ZONES = {
    "America/New_York": datetime(2024, 11, 3, 4, 30),
    "Europe/Berlin": datetime(2024, 10, 26, 23, 30),
    "Australia/Lord_Howe": datetime(2024, 4, 6, 14, 0),  # by half an hour
}


def local_rows(zone, step=60):
    """Rows of the local clock for three hours about the change: time, command from 0 to 1."""
    instants = [ZONES[zone] + timedelta(seconds=s) for s in range(0, 10801, step)]
    clock = [instant.replace(tzinfo=ZoneInfo("UTC")).astimezone(ZoneInfo(zone)) for instant in instants]
    return [
        [f"{time:%Y-%m-%d %H:%M:%S}", f"{s:.6f}"] for time, s in zip(clock, np.linspace(0, 1, len(clock)), strict=True)
    ]


def join(tmp_path, rows, **options):
    path = save_text(tmp_path, table_text(rows, ("timestamp", "command [1]")), name="command.csv")
    return join_points([path], columns={}, units={}, **options)[0].splitlines()[1:]


@pytest.mark.parametrize("zone", ZONES)
@pytest.mark.parametrize("step", [60, 900, 1800])
def test_rows_in_their_order_are_read_with_the_hour_that_is_meant(tmp_path, zone, step):
    rows = local_rows(zone, step)
    path = save_text(tmp_path, table_text(rows, ("timestamp", "command [1]")), name="log.csv")
    log = fc.read_log(path, time_zone=zone).read(ColumnSpec(("command",)))
    np.testing.assert_array_equal(log.time, step * np.arange(len(rows)))
    for each in (rows, rows[::-1]):  # the newest first
        lines = join(tmp_path, each, time_zone=zone)
        np.testing.assert_allclose(
            [float(line.split(",")[1]) for line in lines], np.linspace(0, 1, len(rows)), atol=1e-5
        )


@pytest.mark.parametrize("zone", ZONES)
@pytest.mark.parametrize("kind", ["mixed", "once"])
def test_rows_out_of_their_order_are_refused_and_never_to_be_sorted(tmp_path, zone, kind):
    rows = sorted(local_rows(zone))
    rows = list(dict(rows).items()) if kind == "once" else rows
    assert_refused("timestamp", "time", join, tmp_path, rows, time_zone=zone)
    for without_zone in (local_rows(zone), sorted(local_rows(zone))):
        assert "unsorted rows" in refusal(join, tmp_path, without_zone)
        path = save_text(tmp_path, table_text(without_zone, ("timestamp", "command [1]")), name="log.csv")
        assert "unsorted rows" in refusal(fc.read_log(path).read, ColumnSpec(("command",)))


def test_an_hour_that_the_clock_skips_is_refused(tmp_path):
    rows = [[f"2024-03-10 0{k // 60}:{k % 60:02}:00", "0.5"] for k in range(60, 240)]
    assert_refused("timestamp", "time", join, tmp_path, rows, time_zone="America/New_York")
    assert len(join(tmp_path, rows, time_zone="UTC-05:00")) == 180


def test_rows_of_each_value_have_an_order_for_each_point(tmp_path):
    rows = local_rows("America/New_York")
    by_point = [[t, name, v] for name in ("VLV CMD", "SAT") for t, v in rows]
    path = save_text(tmp_path, table_text(by_point, ("time", "point", "value")), name="log.csv")
    units = {"command": "1", "T_sup": "degC"}
    log = fc.read_log(path, time_zone="America/New_York", units=units).read(ColumnSpec(("command", "T_sup")))
    np.testing.assert_array_equal(log.time, 60 * np.arange(181))

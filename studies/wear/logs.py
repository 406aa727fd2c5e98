"""What a year of trend logs shows of a gap that grows or a linkage that comes loose, and what valve tests show of it.

A size is compared with the first that was claimed: an alarm is raised once its interval lies above that of the first.
So a false alarm needs a wrong claim.  The logs are of the plain PI and pooled over four days at a time, each of which
stands for half a month, as all 24 stand for a year.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from joblib import Parallel, delayed

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.measured.diagnose import DIAGNOSIS_COLUMNS, identify_and_measure
from fastcoil.measured.grid import join_grids, keep_own_values, resample_log
from studies.common import progress_printer, share_of, write_table
from studies.days import CONSTANT, STEPPED
from studies.diagnosis.claims import make_log
from studies.remedies.runs import select_loop
from studies.wear.runs import (
    DAYS,
    MONTHLY_STEPS,
    REAL_WEATHER,
    SEED,
    Sequence,
    available_kinds,
    sequence_days,
    sequence_loops,
    target_growths,
    wear_rates,
)

VALVES, FIRST_DAY = 48, 7351
POOLED_DAYS = 4  # days that are read together, and from one valve test to the next
MONTHS_PER_READING = 12 * POOLED_DAYS / DAYS
LOG_INTERVAL, TEST_LOG_INTERVAL = 30, 5
"""Seconds."""
TEST_START = 8 * 3600
SECONDS_BEFORE, SECONDS_AFTER = 3600, 600
"""Seconds of the log of a test before and after it."""
LOGS, TESTS = "logs", "valve test"
LOOSE_READING = DAYS // 3 // POOLED_DAYS
"""First reading after the linkage came loose; it is repaired as many readings later."""
GROWS, LOOSE, NO_GAP = "grows", "comes loose", "no gap"

NO_SAMPLE = "each row reads some hundred logs of 48 valves"


class Readings(NamedTuple):
    """Readings of the valves of a sequence: (way, sample, reading)."""

    low: xr.DataArray
    high: xr.DataArray
    claimed: xr.DataArray
    growth: xr.DataArray
    """(sample,), that was given, fraction of stroke in the year."""


def read_logs(signals: dict[str, np.ndarray], stroke_time: float) -> tuple[float, float, bool]:
    """Read the gap of one valve from trend logs of several days; signals: (day, row)."""
    days = range(signals["command"].shape[0])
    grids = [
        resample_log(
            read_checked_log(
                make_log({name: series[day] for name, series in signals.items()}, float(LOG_INTERVAL)),
                DIAGNOSIS_COLUMNS,
            )
        )[0]
        for day in days
    ]
    identification = identify_and_measure(keep_own_values(join_grids(grids))[0], stroke_time)[0]
    return identification.low, identification.high, identification.identified


def read_test_log(signals: dict[str, np.ndarray], stroke_time: float) -> tuple[float, float, bool]:
    """Read the gap from a valve test; signals: (row,)."""
    if not signals["test"].any():
        return np.nan, np.nan, False
    reading = fc.read_test(make_log(signals, float(TEST_LOG_INTERVAL)), stroke_time=stroke_time)
    return *reading.interval, reading.identified


def simulate_readings(sequence: Sequence, size: int = VALVES) -> Readings:
    """Simulate a year of plain PI with and without tests, and read both."""
    loop, days = sequence_loops(sequence, size), sequence_days(sequence)
    growth = target_growths(loop) * (0.0 if sequence.in_steps or sequence.is_good else 1.0)
    plain = fc.simulate(loop, days, carry_over=True, seed=SEED)
    loop = loop.assign(wear_rate=wear_rates(growth, plain))
    T_set = np.broadcast_to(np.asarray(days.series["T_set"]), (DAYS, days.n_steps))
    stroke_time = np.broadcast_to(xr.DataArray(loop["stroke_time"]).values, size)
    test = fc.ValveTest.gentle(start=TEST_START, every=POOLED_DAYS * days.n_steps / 86400)
    end = TEST_START + 60 * int(test.minutes)
    test_rows = slice((TEST_START - SECONDS_BEFORE) // TEST_LOG_INTERVAL, (end + SECONDS_AFTER) // TEST_LOG_INTERVAL)
    jobs = []
    for k in range(size):
        valve_loop = select_loop(loop, sample=slice(k, k + 1))
        signals = _simulate_signals(valve_loop, days, LOG_INTERVAL) | {"T_set": T_set[:, ::LOG_INTERVAL]}
        for first in range(0, DAYS, POOLED_DAYS):
            days_signals = {name: series[first : first + POOLED_DAYS] for name, series in signals.items()}
            jobs.append(delayed(read_logs)(days_signals, stroke_time[k]))
        test_signals = _simulate_signals(valve_loop, days, TEST_LOG_INTERVAL, test)
        for day in range(0, DAYS, POOLED_DAYS):
            jobs.append(
                delayed(read_test_log)(
                    {name: series[day, test_rows] for name, series in test_signals.items()}, stroke_time[k]
                )
            )
    values = np.array(Parallel(n_jobs=-1)(jobs), dtype=float).reshape(size, 2, DAYS // POOLED_DAYS, 3)
    low, high, is_claimed = (
        xr.DataArray(values[..., k], dims=("sample", "way", "reading")).assign_coords(way=[LOGS, TESTS])
        for k in range(3)
    )
    return Readings(low, high, is_claimed > 0.0, growth.reset_coords(drop=True))


def _simulate_signals(
    loop: fc.Loop, days: fc.Boundary, every: int, test: fc.ValveTest | None = None
) -> dict[str, np.ndarray]:
    names = {"command": "command", "T_measured": "T_sup"} | ({"test": "test"} if test else {})
    ds = fc.simulate(
        loop, days, test=test, carry_over=True, traces=list(names), trace_interval=every, seed=SEED, n_jobs=1
    )
    return {column: ds[name].squeeze("sample").values.astype(float) for name, column in names.items()}


def first_alarms(gap_readings: Readings) -> xr.DataArray:
    """First reading whose interval lies above that of the first claim; inf: none."""
    reading = xr.DataArray(np.arange(gap_readings.low.sizes["reading"], dtype=float), dims="reading")
    first = reading.where(gap_readings.claimed).min("reading")
    high = gap_readings.high.where(reading == first).max("reading")
    return reading.where(gap_readings.claimed & (gap_readings.low > high)).min("reading").fillna(np.inf)


def make_sequences(first: int = FIRST_DAY) -> dict[str, dict[str, Sequence]]:
    """Kind of day → what the gap does → sequence."""
    kinds = [kind for kind in (STEPPED, MONTHLY_STEPS, REAL_WEATHER, CONSTANT) if kind in available_kinds()]
    return {
        kind: {
            gap_course: Sequence(f"{kind}, {gap_course}", kind, False, gap_course == LOOSE, gap_course == NO_GAP, first)
            for gap_course in ((GROWS, LOOSE, NO_GAP) if kind in (STEPPED, MONTHLY_STEPS) else (GROWS,))
        }
        for kind in kinds
    }


HEAD = (
    "days", "reading of", "claims at first", "false alarms, constant gap", "false alarms, no gap",
    "growth by 2 % noticed", "growth by 4 % noticed", "after months, median", "loose linkage noticed", "after months",
)  # fmt: skip


def alarm_row(by_course: dict[str, Readings], reading_way: str) -> list[str]:
    """Cells of a kind of day and a way to read."""
    by_course = {
        gap_course: Readings(*(field.sel(way=reading_way) for field in gap_readings[:3]), gap_readings.growth)
        for gap_course, gap_readings in by_course.items()
    }
    grown = by_course[GROWS]
    alarm_reading, growth_shares = first_alarms(grown), []
    for growth in (0.0, 0.02, 0.04):
        growth_shares.append(_share_among(np.isfinite(alarm_reading), abs(grown.growth - growth) < 1e-9))
    growth_alarms = alarm_reading.where(np.isfinite(alarm_reading) & (grown.growth > 0.015))
    months = f"{MONTHS_PER_READING * float(growth_alarms.median()):.0f}" if bool(growth_alarms.notnull().any()) else "—"
    loose_share, loose_months = "—", "—"
    if LOOSE in by_course:
        alarm_reading = first_alarms(by_course[LOOSE])
        is_noticed = (alarm_reading >= LOOSE_READING) & (alarm_reading < 2 * LOOSE_READING)
        loose_share = _share_among(is_noticed, alarm_reading >= LOOSE_READING)
        if bool(is_noticed.any()):
            loose_months = (
                f"{MONTHS_PER_READING * float((alarm_reading - LOOSE_READING).where(is_noticed).median()):.0f}"
            )
    good_share = "—"
    if NO_GAP in by_course:
        has_alarm = np.isfinite(first_alarms(by_course[NO_GAP]))
        good_share = _share_among(has_alarm, has_alarm.notnull())
    is_claimed_first = grown.claimed.isel(reading=0)
    return [
        _share_among(is_claimed_first, is_claimed_first.notnull()),
        growth_shares[0],
        good_share,
        *growth_shares[1:],
        months,
        loose_share,
        loose_months,
    ]


def _share_among(holds: xr.DataArray, among: xr.DataArray) -> str:
    return f"{share_of(holds & among, among)}"


def main(size: int = VALVES) -> None:
    """Write the table."""
    report, rows = progress_printer(), []
    for kind, courses in make_sequences().items():
        readings_by_course = {}
        for gap_course, sequence in courses.items():
            readings_by_course[gap_course] = simulate_readings(sequence, size)
            report(sequence.name)
        rows += [[kind, way, *alarm_row(readings_by_course, way)] for way in (LOGS, TESTS)]
    write_table(
        "wear/wear_logs",
        f"A year of wear in trend logs of 4 days, and in valve tests every two months: alarms; {size} valves",
        HEAD,
        rows,
    )

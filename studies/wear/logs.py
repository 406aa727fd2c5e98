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
from fastcoil.measured.grid import join_grids, resample_log
from studies.common import progress, share_of, write_table
from studies.days import CONSTANT, STEPPED
from studies.diagnosis.claims import dataset
from studies.remedies.runs import picked
from studies.wear.runs import DAYS, MONTHLY, REAL, SEED, Sequence, days_of, growths, kinds_here, loops_of, rates

VALVES, FIRST_DAY = 48, 7351
POOLED = 4
"""Days that are read together, and from one valve test to the next."""
MONTHS = 12 * POOLED / DAYS
LOGGED, LOGGED_IN_TEST = 30, 5
"""Seconds."""
START = 8 * 3600
BEFORE, AFTER = 3600, 600
"""Seconds of the log of a test before and after it."""
LOGS, TESTS = "logs", "valve test"
LOOSE_AT = DAYS // 3 // POOLED
"""First reading after the linkage came loose; it is repaired as many readings later."""
GROWN, LOOSE, NO_GAP = "grows", "comes loose", "no gap"


class Readings(NamedTuple):
    """Of the valves of a sequence: (way, sample, reading)."""

    low: xr.DataArray
    high: xr.DataArray
    claimed: xr.DataArray
    growth: xr.DataArray
    """(sample,), that was given, fraction of stroke in the year."""


def of_logs(signals: dict[str, np.ndarray], stroke_time: float) -> tuple[float, float, bool]:
    """What trend logs of several days show of one valve; signals: (day, row)."""
    days = range(signals["command"].shape[0])
    grids = [
        resample_log(
            read_checked_log(dataset({name: of[day] for name, of in signals.items()}, float(LOGGED)), DIAGNOSIS_COLUMNS)
        )[0]
        for day in days
    ]
    found = identify_and_measure(join_grids(grids), stroke_time)[0]
    return found.low, found.high, found.identified


def of_test(signals: dict[str, np.ndarray], stroke_time: float) -> tuple[float, float, bool]:
    """What a valve test shows; signals: (row,)."""
    if not signals["test"].any():
        return np.nan, np.nan, False
    found = fc.read_test(dataset(signals, float(LOGGED_IN_TEST)), stroke_time=stroke_time)
    return *found.interval, found.identified


def readings(sequence: Sequence, size: int = VALVES) -> Readings:
    """Simulate a year of plain PI with and without tests, and read both."""
    loop, days = loops_of(sequence, size), days_of(sequence)
    growth = growths(loop) * (0.0 if sequence.in_steps or sequence.is_good else 1.0)
    plain = fc.simulate(loop, days, carry_over=True, seed=SEED)
    loop = loop.assign(wear_rate=rates(growth, plain))
    T_set = np.broadcast_to(np.asarray(days.series["T_set"]), (DAYS, days.n_steps))
    stroke_time = np.broadcast_to(xr.DataArray(loop["stroke_time"]).values, size)
    test = fc.ValveTest.gentle(start=START, every=POOLED * days.n_steps / 86400)
    end = START + 60 * int(test.minutes)
    within = slice((START - BEFORE) // LOGGED_IN_TEST, (end + AFTER) // LOGGED_IN_TEST)
    jobs = []
    for k in range(size):
        one = picked(loop, sample=slice(k, k + 1))
        signals = _simulated(one, days, LOGGED) | {"T_set": T_set[:, ::LOGGED]}
        for first in range(0, DAYS, POOLED):
            pooled = {name: series[first : first + POOLED] for name, series in signals.items()}
            jobs.append(delayed(of_logs)(pooled, stroke_time[k]))
        tested = _simulated(one, days, LOGGED_IN_TEST, test)
        for day in range(0, DAYS, POOLED):
            jobs.append(delayed(of_test)({name: of[day, within] for name, of in tested.items()}, stroke_time[k]))
    found = np.array(Parallel(n_jobs=-1)(jobs), dtype=float).reshape(size, 2, DAYS // POOLED, 3)
    low, high, claimed = (
        xr.DataArray(found[..., k], dims=("sample", "way", "reading")).assign_coords(way=[LOGS, TESTS])
        for k in range(3)
    )
    return Readings(low, high, claimed > 0.0, growth.reset_coords(drop=True))


def _simulated(loop: fc.Loop, days: fc.Boundary, every: int, test: fc.ValveTest | None = None) -> dict[str, np.ndarray]:
    names = {"command": "command", "T_measured": "T_sup"} | ({"test": "test"} if test else {})
    ds = fc.simulate(
        loop, days, test=test, carry_over=True, traces=list(names), trace_interval=every, seed=SEED, n_jobs=1
    )
    return {to: ds[name].squeeze("sample").values.astype(float) for name, to in names.items()}


def alarms(found: Readings) -> xr.DataArray:
    """First reading whose interval lies above that of the first claim; inf: none."""
    reading = xr.DataArray(np.arange(found.low.sizes["reading"], dtype=float), dims="reading")
    first = reading.where(found.claimed).min("reading")
    high = found.high.where(reading == first).max("reading")
    return reading.where(found.claimed & (found.low > high)).min("reading").fillna(np.inf)


def sequences(first: int = FIRST_DAY) -> dict[str, dict[str, Sequence]]:
    """Kind of day → what the gap does → sequence."""
    kinds = [kind for kind in (STEPPED, MONTHLY, REAL, CONSTANT) if kind in kinds_here()]
    return {
        kind: {
            does: Sequence(f"{kind}, {does}", kind, False, does == LOOSE, does == NO_GAP, first)
            for does in ((GROWN, LOOSE, NO_GAP) if kind in (STEPPED, MONTHLY) else (GROWN,))
        }
        for kind in kinds
    }


HEAD = (
    "days", "reading of", "claims at first", "false alarms, constant gap", "false alarms, no gap",
    "growth by 2 % noticed", "growth by 4 % noticed", "after months, median", "loose linkage noticed", "after months",
)  # fmt: skip


def row(of: dict[str, Readings], way: str) -> list[str]:
    """Cells of a kind of day and a way to read."""
    of = {does: Readings(*(each.sel(way=way) for each in found[:3]), found.growth) for does, found in of.items()}
    grown = of[GROWN]
    raised, shown = alarms(grown), []
    for growth in (0.0, 0.02, 0.04):
        shown.append(_share(np.isfinite(raised), abs(grown.growth - growth) < 1e-9))
    late = raised.where(np.isfinite(raised) & (grown.growth > 0.015))
    months = f"{MONTHS * float(late.median()):.0f}" if bool(late.notnull().any()) else "—"
    loose, after = "—", "—"
    if LOOSE in of:
        raised = alarms(of[LOOSE])
        noticed = (raised >= LOOSE_AT) & (raised < 2 * LOOSE_AT)
        loose = _share(noticed, raised >= LOOSE_AT)
        if bool(noticed.any()):
            after = f"{MONTHS * float((raised - LOOSE_AT).where(noticed).median()):.0f}"
    good = "—"
    if NO_GAP in of:
        none = np.isfinite(alarms(of[NO_GAP]))
        good = _share(none, none.notnull())
    at_first = grown.claimed.isel(reading=0)
    return [_share(at_first, at_first.notnull()), shown[0], good, *shown[1:], months, loose, after]


def _share(holds: xr.DataArray, among: xr.DataArray) -> str:
    return f"{share_of(holds & among, among)}"


def main(size: int = VALVES) -> None:
    """Write the table."""
    done, rows = progress(), []
    for kind, does in sequences().items():
        of = {}
        for name, sequence in does.items():
            of[name] = readings(sequence, size)
            done(sequence.name)
        rows += [[kind, way, *row(of, way)] for way in (LOGS, TESTS)]
    write_table(
        "wear/wear_logs",
        f"A year of wear in trend logs of 4 days, and in valve tests every two months: alarms; {size} valves",
        HEAD,
        rows,
    )

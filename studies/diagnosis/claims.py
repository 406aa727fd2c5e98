"""What is claimed of logs that cannot show a gap, and of many ordinary days of one-minute trends taken together.

*Misled*: logs of 6 h with a column that does not belong to the others, or on another clock, or filled in.  Any claim of
one is wrong where the temperature is not that of the valve, and where the log runs backwards.  *Pooled*: days of one
valve.  Thresholds of ``agreement``, ``grid`` and ``identify`` were chosen on valves and days of seeds below 9000.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
import xarray as xr
from joblib import Parallel, delayed

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.measured import identify
from fastcoil.measured.diagnose import DIAGNOSIS_COLUMNS, identify_and_measure
from fastcoil.measured.grid import forward_fill, join_grids, motor_positions, resample_log
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE, Identification
from fastcoil.measured.part import count_reversals
from studies.common import compare_rows, write_table
from studies.days import CONSTANT, STEPPED, of_kind
from studies.diagnosis.diagnosis import SIMULATED, Population, logs, share, valves

SEED = 9547
VALVES, HOURS = 128, 6
LEVELS = 1.5
"""K; the set-points of days that are taken together lie within so much of the middle."""


class Columns(NamedTuple):
    """Columns of one valve on one day, a sample every ``SIMULATED`` s, (n,) each."""

    command: np.ndarray
    T_sup: np.ndarray
    T_set: np.ndarray


def every(own: Columns, _: Columns, draw: np.random.Generator, seconds: int) -> tuple[Columns, float]:
    """The log as it is, a sample every so many seconds."""
    step = seconds // SIMULATED
    return Columns(*(series[::step] for series in own)), float(seconds)


def coarse(own: Columns, _: Columns, draw: np.random.Generator, steps: tuple[int, ...]) -> tuple[Columns, float]:
    """Command and temperature logged at times of their own, joined to the 10 s of the set-point."""
    seconds, clock = draw.choice(steps), np.arange(0, own.T_set.size * SIMULATED, 10)
    held, straight = (np.arange(SIMULATED * draw.integers(seconds // SIMULATED), clock[-1], seconds) for _ in range(2))
    last = np.maximum(np.searchsorted(held, clock, side="right") - 1, 0)
    T = np.interp(clock, straight, own.T_sup[straight // SIMULATED])
    return Columns(own.command[held[last] // SIMULATED], T, own.T_set[::2]), 10.0


def of_another(own: Columns, other: Columns, draw: np.random.Generator, seconds: int) -> tuple[Columns, float]:
    """The temperature of another plant on the same schedule."""
    return every(own._replace(T_sup=other.T_sup), other, draw, seconds)


def backwards(own: Columns, other: Columns, draw: np.random.Generator, seconds: int) -> tuple[Columns, float]:
    """All columns from last to first."""
    return every(Columns(*(series[::-1] for series in own)), other, draw, seconds)


def late(own: Columns, other: Columns, draw: np.random.Generator, seconds: int) -> tuple[Columns, float]:
    """The command logged 30 to 60 s late."""
    shift = int(draw.integers(30 // SIMULATED, 60 // SIMULATED + 1))
    rest = slice(shift, None)
    moved = Columns(own.command[:-shift], own.T_sup[rest], own.T_set[rest])
    return every(moved, other, draw, seconds)


class Case(NamedTuple):
    """A way in which logs mislead, and the kind of their days."""

    made: Callable[..., tuple[Columns, float]]
    given: object
    kind: str = STEPPED
    belongs: bool = True


CASES = {
    "in order, 10 s": Case(every, 10),
    "in order, 30 s": Case(every, 30),
    "in order, 60 s": Case(every, 60),
    "in order, 10 s, steady": Case(every, 10, CONSTANT),
    "every 60 to 300 s, joined to 10 s": Case(coarse, (60, 120, 300)),
    "every 60 s, joined to 10 s": Case(coarse, (60,)),
    "two plants on one schedule, 10 s": Case(of_another, 10, belongs=False),
    "two plants on one schedule, 60 s": Case(of_another, 60, belongs=False),
    "two plants, steady, 10 s": Case(of_another, 10, CONSTANT, belongs=False),
    "backwards, 10 s": Case(backwards, 10, belongs=False),
    "backwards, 60 s": Case(backwards, 60, belongs=False),
    "backwards, steady, 10 s": Case(backwards, 10, CONSTANT, belongs=False),
    "command 30 to 60 s late, 10 s": Case(late, 10),
    "command 30 to 60 s late, 60 s": Case(late, 60),
}


def claimed(columns: Columns, interval: float, stroke_time: float) -> Identification:
    """What ``fc.diagnose`` claims of a log."""
    return identify_and_measure(
        resample_log(read_checked_log(dataset(columns._asdict(), interval), DIAGNOSIS_COLUMNS))[0], stroke_time
    )[0]


def dataset(columns: dict[str, np.ndarray], interval: float) -> xr.Dataset:
    """A log as a Dataset."""
    units = {"command": "1", "test": "1", "m_a": "kg/s"}
    series = {n: ("elapsed_time", values, {"units": units.get(n, "degC")}) for n, values in columns.items()}
    time = np.arange(len(columns["command"])) * interval
    return xr.Dataset(series, {"elapsed_time": ("elapsed_time", time, {"units": "s"})})


def is_right(found: Identification, backlash: float) -> bool:
    """To 20 % of the gap or 1 % of the stroke."""
    return abs(found.backlash - backlash) <= max(SIZE_TOLERANCE * backlash, GOOD_BACKLASH) + 1e-9


def misled() -> list[list[str]]:
    """Claims of each case, the largest share of wrong ones first."""
    simulated = {
        kind: logs(Population(kind), [SEED, k], [10 * SEED + 2 * k, 10 * SEED + 2 * k + 1], VALVES)
        for k, kind in enumerate((STEPPED, CONSTANT))
    }
    rows = []
    for name, case in CASES.items():
        of, draw = simulated[case.kind], np.random.default_rng(SEED)
        end = HOURS * 3600 // SIMULATED
        T_set = of.signals["T_set"][:, 0, :end]
        claims, wrong = (xr.DataArray(np.zeros((len(T_set), VALVES), bool), dims=("day", "sample")) for _ in range(2))
        for day in range(len(T_set)):
            for valve in range(VALVES):
                own, other = (
                    Columns(of.signals["command"][day, v, :end], of.signals["T_measured"][day, v, :end], T_set[day])
                    for v in (valve, (valve + 1) % VALVES)
                )
                columns, interval = case.made(own, other, draw, case.given)
                found = claimed(columns, interval, float(of.stroke_time[valve]))
                claims[day, valve] = found.identified
                wrong[day, valve] = found.identified and not (case.belongs and is_right(found, of.backlash[valve]))
        print(f"{name}: done", flush=True)
        counted = f"{int(wrong.sum())} of {int(claims.sum())}"
        rows.append((float(wrong.mean()), [name, share(claims), counted, share(wrong)]))
    return [cells for _, cells in sorted(rows, key=lambda row: -row[0])]


class Pool(NamedTuple):
    """Days that are taken together: how many, a sample every so many seconds, one with steps every so many days."""

    days: int
    seconds: int
    steps_every: int
    inputs: tuple[str, ...]
    valves: int

    @property
    def cells(self) -> list[str]:
        """First cells of its row."""
        days = f"{self.days}, every third with steps" if self.steps_every else f"{self.days}, steady"
        return [days, f"{self.seconds} s", "with air flow and T_in" if self.inputs else "command, T_sup, T_set"]


AIR = ("m_a", "T_a_in")
POOLS = [
    Pool(days, seconds, steps_every, inputs, n)
    for days, seconds, n in ((10, 60, 240), (6, 10, 120), (30, 60, 120), (10, 300, 120), (30, 300, 120))
    for steps_every in (0, 3)
    for inputs in ((), AIR)
]


def days_of_valves(pool: Pool) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Parameters of the valves, an eighth of them good, and their signals, (days, valves or one, n)."""
    draw = np.random.default_rng([SEED, 3])
    drawn = valves(Population(CONSTANT), [SEED, 4], pool.valves)
    worn = np.where(drawn["backlash"] > 0.0, drawn["backlash"], draw.uniform(0.005, 0.15, pool.valves))
    drawn["backlash"] = np.where(np.arange(pool.valves) % 8 == 0, 0.0, worn)
    seeds = [10 * SEED + 100 + day for day in range(pool.days)]
    days = of_kind(CONSTANT, seeds)
    T_set = days.series["T_set"] + draw.uniform(-LEVELS, LEVELS, (pool.days, 1))
    if pool.steps_every:
        T_set[:: pool.steps_every] = of_kind(STEPPED, seeds).series["T_set"][:: pool.steps_every]
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, **{name: ("sample", values) for name, values in drawn.items()})
    ds = fc.simulate(
        loop,
        days.assign(T_set=T_set),
        traces=["command", "T_measured"],
        trace_interval=pool.seconds,
        seed=SEED,
        n_jobs=1,
    )
    signals = {
        name: ds[trace].transpose("day", "sample", "elapsed_time").values.astype(float)
        for name, trace in (("command", "command"), ("T_sup", "T_measured"))
    }
    inputs = {"T_set": T_set} | {name: np.asarray(days.series[name]) for name in pool.inputs}
    return drawn, signals | {name: values[:, np.newaxis, :: pool.seconds] for name, values in inputs.items()}


def of_days(pool: Pool, signals: dict[str, np.ndarray], valve: int, stroke_time: float) -> Identification:
    """What ``fc.diagnose`` claims of all days of a valve."""
    days = [
        {name: series[day, valve if series.shape[1] > 1 else 0] for name, series in signals.items()}
        for day in range(pool.days)
    ]
    grids = [resample_log(read_checked_log(dataset(day, float(pool.seconds)), DIAGNOSIS_COLUMNS))[0] for day in days]
    return identify_and_measure(join_grids(grids), stroke_time)[0]


def pooled(pool: Pool) -> list[str]:
    """Row of a pool; the interval that the tool refuses is let pass."""
    drawn, signals = days_of_valves(pool)
    sizes = drawn["backlash"]
    with patch.object(identify, "LONGEST_INTERVAL", max(identify.LONGEST_INTERVAL, pool.seconds)):
        found = [of_days(pool, signals, v, float(drawn["stroke_time"][v])) for v in range(pool.valves)]

    def each(flags: Iterable[object]) -> xr.DataArray:
        return xr.DataArray([bool(one) for one in flags], dims="sample")

    claims, right = each(one.identified for one in found), each(map(is_right, found, sizes))
    covers = each(one.low <= size <= one.high for one, size in zip(found, sizes, strict=True))
    accused = claims & each(one.backlash > GOOD_BACKLASH + 1e-9 for one in found) & (sizes == 0.0)
    print(", ".join(pool.cells), "done", flush=True)
    return [
        *pool.cells, share(claims), f"{int((claims & ~right).sum())} of {int(claims.sum())}", share(right, claims),
        share(covers, claims), f"{int(accused.sum())} of {int((sizes == 0.0).sum())}",
    ]  # fmt: skip


TURNS = (0, 1, 10, 100, 1000, 10**9)
"""Turns of the motor by more than the gap, in all days: groups from one to below the next."""


def by_turns(pool: Pool) -> list[list[str]]:
    """What is claimed of worn valves, by how often the motor turns by more than the gap."""
    drawn, signals = days_of_valves(pool)
    worn = np.flatnonzero(drawn["backlash"] > 0.0)
    counted, claims = np.zeros(worn.size), np.zeros(worn.size, bool)
    for k, v in enumerate(worn):
        stroke_time, gap = float(drawn["stroke_time"][v]), float(drawn["backlash"][v])
        days = [
            motor_positions(forward_fill(command), pool.seconds, stroke_time) for command in signals["command"][:, v]
        ]
        counted[k] = sum(count_reversals(positions, gap) for positions in days)
        claims[k] = of_days(pool, signals, int(v), stroke_time).identified
    groups = [(counted >= low) & (counted < high) for low, high in pairwise(TURNS)]
    names = ["none", *(f"{low} to {high - 1}" for low, high in pairwise(TURNS[1:-1])), f"{TURNS[-2]} or more"]
    of_valve = xr.DataArray(claims, dims="sample")
    return [
        [name, str(int(group.sum())), share(of_valve, xr.DataArray(group, dims="sample"))]
        for name, group in zip(names, groups, strict=True)
        if group.any()
    ]


def sample() -> None:
    """Six steady days of each valve."""
    compare_rows("diagnosis/claims_pooled", [pooled(POOLS[4])])


def main() -> None:
    """Measure both and write the tables."""
    title = f"Logs of {HOURS} h that mislead, and logs in order: {VALVES} valves × 2 days each"
    head = ["log", "claimed", "wrong claims", "wrong, of all logs"]
    write_table("diagnosis/claims_misled", title, head, misled())
    title = (
        f"Days of 8 h taken together: {POOLS[0].valves} valves in the first four rows, {POOLS[4].valves} in the others"
    )
    head = ["days", "logged every", "columns", "claimed", "wrong claims", "right of claimed",
            "interval of claimed covers", "good valves accused"]  # fmt: skip
    write_table("diagnosis/claims_pooled", title, head, Parallel(n_jobs=-1)(delayed(pooled)(pool) for pool in POOLS))
    title = (
        f"{POOLS[1].days} steady days of 8 h, logged every {POOLS[1].seconds} s, with air flow and T_in: worn valves"
    )
    head = ["reversals by more than the gap", "valves", "claimed"]
    write_table("diagnosis/claims_turns", title, head, by_turns(POOLS[1]))

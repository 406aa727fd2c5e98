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
from fastcoil.measured.grid import forward_fill, join_grids, keep_own_values, motor_positions, resample_log
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE, Identification
from fastcoil.measured.part import count_reversals
from studies.common import compare_rows, write_table
from studies.days import CONSTANT, STEPPED, make_days
from studies.diagnosis.diagnosis import TRACE_INTERVAL, Population, share_or_none, simulate_logs, valves

SEED = 9547
VALVES, HOURS = 128, 6
SET_POINT_SPREAD_K = 1.5  # K; the set-points of days that are taken together lie within so much of the middle


class Columns(NamedTuple):
    """Columns of one valve on one day, a sample every ``TRACE_INTERVAL`` s, (n,) each."""

    command: np.ndarray
    T_sup: np.ndarray
    T_set: np.ndarray


def resample_columns(columns: Columns, _: Columns, rng: np.random.Generator, seconds: int) -> tuple[Columns, float]:
    """Resample the log, unchanged otherwise."""
    stride = seconds // TRACE_INTERVAL
    return Columns(*(series[::stride] for series in columns)), float(seconds)


def join_coarse_columns(
    columns: Columns, _: Columns, rng: np.random.Generator, steps: tuple[int, ...]
) -> tuple[Columns, float]:
    """Log command and temperature at separate times, and join them to the 10-s grid of the set-point."""
    seconds, clock = rng.choice(steps), np.arange(0, columns.T_set.size * TRACE_INTERVAL, 10)
    command_times, temperature_times = (
        np.arange(TRACE_INTERVAL * rng.integers(seconds // TRACE_INTERVAL), clock[-1], seconds) for _ in range(2)
    )
    last_command = np.maximum(np.searchsorted(command_times, clock, side="right") - 1, 0)
    T = np.interp(clock, temperature_times, columns.T_sup[temperature_times // TRACE_INTERVAL])
    return Columns(columns.command[command_times[last_command] // TRACE_INTERVAL], T, columns.T_set[::2]), 10.0


def with_other_temperature(
    columns: Columns, other_columns: Columns, rng: np.random.Generator, seconds: int
) -> tuple[Columns, float]:
    """Replace the temperature by that of another plant on the same schedule."""
    return resample_columns(columns._replace(T_sup=other_columns.T_sup), other_columns, rng, seconds)


def reverse_columns(
    columns: Columns, other_columns: Columns, rng: np.random.Generator, seconds: int
) -> tuple[Columns, float]:
    """Reverse all columns in time."""
    return resample_columns(Columns(*(series[::-1] for series in columns)), other_columns, rng, seconds)


def delay_command(
    columns: Columns, other_columns: Columns, rng: np.random.Generator, seconds: int
) -> tuple[Columns, float]:
    """Delay the command by 30 to 60 s."""
    shift = int(rng.integers(30 // TRACE_INTERVAL, 60 // TRACE_INTERVAL + 1))
    from_shift = slice(shift, None)
    shifted = Columns(columns.command[:-shift], columns.T_sup[from_shift], columns.T_set[from_shift])
    return resample_columns(shifted, other_columns, rng, seconds)


class Case(NamedTuple):
    """A way in which logs mislead, and the kind of their days."""

    make_columns: Callable[..., tuple[Columns, float]]
    argument: object
    kind: str = STEPPED
    is_consistent: bool = True


CASES = {
    "in order, 10 s": Case(resample_columns, 10),
    "in order, 30 s": Case(resample_columns, 30),
    "in order, 60 s": Case(resample_columns, 60),
    "in order, 10 s, steady": Case(resample_columns, 10, CONSTANT),
    "every 60 to 300 s, joined to 10 s": Case(join_coarse_columns, (60, 120, 300)),
    "every 60 s, joined to 10 s": Case(join_coarse_columns, (60,)),
    "two plants on one schedule, 10 s": Case(with_other_temperature, 10, is_consistent=False),
    "two plants on one schedule, 60 s": Case(with_other_temperature, 60, is_consistent=False),
    "two plants, steady, 10 s": Case(with_other_temperature, 10, CONSTANT, is_consistent=False),
    "backwards, 10 s": Case(reverse_columns, 10, is_consistent=False),
    "backwards, 60 s": Case(reverse_columns, 60, is_consistent=False),
    "backwards, steady, 10 s": Case(reverse_columns, 10, CONSTANT, is_consistent=False),
    "command 30 to 60 s late, 10 s": Case(delay_command, 10),
    "command 30 to 60 s late, 60 s": Case(delay_command, 60),
}


def identify_gap(columns: Columns, interval: float, stroke_time: float) -> Identification:
    """Return the identification that ``fc.diagnose`` makes of a log."""
    grid, _ = resample_log(read_checked_log(make_log(columns._asdict(), interval), DIAGNOSIS_COLUMNS))
    return identify_and_measure(keep_own_values(grid)[0], stroke_time)[0]


def make_log(columns: dict[str, np.ndarray], interval: float) -> xr.Dataset:
    """Make a log, as a Dataset."""
    units = {"command": "1", "test": "1", "m_a": "kg/s"}
    series = {n: ("elapsed_time", values, {"units": units.get(n, "degC")}) for n, values in columns.items()}
    time = np.arange(len(columns["command"])) * interval
    return xr.Dataset(series, {"elapsed_time": ("elapsed_time", time, {"units": "s"})})


def is_right(identification: Identification, backlash: float) -> bool:
    """Return whether the size is right, to 20 % of the gap or 1 % of the stroke."""
    return abs(identification.backlash - backlash) <= max(SIZE_TOLERANCE * backlash, GOOD_BACKLASH) + 1e-9


def misleading_rows() -> list[list[str]]:
    """Claims of each case, the largest share of wrong ones first."""
    logs_by_kind = {
        kind: simulate_logs(Population(kind), [SEED, k], [10 * SEED + 2 * k, 10 * SEED + 2 * k + 1], VALVES)
        for k, kind in enumerate((STEPPED, CONSTANT))
    }
    rows = []
    for name, case in CASES.items():
        kind_logs, rng = logs_by_kind[case.kind], np.random.default_rng(SEED)
        end = HOURS * 3600 // TRACE_INTERVAL
        T_set = kind_logs.signals["T_set"][:, 0, :end]
        claims, is_wrong = (
            xr.DataArray(np.zeros((len(T_set), VALVES), bool), dims=("day", "sample")) for _ in range(2)
        )
        for day in range(len(T_set)):
            for valve in range(VALVES):
                own_columns, other_columns = (
                    Columns(
                        kind_logs.signals["command"][day, v, :end],
                        kind_logs.signals["T_measured"][day, v, :end],
                        T_set[day],
                    )
                    for v in (valve, (valve + 1) % VALVES)
                )
                columns, interval = case.make_columns(own_columns, other_columns, rng, case.argument)
                identification = identify_gap(columns, interval, float(kind_logs.stroke_time[valve]))
                claims[day, valve] = identification.identified
                is_wrong[day, valve] = identification.identified and not (
                    case.is_consistent and is_right(identification, kind_logs.backlash[valve])
                )
        print(f"{name}: done", flush=True)
        count_text = f"{int(is_wrong.sum())} of {int(claims.sum())}"
        rows.append((float(is_wrong.mean()), [name, share_or_none(claims), count_text, share_or_none(is_wrong)]))
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


AIR_COLUMNS = ("m_a", "T_a_in")
POOLS = [
    Pool(days, seconds, steps_every, inputs, n)
    for days, seconds, n in ((10, 60, 240), (6, 10, 120), (30, 60, 120), (10, 300, 120), (30, 300, 120))
    for steps_every in (0, 3)
    for inputs in ((), AIR_COLUMNS)
]


def simulate_pool(pool: Pool) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Parameters of the valves, an eighth of them good, and their signals, (days, valves or one, n)."""
    rng = np.random.default_rng([SEED, 3])
    parameters = valves(Population(CONSTANT), [SEED, 4], pool.valves)
    worn_backlash = np.where(
        parameters["backlash"] > 0.0, parameters["backlash"], rng.uniform(0.005, 0.15, pool.valves)
    )
    parameters["backlash"] = np.where(np.arange(pool.valves) % 8 == 0, 0.0, worn_backlash)
    seeds = [10 * SEED + 100 + day for day in range(pool.days)]
    days = make_days(CONSTANT, seeds)
    T_set = days.series["T_set"] + rng.uniform(-SET_POINT_SPREAD_K, SET_POINT_SPREAD_K, (pool.days, 1))
    if pool.steps_every:
        T_set[:: pool.steps_every] = make_days(STEPPED, seeds).series["T_set"][:: pool.steps_every]
    loop = fc.Loop.preset("lbnl").assign(
        m_full=1.7, **{name: ("sample", values) for name, values in parameters.items()}
    )
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
    return parameters, signals | {name: values[:, np.newaxis, :: pool.seconds] for name, values in inputs.items()}


def identify_from_days(pool: Pool, signals: dict[str, np.ndarray], valve: int, stroke_time: float) -> Identification:
    """What ``fc.diagnose`` claims of all days of a valve."""
    days = [
        {name: series[day, valve if series.shape[1] > 1 else 0] for name, series in signals.items()}
        for day in range(pool.days)
    ]
    grids = [resample_log(read_checked_log(make_log(day, float(pool.seconds)), DIAGNOSIS_COLUMNS))[0] for day in days]
    return identify_and_measure(keep_own_values(join_grids(grids))[0], stroke_time)[0]


def pool_row(pool: Pool) -> list[str]:
    """Row of a pool; intervals that ``identify`` would refuse are accepted."""
    parameters, signals = simulate_pool(pool)
    sizes = parameters["backlash"]
    with patch.object(identify, "LONGEST_INTERVAL", max(identify.LONGEST_INTERVAL, pool.seconds)):
        identifications = [
            identify_from_days(pool, signals, v, float(parameters["stroke_time"][v])) for v in range(pool.valves)
        ]

    def along_sample(flags: Iterable[object]) -> xr.DataArray:
        return xr.DataArray([bool(flag) for flag in flags], dims="sample")

    claims, right = (
        along_sample(identification.identified for identification in identifications),
        along_sample(map(is_right, identifications, sizes)),
    )
    is_covered = along_sample(
        identification.low <= size <= identification.high
        for identification, size in zip(identifications, sizes, strict=True)
    )
    is_accused = (
        claims
        & along_sample(identification.backlash > GOOD_BACKLASH + 1e-9 for identification in identifications)
        & (sizes == 0.0)
    )
    print(", ".join(pool.cells), "done", flush=True)
    return [
        *pool.cells, share_or_none(claims), f"{int((claims & ~right).sum())} of {int(claims.sum())}",
        share_or_none(right, claims),
        share_or_none(is_covered, claims), f"{int(is_accused.sum())} of {int((sizes == 0.0).sum())}",
    ]  # fmt: skip


TURN_EDGES = (0, 1, 10, 100, 1000, 10**9)
"""Turns of the motor by more than the gap, in all days: groups from one to below the next."""


def rows_by_turns(pool: Pool) -> list[list[str]]:
    """Rows of the claims for worn valves, by how often the motor turns by more than the gap."""
    parameters, signals = simulate_pool(pool)
    worn_valves = np.flatnonzero(parameters["backlash"] > 0.0)
    turn_counts, claims = np.zeros(worn_valves.size), np.zeros(worn_valves.size, bool)
    for k, v in enumerate(worn_valves):
        stroke_time, gap = float(parameters["stroke_time"][v]), float(parameters["backlash"][v])
        days = [
            motor_positions(forward_fill(command), pool.seconds, stroke_time) for command in signals["command"][:, v]
        ]
        turn_counts[k] = sum(count_reversals(positions, gap) for positions in days)
        claims[k] = identify_from_days(pool, signals, int(v), stroke_time).identified
    groups = [(turn_counts >= low) & (turn_counts < high) for low, high in pairwise(TURN_EDGES)]
    names = ["none", *(f"{low} to {high - 1}" for low, high in pairwise(TURN_EDGES[1:-1])), f"{TURN_EDGES[-2]} or more"]
    is_claimed = xr.DataArray(claims, dims="sample")
    return [
        [name, str(int(group.sum())), share_or_none(is_claimed, xr.DataArray(group, dims="sample"))]
        for name, group in zip(names, groups, strict=True)
        if group.any()
    ]


def sample() -> None:
    """Compare the row of six steady days of each valve."""
    compare_rows("diagnosis/claims_pooled", [pool_row(POOLS[4])])


def main() -> None:
    """Measure both and write the tables."""
    title = f"Logs of {HOURS} h that mislead, and logs in order: {VALVES} valves × 2 days each"
    head = ["log", "claimed", "wrong claims", "wrong, of all logs"]
    write_table("diagnosis/claims_misled", title, head, misleading_rows())
    title = (
        f"Days of 8 h taken together: {POOLS[0].valves} valves in the first four rows, {POOLS[4].valves} in the others"
    )
    head = ["days", "logged every", "columns", "claimed", "wrong claims", "right of claimed",
            "interval of claimed covers", "good valves accused"]  # fmt: skip
    write_table("diagnosis/claims_pooled", title, head, Parallel(n_jobs=-1)(delayed(pool_row)(pool) for pool in POOLS))
    title = (
        f"{POOLS[1].days} steady days of 8 h, logged every {POOLS[1].seconds} s, with air flow and T_in: worn valves"
    )
    head = ["reversals by more than the gap", "valves", "claimed"]
    write_table("diagnosis/claims_turns", title, head, rows_by_turns(POOLS[1]))

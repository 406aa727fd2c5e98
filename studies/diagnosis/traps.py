"""What is claimed of polled points, of days on another clock, and of swings from outside.

*Polled*: a gateway polls points every 30 to 300 s and repeats them in rows of 5 to 60 s.  *Late*: ten days whose
temperature is logged minutes late.  *Swings*: air or water that enters swings nearly squarely every 5 to 18 min.  The
thresholds of ``fastcoil.logs.own_values`` and ``fastcoil.measured`` were chosen on valves and days of seeds below 9000.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.measured.diagnose import DIAGNOSIS_COLUMNS, identify_and_measure
from fastcoil.measured.grid import join_grids, keep_own_values, resample_log
from fastcoil.measured.identify import GOOD_BACKLASH, Identification
from studies.common import compare_rows, draw_loguniform, write_table
from studies.days import STEPPED, make_days
from studies.diagnosis.claims import is_right, make_log
from studies.diagnosis.diagnosis import TRACE_INTERVAL, Population, share_or_none, valves

SEED = 9677
POLLED_VALVES, LATE_VALVES, SWING_VALVES, DAYS = 128, 16, 200, 10
SLOW = "slow set-point"
POINTS = ("command", "T_sup", "T_set")
ROW_SECONDS = (5, 10, 15, 30, 60)
POLL_SECONDS = (30.0, 300.0)  # from and to
LATE_MINUTES = (0, 2, 5, 10)
SWINGS = {"entering air": ("T_a_in", 1.0, 0.0), "entering water": ("T_w_in", 1.0, 0.0), "air flow": ("m_a", 0.0, 0.06)}
"""Series that swings, by how much for a swing of 1: in its unit, and as a share of itself."""

Signals = dict[str, np.ndarray]  # (days, valves or one, n), a sample every ``TRACE_INTERVAL`` s


def simulate_days(
    kind: str, n_valves: int, n_days: int, *, worn_only: bool, swing: str = ""
) -> tuple[Signals, Signals]:
    """Parameters of valves and their signals on days with steps or a slow set-point; ``swing``: of ``SWINGS``."""
    rng = np.random.default_rng([SEED, n_valves, kind == SLOW])
    parameters = valves(Population(), [SEED, n_valves], n_valves)
    sizes = rng.uniform(0.005, 0.15, n_valves)
    parameters["backlash"] = np.where(~worn_only & (np.arange(n_valves) % 4 == 0), 0.0, sizes)
    if swing:
        parameters["backlash"] = np.zeros(n_valves)
    days = make_days(STEPPED, [10 * SEED + day for day in range(n_days)])
    series = {n: np.array(days.series[n], float) for n in ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")}
    seconds = np.arange(series["T_set"].shape[1])
    if kind == SLOW:
        walk = 13.5 + 0.15 * np.cumsum(rng.normal(0.0, 1.0, (n_days, seconds.size // 300 + 1)), axis=1)
        series["T_set"] = np.repeat(walk, 300, axis=1)[:, : seconds.size]
    for day in range(n_days) if swing else ():
        name, absolute, relative = SWINGS[swing]
        sine = np.sin(2.0 * np.pi * (seconds / rng.uniform(300.0, 1080.0) + rng.uniform()))
        square = rng.uniform(0.5, 2.0) * np.tanh(4.0 * sine)
        series[name][day] += square * (absolute + relative * series[name][day])
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, **{name: ("sample", x) for name, x in parameters.items()})
    boundary = fc.Boundary(**series, day=list(range(n_days)))
    traces = ["command", "T_measured"]
    ds = fc.simulate(loop, boundary, traces=traces, trace_interval=TRACE_INTERVAL, seed=SEED, n_jobs=1)
    signals = {
        name: ds[trace].transpose("day", "sample", "elapsed_time").values.astype(float)
        for name, trace in zip(("command", "T_sup"), traces, strict=True)
    }
    return parameters, signals | {"T_set": series["T_set"][:, np.newaxis, ::TRACE_INTERVAL]}


def day_columns(signals: Signals, day: int, valve: int) -> Signals:
    """Columns of one valve on one day, (n,)."""
    return {name: x[day, valve if x.shape[1] > 1 else 0] for name, x in signals.items()}


def poll_columns(columns: Signals, row: int, steps: Signals, phases: Signals, rng: np.random.Generator) -> Signals:
    """Rows of a log: of each point the value of its last poll, which comes up to 5 % early or late."""
    rows, polled = np.arange(0.0, columns["T_set"].size * TRACE_INTERVAL, row), {}
    for name, series in columns.items():
        times = np.arange((phases[name] - 1.0) * steps[name], rows[-1], steps[name])
        times = np.sort(times + 0.05 * steps[name] * rng.uniform(-1.0, 1.0, times.size))
        last = np.maximum(times[np.maximum(np.searchsorted(times, rows, side="right") - 1, 0)], 0.0)
        polled[name] = series[(last // TRACE_INTERVAL).astype(int)]
    return polled


def identify_days(days: Iterable[Signals], row: int, stroke_time: float) -> Identification:
    """What ``fc.diagnose`` claims of days with a row every ``row`` s."""
    grids = [resample_log(read_checked_log(make_log(day, float(row)), DIAGNOSIS_COLUMNS))[0] for day in days]
    return identify_and_measure(keep_own_values(join_grids(grids))[0], stroke_time)[0]


def polled_claims(kind: str, n_days: int) -> Iterator[tuple[Identification, float]]:
    """Claims of polled logs with the true gap: all points polled together, or each at its own times."""
    parameters, signals = simulate_days(kind, POLLED_VALVES, n_days, worn_only=False)
    for valve in range(POLLED_VALVES):
        rng = np.random.default_rng([SEED, valve, n_days, kind == SLOW])
        row, is_together = int(rng.choice(ROW_SECONDS)), rng.uniform() < 0.5
        steps = dict(zip(POINTS, draw_loguniform(rng, *POLL_SECONDS, 3), strict=True))
        phases = dict(zip(POINTS, rng.uniform(0.0, 1.0, 3), strict=True))
        if is_together:
            steps, phases = dict.fromkeys(POINTS, round(steps["T_sup"])), dict.fromkeys(POINTS, phases["T_sup"])
        days = (poll_columns(day_columns(signals, d, valve), row, steps, phases, rng) for d in range(n_days))
        yield identify_days(days, row, float(parameters["stroke_time"][valve])), float(parameters["backlash"][valve])


def late_claims(kind: str, minutes: int) -> Iterator[tuple[Identification, float]]:
    """Claims of ten days in rows of 60 s, their temperature late."""
    parameters, signals = simulate_days(kind, LATE_VALVES, DAYS, worn_only=False)
    for valve in range(LATE_VALVES):
        days = []
        for day in range(DAYS):
            columns = {name: x[:: 60 // TRACE_INTERVAL] for name, x in day_columns(signals, day, valve).items()}
            n = columns["T_set"].size - minutes
            days.append({name: x[:n] if name == "T_sup" else x[-n:] for name, x in columns.items()})
        yield identify_days(days, 60, float(parameters["stroke_time"][valve])), float(parameters["backlash"][valve])


def swing_claims(swing: str) -> Iterator[tuple[Identification, float]]:
    """Claims of days with steps: of good valves under a swing from outside, or of worn valves without one."""
    n_days = 8
    parameters, signals = simulate_days(STEPPED, SWING_VALVES, n_days, worn_only=not swing, swing=swing)
    for valve in range(SWING_VALVES):
        row = (10, 30, 60)[valve % 3]
        columns = {n: x[:: row // TRACE_INTERVAL] for n, x in day_columns(signals, valve % n_days, valve).items()}
        yield (
            identify_days([columns], row, float(parameters["stroke_time"][valve])),
            float(parameters["backlash"][valve]),
        )


def trap_row(name: str, claims: Iterable[tuple[Identification, float]]) -> list[str]:
    """Row of a trap: claims, wrong ones, and good valves that are accused."""
    results = list(claims)
    identified = np.array([claim.identified for claim, _ in results])
    is_wrong = np.array([claim.identified and not is_right(claim, size) for claim, size in results])
    is_good = np.array([size == 0.0 for _, size in results])
    is_accused = identified & is_good & (np.array([claim.backlash for claim, _ in results]) > GOOD_BACKLASH + 1e-9)
    print(name, "done", flush=True)
    shares = (share_or_none(xr.DataArray(mask, dims="sample")) for mask in (identified, is_wrong))
    claimed, wrong = shares
    accused = f"{is_accused.sum()} of {is_good.sum()}"
    return [name, str(len(results)), claimed, f"{is_wrong.sum()} of {identified.sum()}", wrong, accused]


def sample() -> None:
    """Run a sample of the study: days with steps whose temperature is 10 min late."""
    claims = late_claims(STEPPED, LATE_MINUTES[-1])
    row = trap_row(f"ten days, set-point steps, {LATE_MINUTES[-1]} min late", claims)
    compare_rows("diagnosis/claims_traps", [row])


def main() -> None:
    """Measure all traps and write the table."""
    rows = []
    for kind in (STEPPED, SLOW):
        day = "set-point steps" if kind == STEPPED else SLOW
        for n_days in (1, 4):
            rows.append(trap_row(f"polled, {day}, days: {n_days}", polled_claims(kind, n_days)))
        for minutes in LATE_MINUTES:
            rows.append(trap_row(f"ten days, {day}, {minutes} min late", late_claims(kind, minutes)))
    rows += [trap_row(f"good valves, {swing} swings", swing_claims(swing)) for swing in SWINGS]
    rows.append(trap_row("worn valves with steps, no swing", swing_claims("")))
    head = ["logs", "number", "claimed", "wrong claims", "wrong, of all logs", "good valves accused"]
    write_table("diagnosis/claims_traps", "Polled points, late days, swings from outside", head, rows)

"""How well any reading could tell the gap from a valve test, and how near ``read_test`` comes: the Cramér–Rao bound.

The temperature of a test is the response to its command plus drift and noise.  What the response would change by, if
the gap, the gain or the lag of the coil were a little larger, comes from simulations with the same command; drift and
noise from one in which the command stands still.  Their changes are whitened by the ARIMA(1,1,1) that leaves the least.
The bound is the standard deviation of the best unbiased estimate of the gap where gain, lag and level are unknown.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed
from scipy.signal import lfilter

import fastcoil as fc
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE
from fastcoil.measured.read_test import AR, MA
from studies.common import compare_rows, write_table
from studies.days import of_kind, settings
from studies.diagnosis.diagnosis import valves
from studies.valve_test.valve_test import ASKED, HOURS, LOGGED, SEQUENCES, START, Case, log_of, read, simulated

SEED, VALVES, DAYS = 9671, 64, 8
EVERY, AFTER = 10, 600
"""Seconds between the temperatures that count, and after the test in which they do."""
CALMS_DOWN = 1800
"""Seconds for which the command stands still before drift and noise are taken."""
MEDIAN_OF_NORMAL = 0.674
"""Median size of a normal number, in standard deviations."""
SMALL = {"backlash": 0.002, "m_full": 0.02, "C_c": 0.05}
"""Change of the gap, fraction of stroke, and relative changes of gain and lag."""


class Bounded(NamedTuple):
    """Of each worn valve: gap, bound and error of the reading, fractions of stroke; excursion, K."""

    gap: np.ndarray
    bound: np.ndarray
    error: np.ndarray
    excursion: np.ndarray


def whitened(series: np.ndarray, ar: float, ma: float) -> np.ndarray:
    """Innovations of an ARIMA(1,1,1)."""
    return np.asarray(lfilter(np.convolve([1.0, -1.0], [1.0, -ar]), [1.0, -ma], series, axis=-1)[..., 2:])


def bound(responses: np.ndarray, changes: np.ndarray, drift: np.ndarray) -> float:
    """Least standard deviation of an unbiased estimate of the gap.

    responses: (3, n), dT per unit of gap, of gain and of lag; changes: what a unit is; drift: (n,), K.
    """
    models = [(float(np.mean(whitened(drift, ar, ma) ** 2)), ar, ma) for ar in AR for ma in MA]
    variance, ar, ma = min(models)
    gap, *others = whitened(responses / changes[:, np.newaxis], ar, ma)
    unknown, _ = np.linalg.qr(np.stack([*others, np.ones(gap.size)], axis=1))
    left = gap - unknown @ (unknown.T @ gap)
    return float(np.sqrt(variance / (left @ left)))


def bound_of(loop: fc.Loop, day: fc.Boundary, command: np.ndarray, still: np.ndarray, rows: slice, seed: int) -> float:
    """The bound of one day of which ``rows`` are seen, s.  command: (n,), as it was; still: as it is for the drift."""

    def temperature(command: np.ndarray, trace: str = "T_sup", **changed: float) -> np.ndarray:
        ds = fc.simulate(loop.assign(**changed), day, command=command, traces=[trace], seed=seed, n_jobs=1)
        return np.asarray(ds[trace].squeeze().values[rows], dtype=float)

    values = {name: float(loop[name]) for name in SMALL}
    steps = np.array([SMALL["backlash"], SMALL["m_full"] * values["m_full"], SMALL["C_c"] * values["C_c"]])
    responses = [
        temperature(command, **{name: values[name] + step}) - temperature(command, **{name: values[name] - step})
        for name, step in zip(SMALL, steps, strict=True)
    ]
    return bound(np.array(responses), 2.0 * steps, temperature(still, "T_measured"))


def bounded(case: Case, seed: int, n: int = VALVES, days: int = DAYS) -> Bounded:
    """Bounds and readings of the worn valves of a case whose test came to its end."""
    of = simulated(case, seed, n, days)
    drawn = valves(case.population, [seed, 1], n)
    boundary = of_kind(case.population.kind, [100 * seed + k for k in range(days)], hours=HOURS)
    whole = (of.signals.test > 0.0).any("elapsed_time") & (of.signals.test_aborted == 0.0)
    pairs = [(k, k % days) for k in range(n) if of.backlash[k] > 0.0 and whole[k, k % days]]

    def one(k: int, day: int) -> tuple[float, ...]:
        values = {name: float(each[k]) for name, each in drawn.items()} | {"backlash_estimate": 0.0}
        loop = fc.Loop.preset("lbnl").assign(m_full=1.7, **values, **settings(case.population.kind))
        signals = of.signals.isel(sample=k, day=day)
        runs = np.flatnonzero(signals.test.values > 0.0)
        command = np.repeat(signals.command.values, LOGGED).astype(float)
        end = LOGGED * int(runs[-1])
        still = np.where(np.arange(command.size) < START - CALMS_DOWN, command, command[START:end].mean())
        least = bound_of(loop, boundary.isel(day), command, still, slice(START, end + AFTER, EVERY), seed)
        size, *_ = read(log_of(of, case, k, day), of.stroke_time[k])
        excursion = float(abs(signals.T_sup - signals.T_set).values[runs].max())
        return of.backlash[k], least, size - of.backlash[k], excursion

    return Bounded(*np.array(Parallel(n_jobs=-1)(delayed(one)(*pair) for pair in pairs)).T)


def row(found: Bounded) -> list[str]:
    """A row of the table, sizes in per cent of stroke."""
    typical, large = (100 * float(np.quantile(found.bound, q)) for q in (0.5, 0.9))
    ratio = float(np.median(abs(found.error) / found.bound)) / MEDIAN_OF_NORMAL
    clear = found.bound < np.maximum(SIZE_TOLERANCE * found.gap, GOOD_BACKLASH) / 1.96
    return [
        f"{found.gap.size}", f"{np.median(found.excursion):.2f}", f"{typical:.2f} · {large:.2f}",
        f"{100 * np.sqrt(np.mean(found.error**2)):.2f}", f"{ratio:.1f}", f"{100 * clear.mean():.0f} %",
    ]  # fmt: skip


HEAD = (
    "tests", "n", "excursion, median, K", "bound, median · 90 %, % of stroke", "rms error of the reading, % of stroke",
    "error / bound, typical", "could be claimed",
)  # fmt: skip


def sample() -> None:
    """The first test."""
    name, case = next(iter(ASKED.items()))
    compare_rows("valve_test/valve_test_bound", [[name, *row(bounded(case, SEED))]])


def main() -> None:
    """Write the table."""
    chosen = {name: case for name, case in (ASKED | SEQUENCES).items() if case.command is None and not case.inputs}
    rows = []
    for k, (name, case) in enumerate(chosen.items()):
        rows.append([name, *row(bounded(case, SEED + k))])
        print(rows[-1], flush=True)
    write_table(
        "valve_test/valve_test_bound", "The Cramér–Rao bound of the gap, and the error of this reading", HEAD, rows
    )

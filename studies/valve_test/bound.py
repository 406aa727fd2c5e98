"""How well any reading could tell the gap from a valve test, and how near ``read_test`` comes: the Cramér–Rao bound.

The temperature of a test is the response to its command plus drift and noise.  What the response would change by, if
the gap, the gain or the lag of the coil were a little larger, comes from simulations with the same command; drift and
noise from one in which the command stands still.  Their changes are whitened by the ARIMA(1,1,1) that leaves the least.
The bound is the standard deviation of the best unbiased estimate of the gap where gain, lag and level are unknown.
A reading that knows the coil beforehand, or that prefers some gaps, is not bound by it: the bound with gain and lag
known says what the first can gain at most.
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
from studies.days import loop_settings, make_days
from studies.diagnosis.diagnosis import valves
from studies.valve_test.valve_test import (
    BASIC_CASES,
    HOURS,
    LOG_INTERVAL,
    SEQUENCE_CASES,
    TEST_START,
    Case,
    read_gap,
    select_log,
    simulate_case,
)

SEED, VALVES, DAYS = 9671, 64, 8
SAMPLE_INTERVAL = 10  # seconds between the temperatures that count
SECONDS_AFTER = 600  # seconds after the test that count
SETTLING_SECONDS = 1800  # seconds for which the command stands still before drift and noise are taken
MEDIAN_OF_NORMAL = 0.674  # median size of a normal number, in standard deviations
CERTAIN_SIGMAS = 1.96  # standard deviations to each side that hold a gap with 95 %
PARAMETER_STEPS = {"backlash": 0.002, "m_full": 0.02, "C_c": 0.05}
"""Change of the gap, fraction of stroke, and relative changes of gain and lag."""


class Bound(NamedTuple):
    """Least standard deviation of an unbiased estimate of the gap, fraction of stroke."""

    unknown_coil: float
    known_coil: float
    """With gain and lag of the coil known, and only the level unknown."""


class BoundedReadings(NamedTuple):
    """Gap, bounds, error and interval of the reading of each worn valve, fractions of stroke; excursion, K."""

    gap: np.ndarray
    bound: np.ndarray
    known_coil_bound: np.ndarray
    error: np.ndarray
    interval_width: np.ndarray
    excursion: np.ndarray


def whiten(series: np.ndarray, ar: float, ma: float) -> np.ndarray:
    """Return the innovations of a series under an ARIMA(1,1,1) with these coefficients."""
    return np.asarray(lfilter(np.convolve([1.0, -1.0], [1.0, -ar]), [1.0, -ma], series, axis=-1)[..., 2:])


def gap_bound(responses: np.ndarray, changes: np.ndarray, drift: np.ndarray) -> Bound:
    """Return the bounds of the gap.

    responses: (3, n), dT per unit of gap, of gain and of lag; changes: what a unit is; drift: (n,), K.
    """
    noise_models = [(float(np.mean(whiten(drift, ar, ma) ** 2)), ar, ma) for ar in AR for ma in MA]
    variance, ar, ma = min(noise_models)
    gap, *other_responses = whiten(responses / changes[:, np.newaxis], ar, ma)
    bounds = []
    for unknown in ([*other_responses, np.ones(gap.size)], [np.ones(gap.size)]):
        nuisance, _ = np.linalg.qr(np.stack(unknown, axis=1))
        residual = gap - nuisance @ (nuisance.T @ gap)
        bounds.append(float(np.sqrt(variance / (residual @ residual))))
    return Bound(*bounds)


def simulate_bound(
    loop: fc.Loop, day: fc.Boundary, command: np.ndarray, still_command: np.ndarray, rows: slice, seed: int
) -> Bound:
    """Simulate the bounds of one day, of which ``rows`` are seen, s.

    command: (n,), as it was; still_command: as it is for the drift.
    """

    def temperature(command: np.ndarray, trace: str = "T_sup", **changes: float) -> np.ndarray:
        ds = fc.simulate(loop.assign(**changes), day, command=command, traces=[trace], seed=seed, n_jobs=1)
        return np.asarray(ds[trace].squeeze().values[rows], dtype=float)

    values = {name: float(loop[name]) for name in PARAMETER_STEPS}
    steps = np.array(
        [
            PARAMETER_STEPS["backlash"],
            PARAMETER_STEPS["m_full"] * values["m_full"],
            PARAMETER_STEPS["C_c"] * values["C_c"],
        ]
    )
    responses = [
        temperature(command, **{name: values[name] + step}) - temperature(command, **{name: values[name] - step})
        for name, step in zip(PARAMETER_STEPS, steps, strict=True)
    ]
    return gap_bound(np.array(responses), 2.0 * steps, temperature(still_command, "T_measured"))


def bound_case(case: Case, seed: int, n: int = VALVES, days: int = DAYS) -> BoundedReadings:
    """Bounds and readings of the worn valves of a case whose test came to its end."""
    tests = simulate_case(case, seed, n, days)
    parameters = valves(case.population, [seed, 1], n)
    boundary = make_days(case.population.kind, [100 * seed + k for k in range(days)], hours=HOURS)
    is_complete = (tests.signals.test > 0.0).any("elapsed_time") & (tests.signals.test_aborted == 0.0)
    pairs = [(k, k % days) for k in range(n) if tests.backlash[k] > 0.0 and is_complete[k, k % days]]

    def bound_test(k: int, day: int) -> tuple[float, ...]:
        values = {name: float(column[k]) for name, column in parameters.items()} | {"backlash_estimate": 0.0}
        loop = fc.Loop.preset("lbnl").assign(m_full=1.7, **values, **loop_settings(case.population.kind))
        signals = tests.signals.isel(sample=k, day=day)
        test_rows = np.flatnonzero(signals.test.values > 0.0)
        command = np.repeat(signals.command.values, LOG_INTERVAL).astype(float)
        end = LOG_INTERVAL * int(test_rows[-1])
        still_command = np.where(
            np.arange(command.size) < TEST_START - SETTLING_SECONDS, command, command[TEST_START:end].mean()
        )
        bound = simulate_bound(
            loop,
            boundary.isel(day),
            command,
            still_command,
            slice(TEST_START, end + SECONDS_AFTER, SAMPLE_INTERVAL),
            seed,
        )
        estimate, low, high, _ = read_gap(select_log(tests, case, k, day), tests.stroke_time[k])
        excursion = float(abs(signals.T_sup - signals.T_set).values[test_rows].max())
        return tests.backlash[k], *bound, estimate - tests.backlash[k], high - low, excursion

    return BoundedReadings(*np.array(Parallel(n_jobs=-1)(delayed(bound_test)(*pair) for pair in pairs)).T)


def bound_row(readings: BoundedReadings) -> list[str]:
    """Format bounds and readings of a case as a row, sizes in per cent of stroke."""
    median_bound, large_bound = (100 * float(np.quantile(readings.bound, q)) for q in (0.5, 0.9))
    ratio = float(np.median(abs(readings.error) / readings.bound)) / MEDIAN_OF_NORMAL
    rms_error, rms_bound = (np.sqrt(np.mean(sizes**2)) for sizes in (readings.error, readings.bound))
    width_ratio = float(np.nanmedian(readings.interval_width / readings.bound)) / (2.0 * CERTAIN_SIGMAS)
    is_claimable = readings.bound < np.maximum(SIZE_TOLERANCE * readings.gap, GOOD_BACKLASH) / CERTAIN_SIGMAS
    return [
        f"{readings.gap.size}", f"{np.median(readings.excursion):.2f}", f"{median_bound:.2f} · {large_bound:.2f}",
        f"{100 * np.median(readings.known_coil_bound):.2f}", f"{100 * rms_error:.2f}", f"{ratio:.1f}",
        f"{rms_error / rms_bound:.1f}", f"{width_ratio:.1f}", f"{100 * is_claimable.mean():.0f} %",
    ]  # fmt: skip


HEAD = (
    "tests", "n", "excursion, median, K", "bound, median · 90 %, % of stroke", "median bound with gain and lag known",
    "rms error of the reading, % of stroke", "error / bound, typical", "rms error / rms bound",
    "width of the interval / that of the bound, typical", "could be claimed",
)  # fmt: skip


def sample() -> None:
    """Run a sample of the study: the first test."""
    name, case = next(iter(BASIC_CASES.items()))
    compare_rows("valve_test/valve_test_bound", [[name, *bound_row(bound_case(case, SEED))]])


def main() -> None:
    """Write the table."""
    chosen = {
        name: case for name, case in (BASIC_CASES | SEQUENCE_CASES).items() if case.command is None and not case.inputs
    }
    rows = []
    for k, (name, case) in enumerate(chosen.items()):
        rows.append([name, *bound_row(bound_case(case, SEED + k))])
        print(rows[-1], flush=True)
    write_table(
        "valve_test/valve_test_bound", "The Cramér–Rao bound of the gap, and the error of this reading", HEAD, rows
    )

"""How surely a valve test of 20 to 45 minutes shows the gap, what misleads it, and what it does to the air.

Each valve is tested on one of the days; every fourth has no gap.  Sequence, likelihood and thresholds were chosen on
valves and days of seeds below 9000.  A claim is right within 20 % of the gap or 1 % of the stroke.  Tests that end
before their time are read as well: what they claim counts among the claims.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from joblib import Parallel, delayed

import fastcoil as fc
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE
from fastcoil.model.metric_table import TEST_ABORTED_MEANINGS
from studies.common import compare_rows, save_figure, share_of, write_table
from studies.days import CONSTANT, DESIGN, HEATING, STEPPED, WEATHER, kinds, loop_settings, make_days
from studies.diagnosis.diagnosis import Population, valves

SEED, VALVES, DAYS = 9631, 256, 8
TEST_START, HOURS, LOG_INTERVAL = 5400, 3, 5
INPUT_COLUMNS = ("m_a", "T_a_in", "T_w_in")
UNITS = {"command": "1", "test": "1", "m_a": "kg/s"}


class Case(NamedTuple):
    """Tests of a population.

    changed: parameters of the loops; swing: a series of the boundary, and by how much it swings every 10 min.  air:
    share of the air flow, given a random generator and the seconds.  inputs: what else is logged.  log_interval: s.
    stroke_time: value given over the true one.  late: s by which the command is logged after the temperature.
    command: in place of the test, the command from its start on, given that of the start: (n,) at every second.
    """

    population: Population = Population(CONSTANT)
    test: fc.ValveTest = fc.ValveTest(start=TEST_START)
    changed: dict[str, float] = {}
    swing: tuple[str, float] | None = None
    air: Callable[[np.random.Generator, np.ndarray], np.ndarray] | None = None
    inputs: tuple[str, ...] = ()
    log_interval: int = LOG_INTERVAL
    stroke_time: float = 1.0
    late: int = 0
    command: Callable[[float], np.ndarray] | None = None


LONGER_TEST = fc.ValveTest(start=TEST_START, minutes=30)
GENTLE_TEST = fc.ValveTest.gentle(start=TEST_START)
HEATING_TEST = fc.ValveTest.heating(start=TEST_START)
BASIC_CASES = {
    "cooling, 20 min": Case(),
    "cooling, 30 min": Case(test=LONGER_TEST),
    "cooling, 30 min, m_a, T_a_in, T_w_in logged": Case(test=LONGER_TEST, inputs=INPUT_COLUMNS),
    "gentle, 45 min": Case(test=GENTLE_TEST),
    "heating, 30 min": Case(Population(HEATING), HEATING_TEST),
    "design days, 20 min": Case(Population(DESIGN)),
    "set-point stepped, 20 min": Case(Population(STEPPED)),
    **({"weather, 20 min": Case(Population(WEATHER))} if WEATHER in kinds() else {}),
}
HARDER_CASES = {
    "noise 0.1 K": Case(changed={"noise_std": 0.1}),
    "sensor in steps of 0.1 K": Case(changed={"sensor_resolution": 0.1}),
    "command in steps of 1 %": Case(changed={"command_resolution": 0.01}),
    "neutral zone of 1 %": Case(changed={"neutral_zone": 0.01}),
    "slip jump of 0.3 X": Case(Population(CONSTANT, slip_ratio=0.3)),
    "authority 0.02 to 0.1": Case(Population(CONSTANT, authority=(0.02, 0.1))),
    "stroke time told is half the true one": Case(stroke_time=0.5),
    "logged every 15 s": Case(log_interval=15),
    "command logged 30 s late": Case(late=30),
    "command logged 45 s late": Case(late=45),
    "command logged 2 min late": Case(late=120),
    "command logged 2 min early": Case(late=-120),
    "command logged 5 min late": Case(late=300),
    "water swings by ± 0.5 K": Case(swing=("T_w_in", 0.5)),
    "water swings by ± 1 K": Case(swing=("T_w_in", 1.0)),
    "water swings by ± 2 K": Case(swing=("T_w_in", 2.0)),
    "entering air swings by ± 2 K": Case(swing=("T_a_in", 2.0)),
}


def square_command(command: float) -> np.ndarray:
    """Return a command with steps of ± 5 % every five minutes for 20, as people step a valve."""
    return command + 0.05 * np.repeat([1.0, -1.0, 1.0, -1.0], 300)


def triangle_command(command: float) -> np.ndarray:
    """Return a command with equal triangles of ± 10 % in ten minutes."""
    t = np.arange(1200)
    return command + 0.1 * np.interp(t % 600, [0, 150, 450, 600], [0.0, 1.0, -1.0, 0.0])


SEQUENCE_CASES = {
    "square, ± 5 %": Case(command=square_command),
    "triangles, ± 10 %": Case(command=triangle_command),
    "relay, 0.035 %/s": Case(test=fc.ValveTest(start=TEST_START, rate=3.5e-4)),
    "relay, 0.07 %/s (as shipped)": Case(),
    "relay, 0.14 %/s": Case(test=fc.ValveTest(start=TEST_START, rate=1.4e-3)),
    "relay, holds of 30 s": Case(test=fc.ValveTest(start=TEST_START, hold=30)),
    "relay, holds of 240 s": Case(test=fc.ValveTest(start=TEST_START, hold=240)),
    "relay, threshold 0.1 K": Case(test=fc.ValveTest(start=TEST_START, threshold=0.1)),
    "relay, threshold 0.6 K": Case(test=fc.ValveTest(start=TEST_START, threshold=0.6, excursion=2.0)),
}


class SimulatedTests(NamedTuple):
    """Simulated tests: dims sample and day, and elapsed_time."""

    signals: xr.Dataset
    backlash: np.ndarray
    stroke_time: np.ndarray


def simulate_case(case: Case, seed: int, n: int, days: int) -> SimulatedTests:
    """Simulate the tests of a case."""
    population = case.population
    parameters = valves(population, [seed, 1], n) | {"backlash_estimate": np.zeros(n)}
    parameters |= {name: np.full(n, value) for name, value in case.changed.items()}
    boundary = make_days(population.kind, [100 * seed + k for k in range(days)], hours=HOURS)
    series: dict[str, Any] = {name: np.asarray(boundary.series[name]) for name in (*INPUT_COLUMNS, "W_a_in", "T_set")}
    if case.swing is not None:
        name, size = case.swing
        phase = np.random.default_rng([seed, 2]).uniform(0.0, 2 * np.pi, (days, 1))
        series[name] = series[name] + size * np.sin(2 * np.pi * np.arange(HOURS * 3600) / 600 + phase)
        boundary = fc.Boundary(**series, day=list(range(days)))
    if case.air is not None:
        seconds = np.arange(HOURS * 3600)
        air = [case.air(np.random.default_rng([seed, 3, day]), seconds) for day in range(days)]
        boundary = boundary.assign(m_a=series["m_a"] * np.array(air))
        series["m_a"] = np.asarray(boundary.series["m_a"])
    loop = fc.Loop.preset("lbnl").assign(
        m_full=1.7,
        **{name: ("sample", values) for name, values in parameters.items()},
        **loop_settings(population.kind),
    )
    options: dict[str, Any] = {
        "traces": ["command", "T_measured", "T_sup", "test"],
        "trace_interval": LOG_INTERVAL,
        "seed": seed,
    }
    if case.command is None:
        ds = fc.simulate(loop, boundary, test=case.test, **options)
    else:
        command_before = fc.simulate(loop, boundary, traces=["command"], seed=seed).command.transpose(
            "sample", "day", ...
        )
        parts = []
        for k in range(n):
            command = command_before[k].values.copy()
            for day_command in command:
                steps = case.command(day_command[TEST_START])
                day_command[TEST_START : TEST_START + steps.size] = np.clip(steps, 0.0, 1.0)
                day_command[TEST_START + steps.size :] = day_command[TEST_START]
            valve_loop = loop.assign(**{name: float(values[k]) for name, values in parameters.items()})
            parts.append(fc.simulate(valve_loop, boundary, command=command, n_jobs=1, **options))
        ds = xr.concat(parts, "sample")
        ds["test"] = ds.test.where((ds.elapsed_time < TEST_START) | (ds.elapsed_time >= TEST_START + steps.size), 1.0)
    for name in (*INPUT_COLUMNS, "T_set"):
        ds[name] = (("day", "elapsed_time"), series[name][:, ::LOG_INTERVAL])
    return SimulatedTests(ds.transpose("sample", "day", ...), parameters["backlash"], parameters["stroke_time"])


def select_log(tests: SimulatedTests, case: Case, sample: int, day: int) -> xr.Dataset:
    """Select the log of one test from those of a case."""
    names = ["command", "T_measured", "T_set", "test", *case.inputs]
    log = tests.signals[names].isel(
        sample=sample, day=day, elapsed_time=slice(None, None, case.log_interval // LOG_INTERVAL)
    )
    log = log.astype(float).reset_coords(drop=True).rename(T_measured="T_sup")
    for name in log:
        log[name].attrs = {"units": UNITS.get(str(name), "degC")}
    rows = np.arange(log.sizes["elapsed_time"])
    shifted_rows = np.clip(rows - case.late // case.log_interval, 0, rows[-1])
    for name in ("command", "test"):
        log[name].values = log[name].values[shifted_rows]
    time = rows * float(case.log_interval)
    return log.assign_coords(elapsed_time=("elapsed_time", time, {"units": "s"}))


def read_gap(log: xr.Dataset, stroke_time: float) -> tuple[float, ...]:
    """Read the log of a test: the gap, its interval, and whether it is claimed."""
    reading = fc.read_test(log, stroke_time=stroke_time)
    return reading.backlash, *reading.interval, float(reading.identified)


class CaseReadings(NamedTuple):
    """Readings of a case and their quality: (sample, day) each, of the tests that began."""

    began: xr.DataArray
    ended: xr.DataArray
    claimed: xr.DataArray
    right: xr.DataArray
    covered: xr.DataArray
    good: xr.DataArray
    accused: xr.DataArray
    error: xr.DataArray
    excursion: xr.DataArray
    aborted: xr.DataArray
    wait: xr.DataArray
    """Time for which a test waited for calm air, s."""
    own: xr.DataArray
    """Whether the valve is tested on this day."""


def read_case(case: Case, seed: int, n: int = VALVES, days: int = DAYS) -> CaseReadings:
    """Simulate and read the tests of a case."""
    tests = simulate_case(case, seed, n, days)
    is_test = tests.signals.test > 0.0
    is_own_day = xr.DataArray(np.arange(n)[:, np.newaxis] % days == np.arange(days), dims=("sample", "day"))
    has_begun = is_test.any("elapsed_time") & is_own_day
    pairs = [(k, day) for k in range(n) for day in range(days) if has_begun[k, day]]
    stroke_times_told = case.stroke_time * tests.stroke_time
    readings = Parallel(n_jobs=-1)(
        delayed(read_gap)(select_log(tests, case, k, day), stroke_times_told[k]) for k, day in pairs
    )
    values = np.full((4, n, days), np.nan)
    for pair, numbers in zip(pairs, readings, strict=True):
        values[(slice(None), *pair)] = numbers
    size, low, high, is_claimed = (xr.DataArray(column, dims=("sample", "day")) for column in values)
    truth = xr.DataArray(tests.backlash, dims="sample")
    error = size - truth
    is_right = abs(error) <= np.maximum(SIZE_TOLERANCE * truth, GOOD_BACKLASH) + 1e-9
    aborted = tests.signals.test_aborted if case.command is None else xr.zeros_like(has_begun, dtype=float)
    excursion = abs(tests.signals.T_sup - tests.signals.T_set).where(is_test).max("elapsed_time")
    is_good = (truth == 0.0) & has_begun
    return CaseReadings(
        has_begun, has_begun & (aborted == 0.0), (is_claimed > 0.0) & has_begun, is_right & has_begun,
        (truth >= low) & (truth <= high), is_good,
        is_good & (is_claimed > 0.0) & (size > GOOD_BACKLASH + 1e-9), error, excursion, aborted,
        tests.signals.elapsed_time.where(is_test).min("elapsed_time") - TEST_START, is_own_day,
    )  # fmt: skip


HEAD = (
    "tests", "n", "to their end", "right", "claimed", "claims that are right", "interval holds the gap",
    "rms error, % of stroke", "excursion, median · 95 %, K", "good valves accused",
)  # fmt: skip


def reading_cells(readings: CaseReadings) -> list[str]:
    """Format the readings of a case as a row: shares of the tests that came to their end; claims, of all that began."""
    error = 100 * float(np.sqrt((readings.error**2).where(readings.ended).mean()))
    middle, large = (float(readings.excursion.where(readings.began).quantile(q)) for q in (0.5, 0.95))
    return [
        f"{int(readings.began.sum())}", f"{share_of(readings.ended, readings.began)}",
        f"{share_of(readings.right, readings.ended).to_text(1)}",
        f"{share_of(readings.claimed, readings.ended)}", _right_share(readings),
        f"{share_of(readings.covered, readings.ended).to_text(1)}",
        f"{error:.2f}", f"{middle:.2f} · {large:.2f}", f"{int(readings.accused.sum())} of {int(readings.good.sum())}",
    ]  # fmt: skip


def _right_share(readings: CaseReadings) -> str:
    return share_of(readings.right, readings.claimed).to_text(1) if bool(readings.claimed.any()) else "no claim"


def write_case_table(
    name: str, title: str, cases: dict[str, Case], seed_offset: int, n: int = VALVES
) -> dict[str, CaseReadings]:
    """Write the table of some cases; ``seed_offset`` is added to the seed."""
    by_label = {}
    for k, (label, case) in enumerate(cases.items()):
        by_label[label] = read_case(case, SEED + seed_offset + k, n)
        print(label, reading_cells(by_label[label]), flush=True)
    write_table(
        f"valve_test/{name}", title, HEAD, [[label, *reading_cells(readings)] for label, readings in by_label.items()]
    )
    return by_label


MINUTES, THRESHOLDS = (10, 15, 20, 30, 45), (0.1, 0.2, 0.3, 0.5)


def draw_claims_over_time(n: int = 128) -> None:
    """Draw the share that is claimed over minutes and kelvins."""
    figure, axes = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for k, threshold in enumerate(THRESHOLDS):
        tests = [fc.ValveTest(start=TEST_START, minutes=m, threshold=threshold, excursion=2.0) for m in MINUTES]
        rows = [read_case(Case(test=test), SEED + 60 + k, n) for test in tests]
        kelvin = float(np.median([row.excursion.median() for row in rows]))
        shares = [100 * share_of(row.claimed & row.right, row.began).value for row in rows]
        axes.plot(MINUTES, shares, marker="o", label=f"threshold {threshold:g} K: {kelvin:.1f} K in the median")
    axes.set(xlabel="minutes of the test", ylabel="gaps claimed and right [%]", ylim=(0, 100))
    axes.legend(loc="lower right", title="excursion")
    save_figure(figure, "valve_test/valve_test.png")


def draw_one_test() -> None:
    """Draw the test that the page shows, and its reading."""
    loop = fc.Loop.preset("lbnl").assign(
        backlash=0.08, noise_std=0.02, kp=0.06, ti=60, sample_time=LOG_INTERVAL, stroke_time=90
    )  # fmt: skip
    day = fc.Boundary(**{**fc.paper_day(hours=HOURS, seed=3).series, "T_set": 14.0})
    options: dict[str, Any] = {"traces": ["command", "T_measured", "test"], "trace_interval": LOG_INTERVAL}
    ds = fc.simulate(loop, day, test=fc.ValveTest(start=TEST_START), **options).squeeze()
    T_set = ("elapsed_time", np.full(ds.sizes["elapsed_time"], 14.0), {"units": "degC"})
    save_figure(fc.read_test(ds.assign(T_set=T_set), stroke_time=90).plot(), "valve_test/one_test.png")


def sample() -> None:
    """Run a sample of the study: the last row of the first table."""
    label, case = list(BASIC_CASES.items())[-1]
    compare_rows("valve_test/valve_test", [[label, *reading_cells(read_case(case, SEED + len(BASIC_CASES) - 1))]])


def main() -> None:
    """Write the tables and the figure."""
    conditions_text = f"{VALVES} valves on {DAYS} days, a quarter without a gap"
    basic_readings = write_case_table("valve_test", f"What a valve test shows: {conditions_text}", BASIC_CASES, 0)
    reasons = {
        label: [
            f"{int(((readings.aborted == k) & readings.began).sum())}" for k in range(1, len(TEST_ABORTED_MEANINGS))
        ]
        for label, readings in basic_readings.items()
    }
    write_table("valve_test/valve_test_aborted", "Tests that were aborted, by reason",
                ["tests", *(word.replace("_", " ") for word in TEST_ABORTED_MEANINGS[1:])],
                [[label, *counts] for label, counts in reasons.items()])  # fmt: skip
    write_case_table(
        "valve_test_harder", f"Valve tests under harder conditions: 20 min, {conditions_text}", HARDER_CASES, 20
    )
    write_case_table(
        "valve_test_sequences", f"Sequences of 20 min compared: 128 valves on {DAYS} days", SEQUENCE_CASES, 40, 128
    )
    draw_claims_over_time()
    draw_one_test()

"""Test vectors: synthetic records that exercise every branch of a controller, with the expected answers.

Each row is a cycle: the inputs of the controller, and its answers.  The answers are those of fastcoil's kernel, except
for starts from a command, bad readings, holds and synthetic valve tests, which the laws in Python answer.
"""

import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.machine import VERSION
from fastcoil.deliver.export.controller import Controller
from fastcoil.loops.boundary.days import heating_day, paper_day
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.measured.replay import run_controllers
from fastcoil.model.engine.recorded import REPLAY_COLUMNS
from fastcoil.model.parameter_table import LARGEST_FLOAT
from fastcoil.model.valve_test import LONGEST_WAIT_S

TRACE_BY_OUTPUT = {
    "command": "command", "u": "u", "integral_part": "integral", "rising": "mode", "estimate": "estimate",
    "test": "test",
}  # fmt: skip
"""Trace by the output of the code that has it."""
_TEST_START_S = 1800.0  # from the start of the simulated day
_READING_LIMITS_C = (-50.0, 150.0)  # a good reading lies between them
FLAG_INPUTS = ("enabled", "start_test", "reset")  # inputs that are true or false
_LARGEST_ERROR_K = 25.0  # in a record: a reading stays plausible
_MOST_CYCLES = 6000  # of a record: intervals of a day would fill a disk


@dataclass(frozen=True)
class Vectors:
    """Test vectors: inputs and expected answers by name, each with a value for every cycle."""

    columns: dict[str, Array]
    inputs: tuple[str, ...]

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(name for name in self.columns if name not in self.inputs)

    @property
    def n_cycles(self) -> int:
        return int(self.columns["T_sup"].size)

    @cached_property
    def lines(self) -> str:
        """The header and the rows as CSV text, numbers with 17 digits."""
        rows = zip(*(column.tolist() for column in self.columns.values()), strict=True)
        lines = [",".join(self.columns), *(",".join(f"{x:.17g}" for x in row) for row in rows)]
        return "".join(f"{line}\n" for line in lines)

    @property
    def checksum(self) -> int:
        """CRC-32 of the lines, to detect a file that was cut or edited."""
        return zlib.crc32(self.lines.encode())

    def csv_text(self, code: str, sample_time: float) -> str:
        return (
            f"# Vectors for {code}, written by fastcoil {VERSION}: a row for each {sample_time:g} s cycle.\n"
            f"# Given: {', '.join(self.inputs)}.  A row with reset = 1 begins a run, and so does the first.\n"
            f"# Expected after the cycle, to 1e-12: {', '.join(self.outputs)}.\n"
            "# The first run has starts from a command, bad readings, holds and ends; then come made-up records,\n"
            "# replayed by the simulation, and the loop on a simulated day.\n"
            f"# {self.n_cycles} rows; CRC-32 of all lines but these, each with one line feed: {self.checksum:08x}.\n"
            f"{self.lines}"
        )


def make_vectors(loop: Loop, controller: Controller, text: str) -> Vectors:
    """Return vectors of operation by hand, of replays of synthetic records, and of the loop on a simulated day."""
    is_missing = {"estimate": controller.estimator_port is None, "integral_part": controller.law_port is not None}
    is_missing |= dict.fromkeys(("start_test", "test", "test_aborted"), not controller.has_test)
    is_missing["m_a"] = not controller.sees_air
    all_inputs = ("T_sup", "T_set", "m_a", "enabled", "start_test", "reset", "start_command")
    inputs = tuple(name for name in all_inputs if not is_missing.get(name, False))
    outputs = [name for name in (*TRACE_BY_OUTPUT, "switches", "test_aborted") if not is_missing.get(name, False)]
    records = []
    for record in (_operator_record(controller), *([_valve_test_record(controller)] if controller.has_test else [])):
        input_columns = {name: record[name] for name in inputs}
        answers = np.array(list(run_cycles(text, input_columns, outputs))).T
        records.append(input_columns | dict(zip(outputs, answers, strict=True)))
    loop_without_test = loop.assign(test_start=LARGEST_FLOAT) if controller.has_test else loop
    for readings in _replay_records(controller):
        sample_time = int(controller.number["sample_time"])
        no_air = {} if controller.sees_air else {"m_a": np.full(readings["m_a"].size, np.nan)}
        series = np.stack([(readings | no_air)[name] for name in REPLAY_COLUMNS], axis=1).repeat(sample_time, axis=0)
        # not by ``fc.replay``, which refuses such jumps
        records.append(_record_from_results(run_controllers(loop_without_test, series, sample_time), readings))
    records.append(_day_record(loop, controller))
    if controller.word["estimator"] == "identify":
        records.append(_day_record(loop, controller, disturbed=True))
    return Vectors({name: np.concatenate([run[name] for run in records]) for name in (*inputs, *outputs)}, inputs)


def run_cycles(text: str, inputs: Mapping[str, Array], outputs: Sequence[str]) -> Iterator[list[float]]:
    """Run the laws in Python and yield the outputs of each cycle; inputs: series in the order of the arguments."""
    laws: dict[str, Any] = {"zeros": lambda size: [0.0] * size}
    exec(compile(text, "<laws>", "exec"), laws)
    s = laws["State"]()
    for row in zip(*(values.tolist() for values in inputs.values()), strict=True):
        laws["step"](s, *(x > 0.5 if name in FLAG_INPUTS else x for name, x in zip(inputs, row, strict=True)))
        yield [float(getattr(s, name)) for name in outputs]


def _operator_record(controller: Controller) -> dict[str, Array]:
    """Make inputs with starts from a command, operation by hand, bad readings, off and on, ends of stroke, holds."""
    number, sign = controller.number, -1.0 if controller.heats else 1.0
    # K: moves the output by a tenth of the stroke at most
    gain = abs(number["kp"]) * max(1.0, number["sample_time"] / number["ti"])
    size = min(0.1 / max(gain, 1e-9), 5.0) + number["error_dead_band"]

    def cycle(
        e: float = 0.0, start_command: float = 0.0, reset: float = 0.0, enabled: float = 1.0, **reading: float
    ) -> tuple[float, ...]:
        T_sup = reading.get("T_sup", controller.set_point + sign * size * e)
        return T_sup, reading.get("T_set", controller.set_point), 1.2, enabled, reset, start_command

    rows = [cycle(1.0, 0.3), cycle(-1.0), cycle(2.0), cycle(-1.0)]  # a state of zeros starts by itself
    rows += [cycle(-1.0, hand, reset=1.0) for hand in (0.2, 0.35, 0.6)]
    rows += [cycle(e, 0.9) for e in (-1.0, 1.0, -2.0)]  # a start command without a reset is none
    for start in (0.0, 0.4, 1.0, 1.5, -0.2, math.nan, math.inf):
        for e in (0.5, -0.5):
            rows += [cycle(e, start, reset=1.0), cycle(-e)]
    just_inside = math.nextafter(_READING_LIMITS_C[0], 0.0), math.nextafter(_READING_LIMITS_C[1], 0.0)
    for reading in (math.nan, math.inf, -math.inf, *_READING_LIMITS_C, *just_inside):
        for name in ("T_sup", "T_set"):
            rows += [cycle(0.5, 0.5, reset=1.0), cycle(**{name: reading}), cycle(-1.0), cycle(1.0)]
    plus, minus, bad = cycle(1.0), cycle(-1.0), cycle(T_sup=math.nan)
    rows += [cycle(1.0, 0.4, reset=1.0, T_sup=math.nan), bad, plus, minus]
    off = [cycle(e, enabled=0.0) for e in (1.0, 2.0)]
    rows += [*off, plus, minus, cycle(1.0, 0.4, 1.0, 0.0), *off, bad, plus, bad, *off]
    rows += [cycle(e) for e in (4.0, -4.0, 4.0) for _ in range(12)]
    # a hold in which an interval of a learner ends
    n = min(int(number["learning_interval"] / number["sample_time"]), 100)
    turns = [plus if k % 8 < 4 else minus for k in range(4 * n + n // 2)]
    rows += [cycle(0.5, 0.4, reset=1.0), *turns, *[bad] * n, *turns[:n]] if controller.estimator_port else [bad] * 20
    rows += [plus, minus]
    names = ("T_sup", "T_set", "m_a", "enabled", "reset", "start_command")
    return dict(zip(names, np.array(rows).T, strict=True)) | {"start_test": np.zeros(len(rows))}


def _valve_test_record(controller: Controller) -> dict[str, Array]:
    """Make inputs with a full valve test, then ones ended by excursion, stroke, swing, plant off and varying air."""
    number = controller.number
    dt, settle, excursion = number["sample_time"], number["test_settle"], number["test_excursion"]
    t = dt * np.arange(min(math.ceil(60.0 * number["test_minutes"] / dt), _MOST_CYCLES) + 20)
    ramp_time = np.maximum(t - settle - 6.0 * dt, 0.0)
    size = min(number["test_threshold"] + 0.5, 0.9 * excursion) * np.where(ramp_time // 500.0 % 2.0, 0.7, 1.0)
    steady_error, swing_error = np.full(t.size, min(0.2, 0.5 * excursion)), 0.3 * (-1.0) ** np.arange(t.size)
    excursion_error = 1.5 * excursion * (1.0 + (t > 0.6 * settle + 4.0 * dt)) * (t > 0.3 * settle + 3.0 * dt)
    e = np.stack([size * np.sin(ramp_time / 60.0), excursion_error, steady_error, swing_error, steady_error])
    enabled, start_test, reset, start_command, m_a = (np.full(e.shape, x) for x in (1.0, 1.0, 0.0, 0.0, 1.2))
    gust = slice(t.size // 2, t.size // 2 + 2)  # of air, with an error that it explains
    e[0, gust], m_a[0, gust] = 1.3 * excursion, 1.5
    reset[:, 0], start_command[:, 0] = 1.0, (0.5, 0.5, 0.98, 0.5, 0.5)
    start_test[:, 1:3] = 0.0  # a request from the start on begins no test
    enabled[4, 6:14] = 0.0
    start_test[4, [9, 10, 16, 17]] = 0.0  # requested again while the plant is off, and on
    handling = {"m_a": m_a, "start_test": start_test, "reset": reset, "start_command": start_command}
    waiting = np.arange(min(math.ceil(LONGEST_WAIT_S / dt), _MOST_CYCLES) + 20)
    inputs = {name: np.append(values, np.resize(values[1], waiting.size)) for name, values in handling.items()}
    inputs["reset"][e.size + 1 :] = 0.0
    inputs["m_a"][e.size :] = np.where((waiting + 99 // dt) * dt // 100.0 % 2.0, 1.0, 1.4)
    errors, is_on = np.append(e, np.full(waiting.size, 0.1 * excursion)), np.append(enabled, np.ones(waiting.size))
    readings = _readings_for_errors(controller, errors, np.full(errors.size, controller.set_point), is_on)
    readings["T_sup"][10] = math.nan
    return readings | inputs


def _day_record(loop: Loop, controller: Controller, *, disturbed: bool = False) -> dict[str, Array]:
    """Simulate the loop on a day: inputs and answers; if disturbed, with steps of air flow and some time off."""
    hours = 3 if controller.word["estimator"] == "identify" else 1  # it needs steps of the set-point
    if controller.has_test:
        loop = loop.assign(test_start=_TEST_START_S, test_every=0.0)
        hours = max(hours, math.ceil(controller.number["test_minutes"] / 60.0 + 0.75))
    day = heating_day(hours) if controller.heats else paper_day(hours)
    sample_time, band = int(controller.number["sample_time"]), controller.number["error_dead_band"]
    if band > 0.0:  # smaller steps are refused
        T_set = day.series["T_set"][0]
        day = day.assign(T_set=T_set[0] + (1.0 + 2.0 * band) * (T_set - T_set[0]))
    enabled = np.ones(day.series["T_set"].shape[1])
    if disturbed:
        second = np.arange(enabled.size)
        enabled[(second // sample_time >= 3900 // sample_time) & (second // sample_time < 4500 // sample_time)] = 0.0
        day = day.assign(m_a=day.series["m_a"][0] * np.where(second % 3000 < 2400, 1.0, 0.8), enabled=enabled)
    traces = ["T_measured", *TRACE_BY_OUTPUT.values()]
    ds = simulate(loop, day, traces=traces, trace_interval=sample_time, warm_up=0, n_jobs=1, progress=False)
    series = {name: np.asarray(day.series[name][0])[::sample_time] for name in ("T_set", "m_a")}
    T_sup = ds["T_measured"].values
    test_requested = (np.arange(0, enabled.size, sample_time) >= _TEST_START_S).astype(float)
    series |= {"T_sup": T_sup, "enabled": enabled[::sample_time], "start_test": test_requested}
    rows = _record_from_results(ds, series)
    is_good = np.logical_and.accumulate((T_sup > _READING_LIMITS_C[0]) & (T_sup < _READING_LIMITS_C[1]))
    return {name: values[is_good] for name, values in rows.items()}


def _record_from_results(ds: xr.Dataset, inputs: dict[str, Array]) -> dict[str, Array]:
    """Return the inputs and the answers of a simulation as columns of vectors."""
    zeros = np.zeros(inputs["T_sup"].size)
    rows = {"start_test": zeros, "start_command": zeros, "reset": (np.arange(zeros.size) == 0).astype(float)}
    rows |= inputs | {name: ds[trace].values if trace in ds else zeros for name, trace in TRACE_BY_OUTPUT.items()}
    aborted = float(ds["test_aborted"]) if "test_aborted" in ds else 0.0
    rows["test_aborted"] = aborted * rows["start_test"] * (1.0 - rows["test"])
    rows["rising"] = (rows["rising"] > 0.0).astype(float)
    turns = np.abs(np.diff(rows["rising"], prepend=0.0))
    return rows | {"switches": np.cumsum(turns * (1.0 - rows["test"]))}  # those of a test do not count


def _replay_records(controller: Controller) -> list[dict[str, Array]]:
    """Return readings that lead a controller along the stroke, and those that its estimator needs besides."""
    e, enabled = _errors_along_stroke(controller)
    T_set = np.full(e.size, controller.set_point)
    T_set[60:] += 1.0 + 2.0 * controller.number["error_dead_band"]
    T_set[130:] -= 0.5
    records = [_readings_for_errors(controller, e, T_set, enabled)]
    special = {"learner": _errors_for_learner, "hagglund": _errors_for_hagglund}.get(controller.word["estimator"])
    if special is not None:
        e = special(controller)[:_MOST_CYCLES]
        records.append(_readings_for_errors(controller, e, np.full(e.size, T_set[0]), np.ones(e.size)))
    return records


def _readings_for_errors(controller: Controller, e: Array, T_set: Array, enabled: Array) -> dict[str, Array]:
    """Return the readings of a controller whose errors are ``e``, K, with the resolution of its sensor."""
    T_sup = T_set - e if controller.heats else T_set + e
    resolution = controller.number["sensor_resolution"]
    T_sup = resolution * np.floor(T_sup / resolution + 0.5) if resolution > 0.0 else T_sup
    m_a = np.where(np.arange(e.size) % 400 < 250, 1.2, 1.0)
    return {"T_sup": T_sup, "T_set": T_set, "m_a": m_a, "enabled": enabled}


def _errors_along_stroke(controller: Controller) -> tuple[Array, Array]:
    """Return errors, K, and when the plant is on: along the stroke to its ends, back and forth, off and on."""
    number = controller.number
    k, band = np.arange(30), number["error_dead_band"]
    # cycles of a weak or slow PI from one end of the stroke to the other
    n_cycles = 1.5 * number["ti"] / max(abs(number["kp"]) * number["sample_time"] * _LARGEST_ERROR_K, 1e-9)
    n_crossing = min(math.ceil(n_cycles), _MOST_CYCLES // 4)
    openings = np.concatenate(
        [
            *(np.linspace(0.05, 0.7, 15), np.linspace(0.68, 0.3, 15)),
            *(np.linspace(0.4, 1.4, 10), np.linspace(0.9, -0.4, 20)),
            0.5 + 0.3 * np.sin(2.0 * np.pi * k / 15.0),
            0.4 + 0.01 * np.sin(2.0 * np.pi * k / 3.0 + 0.5) + 0.001 * k,
            0.6 + 1e-12 * (-1.0) ** k[:10],  # round-off, which is no turn
            0.5 + 0.02 * (-1.0) ** k,
            np.linspace(0.5, 0.9, 20),
            np.random.default_rng(17).uniform(0.2, 0.8, 40),
            *(np.full(n_crossing, 1.5), np.full(n_crossing, -0.5)),
        ]
    )
    enabled = np.ones(openings.size)
    for start in (95, 103, 150):
        enabled[start : start + 4] = 0.0
    e = _errors_for_openings(controller, openings, enabled)
    e[110:120] = np.linspace(-1.2, 1.2, 10) * band if band > 0.0 else e[110:120]
    return e, enabled


def _errors_for_openings(controller: Controller, openings: Array, enabled: Array) -> Array:
    """Return the errors, K, for which the PI gives these openings, except for a dead band or the limit of errors."""
    number = controller.number
    kp, ki = number["kp"], number["kp"] * number["sample_time"] / number["ti"]
    e, integral = np.zeros(openings.size), 0.0
    for k, u in enumerate(openings):
        e[k] = min(max((u - integral) / (kp + ki), -_LARGEST_ERROR_K), _LARGEST_ERROR_K) if kp != 0.0 else u
        integral = min(max(integral + ki * e[k], 0.0), 1.0) if enabled[k] else 0.0
    return e


def _errors_for_learner(controller: Controller) -> Array:
    """Return errors, K, that make some turns in the reference intervals of a learner, then none, few or many."""
    number = controller.number
    n = int(number["learning_interval"] / number["sample_time"])
    k = np.arange(n)
    some = 0.5 + 0.02 * np.where(k % 8 < 4, k % 4, 4 - k % 4)
    none = 0.45 + 0.1 * k / n
    many = 0.5 + 0.02 * (-1.0) ** k
    large_errors = 0.5 + 0.3 * (-1.0) ** (k // 10)  # few turns, large errors
    reference = [some] * (int(number["learning_reference"]) + 2)
    openings = np.concatenate([*reference, none, none, large_errors, many, none, many, many, none])
    return _errors_for_openings(controller, openings, np.ones(openings.size))


def _errors_for_hagglund(controller: Controller) -> Array:
    """Return errors with half periods that Hägglund's rule counts, K: each long enough for the PI to cross a gap."""
    number = controller.number
    n = math.ceil(7.0 * number["ti"] / number["sample_time"]) + 2
    size = 0.15 * number["ti"] / (abs(number["kp"]) * n * number["sample_time"])
    halves = range(int(number["hagglund_least_half_periods"]) + 4)
    sides = [np.full(n + side % 3, size * (1.0 + 0.1 * (side % 4)) * (-1.0) ** side) for side in halves]
    return np.concatenate([np.full(n, 0.35 / 0.15 * size), *sides])

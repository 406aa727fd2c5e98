"""Golden vectors: made-up records that take a controller through all that it does, and what fastcoil makes of them.

Each row is a cycle: what the controller sees, and what fastcoil's own kernel answers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.machine import package_version
from fastcoil.deliver.export.controller import Controller
from fastcoil.loops.boundary.days import heating_day, paper_day
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.measured.replay import replay

OUTPUTS = {"command": "command", "u": "u", "integral_part": "integral", "rising": "mode", "estimate": "estimate"}
"""What the code calls a trace."""
_HOURS, _HOURS_TO_IDENTIFY = 1, 3  # of the simulated day: an estimate from steps of the set-point takes longer
_LIMITS = -50.0, 150.0
_LARGEST_ERROR = 25.0  # K; a reading stays plausible
_MOST_CYCLES = 6000  # of a record: intervals of a day would fill a disk
_OFF = (95, 103, 150)  # cycles at which the plant goes off for the next four


@dataclass(frozen=True)
class Vectors:
    """Columns by name, each with a value for every cycle; n_made: those of the first run."""

    columns: dict[str, Array]
    inputs: tuple[str, ...]
    n_made: int

    @property
    def outputs(self) -> tuple[str, ...]:
        """What a port must give."""
        return tuple(name for name in self.columns if name not in self.inputs)

    def csv(self, code: str, sample_time: float) -> str:
        """As a text file, numbers with 17 digits."""
        lines = [
            f"# Vectors for {code}, written by fastcoil {package_version()}: a row for each {sample_time:g} s cycle.",
            f"# Given: {', '.join(self.inputs)}; the start command is 0.  A row with reset = 1 begins a run.",
            f"# Expected after the cycle, to 1e-12: {', '.join(self.outputs)}.",
            "# The first runs are made-up records, replayed; then comes the loop on a simulated day.",
            ",".join(self.columns),
        ]
        rows = zip(*(column.tolist() for column in self.columns.values()), strict=True)
        return "\n".join([*lines, *(",".join(f"{value:.17g}" for value in row) for row in rows)]) + "\n"


def vectors_of(loop: Loop, controller: Controller) -> Vectors:
    """Replay made-up records through the loop's controller, and simulate the loop on a day."""
    runs = [*(_replayed(loop, controller, seen) for seen in _records(controller)), _simulated(loop, controller)]
    if controller.word["estimator"] == "identify":
        runs.append(_simulated(loop, controller, disturbed=True))
    inputs = ("T_sup", "T_set", *(["m_a"] if controller.sees_air else []), "enabled", "reset")
    lacks = {"estimate": controller.estimating is None, "integral_part": controller.deciding is not None}
    outputs = [name for name in (*OUTPUTS, "switches") if not lacks.get(name, False)]
    columns = {name: np.concatenate([run[name] for run in runs]) for name in (*inputs, *outputs)}
    return Vectors(columns, inputs, runs[0]["T_sup"].size)


def _replayed(loop: Loop, controller: Controller, seen: dict[str, Array]) -> dict[str, Array]:
    sample_time = int(controller.number["sample_time"])
    time = {"elapsed_time": ("elapsed_time", sample_time * np.arange(seen["T_sup"].size), {"units": "s"})}
    units = {"T_sup": "degC", "T_set": "degC", "enabled": "1"} | ({"m_a": "kg s-1"} if controller.sees_air else {})
    log = xr.Dataset({name: ("elapsed_time", seen[name], {"units": unit}) for name, unit in units.items()}, time)
    return _rows(replay(loop, log, trace_interval=sample_time), seen)


def _simulated(loop: Loop, controller: Controller, *, disturbed: bool = False) -> dict[str, Array]:
    """The loop on its generic day, with gusts and some time off if it is to be disturbed."""
    hours = _HOURS_TO_IDENTIFY if controller.word["estimator"] == "identify" else _HOURS
    day = heating_day(hours) if controller.heats else paper_day(hours)
    sample_time, band = int(controller.number["sample_time"]), controller.number["error_dead_band"]
    if band > 0.0:  # steps that it would not answer are refused
        T_set = day.series["T_set"][0]
        day = day.assign(T_set=T_set[0] + (1.0 + 2.0 * band) * (T_set - T_set[0]))
    enabled = np.ones(day.series["T_set"].shape[1])
    if disturbed:
        second = np.arange(enabled.size)
        enabled[(second // sample_time >= 3900 // sample_time) & (second // sample_time < 4500 // sample_time)] = 0.0
        day = day.assign(m_a=day.series["m_a"][0] * np.where(second % 3000 < 2400, 1.0, 0.8), enabled=enabled)
    traces = ["T_measured", *OUTPUTS.values()]
    ds = simulate(loop, day, traces=traces, trace_interval=sample_time, warm_up=0, n_jobs=1, progress=False)
    series = {name: np.asarray(day.series[name][0])[::sample_time] for name in ("T_set", "m_a")}
    T_sup = ds["T_measured"].values
    rows = _rows(ds, {"T_sup": T_sup, **series, "enabled": enabled[::sample_time]})
    good = (T_sup > _LIMITS[0]) & (T_sup < _LIMITS[1])
    end = T_sup.size if bool(good.all()) else int(np.argmin(good))
    return {name: values[:end] for name, values in rows.items()}


def _rows(ds: xr.Dataset, inputs: dict[str, Array]) -> dict[str, Array]:
    reset = np.zeros(inputs["T_sup"].size)
    reset[0] = 1.0
    outputs = {name: ds[trace].values for name, trace in OUTPUTS.items()}
    rising = (outputs["rising"] > 0.0).astype(float)
    switches = np.cumsum(np.abs(np.diff(rising, prepend=0.0)))
    return inputs | {"reset": reset} | outputs | {"rising": rising, "switches": switches}


def _records(controller: Controller) -> list[dict[str, Array]]:
    """A tour of PI and inverse for every controller, and a record for estimators that need another."""
    e, enabled = _tour(controller)
    T_set = np.full(e.size, 24.0 if controller.heats else 14.0)
    T_set[60:] += 1.0 + 2.0 * controller.number["error_dead_band"]
    T_set[130:] -= 0.5
    found = [_seen(controller, e, T_set, enabled)]
    special = {"learner": _intervals, "hagglund": _square_waves}.get(controller.word["estimator"])
    if special is not None:
        e = special(controller)[:_MOST_CYCLES]
        found.append(_seen(controller, e, np.full(e.size, T_set[0]), np.ones(e.size)))
    return found


def _seen(controller: Controller, e: Array, T_set: Array, enabled: Array) -> dict[str, Array]:
    T_sup = T_set - e if controller.heats else T_set + e
    resolution = controller.number["sensor_resolution"]
    T_sup = resolution * np.floor(T_sup / resolution + 0.5) if resolution > 0.0 else T_sup
    m_a = np.where(np.arange(e.size) % 400 < 250, 1.2, 1.0)
    return {"T_sup": T_sup, "T_set": T_set, "m_a": m_a, "enabled": enabled}


def _tour(controller: Controller) -> tuple[Array, Array]:
    """Errors, K, and when the plant is on: along the stroke to its ends, back and forth, off and on."""
    number = controller.number
    k, band = np.arange(30), number["error_dead_band"]
    # a weak or slow PI takes its time from one end to the other
    slowly = 1.5 * number["ti"] / max(abs(number["kp"]) * number["sample_time"] * _LARGEST_ERROR, 1e-9)
    crossing = min(math.ceil(slowly), _MOST_CYCLES // 4)
    wanted = np.concatenate(
        [
            *(np.linspace(0.05, 0.7, 15), np.linspace(0.68, 0.3, 15)),
            *(np.linspace(0.4, 1.4, 10), np.linspace(0.9, -0.4, 20)),
            0.5 + 0.3 * np.sin(2.0 * np.pi * k / 15.0),
            0.4 + 0.01 * np.sin(2.0 * np.pi * k / 3.0 + 0.5) + 0.001 * k,
            0.6 + 1e-12 * (-1.0) ** k[:10],  # round-off, which is no turn
            0.5 + 0.02 * (-1.0) ** k,
            np.linspace(0.5, 0.9, 20),
            np.random.default_rng(17).uniform(0.2, 0.8, 40),
            *(np.full(crossing, 1.5), np.full(crossing, -0.5)),
        ]
    )
    enabled = np.ones(wanted.size)
    for start in _OFF:
        enabled[start : start + 4] = 0.0
    e = _errors(controller, wanted, enabled)
    e[110:120] = np.linspace(-1.2, 1.2, 10) * band if band > 0.0 else e[110:120]
    return e, enabled


def _errors(controller: Controller, wanted: Array, enabled: Array) -> Array:
    """The errors that the PI answers with the openings wanted, K.

    A dead band, or the limit of the error, takes it elsewhere, which does no harm.
    """
    number = controller.number
    kp, ki = number["kp"], number["kp"] * number["sample_time"] / number["ti"]
    e, integral = np.zeros(wanted.size), 0.0
    for k, u in enumerate(wanted):
        e[k] = min(max((u - integral) / (kp + ki), -_LARGEST_ERROR), _LARGEST_ERROR) if kp != 0.0 else u
        integral = min(max(integral + ki * e[k], 0.0), 1.0) if enabled[k] else 0.0
    return e


def _intervals(controller: Controller) -> Array:
    """Errors over the intervals of a learner, K: some turns in those of the reference, then none, few or many."""
    number = controller.number
    n = int(number["learning_interval"] / number["sample_time"])
    k = np.arange(n)
    some = 0.5 + 0.02 * np.where(k % 8 < 4, k % 4, 4 - k % 4)
    none = 0.45 + 0.1 * k / n
    many = 0.5 + 0.02 * (-1.0) ** k
    far = 0.5 + 0.3 * (-1.0) ** (k // 10)  # few turns, large errors
    first = [some] * (int(number["learning_reference"]) + 2)
    wanted = np.concatenate([*first, none, none, far, many, none, many, many, none])
    return _errors(controller, wanted, np.ones(wanted.size))


def _square_waves(controller: Controller) -> Array:
    """Errors of half periods that Hägglund's rule counts, K: each as long as the PI needs to cross a gap."""
    number = controller.number
    n = math.ceil(7.0 * number["ti"] / number["sample_time"]) + 2
    size = 0.15 * number["ti"] / (abs(number["kp"]) * n * number["sample_time"])
    halves = range(int(number["hagglund_least_half_periods"]) + 4)
    sides = [np.full(n + side % 3, size * (1.0 + 0.1 * (side % 4)) * (-1.0) ** side) for side in halves]
    return np.concatenate([np.full(n, 0.35 / 0.15 * size), *sides])

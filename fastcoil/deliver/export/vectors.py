"""Golden vectors: what the controller sees and what fastcoil's own kernel makes of it, cycle by cycle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.machine import package_version
from fastcoil.deliver.export.controller import Controller
from fastcoil.deliver.export.record import Inputs, made_records
from fastcoil.loops.boundary.days import heating_day, paper_day
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.measured.replay import replay

OUTPUTS = {"command": "command", "u": "u", "integral_part": "integral", "rising": "mode", "estimate": "estimate"}
"""What the code calls a trace."""
_HOURS, _HOURS_TO_IDENTIFY = 1, 3
"""Of the simulated day: an estimate from steps of the set-point takes longer."""
_LIMITS = -50.0, 150.0


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

    def exercised(self) -> str:
        """What the cycles contain, in words."""
        u, rising, reset = self.columns["u"], self.columns["rising"], self.columns["reset"]
        within = reset[1:] == 0.0
        found = {
            "turns of the inverse": int(np.sum((np.diff(rising) != 0.0) & within)),
            "cycles with u = 0": int(np.sum(u == 0.0)),
            "with u = 1": int(np.sum(u == 1.0)),
            "switched off": int(np.sum(self.columns["enabled"] == 0.0)),
        }
        if "estimate" in self.columns:
            change = np.diff(self.columns["estimate"])[within]
            found |= {"changes of the estimate up": int(np.sum(change > 0.0)), "down": int(np.sum(change < 0.0))}
        return ", ".join(f"{n} {what}" for what, n in found.items())

    def csv(self, code: str, sample_time: float) -> str:
        """As a text file, numbers with 17 digits."""
        lines = [
            f"# Vectors for {code}, written by fastcoil {package_version()}: a row for each {sample_time:g} s cycle.",
            f"# Given: {', '.join(self.inputs)}; the start command is 0.  A row with reset = 1 begins a run.",
            f"# Expected after the cycle, to 1e-12: {', '.join(self.outputs)}.",
            "# The first runs are made-up records, replayed; then comes the loop on a simulated day.",
            f"# In them: {self.exercised()}.",
            ",".join(self.columns),
        ]
        rows = zip(*(column.tolist() for column in self.columns.values()), strict=True)
        return "\n".join([*lines, *(",".join(f"{value:.17g}" for value in row) for row in rows)]) + "\n"


def vectors_of(loop: Loop, controller: Controller) -> Vectors:
    """Replay made-up records through the loop's controller, and simulate the loop on a day."""
    runs = [*(_replayed(loop, controller, seen) for seen in made_records(controller)), _simulated(loop, controller)]
    if controller.estimator == "identify":
        runs.append(_simulated(loop, controller, disturbed=True))
    inputs = ("T_sup", "T_set", *(["m_a"] if controller.sees_air else []), "enabled", "reset")
    lacks = {"estimate": not controller.has_estimate, "integral_part": controller.deciding is not None}
    outputs = [name for name in (*OUTPUTS, "switches") if not lacks.get(name, False)]
    columns = {name: np.concatenate([run[name] for run in runs]) for name in (*inputs, *outputs)}
    return Vectors(columns, inputs, runs[0]["T_sup"].size)


def _replayed(loop: Loop, controller: Controller, seen: Inputs) -> dict[str, Array]:
    sample_time = int(controller.number["sample_time"])
    time = {"elapsed_time": ("elapsed_time", sample_time * np.arange(seen.T_sup.size), {"units": "s"})}
    units = {"T_sup": "degC", "T_set": "degC", "enabled": "1"}
    if controller.sees_air:
        units["m_a"] = "kg s-1"
    log = xr.Dataset({name: ("elapsed_time", getattr(seen, name), {"units": u}) for name, u in units.items()}, time)
    ds = replay(loop, log, trace_interval=sample_time)
    return _rows(ds, {"T_sup": seen.T_sup, "T_set": seen.T_set, "m_a": seen.m_a, "enabled": seen.enabled})


def _simulated(loop: Loop, controller: Controller, *, disturbed: bool = False) -> dict[str, Array]:
    """The loop on its generic day, with gusts and some time off if it is to be disturbed."""
    hours = _HOURS_TO_IDENTIFY if controller.estimator == "identify" else _HOURS
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

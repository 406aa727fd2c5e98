"""Whole runs with every feature of the package; a script that writes all their numbers: OUT.npz FEATURE …."""

from __future__ import annotations

import sys
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.model.metric_table import TRACES
from helpers.simulated_logs import coil_log, flows, log_of, walk

WAYS: dict[str, dict[str, object]] = {
    "plain": {},
    "buffered": {"backlash_estimate": 0.06, "buffer": 0.01},
    "learning": {"learning_step": 0.02, "learning_early_trip": 1.0, "sample_time": 5},
    "once": {"learning_step": 0.02, "learning_stop": "first_step_down"},
    "slow": {"sensor_time_constant": 30.0, "stroke_time": 90.0},
    "coarse": {"sensor_resolution": 0.1, "command_resolution": 0.01},
    "small": {"n_volumes": 3},
    "quasistatic": {"air_march": "quasistatic"},
}
"""Loops with one feature each."""


def study_text(seconds: int, days: int) -> str:
    """A study with all of them, on some days."""
    plain = {n: fc.parameters()[n].default for way in WAYS.values() for n in way}
    cases = "\n".join(
        f"{name} = {{ {', '.join(f'{n} = {v!r}' for n, v in (plain | way).items())} }}" for name, way in WAYS.items()
    )
    return f"""
title = "every feature"
[loop]
noise_std = 0.02
learning_interval = 600
[sweep]
backlash = [0.0, 0.07]
[cases.way]
{cases}
[boundary]
hours = {seconds / 3600!r}
seed = {list(range(1, days + 1))}
[run]
warm_up = {seconds // 2}
replicates = 2
traces = {list(TRACES)!r}
trace_interval = 7
"""


def study(folder: Path, seconds: int = 1500, days: int = 2) -> xr.Dataset:
    """What a study file can say, run by the command line."""
    from fastcoil.cli.main import main

    file, out = folder / "every.toml", folder / "out"
    file.write_text(study_text(seconds, days))
    with suppress(SystemExit):
        main(["run", str(file), "-o", str(out), "-j", "2", "--no-figures"])
    return fc.open_study(out).load()


def short_study(folder: Path) -> xr.Dataset:
    """The same for some seconds: for the interpreter, which is slow."""
    return study(folder, 8, 1)


def heating(_: Path) -> xr.Dataset:
    """A heating coil, off at first and in the end."""
    day = fc.design_day(1.0, "heating").series
    enabled = np.ones(3600)
    enabled[:300] = enabled[3000:] = 0.0
    boundary = fc.Boundary(**{name: values[0] for name, values in day.items()} | {"enabled": enabled})
    loop = fc.Loop.preset("lbnl").assign(
        action="heating", backlash=[0.0, 0.07], kp=0.0045, noise_std=0.02, learning_step=0.02, learning_interval=600
    )
    return fc.simulate(loop, boundary, warm_up=0, traces=list(TRACES), trace_interval=100)


def open_loop(_: Path) -> xr.Dataset:
    """Recorded commands."""
    command = np.linspace(0.0, 1.0, 900)
    loop = fc.Loop(backlash=[0.02, 0.15], n_volumes=[4, 8], stroke_time=60.0)
    return fc.simulate(loop, fc.paper_day(0.25), warm_up=0, command=command, traces=list(TRACES), trace_interval=10)


def replayed(_: Path) -> xr.Dataset:
    """Controllers on a record."""
    day = fc.paper_day(0.25)
    log = fc.simulate(fc.Loop(), day, traces=["T_sup"], warm_up=0)[["T_sup"]]
    log["T_set"] = day.to_dataset()["T_set"]
    return fc.replay(fc.Loop(backlash_estimate=[0.0, 0.05], learning_step=0.01, learning_interval=600), log)


def valve_fit(_: Path) -> dict[str, float]:
    """The valve kernel."""
    command = walk(np.random.default_rng(1), n=200)
    return dict(fc.fit_valve(log_of(command, flows(command)), split=1.0).parameters)


def coil_fit(_: Path) -> dict[str, float]:
    """The coil kernel."""
    return dict(fc.fit_coil(coil_log(hours=0.5, seed=1), split=1.0, warm_up=100).parameters)


FEATURES = {f.__name__: f for f in (study, short_study, heating, open_loop, replayed, valve_fit, coil_fit)}


def numbers(found: xr.Dataset | dict[str, float]) -> dict[str, np.ndarray]:
    """All numbers of a result."""
    if isinstance(found, dict):
        return {name: np.array(float(value)) for name, value in found.items()}
    return {str(name): v.values for name, v in found.data_vars.items() if v.dtype.kind in "fi"}


def main() -> None:
    """Run some features."""
    out = Path(sys.argv[1])
    warnings.simplefilter("ignore")
    found = {}
    for feature in sys.argv[2:]:
        found |= {f"{feature}.{name}": v for name, v in numbers(FEATURES[feature](out.parent)).items()}
    np.savez(out, **found)


if __name__ == "__main__":
    main()

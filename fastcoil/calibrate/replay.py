"""``replay``: what a controller would have commanded on a recorded day, without acting on it (shadow mode)."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.arguments import whole_number_problems
from fastcoil.boundary.series import Array
from fastcoil.calibrate.data import Log, read_log
from fastcoil.engine.lanes import parameter_matrix
from fastcoil.engine.replay_loop import REPLAY_COLUMNS, REPLAY_TRACES, run_replay
from fastcoil.errors import InputError
from fastcoil.outputs import TRACES
from fastcoil.simulation.dataset import attributes, coordinate_attrs, provenance
from fastcoil.simulation.loop import Loop
from fastcoil.simulation.resources import available_memory, gib
from fastcoil.simulation.scenarios import columns_of


def replay(
    loop: Loop,
    log: Any,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, float] | None = None,
    trace_interval: int = 1,
    max_gap: float | None = None,
) -> xr.Dataset:
    """Feed recorded temperatures and set-points to the controllers of a loop, and return what they command.

    The loop stays open: the commands do not change the record.  Plant and sensor parameters play no part, but for
    ``sensor_resolution``; noise is what the record has.

    Parameters
    ----------
    loop
        One loop or a sweep of them: PI, inverse and learner.
    log
        Path of a CSV file or a Dataset with ``T_sup`` (as the controller read it), ``T_set``, if there ``enabled``,
        and ``elapsed_time`` or ``timestamp``; samples 1 s apart or more.  A value holds until the next.
    units, columns, constants
        As in ``fc.Boundary.from_csv``.
    trace_interval
        Seconds between the samples of the result.
    max_gap
        Longest step to be bridged [s]; three times the median step if left out.

    Returns
    -------
    xarray.Dataset
        ``u``, ``integral``, ``command``, ``estimate``, ``mode`` over the dims of the sweep and ``elapsed_time``.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments.

    Notes
    -----
    Cai and Braun (2016), section 3.3 and Fig 8.  Fed with ``T_measured`` of a simulation it returns that simulation's
    commands to the last bit.
    """
    if not isinstance(loop, Loop):
        raise InputError(f"loop is a {type(loop).__name__}: give a fastcoil.Loop")
    data = read_log(
        log, ["T_sup", "T_set"], optional=["enabled"], units=units, columns=columns, constants=constants,
        max_gap=max_gap,
    )  # fmt: skip
    series = _seconds(data)
    problems = whole_number_problems("trace_interval", trace_interval, 1, series.shape[0])
    if problems:
        raise InputError(problems)
    n = math.prod(loop.sizes.values())
    points = np.arange(0, series.shape[0], trace_interval)
    needed = 8 * n * len(REPLAY_TRACES) * points.size
    if 2 * needed > available_memory():
        raise InputError(f"the commands need {gib(needed)} of memory: raise trace_interval or sweep fewer values")
    found = run_replay(parameter_matrix(columns_of(loop, loop.sizes, np.arange(n))), series, trace_interval)
    ds = xr.Dataset(coords={name: c.assign_attrs(coordinate_attrs(name)) for name, c in loop.coordinates().items()})
    ds = ds.assign_coords(
        elapsed_time=("elapsed_time", points.astype(float), coordinate_attrs("elapsed_time")),
    )
    for name, values in found.items():
        shape = (*loop.sizes.values(), points.size)
        ds[name] = ((*loop.sizes, "elapsed_time"), values.T.reshape(shape), attributes(TRACES[name]))
    ds.attrs = {"title": "fastcoil replay", **provenance(), "parameters": json.dumps(loop.constants), "log": data.name}
    return ds


def _seconds(data: Log) -> Array:
    """What the controller sees at every second, (n_steps, 3): the last recorded values."""
    if data.batch[-1] > 0:
        k = int(np.argmax(data.batch > 0))
        raise InputError(
            f"{data.name}: the record is broken between rows {data.rows[k - 1]} and {data.rows[k]}: cut the log "
            f"there, or bridge it: max_gap={data.time[k] - data.time[k - 1]:g}"
        )
    if data.step < 0.999:
        raise InputError(f"{data.name}: rows are {data.step:g} s apart: thin the log to 1 s or more")
    values = {"enabled": np.ones(data.time.size), **data.values}
    seconds = np.arange(int(data.time[-1] + 1e-6) + 1)
    latest = np.searchsorted(data.time, seconds + 1e-6, side="right") - 1
    return np.stack([values[name][latest] for name in REPLAY_COLUMNS], axis=1)

"""``replay``: what a controller would have commanded on a recorded day, without acting on it (shadow mode)."""

from __future__ import annotations

import json
import math

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, raise_problems, require_instance, require_integer
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.base.machine import available_memory, format_bytes
from fastcoil.logs import CheckedLog, warn_of_reading_notes
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.log import as_log
from fastcoil.logs.pieces import require_span_in_limits, require_whole_seconds, resample_at_seconds
from fastcoil.loops.clashes import controller_clashes, missing_parameters
from fastcoil.loops.loop import Loop, used_choices
from fastcoil.loops.provenance import provenance
from fastcoil.loops.scenarios import cf_attributes, coordinate_attrs, parameter_columns
from fastcoil.measured.part import LogSource
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.engine.recorded import REPLAY_COLUMNS, REPLAY_TRACES, run_replay
from fastcoil.model.estimators.registry import ESTIMATORS
from fastcoil.model.metric_table import TRACES
from fastcoil.model.user_rules import rules_for_kernels


@np.errstate(all="ignore")
def replay(loop: Loop, log: LogSource, *, trace_interval: int = 1) -> xr.Dataset:
    """Feed recorded temperatures and set-points to the controllers of a loop; return their commands.

    The loop stays open: the commands do not change the record.  Plant and sensor parameters play no part, except
    ``sensor_resolution``, and ``noise_std`` where it sizes the buffer; the record has its own noise.

    Parameters
    ----------
    loop : Loop
        One loop or a sweep of them: PI, or a law of the user, inverse and estimator.
    log : path, DataFrame, Dataset or Log
        Needed: ``T_sup`` (as the controller read it), ``T_set``, and ``elapsed_time`` or ``timestamp``; optional:
        ``enabled``, and ``m_a``, after whose steps the estimators ``gradient`` and ``identify`` pause.  Samples are 1 s
        apart or more; a value holds until the next.  `read_log` has the options of reading.
    trace_interval : int, default 1
        Time between the samples of the result, s.

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
    Cai and Braun (2016), section 3.3 and Fig 8.  With ``T_measured`` of a simulation as ``T_sup`` it returns the
    commands of that simulation to the last bit.

    Examples
    --------
    >>> day = fc.paper_day(hours=1)
    >>> ds = fc.simulate(fc.Loop(), day, traces=["T_measured", "command"])
    >>> log = day.to_dataset()[["T_set"]].assign(T_sup=ds["T_measured"])
    >>> bool((fc.replay(fc.Loop(), log)["command"] == ds["command"]).all())
    True
    """
    with argument_checks() as check:
        check(require_instance, "loop", loop, Loop, "give a fastcoil.Loop")
        source = check(as_log, "log", log)
        trace_interval = check(require_integer, "trace_interval", trace_interval, 1)
    raise_problems(missing_parameters(loop))
    air_estimators = {estimator.name for estimator in ESTIMATORS if estimator is not None and estimator.sees_air}
    sees_air = bool(loop.rules) or not air_estimators.isdisjoint(used_choices(loop, "estimator"))
    optional = ("enabled", "m_a") if sees_air else ("enabled",)
    data = source.read(ColumnSpec(("T_sup", "T_set"), optional), refuse_gaps=True)
    warn_of_reading_notes(data.name, data.notes)
    series = _controller_inputs(data)
    raise_problems(controller_clashes(loop, series[:, REPLAY_COLUMNS.index("T_set")]))
    require_integer("trace_interval", trace_interval, 1, series.shape[0])
    ds = run_controllers(loop, series, trace_interval)
    ds.attrs = {"title": "fastcoil replay", **provenance(), "parameters": json.dumps(loop.constants), "log": data.name}
    return ds


def run_controllers(loop: Loop, series: Array, trace_interval: int) -> xr.Dataset:
    """Commands of the controllers of a loop; series: ``REPLAY_COLUMNS`` at every second, (n_steps, 4)."""
    n = math.prod(loop.sizes.values())
    points = np.arange(0, series.shape[0], trace_interval)
    needed_bytes = 8 * n * len(REPLAY_TRACES) * points.size
    if 2 * needed_bytes > available_memory():
        words = f"the commands need {format_bytes(needed_bytes)} of memory"
        raise InputError(f"{words}: raise trace_interval or sweep fewer values", "trace_interval", "size")
    rules = rules_for_kernels(loop.rules)
    matrix = parameter_matrix(parameter_columns(loop, loop.sizes, np.arange(n)), rules)
    ds = xr.Dataset(coords={name: c.assign_attrs(coordinate_attrs(name)) for name, c in loop.coordinates().items()})
    ds = ds.assign_coords(elapsed_time=("elapsed_time", points.astype(float), coordinate_attrs("elapsed_time")))
    for name, values in run_replay(matrix, series, trace_interval, rules).items():
        shape = (*loop.sizes.values(), points.size)
        ds[name] = ((*loop.sizes, "elapsed_time"), values.T.reshape(shape), cf_attributes(TRACES[name]))
    return ds


def _controller_inputs(log: CheckedLog) -> Array:
    """Inputs of the controller at every second, (n_steps, 4): the last recorded values, NaN for an unknown air flow."""
    require_whole_seconds(log.name, log.step)
    require_span_in_limits(log.name, float(log.time[-1]))
    recorded = {"enabled": np.ones(log.time.size), "m_a": np.full(log.time.size, np.nan), **log.values}
    values = {name: recorded[name] for name in REPLAY_COLUMNS}
    seconds = np.arange(int(log.time[-1] + 1e-6) + 1, dtype=float)
    return np.stack(list(resample_at_seconds(log.time, values, seconds, REPLAY_COLUMNS, 1e-6).values()), axis=1)

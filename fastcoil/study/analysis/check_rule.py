"""Whether a compiled rule does what its Python says: both see the same samples of a closed loop."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, instance_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import paper_day
from fastcoil.loops.loop import Loop, forgetting
from fastcoil.loops.scenarios import Layout, columns_of
from fastcoil.loops.simulate import simulate
from fastcoil.model.control import FALLING
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.engine.rows import PARAMETER_ROWS
from fastcoil.model.estimators.interface import Sample, defaults_of
from fastcoil.model.metric_table import STATUS_MEANINGS, STATUS_OK
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.model.user_rules import Rule, rules_for_kernels

TOLERANCE = 1e-9
"""Fraction of stroke up to which two estimates, or two openings, count as one."""
_TRACES = ("T_measured", "u", "command", "mode", "estimate")


class _Run(NamedTuple):
    """A run of the compiled rule: the parameters of its loop, its traces and its boundary, second by second."""

    parameters: dict[str, float]
    traces: dict[str, Array]
    series: dict[str, Array]
    switches: Array

    def sample(self, t: int, seen_at: int, estimate: float) -> Sample:
        """What a rule sees at second t of a temperature measured at ``seen_at``."""
        sign = 1.0 - 2.0 * self.parameters["action"]
        T, T_set = float(self.traces["T_measured"][seen_at]), self.series["T_set"]
        held = [float(self.traces[n][t - 1]) for n in ("u", "command", "mode")] if t else [0.0, 0.0, FALLING]
        m_a, e = float(self.series["m_a"][t]), sign * (T - float(T_set[seen_at]))
        switches = float(self.switches[t - 1]) if t else 0.0
        u, command, mode = held
        return Sample(float(t), float(T_set[t]), m_a, T, e, u, command, mode, switches, estimate)


def check_rule(rule: Rule, loop: Loop | None = None, boundary: Boundary | None = None) -> float:
    """Run a rule of your own twice over a short closed loop, compiled and as plain Python, and compare.

    Parameters
    ----------
    rule
        What ``@fc.estimator`` or ``@fc.law`` made.
    loop
        One loop, with the rule's parameters; ``fc.Loop()`` by default.
    boundary
        One day; two hours of ``fc.paper_day()`` by default.

    Returns
    -------
    float
        The largest difference between the two, of the estimate or of u, as a fraction of stroke.

    Raises
    ------
    InputError
        If the rule does not compile; if the two differ by more than 1e-9, with the first sample at which they do; if
        the Python raises an error; if the loop fails, as it does where a rule returns NaN.
    """
    with checking() as check:
        check(instance_of, "rule", rule, Rule, "give a function with @fc.estimator(…) or @fc.law(…) before it")
        check.unless_none(instance_of, "loop", loop, Loop, "give a fastcoil.Loop")
        check.unless_none(instance_of, "boundary", boundary, Boundary, "give a fastcoil.Boundary")
    loop = (Loop() if loop is None else loop).assign(**{rule.kind: rule})
    boundary = paper_day(hours=2) if boundary is None else boundary
    if loop.sizes or boundary.has_day_dim:
        several = ", ".join(["day"] * boundary.has_day_dim + list(loop.sizes))
        raise InputError(f"check_rule takes one loop and one day: leave out the dims {several}")
    _call_once(rule, loop, boundary)
    ds = simulate(loop, boundary, traces=list(_TRACES), warm_up=0, n_jobs=1, progress=False)
    if int(ds["status"]) != STATUS_OK:
        raise InputError(
            f"{rule.name}: the loop ends with the status {STATUS_MEANINGS[int(ds['status'])]}: a rule must return "
            "finite numbers"
        )
    return _largest_difference(rule, _run_of(loop, boundary, ds))


def _run_of(loop: Loop, boundary: Boundary, ds: xr.Dataset) -> _Run:
    loop = Layout(loop, boundary).loop
    rules = rules_for_kernels(loop.rules)
    row = parameter_matrix(columns_of(loop, {}, np.array([0])), rules)[:, 0]
    traces = {n: ds[n].values.astype(float) for n in _TRACES}
    series = {n: np.ravel(values) for n, values in boundary.series.items()}
    turned = np.diff(traces["mode"], prepend=FALLING) != 0.0
    return _Run(dict(zip((*PARAMETER_ROWS, *rules.own), row.tolist(), strict=True)), traces, series, np.cumsum(turned))


def _call_once(rule: Rule, loop: Loop, boundary: Boundary) -> None:
    """Call the plain Python with the first sample, which is the same without the rule: before it is compiled."""
    without = forgetting(loop.assign(**{rule.kind: PARAMETERS[rule.kind].choices[0]}), {rule.name})
    ds = simulate(without, boundary, traces=list(_TRACES), warm_up=0, n_jobs=1, progress=False)
    run = _run_of(without, boundary, ds)
    is_law = rule.kind == "law"
    t = 0 if is_law else int(run.parameters["sample_time"])
    if int(ds["status"]) != STATUS_OK or t >= ds.sizes["elapsed_time"] or not run.series["enabled"][t]:
        return
    _, Parameters, Memory = rule.parts
    values: dict[str, Any] = dict(loop.items())
    p = Parameters(*(run.parameters[n] if n in run.parameters else float(values[n]) for n in Parameters._fields))
    _called(rule, run.sample(t, 0, float(run.traces["estimate"][0])), p, Memory(*defaults_of(Memory)))


def _largest_difference(rule: Rule, run: _Run) -> float:
    _, Parameters, Memory = rule.parts
    is_law, compiled = rule.kind == "law", run.traces["u" if rule.kind == "law" else "estimate"]
    p = Parameters(*(run.parameters[n] for n in Parameters._fields))
    begin = Memory(*defaults_of(Memory))
    memory, estimate, largest = begin, float(run.traces["estimate"][0]), 0.0
    sample_time = int(run.parameters["sample_time"])
    for t in range(compiled.size):
        if not run.series["enabled"][t]:
            memory = begin if is_law else memory
            continue
        if t % sample_time or (t == 0 and not is_law):
            continue
        seen_at = t if is_law else t - sample_time
        now = run.sample(t, seen_at, float(run.traces["estimate"][t]) if is_law else estimate)
        found, memory = _called(rule, now, p, memory)
        estimate = found
        difference = abs(found - float(compiled[t]))
        if not difference <= TOLERANCE:
            raise InputError(
                f"{rule.name} compiled and in plain Python differ from t = {t} s on: {compiled[t]:.12g} and "
                f"{found:.12g}; look for a test that hangs on the last digit, or whole numbers that grow large"
            )
        largest = max(largest, difference)
    return largest


def _called(rule: Rule, now: Sample, p: Any, memory: Any) -> tuple[float, Any]:
    """The answer of the plain Python, limited to 0–1 as that of the compiled rule is."""
    try:
        found, memory = rule(now, p, memory)
        return min(max(float(found), 0.0), 1.0) if not math.isnan(found) else math.nan, memory
    except Exception as error:  # a user's code may raise anything
        raise InputError(
            f"{rule.name} raises {type(error).__name__} in plain Python at t = {now.t:g} s, where the compiled rule "
            f"goes on: {error}; leave no such case open"
        ) from None

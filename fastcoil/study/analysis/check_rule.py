"""Whether a compiled rule does what its Python says: both see the same samples of a closed loop."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

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

TOLERANCE = 1e-9  # fraction of stroke up to which two estimates, or two openings, count as one
_TRACES = ("T_measured", "u", "command", "mode", "estimate")


class _Run(NamedTuple):
    """A run of the compiled rule: the parameters of its loop, its traces and its boundary, second by second."""

    status: int
    parameters: dict[str, float]
    traces: dict[str, Array]
    series: dict[str, Array]
    switches: Array

    def sample(self, t: int, seen_at: int, estimate: float) -> Sample:
        """What a rule sees at second t of a temperature measured at ``seen_at``."""
        sign = 1.0 - 2.0 * self.parameters["action"]
        T, T_set = float(self.traces["T_measured"][seen_at]), self.series["T_set"]
        u, command, mode = (
            [float(self.traces[n][t - 1]) for n in ("u", "command", "mode")] if t else (0.0, 0.0, FALLING)
        )
        m_a, e = float(self.series["m_a"][t]), sign * (T - float(T_set[seen_at]))
        switches = float(self.switches[t - 1]) if t else 0.0
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
    _, Parameters, _ = rule.parts
    # the first sample is the same without the rule: its Python is called with it before anything is compiled
    run = _run_of(forgetting(loop.assign(**{rule.kind: PARAMETERS[rule.kind].choices[0]}), {rule.name}), boundary)
    known: dict[str, Any] = {**dict(loop.items()), **run.parameters}
    if run.status == STATUS_OK:
        next(_replayed(rule, run, Parameters(*(float(known[n]) for n in Parameters._fields))), None)
    run = _run_of(loop, boundary)
    if run.status != STATUS_OK:
        ended = f"the loop ends with the status {STATUS_MEANINGS[run.status]}"
        raise InputError(f"{rule.name}: {ended}: a rule must return finite numbers")
    compiled, largest = run.traces["u" if rule.kind == "law" else "estimate"], 0.0
    for t, found in _replayed(rule, run, Parameters(*(run.parameters[n] for n in Parameters._fields))):
        difference = abs(found - float(compiled[t]))
        if not difference <= TOLERANCE:
            raise InputError(
                f"{rule.name} compiled and in plain Python differ from t = {t} s on: {compiled[t]:.12g} and "
                f"{found:.12g}; look for a test that hangs on the last digit, or whole numbers that grow large"
            )
        largest = max(largest, difference)
    return largest


def _run_of(loop: Loop, boundary: Boundary) -> _Run:
    ds = simulate(loop, boundary, traces=list(_TRACES), warm_up=0, n_jobs=1, progress=False)
    loop = Layout(loop, boundary).loop
    rules = rules_for_kernels(loop.rules)
    row = parameter_matrix(columns_of(loop, {}, np.array([0])), rules)[:, 0]
    parameters = dict(zip((*PARAMETER_ROWS, *rules.own), row.tolist(), strict=True))
    traces = {n: ds[n].values.astype(float) for n in _TRACES}
    series = {n: np.ravel(values) for n, values in boundary.series.items()}
    turned = np.diff(traces["mode"], prepend=FALLING) != 0.0
    return _Run(int(ds["status"]), parameters, traces, series, np.cumsum(turned))


def _replayed(rule: Rule, run: _Run, p: Any) -> Iterator[tuple[int, float]]:
    """The seconds at which the rule is called, and what its plain Python then answers, limited to 0–1."""
    is_law, Memory = rule.kind == "law", rule.parts[2]
    begin = memory = Memory(*defaults_of(Memory))
    estimate = run.traces["estimate"]
    answer, sample_time = float(estimate[0]), int(run.parameters["sample_time"])
    for t in range(estimate.size):
        if not run.series["enabled"][t]:
            memory = begin if is_law else memory
            continue
        if t % sample_time or (t == 0 and not is_law):
            continue
        now = run.sample(t, t, float(estimate[t])) if is_law else run.sample(t, t - sample_time, answer)
        try:
            found, memory = rule(now, p, memory)
            answer = float(np.clip(float(found), 0.0, 1.0))
        except Exception as error:  # a user's code may raise anything
            raise InputError(
                f"{rule.name} raises {type(error).__name__} in plain Python at t = {now.t:g} s, where the compiled "
                f"rule goes on: {error}; leave no such case open"
            ) from None
        yield t, answer

"""``fit_valve``: backlash and flow curve, Eqs (1) and (2), from recorded commands and flows (section 2.1.3).

A known time shift between the command and the flow is taken out first: the fit would mistake it for backlash.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, raise_problems, require_choice, require_number
from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError, Problem
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.log import CheckedLog, as_log
from fastcoil.logs.own_values import find_own_values
from fastcoil.measured import valve_problem
from fastcoil.measured.fit import AT_BOUND, NOT_UNIQUE, Fit, build_fit, natural_intervals
from fastcoil.measured.part import LEAST_ABOVE_0, LogSource, fitting_mask, require_split, split_segments
from fastcoil.measured.valve_problem import SHAPE, X_BL, ValveProblem, ValveSolution, judge_interval
from fastcoil.model.engine.recorded import VALVE_ROWS

_ROUND_OFF_S = 1e-6  # that is no difference of times
_SHORTEST_HOLD_S = 600.0  # between values of its own: a test that holds the command, and no poll
_VALVE_COLUMNS = ColumnSpec(required=("command", "m_w"), optional=("enabled",), measured=("m_w",))


@np.errstate(all="ignore")
def fit_valve(
    log: LogSource,
    *,
    m_max: float | None = None,
    split: float | None = None,
    lag: float = 0.0,
    holds: str | None = None,
) -> Fit:
    """Fit the backlash and the flow curve of a valve to a log of commands and flows.

    Parameters
    ----------
    log : path, DataFrame, Dataset or Log
        Needed: ``command`` (fraction of stroke, %, deg of 90, V of 10), ``m_w`` (kg/s, L/s, m3/h, gpm, …), and
        ``elapsed_time`` or ``timestamp``; optional: ``enabled``, 0 where the pump is off, and ``batch``, the number of
        the experiment.  `read_log` has the options of reading.
    m_max : float, optional
        Asymptotic flow of Eq (2), or flow of a straight line fully open, kg/s; estimated by default.
    split : float, default 0.7
        Share of the log that is fitted (of its batches, if it has at least four).  The rest validates the fit,
        on which it has no influence.  To hold back another log, join both with different numbers in ``batch``.
    lag : float, default 0
        Time by which the flow is logged after the command, s, negative if before.  A shift makes the backlash too
        large: compare with fits of ``lag`` a few samples either way, the right one has the smallest ``rmse["fit"]``.
    holds : "command", optional
        The command holds from row to row, as in a test of the valve.  By default a controller may move it between the
        rows, and the interval of the backlash allows for that.

    Returns
    -------
    Fit
        ``backlash``, ``m_max`` and the ``curve``: ``richards``, Eq (2), with ``valve_a``, ``valve_b`` and ``valve_c``,
        or ``linear``, which is taken where the Bayesian information criterion prefers it by 10 or more; ``notes`` has
        the evidence.  ``backlash`` is not among its ``parameters`` if the data do not identify it; ``held`` says why.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments.

    Notes
    -----
    Cai and Braun (2016), section 2.1.3.  The start of each batch within the gap and the floor of the meter are
    estimated.  If the command is held, flows of the first half of a typical hold are not compared.  Only b/(1 - x_BL)
    and (1 - x_BL) c enter Eq (2): α = 1/(1 - x_BL) assumes that a full command opens the valve fully.

    Examples
    --------
    >>> ds = fc.simulate(fc.Loop(backlash=0.07), fc.paper_day(hours=3), traces=["command", "m_w"], trace_interval=30)
    >>> fit = fc.fit_valve(ds, holds="command")
    >>> f"{fit.backlash:.3f}", fit.identified
    ('0.070', True)
    """
    start_time = time.perf_counter()
    with argument_checks() as check:
        log = check(as_log, "log", log)
        m_max = check.unless_none(require_number, "m_max", m_max, "give a flow above 0 kg/s", least=LEAST_ABOVE_0)
        cure = "give seconds by which the flow is logged after the command"
        lag = check(require_number, "lag", lag, cure, least=-86400.0, most=86400.0)
        holds = check.unless_none(require_choice, "holds", holds, ("command",))
        share = check(require_split, split)
    data = (_require_rows_per_piece if holds else _keep_own_flows)(log.read(_VALVE_COLUMNS))
    _require_movement(data, m_max)
    if lag:
        data = _shift_command(data, lag, fitting_mask(data, share))
    problem = ValveProblem(data, fitting_mask(data, share), m_max)
    return _assemble_fit(problem, problem.solve(), holds is not None, start_time)


def _require_rows_per_piece(data: CheckedLog) -> CheckedLog:
    """Refuse a log in so many pieces that most have fewer than three rows; return any other."""
    n_rows, n_pieces = data.time.size, data.n_batches
    if n_rows < 3 * n_pieces:
        cure = "give at least 3 rows for each, bridge gaps with fc.read_log(..., max_gap=SECONDS), --max-gap, or sort "
        sentence = f"{data.name}: its {n_rows:,} rows are in {n_pieces:,} pieces: {cure}the rows by time"
        raise InputError(sentence, "log", "time")
    return data


def _keep_own_flows(data: CheckedLog) -> CheckedLog:
    """Keep the rows with a flow of its own: between polls neither the flow nor the command that it answers is known."""
    flow = data.values["m_w"]
    own = find_own_values(flow, np.isfinite(flow), holds=False)
    if own is None or own.spacing * data.step >= _SHORTEST_HOLD_S:
        return _require_rows_per_piece(data)
    note = f"m_w has {own.describe(data.step)}: the rows between do not count"
    is_own = np.isin(np.arange(flow.size), own.rows)
    batch = np.unique(data.batch[is_own], return_inverse=True)[1]
    return _require_rows_per_piece(replace(data.where(is_own), batch=batch, notes=[*data.notes, note]))


def _require_movement(data: CheckedLog, m_max: float | None) -> None:
    """Refuse a log in which the valve does not move, and an ``m_max`` below its flows."""
    command, flow = data.values["command"], data.values["m_w"]
    known_flow = flow[np.isfinite(flow)]
    largest_flow, largest_command = float(known_flow.max()), float(command.max())
    rows = f"from row {data.rows[0]} to row {data.rows[-1]}"
    constants = {name: v[0] for name, v in (("command", command), ("m_w", known_flow)) if np.ptp(v) == 0.0}
    cure = "give a log in which the valve moves"
    problems = [Problem(f"{data.name}: {name} is {v:g} {rows}: {cure}", name, "data") for name, v in constants.items()]
    if largest_command < 0.02:
        sentence = f"{data.name}: command is never above {largest_command:.3g} of the stroke: check its unit"
        problems.append(Problem(sentence, "command", "unit"))
    if m_max is not None and m_max < 0.8 * largest_flow:  # noise may lift readings above the asymptotic flow
        sentence = f"m_max = {m_max:g} kg/s: {data.name} has flows up to {largest_flow:.3g} kg/s, give at least that"
        problems.append(Problem(sentence, "m_max", "conflict"))
    raise_problems(problems)


def has_live_zero(command: Array, flow: Array) -> bool:
    """Whether commands look like a signal of 2-10 V read as 0-10 V: the valve is closed at 20 %, and none is lower."""
    least = float(command.min())
    flow_when_lowest = flow[command <= least + 0.02]
    is_closed = flow_when_lowest.size >= 3 and float(np.median(flow_when_lowest)) <= 0.1 * float(flow.max())
    return bool(0.185 <= least <= 0.215 and command.max() > 0.5 and is_closed)


def _assemble_fit(problem: ValveProblem, solution: ValveSolution, holds: bool, start_time: float) -> Fit:
    """Assemble the fit of a valve from its solution; ``holds``: whether the command holds between the rows."""
    best, spread, notes = solution.estimate, solution.uncertainty, problem.notes
    names = VALVE_ROWS[: SHAPE[0] if problem.curve == "linear" else None]
    p, is_fitted = len(names), problem.good & problem.fitting
    is_logarithmic = valve_problem.IS_LOGARITHMIC[:p]
    command, flow = problem.command[is_fitted], problem.flow[is_fitted]
    natural = np.where(is_logarithmic, np.exp(best.x[:p]), best.x[:p])
    is_inverted = bool(np.corrcoef(command, flow)[0, 1] < -0.5)
    verdict = judge_interval(problem, solution, holds or is_inverted or problem.data.change_of_value)
    signal_notes = []
    if is_inverted:
        signal_notes = ["the flow falls as the command rises: if a full command closes the valve, log 1 - command"]
        verdict = verdict._replace(why=f"not identified: {signal_notes[0]}")
    elif has_live_zero(command, flow):
        signal_notes = [
            f"the valve is closed at a command of {command.min():.2g} and the command never falls below that: this "
            "looks like a 2-10 V signal read as 0-10 V, which makes the backlash a fifth too small; declare its unit, "
            "units={'command': 'V 2-10'}, --unit command='V 2-10', or log (command - 0.2) / 0.8"
        ]

    variances = np.diag(spread.covariance)[:p]
    held = {"backlash": verdict.why} if verdict.why else {}
    if problem.m_max is not None:
        held["m_max"] = "given"
    for name, variance in list(zip(names, variances, strict=True))[1:]:
        if not math.isfinite(variance):
            held.setdefault(name, AT_BOUND if math.isnan(variance) else NOT_UNIQUE)
    half_widths = spread.quantile() * np.sqrt(variances)
    intervals = natural_intervals(best.x[:p], half_widths, is_logarithmic)
    intervals[X_BL] = verdict.interval
    # the deviation of the backlash belongs to its interval
    scale = np.where(is_logarithmic, natural, 1.0)
    scale[X_BL] = max(1.0, 0.5 * (verdict.interval[1] - verdict.interval[0]) / max(half_widths[X_BL], 1e-12))

    parameters = dict(zip(names, natural.tolist(), strict=True)) | {"curve": problem.curve}
    if verdict.why:
        x = round(parameters.pop("backlash"), 4)
        notes.append(f"the curve belongs to a backlash of {x:g}, which is not identified: sweep it in a study")
    largest_command = float(problem.command[: problem.n_fit].max())
    if largest_command < 0.9:
        notes.append(f"commands reach {largest_command:.2g}: beyond it the curve is an extrapolation")
    if problem.n_reversals > 1:
        parts = ", ".join(f"{100 * x:.3g}" for x in solution.parts)
        notes.append(f"parts of the log, one after the other, give a backlash of {parts} %")
    notes += [*signal_notes, *filter(None, [verdict.note])]
    parameter_sets = np.stack([best.x, solution.without_backlash.x], axis=1)
    start = np.full((int(problem.batch[-1]) + 1, 2), 0.5)  # unknown for a batch held back
    start[: parameter_sets.shape[0] - 5] = parameter_sets[5:]
    openings, model_flows = problem.flows(parameter_sets[:5], start, problem.command)
    with_backlash, without_backlash = model_flows.T
    flows = {"m_w": problem.flow, "modelled": with_backlash, "modelled_without_backlash": without_backlash}
    flows["residual"] = problem.flow - with_backlash
    series = {name: (values, "kg s-1") for name, values in flows.items()}
    series |= {"command": (problem.command, "1"), "opening": (openings[:, 0], "1")}
    compared_flow = np.where(problem.good, problem.flow, np.nan)
    errors = {"": with_backlash - compared_flow, "_without_backlash": without_backlash - compared_flow}
    n_compared = solution.model.used.sum()
    rmse, limit = np.sqrt(solution.sums / n_compared), math.sqrt(solution.limit / n_compared)
    attrs = {"limit": limit, "backlash": float(natural[X_BL]), "interval_95": list(verdict.interval)}
    backlashes = {"backlash": ("backlash", solution.grid, {"units": "1"})}
    return build_fit(
        problem.data, start_time, problem.good, problem.fitting, errors, series, names,
        spread.covariance[:p, :p] * np.outer(scale, scale), held, intervals, kind="valve", parameters=parameters,
        profile=xr.Dataset({"rmse": ("backlash", rmse, {"units": "kg s-1"})}, backlashes, attrs),
        notes=notes, n_used=spread.n_used, n_effective=spread.n_effective,
    )  # fmt: skip


def _shift_command(log: CheckedLog, lag: float, fitting: Mask) -> CheckedLog:
    """Return a log with the command ``lag`` s before each sample, and a note on it.

    No flow counts whose command lies in another piece of the log, or on the other side of what is fitted.
    """
    command, flow = (log.values[name].copy() for name in ("command", "m_w"))
    for piece in split_segments(2 * log.batch + fitting):
        time = log.time[piece]
        command_time = time - lag + _ROUND_OFF_S
        rows = np.searchsorted(time, command_time, side="right") - 1
        command[piece] = log.values["command"][piece[np.maximum(rows, 0)]]
        flow[piece[(rows < 0) | (command_time > time[-1] + 2.0 * _ROUND_OFF_S)]] = np.nan
    note = f"the flow is compared with the command {abs(lag):g} s {'before' if lag > 0.0 else 'after'} it, as given"
    return replace(log, values=log.values | {"command": command, "m_w": flow}, notes=[*log.notes, note])

"""``fit_valve``: x_BL, m_max, a, b, c of Eqs (1) and (2) from recorded commands and flows (section 2.1.3).

The time shift between the command and the flow is estimated per piece, reported, removed.  Each candidate shift and
backlash turns the command into an opening; a piecewise linear curve from opening to flow is fitted to the whole log,
without the shape of Eq (2).  Shift and backlash are estimated together, so that neither is mistaken for the other.
Every piece whose shift differs from the others has a price, so that noise shifts no log.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, raise_problems, require_choice, require_number, to_builtin
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, Problem
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.log import CheckedLog, as_log
from fastcoil.logs.own_values import find_own_values
from fastcoil.logs.series import format_count
from fastcoil.measured import valve_problem
from fastcoil.measured.fit import AT_BOUND, NOT_UNIQUE, Fit, build_fit, natural_intervals
from fastcoil.measured.least_squares import autocorrelation
from fastcoil.measured.part import LEAST_ABOVE_0, LogSource, check_split, split_segments
from fastcoil.measured.valve_problem import X_BL, ValveProblem, ValveSolution, judge_interval, median_step
from fastcoil.model.engine.recorded import VALVE_ROWS, valve_flows

_SHORTEST_HOLD_S = 600.0  # between values of its own: a test that holds the command, and no poll
_VALVE_COLUMNS = ColumnSpec(required=("command", "m_w"), optional=("enabled",), measured=("m_w",))


@np.errstate(all="ignore")
def fit_valve(
    log: LogSource,
    *,
    m_max: float | None = None,
    split: float | None = None,
    validation: LogSource | None = None,
    lag: float | str = "auto",
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
        Asymptotic flow of Eq (2), kg/s; estimated by default.
    split : float, default 0.7
        Share of the log that is fitted (of its batches, if it has at least four).  The rest validates the fit.
    validation : path, DataFrame, Dataset or Log, optional
        Another log with the same columns that validates the fit of all of ``log``; a path is read with the options of
        ``log``.  Samples held back have no influence on the fit.
    lag : float or "auto", default "auto"
        Time by which the flow is logged after the command, s, negative if before; ``auto``: estimated for each piece of
        the fitted part, reported, removed.  The part held back is shifted like the last piece.
    holds : "command", optional
        The command holds from row to row, as in a test of the valve.  By default a controller may move it between the
        rows, and the interval of the backlash allows for that.

    Returns
    -------
    Fit
        ``backlash``, ``m_max``, ``valve_a``, ``valve_b`` and ``valve_c`` with intervals and residuals.  ``backlash`` is
        not among its ``parameters`` if the data do not identify it; ``held`` then says why.

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
        lag = check(_require_lag, lag)
        holds = check.unless_none(require_choice, "holds", holds, ("command",))
        part = check_split(check, log, split, validation)
    data = part.read(log, _VALVE_COLUMNS, _require_rows_per_piece if holds else _keep_own_flows)
    _require_movement(data, m_max)
    if isinstance(lag, float) and lag != 0.0:
        note = f"the flow is compared with the command {abs(lag):g} s {'before' if lag > 0.0 else 'after'} it, as given"
        data = _shift_command(data, np.full(data.time.size, lag), part.fitting_mask(data), [note])
    problem = ValveProblem(data, part)
    if lag == "auto":
        unlagged = remove_lag(data, problem.good, problem.fitting)
        problem = problem if unlagged is data else ValveProblem(unlagged, part)
    return _assemble_fit(problem, problem.solve(m_max), holds is not None, start_time)


def _require_lag(lag: Any) -> float | str:
    if isinstance(lag := to_builtin(lag), str) and lag == "auto":
        return lag
    cure = "give seconds by which the flow is logged after the command, or 'auto'"
    return float(require_number("lag", lag, cure, least=-86400.0, most=86400.0))


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
    is_first_log = data.source == 0
    command, flow = data.values["command"][is_first_log], data.values["m_w"][is_first_log]
    known_flow = flow[np.isfinite(flow)]
    largest_flow, largest_command = float(known_flow.max()), float(command.max())
    rows = f"from row {data.rows[is_first_log][0]} to row {data.rows[is_first_log][-1]}"
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
    is_fitted, is_logarithmic = problem.good & problem.fitting, valve_problem.IS_LOGARITHMIC
    command, flow = problem.command[is_fitted], problem.flow[is_fitted]
    natural = np.where(is_logarithmic, np.exp(best.x[:5]), best.x[:5])
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

    variances = np.diag(spread.covariance)[:5]
    held = {"backlash": verdict.why} if verdict.why else {}
    if solution.is_m_max_given:
        held["m_max"] = "given"
    for name, variance in list(zip(VALVE_ROWS, variances, strict=True))[1:]:
        if not math.isfinite(variance):
            held.setdefault(name, AT_BOUND if math.isnan(variance) else NOT_UNIQUE)
    half_widths = spread.quantile() * np.sqrt(variances)
    intervals = natural_intervals(best.x[:5], half_widths, is_logarithmic)
    intervals[X_BL] = verdict.interval
    # the deviation of the backlash belongs to its interval
    scale = np.where(is_logarithmic, natural, 1.0)
    scale[X_BL] = max(1.0, 0.5 * (verdict.interval[1] - verdict.interval[0]) / max(half_widths[X_BL], 1e-12))

    parameters = dict(zip(VALVE_ROWS, natural.tolist(), strict=True))
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
    notes += _compare_with_line(openings[is_fitted, 0], flow, with_backlash[is_fitted])
    attrs = {"limit": limit, "backlash": float(natural[X_BL]), "interval_95": list(verdict.interval)}
    backlashes = {"backlash": ("backlash", solution.grid, {"units": "1"})}
    return build_fit(
        problem.data, start_time, problem.good, problem.fitting, errors, series, VALVE_ROWS,
        spread.covariance[:5, :5] * np.outer(scale, scale), held, intervals, kind="valve", parameters=parameters,
        profile=xr.Dataset({"rmse": ("backlash", rmse, {"units": "kg s-1"})}, backlashes, attrs),
        notes=notes, n_used=spread.n_used, n_effective=spread.n_effective,
    )  # fmt: skip


def _compare_with_line(opening: Array, flow: Array, model_flow: Array) -> list[str]:
    """Return a note where a straight line from the closed valve on, of one parameter, fits better than Eq (2)."""
    m_max = float(opening @ flow / max(float(opening @ opening), _LEAST_SUM))
    line, curve = (float(np.sqrt(np.mean((flow - fitted) ** 2))) for fitted in (m_max * opening, model_flow))
    if line >= curve:
        return []
    cure = f'give the loop curve = "linear" and m_max = {m_max:.4g} in place of the four parameters of Eq (2)'
    return [f"a straight line fits better than Eq (2), RMSE {line:.2g} against {curve:.2g} kg/s: {cure}"]


N_KNOTS = 11  # of a flow curve, from closed to open
TRIAL_BACKLASHES = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.125, 0.15, 0.18, 0.22, 0.27, 0.33, 0.4])
_NEAR_SHIFTS = 6  # largest shift either way that is always tried, samples
_SHIFT_PRICE = 12.0  # log-likelihood of a shift, and of each change of it
_ROUND_OFF = 1e-6  # s, and share of a flow, that is no difference
_LEAST_SUM = 1e-300  # of squares, so that nothing is divided by 0


def knot_weights(opening: Array) -> Array:
    """Return the weights of evenly spaced knots that interpolate at each opening: (…,) → (…, knots)."""
    knots_from_closed = np.clip(opening, 0.0, 1.0) * (N_KNOTS - 1)
    return np.asarray(np.maximum(1.0 - np.abs(knots_from_closed[..., None] - np.arange(N_KNOTS)), 0.0))


def simulate_openings(command: Array, batch: Index, backlashes: Array) -> Array:
    """Simulate the opening behind each backlash, (n, backlashes); each batch starts in the middle of the gap."""
    rows, start = np.ones((5, backlashes.size)), np.full((int(batch[-1]) + 1, backlashes.size), 0.5)
    rows[0] = backlashes
    openings, flows = np.empty((2, command.size, backlashes.size))
    valve_flows(np.ascontiguousarray(command), batch, rows, start, openings, flows)
    return openings


def _squared_errors(products: Array, flows: Array) -> Array:
    """Return the sums of squared residuals, (…,), of a flow curve, (…, knots), from sums of products."""
    v = np.concatenate([flows, np.full((*flows.shape[:-1], 1), -1.0)], axis=-1)
    return np.asarray(np.maximum(np.einsum("...ij,...i,...j", products, v, v), 0.0))


class _Curve(NamedTuple):
    """A flow curve over the opening behind a backlash."""

    backlash: int  # index in ``TRIAL_BACKLASHES``
    flows: Array  # at the knots, kg/s
    variance: float  # of a residual, (kg/s)²


class _LagSums(NamedTuple):
    """Sums over the pieces of a log that determine lags and curve."""

    lags: Array  # that are tried, samples, (lags,)
    products: Array  # of the curve's terms and the flow, (pieces, lags, backlashes, knots + 1, knots + 1)
    counts: Array  # samples in each, (pieces, lags)

    def fit_curve(self, lag_indices: Index) -> _Curve:
        """Fit backlash and curve to all pieces, each at its lag; lag_indices: in ``lags``, (pieces,)."""
        each_piece = np.arange(lag_indices.size), lag_indices
        total, n = self.products[each_piece].sum(axis=0), max(float(self.counts[each_piece].sum()), 1.0)
        A, b = total[:, :-1, :-1], total[:, :-1, -1:]
        ridge = 1e-9 * np.trace(A, axis1=-2, axis2=-1) + _LEAST_SUM
        flows = np.linalg.solve(A + ridge[:, None, None] * np.eye(N_KNOTS), b)[..., 0]
        errors = _squared_errors(total, flows)
        j = int(np.argmin(errors))
        return _Curve(j, flows[j], max(float(errors[j]) / n, _ROUND_OFF**2 * float(total[j, -1, -1]) / n, _LEAST_SUM))

    def cheapest_lags(self, curve: _Curve, worth: float) -> Index:
        """Return the best lag of each piece, an index in ``lags``: least errors, with a price for each shift.

        worth: samples that count as an independent one.  Samples that a lag leaves without a command cost as much as
        others; they may not be most of a piece.  The variance of a piece that fits worse than the rest is its own,
        since chance moves it more easily.
        """
        n_samples = self.counts.max(axis=1, keepdims=True)
        errors = _squared_errors(self.products[:, :, curve.backlash], curve.flows)
        errors = np.where(self.counts < 0.5 * n_samples, np.inf, errors + curve.variance * (n_samples - self.counts))
        own_variance = errors.min(axis=1, keepdims=True) / np.maximum(n_samples, 1.0)
        costs = errors / (2.0 * worth * np.maximum(own_variance, curve.variance))
        # of each lag that most pieces may have, (common, pieces, lags)
        costs_with_price = costs + _SHIFT_PRICE * (self.lags != self.lags[:, None])[:, None]
        common_lag = int(np.argmin(costs_with_price.min(axis=2).sum(axis=1) + _SHIFT_PRICE * (self.lags != 0)))
        return np.asarray(costs_with_price[common_lag].argmin(axis=1))

    def search(self, worth: float) -> tuple[Index, _Curve]:
        """Return the lag of each piece and the curve, iterated from each common lag until neither changes."""
        solutions, n = [], self.counts.sum(axis=0)
        for common in np.flatnonzero(n >= 0.5 * n.max()):
            lag_indices = np.full(self.counts.shape[0], common)
            for _ in range(10):
                previous = lag_indices
                lag_indices = self.cheapest_lags(self.fit_curve(previous), worth)
                if (lag_indices == previous).all():
                    break
            curve = self.fit_curve(lag_indices)
            changes = np.count_nonzero(np.diff(self.lags[lag_indices], prepend=0))
            cost = 0.5 * self.counts.max(axis=1).sum() / worth * np.log(curve.variance)
            solutions.append((_SHIFT_PRICE * changes + cost, lag_indices, curve))
        return min(solutions, key=lambda solution: float(solution[0]))[1:]

    def worthwhile_lags(self, lag_indices: Index, curve: _Curve) -> Array:
        """Return the lag of each piece in samples, set to 0 in runs of pieces that gain little by it."""
        errors = _squared_errors(self.products[:, :, curve.backlash], curve.flows)
        lags, no_lag = self.lags[lag_indices], int(np.flatnonzero(self.lags == 0)[0])
        for run in split_segments(lag_indices):
            if errors[run, lag_indices[run]].sum() > 0.8 * errors[run, no_lag].sum():
                lags[run] = 0
        return lags


def delay_command(log: CheckedLog, lag: Array | float) -> tuple[Array, Mask]:
    """Return the command ``lag`` seconds before each sample, (n,), and whether that is outside of its piece."""
    logged_command, lag = log.values["command"], np.broadcast_to(lag, log.time.shape)
    command, is_outside = logged_command.copy(), np.zeros(logged_command.size, dtype=bool)
    for piece in split_segments(log.batch):
        time = log.time[piece]
        command_time = time - lag[piece] + _ROUND_OFF
        rows = np.searchsorted(time, command_time, side="right") - 1
        command[piece] = logged_command[piece[np.maximum(rows, 0)]]
        is_outside[piece] = (rows < 0) | (command_time > time[-1] + 2.0 * _ROUND_OFF)
    return command, is_outside


def remove_lag(log: CheckedLog, good: Mask, fitting: Mask) -> CheckedLog:
    """Shift the command of each piece to the clock of the flow, and note it; a log without a shift is returned itself.

    good, fitting: (n,), samples that may be compared, and those of the part to fit.  Shifts are estimated in that part
    alone; what follows is shifted like its last piece.
    """
    fitted_log, is_used, step = log.where(fitting), good[fitting], median_step(log, fitting)
    lags, memory, worth = _lags_to_try(fitted_log, is_used, step).astype(float), 0.0, 1.0
    for is_white in (False, True):  # first the correlation of the residuals, then without it
        sums = _sum_products(fitted_log, is_used, step, lags, memory)
        lag_indices, curve = sums.search(worth)
        rho = _residual_correlation(fitted_log, is_used, lags[lag_indices][fitted_log.batch] * step, curve, memory)
        if is_white:
            worth = max(1.0 + 2.0 * float(rho.sum()), 1.0)
        elif rho.size:
            memory = min(float(rho[0]), 0.98)
    shifts = sums.worthwhile_lags(*sums.search(worth))[fitted_log.batch]
    shifts = np.pad(shifts, (0, log.time.size - shifts.size), mode="edge")
    return _shift_command(log, shifts * step, fitting, _describe_shifts(log, shifts, step)) if shifts.any() else log


def _shift_command(log: CheckedLog, lag: Array, fitting: Mask, notes: list[str]) -> CheckedLog:
    """Return a log with the command ``lag`` s before each sample, (n,), and with these notes."""
    command, is_outside = delay_command(log, lag)
    # commands of the part held back have no influence on the fit
    command[fitting], is_outside[fitting] = delay_command(log.where(fitting), lag[fitting])
    values = log.values | {"command": command, "m_w": np.where(is_outside, np.nan, log.values["m_w"])}
    return replace(log, values=values, notes=log.notes + notes)


def _describe_shifts(log: CheckedLog, shifts: Array, step: float) -> list[str]:
    """Describe which rows of the flow are logged after the command, or before; shifts: samples, (n,)."""
    notes = []
    for run in [run for run in split_segments(shifts) if shifts[run[0]]]:
        n, first, last = int(shifts[run[0]]), int(run[0]), int(run[-1])
        piece = f" (piece {log.batch[first] + 1} of {log.n_batches})" if log.n_batches > 1 else ""
        where = f"from row {log.rows[first]}{piece} to row {log.rows[last]}" if run.size < shifts.size else "throughout"
        when = f"{format_count(abs(n), 'sample')} ({abs(n) * step:.4g} s) {'after' if n > 0 else 'before'} the command"
        notes.append(f"{where} the flow is logged {when}: the fit takes this shift out; lag=0, --lag 0 leaves it in")
    return notes


def _sum_products(log: CheckedLog, good: Mask, step: float, lags: Array, memory: float) -> _LagSums:
    """Sum products of knot weights and flow for each lag and backlash, each less ``memory`` times the one before."""
    pieces = split_segments(log.batch)
    starts = [int(piece[0]) for piece in pieces]
    products = np.zeros((len(pieces), lags.size, TRIAL_BACKLASHES.size, N_KNOTS + 1, N_KNOTS + 1))
    counts = np.zeros((len(pieces), lags.size))
    for i, lag in enumerate(lags):
        command, is_outside = delay_command(log, lag * step)
        openings = simulate_openings(command, log.batch, TRIAL_BACKLASHES)
        is_used = good & ~is_outside
        if memory:
            is_used[1:] &= is_used[:-1].copy()
            is_used[starts] = False
        counts[:, i] = np.add.reduceat(is_used, starts, dtype=float)
        for j in range(TRIAL_BACKLASHES.size):
            A = np.column_stack([knot_weights(openings[:, j]), log.values["m_w"]])
            if memory:
                A[1:] -= memory * A[:-1]
            A = np.where(is_used[:, None], A, 0.0)
            for k, piece in enumerate(pieces):
                products[k, i, j] = A[piece].T @ A[piece]
    return _LagSums(lags, products, counts)


def _lags_to_try(log: CheckedLog, used: Mask, step: float) -> Index:
    """Return the lags to try, samples: a few either way, and some around the peak of the cross-correlation."""
    from scipy.signal import correlate

    lags = np.arange(-_NEAR_SHIFTS, _NEAR_SHIFTS + 1)
    largest_lag = min(int(7200.0 / step), log.time.size // 4)  # clocks may differ by an hour
    is_compared = used[1:] & used[:-1] & (np.diff(log.batch) == 0)
    if largest_lag <= _NEAR_SHIFTS or not is_compared.any():
        return lags
    moves, answers = (np.where(is_compared, np.diff(log.values[name]), 0.0) for name in ("command", "m_w"))
    far_lags = np.concatenate([np.arange(-largest_lag, -_NEAR_SHIFTS), np.arange(_NEAR_SHIFTS + 1, largest_lag + 1)])
    peak = int(far_lags[np.argmax(correlate(answers, moves)[far_lags + moves.size - 1])])  # its lags begin at 1 - n
    return np.union1d(lags, np.arange(peak - 2, peak + 2 + 1))


def _residual_correlation(log: CheckedLog, used: Mask, lag: Array, curve: _Curve, memory: float) -> Array:
    """Return the autocorrelation of the residuals, each less ``memory`` times the one before; lag: (n,), s."""
    command, is_outside = delay_command(log, lag)
    opening = simulate_openings(command, log.batch, TRIAL_BACKLASHES[[curve.backlash]])[:, 0]
    used = used & ~is_outside
    r = np.where(used, knot_weights(opening) @ curve.flows - log.values["m_w"], 0.0)
    r[1:] -= memory * r[:-1]
    n = int(np.flatnonzero(used)[-1]) + 1
    return autocorrelation(r[:n], log.batch[:n], used[:n])

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

from fastcoil.base.arguments import argument_checks, raise_problems, require_choice, require_number, to_builtin
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, Problem
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.log import CheckedLog, as_log
from fastcoil.logs.series import format_count
from fastcoil.measured import valve_problem
from fastcoil.measured.fit import AT_BOUND, NOT_UNIQUE, Fit, backlash_series, build_fit, natural_intervals, rmse_profile
from fastcoil.measured.least_squares import autocorrelation
from fastcoil.measured.part import ABOVE_0, LogSource, check_split, split_segments
from fastcoil.measured.valve_problem import X_BL, ValveProblem, ValveSolution, judge_interval, median_step
from fastcoil.model.engine.recorded import VALVE_ROWS, valve_flows

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

    See Also
    --------
    fit_coil, fit_loop, read_log

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
        m_max = check.unless_none(require_number, "m_max", m_max, "give a flow above 0 kg/s", least=ABOVE_0)
        lag = check(_require_lag, lag)
        holds = check.unless_none(require_choice, "holds", holds, ("command",))
        part = check_split(check, log, split, validation)
    data = part.read(log, _VALVE_COLUMNS, _require_rows_per_piece)
    _require_movement(data, m_max)
    if isinstance(lag, float) and lag != 0.0:
        note = f"the flow is compared with the command {abs(lag):g} s {'before' if lag > 0.0 else 'after'} it, as given"
        data = _shift_command(data, np.full(data.time.size, lag), part.fitting_mask(data), [note])
    problem = ValveProblem(data, part)
    if lag == "auto":
        shifted = remove_lag(data, problem.good, problem.fitting)
        problem = problem if shifted is data else ValveProblem(shifted, part)
    return _assemble_fit(problem, problem.solve(m_max), holds is not None, start_time)


def _require_lag(lag: Any) -> float | str:
    if isinstance(lag := to_builtin(lag), str) and lag == "auto":
        return lag
    cure = "give seconds by which the flow is logged after the command, or 'auto'"
    return float(require_number("lag", lag, cure, least=-86400.0, most=86400.0))


def _require_rows_per_piece(data: CheckedLog) -> CheckedLog:
    """Refuse a log that is no record in time: where in its gap a piece starts is one more unknown."""
    n_rows, n_pieces = data.time.size, data.n_batches
    if n_rows < 3 * n_pieces:
        cure = "give at least 3 rows for each, bridge gaps with fc.read_log(..., max_gap=SECONDS), --max-gap, or sort "
        sentence = f"{data.name}: its {n_rows:,} rows are in {n_pieces:,} pieces: {cure}the rows by time"
        raise InputError(sentence, "log", "time")
    return data


def _require_movement(data: CheckedLog, m_max: float | None) -> None:
    """Refuse arguments that do not fit the log, and a log in which the valve does not move."""
    first = data.source == 0
    command, flow = data.values["command"][first], data.values["m_w"][first]
    known = flow[np.isfinite(flow)]
    top, reach = float(known.max()), float(command.max())
    rows = f"from row {data.rows[first][0]} to row {data.rows[first][-1]}"
    problems = [
        Problem(f"{data.name}: {name} is {values[0]:g} {rows}: give a log in which the valve moves", name, "data")
        for name, values in (("command", command), ("m_w", known))
        if np.ptp(values) == 0.0
    ]
    if reach < 0.02:
        sentence = f"{data.name}: command is never above {reach:.3g} of the stroke: check its unit"
        problems.append(Problem(sentence, "command", "unit"))
    if m_max is not None and m_max < 0.8 * top:  # noise may lift readings above the asymptotic flow
        sentence = f"m_max = {m_max:g} kg/s: {data.name} has flows up to {top:.3g} kg/s, give at least that"
        problems.append(Problem(sentence, "m_max", "conflict"))
    raise_problems(problems)


def has_live_zero(command: Array, flow: Array) -> bool:
    """Whether the samples look like a signal of 2-10 V read as 0-10 V: closed at 20 %, never below."""
    least = float(command.min())
    lowest = flow[command <= least + 0.02]
    is_closed = lowest.size >= 3 and float(np.median(lowest)) <= 0.1 * float(flow.max())
    return bool(0.185 <= least <= 0.215 and command.max() > 0.5 and is_closed)


def _assemble_fit(problem: ValveProblem, solution: ValveSolution, holds: bool, start_time: float) -> Fit:
    """Assemble the result; ``holds``: the command holds between the rows."""
    best, spread, notes = solution.estimate, solution.uncertainty, problem.notes
    fitted, is_logarithmic = problem.good & problem.fitting, valve_problem.IS_LOGARITHMIC
    command, flow = problem.command[fitted], problem.flow[fitted]
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
    half = spread.quantile() * np.sqrt(variances)
    intervals = natural_intervals(best.x[:5], half, is_logarithmic)
    intervals[X_BL] = verdict.interval
    # the deviation of the backlash belongs to its interval
    scale = np.where(is_logarithmic, natural, 1.0)
    scale[X_BL] = max(1.0, 0.5 * (verdict.interval[1] - verdict.interval[0]) / max(half[X_BL], 1e-12))

    parameters = dict(zip(VALVE_ROWS, natural.tolist(), strict=True))
    if verdict.why:
        x = round(parameters.pop("backlash"), 4)
        notes.append(f"the curve belongs to a backlash of {x:g}, which is not identified: sweep it in a study")
    reach = float(problem.command[: problem.n_fit].max())
    if reach < 0.9:
        notes.append(f"commands reach {reach:.2g}: beyond it the curve is an extrapolation")
    if problem.n_reversals > 1:
        parts = ", ".join(f"{100 * x:.3g}" for x in solution.parts)
        notes.append(f"parts of the log, one after the other, give a backlash of {parts} %")
    notes += [*signal_notes, *filter(None, [verdict.note])]
    parameter_sets = np.stack([best.x, solution.without_backlash.x], axis=1)
    start = np.full((int(problem.batch[-1]) + 1, 2), 0.5)  # unknown for a batch held back
    start[: parameter_sets.shape[0] - 5] = parameter_sets[5:]
    openings, modelled = problem.flows(parameter_sets[:5], start, problem.command)
    with_backlash, without = modelled.T
    series, errors = backlash_series("m_w", "kg s-1", problem.flow, with_backlash, without, problem.good)
    series |= {"command": (problem.command, "1"), "opening": (openings[:, 0], "1")}
    n_compared = solution.model.used.sum()
    rmse, limit = np.sqrt(solution.sums / n_compared), math.sqrt(solution.limit / n_compared)
    return build_fit(
        problem.data, start_time, problem.good, problem.fitting, errors, series, VALVE_ROWS,
        spread.covariance[:5, :5] * np.outer(scale, scale), held, intervals, kind="valve", parameters=parameters,
        profile=rmse_profile(solution.grid, rmse, "kg s-1", float(natural[X_BL]), verdict.interval, limit=limit),
        notes=notes, n_used=spread.n_used, n_effective=spread.n_effective,
    )  # fmt: skip


N_KNOTS = 11
TRIAL_BACKLASHES = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.125, 0.15, 0.18, 0.22, 0.27, 0.33, 0.4])
_NEAR_SHIFTS = 6  # samples either way that are always tried
_SHIFT_PRICE = 12.0  # log-likelihood of a shift, and of each change of it
_ROUND_OFF = 1e-6
_TINY = 1e-300


def knot_weights(opening: Array) -> Array:
    """Weights of the knots, evenly spaced from 0 to 1, at each opening: (…,) → (…, knots)."""
    place = np.clip(opening, 0.0, 1.0) * (N_KNOTS - 1)
    return np.asarray(np.maximum(1.0 - np.abs(place[..., None] - np.arange(N_KNOTS)), 0.0))


def simulate_openings(command: Array, batch: Index, backlashes: Array) -> Array:
    """Opening behind each backlash, (n, backlashes); each piece starts in the middle of the gap."""
    rows, start = np.ones((5, backlashes.size)), np.full((int(batch[-1]) + 1, backlashes.size), 0.5)
    rows[0] = backlashes
    openings, flows = np.empty((2, command.size, backlashes.size))
    valve_flows(np.ascontiguousarray(command), batch, rows, start, openings, flows)
    return openings


def _squared_errors(products: Array, flows: Array) -> Array:
    """Sums of squared residuals, (…,), of a curve, (…, k - 1) or (k - 1,)."""
    v = np.concatenate([flows, np.full((*flows.shape[:-1], 1), -1.0)], axis=-1)
    return np.asarray(np.maximum(np.einsum("...ij,...i,...j", products, v, v), 0.0))


class _Curve(NamedTuple):
    backlash: int  # index in ``TRIAL_BACKLASHES``
    flows: Array  # at the knots, kg/s
    variance: float  # of a residual, (kg/s)²


class _LagSums(NamedTuple):
    """Sums over the pieces of a log that determine lags and curve."""

    lags: Array  # that are tried, samples, (lags,)
    products: Array  # of the curve's terms and the flow, (pieces, lags, backlashes, knots + 1, knots + 1)
    counts: Array  # samples in each, (pieces, lags)

    def fit_curve(self, chosen: Index) -> _Curve:
        """Best curve with each piece at its lag, an index in ``lags``."""
        at = np.arange(chosen.size), chosen
        total, n = self.products[at].sum(axis=0), max(float(self.counts[at].sum()), 1.0)
        A, b = total[:, :-1, :-1], total[:, :-1, -1:]
        ridge = 1e-9 * np.trace(A, axis1=-2, axis2=-1) + _TINY
        flows = np.linalg.solve(A + ridge[:, None, None] * np.eye(N_KNOTS), b)[..., 0]
        errors = _squared_errors(total, flows)
        j = int(np.argmin(errors))
        return _Curve(j, flows[j], max(float(errors[j]) / n, _ROUND_OFF**2 * float(total[j, -1, -1]) / n, _TINY))

    def cheapest_lags(self, curve: _Curve, worth: float) -> Index:
        """Lag of each piece with the least sum of errors and prices, an index in ``lags``.

        worth: samples that count as an independent one.  Samples that a lag leaves without a command cost as much as
        others; they may not be most of a piece.  The variance of a piece that fits worse than the rest is its own,
        since chance moves it more easily.
        """
        most = self.counts.max(axis=1, keepdims=True)
        errors = _squared_errors(self.products[:, :, curve.backlash], curve.flows)
        errors = np.where(self.counts < 0.5 * most, np.inf, errors + curve.variance * (most - self.counts))
        own_variance = errors.min(axis=1, keepdims=True) / np.maximum(most, 1.0)
        costs = errors / (2.0 * worth * np.maximum(own_variance, curve.variance))
        # of each lag that most pieces may have, (common, pieces, lags)
        whole = costs + _SHIFT_PRICE * (self.lags != self.lags[:, None])[:, None]
        common = int(np.argmin(whole.min(axis=2).sum(axis=1) + _SHIFT_PRICE * (self.lags != 0)))
        return np.asarray(whole[common].argmin(axis=1))

    def search(self, worth: float) -> tuple[Index, _Curve]:
        """Lag of each piece and the curve, iterated from each common lag until neither changes."""
        solutions, n = [], self.counts.sum(axis=0)
        for common in np.flatnonzero(n >= 0.5 * n.max()):
            chosen = np.full(self.counts.shape[0], common)
            for _ in range(10):
                before = chosen
                chosen = self.cheapest_lags(self.fit_curve(before), worth)
                if (chosen == before).all():
                    break
            curve = self.fit_curve(chosen)
            changes = np.count_nonzero(np.diff(self.lags[chosen], prepend=0))
            cost = 0.5 * self.counts.max(axis=1).sum() / worth * np.log(curve.variance)
            solutions.append((_SHIFT_PRICE * changes + cost, chosen, curve))
        return min(solutions, key=lambda solution: float(solution[0]))[1:]

    def worthwhile_lags(self, chosen: Index, curve: _Curve) -> Array:
        """Lag of each piece in samples, 0 where a run of pieces with one lag gains little by it."""
        errors = _squared_errors(self.products[:, :, curve.backlash], curve.flows)
        lags, no_lag = self.lags[chosen], int(np.flatnonzero(self.lags == 0)[0])
        for run in split_segments(chosen):
            if errors[run, chosen[run]].sum() > 0.8 * errors[run, no_lag].sum():
                lags[run] = 0
        return lags


def delay_command(log: CheckedLog, lag: Array | float) -> tuple[Array, Mask]:
    """The command ``lag`` seconds before each sample, (n,), and where no row of its piece gives it."""
    logged, lag = log.values["command"], np.broadcast_to(lag, log.time.shape)
    command, outside = logged.copy(), np.zeros(logged.size, dtype=bool)
    for piece in split_segments(log.batch):
        time = log.time[piece]
        asked_time = time - lag[piece] + _ROUND_OFF
        at = np.searchsorted(time, asked_time, side="right") - 1
        command[piece] = logged[piece[np.maximum(at, 0)]]
        outside[piece] = (at < 0) | (asked_time > time[-1] + 2.0 * _ROUND_OFF)
    return command, outside


def remove_lag(log: CheckedLog, good: Mask, fitting: Mask) -> CheckedLog:
    """Remove the shift of each piece from a log and note it; a log without one is returned itself.

    good, fitting: (n,), samples that may be compared, and those of the part to fit.  Shifts are estimated in that part
    alone; what follows is shifted like its last piece.
    """
    fitted_log, used, step = log.where(fitting), good[fitting], median_step(log, fitting)
    lags, memory, worth = _lags_to_try(fitted_log, used, step).astype(float), 0.0, 1.0
    for is_white in (False, True):  # first the correlation of the residuals, then without it
        sums = _sum_products(fitted_log, used, step, lags, memory)
        chosen, curve = sums.search(worth)
        rho = _residual_correlation(fitted_log, used, lags[chosen][fitted_log.batch] * step, curve, memory)
        if is_white:
            worth = max(1.0 + 2.0 * float(rho.sum()), 1.0)
        elif rho.size:
            memory = min(float(rho[0]), 0.98)
    shifts = sums.worthwhile_lags(*sums.search(worth))[fitted_log.batch]
    shifts = np.pad(shifts, (0, log.time.size - shifts.size), mode="edge")
    return _shift_command(log, shifts * step, fitting, _describe_shifts(log, shifts, step)) if shifts.any() else log


def _shift_command(log: CheckedLog, lag: Array, fitting: Mask, notes: list[str]) -> CheckedLog:
    command, outside = delay_command(log, lag)
    # commands of the part held back have no influence on the fit
    command[fitting], outside[fitting] = delay_command(log.where(fitting), lag[fitting])
    values = log.values | {"command": command, "m_w": np.where(outside, np.nan, log.values["m_w"])}
    return replace(log, values=values, notes=log.notes + notes)


def _describe_shifts(log: CheckedLog, shifts: Array, step: float) -> list[str]:
    notes = []
    for run in [run for run in split_segments(shifts) if shifts[run[0]]]:
        n, first, last = int(shifts[run[0]]), int(run[0]), int(run[-1])
        piece = f" (piece {log.batch[first] + 1} of {log.n_batches})" if log.n_batches > 1 else ""
        where = f"from row {log.rows[first]}{piece} to row {log.rows[last]}" if run.size < shifts.size else "throughout"
        when = f"{format_count(abs(n), 'sample')} ({abs(n) * step:.4g} s) {'after' if n > 0 else 'before'} the command"
        notes.append(f"{where} the flow is logged {when}: the fit takes this shift out; lag=0, --lag 0 leaves it in")
    return notes


def _sum_products(log: CheckedLog, good: Mask, step: float, lags: Array, memory: float) -> _LagSums:
    """Sum products of the terms and the flow for each lag and backlash, less ``memory`` of the sample before."""
    pieces = split_segments(log.batch)
    starts = [int(piece[0]) for piece in pieces]
    products = np.zeros((len(pieces), lags.size, TRIAL_BACKLASHES.size, N_KNOTS + 1, N_KNOTS + 1))
    counts = np.zeros((len(pieces), lags.size))
    for i, lag in enumerate(lags):
        command, outside = delay_command(log, lag * step)
        openings = simulate_openings(command, log.batch, TRIAL_BACKLASHES)
        used = good & ~outside
        if memory:
            used[1:] &= used[:-1].copy()
            used[starts] = False
        counts[:, i] = np.add.reduceat(used, starts, dtype=float)
        for j in range(TRIAL_BACKLASHES.size):
            A = np.column_stack([knot_weights(openings[:, j]), log.values["m_w"]])
            if memory:
                A[1:] -= memory * A[:-1]
            A = np.where(used[:, None], A, 0.0)
            for k, piece in enumerate(pieces):
                products[k, i, j] = A[piece].T @ A[piece]
    return _LagSums(lags, products, counts)


def _lags_to_try(log: CheckedLog, used: Mask, step: float) -> Index:
    """Shifts in samples: a few either way, and around the peak of the cross-correlation of the changes."""
    from scipy.signal import correlate

    lags = np.arange(-_NEAR_SHIFTS, _NEAR_SHIFTS + 1)
    most = min(int(7200.0 / step), log.time.size // 4)  # clocks may differ by an hour
    is_compared = used[1:] & used[:-1] & (np.diff(log.batch) == 0)
    if most <= _NEAR_SHIFTS or not is_compared.any():
        return lags
    moves, answers = (np.where(is_compared, np.diff(log.values[name]), 0.0) for name in ("command", "m_w"))
    far = np.concatenate([np.arange(-most, -_NEAR_SHIFTS), np.arange(_NEAR_SHIFTS + 1, most + 1)])
    peak = int(far[np.argmax(correlate(answers, moves)[far + moves.size - 1])])  # its lags begin at 1 - n
    return np.union1d(lags, np.arange(peak - 2, peak + 2 + 1))


def _residual_correlation(log: CheckedLog, used: Mask, lag: Array, curve: _Curve, memory: float) -> Array:
    """Autocorrelation of the residuals, each less ``memory`` times the one before; lag: (n,), s."""
    command, outside = delay_command(log, lag)
    opening = simulate_openings(command, log.batch, TRIAL_BACKLASHES[[curve.backlash]])[:, 0]
    used = used & ~outside
    r = np.where(used, knot_weights(opening) @ curve.flows - log.values["m_w"], 0.0)
    r[1:] -= memory * r[:-1]
    n = int(np.flatnonzero(used)[-1]) + 1
    return autocorrelation(r[:n], log.batch[:n], used[:n])

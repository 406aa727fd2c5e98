"""The least-squares problem of a valve and its solution.

Between two rows a controller may move the valve and turn it back.  What that leaves in the residuals, besides the noise
of the meter, widens the interval of the backlash; if it is much, the backlash is not identified.
"""

import math
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs import CheckedLog
from fastcoil.logs.series import describe_first_row, format_count
from fastcoil.measured import least_squares, thresholds
from fastcoil.measured.least_squares import Estimate, Model, Uncertainty, minimise, uncertainty
from fastcoil.measured.part import count_reversals, split_segments
from fastcoil.model.engine.recorded import valve_flows

X_BL = 0  # index of the backlash in a parameter set
M_MAX = 1  # index of m_max in it
SHAPE = (2, 3, 4)  # of a, b, c, which a straight line does without
IS_LOGARITHMIC = np.array([False, True, True, True, False])  # of backlash, m_max, a, b, c: searched by its logarithm
LARGEST_BACKLASH = 0.5  # fraction of stroke, as all below
LEAST_REVERSAL = 0.01  # of the command, that counts
_HOLD_TOLERANCE = 2e-3  # between the commands of one hold
FEWEST_SAMPLES = 20  # flows to fit
_LEAST_EVIDENCE = 10.0  # difference of BIC from which a line replaces Eq (2): very strong, Kass and Raftery (1995)


def _is_flow_settled(log: CheckedLog, fitting: Mask, notes: list[str]) -> Mask:
    """Whether half a typical hold has passed since the command changed, (n,); always if it is not held."""
    command, step = log.values["command"], median_step(log, fitting)
    seconds_since_change, starts = np.zeros(command.size), [0]
    for t in range(1, command.size):
        if abs(command[t] - command[starts[-1]]) > _HOLD_TOLERANCE or log.batch[t] != log.batch[t - 1]:
            starts.append(t)
        seconds_since_change[t] = log.time[t] - log.time[starts[-1]]
    hold_lengths = np.diff(np.minimum([*starts, command.size], int(np.flatnonzero(fitting)[-1]) + 1))
    hold_lengths = hold_lengths[hold_lengths > 0]
    typical_hold = float(np.median(hold_lengths))
    if typical_hold < 4:  # the command is not held
        return np.ones(command.size, dtype=bool)
    wait = 0.5 * typical_hold * step
    is_settled = seconds_since_change >= wait
    count = f"{int((~is_settled).sum()):,} of {is_settled.size:,} flows not compared"
    holds = f"{hold_lengths.size:,} holds, typically {typical_hold * step:.4g} s"
    notes.append(f"{count}: less than {wait:g} s after the command changed ({holds})")
    return np.asarray(is_settled)


def median_step(log: CheckedLog, fitting: Mask) -> float:
    """Return the median time between the rows that are fitted, s; that of the log if there is only one."""
    return float(np.median(np.diff(log.time[fitting]))) if fitting.sum() > 1 else log.step


def _find_meter_floor(flow: Array, notes: list[str]) -> float:
    """Find the floor of a flow meter, kg/s: its lowest reading above 0 if that is frequent, else 0; and note it."""
    flow_above_0 = flow[np.isfinite(flow) & (flow > 0.0)]
    lowest = float(flow_above_0.min(initial=np.inf))
    n_lowest = int((flow_above_0 == lowest).sum())
    if n_lowest < max(5, 0.02 * flow_above_0.size):
        return 0.0
    notes.append(f"the flow meter reads {lowest:.4g} kg/s {n_lowest:,} times and never less: taken as its floor")
    return lowest


def _is_sensor_off(command: Array, flow: Array, floor: float, fitting: Mask) -> Mask:
    """Whether the sensor or the pump seems off, (n,): a flow of 0, or of the meter's floor, with the valve far open."""
    is_still = flow <= floor
    flows_from = 1.0
    for lower in np.arange(0.0, 1.0, 0.05):
        is_in_bin = (command >= lower) & (command < lower + 0.05) & np.isfinite(flow) & fitting
        if is_in_bin.sum() >= 3 and is_still[is_in_bin].mean() < 0.5:
            flows_from = lower
            break
    # a valve this much further open than one that passes water passes water
    is_off = is_still & (command > flows_from + 0.25)
    return np.asarray(is_off | (flow == 0.0) if floor > 0.0 else is_off)


class ValveSolution(NamedTuple):
    """Solution of the fit of a valve: the minimum, its uncertainty, and the profile over the backlash."""

    model: Model
    estimate: Estimate
    uncertainty: Uncertainty
    grid: Array
    sums: Array  # least sum of squares with the backlash held at each value of ``grid``, (n,)
    limit: float  # of the sums, below which ``interval`` lies if errors of the flow are all that is wrong
    parts: Array  # backlash of each part of the log; if they differ by more, ``interval`` is wider
    interval: tuple[float, float]  # of 95 %
    without_backlash: Estimate


class ValveProblem:
    """The least-squares problem of a valve: its log, the samples that are compared, and the model.

    curve: ``richards``, Eq (2), or ``linear``, m_max times the opening, whose sets have shapes without effect.
    """

    def __init__(self, data: CheckedLog, fitting: Mask, m_max: float | None = None) -> None:
        self.data, self.notes, self.batch = data, list(data.notes), data.batch
        self.m_max, self.curve = m_max, "richards"
        self.command, self.flow = data.values["command"], data.values["m_w"]
        self.fitting = fitting  # whether each sample is fitted
        self.floor = _find_meter_floor(self.flow[self.fitting], self.notes)
        is_off = _is_sensor_off(self.command, self.flow, self.floor, self.fitting)
        if is_off.any():
            which = f"0, or the meter's floor with the valve open ({describe_first_row(data.rows.tolist(), is_off)})"
            self.notes.append(f"{format_count(is_off, 'flow')} left out, sensor or pump off: {which}")
        is_settled = _is_flow_settled(data, self.fitting, self.notes)
        is_enabled = data.values.get("enabled", np.ones(self.flow.size)) != 0.0
        if not is_enabled.all():
            self.notes.append(f"{format_count(~is_enabled, 'flow')} not compared: enabled is 0")
        self.good = np.isfinite(self.flow) & ~is_off & is_settled & is_enabled
        is_to_fit = self.good & self.fitting
        if is_to_fit.sum() < FEWEST_SAMPLES:
            cure = f"give at least {FEWEST_SAMPLES}, or raise split ({'; '.join(self.notes)})"
            raise InputError(f"{data.name}: {format_count(is_to_fit, 'flow')} left to fit: {cure}", "log", "data")
        self.n_fit = int(np.flatnonzero(self.fitting)[-1]) + 1
        self.n_pieces = int(self.batch[self.n_fit - 1]) + 1  # of the part to fit
        self.top = float(np.nanmax(self.flow[self.fitting]))
        command, pieces = self.command[self.fitting], split_segments(self.batch[self.fitting])
        self.n_reversals = sum(count_reversals(command[piece], LEAST_REVERSAL) for piece in pieces)

    def flows(self, sets: Array, start: Array, command: Array) -> tuple[Array, Array]:
        """Simulate openings and flows of parameter sets, (5, sets), with these commands; no flow is below the floor."""
        n = command.size
        openings, flows = np.empty((2, n, sets.shape[1]))
        rows = np.where(IS_LOGARITHMIC[:, None], np.exp(sets), sets)
        valve_flows(np.ascontiguousarray(command), self.batch[:n], rows, np.ascontiguousarray(start), openings, flows)
        if self.curve == "linear":
            flows = np.exp(sets[M_MAX]) * openings
        return openings, np.maximum(flows, self.floor)

    @property
    def fixed(self) -> list[int]:
        """Parameters that are not fitted."""
        return [M_MAX] * (self.m_max is not None) + [*SHAPE] * (self.curve == "linear")

    def model(self) -> Model:
        """Return the least-squares model of the fitted samples."""
        n, n_pieces = self.n_fit, self.n_pieces
        is_used = self.good[:n] & self.fitting[:n]

        def residuals(sets: Array) -> Array:
            return self.flows(sets[:5], sets[5:], self.command[:n])[1] - self.flow[:n, None]

        log_top = math.log(self.top)
        lower = np.array([0.0, log_top - 1.0, math.log(0.01), math.log(0.5), -2.0, *[0.0] * n_pieces])
        upper = np.array([LARGEST_BACKLASH, log_top + 3.0, math.log(20.0), math.log(200.0), 3.0, *[1.0] * n_pieces])
        if self.m_max is not None:
            lower[M_MAX] = min(lower[M_MAX], math.log(self.m_max) - 1.0)
            upper[M_MAX] = max(upper[M_MAX], math.log(self.m_max) + 1.0)
        step = np.array([1e-3, 1e-4, 1e-4, 1e-4, 1e-4, *[0.02] * n_pieces])
        return Model(residuals, lower, upper, step, self.batch[:n], is_used, n_pieces)

    def _starts(self) -> Array:
        """Return parameter sets to start from, (p, sets): shapes of the curve, each with several backlashes."""
        shapes = product(
            (0.0, 0.02, 0.04, 0.06, 0.09, 0.13, 0.18, 0.25),
            [math.log(self.m_max)] if self.m_max else [math.log(self.top * f) for f in (1.03, 1.5)],
            *(((0.0,),) * 3 if self.curve == "linear" else (
                (math.log(0.5), math.log(2.0)), (math.log(5.0), math.log(8.0), math.log(14.0)), (0.2, 0.4, 0.6, 0.85),
            )),
        )  # fmt: skip
        return np.array([[*shape, *[0.5] * self.n_pieces] for shape in shapes]).T

    def _choose_curve(self) -> Estimate:
        """Fit both curves, and keep Eq (2) unless the Bayesian information criterion clearly prefers a straight line.

        It counts as many samples as the correlated residuals of the straight line are worth.
        """
        estimates = {}
        for curve in ("richards", "linear"):
            self.curve = curve
            estimates[curve] = minimise(self.model(), self._starts(), self.fixed)
        n = uncertainty(self.model(), estimates["linear"], self.fixed).n_effective
        rss = {curve: max(estimate.rss, 1e-300) for curve, estimate in estimates.items()}
        evidence = n * math.log(rss["richards"] / rss["linear"]) + len(SHAPE) * math.log(n)
        self.curve = "linear" if evidence > _LEAST_EVIDENCE else "richards"
        line = "a straight line, m_max times the opening"
        verdict = f"{line}: its BIC is {evidence:.3g} below that of Eq (2)"
        if self.curve == "richards":
            verdict = f"Eq (2): the BIC of {line}, is "
            verdict += f"only {evidence:.2g} lower" if evidence > 0.0 else f"{-evidence:.3g} higher"
        errors = (math.sqrt(value / int((self.good & self.fitting).sum())) for value in rss.values())
        self.notes.append(f"curve: {verdict} (RMSE {{:.2g}} kg/s of Eq (2), {{:.2g}} of the line)".format(*errors))
        return estimates[self.curve]

    def solve(self) -> ValveSolution:
        """Choose the curve, profile over the backlash, and fit again from a better minimum if the profile finds one."""
        best = self._choose_curve()
        model, fixed = self.model(), self.fixed
        for n_restarts in range(3):
            spread = uncertainty(model, best, fixed, profiled=[X_BL])
            spread = least_squares.widen_by_blocks(model, best, spread)
            grid = _profile_grid(best, spread)
            minima = least_squares.profile_parameter(model, best, X_BL, grid, fixed)
            sums = np.array([minimum.rss for minimum in minima])
            if sums.min() > best.rss * (1.0 - 1e-6) or n_restarts == 2:
                break
            best = minimise(model, np.stack([best.x, minima[int(sums.argmin())].x], axis=1), fixed)
        limit = best.rss + spread.inflation[X_BL] * spread.quantile() ** 2 * spread.variance
        parts = _fit_parts(model, best, fixed)
        quantile, deviation = spread.quantile(parts.size - 1), float(parts.std(ddof=1))
        half_width = thresholds.PART_SPREAD_FACTOR * quantile * deviation / math.sqrt(parts.size)
        interval = _profile_interval(grid, sums, best, limit, half_width)
        return ValveSolution(model, best, spread, grid, sums, limit, parts, interval, minima[0])


def _profile_grid(best: Estimate, spread: Uncertainty) -> Array:
    """Return the backlashes at which to profile: coarse over the whole range, fine around the minimum."""
    x, variance = float(best.x[X_BL]), spread.covariance[X_BL, X_BL]
    top = min(max(0.25, 2.0 * x), LARGEST_BACKLASH)
    width = 3.0 * math.sqrt(variance) if np.isfinite(variance) else 0.02
    width = min(max(width, 2e-3), 0.1)
    fine = np.linspace(max(x - width, 0.0), min(x + width, top), 12)
    return np.unique(np.round(np.concatenate([np.linspace(0.0, top, 25), fine]), 6))


def _profile_interval(grid: Array, sums: Array, best: Estimate, limit: float, half_width: float) -> tuple[float, float]:
    """Return the interval in which the profile is below its limit, at least ``half_width`` on both sides."""
    x_best = float(best.x[X_BL])
    x, y = np.append(grid, x_best), np.append(sums, best.rss)
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    below_limit = np.flatnonzero(y <= limit)

    def crossing(k_inside: int, k_outside: int) -> float:
        """Return where the profile reaches the limit between two points; the first if there is no second."""
        if not 0 <= k_outside < x.size:
            return float(x[k_inside])
        rise = max(y[k_outside] - y[k_inside], 1e-300)
        return float(x[k_inside] + (x[k_outside] - x[k_inside]) * (limit - y[k_inside]) / rise)

    low, high = (crossing(int(below_limit[end]), int(below_limit[end]) + step) for end, step in ((0, -1), (-1, 1)))
    return max(min(low, x_best - half_width), 0.0), min(max(high, x_best + half_width), LARGEST_BACKLASH)


def _fit_parts(model: Model, best: Estimate, fixed: list[int]) -> Array:
    """Fit the backlash to each of some consecutive parts of the log, (parts,), with the same shape of the curve."""
    count = np.cumsum(model.used) - 1
    n_parts = int(np.clip(count[-1] // 30, 4, 6))
    part_number = np.maximum(count, 0) * n_parts // (count[-1] + 1)
    parts = (replace(model, used=model.used & (part_number == k)) for k in range(n_parts))
    estimates = [minimise(part, best.x[:, None], [*fixed, *SHAPE], max_steps=25) for part in parts]
    return np.array([estimate.x[X_BL] for estimate in estimates])


class Verdict(NamedTuple):
    """Judgement of a fit: 95 % interval of the backlash, why it is not identified, and a note, either may be empty."""

    interval: tuple[float, float]
    why: str
    note: str


def judge_interval(problem: ValveProblem, solution: ValveSolution, holds: bool) -> Verdict:
    """Widen the interval of a fit for motion between the rows, and judge it; ``holds``: there is no such motion.

    An interval no wider than the backlash, or than 2 % of the stroke, identifies it.  One that just misses 0 can be
    chance, and its middle is then too large.
    """
    interval, x, largest = solution.interval, float(solution.estimate.x[X_BL]), solution.grid[-1]

    def why_wide(low: float, high: float) -> str:
        if problem.n_reversals < 2:
            count = f"{format_count(problem.n_reversals, 'time')} by more than {100 * LEAST_REVERSAL:.0f} % of stroke"
            cure = "give a log in which it goes up and down, or bridge gaps with fc.read_log(..., max_gap=SECONDS), "
            return f"not identified: the command reverses only {count}: {cure}--max-gap"
        if not (high >= largest or high - low > max(x, 0.02)):
            return ""
        cure = "give a longer log, in which the command also makes small reversals where the curve is steep"
        return f"not identified: anything from {low:.3g} to {high:.3g} fits as well (95 %): {cure}"

    sampling_cause = (
        f"rows are {median_step(problem.data, problem.fitting):.4g} s apart, and a controller may move the valve "
        "between them, unseen: log as often as it acts; if the command holds from row to row, say so: "
        "holds='command', --hold command"
    )
    why = why_wide(*interval)
    motion_share = 0.0 if holds else _motion_share(problem, solution)
    if motion_share > thresholds.LARGEST_MOTION_SHARE and not why:
        why = f"not identified: {sampling_cause}"
    elif motion_share > thresholds.LARGEST_MOTION_SHARE and problem.n_reversals > 1:
        why += f"; or {sampling_cause}"
    if why or motion_share == 0.0:
        return Verdict(interval, why, "")
    allowance = thresholds.ALLOWANCE_PER_MOTION_SHARE * math.sqrt(motion_share) * x + thresholds.LEAST_ALLOWANCE
    low, high = max(interval[0] - allowance, 0.0), interval[1] + allowance
    if why_wide(low, high):
        why = f"not identified: a backlash of {low:.2g} to {high:.2g} is possible: {sampling_cause}"
        return Verdict((low, high), why, "")
    note = f"the interval of the backlash allows {allowance:.2g} for motion between the rows: {sampling_cause}"
    return Verdict((low, high), "", note if allowance > 0.05 * x else "")


def _motion_share(problem: ValveProblem, solution: ValveSolution) -> float:
    """Return the variance that motion between the rows may have left, over that which the backlash explains.

    The noise of the meter is subtracted; 0 if the command rests at most rows, or the residual is too small for motion.
    """
    n = problem.n_fit
    command, batch = problem.command[:n], problem.batch[:n]
    flow = np.where(problem.good & problem.fitting, problem.flow, np.nan)[:n]
    is_same_piece = np.diff(batch) == 0
    is_moving = np.abs(np.diff(command)) > _HOLD_TOLERANCE
    if not is_same_piece.any() or is_moving[is_same_piece].mean() < thresholds.LEAST_MOVING_SHARE:
        return 0.0
    n_compared = max(int(solution.model.used.sum()), 1)
    estimates = solution.estimate, solution.without_backlash
    residual, residual_without = (estimate.rss / n_compared for estimate in estimates)
    changes = np.diff(flow)[is_same_piece]
    mean_square_change = float(np.nanmean(changes**2)) if np.isfinite(changes).any() else 0.0
    is_little = residual < thresholds.LITTLE_RESIDUAL**2 * mean_square_change and residual < 0.5**2 * residual_without
    if is_little or residual < thresholds.TINY_RESIDUAL**2 * mean_square_change:
        return 0.0
    noise = _meter_noise(command, np.where(flow > problem.floor, flow, np.nan), ~is_moving & is_same_piece) ** 2
    # squared residuals up to 1.2 times the meter's noise may be that noise alone
    return max(residual - 1.2 * noise, 1e-6 * residual) / max(residual_without - min(noise, 0.9 * residual), 1e-300)


def _meter_noise(command: Array, flow: Array, is_still: Mask) -> float:
    """Standard deviation of the meter's noise while the command rests for three rows, kg/s; 0 if it hardly rests."""
    # two equal commands may be chance: the valve may have moved between them
    is_inside_stroke = (command[1:-1] > 0.01) & (command[1:-1] < 1.0 - 0.01)
    changes = np.abs(np.diff(flow)[1:][is_still[1:] & is_still[:-1] & is_inside_stroke])
    changes = changes[np.isfinite(changes)]
    if changes.size < 20:
        return 0.0
    return float(np.sqrt(0.5 * np.mean(np.clip(changes, 0.0, 6.0 * np.median(changes)) ** 2)))

"""The PI controller that wrote a log, recovered from error and command, and the plant that answered it.

The plant is valve and coil as a static curve behind two lags and a delay.  The temperature is c₁ o + c₂ o² of the
opening o, delayed and filtered, plus a disturbance: all that the opening does not explain, measurement noise included.
The curve is linear in its coefficients, so that lags and delay are searched on a grid (separable least squares).  The
disturbance drifts, and the controller answers it: its changes are whitened by an autoregression fitted along with the
plant, without which a loop that works well would hide its own plant.

The ARIX of ``identify`` predicts the next half minute better.  It is not taken here, since a controller that
samples every few seconds cannot be run on half minutes, and nothing makes the loop that it closes a stable one.
"""

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs.series import format_count
from fastcoil.measured.grid import is_range_good, motor_positions, openings

LARGEST_HELD_CHANGE = 1e-9  # a command that changes by less is held
LEAST_CHANGES, LEAST_PI_ROWS = 20, 30
BUSY_CHANGES = 20  # changes of the command in a row whose mean distance is the sample time, where it is shortest
EXACT_RESIDUAL = 1e-3  # residual, as a share of the changes, below which the log holds every sample of the controller
_PHASE_STEP, _PHASE_TOLERANCE = 0.1, 0.02
"""Of the log's interval: step of the phase at which a controller of another rhythm samples; share of the command's
changes by which a phase may agree with them less than the best."""
FAST_SAMPLE_TIMES_S = (
    1.0,
    2.0,
    4.0,
    5.0,
    6.0,
    7.0,
    8.0,
)  # sample times of a controller that are tried where the log is coarser, s
ROW_LAGS = (1, 2, 4)  # changes that a row of the fit spans
USUAL_SAMPLE_TIME_S = 10.0  # seconds between samples of a controller that a coarser log does not resolve
LARGEST_LATER_SHARE = 0.9
"""Share of what one sample leaves unexplained that the sample before may leave at most to be taken in its place."""
LEAST_EXPLAINED = 0.9  # share of the variance of the command's changes that a PI has to explain
SATURATION_TOLERANCE = 1e-6  # a command this close to 0 or 1 is saturated


class RecoveredPI(NamedTuple):
    """A PI controller, Δu = kp Δe + kp (sample_time/ti) e with e = T - T_set."""

    kp: float  # 1/K, below 0 for heating
    ti: float  # s
    sample_time: float  # s
    explained: float  # share of the variance of the command's changes
    phase: float = 0.0  # of its samples against those of the log, s, where their rhythms differ

    def acting_samples(self, at: Array, interval: float) -> Index:
        """Which sample of the log shows the command that acts at each time, in samples of the log."""
        if self.sample_time % interval <= LARGEST_HELD_CHANGE:
            return np.asarray(at.astype(int))
        behind = (at * interval - self.phase) % self.sample_time
        return np.maximum(np.ceil(at - behind / interval - LARGEST_HELD_CHANGE), 0).astype(int)


class _Regression(NamedTuple):
    kp: float
    ki: float  # kp/ti
    explained: float

    def to_pi(self, sample_time: float) -> RecoveredPI:
        return RecoveredPI(self.kp, self.kp / self.ki if self.ki else np.inf, sample_time, self.explained)


def recover_pi(
    command: Array, temperature: Array, T_set: Array, interval: float, good: Mask, sample_time: float | None,
    gains: tuple[float, float] | None = None,
) -> RecoveredPI | str:  # fmt: skip
    """kp, ti and, if None, the sample time of a PI; a sentence if the command follows none; ``gains``: kp > 0, ti."""
    changes = np.flatnonzero((np.abs(np.diff(command)) > LARGEST_HELD_CHANGE) & good[1:] & good[:-1]) + 1
    if changes.size < LEAST_CHANGES:
        return f"the command changes only {format_count(changes.size, 'time')}: log a day on which the loop is in operation"
    every = _find_sample_time(command, changes, interval) if sample_time is None else sample_time
    candidates = []
    for late in (0, 1):  # many logs write the command that answers a temperature one sample after it
        at = np.maximum(np.arange(command.size) - late, 0)
        T, set_point, is_usable = temperature[at], T_set[at], good & good[at]
        is_usable[:late] = False
        if every > 1.2 * interval:
            # a log at least as fine as the controller: a row for each few changes that are one sample apart each
            is_one_sample = (
                np.abs(np.diff(changes) * interval - every) < max(interval, 0.5 * every) - LARGEST_HELD_CHANGE
            )
            fit = _fit_best_pi(
                command, T - set_point, changes, is_one_sample, np.cumsum(every * (T - set_point)[changes])
            )
            candidates.append(fit and fit.to_pi(every))
        else:
            error_integrals = interval * (0.5 * (T[1:] + T[:-1]) - set_point[:-1])
            candidates.append(
                _fit_coarse_log(command, T - set_point, error_integrals, is_usable, interval, sample_time)
            )
    best, best_later = candidates
    if best is None or (
        best_later is not None and 1.0 - best_later.explained < LARGEST_LATER_SHARE * (1.0 - best.explained)
    ):
        best = best_later
    is_unseen = sample_time is None and every <= interval and (best is None or 1.0 - best.explained > EXACT_RESIDUAL**2)
    for rhythm in FAST_SAMPLE_TIMES_S if is_unseen else (every,):
        if rhythm % interval > LARGEST_HELD_CHANGE:
            phase_fits = _fit_phases(command, temperature, T_set, good, interval, rhythm)
            best = max(
                [*filter(None, [best]), *phase_fits], key=lambda is_one_sample: is_one_sample.explained, default=None
            )
    if best is None:
        return "too little of the log shows the controller at work: the command is saturated or hardly moves"
    if gains is not None:
        return best._replace(kp=math.copysign(gains[0], best.kp), ti=gains[1])
    if best.explained < LEAST_EXPLAINED:
        return (
            f"a PI of the logged error explains only {100 * max(best.explained, 0.0):.0f} % of the command's changes: "
            "the loop has another control law or an inverse, or the logged set-point is not the controller's"
        )
    if best.ti <= 0.0 or not np.isfinite(best.ti):
        return "the command moves without an error: not a PI"
    return best


def _find_sample_time(command: Array, changes: Index, interval: float) -> float:
    """Seconds between the controller's samples, or ``interval`` if the log is coarser."""
    # a saturated command is held for as long as it stays so and carries no information
    held_command = command[changes[:-1]]
    gaps = np.diff(changes)[(held_command > SATURATION_TOLERANCE) & (held_command < 1.0 - SATURATION_TOLERANCE)]
    if gaps.size == 0:
        return interval
    busy = min(BUSY_CHANGES, gaps.size)
    total = np.concatenate([[0], np.cumsum(gaps)])
    estimate = float(np.quantile(total[busy:] - total[:-busy], 0.1)) * interval / busy
    rounded = 5.0 * round(estimate / 5.0)
    return rounded if abs(estimate - rounded) < 0.05 * estimate and rounded > 0.0 else estimate


def _fit_phases(
    command: Array, temperature: Array, T_set: Array, good: Mask, interval: float, every: float
) -> list[RecoveredPI]:
    """For each phase of another rhythm than the log's that agrees with when the command changes; T runs straight."""
    changes = np.flatnonzero(np.abs(np.diff(command)) > LARGEST_HELD_CHANGE) + 1
    phases = []
    for phase in np.arange(0.0, every, _PHASE_STEP * interval):
        at = np.arange(phase, (command.size - 2) * interval, every) / interval
        logged_at = np.ceil(at - LARGEST_HELD_CHANGE).astype(int)
        phases.append((float(np.isin(changes, logged_at).mean()), at, logged_at))
    best_agreement = max(agreement for agreement, _, _ in phases)
    fits = []
    for agreement, at, logged_at in phases:
        if agreement < best_agreement - _PHASE_TOLERANCE:
            continue
        before = np.floor(at + LARGEST_HELD_CHANGE).astype(int)
        error = np.interp(at, np.arange(command.size), temperature) - T_set[before]
        usable = good[before] & good[before + 1]
        integral = np.cumsum(every * np.where(usable, error, 0.0))
        last = np.append(np.diff(logged_at) > 0, False)  # of the controller's samples before one of the log
        if fit := _fit_best_pi(command[logged_at], error, np.arange(at.size), usable[1:] & usable[:-1], integral, last):
            fits.append(fit.to_pi(every)._replace(phase=float(at[0] * interval)))
    return fits


def _fit_coarse_log(
    command: Array, error: Array, error_integrals: Array, good: Mask, interval: float, sample_time: float | None
) -> RecoveredPI | None:
    """From a log as fine as the controller or coarser; ``error_integrals``: K s from each sample of it to the next."""
    is_pair_good = good[1:] & good[:-1]

    def fit_sums(sums: Array) -> _Regression | None:
        integral = np.concatenate([[0.0], np.cumsum(np.where(is_pair_good, sums, 0.0))])
        return _fit_best_pi(command, error, np.arange(command.size), is_pair_good, integral)

    fit = fit_sums(interval * error[1:])
    if fit is not None and 1.0 - fit.explained < EXACT_RESIDUAL**2:
        return fit.to_pi(interval)
    fit = fit_sums(error_integrals)
    # each sample adds the new error before use: half a sample more than the straight line
    every = min(0.5 * interval, USUAL_SAMPLE_TIME_S) if sample_time is None else sample_time
    return fit and fit._replace(kp=fit.kp - 0.5 * every * fit.ki).to_pi(every)


def _fit_best_pi(
    command: Array, error: Array, at: Index, is_unbroken: Mask, integral: Array, is_end: Mask | None = None
) -> _Regression | None:
    """The fit of the changes between the samples ``at``, (n,), over the lag that explains most.

    whole: where nothing is missing up to the next of them, (n - 1,).  integral: of the error up to each.  ends: those
    between which changes are compared, all if None.  A log whose samples fall between those of the controller sees one
    of these now and two then; a longer lag evens that out, and what a coarse resolution does too.
    """
    fits, broken_before = [], np.concatenate([[0], np.cumsum(~is_unbroken)])
    for lag in ROW_LAGS:
        is_used = broken_before[lag:] == broken_before[:-lag]
        first = np.flatnonzero(is_used if is_end is None else is_used & is_end[lag:] & is_end[:-lag])
        fits.append(regress_pi(command, error, at[first], at[first + lag], integral[first + lag] - integral[first]))
    return max(filter(None, fits), key=lambda fit: fit.explained, default=None)


def regress_pi(command: Array, error: Array, before: Index, after: Index, integral: Array) -> _Regression | None:
    """The PI of changes of the command; saturated ones, and those of a saturated integral, are left out."""
    du, de = command[after] - command[before], error[after] - error[before]
    inside = np.minimum(command[before], command[after]) > SATURATION_TOLERANCE
    inside &= np.maximum(command[before], command[after]) < 1.0 - SATURATION_TOLERANCE
    X = np.stack([de, integral], axis=1)
    is_used = inside
    for _ in range(3):
        if is_used.sum() < LEAST_PI_ROWS or not np.any(du[is_used]):
            return None
        kp, ki = np.linalg.lstsq(X[is_used], du[is_used], rcond=None)[0]
        sums = np.stack([command[i] - kp * error[i] for i in (before, after)])
        is_used = inside & (sums.min(axis=0) > SATURATION_TOLERANCE) & (sums.max(axis=0) < 1.0 - SATURATION_TOLERANCE)
    residual, total = du[is_used] - X[is_used] @ (kp, ki), float(du[is_used] @ du[is_used])
    return _Regression(float(kp), float(ki), 1.0 - float(residual @ residual) / total) if total > 0.0 else None


LONGEST_STEP_S = 5.0  # the loop is simulated at this many seconds or less
PLANT_LAGS_S = (5.0, 12.0, 25.0, 45.0, 80.0, 140.0)
PLANT_DELAYS_S = (0.0, 10.0, 20.0)  # seconds, as the lags, tried first; then the neighbours of the best
CHANGE_SPAN_S, AUTOREGRESSION_SPAN_S = 15.0, 120.0
"""Seconds between the changes that are compared, and over which the autoregression remembers."""
N_ROUNDS = 3
PRIOR_PRECISION = 0.01  # of the prior of the curve's coefficients, 1/K², as in ``identify``
LEAST_PLANT_ROWS = 60


class FittedPlant(NamedTuple):
    """A plant and its day."""

    curve: tuple[float, float]  # c₁, c₂, K per stroke; straight beyond the openings from ``least`` to ``most``
    least: float
    most: float
    lags: tuple[float, float]  # s
    delay: int  # steps
    step: float  # of the simulation, s
    per_sample: int  # steps to a sample of the log
    disturbance: Array  # (n,), K, at the samples of the log
    explained: float  # share of the whitened changes of the temperature that the opening explains

    def slope(self, opening: float) -> float:
        """K per stroke at an opening, once all has settled."""
        return self.curve[0] + 2.0 * self.curve[1] * min(max(opening, self.least), self.most)

    @property
    def gain(self) -> float:
        """K per stroke in the middle of the openings of the log."""
        return self.slope(0.5 * (self.least + self.most))


def fit_plant(
    command: Array, temperature: Array, good: Mask, interval: float, backlash: float, stroke_time: float,
    pi: RecoveredPI,
) -> FittedPlant | None:  # fmt: skip
    """The plant between command and temperature, without NaN; None if none that the PI can control explains it."""
    per_sample = math.ceil(interval / LONGEST_STEP_S)
    step = interval / per_sample
    at = np.arange((command.size - 1) * per_sample + 1) / per_sample
    is_held = pi.sample_time >= interval
    fine_command = command[pi.acting_samples(at, interval)] if is_held else np.interp(at, np.arange(command.size), command)
    sign = -1.0 if pi.kp > 0.0 else 1.0
    opening = openings(motor_positions(fine_command, step, stroke_time)[:-1], backlash)
    logged_openings = opening[::per_sample][good]
    rows = _WhitenedChanges(temperature, good, interval)
    if rows.used.sum() < LEAST_PLANT_ROWS:
        return None
    for powers in (2, 1):
        best = _search_plant(np.stack([opening**k for k in range(1, powers + 1)], axis=1), rows, step, per_sample)
        curve = (float(best.curve[0]), float(best.curve[1]) if powers > 1 else 0.0)
        plant = FittedPlant(
            curve, float(logged_openings.min()), float(logged_openings.max()), (best.slow, best.fast), best.delay, step, per_sample,
            temperature - best.filtered @ best.curve, best.explained,
        )  # fmt: skip
        if min(sign * plant.slope(opening) for opening in (plant.least, plant.most)) > 0.0:
            return plant
    return None


class _WhitenedChanges:
    """Changes of series of the log over about ``APART`` s, whitened, where all that they need may be used."""

    def __init__(self, temperature: Array, good: Mask, interval: float) -> None:
        self.width = max(1, round(CHANGE_SPAN_S / interval))
        self.order = max(2, round(AUTOREGRESSION_SPAN_S / (self.width * interval)))
        ends = np.arange((self.order + 1) * self.width, good.size, self.width)
        self.used = is_range_good(good, ends - (self.order + 1) * self.width, ends)
        self.y = self.changes(temperature)
        self.memory: Array = np.zeros(self.order)

    def changes(self, series: Array) -> Array:
        """(n_changes, …): between each ``width`` samples, first axis of ``series``."""
        return np.asarray(np.diff(series[:: self.width], axis=0))

    def whiten(self, changes: Array) -> Array:
        """Less what the autoregression predicts, in the rows that are used; first axis of ``changes``."""
        residual = changes[self.order :].copy()
        for lag, share in enumerate(self.memory, 1):
            residual -= share * changes[self.order - lag : changes.shape[0] - lag]
        return np.asarray(residual[self.used])

    def fit_memory(self, residual: Array) -> None:
        """Fit the autoregression to the changes of a disturbance."""
        n = residual.size
        X = np.stack([residual[self.order - lag : n - lag] for lag in range(1, self.order + 1)], axis=1)
        self.memory = np.asarray(np.linalg.lstsq(X[self.used], residual[self.order :][self.used], rcond=None)[0], float)


class _SearchPoint(NamedTuple):
    """A point of the search."""

    slow: float  # lags, s
    fast: float
    delay: int  # steps
    filtered: Array  # (n, powers), what the curve weights, at the samples of the log
    rss: float = math.inf
    curve: Array = np.empty(0)
    explained: float = 0.0


def _search_plant(basis: Array, rows: _WhitenedChanges, step: float, per_sample: int) -> _SearchPoint:
    """The best lags, delay and curve on the grid, then among the neighbours of these."""
    rows.memory = np.zeros(rows.order)
    pairs = [(slow, fast) for slow in PLANT_LAGS_S for fast in PLANT_LAGS_S if fast <= slow]
    grid = [(*lags, round(delay / step)) for lags in pairs for delay in PLANT_DELAYS_S]
    candidates = _filter_basis(basis, grid, step, per_sample)
    for _ in range(N_ROUNDS):
        best = _find_best_point(candidates, rows)
        rows.fit_memory(rows.y - rows.changes(best.filtered) @ best.curve)
    factors = (0.75, 1.0, 1.33)
    delays = sorted({max(best.delay + change, 0) for change in (-1, 0, 1)})
    grid = [(best.slow * a, best.fast * b, delay) for a in factors for b in factors for delay in delays]
    return _find_best_point(_filter_basis(basis, grid, step, per_sample), rows)


def _filter_basis(
    basis: Array, grid: list[tuple[float, float, int]], step: float, per_sample: int
) -> list[_SearchPoint]:
    """The basis behind the lags and delay of each point of a grid, at the samples of the log."""
    pairs = sorted({(slow, fast) for slow, fast, _ in grid})
    filtered = np.repeat(basis[:, :, np.newaxis], len(pairs), axis=2)
    for lags in zip(*pairs, strict=True):
        filtered = first_order_lag(filtered, 1.0 - np.exp(-step / np.array(lags)))
    points = []
    for slow, fast, delay in grid:
        series = filtered[:, :, pairs.index((slow, fast))]
        start = np.repeat(series[:1], delay, axis=0)
        delayed = np.concatenate([start, series[: series.shape[0] - delay]])[::per_sample]
        points.append(_SearchPoint(slow, fast, delay, delayed))
    return points


def first_order_lag(series: Array, share: Array | float) -> Array:
    """First-order lag along the first axis that goes ``share`` of the way to each new input; it starts at rest."""
    filtered = np.empty_like(series)
    state = series[0]
    for k, target in enumerate(series):
        filtered[k] = state = state + share * (target - state)
    return filtered


def _find_best_point(candidates: list[_SearchPoint], rows: _WhitenedChanges) -> _SearchPoint:
    y = rows.whiten(rows.y)
    total = float(y @ y)
    precision = PRIOR_PRECISION * total / y.size
    best = candidates[0]
    for candidate in candidates:
        X = rows.whiten(rows.changes(candidate.filtered))
        curve = np.asarray(np.linalg.solve(X.T @ X + precision * np.eye(X.shape[1]), X.T @ y), float)
        residual = y - X @ curve
        rss = float(residual @ residual + precision * curve @ curve)
        if rss < best.rss:
            best = candidate._replace(rss=rss, curve=curve, explained=1.0 - float(residual @ residual) / total)
    return best

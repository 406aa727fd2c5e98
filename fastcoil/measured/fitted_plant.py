"""The PI controller of a log, recovered from error and command, and its plant.

The plant is valve and coil as a static curve behind two lags and a delay.  The temperature is c₁ o + c₂ o² of the
opening o, delayed and filtered, plus a disturbance: all that the opening does not explain, measurement noise included.
The curve is linear in its coefficients, so that lags and delay are searched on a grid (separable least squares).  The
disturbance drifts, and the controller answers it: its changes are whitened by an autoregression fitted along with the
plant, without which a loop that works well would hide its own plant.

The ARIX of ``identify`` predicts the next half minute better.  It is not taken here, since a controller that
samples every few seconds cannot be run on half minutes, and nothing makes the loop that it closes a stable one.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs.series import format_count
from fastcoil.measured.grid import is_range_good, motor_positions, openings

HELD = 1e-9  # change of a command, below which it is held
LEAST_PI_ROWS = 30
_EXACT_RESIDUAL = 1e-3  # share of the changes, below which the log holds every sample of the controller
_FAST_SAMPLE_TIMES_S = (1.0, 2.0, 4.0, 5.0, 6.0, 7.0, 8.0)  # of a controller, that are tried in a coarser log


class RecoveredPI(NamedTuple):
    """A PI controller, Δu = kp Δe + kp (sample_time/ti) e with e = T - T_set."""

    kp: float  # 1/K, below 0 for heating
    ti: float  # s
    sample_time: float  # s
    explained: float  # share of the variance of the command's changes
    phase: float = 0.0  # of its samples against those of the log, s, where their rhythms differ

    def acting_samples(self, at: Array, interval: float) -> Index:
        """Sample of the log that shows the command acting at each time ``at``, in samples of the log."""
        if self.sample_time % interval <= HELD:
            return np.asarray(at.astype(int))
        behind = (at * interval - self.phase) % self.sample_time
        return np.maximum(np.ceil(at - behind / interval - HELD), 0).astype(int)


def is_unsaturated(command: Array) -> Mask:
    """Whether a command is not at one of its ends."""
    return np.asarray((command > 1e-6) & (command < 1.0 - 1e-6))


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
    """Recover kp, ti and, if None, the sample time of a PI controller; a sentence if the command follows none.

    gains: kp > 0, 1/K, and ti, s, if they are known.
    """
    changes = np.flatnonzero((np.abs(np.diff(command)) > HELD) & good[1:] & good[:-1]) + 1
    if changes.size < 20:
        times = format_count(changes.size, "time")
        return f"the command changes only {times}: log a day on which the loop is in operation"
    every = _find_sample_time(command, changes, interval) if sample_time is None else sample_time
    candidates = []
    for late in (0, 1):  # many logs write the command that answers a temperature one sample after it
        at = np.maximum(np.arange(command.size) - late, 0)
        T, set_point, is_usable = temperature[at], T_set[at], good & good[at]
        error = T - set_point
        is_usable[:late] = False
        if every > 1.2 * interval:
            # a log at least as fine as the controller: a row for each few changes that are one sample apart each
            is_one_sample = np.abs(np.diff(changes) * interval - every) < max(interval, 0.5 * every) - HELD
            fit = _fit_best_pi(command, error, changes, is_one_sample, np.cumsum(every * error[changes]))
            candidates.append(fit and fit.to_pi(every))
        else:
            integrals = interval * (0.5 * (T[1:] + T[:-1]) - set_point[:-1])
            candidates.append(_fit_coarse_log(command, error, integrals, is_usable, interval, sample_time))
    best, later = candidates
    if best is None or (later is not None and 1.0 - later.explained < 0.9 * (1.0 - best.explained)):
        best = later
    is_exact = best is not None and 1.0 - best.explained <= _EXACT_RESIDUAL**2
    is_unseen = sample_time is None and every <= interval and not is_exact
    for rhythm in _FAST_SAMPLE_TIMES_S if is_unseen else (every,):
        if rhythm % interval > HELD:
            phase_fits = _fit_phases(command, temperature, T_set, good, interval, rhythm)
            best = max([*filter(None, [best]), *phase_fits], key=lambda pi: pi.explained, default=None)
    if best is None:
        return "too little of the log shows the controller at work: the command is saturated or hardly moves"
    if gains is not None:
        return best._replace(kp=math.copysign(gains[0], best.kp), ti=gains[1])
    if best.explained < 0.9:
        share = f"{100 * max(best.explained, 0.0):.0f} % of the command's changes"
        reason = "the loop has another control law or an inverse, or the logged set-point is not the controller's"
        return f"a PI of the logged error explains only {share}: {reason}"
    if best.ti <= 0.0 or not np.isfinite(best.ti):
        return "the command moves without an error: not a PI"
    return best


def _find_sample_time(command: Array, changes: Index, interval: float) -> float:
    """Time between the controller's samples, s, or ``interval`` if the log is coarser."""
    # a saturated command is held for as long as it stays so and carries no information
    gaps = np.diff(changes)[is_unsaturated(command[changes[:-1]])]
    if gaps.size == 0:
        return interval
    busy = min(20, gaps.size)  # changes in a row whose mean distance is the sample time, where it is shortest
    total = np.concatenate([[0], np.cumsum(gaps)])
    estimate = float(np.quantile(total[busy:] - total[:-busy], 0.1)) * interval / busy
    rounded = 5.0 * round(estimate / 5.0)
    return rounded if abs(estimate - rounded) < 0.05 * estimate and rounded > 0.0 else estimate


def _fit_phases(command: Array, T: Array, T_set: Array, good: Mask, interval: float, every: float) -> list[RecoveredPI]:
    """Fit a controller of another rhythm than the log, at each phase that agrees with the changes of its command."""
    changes = np.flatnonzero(np.abs(np.diff(command)) > HELD) + 1
    phases = []
    for phase in np.arange(0.0, every, 0.1 * interval):
        at = np.arange(phase, (command.size - 2) * interval, every) / interval
        logged_at = np.ceil(at - HELD).astype(int)
        phases.append((float(np.isin(changes, logged_at).mean()), at, logged_at))
    best_agreement = max(agreement for agreement, _, _ in phases)
    fits = []
    for agreement, at, logged_at in phases:
        if agreement < best_agreement - 0.02:
            continue
        before = np.floor(at + HELD).astype(int)
        error = np.interp(at, np.arange(command.size), T) - T_set[before]
        usable = good[before] & good[before + 1]
        integral = np.cumsum(every * np.where(usable, error, 0.0))
        last = np.append(np.diff(logged_at) > 0, False)  # of the controller's samples before one of the log
        if fit := _fit_best_pi(command[logged_at], error, np.arange(at.size), usable[1:] & usable[:-1], integral, last):
            fits.append(fit.to_pi(every)._replace(phase=float(at[0] * interval)))
    return fits


def _fit_coarse_log(
    command: Array, error: Array, error_integrals: Array, good: Mask, interval: float, sample_time: float | None
) -> RecoveredPI | None:
    """Fit a log as fine as the controller or coarser; ``error_integrals``: K s between samples."""
    is_pair_good = good[1:] & good[:-1]

    def fit_sums(sums: Array) -> _Regression | None:
        integral = np.concatenate([[0.0], np.cumsum(np.where(is_pair_good, sums, 0.0))])
        return _fit_best_pi(command, error, np.arange(command.size), is_pair_good, integral)

    fit = fit_sums(interval * error[1:])
    if fit is not None and 1.0 - fit.explained < _EXACT_RESIDUAL**2:
        return fit.to_pi(interval)
    fit = fit_sums(error_integrals)
    # each sample adds the new error before use: half a sample more than the straight line
    every = min(0.5 * interval, 10.0) if sample_time is None else sample_time
    return fit and fit._replace(kp=fit.kp - 0.5 * every * fit.ki).to_pi(every)


def _fit_best_pi(
    command: Array, error: Array, at: Index, is_unbroken: Mask, integral: Array, is_end: Mask | None = None
) -> _Regression | None:
    """Fit changes between the samples ``at``, (n,), over the lag that explains most.

    is_unbroken: whether nothing is missing up to the next of them, (n - 1,).  integral: of the error up to
    each.  is_end: whether changes may start or end there, everywhere if None.  A log between the samples of the
    controller sees one of them now and two then; a longer lag evens that out, and coarse resolution as well.
    """
    fits, broken_before = [], np.concatenate([[0], np.cumsum(~is_unbroken)])
    for lag in (1, 2, 4):
        is_used = broken_before[lag:] == broken_before[:-lag]
        first = np.flatnonzero(is_used if is_end is None else is_used & is_end[lag:] & is_end[:-lag])
        fits.append(regress_pi(command, error, at[first], at[first + lag], integral[first + lag] - integral[first]))
    return max(filter(None, fits), key=lambda fit: fit.explained, default=None)


def regress_pi(command: Array, error: Array, before: Index, after: Index, integral: Array) -> _Regression | None:
    """Fit a PI controller to changes of the command; without saturated ones and those of a saturated integral."""
    du, de = command[after] - command[before], error[after] - error[before]
    inside = is_unsaturated(np.stack([command[before], command[after]])).all(axis=0)
    X = np.stack([de, integral], axis=1)
    is_used = inside
    for _ in range(3):
        if is_used.sum() < LEAST_PI_ROWS or not np.any(du[is_used]):
            return None
        kp, ki = np.linalg.lstsq(X[is_used], du[is_used], rcond=None)[0]
        is_used = inside & is_unsaturated(np.stack([command[i] - kp * error[i] for i in (before, after)])).all(axis=0)
    residual, total = du[is_used] - X[is_used] @ (kp, ki), float(du[is_used] @ du[is_used])
    return _Regression(float(kp), float(ki), 1.0 - float(residual @ residual) / total) if total > 0.0 else None


PLANT_LAGS_S = (5.0, 12.0, 25.0, 45.0, 80.0, 140.0)
PLANT_DELAYS_S = (0.0, 10.0, 20.0)  # tried first; then the neighbours of the best
PRIOR_PRECISION = 0.01  # of the curve's coefficients, 1/K², as in ``identify``


class FittedPlant(NamedTuple):
    """A plant and the disturbance of its day."""

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
        """Steady change of the temperature at an opening, K per stroke."""
        return self.curve[0] + 2.0 * self.curve[1] * min(max(opening, self.least), self.most)

    @property
    def gain(self) -> float:
        """The same in the middle of the logged openings."""
        return self.slope(0.5 * (self.least + self.most))


def fit_plant(
    command: Array, temperature: Array, good: Mask, interval: float, backlash: float, stroke_time: float,
    pi: RecoveredPI,
) -> FittedPlant | None:  # fmt: skip
    """Fit the plant between command and temperature; None if none that the PI can control explains the log."""
    per_sample = math.ceil(interval / 5.0)
    step = interval / per_sample
    at = np.arange((command.size - 1) * per_sample + 1) / per_sample
    is_held = pi.sample_time >= interval
    sample = np.arange(command.size)
    fine_command = command[pi.acting_samples(at, interval)] if is_held else np.interp(at, sample, command)
    sign = -1.0 if pi.kp > 0.0 else 1.0
    opening = openings(motor_positions(fine_command, step, stroke_time)[:-1], backlash)
    logged_openings = opening[::per_sample][good]
    rows = _WhitenedChanges(temperature, good, interval)
    if rows.used.sum() < 60:
        return None
    for powers in (2, 1):
        best = _search_plant(np.stack([opening**k for k in range(1, powers + 1)], axis=1), rows, step, per_sample)
        curve = (float(best.curve[0]), float(best.curve[1]) if powers > 1 else 0.0)
        plant = FittedPlant(
            curve, float(logged_openings.min()), float(logged_openings.max()), (best.slow, best.fast), best.delay, step,
            per_sample, temperature - best.filtered @ best.curve, best.explained,
        )  # fmt: skip
        if min(sign * plant.slope(opening) for opening in (plant.least, plant.most)) > 0.0:
            return plant
    return None


class _WhitenedChanges:
    """Whitened changes of the series of a log over 15 s, where all that they need may be used."""

    def __init__(self, temperature: Array, good: Mask, interval: float) -> None:
        self.width = max(1, round(15.0 / interval))  # s
        self.order = max(2, round(120.0 / (self.width * interval)))  # s that the autoregression remembers
        ends = np.arange((self.order + 1) * self.width, good.size, self.width)
        self.used = is_range_good(good, ends - (self.order + 1) * self.width, ends)
        self.y = self.changes(temperature)
        self.memory: Array = np.zeros(self.order)

    def changes(self, series: Array) -> Array:
        """Changes over ``width`` samples along the first axis of ``series``, (n_changes, …)."""
        return np.asarray(np.diff(series[:: self.width], axis=0))

    def whiten(self, changes: Array) -> Array:
        """Residuals of the autoregression in the rows that are used; first axis of ``changes``."""
        residual = changes[self.order :].copy()
        for lag, share in enumerate(self.memory, 1):
            residual -= share * changes[self.order - lag : changes.shape[0] - lag]
        return np.asarray(residual[self.used])

    def fit_memory(self, residual: Array) -> None:
        """Fit the autoregression to the changes of a disturbance."""
        X = np.stack([residual[self.order - lag : residual.size - lag] for lag in range(1, self.order + 1)], axis=1)
        self.memory = np.asarray(np.linalg.lstsq(X[self.used], residual[self.order :][self.used], rcond=None)[0], float)


_Dynamics = tuple[float, float, int]  # slow and fast lag, s; delay, steps


class _SearchPoint(NamedTuple):
    slow: float  # lags, s
    fast: float
    delay: int  # steps
    filtered: Array  # (n, powers), what the curve weights, at the samples of the log
    rss: float = math.inf
    curve: Array = np.empty(0)
    explained: float = 0.0


def _search_plant(basis: Array, rows: _WhitenedChanges, step: float, per_sample: int) -> _SearchPoint:
    """Find the best lags, delay and curve on the grid, then among the neighbours of these."""
    rows.memory = np.zeros(rows.order)
    pairs = [(slow, fast) for slow in PLANT_LAGS_S for fast in PLANT_LAGS_S if fast <= slow]
    grid = [(*lags, round(delay / step)) for lags in pairs for delay in PLANT_DELAYS_S]
    candidates = _filter_basis(basis, grid, step, per_sample)
    for _ in range(3):
        best = _find_best_point(candidates, rows)
        rows.fit_memory(rows.y - rows.changes(best.filtered) @ best.curve)
    factors = (0.75, 1.0, 1.33)
    delays = sorted({max(best.delay + change, 0) for change in (-1, 0, 1)})
    grid = [(best.slow * a, best.fast * b, delay) for a in factors for b in factors for delay in delays]
    return _find_best_point(_filter_basis(basis, grid, step, per_sample), rows)


def _filter_basis(basis: Array, grid: Sequence[_Dynamics], step: float, per_sample: int) -> list[_SearchPoint]:
    """Filter the basis by the lags and delay of each point of a grid, at the samples of the log."""
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
    """First-order lag along the first axis, at rest at first; ``share``: of the way to each new input."""
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

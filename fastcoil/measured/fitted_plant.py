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
from fastcoil.logs.series import counted
from fastcoil.measured.grid import all_good, motor_positions, openings

HELD = 1e-9  # a command that changes by less is held
LEAST_CHANGES, LEAST_PI_ROWS = 20, 30
BUSY = 20  # changes of the command in a row whose mean distance is the sample time, where it is shortest
EXACT = 1e-3  # residual, as a share of the changes, below which the log holds every sample of the controller
_PHASE, _AGREES = 0.1, 0.02
"""Of the log's interval: step of the phase at which a controller of another rhythm samples; share of the command's
changes by which a phase may agree with them less than the best."""
FAST = (1.0, 2.0, 4.0, 5.0, 6.0, 7.0, 8.0)  # sample times of a controller that are tried where the log is coarser, s
ROW_LAGS = (1, 2, 4)  # changes that a row of the fit spans
USUAL = 10.0  # seconds between samples of a controller that a coarser log does not resolve
LESS = 0.9
"""Share of what one sample leaves unexplained that the sample before may leave at most to be taken in its place."""
LEAST_EXPLAINED = 0.9  # share of the variance of the command's changes that a PI has to explain
EDGE = 1e-6  # a command this close to 0 or 1 is saturated


class RecoveredPI(NamedTuple):
    """A PI controller, Δu = kp Δe + kp (sample_time/ti) e with e = T - T_set."""

    kp: float  # 1/K, below 0 for heating
    ti: float  # s
    sample_time: float  # s
    explained: float  # share of the variance of the command's changes
    phase: float = 0.0  # of its samples against those of the log, s, where their rhythms differ

    def acted(self, at: Array, interval: float) -> Index:
        """Which sample of the log shows the command that acts at each time, in samples of the log."""
        if self.sample_time % interval <= HELD:
            return np.asarray(at.astype(int))
        behind = (at * interval - self.phase) % self.sample_time
        return np.maximum(np.ceil(at - behind / interval - HELD), 0).astype(int)


class _Fit(NamedTuple):
    kp: float
    ki: float  # kp/ti
    explained: float

    def pi(self, sample_time: float) -> RecoveredPI:
        return RecoveredPI(self.kp, self.kp / self.ki if self.ki else np.inf, sample_time, self.explained)


def recover_pi(
    command: Array, temperature: Array, T_set: Array, interval: float, good: Mask, sample_time: float | None,
    gains: tuple[float, float] | None = None,
) -> RecoveredPI | str:  # fmt: skip
    """kp, ti and, if None, the sample time of a PI; a sentence if the command follows none; ``gains``: kp > 0, ti."""
    changes = np.flatnonzero((np.abs(np.diff(command)) > HELD) & good[1:] & good[:-1]) + 1
    if changes.size < LEAST_CHANGES:
        return f"the command changes only {counted(changes.size, 'time')}: log a day on which the loop is in operation"
    every = _sample_time(command, changes, interval) if sample_time is None else sample_time
    answers = []
    for late in (0, 1):  # many logs write the command that answers a temperature one sample after it
        at = np.maximum(np.arange(command.size) - late, 0)
        T, wanted, usable = temperature[at], T_set[at], good & good[at]
        usable[:late] = False
        if every > 1.2 * interval:
            # a log at least as fine as the controller: a row for each few changes that are one sample apart each
            one = np.abs(np.diff(changes) * interval - every) < max(interval, 0.5 * every) - HELD
            fit = _best_pi(command, T - wanted, changes, one, np.cumsum(every * (T - wanted)[changes]))
            answers.append(fit and fit.pi(every))
        else:
            between = interval * (0.5 * (T[1:] + T[:-1]) - wanted[:-1])
            answers.append(_faster(command, T - wanted, between, usable, interval, sample_time))
    found, later = answers
    if found is None or (later is not None and 1.0 - later.explained < LESS * (1.0 - found.explained)):
        found = later
    is_unseen = sample_time is None and every <= interval and (found is None or 1.0 - found.explained > EXACT**2)
    for rhythm in FAST if is_unseen else (every,):
        if rhythm % interval > HELD:
            phased = _between(command, temperature, T_set, good, interval, rhythm)
            found = max([*filter(None, [found]), *phased], key=lambda one: one.explained, default=None)
    if found is None:
        return "too little of the log shows the controller at work: the command is saturated or hardly moves"
    if gains is not None:
        return found._replace(kp=math.copysign(gains[0], found.kp), ti=gains[1])
    if found.explained < LEAST_EXPLAINED:
        return (
            f"a PI of the logged error explains only {100 * max(found.explained, 0.0):.0f} % of the command's changes: "
            "the loop has another control law or an inverse, or the logged set-point is not the controller's"
        )
    if found.ti <= 0.0 or not np.isfinite(found.ti):
        return "the command moves without an error: not a PI"
    return found


def _sample_time(command: Array, changes: Index, interval: float) -> float:
    """Seconds between the controller's samples, or ``interval`` if the log is coarser."""
    # a saturated command is held for as long as it stays so and carries no information
    held = command[changes[:-1]]
    gaps = np.diff(changes)[(held > EDGE) & (held < 1.0 - EDGE)]
    if gaps.size == 0:
        return interval
    busy = min(BUSY, gaps.size)
    total = np.concatenate([[0], np.cumsum(gaps)])
    found = float(np.quantile(total[busy:] - total[:-busy], 0.1)) * interval / busy
    nice = 5.0 * round(found / 5.0)
    return nice if abs(found - nice) < 0.05 * found and nice > 0.0 else found


def _between(
    command: Array, temperature: Array, T_set: Array, good: Mask, interval: float, every: float
) -> list[RecoveredPI]:
    """For each phase of another rhythm than the log's that agrees with when the command changes; T runs straight."""
    changes = np.flatnonzero(np.abs(np.diff(command)) > HELD) + 1
    phases = []
    for phase in np.arange(0.0, every, _PHASE * interval):
        at = np.arange(phase, (command.size - 2) * interval, every) / interval
        seen = np.ceil(at - HELD).astype(int)
        phases.append((float(np.isin(changes, seen).mean()), at, seen))
    most = max(agrees for agrees, _, _ in phases)
    found = []
    for agrees, at, seen in phases:
        if agrees < most - _AGREES:
            continue
        before = np.floor(at + HELD).astype(int)
        error = np.interp(at, np.arange(command.size), temperature) - T_set[before]
        usable = good[before] & good[before + 1]
        integral = np.cumsum(every * np.where(usable, error, 0.0))
        last = np.append(np.diff(seen) > 0, False)  # of the controller's samples before one of the log
        if fit := _best_pi(command[seen], error, np.arange(at.size), usable[1:] & usable[:-1], integral, last):
            found.append(fit.pi(every)._replace(phase=float(at[0] * interval)))
    return found


def _faster(
    command: Array, error: Array, between: Array, good: Mask, interval: float, given: float | None
) -> RecoveredPI | None:
    """From a log as fine as the controller or coarser; ``between``: K s from each sample of it to the next."""
    both = good[1:] & good[:-1]

    def fit_of(sums: Array) -> _Fit | None:
        integral = np.concatenate([[0.0], np.cumsum(np.where(both, sums, 0.0))])
        return _best_pi(command, error, np.arange(command.size), both, integral)

    fit = fit_of(interval * error[1:])
    if fit is not None and 1.0 - fit.explained < EXACT**2:
        return fit.pi(interval)
    fit = fit_of(between)
    # each sample adds the new error before use: half a sample more than the straight line
    every = min(0.5 * interval, USUAL) if given is None else given
    return fit and fit._replace(kp=fit.kp - 0.5 * every * fit.ki).pi(every)


def _best_pi(
    command: Array, error: Array, at: Index, whole: Mask, integral: Array, ends: Mask | None = None
) -> _Fit | None:
    """The fit of the changes between the samples ``at``, (n,), over the lag that explains most.

    whole: where nothing is missing up to the next of them, (n - 1,).  integral: of the error up to each.  ends: those
    between which changes are compared, all if None.  A log whose samples fall between those of the controller sees one
    of these now and two then; a longer lag evens that out, and what a coarse resolution does too.
    """
    fits, broken_before = [], np.concatenate([[0], np.cumsum(~whole)])
    for lag in ROW_LAGS:
        used = broken_before[lag:] == broken_before[:-lag]
        first = np.flatnonzero(used if ends is None else used & ends[lag:] & ends[:-lag])
        fits.append(regressed_pi(command, error, at[first], at[first + lag], integral[first + lag] - integral[first]))
    return max(filter(None, fits), key=lambda fit: fit.explained, default=None)


def regressed_pi(command: Array, error: Array, before: Index, after: Index, integral: Array) -> _Fit | None:
    """The PI of changes of the command; saturated ones, and those of a saturated integral, are left out."""
    du, de = command[after] - command[before], error[after] - error[before]
    inside = np.minimum(command[before], command[after]) > EDGE
    inside &= np.maximum(command[before], command[after]) < 1.0 - EDGE
    X = np.stack([de, integral], axis=1)
    kept = inside
    for _ in range(3):
        if kept.sum() < LEAST_PI_ROWS or not np.any(du[kept]):
            return None
        kp, ki = np.linalg.lstsq(X[kept], du[kept], rcond=None)[0]
        sums = np.stack([command[i] - kp * error[i] for i in (before, after)])
        kept = inside & (sums.min(axis=0) > EDGE) & (sums.max(axis=0) < 1.0 - EDGE)
    left, total = du[kept] - X[kept] @ (kp, ki), float(du[kept] @ du[kept])
    return _Fit(float(kp), float(ki), 1.0 - float(left @ left) / total) if total > 0.0 else None


STEP = 5.0  # the loop is simulated at this many seconds or less
PLANT_LAGS = (5.0, 12.0, 25.0, 45.0, 80.0, 140.0)
DELAYS = (0.0, 10.0, 20.0)  # seconds, as the lags, tried first; then the neighbours of the best
APART, MEMORY = 15.0, 120.0
"""Seconds between the changes that are compared, and over which the autoregression remembers."""
ROUNDS = 3
PRECISION = 0.01  # of the prior of the curve's coefficients, 1/K², as in ``identify``
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
    per_sample = math.ceil(interval / STEP)
    step = interval / per_sample
    at = np.arange((command.size - 1) * per_sample + 1) / per_sample
    is_held = pi.sample_time >= interval
    fine = command[pi.acted(at, interval)] if is_held else np.interp(at, np.arange(command.size), command)
    sign = -1.0 if pi.kp > 0.0 else 1.0
    opening = openings(motor_positions(fine, step, stroke_time)[:-1], backlash)
    seen = opening[::per_sample][good]
    rows = _Changes(temperature, good, interval)
    if rows.used.sum() < LEAST_PLANT_ROWS:
        return None
    for powers in (2, 1):
        found = _searched(np.stack([opening**k for k in range(1, powers + 1)], axis=1), rows, step, per_sample)
        curve = (float(found.curve[0]), float(found.curve[1]) if powers > 1 else 0.0)
        plant = FittedPlant(
            curve, float(seen.min()), float(seen.max()), (found.slow, found.fast), found.delay, step, per_sample,
            temperature - found.filtered @ found.curve, found.explained,
        )  # fmt: skip
        if min(sign * plant.slope(opening) for opening in (plant.least, plant.most)) > 0.0:
            return plant
    return None


class _Changes:
    """Changes of series of the log over about ``APART`` s, whitened, where all that they need may be used."""

    def __init__(self, temperature: Array, good: Mask, interval: float) -> None:
        self.width = max(1, round(APART / interval))
        self.order = max(2, round(MEMORY / (self.width * interval)))
        ends = np.arange((self.order + 1) * self.width, good.size, self.width)
        self.used = all_good(good, ends - (self.order + 1) * self.width, ends)
        self.y = self.changes(temperature)
        self.memory: Array = np.zeros(self.order)

    def changes(self, series: Array) -> Array:
        """(n_changes, …): between each ``width`` samples, first axis of ``series``."""
        return np.asarray(np.diff(series[:: self.width], axis=0))

    def whitened(self, changes: Array) -> Array:
        """Less what the autoregression predicts, in the rows that are used; first axis of ``changes``."""
        left = changes[self.order :].copy()
        for lag, share in enumerate(self.memory, 1):
            left -= share * changes[self.order - lag : changes.shape[0] - lag]
        return np.asarray(left[self.used])

    def learn(self, residual: Array) -> None:
        """Fit the autoregression to the changes of a disturbance."""
        n = residual.size
        X = np.stack([residual[self.order - lag : n - lag] for lag in range(1, self.order + 1)], axis=1)
        self.memory = np.asarray(np.linalg.lstsq(X[self.used], residual[self.order :][self.used], rcond=None)[0], float)


class _Found(NamedTuple):
    """A point of the search."""

    slow: float  # lags, s
    fast: float
    delay: int  # steps
    filtered: Array  # (n, powers), what the curve weights, at the samples of the log
    rss: float = math.inf
    curve: Array = np.empty(0)
    explained: float = 0.0


def _searched(basis: Array, rows: _Changes, step: float, per_sample: int) -> _Found:
    """The best lags, delay and curve on the grid, then among the neighbours of these."""
    rows.memory = np.zeros(rows.order)
    pairs = [(slow, fast) for slow in PLANT_LAGS for fast in PLANT_LAGS if fast <= slow]
    grid = [(*lags, round(delay / step)) for lags in pairs for delay in DELAYS]
    candidates = _filtered(basis, grid, step, per_sample)
    for _ in range(ROUNDS):
        best = _best(candidates, rows)
        rows.learn(rows.y - rows.changes(best.filtered) @ best.curve)
    near = (0.75, 1.0, 1.33)
    delays = sorted({max(best.delay + more, 0) for more in (-1, 0, 1)})
    grid = [(best.slow * a, best.fast * b, delay) for a in near for b in near for delay in delays]
    return _best(_filtered(basis, grid, step, per_sample), rows)


def _filtered(basis: Array, grid: list[tuple[float, float, int]], step: float, per_sample: int) -> list[_Found]:
    """The basis behind the lags and delay of each point of a grid, at the samples of the log."""
    pairs = sorted({(slow, fast) for slow, fast, _ in grid})
    both = np.repeat(basis[:, :, np.newaxis], len(pairs), axis=2)
    for lags in zip(*pairs, strict=True):
        both = lagged(both, 1.0 - np.exp(-step / np.array(lags)))
    found = []
    for slow, fast, delay in grid:
        series = both[:, :, pairs.index((slow, fast))]
        early = np.repeat(series[:1], delay, axis=0)
        delayed = np.concatenate([early, series[: series.shape[0] - delay]])[::per_sample]
        found.append(_Found(slow, fast, delay, delayed))
    return found


def lagged(series: Array, share: Array | float) -> Array:
    """First-order lag along the first axis that goes ``share`` of the way to each new input; it starts at rest."""
    found = np.empty_like(series)
    state = series[0]
    for k, wanted in enumerate(series):
        found[k] = state = state + share * (wanted - state)
    return found


def _best(candidates: list[_Found], rows: _Changes) -> _Found:
    y = rows.whitened(rows.y)
    total = float(y @ y)
    precision = PRECISION * total / y.size
    best = candidates[0]
    for candidate in candidates:
        X = rows.whitened(rows.changes(candidate.filtered))
        curve = np.asarray(np.linalg.solve(X.T @ X + precision * np.eye(X.shape[1]), X.T @ y), float)
        left = y - X @ curve
        rss = float(left @ left + precision * curve @ curve)
        if rss < best.rss:
            best = candidate._replace(rss=rss, curve=curve, explained=1.0 - float(left @ left) / total)
    return best

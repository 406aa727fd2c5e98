"""A plant fitted to a log: valve and coil as a static curve behind two lags and a delay, and what else moved the air.

The temperature is c₁ o + c₂ o² of the opening o, delayed and filtered, plus a disturbance: all that the opening does
not explain, measurement noise included.  The curve is linear in its coefficients, so that lags and delay are searched
on a grid (separable least squares).  The disturbance drifts, and the controller answers it: its changes are whitened
by an autoregression fitted along with the plant, without which a loop that works well would hide its own plant.

The ARIX of ``likelihood`` foretells the next half minute better.  It is not taken here, since a controller that
samples every few seconds cannot be run on half minutes, and nothing makes the loop that it closes a stable one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.diagnosis.motion import motor_positions, openings

STEP = 5.0
"""The loop is simulated at this many seconds or less."""
LAGS = (5.0, 12.0, 25.0, 45.0, 80.0, 140.0)
DELAYS = (0.0, 10.0, 20.0)
"""Seconds, tried first; then the neighbours of the best."""
APART, MEMORY = 15.0, 120.0
"""Seconds between the changes that are compared, and over which the autoregression remembers."""
ROUNDS = 3
PRECISION = 0.01
"""Of the prior of the curve's coefficients, 1/K², as in ``likelihood``."""
LEAST_ROWS = 60


class FittedPlant(NamedTuple):
    """A plant and its day.

    curve: c₁, c₂, K per stroke; beyond the openings from ``least`` to ``most`` it goes on straight.
    lags: s.  delay: whole steps.  step: s of the simulation, a whole number of them to a sample of the log.
    disturbance: (n,), K, at the samples of the log.
    explained: share of the whitened changes of the temperature that the opening explains.
    """

    curve: tuple[float, float]
    least: float
    most: float
    lags: tuple[float, float]
    delay: int
    step: float
    per_sample: int
    disturbance: Array
    explained: float

    def slope(self, opening: float) -> float:
        """K per stroke at an opening, once all has settled."""
        return self.curve[0] + 2.0 * self.curve[1] * min(max(opening, self.least), self.most)

    @property
    def gain(self) -> float:
        """K per stroke in the middle of the openings of the log."""
        return self.slope(0.5 * (self.least + self.most))


def fit_plant(
    command: Array,
    temperature: Array,
    good: Mask,
    interval: float,
    backlash: float,
    stroke_time: float,
    is_held: bool,
    sign: float,
) -> FittedPlant | None:
    """Fit the plant between command and temperature; None if no plant with gains of the ``sign`` explains the log.

    Parameters
    ----------
    command, temperature
        (n,), without NaN: fraction of stroke, °C.
    good
        (n,): samples that may be used.
    is_held
        Whether the command is held between samples of the log; else it runs straight.
    sign
        -1 where a higher opening lowers the temperature, else 1.
    """
    per_sample = math.ceil(interval / STEP)
    step = interval / per_sample
    at = np.arange((command.size - 1) * per_sample + 1) / per_sample
    fine = command[at.astype(int)] if is_held else np.interp(at, np.arange(command.size), command)
    position = motor_positions(fine, step / stroke_time if stroke_time > 0.0 else 1.0)[:-1]
    opening = openings(position, np.array([backlash]))[:, 0]
    seen = opening[::per_sample][good]
    rows = _Rows(temperature, good, interval)
    if rows.used.sum() < LEAST_ROWS:
        return None
    for powers in (2, 1):
        found = _searched(np.stack([opening**k for k in range(1, powers + 1)], axis=1), rows, step, per_sample)
        curve = (float(found.curve[0]), float(found.curve[1]) if powers > 1 else 0.0)
        plant = FittedPlant(
            curve, float(seen.min()), float(seen.max()), found.lags, found.delay, step, per_sample,
            temperature - found.filtered @ found.curve, found.explained,
        )  # fmt: skip
        if min(sign * plant.slope(opening) for opening in (plant.least, plant.most)) > 0.0:
            return plant
    return None


class _Rows:
    """Changes of series of the log over about ``APART`` s, whitened, where all that they need may be used."""

    def __init__(self, temperature: Array, good: Mask, interval: float) -> None:
        self.width = max(1, round(APART / interval))
        self.order = max(2, round(MEMORY / (self.width * interval)))
        bad = np.concatenate([[0], np.cumsum(~good)])
        ends = np.arange((self.order + 1) * self.width, good.size, self.width)
        self.used = bad[ends + 1] == bad[ends - (self.order + 1) * self.width]
        self.y = self.changes(temperature)
        self.memory = np.zeros(self.order)

    def changes(self, series: Array) -> Array:
        """(n_changes, …): between each ``width`` samples, first axis of ``series``."""
        return np.asarray(np.diff(series[:: self.width], axis=0))

    def whitened(self, changes: Array) -> Array:
        """Less what the autoregression foretells, in the rows that are used; first axis of ``changes``."""
        left = changes[self.order :].copy()
        for lag, share in enumerate(self.memory, 1):
            left -= share * changes[self.order - lag : changes.shape[0] - lag]
        return np.asarray(left[self.used])

    def learn(self, residual: Array) -> None:
        """Fit the autoregression to the changes of a disturbance."""
        n = residual.size
        X = np.stack([residual[self.order - lag : n - lag] for lag in range(1, self.order + 1)], axis=1)
        self.memory = np.linalg.lstsq(X[self.used], residual[self.order :][self.used], rcond=None)[0]


class _Found(NamedTuple):
    """The best of a search; filtered: (n, powers), what the curve weights, at the samples of the log."""

    rss: float
    lags: tuple[float, float]
    delay: int
    curve: Array
    filtered: Array
    explained: float


def _searched(basis: Array, rows: _Rows, step: float, per_sample: int) -> _Found:
    """The best lags, delay and curve on the grid, then among the neighbours of these."""
    rows.memory = np.zeros(rows.order)
    grid = [(slow, fast, round(delay / step)) for slow in LAGS for fast in LAGS if fast <= slow for delay in DELAYS]
    candidates = _filtered(basis, grid, step, per_sample)
    for _ in range(ROUNDS):
        best = _best(candidates, rows)
        rows.learn(rows.y - rows.changes(best.filtered) @ best.curve)
    near = (0.75, 1.0, 1.33)
    slow, fast = best.lags
    delays = {max(best.delay + more, 0) for more in (-1, 0, 1)}
    grid = [(slow * a, fast * b, delay) for a in near for b in near for delay in sorted(delays)]
    return _best(_filtered(basis, grid, step, per_sample), rows)


def _filtered(
    basis: Array, grid: list[tuple[float, float, int]], step: float, per_sample: int
) -> list[tuple[tuple[float, float, int], Array]]:
    """The basis behind the lags and delay of each point of a grid, at the samples of the log."""
    slows = sorted({slow for slow, _, _ in grid})
    pairs = sorted({(slow, fast) for slow, fast, _ in grid})
    once = lagged(np.repeat(basis[:, :, np.newaxis], len(slows), axis=2), _shares(slows, step))
    both = lagged(once[:, :, [slows.index(slow) for slow, _ in pairs]], _shares([fast for _, fast in pairs], step))
    twice = {pair: both[:, :, k] for k, pair in enumerate(pairs)}
    found = []
    for slow, fast, delay in grid:
        series = twice[slow, fast]
        early = np.repeat(series[:1], delay, axis=0)
        found.append(((slow, fast, delay), np.concatenate([early, series[: series.shape[0] - delay]])[::per_sample]))
    return found


def _shares(lags: list[float], step: float) -> Array:
    """Of the way to its input that a lag goes in a step."""
    return np.asarray(1.0 - np.exp(-step / np.array(lags)))


def lagged(series: Array, share: Array | float) -> Array:
    """First-order lag along the first axis that goes ``share`` of the way to each new input; it starts at rest."""
    found = np.empty_like(series)
    state = series[0]
    for k, wanted in enumerate(series):
        found[k] = state = state + share * (wanted - state)
    return found


def _best(candidates: list[tuple[tuple[float, float, int], Array]], rows: _Rows) -> _Found:
    y = rows.whitened(rows.y)
    total = float(y @ y)
    precision = PRECISION * total / y.size
    best: _Found | None = None
    for (slow, fast, delay), filtered in candidates:
        X = rows.whitened(rows.changes(filtered))
        curve = np.asarray(np.linalg.solve(X.T @ X + precision * np.eye(X.shape[1]), X.T @ y), float)
        left = y - X @ curve
        rss = float(left @ left + precision * curve @ curve)
        if best is None or rss < best.rss:
            best = _Found(rss, (slow, fast), delay, curve, filtered, 1.0 - float(left @ left) / total)
    assert best is not None
    return best

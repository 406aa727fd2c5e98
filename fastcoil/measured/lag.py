"""The time shift between the command and the flow of a log: estimated per piece, reported, removed.

Each candidate shift and backlash turns the command into an opening; a piecewise linear curve from opening to flow, one
for the whole log, which needs no shape of Eq (2), is solved for.  Shift and backlash are estimated together, so that
neither is mistaken for the other.  The shift of each piece is the one that fits best, less a price for every piece that
differs from the others, so that noise moves no log.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs import Log
from fastcoil.logs.series import counted
from fastcoil.measured.least_squares import autocorrelation
from fastcoil.measured.part import unbroken
from fastcoil.measured.valve_problem import step_of
from fastcoil.model.engine.recorded import valve_flows

N_KNOTS = 11
_RIDGE, _TINY, _ROUND_OFF, _MOST_MEMORY = 1e-9, 1e-300, 1e-6, 0.98
BACKLASHES = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.125, 0.15, 0.18, 0.22, 0.27, 0.33, 0.4])
_WORTHWHILE = 0.8  # a shift leaves at most this share of the squared residuals of the rows that it moves
_ROUNDS = 10
_NEAR, _AROUND = 6, 2
"""Shifts tried: up to so many samples either way, and around the one that the cross-correlation proposes."""
_FARTHEST = 7200.0  # s, proposed by the cross-correlation: clocks that differ by an hour
_PRICE = 12.0  # of a shift, and of a piece with another one, in logarithms of likelihood


def hats(opening: Array) -> Array:
    """Weights of the knots, evenly spaced from 0 to 1, at each opening: (…,) → (…, knots)."""
    place = np.clip(opening, 0.0, 1.0) * (N_KNOTS - 1)
    return np.asarray(np.maximum(1.0 - np.abs(place[..., None] - np.arange(N_KNOTS)), 0.0))


def openings_of(command: Array, batch: Index, backlashes: Array) -> Array:
    """Opening behind each backlash, (n, backlashes); each piece starts in the middle of the gap."""
    rows, start = np.ones((5, backlashes.size)), np.full((int(batch[-1]) + 1, backlashes.size), 0.5)
    rows[0] = backlashes
    openings, flows = np.empty((2, command.size, backlashes.size))
    valve_flows(np.ascontiguousarray(command), batch, rows, start, openings, flows)
    return openings


def _solved(products: Array) -> Array:
    """Flows at the knots, (…, k - 1), from sums of products of the weights and, last, the flow, (…, k, k)."""
    A, b = products[..., :-1, :-1], products[..., :-1, -1:]
    ridge = _RIDGE * np.trace(A, axis1=-2, axis2=-1) + _TINY
    return np.asarray(np.linalg.solve(A + ridge[..., None, None] * np.eye(A.shape[-1]), b)[..., 0])


def _errors_of(products: Array, flows: Array) -> Array:
    """Sums of squared residuals, (…,), of a curve, (…, k - 1) or (k - 1,)."""
    v = np.concatenate([flows, np.full((*flows.shape[:-1], 1), -1.0)], axis=-1)
    return np.asarray(np.maximum(np.einsum("...ij,...i,...j", products, v, v), 0.0))


class _Curve(NamedTuple):
    backlash: int  # index in BACKLASHES
    flows: Array  # at the knots, kg/s
    variance: float  # of a residual, (kg/s)²


class _Sums(NamedTuple):
    """What the search needs of some pieces of a log."""

    lags: Array  # that are tried, samples, (lags,)
    products: Array  # of the curve's terms and the flow, (pieces, lags, backlashes, knots + 1, knots + 1)
    counts: Array  # samples in each, (pieces, lags)

    def curve(self, chosen: Index) -> _Curve:
        """The best curve with each piece at its lag, an index in ``lags``."""
        at = np.arange(chosen.size), chosen
        total, n = self.products[at].sum(axis=0), max(float(self.counts[at].sum()), 1.0)
        flows = _solved(total)
        errors = _errors_of(total, flows)
        j = int(np.argmin(errors))
        return _Curve(j, flows[j], max(float(errors[j]) / n, _ROUND_OFF**2 * float(total[j, -1, -1]) / n, _TINY))

    def cheapest(self, curve: _Curve, worth: float) -> Index:
        """The lag of each piece with the least errors and prices, an index in ``lags``; worth: samples, of one.

        Samples that a lag leaves without a command cost as much as others; they may not be most of a piece.  Where all
        of a piece fits worse than the rest, chance moves it more easily: its own variance counts.
        """
        most = self.counts.max(axis=1, keepdims=True)
        errors = _errors_of(self.products[:, :, curve.backlash], curve.flows)
        errors = np.where(self.counts < 0.5 * most, np.inf, errors + curve.variance * (most - self.counts))
        own = errors.min(axis=1, keepdims=True) / np.maximum(most, 1.0)
        costs = errors / (2.0 * worth * np.maximum(own, curve.variance))
        # of each lag that most pieces may have, (common, pieces, lags)
        whole = costs + _PRICE * (self.lags != self.lags[:, None])[:, None]
        common = int(np.argmin(whole.min(axis=2).sum(axis=1) + _PRICE * (self.lags != 0)))
        return np.asarray(whole[common].argmin(axis=1))

    def search(self, worth: float) -> tuple[Index, _Curve]:
        """The lag of each piece and the curve: from each common lag until neither changes."""
        ways, n = [], self.counts.sum(axis=0)
        for common in np.flatnonzero(n >= 0.5 * n.max()):
            chosen = np.full(self.counts.shape[0], common)
            for _ in range(_ROUNDS):
                before = chosen
                chosen = self.cheapest(self.curve(before), worth)
                if (chosen == before).all():
                    break
            curve = self.curve(chosen)
            changes = np.count_nonzero(np.diff(self.lags[chosen], prepend=0))
            cost = 0.5 * self.counts.max(axis=1).sum() / worth * np.log(curve.variance)
            ways.append((_PRICE * changes + cost, chosen, curve))
        return min(ways, key=lambda one: float(one[0]))[1:]

    def worthwhile(self, chosen: Index, curve: _Curve) -> Array:
        """The lag of each piece in samples, 0 where a run of pieces with one lag gains little by it."""
        errors = _errors_of(self.products[:, :, curve.backlash], curve.flows)
        kept, none = self.lags[chosen], int(np.flatnonzero(self.lags == 0)[0])
        for run in unbroken(chosen):
            if errors[run, chosen[run]].sum() > _WORTHWHILE * errors[run, none].sum():
                kept[run] = 0
        return kept


def delayed(log: Log, lag: Array | float) -> tuple[Array, Mask]:
    """The command ``lag`` seconds before each sample, (n,) each, and where no row of its piece gives it."""
    given, lag = log.values["command"], np.broadcast_to(lag, log.time.shape)
    command, outside = given.copy(), np.zeros(given.size, dtype=bool)
    for piece in unbroken(log.batch):
        time = log.time[piece]
        wanted = time - lag[piece] + _ROUND_OFF
        at = np.searchsorted(time, wanted, side="right") - 1
        command[piece] = given[piece[np.maximum(at, 0)]]
        outside[piece] = (at < 0) | (wanted > time[-1] + 2.0 * _ROUND_OFF)
    return command, outside


def with_lag(log: Log, lag: float, fitting: Mask) -> Log:
    """The log with the command that was given ``lag`` seconds before each flow."""
    note = f"the flow is compared with the command {abs(lag):g} s {'before' if lag > 0.0 else 'after'} it, as given"
    return log if lag == 0.0 else _moved(log, np.full(log.time.size, lag), fitting, [note])


def without_lag(log: Log, good: Mask, fitting: Mask) -> Log:
    """The log with the shift of each piece taken out, and a note of it; itself if it has none.

    good, fitting: (n,), samples that may be compared, and those of the part to fit.  Shifts are found in that part
    alone; what follows it is moved like its last piece.
    """
    part, used, step = log.where(fitting), good[fitting], step_of(log, fitting)
    tried, memory, worth = _lags_to_try(part, used, step).astype(float), 0.0, 1.0
    for is_white in (False, True):  # first how the residuals are correlated, then with that taken out
        sums = _sums(part, used, step, unbroken(part.batch), tried, memory)
        chosen, curve = sums.search(worth)
        rho = _correlation(part, used, tried[chosen][part.batch] * step, curve, memory)
        if is_white:
            worth = max(1.0 + 2.0 * float(rho.sum()), 1.0)
        elif rho.size:
            memory = min(float(rho[0]), _MOST_MEMORY)
    shifts = sums.worthwhile(*sums.search(worth))[part.batch]
    shifts = np.pad(shifts, (0, log.time.size - shifts.size), mode="edge")
    return _moved(log, shifts * step, fitting, _in_words(log, shifts, step)) if shifts.any() else log


def _moved(log: Log, lag: Array, fitting: Mask, notes: list[str]) -> Log:
    command, outside = delayed(log, lag)
    # commands of the part held back have no influence on the fit
    command[fitting], outside[fitting] = delayed(log.where(fitting), lag[fitting])
    values = log.values | {"command": command, "m_w": np.where(outside, np.nan, log.values["m_w"])}
    return replace(log, values=values, notes=log.notes + notes)


def _in_words(log: Log, shifts: Array, step: float) -> list[str]:
    """A sentence for each shift."""
    notes = []
    for run in unbroken(shifts):
        n, first, last = int(shifts[run[0]]), int(run[0]), int(run[-1])
        piece = f" (piece {log.batch[first] + 1} of {log.n_batches})" if log.n_batches > 1 else ""
        where = f"from row {log.rows[first]}{piece} to row {log.rows[last]}" if run.size < shifts.size else "throughout"
        when = f"{counted(abs(n), 'sample')} ({abs(n) * step:.4g} s) {'after' if n > 0 else 'before'} the command"
        if n != 0:
            notes.append(
                f"{where} the flow is logged {when}: the fit takes this shift out; lag=0, --lag 0 leaves it in"
            )
    return notes


def _sums(log: Log, good: Mask, step: float, pieces: list[Index], lags: Array, memory: float) -> _Sums:
    """Sums of products of the curve's terms and the flow in each piece, behind each lag and backlash.

    memory: of the residuals, from one sample to the next; that share of the sample before is subtracted from each.
    """
    starts = [int(piece[0]) for piece in pieces]
    products = np.zeros((len(pieces), lags.size, BACKLASHES.size, N_KNOTS + 1, N_KNOTS + 1))
    counts = np.zeros((len(pieces), lags.size))
    for i, lag in enumerate(lags):
        command, outside = delayed(log, lag * step)
        openings = openings_of(command, log.batch, BACKLASHES)
        used = good & ~outside
        if memory:
            used[1:] &= used[:-1].copy()
            used[starts] = False
        counts[:, i] = np.add.reduceat(used, starts, dtype=float)
        for j in range(BACKLASHES.size):
            A = np.column_stack([hats(openings[:, j]), log.values["m_w"]])
            if memory:
                A[1:] -= memory * A[:-1]
            A = np.where(used[:, None], A, 0.0)
            for k, piece in enumerate(pieces):
                products[k, i, j] = A[piece].T @ A[piece]
    return _Sums(lags, products, counts)


def _lags_to_try(log: Log, used: Mask, step: float) -> Index:
    """Shifts in samples: a few either way, and some around the peak of the cross-correlation of the changes."""
    from scipy.signal import correlate

    lags = np.arange(-_NEAR, _NEAR + 1)
    most = min(int(_FARTHEST / step), log.time.size // 4)
    both = used[1:] & used[:-1] & (np.diff(log.batch) == 0)
    if most <= _NEAR or not both.any():
        return lags
    moves, answers = (np.where(both, np.diff(log.values[name]), 0.0) for name in ("command", "m_w"))
    product = correlate(answers, moves)  # at lags from 1 - n
    far = np.concatenate([np.arange(-most, -_NEAR), np.arange(_NEAR + 1, most + 1)])
    peak = int(far[np.argmax(product[far + moves.size - 1])])
    return np.union1d(lags, np.arange(peak - _AROUND, peak + _AROUND + 1))


def _correlation(log: Log, used: Mask, lag: Array, curve: _Curve, memory: float) -> Array:
    """Autocorrelation of the residuals of the fitted part, each less ``memory`` times the one before; lag: (n,), s."""
    command, outside = delayed(log, lag)
    opening = openings_of(command, log.batch, BACKLASHES[[curve.backlash]])[:, 0]
    used = used & ~outside
    r = np.where(used, hats(opening) @ curve.flows - log.values["m_w"], 0.0)
    r[1:] -= memory * r[:-1]
    n = int(np.flatnonzero(used)[-1]) + 1
    return autocorrelation(r[:n], log.batch[:n], used[:n])

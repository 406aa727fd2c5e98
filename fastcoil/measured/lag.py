"""The time shift between the command and the flow of a log: estimated per stretch, reported, removed.

Each candidate shift and backlash turns the command into an opening; a piecewise linear curve from opening to flow, one
for the whole log, which needs no shape of Eq (2), is solved for.  Shift and backlash are estimated together, so that
neither is mistaken for the other.  The shift of each stretch is the one that fits best, less a price for every shift
and every change of it (Viterbi's search), so that noise moves no log.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs import Log
from fastcoil.measured.least_squares import autocorrelation
from fastcoil.measured.part import unbroken
from fastcoil.measured.valve_problem import step_of
from fastcoil.model.engine.recorded import valve_flows

N_KNOTS = 11
_RIDGE, _TINY, _ROUND_OFF = 1e-9, 1e-300, 1e-6
BACKLASHES = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.125, 0.15, 0.18, 0.22, 0.27, 0.33, 0.4])
_WORTHWHILE = 0.8  # a shift leaves at most this share of the squared residuals of the rows that it moves
_ROUNDS = 10
_NEAR, _AROUND = 6, 2
"""Shifts tried: up to so many samples either way, and around the one that the cross-correlation proposes."""
_FARTHEST = 7200.0  # s, proposed by the cross-correlation: clocks that differ by an hour
_STRETCH = 100  # samples: a longer piece is cut into stretches of one to two times this
_PRICE, _PRICE_WITHIN = 12.0, 30.0
"""Of a shift and of a change of it between pieces, and of a change within one, in logarithms of likelihood."""
_MOST_MEMORY = 0.98


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
    likelihood: float  # logarithm of it


class _Stretches(NamedTuple):
    """What the search needs of a log."""

    lags: Index  # that are tried, samples, (lags,)
    number: Index  # of the stretch of each sample, (n,)
    sums: Array  # of products of the curve's terms and the flow, (stretches, lags, backlashes, knots + 1, knots + 1)
    counts: Array  # samples in each sum, (stretches, lags)
    price: Array  # of each change of the lag from one stretch to the next; the first: of any lag but 0
    fitted: Mask  # (stretches,)

    def of(self, which: Mask) -> _Stretches:
        return self._replace(sums=self.sums[which], counts=self.counts[which], price=self.price[which])


def _search(found: _Stretches, worth: float) -> tuple[Index, _Curve]:
    """The lag of each stretch, an index in ``lags``, and the curve: from each common lag until neither changes."""
    ways = []
    n = found.counts.sum(axis=0)
    for common in np.flatnonzero(n >= 0.5 * n.max()):
        chosen = np.full(found.sums.shape[0], common)
        for _ in range(_ROUNDS):
            before = chosen
            chosen = _cheapest(found, _curve(found, before, worth), worth)
            if (chosen == before).all():
                break
        curve = _curve(found, chosen, worth)
        changed = np.append(found.lags[chosen[0]] != 0, np.diff(chosen) != 0)
        ways.append((found.price[changed].sum() - curve.likelihood, chosen, curve))
    return min(ways, key=lambda one: float(one[0]))[1:]


def _curve(found: _Stretches, chosen: Index, worth: float) -> _Curve:
    """The best curve with each stretch at its lag."""
    at = np.arange(chosen.size), chosen
    total, n = found.sums[at].sum(axis=0), max(float(found.counts[at].sum()), 1.0)
    flows = _solved(total)
    errors = _errors_of(total, flows)
    j = int(np.argmin(errors))
    mean = max(float(errors[j]) / n, _ROUND_OFF**2 * float(total[j, -1, -1]) / n, _TINY)
    n_all = float(found.counts.max(axis=1).sum())
    return _Curve(j, flows[j], mean, -0.5 * n_all / worth * float(np.log(mean)))


def _cheapest(found: _Stretches, curve: _Curve, worth: float) -> Index:
    """The lag of each stretch, an index in ``lags``: the way through the stretches with the least errors and prices.

    Samples that a lag leaves without a command cost as much as others; they may not be most of a stretch.  Where all
    of a stretch fits worse than the rest, chance moves it more easily: its own variance counts.
    """
    most = found.counts.max(axis=1, keepdims=True)
    errors = _errors_of(found.sums[:, :, curve.backlash], curve.flows)
    errors = np.where(found.counts < 0.5 * most, np.inf, errors + curve.variance * (most - found.counts))
    own = errors.min(axis=1, keepdims=True) / np.maximum(most, 1.0)
    costs = errors / (2.0 * worth * np.maximum(own, curve.variance))
    lags, ways = found.lags, []
    best = costs[0] + found.price[0] * (lags != 0)
    for cost, of_change in zip(costs[1:], found.price[1:], strict=True):
        whole = best[:, None] + of_change * (lags[:, None] != lags)
        ways.append(whole.argmin(axis=0))
        best = whole.min(axis=0) + cost
    chosen = [int(best.argmin())]
    for way in reversed(ways):
        chosen.append(int(way[chosen[-1]]))
    return np.array(chosen[::-1])


def _worthwhile(found: _Stretches, chosen: Index, curve: _Curve) -> Index:
    """The lag of each stretch in samples, 0 where a run of stretches with one lag gains little by it."""
    errors = _errors_of(found.sums[:, :, curve.backlash], curve.flows)
    kept, none = found.lags[chosen], int(np.flatnonzero(found.lags == 0)[0])
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


def with_lag(log: Log, lag: float) -> Log:
    """The log with the command that was given ``lag`` seconds before each flow."""
    note = f"the flow is compared with the command {abs(lag):g} s {'before' if lag > 0.0 else 'after'} it, as given"
    return log if lag == 0.0 else _moved(log, np.full(log.time.size, lag), [note])


def without_lag(log: Log, good: Mask, fitting: Mask) -> Log:
    """The log with the shift of each stretch taken out, and a note of it; itself if it has none.

    good, fitting: (n,), samples that may be compared, and those of the part to fit; what follows that part has no
    influence on its shifts.
    """
    step = step_of(log, fitting)
    lags_tried = _lags_to_try(log, good & fitting, step)
    memory, worth = 0.0, 1.0
    for of_white in (False, True):  # first how the residuals are correlated, then with that taken out
        found = _stretches(log, good, fitting, step, lags_tried, memory)
        chosen, curve = _search(found.of(found.fitted), worth)
        rho = _correlation(log, good & fitting, found, chosen, curve, step, memory)
        if of_white:
            worth = max(1.0 + 2.0 * float(rho.sum()), 1.0)
        elif rho.size:
            memory = min(float(rho[0]), _MOST_MEMORY)
    chosen, curve = _search(found.of(found.fitted), worth)
    lags = np.zeros(found.fitted.size)
    lags[found.fitted] = _worthwhile(found.of(found.fitted), chosen, curve)
    if not found.fitted.all():
        rest = found.of(~found.fitted)
        lags[~found.fitted] = _worthwhile(rest, _cheapest(rest, curve, worth), curve)
    shifts = lags[found.number]
    return _moved(log, shifts * step, _in_words(log, shifts, step)) if shifts.any() else log


def _moved(log: Log, lag: Array, notes: list[str]) -> Log:
    command, outside = delayed(log, lag)
    values = log.values | {"command": command, "m_w": np.where(outside, np.nan, log.values["m_w"])}
    return replace(log, values=values, notes=log.notes + notes)


def _in_words(log: Log, shifts: Array, step: float) -> list[str]:
    """A sentence for each shift."""
    notes = []
    for run in unbroken(shifts):
        n, first, last = int(shifts[run[0]]), int(run[0]), int(run[-1])
        piece = f" (piece {log.batch[first] + 1} of {log.n_batches})" if log.n_batches > 1 else ""
        until = " on" if last == shifts.size - 1 else f" to row {log.rows[last]}"
        where = f"from row {log.rows[first]}{piece}{until}" if run.size < shifts.size else "throughout"
        late, early = ("flow", "command") if n > 0 else ("command", "flow")
        samples = "one sample" if abs(n) == 1 else f"{abs(n)} samples"
        if n != 0:
            notes.append(
                f"{where} the {late} is logged {samples} ({abs(n) * step:g} s) after the {early}: the fit takes this "
                "shift out; lag=0, --lag 0 leaves it in"
            )
    return notes


def _stretches(log: Log, good: Mask, fitting: Mask, step: float, lags: Index, memory: float) -> _Stretches:
    """Pieces, long ones cut and none partly fitted, and their sums.

    memory: of the residuals, from one sample to the next; that share of the sample before is subtracted from each.
    """
    n = log.time.size
    number, price, follows = np.zeros(n, dtype=np.int64), [_PRICE], np.ones(n, dtype=bool)
    for piece in unbroken(log.batch, fitting):
        cuts = max(piece.size // _STRETCH, 1)
        number[piece] = len(price) - 1 + np.arange(piece.size) * cuts // piece.size
        price += [_PRICE_WITHIN] * (cuts - 1) + [_PRICE]
        follows[piece[0]] = False
    ends = np.searchsorted(number, np.arange(len(price)))
    sums = np.zeros((len(price) - 1, lags.size, BACKLASHES.size, N_KNOTS + 1, N_KNOTS + 1))
    counts = np.zeros((len(price) - 1, lags.size))
    for i, lag in enumerate(lags):
        command, outside = delayed(log, lag * step)
        openings = openings_of(command, log.batch, BACKLASHES)
        used = good & ~outside
        if memory:
            used &= follows & np.append(False, used[:-1])
        counts[:, i] = np.add.reduceat(used, ends[:-1])
        for j in range(BACKLASHES.size):
            A = np.column_stack([hats(openings[:, j]), log.values["m_w"]])
            if memory:
                A[1:] -= memory * A[:-1]
            A = np.where(used[:, None], A, 0.0)
            for s in range(len(price) - 1):
                part = A[ends[s] : ends[s + 1]]
                sums[s, i, j] = part.T @ part
    return _Stretches(lags, number, sums, counts, np.array(price[:-1]), fitting[ends[:-1]])


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


def _correlation(
    log: Log, used: Mask, found: _Stretches, chosen: Index, curve: _Curve, step: float, memory: float
) -> Array:
    """Autocorrelation of the residuals of the fitted part, each less ``memory`` times the one before."""
    lags = np.zeros(found.fitted.size)
    lags[found.fitted] = found.lags[chosen]
    command, outside = delayed(log, lags[found.number] * step)
    opening = openings_of(command, log.batch, BACKLASHES[[curve.backlash]])[:, 0]
    used = used & ~outside
    r = np.where(used, hats(opening) @ curve.flows - log.values["m_w"], 0.0)
    r[1:] -= memory * r[:-1]
    n = int(np.flatnonzero(used)[-1]) + 1
    return autocorrelation(r[:n], log.batch[:n], used[:n])

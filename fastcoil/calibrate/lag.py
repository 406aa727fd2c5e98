"""The time shift between the command and the flow of a log: sought stretch by stretch, told, and taken out.

Each candidate shift and backlash turns the command into an opening; a curve of straight lines from opening to flow,
one for the whole log, is solved for linearly.  Shift and backlash are sought at once, so that neither passes for the
other.  The shift of each stretch is the one that fits best, less a price for every shift and every change of it
(Viterbi's search), so that chance moves no log.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fastcoil.arrays import Array, Index, Mask
from fastcoil.calibrate.least_squares import autocorrelation
from fastcoil.calibrate.play_curve import N_KNOTS, hats
from fastcoil.calibrate.valve_record import step_of
from fastcoil.engine.valve_loop import valve_flows
from fastcoil.logs import Log

_NEAR, _AROUND = 6, 2
"""Shifts tried: up to so many samples either way, and around the one that the cross-correlation proposes."""
_FARTHEST = 7200.0
"""The cross-correlation proposes shifts up to this, s: clocks that differ by an hour."""
_BACKLASHES = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.125, 0.15, 0.18, 0.22, 0.27, 0.33, 0.4])
_STRETCH = 100
"""Samples: a longer piece is cut into stretches of one to two times this."""
_PRICE, _PRICE_WITHIN = 12.0, 30.0
"""Of a shift and of a change of it between pieces, and of a change within one, in logarithms of likelihood."""
_ROUNDS = 10
_RIDGE = 1e-9
_ROUND_OFF = 1e-6
_TINY = 1e-300


class Curve(NamedTuple):
    """The backlash, an index in ``_BACKLASHES``; flows at the knots, kg/s; variance of a residual as if it were white.

    likelihood: logarithm of it.
    """

    backlash: int
    flows: Array
    variance: float
    likelihood: float


class Stretches(NamedTuple):
    """What the search needs of a log.

    lags: that are tried, in samples, (lags,).  number: of the stretch of each sample, (n,).  sums: of products of the
    curve's terms and the flow, (stretches, lags, backlashes, knots + 1, knots + 1).  price: of each change of the lag
    from one stretch to the next, (stretches,), the first is that of any lag but 0.  fitted: (stretches,).
    """

    lags: Index
    number: Index
    sums: Array
    price: Array
    fitted: Mask


def delayed(log: Log, lag: Array | float) -> tuple[Array, Mask]:
    """The command ``lag`` seconds before each sample, (n,) each, and where no row of its piece gives it."""
    given, lag = log.values["command"], np.broadcast_to(lag, log.time.shape)
    command, outside = given.copy(), np.zeros(given.size, dtype=bool)
    for piece in np.split(np.arange(given.size), np.flatnonzero(np.diff(log.batch)) + 1):
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
    found = _stretches(log, good, fitting, step)
    of_fit = found.sums[found.fitted]
    chosen, curve = _search(of_fit, found.lags, found.price[found.fitted], 1.0)
    worth = _worth(log, good & fitting, found, chosen, curve, step)
    chosen, curve = _search(of_fit, found.lags, found.price[found.fitted], worth)
    lags = np.zeros(found.fitted.size)
    lags[found.fitted] = found.lags[chosen]
    if not found.fitted.all():
        rest = ~found.fitted
        lags[rest] = found.lags[_cheapest(found.sums[rest], found.lags, found.price[rest], curve)]
    shifts = lags[found.number]
    return _moved(log, shifts * step, _told(log, shifts, step)) if shifts.any() else log


def _moved(log: Log, lag: Array, notes: list[str]) -> Log:
    command, outside = delayed(log, lag)
    values = log.values | {"command": command, "m_w": np.where(outside, np.nan, log.values["m_w"])}
    return replace(log, values=values, notes=log.notes + notes)


def _told(log: Log, shifts: Array, step: float) -> list[str]:
    """A sentence for each shift."""
    ends = np.flatnonzero(np.diff(shifts)) + 1
    notes = []
    for run in np.split(np.arange(shifts.size), ends):
        n = int(shifts[run[0]])
        if n == 0:
            continue
        samples = "one sample" if abs(n) == 1 else f"{abs(n)} samples"
        first, last = int(run[0]), int(run[-1])
        where = "throughout" if run.size == shifts.size else f"from row {log.rows[first]}"
        if run.size < shifts.size and log.n_batches > 1:
            where += f" (piece {log.batch[first] + 1} of {log.n_batches})"
        if run.size < shifts.size:
            where += " on" if last == shifts.size - 1 else f" to row {log.rows[last]}"
        what = ("flow", "command") if n > 0 else ("command", "flow")
        notes.append(
            f"{where} the {what[0]} is logged {samples} ({abs(n) * step:g} s) after the {what[1]}: the fit takes this "
            "shift out; lag=0, --lag 0 leaves it in"
        )
    return notes


def _stretches(log: Log, good: Mask, fitting: Mask, step: float) -> Stretches:
    """Pieces, long ones cut and none partly fitted, and their sums."""
    n = log.time.size
    border = (np.diff(log.batch) != 0) | (np.diff(fitting.astype(int)) != 0)
    number, price = np.zeros(n, dtype=np.int64), [_PRICE]
    for part in np.split(np.arange(n), np.flatnonzero(border) + 1):
        cuts = max(part.size // _STRETCH, 1)
        number[part] = len(price) - 1 + np.arange(part.size) * cuts // part.size
        price += [_PRICE_WITHIN] * (cuts - 1) + [_PRICE]
    ends = np.searchsorted(number, np.arange(len(price)))
    lags = _lags_to_try(log, good & fitting, step)
    rows, start = np.ones((5, _BACKLASHES.size)), np.full((log.n_batches, _BACKLASHES.size), 0.5)
    rows[0] = _BACKLASHES
    openings, flows = np.empty((n, _BACKLASHES.size)), np.empty((n, _BACKLASHES.size))
    sums = np.zeros((len(price) - 1, lags.size, _BACKLASHES.size, N_KNOTS + 1, N_KNOTS + 1))
    for i, lag in enumerate(lags):
        command, outside = delayed(log, lag * step)
        valve_flows(command, log.batch, rows, start, openings, flows)
        used = (good & ~outside)[:, None]
        for j in range(_BACKLASHES.size):
            A = np.where(used, np.column_stack([hats(openings[:, j]), log.values["m_w"]]), 0.0)
            for s in range(len(price) - 1):
                part = A[ends[s] : ends[s + 1]]
                sums[s, i, j] = part.T @ part
    return Stretches(lags, number, sums, np.array(price[:-1]), fitting[ends[:-1]])


def _lags_to_try(log: Log, used: Mask, step: float) -> Index:
    """Shifts in samples: a few either way, and some around the peak of the cross-correlation of the changes."""
    lags = np.arange(-_NEAR, _NEAR + 1)
    most = min(int(_FARTHEST / step), log.time.size // 4)
    both = used[1:] & used[:-1] & (np.diff(log.batch) == 0)
    if most <= _NEAR or not both.any():
        return lags
    moves, answers = (np.where(both, np.diff(log.values[name]), 0.0) for name in ("command", "m_w"))
    size = 1 << (2 * moves.size - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(answers, size) * np.conj(np.fft.rfft(moves, size)), size)
    far = np.concatenate([np.arange(-most, -_NEAR), np.arange(_NEAR + 1, most + 1)])
    peak = int(far[np.argmax(product[far])])
    return np.union1d(lags, np.arange(peak - _AROUND, peak + _AROUND + 1))


def _search(sums: Array, lags: Index, price: Array, worth: float) -> tuple[Index, Curve]:
    """The lag of each stretch, an index in ``lags``, and the curve: from each common lag until neither changes.

    worth: samples that are worth one independent one.
    """
    found = []
    n = sums[:, :, 0, :-1, :-1].sum(axis=(0, 2, 3))
    for common in np.flatnonzero(n >= 0.5 * n.max()):
        chosen = np.full(sums.shape[0], common)
        for _ in range(_ROUNDS):
            curve, before = _curve(sums, chosen, worth), chosen
            chosen = _cheapest(sums, lags, price, curve)
            if (chosen == before).all():
                break
        curve = _curve(sums, chosen, worth)
        changed = np.append(lags[chosen[0]] != 0, np.diff(chosen) != 0)
        found.append((price[changed].sum() - curve.likelihood, chosen, curve))
    _, chosen, curve = min(found, key=lambda one: float(one[0]))
    return chosen, curve


def _curve(sums: Array, chosen: Index, worth: float) -> Curve:
    """The best curve with each stretch at its lag."""
    total = sums[np.arange(chosen.size), chosen].sum(axis=0)
    flows = [_solved(G) for G in total]
    errors = [float(_errors(G, c)) for G, c in zip(total, flows, strict=True)]
    j = int(np.argmin(errors))
    n = max(float(total[j, :-1, :-1].sum()), 1.0)  # the weights of a sample sum to 1
    n_all = float(sums[:, :, j, :-1, :-1].sum(axis=(-2, -1)).max(axis=1).sum())
    mean = max(errors[j] / n, _ROUND_OFF**2 * float(total[j, -1, -1]) / n, _TINY)
    return Curve(j, flows[j], mean * worth, -0.5 * n_all / worth * float(np.log(mean)))


def _cheapest(sums: Array, lags: Index, price: Array, curve: Curve) -> Index:
    """The lag of each stretch, an index in ``lags``: the way through the stretches with the least errors and prices."""
    costs = _errors(sums[:, :, curve.backlash], curve.flows) / (2.0 * curve.variance)
    costs += _missing(sums, curve)
    best, ways = costs[0] + price[0] * (lags != 0), []
    for cost, of_change in zip(costs[1:], price[1:], strict=True):
        whole = best[:, None] + of_change * (lags[:, None] != lags)
        ways.append(whole.argmin(axis=0))
        best = whole.min(axis=0) + cost
    chosen = [int(best.argmin())]
    for way in reversed(ways):
        chosen.append(int(way[chosen[-1]]))
    return np.array(chosen[::-1])


def _missing(sums: Array, curve: Curve) -> Array:
    """Cost of samples that a lag leaves without a command, (stretches, lags): that of others; it may not be most."""
    n = sums[:, :, curve.backlash, :-1, :-1].sum(axis=(-2, -1))
    most = n.max(axis=1, keepdims=True)
    return np.where(n < 0.5 * most, np.inf, 0.5 * (most - n))


def _worth(log: Log, used: Mask, found: Stretches, chosen: Index, curve: Curve, step: float) -> float:
    """Samples of the fitted part that are worth one independent one, by the autocorrelation of the residuals."""
    lags = np.zeros(found.fitted.size)
    lags[found.fitted] = found.lags[chosen]
    command, outside = delayed(log, lags[found.number] * step)
    rows = np.ones((5, 1))
    rows[0] = _BACKLASHES[curve.backlash]
    openings, flows = np.empty((log.time.size, 1)), np.empty((log.time.size, 1))
    valve_flows(command, log.batch, rows, np.full((log.n_batches, 1), 0.5), openings, flows)
    used = used & ~outside
    r = np.where(used, hats(openings[:, 0]) @ curve.flows - log.values["m_w"], 0.0)
    n = int(np.flatnonzero(used)[-1]) + 1
    return max(1.0 + 2.0 * float(autocorrelation(r[:n], log.batch[:n], used[:n]).sum()), 1.0)


def _solved(G: Array) -> Array:
    A = G[:-1, :-1]
    ridge = _RIDGE * np.trace(A) + _TINY
    return np.asarray(np.linalg.solve(A + ridge * np.eye(A.shape[0]), G[:-1, -1]))


def _errors(G: Array, flows: Array) -> Array:
    """Sums of squared residuals, of sums of products (…, k, k)."""
    v = np.append(flows, -1.0)
    return np.asarray(np.maximum(np.einsum("...ij,i,j", G, v, v), 0.0))

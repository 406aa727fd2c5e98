"""The time shift of each stretch of a log that fits best, with one curve and one backlash for all of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.measured.fit.play_curve import errors_of, solved

BACKLASHES = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.125, 0.15, 0.18, 0.22, 0.27, 0.33, 0.4])
_WORTHWHILE = 0.8
"""A shift leaves at most this share of the squared residuals of the rows that it moves."""
_ROUNDS = 10
_ROUND_OFF = 1e-6
_TINY = 1e-300


class Curve(NamedTuple):
    """The backlash, an index in ``BACKLASHES``; flows at the knots, kg/s; variance of a residual, (kg/s)².

    worth: samples that are worth one independent one.  likelihood: logarithm of it.
    """

    backlash: int
    flows: Array
    variance: float
    worth: float
    likelihood: float


class Stretches(NamedTuple):
    """What the search needs of a log.

    lags: that are tried, in samples, (lags,).  number: of the stretch of each sample, (n,).  sums: of products of the
    curve's terms and the flow, (stretches, lags, backlashes, knots + 1, knots + 1).  counts: samples in each sum,
    (stretches, lags).  price: of each change of the lag
    from one stretch to the next, (stretches,), the first is that of any lag but 0.  fitted: (stretches,).
    """

    lags: Index
    number: Index
    sums: Array
    counts: Array
    price: Array
    fitted: Mask

    def of(self, which: Mask) -> Stretches:
        """Some of the stretches."""
        return self._replace(sums=self.sums[which], counts=self.counts[which], price=self.price[which])


def search(found: Stretches, worth: float) -> tuple[Index, Curve]:
    """The lag of each stretch, an index in ``lags``, and the curve: from each common lag until neither changes.

    worth: samples that are worth one independent one.
    """
    ways = []
    n = found.counts.sum(axis=0)
    for common in np.flatnonzero(n >= 0.5 * n.max()):
        chosen = np.full(found.sums.shape[0], common)
        for _ in range(_ROUNDS):
            curve, before = _curve(found, chosen, worth), chosen
            chosen = cheapest(found, curve)
            if (chosen == before).all():
                break
        curve = _curve(found, chosen, worth)
        changed = np.append(found.lags[chosen[0]] != 0, np.diff(chosen) != 0)
        ways.append((found.price[changed].sum() - curve.likelihood, chosen, curve))
    _, chosen, curve = min(ways, key=lambda one: float(one[0]))
    return chosen, curve


def _curve(found: Stretches, chosen: Index, worth: float) -> Curve:
    """The best curve with each stretch at its lag."""
    at = np.arange(chosen.size), chosen
    total, n = found.sums[at].sum(axis=0), max(float(found.counts[at].sum()), 1.0)
    flows = solved(total)
    errors = errors_of(total, flows)
    j = int(np.argmin(errors))
    mean = max(float(errors[j]) / n, _ROUND_OFF**2 * float(total[j, -1, -1]) / n, _TINY)
    n_all = float(found.counts.max(axis=1).sum())
    return Curve(j, flows[j], mean, worth, -0.5 * n_all / worth * float(np.log(mean)))


def cheapest(found: Stretches, curve: Curve) -> Index:
    """The lag of each stretch, an index in ``lags``: the way through the stretches with the least errors and prices.

    Samples that a lag leaves without a command cost as much as others; they may not be most of a stretch.  Where all
    of a stretch fits worse than the rest, chance moves it more easily: its own variance counts.
    """
    most = found.counts.max(axis=1, keepdims=True)
    errors = errors_of(found.sums[:, :, curve.backlash], curve.flows)
    errors = np.where(found.counts < 0.5 * most, np.inf, errors + curve.variance * (most - found.counts))
    own = errors.min(axis=1, keepdims=True) / np.maximum(most, 1.0)
    costs = errors / (2.0 * curve.worth * np.maximum(own, curve.variance))
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


def worthwhile(found: Stretches, chosen: Index, curve: Curve) -> Index:
    """The lag of each stretch in samples, 0 where a run of stretches with one lag gains little by it."""
    errors = errors_of(found.sums[:, :, curve.backlash], curve.flows)
    kept, none = found.lags[chosen], int(np.flatnonzero(found.lags == 0)[0])
    for run in np.split(np.arange(chosen.size), np.flatnonzero(np.diff(chosen)) + 1):
        if errors[run, chosen[run]].sum() > _WORTHWHILE * errors[run, none].sum():
            kept[run] = 0
    return kept

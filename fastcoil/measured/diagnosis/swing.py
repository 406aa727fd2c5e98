"""Whether a series swings, how far and how fast: from its autocovariance, which noise and gaps do not disturb."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask

REGULAR = 1.0
"""Regularity from which a swing counts as regular: Thornhill, Huang and Zhang, J. Process Control 13 (2003) 91."""
_LEAST_SHARE, _LEAST_PERIODS = 0.5, 8
"""A regular swing makes up at least this share of the variance, and is seen so many times."""
LEAST_SWING = 0.1
"""Peak to peak below which nobody minds a swing, K."""
_LEVELS = (600.0, 1800.0, 3600.0)
"""Seconds of the running means that take slower changes away; periods up to _LONGER of that are looked for."""
_LONGER = 1.2
_SHOWN, _SHOWN_CLEARLY, _CLEAR = 3, 2, 0.7
"""Periods in the longest unbroken stretch, at least; fewer will do where so large a share is periodic."""
_INTERVALS = 10
"""Intervals between zero crossings of the autocovariance that are compared, at most."""
_FEWEST = 4
_MINDFUL = 0.1
"""Share of the longest lag's pairs that must be there, against those of lag 0."""
_SMOOTH = 12
"""The mean over this part of the period takes the noise away before the swing is measured."""


class Swing(NamedTuple):
    """A swing of a series.

    period: s; NaN if it has none that can be told.  regularity: a third of the mean over the standard deviation of the
    intervals between zero crossings of the autocovariance.  share: of the variance that is periodic, the
    autocovariance one period away over that at 0.  peak_to_peak: mean over the periods, in the unit of the series,
    noise smoothed.  periods: how many whole ones the series has.
    """

    period: float
    regularity: float
    share: float
    peak_to_peak: float
    periods: float

    @property
    def is_regular(self) -> bool:
        """Whether it comes back again and again, and matters: what a technician calls hunting."""
        return (
            self.regularity > REGULAR
            and self.share > _LEAST_SHARE
            and self.periods >= _LEAST_PERIODS
            and self.peak_to_peak > LEAST_SWING
        )


NO_SWING = Swing(np.nan, 0.0, 0.0, np.nan, 0.0)


def swing_of(series: Array, good: Mask, interval: float) -> Swing:
    """How a series swings where it is ``good``, (n,) each; ``interval``: s from sample to sample.

    Thornhill, Huang and Zhang (2003): the zero crossings of the autocovariance come at half the period; they are
    regular if r = mean / (3 standard deviation) of the intervals between them exceeds 1.  Slower drifts are taken away
    before, by running means of several lengths; the most periodic of what is left counts.  The longest unbroken stretch
    must show three periods, or two clear ones.
    """
    longest = longest_run(good) * interval
    found = NO_SWING
    for seconds in _LEVELS:
        width = round(seconds / interval)
        if width < _FEWEST or good.sum() < width:
            continue
        rest = np.where(good, series - running_mean(series, good, width), 0.0)
        swing = _from_autocovariance(rest, good, interval)
        shown = _SHOWN_CLEARLY if swing.share > _CLEAR else _SHOWN
        if swing.period < min(_LONGER * seconds, longest / shown) and swing.share > found.share:
            found = swing
    return found


def longest_run(good: Mask) -> int:
    """Samples of the longest unbroken stretch."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    return int(np.max(ends[1::2] - ends[::2], initial=0))


def _from_autocovariance(rest: Array, good: Mask, interval: float) -> Swing:
    covariance = _autocovariance(rest, good)
    if covariance[0] <= 0.0:
        return NO_SWING
    crossings = _crossings(covariance)
    if crossings.size < _FEWEST + 1:
        return NO_SWING
    between = np.diff(crossings)[:_INTERVALS] * interval
    spread = float(between.std(ddof=1))
    regularity = float(between.mean()) / (3.0 * spread) if spread > 0.0 else np.inf
    period = 2.0 * float(between.mean())
    lag = min(round(period / interval), covariance.size - 1)
    share = float(covariance[lag] / covariance[0])
    size = _peak_to_peak(rest, good, period / interval)
    return Swing(period, regularity, share, size, float(good.sum()) * interval / period)


def _autocovariance(rest: Array, good: Mask) -> Array:
    """Mean product of good pairs at each lag, as far as there are enough of them."""
    size = 1 << int(2 * rest.size - 1).bit_length()
    products, pairs = (np.fft.irfft(np.abs(np.fft.rfft(s, size)) ** 2, size)[: rest.size] for s in (rest, good * 1.0))
    enough = pairs > _MINDFUL * max(pairs[0], 1.0)
    last = int(np.argmin(enough)) if not enough.all() else enough.size
    return np.asarray(products[:last] / np.maximum(pairs[:last], 1.0))


def _crossings(covariance: Array) -> Array:
    """Lags at which the autocovariance crosses zero, between the samples."""
    at = np.flatnonzero(np.signbit(covariance[1:]) != np.signbit(covariance[:-1]))
    before, after = covariance[at], covariance[at + 1]
    return np.asarray(at + before / (before - after))


def _peak_to_peak(rest: Array, good: Mask, period: float) -> float:
    """Mean of highest less lowest in each period, in which all samples are good; noise is smoothed before."""
    width, n = max(1, round(period / _SMOOTH)), max(2, round(period))
    smooth = running_mean(rest, good, width)
    whole = rest.size // n
    blocks, fine = smooth[: whole * n].reshape(whole, n), good[: whole * n].reshape(whole, n).all(axis=1)
    return float(np.ptp(blocks[fine], axis=1).mean()) if fine.any() else np.nan


def median_swing(series: Array, good: Mask, samples: int) -> float:
    """Median of highest less lowest over so many samples in a row that are all good; NaN if there are none."""
    whole = series.size // samples
    blocks = series[: whole * samples].reshape(whole, samples)
    fine = good[: whole * samples].reshape(whole, samples).all(axis=1)
    return float(np.median(np.ptp(blocks[fine], axis=1))) if fine.any() else np.nan


def running_mean(series: Array, good: Mask, width: int) -> Array:
    """Mean of the good samples among the ``width`` around each."""

    def total(of: Array) -> Array:
        summed = np.concatenate([[0.0], np.cumsum(of)])
        index = np.arange(of.size)
        low, high = np.maximum(index - width // 2, 0), np.minimum(index + (width + 1) // 2, of.size)
        return np.asarray(summed[high] - summed[low])

    return np.asarray(total(np.where(good, series, 0.0)) / np.maximum(total(good.astype(float)), 1.0))

"""What a log shows of its loop before any model: how it swings, known performance indices, what its motor does."""

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.grid import Grid, motor_positions
from fastcoil.measured.part import runs

# when a swing counts as regular
REGULAR = 1.0  # regularity above this: Thornhill, Huang and Zhang, J. Process Control 13 (2003) 91
_LEAST_SHARE, _LEAST_PERIODS = 0.5, 8  # of the variance, and seen so many times
LEAST_SWING = 0.1  # peak to peak below which a swing does not matter, K
_LEVELS, _LONGER = (600.0, 1800.0, 3600.0), 1.2
"""Seconds of the running means that take slower changes away; periods up to ``_LONGER`` of that are looked for."""
_SHOWN, _SHOWN_CLEARLY, _CLEAR = 3, 2, 0.7
"""Periods in the longest unbroken stretch, at least; fewer will do where so large a share is periodic."""
_INTERVALS, _FEWEST = 10, 4  # intervals between zero crossings of the autocovariance that are compared
_MINDFUL = 0.1  # share of the longest lag's pairs that must be there, against those of lag 0
SMOOTH = 12  # the mean over this part of the period takes the noise away before the swing is measured


class Swing(NamedTuple):
    """A swing of a series."""

    period: float  # s; NaN if none can be resolved
    regularity: float  # a third of the mean over the deviation of the intervals between zero crossings
    share: float  # of the variance that is periodic: the autocovariance one period away over that at 0
    peak_to_peak: float  # mean over the periods, in the unit of the series, noise smoothed
    periods: float  # how many whole ones the series has

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
    return int(np.max(np.diff(runs(good)), initial=0))


def _from_autocovariance(rest: Array, good: Mask, interval: float) -> Swing:
    covariance = _autocovariance(rest, good)
    at = np.flatnonzero(np.signbit(covariance[1:]) != np.signbit(covariance[:-1]))
    if covariance[0] <= 0.0 or at.size < _FEWEST + 1:
        return NO_SWING
    crossings = at + covariance[at] / (covariance[at] - covariance[at + 1])
    between = np.diff(crossings)[:_INTERVALS] * interval
    spread = float(between.std(ddof=1))
    regularity = float(between.mean()) / (3.0 * spread) if spread > 0.0 else np.inf
    period = 2.0 * float(between.mean())
    lag = min(round(period / interval), covariance.size - 1)
    samples = period / interval
    smooth = running_mean(rest, good, max(1, round(samples / SMOOTH)))  # of noise
    sizes = _spans(smooth, good, max(2, round(samples)))
    size = float(sizes.mean()) if sizes.size else np.nan
    return Swing(
        period, regularity, float(covariance[lag] / covariance[0]), size, float(good.sum()) * interval / period
    )


def _autocovariance(rest: Array, good: Mask) -> Array:
    """Mean product of good pairs at each lag, as far as there are enough of them."""
    size = 1 << int(2 * rest.size - 1).bit_length()
    products, pairs = (np.fft.irfft(np.abs(np.fft.rfft(s, size)) ** 2, size)[: rest.size] for s in (rest, good * 1.0))
    enough = pairs > _MINDFUL * max(pairs[0], 1.0)
    last = int(np.argmin(enough)) if not enough.all() else enough.size
    return np.asarray(products[:last] / np.maximum(pairs[:last], 1.0))


def _spans(series: Array, good: Mask, samples: int) -> Array:
    """Highest less lowest over so many samples in a row, where all are good."""
    whole = series.size // samples
    blocks, fine = (of[: whole * samples].reshape(whole, samples) for of in (series, good))
    return np.asarray(np.ptp(blocks[fine.all(axis=1)], axis=1))


def running_mean(series: Array, good: Mask, width: int) -> Array:
    """Mean of the good samples among the ``width`` around each."""

    def total(of: Array) -> Array:
        summed = np.concatenate([[0.0], np.cumsum(of)])
        index = np.arange(of.size)
        low, high = np.maximum(index - width // 2, 0), np.minimum(index + (width + 1) // 2, of.size)
        return np.asarray(summed[high] - summed[low])

    return np.asarray(total(np.where(good, series, 0.0)) / np.maximum(total(good.astype(float)), 1.0))


SETTLED_AFTER = 600.0  # seconds after a change of the set-point from which the loop counts as settled
LEAST_CHANGE = 0.3  # change of the set-point that counts, K, in one step or within that time
_END = 0.005  # a command so near to closed or open counts as that
_DAY = 86400.0


def settled(T_set: Array, good: Mask, interval: float) -> Mask:
    """Where the set-point has hardly moved for a while, and the plant was on all that time, (n,)."""
    width = max(1, round(SETTLED_AFTER / interval))
    if T_set.size <= width:
        return np.zeros(T_set.size, dtype=bool)
    known = np.where(np.isfinite(T_set), T_set, np.inf)
    windows = sliding_window_view(known, width + 1)
    with np.errstate(invalid="ignore"):
        steady = windows.max(axis=1) - windows.min(axis=1) < LEAST_CHANGE
    there = sliding_window_view(good, width + 1).mean(axis=1) > 0.5
    return np.concatenate([np.zeros(width, dtype=bool), steady & there]) & good


def in_control(command: Array, good: Mask, interval: float) -> Mask:
    """Where the valve was not closed or wide open for so long that the loop has no say, (n,)."""
    found = good.copy()
    for first, last in runs(good & ((command <= _END) | (command >= 1.0 - _END))):
        if (last - first) * interval > SETTLED_AFTER:
            found[first:last] = False
    return found


def travel(positions: Array, on: Mask, interval: float) -> tuple[float, float]:
    """Strokes and turns of the motor in a day of operation; ``positions``: (n + 1,), at the samples.

    A turn is a change of sign between successive movements.
    """
    days = float(on.sum()) * interval / _DAY
    if days == 0.0:
        return np.nan, np.nan
    moves = np.diff(positions)[on]
    moved = moves[np.abs(moves) > 1e-9]
    return float(np.abs(moved).sum()) / days, float(np.sum(moved[1:] * moved[:-1] < 0.0)) / days


COARSE = 60.0  # interval beyond which a log misses the swings of most loops, s
USUAL_PERIOD = 600.0  # s, where the temperature shows no swing
LEAST_WATCHED, LEAST_PIECE = 3600.0, 600.0
"""Seconds of settled operation, and of its longest piece, after which a loop that does not swing may be called calm."""
WIDE = 0.5  # peak to peak of a swing above which no loop is called calm, K, although it does not come back regularly


class Measures(NamedTuple):
    """What a log shows of its loop."""

    calm: Mask  # where the plant was on, in control and settled, (n,)
    swing: Swing  # of the control error there, K; of the temperature, if there is no set-point
    position: Array  # of the motor, (n,)
    command_swing: float  # median of highest less lowest command in a period
    indices: dict[str, float]
    blind: str  # why the log could not show a swing; empty if it could


def measures_of(grid: Grid, stroke_time: float) -> Measures:
    """Measure a log; ``stroke_time``: of the motor, s."""
    T, command, interval = grid.values["T_sup"], grid.values["command"], grid.interval
    T_set = grid.values.get("T_set")
    error = T if T_set is None else T - T_set
    good = grid.on & np.isfinite(error) & np.isfinite(command)
    calm = in_control(command, good, interval)
    if T_set is not None:
        calm &= settled(T_set, good, interval)
    error = np.where(good, error, 0.0)
    swing = swing_of(error, calm, interval)
    known = np.where(np.isfinite(command), command, 0.0)
    positions = motor_positions(known, interval, stroke_time)
    strokes, turns = travel(positions, good, interval)
    length = swing.period if np.isfinite(swing.period) else USUAL_PERIOD
    spans = _spans(known, calm, max(2, round(length / interval)))
    moved = float(np.median(spans)) if spans.size else np.nan
    rms = [
        float(np.sqrt(np.mean(error[where] ** 2))) if T_set is not None and where.any() else np.nan
        for where in (good, calm)
    ]
    indices = {
        "error_rms": rms[0], "error_rms_settled": rms[1], "peak_to_peak": swing.peak_to_peak, "period": swing.period,
        "regularity": swing.regularity, "periodic_share": swing.share, "command_swing": moved,
        "motor_travel": strokes, "reversals": turns,
    }  # fmt: skip
    return Measures(calm, swing, positions[:-1], moved, indices, _blind(grid, calm, swing))


def _blind(grid: Grid, calm: Mask, swing: Swing) -> str:
    watched, piece = float(calm.sum()) * grid.interval, longest_run(calm) * grid.interval
    reasons = {
        f"a sample every {grid.interval:.4g} s misses swings of minutes: log every 30 s or faster":
            grid.interval > COARSE,
        f"the loop is settled with its valve between the ends for {watched / 60:.0f} min only: log an hour or more of "
        "that, with the set-point held": watched < LEAST_WATCHED,
        f"the log has no more than {piece / 60:.0f} min in one piece: log without gaps, or bridge them (max_gap)":
            piece < LEAST_PIECE,
        "the log has no set-point (T_set), and its changes hide a swing: log it, too": "T_set" not in grid.values,
        "the swing is not even enough to judge the whole log: log every 10 s, with half an hour between two changes "
        "of the set-point": swing.peak_to_peak > WIDE and swing.regularity > REGULAR,
    }  # fmt: skip
    return next((reason for reason, holds in reasons.items() if holds), "")

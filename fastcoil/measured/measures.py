"""What a log shows of its loop before any model: how it swings, known performance indices, what its motor does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.fitted_loop import FittedLoop
from fastcoil.measured.grid import Grid, motor_positions
from fastcoil.measured.identify import USUAL_STROKE_TIME

REGULAR = 1.0
"""Regularity from which a swing counts as regular: Thornhill, Huang and Zhang, J. Process Control 13 (2003) 91."""
_LEAST_SHARE, _LEAST_PERIODS = 0.5, 8
"""A regular swing makes up at least this share of the variance, and is seen so many times."""
LEAST_SWING = 0.1
"""Peak to peak below which a swing does not matter, K."""
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

    period: s; NaN if none can be resolved.  regularity: a third of the mean over the standard deviation of the
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


SETTLED_AFTER = 600.0
"""Seconds after a change of the set-point from which the loop counts as settled."""
LEAST_CHANGE = 0.3
"""Change of the set-point that counts, K, in one step or within the time above."""
_END = 0.005
"""A command so near to closed or open counts as that."""
_AMPLITUDE = 0.1
"""Of the least oscillation that Hägglund's index counts, K: 1 % of the 10 K that a supply temperature ranges over."""
_EVENTS, _SUPERVISED = 10, 50.0
"""So many events within so many integral times are an oscillation."""
_ORDER, _STEP, _AHEAD = 15, 30.0, 60.0
"""Order of the model of the error, its step [s], and the time that no controller can overtake [s]."""
_LONG, _PEAKED = 5.0, 2.0
"""A half period counts for Hägglund's gap if it lasts so many integral times and its peak is below so many means."""
_DAY = 86400.0


class Index(NamedTuple):
    """A number with its unit and its meaning; NaN where the log does not show it."""

    value: float
    unit: str
    meaning: str


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
    at_end = good & ((command <= _END) | (command >= 1.0 - _END))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at_end, [False]]).astype(int)))
    found = good.copy()
    for first, last in zip(edges[::2], edges[1::2], strict=True):
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


def oscillation_index(e: Array, good: Mask, interval: float, ti: float) -> float:
    """Hägglund, Control Engineering Practice 3 (1995) 1543: above 1 the loop oscillates.

    The integral of |e| between two zero crossings is an event if it exceeds 2 a/ω, as that of half a sine of amplitude
    a = 0.1 K and frequency ω = 2 π/ti does: a ti/π.  The index is the largest number of events within 50 ti, over 10.

    ti: integral time, s; where it is not known, the period of the oscillation stands for it.
    """
    if not np.isfinite(ti):
        return 0.0
    halves = half_periods(e, good, interval)
    at = halves.end[halves.iae > _AMPLITUDE * ti / np.pi]
    within = np.searchsorted(at, at + _SUPERVISED * ti, side="right") - np.arange(at.size)
    return float(np.max(within, initial=0)) / _EVENTS


class Halves(NamedTuple):
    """Half periods of an error, between zero crossings.

    end, duration: s.  iae: integral of its absolute value, K s.  peak: largest of it, K.
    """

    end: Array
    duration: Array
    iae: Array
    peak: Array


def half_periods(e: Array, good: Mask, interval: float) -> Halves:
    """The half periods that are wholly good."""
    sign = np.where(good, np.where(e > 0.0, 1, -1), 0)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(sign)) + 1, [e.size]])
    first, last = edges[:-1], edges[1:]
    whole = (sign[first] != 0) & (first > 0) & (last < e.size)
    whole &= (sign[first - 1] == -sign[first]) & (sign[np.minimum(last, e.size - 1)] == -sign[first])
    size = np.where(good, np.abs(e), 0.0)
    iae = np.add.reduceat(size, first)[whole] * interval
    peak = np.maximum.reduceat(size, first)[whole]
    return Halves(last[whole] * interval, (last - first)[whole] * interval, iae, peak)


def harris_index(e: Array, good: Mask, interval: float) -> float:
    """Normalised Harris index, 1 - σ²/mean e²: 0 is the best that feedback can do, 1 the worst.

    σ² is the variance of what could not be predicted of the error a minute ahead: from an autoregressive model of order
    15 in steps of 30 s, with innovations of variance s² and impulse response h, σ² = s² (h₀² + h₁²).  The index of
    Harris (Can. J. Chem. Eng. 67 (1989) 856) as ASHRAE RP-1587 recommends it for HVAC loops; a minute stands for the
    dead time, which a log does not show.
    """
    every = max(1, round(_STEP / interval))
    thinned, usable = e[::every], good[::every]
    if thinned.size <= _ORDER:
        return np.nan
    windows = sliding_window_view(thinned, _ORDER + 1)[sliding_window_view(usable, _ORDER + 1).all(axis=1)]
    if windows.shape[0] < 4 * _ORDER:
        return np.nan
    centre = windows.mean()
    X, y = windows[:, -2::-1] - centre, windows[:, -1] - centre
    a = np.linalg.lstsq(X, y, rcond=None)[0]
    innovations = float(np.mean((y - X @ a) ** 2))
    h = np.zeros(max(1, round(_AHEAD / (every * interval))))
    h[0] = 1.0
    for j in range(1, h.size):
        h[j] = a[: min(j, _ORDER)] @ h[j - 1 :: -1][:_ORDER]
    total = float(np.mean(windows[:, -1] ** 2))
    return float(np.clip(1.0 - innovations * float(h @ h) / total, 0.0, 1.0)) if total > 0.0 else np.nan


def hagglund_gap(e: Array, good: Mask, interval: float, kp: float, ti: float, gain: float) -> float:
    """Backlash after Hägglund, J. Process Control 17 (2007) 741, fraction of stroke; NaN without evidence.

    While the gap is crossed the valve stands still and the error is a square wave; d = kp (Δt/ti - 1/(kp gain)) Δy,
    with the mean error Δy of a half period Δt.  The median of those that last 5 ti or more and peak below 2 Δy.

    kp, ti: gain [1/K] and integral time [s] of the controller.  gain: of the plant, K per stroke.
    """
    halves = half_periods(e, good, interval)
    mean = halves.iae / halves.duration
    d = kp * (halves.duration / ti - 1.0 / (kp * gain)) * mean
    counts = (halves.duration >= _LONG * ti) & (halves.peak < _PEAKED * mean) & (d > 0.0) & (d < 1.0)
    return float(np.median(d[counts])) if counts.any() else np.nan


def rms(e: Array, good: Mask) -> float:
    """Root mean square where good; NaN without samples."""
    return float(np.sqrt(np.mean(e[good] ** 2))) if good.any() else np.nan


COARSE = 60.0
"""Interval beyond which a log misses the swings of most loops, s."""
USUAL_PERIOD = 600.0
"""Seconds, where the temperature shows no swing."""
LEAST_WATCHED, LEAST_PIECE = 3600.0, 600.0
"""Seconds of settled operation, and of its longest piece, after which a loop that does not swing may be called calm."""
WIDE = 0.5
"""Peak to peak of a swing above which no loop is called calm, K, although it does not come back regularly."""


class Measures(NamedTuple):
    """What a log shows of its loop.

    error: control error where it is known, K, (n,); else of the temperature, °C.  has_error: which of the two.
    calm: where the plant was on, in control and settled, (n,).  swing: of the error there.  position: of the motor,
    (n,).  command_swing: median of highest less lowest command in a period.  indices: by name.  blind: why the log
    could not show a swing; empty if it could.
    """

    error: Array
    has_error: bool
    calm: Mask
    swing: Swing
    position: Array
    command_swing: float
    indices: dict[str, Index]
    blind: str


def measures_of(grid: Grid, stroke_time: float | None) -> Measures:
    """Measure a log; ``stroke_time``: of the motor, s, the usual one if None."""
    T, command = grid.values["T_sup"], grid.values["command"]
    T_set = grid.values.get("T_set")
    error = T if T_set is None else T - T_set
    good = grid.on & np.isfinite(error) & np.isfinite(command)
    calm = in_control(command, good, grid.interval)
    if T_set is not None:
        calm &= settled(T_set, good, grid.interval)
    error = np.where(good, error, 0.0)
    swing = swing_of(error, calm, grid.interval)
    seconds = USUAL_STROKE_TIME if stroke_time is None else stroke_time
    known = np.where(np.isfinite(command), command, 0.0)
    positions = motor_positions(known, grid.interval / seconds if seconds > 0.0 else 1.0)
    strokes, turns = travel(positions, good, grid.interval)
    length = swing.period if np.isfinite(swing.period) else USUAL_PERIOD
    moved = median_swing(known, calm, max(2, round(length / grid.interval)))
    has_error = T_set is not None
    rms_error, rms_settled = (rms(error, where) if has_error else np.nan for where in (good, calm))
    oscillation = oscillation_index(error, calm, grid.interval, swing.period) if has_error else np.nan
    harris = harris_index(error, calm, grid.interval) if has_error else np.nan
    indices = {
        "error_rms": Index(rms_error, "K", "RMS control error"),
        "error_rms_settled": Index(rms_settled, "K", "RMS control error, settled and in control"),
        "peak_to_peak": Index(swing.peak_to_peak, "K", "swing of the supply temperature, peak to peak"),
        "period": Index(swing.period, "s", "period of the swing"),
        "regularity": Index(swing.regularity, "1", "regularity of the swing after Thornhill: regular above 1"),
        "periodic_share": Index(swing.share, "1", "share of the variance that comes back after a period"),
        "oscillation": Index(oscillation, "1", "oscillation index after Hägglund: oscillates above 1"),
        "harris": Index(harris, "1", "normalised Harris index: 0 is the best that feedback can do, 1 the worst"),
        "command_swing": Index(moved, "1", "median swing of the command in a period, peak to peak"),
        "motor_travel": Index(strokes, "d-1", "strokes of the motor in a day"),
        "reversals": Index(turns, "d-1", "turns of the motor in a day"),
    }
    return Measures(error, has_error, calm, swing, positions[:-1], moved, indices, _blind(grid, calm, swing))


def loop_indices(measures: Measures, interval: float, loop: FittedLoop | str, *, trusted: bool) -> dict[str, Index]:
    """Indices of the controller, and of a plant that is ``trusted``: NaN where the loop could not be modelled."""
    kp, ti, every, gain, margin, size = (np.nan,) * 6
    if not isinstance(loop, str):
        kp, ti, every = loop.kp, loop.ti, loop.sample_time
        if trusted:
            gain, margin = loop.gain, loop.margin
            size = hagglund_gap(measures.error, measures.calm, interval, kp, ti, abs(gain))
    return {
        "hagglund_backlash": Index(size, "1", "backlash after Hägglund, fraction of stroke"),
        "kp": Index(kp, "K-1", "gain of the controller"),
        "ti": Index(ti, "s", "integral time of the controller"),
        "sample_time": Index(every, "s", "time between samples of the controller"),
        "plant_gain": Index(gain, "K", "change of the temperature over the stroke"),
        "margin": Index(margin, "1", "margin max |L||N| of the describing function: above 0.8 a gap makes it hunt"),
    }


def _blind(grid: Grid, calm: Mask, swing: Swing) -> str:
    if grid.interval > COARSE:
        return f"a log with a sample every {grid.interval:g} s misses swings of minutes: log every 30 s or faster"
    watched, piece = float(calm.sum()) * grid.interval, longest_run(calm) * grid.interval
    if watched < LEAST_WATCHED:
        return (
            f"the loop is settled and in control for {watched / 60:.0f} min only: log an hour or more with the "
            "set-point held"
        )
    if piece < LEAST_PIECE:
        return f"the log has no more than {piece / 60:.0f} min in one piece: log without gaps, or bridge them (max_gap)"
    if "T_set" not in grid.values:
        return "the log has no set-point (T_set), and its changes hide a swing: log it, too"
    if swing.peak_to_peak > WIDE and swing.regularity > REGULAR:
        return (
            f"the temperature swings by ± {swing.peak_to_peak / 2:.2g} K about every {swing.period / 60:.0f} min, but "
            "not evenly enough to be sure: log every 10 s, some hours with the set-point held"
        )
    return ""

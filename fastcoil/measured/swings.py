"""Swings of a temperature, with their clock times, on any set-point: cycles between successive turns."""

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.measured.grid import forward_fill, running_mean
from fastcoil.measured.part import true_runs

LEAST_SWING_K = 1.5  # peak to peak, of a swing that counts: loads and mixing make ± 0.6 K
_LEVEL_S = 3600.0  # over which the level is averaged, twice: swings of up to 75 min pass
LONGEST_HALF_CYCLE_S = 2700.0  # a drift takes longer
_LEAST_HALF_CYCLES = 6  # in a row, of a swing that goes on
_SLOW_PERIOD_S = 1800.0  # from which loads make three cycles as well: one more is needed
FEWEST_SAMPLES = 4  # of a period that the log resolves
_LEAST_COMMAND_SWING = 0.03  # peak to peak, fraction of stroke, of a valve that makes the air swing
_INTEGRAL_RATIO = 5.5  # of integral to proportional action at the period, from which Ti is too short for any valve
_GAP_RATIO = 1.4  # of the same, from which Ti is too short for a valve that may have a gap
_PROPORTIONAL_RATIO = 0.7  # of the same, up to which the gain is too high
TI_PER_PERIOD = 0.25  # new Ti over the period: the integral then lags by 33 degrees
_MOST_TURNS_RATIO = 2.0  # of turns of the command over those of the temperature, or the reverse


class SwingWindow(NamedTuple):
    """A time in which a temperature swings."""

    first: int  # sample
    end: int  # sample after the last
    peak_to_peak: float  # K, median of the half cycles
    period: float  # s, median


def find_swings(
    T: Array, good: Mask, interval: float, least: float = LEAST_SWING_K, longest_half: float = LONGEST_HALF_CYCLE_S,
    fewest_samples: float = FEWEST_SAMPLES,
) -> list[SwingWindow]:  # fmt: skip
    """Find where a temperature, (n,), swings by ``least`` K or more, three cycles or more; times in s.

    fewest_samples: of a period; a swing that is sampled more rarely keeps its size and looks slower than it is.
    """
    turns, x = find_turns(T, good, interval, 0.5 * least)
    if turns.size < _LEAST_HALF_CYCLES + 1:
        return []
    heights, widths = np.abs(np.diff(x[turns])), np.diff(turns) * interval
    bad_before = np.concatenate([[0], np.cumsum(~good)])
    is_unbroken = bad_before[turns[1:] + 1] == bad_before[turns[:-1]]
    is_swing = is_unbroken & (heights >= 0.6 * least) & (widths <= longest_half)
    windows = []
    for first, last in true_runs(is_swing).tolist():
        height, halves = float(np.median(heights[first:last])), widths[first:last]
        if halves.size < _LEAST_HALF_CYCLES or height < least:
            continue
        periods = halves[1:] + halves[:-1]
        period = float(np.median(periods))
        if halves.size >= _LEAST_HALF_CYCLES + 2 * (period > _SLOW_PERIOD_S) and period >= fewest_samples * interval:
            windows.append(SwingWindow(int(turns[first]), int(turns[last]) + 1, height, period))
    return windows


def detrend(series: Array, good: Mask, interval: float) -> Array:
    """Return a series less its level, a mean over an hour taken twice, (n,); 0 where it is not ``good``."""
    width = max(round(_LEVEL_S / interval), 8)
    known = np.where(good, series, 0.0)
    level = running_mean(running_mean(known, good, width), good, width)
    return np.where(good, known - level, 0.0)


def find_turns(series: Array, good: Mask, interval: float, least: float) -> tuple[Index, Array]:
    """Return the samples at which a detrended series turns by more than ``least``, and that series."""
    x = detrend(series, good, interval)
    turns, direction, extreme, at = [], 0, float(x[0]), 0
    for k, value in enumerate(x.tolist()):
        change = value - extreme
        if direction * change > 0.0 or (direction == 0 and abs(change) > least):
            if direction == 0:
                direction = 1 if change > 0.0 else -1
            extreme, at = value, k
        elif direction and abs(change) > least:
            turns.append(at)
            direction, extreme, at = -direction, value, k
    return np.array(turns, dtype=np.int64), x


def swing_within(series: Array, good: Mask, interval: float, window: SwingWindow) -> float:
    """Return the median peak-to-peak swing of a series in the periods of a window."""
    part = slice(max(window.first - round(_LEVEL_S / interval), 0), window.end + round(_LEVEL_S / interval))
    known = forward_fill(series[part])
    is_good = good[part] & np.isfinite(known)
    x = detrend(known, is_good, interval)[window.first - part.start :][: window.end - window.first]
    samples = max(2, round(window.period / interval))
    blocks = [x[k : k + samples] for k in range(0, max(x.size - samples, 0) + 1, samples)]
    return float(np.median([np.ptp(block) for block in blocks])) if blocks else 0.0


def moves_with(command: Array, window: SwingWindow, swing: float, interval: float) -> bool:
    """Whether a valve may make the swing of a window: its command swings, ``swing``, as often as the temperature."""
    if swing < _LEAST_COMMAND_SWING:
        return False
    part = command[window.first : window.end]
    turns = find_turns(part, np.isfinite(part), interval, 0.4 * swing)[0].size
    expected = 2.0 * (window.end - window.first) * interval / window.period
    return expected / _MOST_TURNS_RATIO - 2 <= turns <= expected * _MOST_TURNS_RATIO + 2


class GainFault(NamedTuple):
    """What is wrong with the gains of a loop that swings, and what to do."""

    cause: str  # ``integral``: Ti too short; ``integral_or_gap``; ``gain``: kp too high; ``unknown``
    kp: float  # to set, 1/K
    ti: float  # to set, s
    action: str


def judge_gains(kp: float, ti: float, period: float) -> GainFault:
    """Judge the gains, 1/K and s, of a PI by the period of its swing, s.

    The integral action at that period is period/(2 pi Ti) times the proportional one.  Where it prevails by far, Ti is
    too short for any valve; where it prevails, for this one, which may have a gap; where it is small, kp makes the
    swing.  The table air_handler_causes of ``studies/air_handler`` shows what the limits are worth.
    """
    ratio = period / (2.0 * math.pi * ti)
    swing = f"a period of {describe_period(period)}"
    ti_text = f"{ti:.0f}" if ti >= 100.0 else f"{ti:.3g}"
    pi = f"kp {kp:.2g} 1/K and Ti {ti_text} s" if ti >= 1.0 else "no proportional action to speak of"
    if ratio >= _GAP_RATIO:
        new_ti = float(f"{TI_PER_PERIOD * period:.2g}")
        if ratio >= _INTEGRAL_RATIO:
            action = f"raise Ti to {new_ti:.0f} s: the log shows {pi}, and {swing}: a pure integrator"
            return GainFault("integral", kp, new_ti, action)
        action = f"raise Ti to {new_ti:.0f} s and leave kp: the log shows {pi}, and {swing}, nearly a pure integrator; "
        action += "if the swing stays, a gap of the valve makes it: make a valve test"
        return GainFault("integral_or_gap", kp, new_ti, action)
    new_kp = float(f"{0.5 * kp:.1g}")
    if ratio <= _PROPORTIONAL_RATIO:
        action = f"lower kp to {new_kp:g} 1/K and leave Ti: the log shows {pi}, and {swing}, at which kp decides"
        return GainFault("gain", new_kp, ti, action)
    action = f"lower kp to {new_kp:g} 1/K, and see whether the swing ends: the log shows {pi}, and {swing}"
    return GainFault("unknown", new_kp, ti, action)


def describe_period(period: float) -> str:
    """Format a period, s, in s or min."""
    return f"{period:.0f} s" if period < 120.0 else f"{period / 60.0:.0f} min"

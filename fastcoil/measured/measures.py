"""Measures of a log that need no model: its swing, indices of its loop and motor, and a state for every hour."""

import math
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.grid import SECONDS_PER_DAY, Grid, forward_fill, motor_positions, running_mean
from fastcoil.measured.part import true_runs
from fastcoil.model.hunting import OWN_SHARE

LEAST_REGULARITY = 1.0  # of a regular swing: Thornhill, Huang and Zhang, J. Process Control 13 (2003) 91
SMOOTHINGS_PER_PERIOD = 12  # means over this part of a period remove the noise before a swing is measured
_FEWEST_INTERVALS = 4  # between zero crossings of the autocovariance, to resolve a period


class Swing(NamedTuple):
    """A swing of a series."""

    period: float  # s; NaN if none can be resolved
    regularity: float  # a third of the mean over the deviation of the intervals between zero crossings
    periodic_share: float  # of the variance that is periodic: the autocovariance one period away over that at 0
    peak_to_peak: float  # mean over the periods, in the unit of the series, noise smoothed
    periods: float  # number of periods in the series

    @property
    def is_regular(self) -> bool:
        """Whether the swing repeats regularly and is large enough to be called hunting."""
        repeats = self.regularity > LEAST_REGULARITY and self.is_periodic and self.periods >= 8
        return repeats and self.peak_to_peak > 0.1  # K

    @property
    def is_periodic(self) -> bool:
        """Whether most of the variance comes back after a period."""
        return self.periodic_share > 0.5


NO_SWING = Swing(np.nan, 0.0, 0.0, np.nan, 0.0)


def measure_swing(series: Array, good: Mask, interval: float) -> Swing:
    """Measure how a series swings where it is ``good``, (n,) each; ``interval``: s between samples.

    Thornhill, Huang and Zhang (2003): the zero crossings of the autocovariance come at half the period; they are
    regular if r = mean / (3 standard deviations) of the intervals between them exceeds 1.  Running means of several
    lengths remove slower drifts; the most periodic remainder counts.  The longest run must show three periods, or two
    clear ones.
    """
    longest_seconds = longest_run(good) * interval
    most_periodic = NO_SWING
    for seconds in (600.0, 1800.0, 3600.0):
        width = round(seconds / interval)
        if width < _FEWEST_INTERVALS or good.sum() < width:
            continue
        detrended = np.where(good, series - running_mean(series, good, width), 0.0)
        swing = _swing_from_autocovariance(detrended, good, interval)
        longest_period = min(1.2 * seconds, longest_seconds / (2 if swing.periodic_share > 0.7 else 3))
        if swing.period < longest_period and swing.periodic_share > most_periodic.periodic_share:
            most_periodic = swing
    return most_periodic


def longest_run(good: Mask) -> int:
    """Return the number of samples in the longest run of True in a mask."""
    return int(np.max(np.diff(true_runs(good)), initial=0))


def _swing_from_autocovariance(detrended: Array, good: Mask, interval: float) -> Swing:
    covariance = _autocovariance(detrended, good)
    k = np.flatnonzero(np.signbit(covariance[1:]) != np.signbit(covariance[:-1]))  # lags before the zero crossings
    if covariance[0] <= 0.0 or k.size < _FEWEST_INTERVALS + 1:
        return NO_SWING
    intervals = np.diff(k + covariance[k] / (covariance[k] - covariance[k + 1]))[:10] * interval
    spread = float(intervals.std(ddof=1))
    regularity = float(intervals.mean()) / (3.0 * spread) if spread > 0.0 else np.inf
    period = 2.0 * float(intervals.mean())
    lag = min(round(period / interval), covariance.size - 1)
    samples = period / interval
    smooth_swing = running_mean(detrended, good, max(1, round(samples / SMOOTHINGS_PER_PERIOD)))
    sizes = _block_swings(smooth_swing, good, max(2, round(samples)))
    periodic_share, n_periods = float(covariance[lag] / covariance[0]), float(good.sum()) * interval / period
    return Swing(period, regularity, periodic_share, float(sizes.mean()) if sizes.size else np.nan, n_periods)


def _autocovariance(detrended: Array, good: Mask) -> Array:
    """Return the autocovariance of a series at each lag, from pairs of good samples, up to a lag with too few."""
    size = 1 << int(2 * detrended.size - 1).bit_length()
    transforms = (np.fft.rfft(series, size) for series in (detrended, good * 1.0))
    products, pair_counts = (np.fft.irfft(np.abs(s) ** 2, size)[: detrended.size] for s in transforms)
    is_enough = pair_counts > 0.1 * max(pair_counts[0], 1.0)
    n_lags = int(np.argmin(is_enough)) if not is_enough.all() else is_enough.size
    return np.asarray(products[:n_lags] / np.maximum(pair_counts[:n_lags], 1.0))


def _block_swings(series: Array, good: Mask, samples: int) -> Array:
    """Return the peak-to-peak swing in each block of so many ``samples``, where all of them are good."""
    n_blocks = series.size // samples
    blocks, is_good = (array[: n_blocks * samples].reshape(n_blocks, samples) for array in (series, good))
    return np.asarray(np.ptp(blocks[is_good.all(axis=1)], axis=1))


SETTLED_AFTER_S = 600.0  # after a change of the set-point; a command at an end for longer leaves the loop no control


def is_settled(T_set: Array, good: Mask, interval: float) -> Mask:
    """Whether the set-point has hardly moved for ten minutes with the plant on, (n,)."""
    width = max(1, round(SETTLED_AFTER_S / interval))
    if T_set.size <= width:
        return np.zeros(T_set.size, dtype=bool)
    windows = sliding_window_view(np.where(np.isfinite(T_set), T_set, np.inf), width + 1)
    with np.errstate(invalid="ignore"):
        is_steady = windows.max(axis=1) - windows.min(axis=1) < 0.3
    is_present = sliding_window_view(good, width + 1).mean(axis=1) > 0.5
    return np.concatenate([np.zeros(width, dtype=bool), is_steady & is_present]) & good


def is_in_control(command: Array, good: Mask, interval: float) -> Mask:
    """Whether the valve is in control: good samples, not at an end of the stroke for more than ten minutes, (n,)."""
    mask = good.copy()
    for first, last in true_runs(good & ((command <= 0.005) | (command >= 1.0 - 0.005))):
        if (last - first) * interval > SETTLED_AFTER_S:
            mask[first:last] = False
    return mask


COARSE_INTERVAL_S = 60.0  # between samples, beyond which a log misses the swings of most loops


class Measures(NamedTuple):
    """Measures of the loop in a log that need no model."""

    calm: Mask  # where the loop can be judged: the plant was on, in control and settled, (n,)
    swing: Swing  # of the control error there, K; of the temperature, if there is no set-point
    position: Array  # of the motor, (n,)
    command_swing: float  # median of highest less lowest command in a period
    indices: dict[str, float]
    why_blind: str  # why the log could not show a swing; empty if it could
    is_own: float = np.nan  # whether the loop makes its swings in 20 min itself, 0 or 1; NaN without air and water


def _judge_swings(grid: Grid, error: Array, calm: Mask) -> tuple[float, float]:
    """Median swing of the control error in 20 min, K, and whether the loop makes it, as ``Measures.is_own``."""
    minute = max(1, round(60.0 / grid.interval))

    def vary(series: Array) -> Array:  # means over a minute remove the noise, those over half an hour the load
        known = np.nan_to_num(forward_fill(series))
        return running_mean(known, calm, minute) - running_mean(known, calm, 30 * minute)

    swing, inputs = vary(error), [grid.values[name] for name in ("m_a", "T_a_in", "T_w_in") if name in grid.values]
    sizes = _block_swings(swing, calm, 20 * minute)
    size = float(np.median(sizes)) if sizes.size else np.nan
    if not sizes.size or len(inputs) < 3:
        return size, np.nan
    flow_gain = np.nanmedian(np.abs(inputs[1] - grid.values["T_sup"])) / np.nanmedian(inputs[0])  # K s/kg, at most
    causes = [gain * vary(series) for gain, series in zip((flow_gain, 1.0, 1.0), inputs, strict=True)]
    lagged = np.stack([np.roll(cause, k * minute)[calm] for cause in causes for k in range(4)], axis=1)  # of a coil
    rest, size_of_all = swing[calm] - lagged @ np.linalg.lstsq(lagged, swing[calm])[0], np.std(swing[calm])
    is_small = sum(np.std(cause[calm]) for cause in causes) < 0.5 * size_of_all  # a swing may fit whatever answers it
    return size, float(is_small or np.std(rest) > math.sqrt(OWN_SHARE) * size_of_all)


def measure_loop(grid: Grid, stroke_time: float) -> Measures:
    """Measure swing, errors, travel and reversals of the loop in a log; ``stroke_time``: of the motor, s."""
    T, command, interval = grid.values["T_sup"], grid.values["command"], grid.interval
    T_set = grid.values.get("T_set")
    error = T if T_set is None else T - T_set
    good = grid.on & np.isfinite(error) & np.isfinite(command)
    calm = is_in_control(command, good, interval)
    if T_set is not None:
        calm &= is_settled(T_set, good, interval)
    error = np.where(good, error, 0.0)
    swing = measure_swing(error, calm, interval)
    filled_command = np.where(np.isfinite(command), command, 0.0)
    positions = motor_positions(filled_command, interval, stroke_time)
    moves = np.diff(positions)[good]
    moves = moves[np.abs(moves) > 1e-9]
    days = float(good.sum()) * interval / SECONDS_PER_DAY or np.nan  # of operation
    strokes, reversals = float(np.abs(moves).sum()) / days, float(np.sum(moves[1:] * moves[:-1] < 0.0)) / days
    period = swing.period if np.isfinite(swing.period) else 600.0
    spans = _block_swings(filled_command, calm, max(2, round(period / interval)))
    command_swing = float(np.median(spans)) if spans.size else np.nan
    rms = [float(np.sqrt(np.mean(error[where] ** 2))) if where.any() else np.nan for where in (good, calm)]
    rms = [np.nan, np.nan] if T_set is None else rms
    block_swing, is_own = _judge_swings(grid, error, calm)
    indices = {
        "error_rms": rms[0], "error_rms_settled": rms[1], "peak_to_peak": swing.peak_to_peak, "period": swing.period,
        "block_swing": block_swing,
        "regularity": swing.regularity, "periodic_share": swing.periodic_share, "command_swing": command_swing,
        "motor_travel": strokes, "reversals": reversals,
    }  # fmt: skip
    return Measures(calm, swing, positions[:-1], command_swing, indices, _why_blind(grid, calm, swing), is_own)


def _why_blind(grid: Grid, calm: Mask, swing: Swing) -> str:
    """Return why a log could not show a swing of its loop, with the cure; empty if it could."""
    calm_time, longest_calm = float(calm.sum()) * grid.interval, longest_run(calm) * grid.interval
    reasons = {
        f"a sample every {grid.interval:.4g} s misses swings of minutes: log every 30 s or faster":
            grid.interval > COARSE_INTERVAL_S,
        f"the loop is settled, with the valve between its end stops, for only {calm_time / 60:.0f} min: log an hour or "
        "more of such operation at a constant set-point": calm_time < 3600.0,
        f"the log has no more than {longest_calm / 60:.0f} min in one piece: log without gaps, or bridge them, "
        "fc.read_log(..., max_gap=SECONDS)": longest_calm < 600.0,
        "the log has no set-point (T_set), and unlogged set-point changes may hide a swing: log T_set as well":
            "T_set" not in grid.values,
        "the swing is too irregular over the log as a whole: log every 10 s, with half an hour between set-point "
        "changes": swing.peak_to_peak > 0.5 and swing.regularity > LEAST_REGULARITY,
    }  # fmt: skip
    return next((reason for reason, holds in reasons.items() if holds), "")

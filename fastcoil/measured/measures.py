"""What a log shows of its loop before any model: how it swings, known indices, its motor; what every hour was like."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.grid import SECONDS_PER_DAY, Grid, forward_fill, motor_positions
from fastcoil.measured.part import true_runs

# when a swing counts as regular
LEAST_REGULARITY = 1.0  # regularity above this: Thornhill, Huang and Zhang, J. Process Control 13 (2003) 91
_LEAST_PERIODIC_SHARE, _LEAST_PERIODS = 0.5, 8  # of the variance, and seen so many times
LEAST_SWING_K = 0.1  # peak to peak below which a swing does not matter, K
_MEAN_WINDOWS_S, _LONGEST_PERIOD_PER_WINDOW = (600.0, 1800.0, 3600.0), 1.2
"""Seconds of the running means that take slower changes away; periods up to ``_LONGER`` of that are looked for."""
_LEAST_PERIODS_IN_RUN, _LEAST_CLEAR_PERIODS_IN_RUN, _CLEAR_PERIODIC_SHARE = 3, 2, 0.7
"""Periods in the longest unbroken stretch, at least; fewer will do where so large a share is periodic."""
_MOST_INTERVALS, _FEWEST_INTERVALS = 10, 4  # intervals between zero crossings of the autocovariance that are compared
_LEAST_PAIR_SHARE = 0.1  # share of the longest lag's pairs that must be there, against those of lag 0
SMOOTHINGS_PER_PERIOD = 12  # the mean over this part of the period takes the noise away before the swing is measured


class Swing(NamedTuple):
    """A swing of a series."""

    period: float  # s; NaN if none can be resolved
    regularity: float  # a third of the mean over the deviation of the intervals between zero crossings
    periodic_share: float  # of the variance that is periodic: the autocovariance one period away over that at 0
    peak_to_peak: float  # mean over the periods, in the unit of the series, noise smoothed
    periods: float  # how many whole ones the series has

    @property
    def is_regular(self) -> bool:
        """Whether it comes back again and again, and matters: what a technician calls hunting."""
        return (
            self.regularity > LEAST_REGULARITY
            and self.periodic_share > _LEAST_PERIODIC_SHARE
            and self.periods >= _LEAST_PERIODS
            and self.peak_to_peak > LEAST_SWING_K
        )


NO_SWING = Swing(np.nan, 0.0, 0.0, np.nan, 0.0)


def measure_swing(series: Array, good: Mask, interval: float) -> Swing:
    """How a series swings where it is ``good``, (n,) each; ``interval``: s from sample to sample.

    Thornhill, Huang and Zhang (2003): the zero crossings of the autocovariance come at half the period; they are
    regular if r = mean / (3 standard deviation) of the intervals between them exceeds 1.  Slower drifts are taken away
    before, by running means of several lengths; the most periodic of what is left counts.  The longest unbroken stretch
    must show three periods, or two clear ones.
    """
    longest = longest_run(good) * interval
    best = NO_SWING
    for seconds in _MEAN_WINDOWS_S:
        width = round(seconds / interval)
        if width < _FEWEST_INTERVALS or good.sum() < width:
            continue
        detrended = np.where(good, series - running_mean(series, good, width), 0.0)
        swing = _swing_from_autocovariance(detrended, good, interval)
        least_periods = _LEAST_CLEAR_PERIODS_IN_RUN if swing.periodic_share > _CLEAR_PERIODIC_SHARE else _LEAST_PERIODS_IN_RUN
        if (
            swing.period < min(_LONGEST_PERIOD_PER_WINDOW * seconds, longest / least_periods)
            and swing.periodic_share > best.periodic_share
        ):
            best = swing
    return best


def longest_run(good: Mask) -> int:
    """Samples of the longest unbroken stretch."""
    return int(np.max(np.diff(true_runs(good)), initial=0))


def _swing_from_autocovariance(detrended: Array, good: Mask, interval: float) -> Swing:
    covariance = _autocovariance(detrended, good)
    before_crossing = np.flatnonzero(np.signbit(covariance[1:]) != np.signbit(covariance[:-1]))
    if covariance[0] <= 0.0 or before_crossing.size < _FEWEST_INTERVALS + 1:
        return NO_SWING
    crossings = before_crossing + covariance[before_crossing] / (
        covariance[before_crossing] - covariance[before_crossing + 1]
    )
    intervals = np.diff(crossings)[:_MOST_INTERVALS] * interval
    spread = float(intervals.std(ddof=1))
    regularity = float(intervals.mean()) / (3.0 * spread) if spread > 0.0 else np.inf
    period = 2.0 * float(intervals.mean())
    lag = min(round(period / interval), covariance.size - 1)
    samples = period / interval
    smooth = running_mean(detrended, good, max(1, round(samples / SMOOTHINGS_PER_PERIOD)))  # of noise
    sizes = _block_swings(smooth, good, max(2, round(samples)))
    size = float(sizes.mean()) if sizes.size else np.nan
    share, periods = float(covariance[lag] / covariance[0]), float(good.sum()) * interval / period
    return Swing(period, regularity, share, size, periods)


def _autocovariance(detrended: Array, good: Mask) -> Array:
    """Mean product of good pairs at each lag, as far as there are enough of them."""
    size = 1 << int(2 * detrended.size - 1).bit_length()
    products, pairs = (
        np.fft.irfft(np.abs(np.fft.rfft(s, size)) ** 2, size)[: detrended.size] for s in (detrended, good * 1.0)
    )
    enough = pairs > _LEAST_PAIR_SHARE * max(pairs[0], 1.0)
    last = int(np.argmin(enough)) if not enough.all() else enough.size
    return np.asarray(products[:last] / np.maximum(pairs[:last], 1.0))


def _block_swings(series: Array, good: Mask, samples: int) -> Array:
    """Highest less lowest over so many samples in a row, where all are good."""
    n_blocks = series.size // samples
    blocks, is_good = (array[: n_blocks * samples].reshape(n_blocks, samples) for array in (series, good))
    return np.asarray(np.ptp(blocks[is_good.all(axis=1)], axis=1))


def running_mean(series: Array, good: Mask, width: int) -> Array:
    """Mean of the good samples among the ``width`` around each."""

    def total(values: Array) -> Array:
        summed = np.concatenate([[0.0], np.cumsum(values)])
        index = np.arange(values.size)
        low, high = np.maximum(index - width // 2, 0), np.minimum(index + (width + 1) // 2, values.size)
        return np.asarray(summed[high] - summed[low])

    return np.asarray(total(np.where(good, series, 0.0)) / np.maximum(total(good.astype(float)), 1.0))


SETTLED_AFTER_S = 600.0  # seconds after a change of the set-point from which the loop counts as settled
LEAST_SET_POINT_CHANGE_K = 0.3  # change of the set-point that counts, K, in one step or within that time
_END_TOLERANCE = 0.005  # a command so near to closed or open counts as that


def is_settled(T_set: Array, good: Mask, interval: float) -> Mask:
    """Where the set-point has hardly moved for a while, and the plant was on all that time, (n,)."""
    width = max(1, round(SETTLED_AFTER_S / interval))
    if T_set.size <= width:
        return np.zeros(T_set.size, dtype=bool)
    filled = np.where(np.isfinite(T_set), T_set, np.inf)
    windows = sliding_window_view(filled, width + 1)
    with np.errstate(invalid="ignore"):
        is_steady = windows.max(axis=1) - windows.min(axis=1) < LEAST_SET_POINT_CHANGE_K
    is_present = sliding_window_view(good, width + 1).mean(axis=1) > 0.5
    return np.concatenate([np.zeros(width, dtype=bool), is_steady & is_present]) & good


def is_in_control(command: Array, good: Mask, interval: float) -> Mask:
    """Where the valve was not closed or wide open for so long that the loop has no say, (n,)."""
    has_say = good.copy()
    for first, last in true_runs(good & ((command <= _END_TOLERANCE) | (command >= 1.0 - _END_TOLERANCE))):
        if (last - first) * interval > SETTLED_AFTER_S:
            has_say[first:last] = False
    return has_say


def daily_motor_travel(positions: Array, on: Mask, interval: float) -> tuple[float, float]:
    """Strokes and turns of the motor in a day of operation; ``positions``: (n + 1,), at the samples."""
    days = float(on.sum()) * interval / SECONDS_PER_DAY
    if days == 0.0:
        return np.nan, np.nan
    moves = np.diff(positions)[on]
    real_moves = moves[np.abs(moves) > 1e-9]
    return float(np.abs(real_moves).sum()) / days, float(np.sum(real_moves[1:] * real_moves[:-1] < 0.0)) / days


COARSE_INTERVAL_S = 60.0  # interval beyond which a log misses the swings of most loops, s
USUAL_PERIOD_S = 600.0  # s, where the temperature shows no swing
LEAST_CALM_TIME_S, LEAST_CALM_RUN_S = 3600.0, 600.0
"""Seconds of settled operation, and of its longest piece, after which a loop that does not swing may be called calm."""
WIDE_SWING_K = (
    0.5  # peak to peak of a swing above which no loop is called calm, K, although it does not come back regularly
)


class Measures(NamedTuple):
    """What a log shows of its loop."""

    calm: Mask  # where the plant was on, in control and settled, (n,)
    swing: Swing  # of the control error there, K; of the temperature, if there is no set-point
    position: Array  # of the motor, (n,)
    command_swing: float  # median of highest less lowest command in a period
    indices: dict[str, float]
    why_blind: str  # why the log could not show a swing; empty if it could


def measure_loop(grid: Grid, stroke_time: float) -> Measures:
    """Measure a log; ``stroke_time``: of the motor, s."""
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
    strokes, turns = daily_motor_travel(positions, good, interval)
    length = swing.period if np.isfinite(swing.period) else USUAL_PERIOD_S
    spans = _block_swings(filled_command, calm, max(2, round(length / interval)))
    command_swing = float(np.median(spans)) if spans.size else np.nan
    rms = [
        float(np.sqrt(np.mean(error[where] ** 2))) if T_set is not None and where.any() else np.nan
        for where in (good, calm)
    ]
    indices = {
        "error_rms": rms[0], "error_rms_settled": rms[1], "peak_to_peak": swing.peak_to_peak, "period": swing.period,
        "regularity": swing.regularity, "periodic_share": swing.periodic_share, "command_swing": command_swing,
        "motor_travel": strokes, "reversals": turns,
    }  # fmt: skip
    return Measures(calm, swing, positions[:-1], command_swing, indices, _why_blind(grid, calm, swing))


def _why_blind(grid: Grid, calm: Mask, swing: Swing) -> str:
    calm_time, longest_calm = float(calm.sum()) * grid.interval, longest_run(calm) * grid.interval
    reasons = {
        f"a sample every {grid.interval:.4g} s misses swings of minutes: log every 30 s or faster":
            grid.interval > COARSE_INTERVAL_S,
        f"the loop is settled, with the valve between its end stops, for only {calm_time / 60:.0f} min: log an hour or "
        "more of such operation at a constant set-point": calm_time < LEAST_CALM_TIME_S,
        f"the log has no more than {longest_calm / 60:.0f} min in one piece: log without gaps, or bridge them (max_gap)":
            longest_calm < LEAST_CALM_RUN_S,
        "the log has no set-point (T_set), and unlogged set-point changes may hide a swing: log T_set as well":
            "T_set" not in grid.values,
        "the swing is too irregular over the log as a whole: log every 10 s, with half an hour between set-point "
        "changes": swing.peak_to_peak > WIDE_SWING_K and swing.regularity > LEAST_REGULARITY,
    }  # fmt: skip
    return next((reason for reason, holds in reasons.items() if holds), "")


STATES = OFF, START_UP, NOT_RESPONDING, OPEN_NOT_MET, SHUT_NOT_MET, SWINGING, WIDE_OPEN, SHUT, OFF_SET_POINT, HOLDING, IN_CONTROL = (
    "off", "start-up", "not responding", "open, not met", "shut, not met", "swinging", "wide open", "shut",
    "off set-point", "holding", "in control",
)  # fmt: skip
"""Of an hour; where several apply, the first counts."""
MET_WITHIN_K, SWINGING_FROM_K = 1.0, 1.0
"""K off the set-point up to which a loop is in control, as air handlers are commissioned; K peak to peak from which it
swings: loads and mixing make up to ± 0.5 K."""
_AT_END_TOLERANCE, _LEAST_AT_END_S = 0.02, 600.0  # of the stroke; s, longer than a swing touches an end
_LONGEST_START_UP_S, _LEAST_PAUSE_S = 3600.0, 1800.0  # s that a start-up may last; that the plant was off before
_FULL_EFFECT_S = 1800.0  # s after which coil and duct have followed the valve
_NO_EFFECT_K, _LEAK_K, _STEADY_K = 1.0, 3.0, 0.5
"""K between entering and supply air: below the first an open coil has no water (fan heat, sensors); above the second a
shut one has some.  K between the halves of an hour: a duct that cools down or warms up changes by more."""
_LEAST_COMMAND_MOVE, _LEAST_COIL_GAIN, _LARGEST_STANDSTILL = 0.2, 2.0, 0.005
"""Of the stroke; K per stroke below which no coil answers a valve; of the stroke, up to which a command stands still
for an hour."""
_LEAST_SIGN_MOVES = 10  # of a command that show the sign of its controller
_MEAN_ERROR_WINDOW_S, _LEVEL_WINDOW_S, _LEVEL_SAMPLES = (
    600.0,
    3600.0,
    8,
)  # s of the mean error; s and samples of the level under a swing
_LEAST_CROSSINGS, _CROSSING_HYSTERESIS, _SAMPLES_PER_PERIOD, _LEAST_HOUR_SAMPLES, _SPREAD_PER_DEVIATION = (
    4,
    0.3,
    4,
    20,
    2.1,
)
"""Crossings of its level in three hours that make a swing, each by that many standard deviations; samples that resolve
a period, and that are enough to measure the size in the hour itself; standard deviation of half periods over the
median absolute one of whole periods."""
_HALF, _NEARLY_ALL, _FAR_FACTOR, _SECONDS_PER_HOUR = 0.5, 0.9, 1.5, 3600.0
_LEAST_FAULT_SHARE, _LEAST_OFF_SET_POINT_SHARE, _SUSPECT_LEAK_K = 0.15, 0.3, 5.0
"""Share of the hours of operation from which a fault is worth a line; of hours off the set-point, which a set-point
that moves makes as well; K off the set-point with the valve shut from which a leak is worth a look."""

HOURLY_VARIABLES: Mapping[str, tuple[str, str]] = {
    "enabled": ("1", "share of the hour in which the plant was on"),
    "in_control": ("1", f"share of the hour with the plant on and T_sup within {MET_WITHIN_K:g} K of the set-point"),
    "saturated": ("1", "share of the hour with the valve wide open or shut for more than 10 min"),
    "not_responding": ("1", "share of the hour in which T_sup does not answer the valve"),
    "command": ("1", "mean command, fraction of stroke"),
    "error": ("K", "mean of T_sup minus T_set"),
    "error_rms": ("K", "RMS of T_sup minus T_set"),
    "from_air": ("K", "mean of T_sup minus T_a_in"),
    "swing": ("K", "swing of the supply temperature, peak to peak"),
    "period": ("s", "median period of the swing; missing where the log does not resolve it"),
    "regularity": ("1", "period over three standard deviations of it, robust, after Thornhill: regular above 1"),
}
"""Unit and meaning of each number of an hour."""


class _LoopSeries(NamedTuple):
    """The log, sample by sample, (n,); temperatures are NaN where they are not logged."""

    T: Array
    command: Array
    error: Array
    from_air: Array  # T_sup - T_a_in
    swing: Array  # the error, or else the temperature, about its level; NaN where unsettled
    good: Mask  # plant on, command and temperature known
    starting: Mask
    open: Mask  # for a while
    shut: Mask
    not_responding: Mask  # open without an effect, or shut with one
    cools: float  # 1 of a cooling coil, -1 of a heating coil, 0 if the log does not show it


def hourly_summary(grid: Grid) -> xr.Dataset:
    """The state of every hour of a log, as far as it has samples, with numbers.

    Returns a Dataset along ``hour``, since the first sample (every further log of a list begins with a new one): the
    variables of ``VARIABLES``, shares from 0 to 1; ``state``, a word of ``STATES``; ``log_limits``, what the log of
    that hour cannot show, blank if nothing.
    """
    hour_of_sample, base = np.zeros(grid.on.size, dtype=np.int64), 0
    for first, end in zip(grid.starts, (*grid.starts[1:], grid.on.size), strict=True):
        hour_of_sample[first:end] = base + ((grid.time[first:end] - grid.time[first] + 1e-6) // _SECONDS_PER_HOUR)
        base = int(hour_of_sample[end - 1]) + 1
    hours, firsts = np.unique(hour_of_sample, return_index=True)
    loop_series = _prepare_series(grid)
    parts = [slice(*pair) for pair in zip(firsts, [*firsts[1:], hour_of_sample.size], strict=True)]
    numbers, states, limits = zip(*(_summarise_hour(loop_series, at, grid) for at in parts), strict=True)
    ds = xr.Dataset(coords={"hour": ("hour", hours, {"units": "h", "long_name": "hours since the first sample"})})
    for name, (unit, meaning) in HOURLY_VARIABLES.items():
        ds[name] = (
            "hour",
            [hour_numbers.get(name, np.nan) for hour_numbers in numbers],
            {"units": unit, "long_name": meaning},
        )
    ds["state"] = ("hour", list(states), {"long_name": "what the hour was like"})
    ds["log_limits"] = ("hour", list(limits), {"long_name": "what the log of the hour cannot show"})
    return ds.assign_attrs(interval=grid.interval, cools=loop_series.cools)


def _prepare_series(grid: Grid) -> _LoopSeries:
    interval, missing = grid.interval, np.full(grid.on.size, np.nan)
    T, T_set, T_air = (grid.values.get(name, missing) for name in ("T_sup", "T_set", "T_a_in"))
    good = grid.on & np.isfinite(T) & np.isfinite(grid.values["command"])
    command, error = forward_fill(grid.values["command"]), np.where(good, T - T_set, np.nan)
    is_starting, has_set = np.zeros(good.size, dtype=bool), bool(np.isfinite(error).any())
    for first, last in true_runs(good):
        before = np.flatnonzero(grid.on[:first])
        if grid.time[first] - grid.time[before[-1] if before.size else 0] >= _LEAST_PAUSE_S:
            end = min(last, first + round(_LONGEST_START_UP_S / interval))
            met = np.flatnonzero(np.abs(error[first:end]) <= MET_WITHIN_K)
            is_starting[first : first + int(met[0]) if met.size else end] = True
    calm = good & ~is_starting & (is_settled(T_set, good, interval) | (not has_set))
    swinging = np.where(calm, error if has_set else T, 0.0)
    width = max(round(_LEVEL_WINDOW_S / interval), _LEVEL_SAMPLES)
    level = running_mean(running_mean(swinging, calm, width), calm, width)  # twice: once lets swings of 40 min pass
    at_end = [good & (command >= 1.0 - _AT_END_TOLERANCE), good & (command <= _AT_END_TOLERANCE)]
    is_open, is_shut = (_is_lasting(at, interval, 0.0) for at in at_end)
    is_long_open, is_long_shut = (_is_lasting(at, interval, _FULL_EFFECT_S) for at in at_end)
    cools = _coil_sign(command, error)
    effect = cools * (T_air - T)  # K by which the coil cools, or heats
    mean = running_mean(np.where(good, T, 0.0), good, max(1, round(_MEAN_ERROR_WINDOW_S / interval)))
    steady = np.abs(mean - np.roll(mean, round(_FULL_EFFECT_S / interval))) < _STEADY_K
    is_silent = (is_long_open & (np.abs(error) > MET_WITHIN_K) & (effect < _NO_EFFECT_K)) | (
        is_long_shut & steady & (effect > _LEAK_K)
    )
    swing = np.where(calm, swinging - level, np.nan)
    return _LoopSeries(T, command, error, T - T_air, swing, good, is_starting, is_open, is_shut, is_silent, cools)


def _coil_sign(command: Array, error: Array) -> float:
    """1 of a cooling coil, whose integral opens the valve while the error is positive; -1 of a heating coil, or 0."""
    moves = np.diff(command)
    correlation = np.nansum(moves * (error[1:] + error[:-1]))
    at_ends = [np.nansum(error[command >= 1.0 - _AT_END_TOLERANCE]), -np.nansum(error[command <= _AT_END_TOLERANCE])]
    evidence = [correlation, *at_ends] if np.count_nonzero(moves) >= _LEAST_SIGN_MOVES else [*at_ends, correlation]
    return next((float(np.sign(value)) for value in evidence if value != 0.0), 0.0)


def _is_lasting(holds: Mask, interval: float, after: float) -> Mask:
    """The runs that last ten minutes and four samples, from ``after`` s after their begin, (n,)."""
    is_lasting = np.zeros(holds.size, dtype=bool)
    for first, last in true_runs(holds):
        if last - first >= _SAMPLES_PER_PERIOD and (last - first) * interval >= _LEAST_AT_END_S:
            is_lasting[first + round(after / interval) : last] = True
    return is_lasting


def _summarise_hour(loop_series: _LoopSeries, at: slice, grid: Grid) -> tuple[dict[str, float], str, str]:
    """Numbers and state of one hour, and what its log cannot show."""
    good, starting, on = loop_series.good[at], loop_series.starting[at], float(grid.on[at].mean())
    if on < _HALF or good.mean() < _HALF * on:
        return {"enabled": on}, OFF, ""
    is_used = good & ~starting if (good & ~starting).any() else good
    T, command, error, from_air = (series[at][is_used] for series in loop_series[:4])
    is_open, is_shut, silent = (
        float((mask[at] & is_used).mean()) for mask in (loop_series.open, loop_series.shut, loop_series.not_responding)
    )
    mean, rms = float(error.mean()), float(np.sqrt(np.mean(error**2)))
    command_range = float(np.ptp(command))
    temperature_fall = loop_series.cools * float(
        T[np.argmin(command)] - T[np.argmax(command)]
    )  # of T_sup, as the valve opens
    is_off_set_point = np.all(error > MET_WITHIN_K) or np.all(error < -MET_WITHIN_K)
    if is_off_set_point and command_range > _LEAST_COMMAND_MOVE and temperature_fall < _LEAST_COIL_GAIN * command_range:
        silent = 1.0
    swing, crossings = _measure_hour_swing(loop_series.swing, at, grid.interval)
    numbers = swing | {
        "enabled": on, "in_control": float(np.mean(np.abs(loop_series.error[at]) <= MET_WITHIN_K)), "saturated": is_open + is_shut,
        "not_responding": silent, "command": float(command.mean()), "error": mean, "error_rms": rms,
        "from_air": float(from_air.mean()),
    }  # fmt: skip
    applies = {
        START_UP: starting.mean() >= _HALF, NOT_RESPONDING: silent >= _HALF, OPEN_NOT_MET: is_open >= _HALF and abs(mean) > MET_WITHIN_K,
        SHUT_NOT_MET: is_shut >= _HALF and loop_series.cools * mean > MET_WITHIN_K,
        SWINGING: swing["swing"] >= SWINGING_FROM_K and crossings >= _LEAST_CROSSINGS and is_open + is_shut < _NEARLY_ALL,
        WIDE_OPEN: is_open >= _HALF and rms <= _FAR_FACTOR * MET_WITHIN_K, SHUT: is_shut >= _HALF,
        OFF_SET_POINT: abs(mean) > MET_WITHIN_K or rms > _FAR_FACTOR * MET_WITHIN_K, HOLDING: command.size >= _SAMPLES_PER_PERIOD and command_range < _LARGEST_STANDSTILL,
    }  # fmt: skip
    missing = 1.0 - float(np.isfinite(loop_series.T[at]).mean())
    limits = {
        f"{100 * missing:.0f} % of T_sup is missing": missing > 1.0 - _NEARLY_ALL,
        f"no swing faster than {_SAMPLES_PER_PERIOD * grid.interval / 60:.0f} min": grid.interval > COARSE_INTERVAL_S,
        "no error: T_set is not logged": np.isnan(loop_series.error).all(),
        "no swing: the set-point changes too often": np.isnan(swing["swing"]) and starting.mean() < _HALF,
    }
    state = next((state for state in STATES if applies.get(state)), IN_CONTROL)
    return numbers, state, "; ".join(limit for limit, holds in limits.items() if holds)


def _measure_hour_swing(swing: Array, at: slice, interval: float) -> tuple[dict[str, float], int]:
    """Size, period and regularity of the swing in an hour and those beside it; how often it crosses its level."""
    n_beside = max(round(_SECONDS_PER_HOUR / interval), _LEVEL_SAMPLES)
    in_hour, with_neighbours = swing[at], swing[max(at.start - n_beside, 0) : at.stop + n_beside]
    measured = in_hour if np.isfinite(in_hour).sum() >= _LEAST_HOUR_SAMPLES else with_neighbours
    if np.isfinite(measured).sum() < _SAMPLES_PER_PERIOD:
        return {"swing": np.nan}, 0
    size = float(2.0 * np.sqrt(2.0) * np.nanstd(measured))  # of a sine; sampled too rarely, it is the same
    beyond_hysteresis = np.flatnonzero(np.abs(with_neighbours) > _CROSSING_HYSTERESIS * np.nanstd(with_neighbours))
    crossed = beyond_hysteresis[1:][np.diff(np.sign(with_neighbours[beyond_hysteresis])) != 0.0]
    cycles = [c - a for a, c in zip(crossed, crossed[2:], strict=False) if np.isfinite(with_neighbours[a:c]).all()]
    period = float(np.median(cycles)) if cycles else 0.0  # samples
    if size < SWINGING_FROM_K or len(cycles) < _LEAST_CROSSINGS - 2 or period < _SAMPLES_PER_PERIOD:
        return {"swing": size}, crossed.size
    spread = max(_SPREAD_PER_DEVIATION * float(np.median(np.abs(cycles - np.array(period)))), 1.0 / 6.0)
    return {"swing": size, "period": period * interval, "regularity": period / 3.0 / spread}, crossed.size


def write_headline(triage: xr.Dataset) -> str:
    """What matters most in a log, and what to log again where that decides: two sentences at most."""
    operation = triage.isel(hour=triage["state"].values != OFF)
    hours, state, interval = operation["hour"].size, operation["state"].values, float(operation.attrs["interval"])
    if not hours:
        return "The plant is off throughout the log: log it in operation, or check the column enabled."
    findings, shut, calm = (
        write_warnings(triage)[:2],
        operation.isel(hour=state == SHUT),
        np.isin(state, (IN_CONTROL, HOLDING, WIDE_OPEN)),
    )
    if not findings and np.isnan(operation["error"]).all():
        findings = [f"{hours} h: no fault found; without T_set the control error is unknown"]
    elif not findings:
        rms = float(operation["error_rms"][calm].median())
        findings = [f"{calm.sum()} of {hours} h in control, error typically {rms:.2g} K (RMS)"] * bool(calm.any())
        n_shut = shut["hour"].size
        findings += [f"{n_shut} of {hours} h shut with no call for cooling or heating"] * bool(n_shut)
    leak_error = float(abs(shut["error"]).median()) if shut["hour"].size > _LEAST_FAULT_SHARE * hours else 0.0
    fastest = f"{_SAMPLES_PER_PERIOD * interval / 60:.0f} min"
    suggestions = [f"every 10 s for a day: every {interval:.0f} s shows no gap and no swing faster than {fastest}"]
    suggestions *= bool(interval > COARSE_INTERVAL_S)
    if leak_error > _SUSPECT_LEAK_K and np.isnan(shut["from_air"]).all():
        suggestions += [
            f"T_a_in to see whether the valve leaks: with the valve shut, T_sup is {leak_error:.2g} K off its set-point"
        ]
    return f"{'; '.join(findings) or f'{hours} h, too few to judge'}." + f" Log {'; log '.join(suggestions)}." * bool(
        suggestions
    )


def write_warnings(triage: xr.Dataset) -> list[str]:
    """A sentence on each fault that lasts for a share of the hours of operation, the worst first."""
    state, hours = triage["state"].values, int(np.sum(triage["state"].values != OFF))
    at_end, is_open = triage["saturated"].values >= _HALF, triage["command"].values > _HALF
    silent = state == NOT_RESPONDING
    is_fault = {OPEN_NOT_MET: (state == OPEN_NOT_MET) | (silent & at_end & is_open), SHUT: silent & at_end & ~is_open}
    is_fault |= {NOT_RESPONDING: silent & ~at_end} | {
        fault: state == fault for fault in (SHUT_NOT_MET, SWINGING, OFF_SET_POINT)
    }
    least_hours = {
        fault: (_LEAST_OFF_SET_POINT_SHARE if fault == OFF_SET_POINT else _LEAST_FAULT_SHARE) * hours
        for fault in is_fault
    }
    lasting = [(fault, at) for fault, at in is_fault.items() if at.sum() > least_hours[fault]]
    return [f"{at.sum()} of {hours} h: {_describe_fault(fault, triage.isel(hour=at))}" for fault, at in lasting]


def _describe_fault(fault: str, hours: xr.Dataset) -> str:
    """A fault in words: numbers are medians of the hours in which it occurs, ``hours``."""
    names = ("error", "error_rms", "from_air", "command", "swing", "period", "regularity")
    error, rms, air, command, swing, period, regularity = (float(hours[name].median()) for name in names)
    error_text = f"{abs(error):.2g} K {'above' if error > 0.0 else 'below'} the set-point"
    air_text = f"{abs(air):.2g} K {'above' if air > 0.0 else 'below'} the entering air"
    effect, largest = -hours.attrs["cools"] * air, float(hours["swing"].max())
    coil_text = "no water or a valve stuck shut" if effect < _LEAK_K else "no water, a stuck valve or too small a coil"
    coil_text = (
        "" if np.isnan(air) else f", {air_text}" if abs(air) > _STEADY_K else ", as warm as the entering air"
    ) + f": {coil_text}"
    coil_text += f", or something else {'heats' if air > 0.0 else 'cools'} the air" * (effect < -_LEAK_K)
    period_text = f"about every {f'{period:.0f} s' if period < 120.0 else f'{period / 60:.0f} min'}"
    period_text += " or faster" * (hours.attrs["interval"] > COARSE_INTERVAL_S) + ", unevenly" * (
        regularity < LEAST_REGULARITY
    )
    largest_text = f", up to ± {largest / 2:.2g} K," * (largest > _FAR_FACTOR * swing)
    unresolved = "too fast for this log to show the period"
    return {
        OPEN_NOT_MET: f"the valve is wide open and T_sup stays {error_text}{coil_text}",
        SHUT: f"the valve is shut and T_sup stays {air_text}: it leaks or is stuck open, or a sensor is wrong",
        NOT_RESPONDING: f"the command moves and T_sup stays {error_text}: a stuck valve, a loose linkage or no water",
        SHUT_NOT_MET: f"the command keeps the valve shut while T_sup is {error_text}: look for an interlock or wind-up",
        OFF_SET_POINT: f"T_sup is {rms:.2g} K (RMS) off, command at {100 * command:.0f} %: a slow loop, or one in manual",
        SWINGING: f"T_sup swings ± {swing / 2:.2g} K{largest_text} {period_text if np.isfinite(period) else unresolved}",
    }[fault]

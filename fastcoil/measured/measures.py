"""Measures of a log that need no model: its swing, indices of its loop and motor, and a state for every hour."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.grid import SECONDS_PER_DAY, Grid, forward_fill, motor_positions
from fastcoil.measured.part import true_runs

LEAST_REGULARITY = 1.0  # of a regular swing: Thornhill, Huang and Zhang, J. Process Control 13 (2003) 91
SMOOTHINGS_PER_PERIOD = 12  # means over this part of a period remove the noise before a swing is measured
_FEWEST_INTERVALS = 4  # between zero crossings of the autocovariance, to resolve a period


class Swing(NamedTuple):
    """A swing of a series."""

    period: float  # s; NaN if none can be resolved
    regularity: float  # a third of the mean over the deviation of the intervals between zero crossings
    periodic_share: float  # of the variance that is periodic: the autocovariance one period away over that at 0
    peak_to_peak: float  # mean over the periods, in the unit of the series, noise smoothed
    periods: float  # how many whole ones the series has

    @property
    def is_regular(self) -> bool:
        """Whether it repeats regularly and matters: what a technician calls hunting."""
        repeats = self.regularity > LEAST_REGULARITY and self.periodic_share > 0.5 and self.periods >= 8
        return repeats and self.peak_to_peak > 0.1  # K


NO_SWING = Swing(np.nan, 0.0, 0.0, np.nan, 0.0)


def measure_swing(series: Array, good: Mask, interval: float) -> Swing:
    """Measure how a series swings where it is ``good``, (n,) each; ``interval``: s between samples.

    Thornhill, Huang and Zhang (2003): the zero crossings of the autocovariance come at half the period; they are
    regular if r = mean / (3 standard deviations) of the intervals between them exceeds 1.  Running means of several
    lengths remove slower drifts; the most periodic remainder counts.  The longest run must show three periods, or two
    clear ones.
    """
    longest = longest_run(good) * interval
    best = NO_SWING
    for seconds in (600.0, 1800.0, 3600.0):
        width = round(seconds / interval)
        if width < _FEWEST_INTERVALS or good.sum() < width:
            continue
        detrended = np.where(good, series - running_mean(series, good, width), 0.0)
        swing = _swing_from_autocovariance(detrended, good, interval)
        longest_period = min(1.2 * seconds, longest / (2 if swing.periodic_share > 0.7 else 3))
        if swing.period < longest_period and swing.periodic_share > best.periodic_share:
            best = swing
    return best


def longest_run(good: Mask) -> int:
    """Number of samples of the longest unbroken run."""
    return int(np.max(np.diff(true_runs(good)), initial=0))


def _swing_from_autocovariance(detrended: Array, good: Mask, interval: float) -> Swing:
    covariance = _autocovariance(detrended, good)
    at = np.flatnonzero(np.signbit(covariance[1:]) != np.signbit(covariance[:-1]))
    if covariance[0] <= 0.0 or at.size < _FEWEST_INTERVALS + 1:
        return NO_SWING
    intervals = np.diff(at + covariance[at] / (covariance[at] - covariance[at + 1]))[:10] * interval
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
    """Mean product of good pairs at each lag, up to a lag with too few of them."""
    size = 1 << int(2 * detrended.size - 1).bit_length()
    transforms = (np.fft.rfft(series, size) for series in (detrended, good * 1.0))
    products, pairs = (np.fft.irfft(np.abs(s) ** 2, size)[: detrended.size] for s in transforms)
    enough = pairs > 0.1 * max(pairs[0], 1.0)
    last = int(np.argmin(enough)) if not enough.all() else enough.size
    return np.asarray(products[:last] / np.maximum(pairs[:last], 1.0))


def _block_swings(series: Array, good: Mask, samples: int) -> Array:
    """Peak to peak of each block of ``samples`` that are all good."""
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
    """Whether the valve is not shut or wide open for so long that the loop is out of control, (n,)."""
    is_in_control = good.copy()
    for first, last in true_runs(good & ((command <= 0.005) | (command >= 1.0 - 0.005))):
        if (last - first) * interval > SETTLED_AFTER_S:
            is_in_control[first:last] = False
    return is_in_control


COARSE_INTERVAL_S = 60.0  # beyond which a log misses the swings of most loops


class Measures(NamedTuple):
    """Measures of the loop of a log."""

    calm: Mask  # where the plant was on, in control and settled, (n,)
    swing: Swing  # of the control error there, K; of the temperature, if there is no set-point
    position: Array  # of the motor, (n,)
    command_swing: float  # median of highest less lowest command in a period
    indices: dict[str, float]
    why_blind: str  # why the log could not show a swing; empty if it could


def measure_loop(grid: Grid, stroke_time: float) -> Measures:
    """Measure the loop of a log; ``stroke_time``: of the motor, s."""
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
    indices = {
        "error_rms": rms[0], "error_rms_settled": rms[1], "peak_to_peak": swing.peak_to_peak, "period": swing.period,
        "regularity": swing.regularity, "periodic_share": swing.periodic_share, "command_swing": command_swing,
        "motor_travel": strokes, "reversals": reversals,
    }  # fmt: skip
    return Measures(calm, swing, positions[:-1], command_swing, indices, _why_blind(grid, calm, swing))


def _why_blind(grid: Grid, calm: Mask, swing: Swing) -> str:
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


OFF = "off"
START_UP = "start-up"
NOT_RESPONDING = "not responding"
OPEN_NOT_MET = "open, not met"
SHUT_NOT_MET = "shut, not met"
SWINGING = "swinging"
WIDE_OPEN = "wide open"
SHUT = "shut"
OFF_SET_POINT = "off set-point"
HOLDING = "holding"
IN_CONTROL = "in control"
STATES = (OFF, START_UP, NOT_RESPONDING, OPEN_NOT_MET, SHUT_NOT_MET, SWINGING, WIDE_OPEN, SHUT, OFF_SET_POINT, HOLDING,
          IN_CONTROL)  # fmt: skip
"""States of an hour; the first that applies wins."""
_MET_K = 1.0  # off the set-point, up to which a loop is in control, as air handlers are commissioned
_SWINGING_K = 1.0  # peak to peak: loads and mixing make up to ± 0.5 K
_AT_END = 0.02  # of the stroke, within which a valve is shut or wide open
_FULL_EFFECT_S = 1800.0  # after which coil and duct have followed the valve
_LEAK_K = 3.0  # between entering and supply air with the valve shut
_STEADY_K = 0.5  # between the halves of an hour: a duct that cools down or warms up changes by more
_SAMPLES_PER_PERIOD = 4  # that resolve a swing
_LEAST_CROSSINGS = 4  # of its level, in three hours, by a swing
_LEAST_FAULT_SHARE = 0.15  # of the hours of operation

HOURLY_VARIABLES: Mapping[str, tuple[str, str]] = {
    "enabled": ("1", "share of the hour in which the plant was on"),
    "in_control": ("1", f"share of the hour with the plant on and T_sup within {_MET_K:g} K of the set-point"),
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
    """A log sample by sample, (n,); temperatures are NaN where they are not logged."""

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
    """Summarise every hour of a log that has samples.

    Returns a Dataset along ``hour``, since the first sample (each further log of a list starts a new hour): the
    variables of ``HOURLY_VARIABLES``; ``state``, one of ``STATES``; ``log_limits``, what the log of that hour cannot
    show, or blank.
    """
    hour_of_sample, base = np.zeros(grid.on.size, dtype=np.int64), 0
    for first, end in zip(grid.starts, (*grid.starts[1:], grid.on.size), strict=True):
        hour_of_sample[first:end] = base + ((grid.time[first:end] - grid.time[first] + 1e-6) // 3600.0)
        base = int(hour_of_sample[end - 1]) + 1
    hours, firsts = np.unique(hour_of_sample, return_index=True)
    loop = _prepare_series(grid)
    parts = [slice(*pair) for pair in zip(firsts, [*firsts[1:], hour_of_sample.size], strict=True)]
    numbers, states, limits = zip(*(_summarise_hour(loop, at, grid) for at in parts), strict=True)
    ds = xr.Dataset(coords={"hour": ("hour", hours, {"units": "h", "long_name": "hours since the first sample"})})
    for name, (unit, meaning) in HOURLY_VARIABLES.items():
        values = [hour_numbers.get(name, np.nan) for hour_numbers in numbers]
        ds[name] = ("hour", values, {"units": unit, "long_name": meaning})
    ds["state"] = ("hour", list(states), {"long_name": "what the hour was like"})
    ds["log_limits"] = ("hour", list(limits), {"long_name": "what the log of the hour cannot show"})
    return ds.assign_attrs(interval=grid.interval, cools=loop.cools)


def _prepare_series(grid: Grid) -> _LoopSeries:
    interval, missing = grid.interval, np.full(grid.on.size, np.nan)
    T, T_set, T_air = (grid.values.get(name, missing) for name in ("T_sup", "T_set", "T_a_in"))
    good = grid.on & np.isfinite(T) & np.isfinite(grid.values["command"])
    command, error = forward_fill(grid.values["command"]), np.where(good, T - T_set, np.nan)
    is_starting, has_set = np.zeros(good.size, dtype=bool), bool(np.isfinite(error).any())
    for first, last in true_runs(good):
        before = np.flatnonzero(grid.on[:first])
        if grid.time[first] - grid.time[before[-1] if before.size else 0] >= 1800.0:
            end = min(last, first + round(3600.0 / interval))
            met = np.flatnonzero(np.abs(error[first:end]) <= _MET_K)
            is_starting[first : first + int(met[0]) if met.size else end] = True
    calm = good & ~is_starting & (is_settled(T_set, good, interval) | (not has_set))
    swinging = np.where(calm, error if has_set else T, 0.0)
    width = max(round(3600.0 / interval), 8)
    level = running_mean(running_mean(swinging, calm, width), calm, width)  # twice: once lets swings of 40 min pass
    at_end = [good & (command >= 1.0 - _AT_END), good & (command <= _AT_END)]
    is_open, is_shut = (_is_lasting(at, interval, 0.0) for at in at_end)
    is_long_open, is_long_shut = (_is_lasting(at, interval, _FULL_EFFECT_S) for at in at_end)
    cools = _coil_sign(command, error)
    effect = cools * (T_air - T)  # K by which the coil cools, or heats
    mean = running_mean(np.where(good, T, 0.0), good, max(1, round(600.0 / interval)))
    steady = np.abs(mean - np.roll(mean, round(_FULL_EFFECT_S / interval))) < _STEADY_K
    # an open coil without water still changes the air by up to 1 K: fan heat, sensors
    has_no_effect = is_long_open & (np.abs(error) > _MET_K) & (effect < 1.0)
    not_responding = has_no_effect | (is_long_shut & steady & (effect > _LEAK_K))
    swing = np.where(calm, swinging - level, np.nan)
    return _LoopSeries(T, command, error, T - T_air, swing, good, is_starting, is_open, is_shut, not_responding, cools)


def _coil_sign(command: Array, error: Array) -> float:
    """1 of a cooling coil, whose integral opens the valve while the error is positive; -1 of heating; 0 if unknown."""
    moves = np.diff(command)
    correlation = np.nansum(moves * (error[1:] + error[:-1]))
    at_ends = [np.nansum(error[command >= 1.0 - _AT_END]), -np.nansum(error[command <= _AT_END])]
    evidence = [correlation, *at_ends] if np.count_nonzero(moves) >= 10 else [*at_ends, correlation]
    return next((float(np.sign(value)) for value in evidence if value != 0.0), 0.0)


def _is_lasting(holds: Mask, interval: float, after: float) -> Mask:
    """Whether a sample is in a run of ten minutes and four samples, ``after`` s or more after its start, (n,)."""
    is_lasting = np.zeros(holds.size, dtype=bool)
    for first, last in true_runs(holds):
        if last - first >= _SAMPLES_PER_PERIOD and (last - first) * interval >= 600.0:
            is_lasting[first + round(after / interval) : last] = True
    return is_lasting


def _summarise_hour(loop: _LoopSeries, at: slice, grid: Grid) -> tuple[dict[str, float], str, str]:
    """Numbers and state of one hour, and what its log cannot show."""
    good, starting, on = loop.good[at], loop.starting[at], float(grid.on[at].mean())
    if on < 0.5 or good.mean() < 0.5 * on:
        return {"enabled": on}, OFF, ""
    is_used = good & ~starting if (good & ~starting).any() else good
    T, command, error, from_air = (series[at][is_used] for series in loop[:4])
    masks = (loop.open, loop.shut, loop.not_responding)
    is_open, is_shut, not_responding = (float((mask[at] & is_used).mean()) for mask in masks)
    mean, rms = float(error.mean()), float(np.sqrt(np.mean(error**2)))
    command_range = float(np.ptp(command))
    fall = loop.cools * float(T[np.argmin(command)] - T[np.argmax(command)])  # of T_sup, as the valve opens
    is_off_set_point = np.all(error > _MET_K) or np.all(error < -_MET_K)
    if is_off_set_point and command_range > 0.2 and fall < 2.0 * command_range:  # K per stroke: no coil
        not_responding = 1.0
    swing, crossings = _measure_hour_swing(loop.swing, at, grid.interval)
    numbers = swing | {
        "enabled": on, "in_control": float(np.mean(np.abs(loop.error[at]) <= _MET_K)), "saturated": is_open + is_shut,
        "not_responding": not_responding, "command": float(command.mean()), "error": mean, "error_rms": rms,
        "from_air": float(from_air.mean()),
    }  # fmt: skip
    applies = {
        START_UP: starting.mean() >= 0.5, NOT_RESPONDING: not_responding >= 0.5,
        OPEN_NOT_MET: is_open >= 0.5 and abs(mean) > _MET_K,
        SHUT_NOT_MET: is_shut >= 0.5 and loop.cools * mean > _MET_K,
        SWINGING: swing["swing"] >= _SWINGING_K and crossings >= _LEAST_CROSSINGS and is_open + is_shut < 0.9,
        WIDE_OPEN: is_open >= 0.5 and rms <= 1.5 * _MET_K, SHUT: is_shut >= 0.5,
        OFF_SET_POINT: abs(mean) > _MET_K or rms > 1.5 * _MET_K,
        HOLDING: command.size >= _SAMPLES_PER_PERIOD and command_range < 0.005,
    }  # fmt: skip
    missing = 1.0 - float(np.isfinite(loop.T[at]).mean())
    limits = {
        f"{100 * missing:.0f} % of T_sup is missing": missing > 1.0 - 0.9,
        f"no swing faster than {_SAMPLES_PER_PERIOD * grid.interval / 60:.0f} min": grid.interval > COARSE_INTERVAL_S,
        "no error: T_set is not logged": np.isnan(loop.error).all(),
        "no swing: the set-point changes too often": np.isnan(swing["swing"]) and starting.mean() < 0.5,
    }
    state = next((state for state in STATES if applies.get(state)), IN_CONTROL)
    return numbers, state, "; ".join(limit for limit, holds in limits.items() if holds)


def _measure_hour_swing(swing: Array, at: slice, interval: float) -> tuple[dict[str, float], int]:
    """Size, period and regularity of the swing in an hour and its neighbours; number of crossings of its level."""
    n_beside = max(round(3600.0 / interval), 8)
    in_hour, with_neighbours = swing[at], swing[max(at.start - n_beside, 0) : at.stop + n_beside]
    measured = in_hour if np.isfinite(in_hour).sum() >= 20 else with_neighbours
    if np.isfinite(measured).sum() < _SAMPLES_PER_PERIOD:
        return {"swing": np.nan}, 0
    size = float(2.0 * np.sqrt(2.0) * np.nanstd(measured))  # of a sine; sampled too rarely, it is the same
    beyond = np.flatnonzero(np.abs(with_neighbours) > 0.3 * np.nanstd(with_neighbours))  # of its hysteresis
    crossed = beyond[1:][np.diff(np.sign(with_neighbours[beyond])) != 0.0]
    cycles = [c - a for a, c in zip(crossed, crossed[2:], strict=False) if np.isfinite(with_neighbours[a:c]).all()]
    period = float(np.median(cycles)) if cycles else 0.0  # samples
    if size < _SWINGING_K or len(cycles) < _LEAST_CROSSINGS - 2 or period < _SAMPLES_PER_PERIOD:
        return {"swing": size}, crossed.size
    # standard deviation of half periods over the median absolute one of whole periods: 2.1
    spread = max(2.1 * float(np.median(np.abs(cycles - np.array(period)))), 1.0 / 6.0)
    return {"swing": size, "period": period * interval, "regularity": period / 3.0 / spread}, crossed.size


def write_headline(triage: xr.Dataset) -> str:
    """The most important finding of a log, and what to log again if that decides: two sentences at most."""
    operation = triage.isel(hour=triage["state"].values != OFF)
    hours, state, interval = operation["hour"].size, operation["state"].values, float(operation.attrs["interval"])
    if not hours:
        return "The plant is off throughout the log: log it in operation, or check the column enabled."
    findings, shut = write_warnings(triage)[:2], operation.isel(hour=state == SHUT)
    calm = np.isin(state, (IN_CONTROL, HOLDING, WIDE_OPEN))
    if not findings and np.isnan(operation["error"]).all():
        findings = [f"{hours} h: no fault found; without T_set the control error is unknown"]
    elif not findings:
        rms = float(operation["error_rms"][calm].median())
        findings = [f"{calm.sum()} of {hours} h in control, error typically {rms:.2g} K (RMS)"] * bool(calm.any())
        n_shut = shut["hour"].size
        findings += [f"{n_shut} of {hours} h shut with no call for cooling or heating"] * bool(n_shut)
    leak_error = float(abs(shut["error"]).median()) if shut["hour"].size > _LEAST_FAULT_SHARE * hours else 0.0
    fastest = f"{_SAMPLES_PER_PERIOD * interval / 60:.0f} min"
    advice = [f"every 10 s for a day: every {interval:.0f} s shows no gap and no swing faster than {fastest}"]
    advice *= bool(interval > COARSE_INTERVAL_S)
    if leak_error > 5.0 and np.isnan(shut["from_air"]).all():  # K
        off = f"{leak_error:.2g} K off its set-point"
        advice += [f"T_a_in to see whether the valve leaks: with the valve shut, T_sup is {off}"]
    return f"{'; '.join(findings) or f'{hours} h, too few to judge'}." + f" Log {'; log '.join(advice)}." * bool(advice)


def write_warnings(triage: xr.Dataset) -> list[str]:
    """A sentence on each fault that lasts for a share of the hours of operation, the worst first."""
    state, hours = triage["state"].values, int(np.sum(triage["state"].values != OFF))
    at_end, is_open = triage["saturated"].values >= 0.5, triage["command"].values > 0.5
    silent = state == NOT_RESPONDING
    is_fault = {OPEN_NOT_MET: (state == OPEN_NOT_MET) | (silent & at_end & is_open), SHUT: silent & at_end & ~is_open}
    is_fault |= {NOT_RESPONDING: silent & ~at_end}
    is_fault |= {fault: state == fault for fault in (SHUT_NOT_MET, SWINGING, OFF_SET_POINT)}
    # a set-point that moves makes hours off it as well
    lasting = [f for f, at in is_fault.items() if at.sum() > {OFF_SET_POINT: 0.3}.get(f, _LEAST_FAULT_SHARE) * hours]
    return [f"{is_fault[f].sum()} of {hours} h: {_describe_fault(f, triage.isel(hour=is_fault[f]))}" for f in lasting]


def _describe_fault(fault: str, hours: xr.Dataset) -> str:
    """Describe a fault by the medians of the ``hours`` in which it occurs."""
    names = ("error", "error_rms", "from_air", "command", "swing", "period", "regularity")
    error, rms, air, command, swing, period, regularity = (float(hours[name].median()) for name in names)
    error_text = f"{abs(error):.2g} K {'above' if error > 0.0 else 'below'} the set-point"
    air_text = f"{abs(air):.2g} K {'above' if air > 0.0 else 'below'} the entering air"
    effect, largest = -hours.attrs["cools"] * air, float(hours["swing"].max())
    coil_text = "no water or a valve stuck shut" if effect < _LEAK_K else "no water, a stuck valve or too small a coil"
    beside = f", {air_text}" if abs(air) > _STEADY_K else ", as warm as the entering air"
    coil_text = f"{'' if np.isnan(air) else beside}: {coil_text}"
    coil_text += f", or something else {'heats' if air > 0.0 else 'cools'} the air" * (effect < -_LEAK_K)
    period_text = f"about every {f'{period:.0f} s' if period < 120.0 else f'{period / 60:.0f} min'}"
    period_text += " or faster" * (hours.attrs["interval"] > COARSE_INTERVAL_S)
    period_text += ", unevenly" * (regularity < LEAST_REGULARITY)
    largest_text = f", up to ± {largest / 2:.2g} K," * (largest > 1.5 * swing)
    rhythm = period_text if np.isfinite(period) else "too fast for this log to show the period"
    manual = f"command at {100 * command:.0f} %: a slow loop, or one in manual"
    return {
        OPEN_NOT_MET: f"the valve is wide open and T_sup stays {error_text}{coil_text}",
        SHUT: f"the valve is shut and T_sup stays {air_text}: it leaks or is stuck open, or a sensor is wrong",
        NOT_RESPONDING: f"the command moves and T_sup stays {error_text}: a stuck valve, a loose linkage or no water",
        SHUT_NOT_MET: f"the command keeps the valve shut while T_sup is {error_text}: look for an interlock or wind-up",
        OFF_SET_POINT: f"T_sup is {rms:.2g} K (RMS) off, {manual}",
        SWINGING: f"T_sup swings ± {swing / 2:.2g} K{largest_text} {rhythm}",
    }[fault]

"""A log hour by hour, without a model: a state for every hour, faults that last, and the headline of a diagnosis."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.clock import describe_times
from fastcoil.measured.grid import Grid, forward_fill, running_mean
from fastcoil.measured.measures import COARSE_INTERVAL_S, LEAST_REGULARITY, is_settled
from fastcoil.measured.part import true_runs
from fastcoil.measured.swings import find_own_swings

STATE_OFF = "off"
STATE_START_UP = "start-up"
STATE_NOT_RESPONDING = "not responding"
STATE_OPEN_NOT_MET = "open, not met"
STATE_SHUT_NOT_MET = "shut, not met"
STATE_SWINGING = "swinging"
STATE_WIDE_OPEN = "wide open"
STATE_SHUT = "shut"
STATE_OFF_SET_POINT = "off set-point"
STATE_HOLDING = "holding"
STATE_IN_CONTROL = "in control"
STATES = (STATE_OFF, STATE_START_UP, STATE_NOT_RESPONDING, STATE_OPEN_NOT_MET, STATE_SHUT_NOT_MET, STATE_SWINGING,
          STATE_WIDE_OPEN, STATE_SHUT, STATE_OFF_SET_POINT, STATE_HOLDING, STATE_IN_CONTROL)  # fmt: skip
"""States of an hour; the first that applies wins."""
_MET_ERROR_K = 1.0  # control error up to which the set-point is met, as air handlers are commissioned
LEAST_SWING_K = 1.0  # peak to peak, of a loop that swings: loads and mixing make up to ± 0.5 K
_END_TOLERANCE = 0.02  # fraction of stroke, within which a valve is shut or wide open
_FULL_EFFECT_S = 1800.0  # time after which coil and duct have followed the valve
_LEAK_EFFECT_K = 3.0  # from entering to supply air with the valve shut, above which it leaks
_STEADY_CHANGE_K = 0.5  # between the halves of an hour: a duct that cools down or warms up changes by more
_SAMPLES_PER_PERIOD = 4  # fewest that resolve a swing
_LEAST_CROSSINGS = 4  # of its mean level, in three hours, by a swing that counts
_LEAST_FAULT_SHARE = 0.15  # share of the hours of operation from which a fault is reported

HOURLY_VARIABLES: Mapping[str, tuple[str, str]] = {
    "enabled": ("1", "share of the hour in which the plant was on"),
    "in_control": (
        "1",
        f"share of the hour with the plant on, calm, and T_sup within {_MET_ERROR_K:g} K of the set-point",
    ),
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
    own_swing: Array  # K, peak to peak, of a swing that the valve makes, on any set-point; NaN without one
    own_period: Array  # s, likewise
    good: Mask  # plant on, command and temperature known
    is_starting: Mask
    is_open: Mask  # for a while
    is_shut: Mask
    is_silent: Mask  # open without an effect, or shut with one
    cools: float  # 1 of a cooling coil, -1 of a heating coil, 0 if the log does not show it


def hourly_summary(grid: Grid, start: np.datetime64 | None = None) -> xr.Dataset:
    """Summarise every hour of a log that has samples; ``start``: time of its first sample, if it has a clock.

    Returns a Dataset along ``hour``, since the first sample (each further log of a list starts a new hour): the
    variables of ``HOURLY_VARIABLES``; ``state``, one of ``STATES``; ``log_limits``, what the log of that hour cannot
    show, or blank.
    """
    hour_of_sample, first_hour = np.zeros(grid.on.size, dtype=np.int64), 0
    for first, end in zip(grid.starts, (*grid.starts[1:], grid.on.size), strict=True):
        hour_of_sample[first:end] = first_hour + ((grid.time[first:end] - grid.time[first] + 1e-6) // 3600.0)
        first_hour = int(hour_of_sample[end - 1]) + 1
    hours, firsts = np.unique(hour_of_sample, return_index=True)
    loop = _prepare_series(grid)
    hour_slices = [slice(*pair) for pair in zip(firsts, [*firsts[1:], hour_of_sample.size], strict=True)]
    numbers, states, limits = zip(*(_summarise_hour(loop, hour, grid) for hour in hour_slices), strict=True)
    ds = xr.Dataset(coords={"hour": ("hour", hours, {"units": "h", "long_name": "hours since the first sample"})})
    for name, (unit, meaning) in HOURLY_VARIABLES.items():
        values = [hour_numbers.get(name, np.nan) for hour_numbers in numbers]
        ds[name] = ("hour", values, {"units": unit, "long_name": meaning})
    ds["state"] = ("hour", list(states), {"long_name": "what the hour was like"})
    ds["log_limits"] = ("hour", list(limits), {"long_name": "what the log of the hour cannot show"})
    swing_spans = [
        (float(grid.time[first]), float(grid.time[end - 1]))
        for first, end in true_runs(np.isfinite(loop.own_swing)).tolist()
    ]
    n_days = len(grid.day_slices())
    swing_times = describe_times(swing_spans, start if len(grid.starts) == 1 else None, n_days) if swing_spans else ""
    return ds.assign_attrs(interval=grid.interval, cools=loop.cools, swing_times=swing_times)


def _prepare_series(grid: Grid) -> _LoopSeries:
    interval, nan_series = grid.interval, np.full(grid.on.size, np.nan)
    T, T_set, T_air = (grid.values.get(name, nan_series) for name in ("T_sup", "T_set", "T_a_in"))
    good = grid.on & np.isfinite(T) & np.isfinite(grid.values["command"])
    command, error = forward_fill(grid.values["command"]), np.where(good, T - T_set, np.nan)
    is_starting, has_set = np.zeros(good.size, dtype=bool), bool(np.isfinite(error).any())
    for first, last in true_runs(good):
        on_before = np.flatnonzero(grid.on[:first])
        if grid.time[first] - grid.time[on_before[-1] if on_before.size else 0] >= 1800.0:
            end = min(last, first + round(3600.0 / interval))
            met_at = np.flatnonzero(np.abs(error[first:end]) <= _MET_ERROR_K)
            is_starting[first : first + int(met_at[0]) if met_at.size else end] = True
    is_calm = good & ~is_starting & (is_settled(T_set, good, interval) | (not has_set))
    deviation = np.where(is_calm, error if has_set else T, 0.0)
    width = max(round(3600.0 / interval), 8)
    # twice: once lets swings of 40 min pass
    level = running_mean(running_mean(deviation, is_calm, width), is_calm, width)
    is_at_ends = [good & (command >= 1.0 - _END_TOLERANCE), good & (command <= _END_TOLERANCE)]
    is_open, is_shut = (_is_lasting(is_at_end, interval, 0.0) for is_at_end in is_at_ends)
    is_long_open, is_long_shut = (_is_lasting(is_at_end, interval, _FULL_EFFECT_S) for is_at_end in is_at_ends)
    cools = _coil_sign(command, error)
    effect = cools * (T_air - T)  # K by which the coil cools, or heats
    mean = running_mean(np.where(good, T, 0.0), good, max(1, round(600.0 / interval)))
    is_steady = np.abs(mean - np.roll(mean, round(_FULL_EFFECT_S / interval))) < _STEADY_CHANGE_K
    # an open coil without water still changes the air by up to 1 K: fan heat, sensors
    has_no_effect = is_long_open & (np.abs(error) > _MET_ERROR_K) & (effect < 1.0)
    is_silent = has_no_effect | (is_long_shut & is_steady & (effect > _LEAK_EFFECT_K))
    swing = np.where(is_calm, deviation - level, np.nan)
    own_swing, own_period = nan_series.copy(), nan_series.copy()
    for window, _ in find_own_swings(T, grid.values.get("T_set"), command, good, interval):
        own_swing[window.first : window.end], own_period[window.first : window.end] = window.peak_to_peak, window.period
    masks = (good, is_starting, is_open, is_shut, is_silent)
    return _LoopSeries(T, command, error, T - T_air, swing, own_swing, own_period, *masks, cools)


def _coil_sign(command: Array, error: Array) -> float:
    """Return 1 for a cooling coil, whose command rises while the error is positive, -1 for heating, 0 if unknown."""
    moves = np.diff(command)
    correlation = np.nansum(moves * (error[1:] + error[:-1]))
    at_ends = [np.nansum(error[command >= 1.0 - _END_TOLERANCE]), -np.nansum(error[command <= _END_TOLERANCE])]
    evidence = [correlation, *at_ends] if np.count_nonzero(moves) >= 10 else [*at_ends, correlation]
    return next((float(np.sign(value)) for value in evidence if value != 0.0), 0.0)


def _is_lasting(mask: Mask, interval: float, after: float) -> Mask:
    """Whether a sample is in a run of True of ten minutes or more, ``after`` s or more after its start, (n,)."""
    is_lasting = np.zeros(mask.size, dtype=bool)
    for first, last in true_runs(mask):
        if last - first >= _SAMPLES_PER_PERIOD and (last - first) * interval >= 600.0:
            is_lasting[first + round(after / interval) : last] = True
    return is_lasting


def _summarise_hour(loop: _LoopSeries, hour: slice, grid: Grid) -> tuple[dict[str, float], str, str]:
    """Return the numbers of one hour by name, its state, and what the log of that hour cannot show."""
    good, is_starting, on_share = loop.good[hour], loop.is_starting[hour], float(grid.on[hour].mean())
    if on_share < 0.5 or good.mean() < 0.5 * on_share:
        return {"enabled": on_share}, STATE_OFF, ""
    is_used = good & ~is_starting if (good & ~is_starting).any() else good
    T, command, error, from_air = (series[hour][is_used] for series in loop[:4])
    masks = (loop.is_open, loop.is_shut, loop.is_silent)
    open_share, shut_share, silent_share = (float((mask[hour] & is_used).mean()) for mask in masks)
    mean_error, rms = float(error.mean()), float(np.sqrt(np.mean(error**2)))
    command_range = float(np.ptp(command))
    fall = loop.cools * float(T[np.argmin(command)] - T[np.argmax(command)])  # of T_sup, as the valve opens
    is_off_set_point = np.all(error > _MET_ERROR_K) or np.all(error < -_MET_ERROR_K)
    if is_off_set_point and command_range > 0.2 and fall < 2.0 * command_range:  # K per stroke: no coil
        silent_share = 1.0
    swing, n_crossings = _measure_hour_swing(loop.swing, hour, grid.interval)
    is_swinging = swing["swing"] >= LEAST_SWING_K and n_crossings >= _LEAST_CROSSINGS
    has_own_swing = np.isfinite(loop.own_swing[hour])
    if has_own_swing.mean() >= 0.5:
        is_swinging = True
        own = {"swing": loop.own_swing, "period": loop.own_period}
        swing |= {name: float(np.nanmedian(series[hour])) for name, series in own.items()}
    numbers = swing | {
        "enabled": on_share, "in_control": float(np.mean((np.abs(loop.error[hour]) <= _MET_ERROR_K) & ~has_own_swing)),
        "saturated": open_share + shut_share, "not_responding": silent_share, "command": float(command.mean()),
        "error": mean_error, "error_rms": rms, "from_air": float(from_air.mean()),
    }  # fmt: skip
    applies = {
        STATE_START_UP: is_starting.mean() >= 0.5, STATE_NOT_RESPONDING: silent_share >= 0.5,
        STATE_OPEN_NOT_MET: open_share >= 0.5 and abs(mean_error) > _MET_ERROR_K,
        STATE_SHUT_NOT_MET: shut_share >= 0.5 and loop.cools * mean_error > _MET_ERROR_K,
        STATE_SWINGING: is_swinging and open_share + shut_share < 0.9,
        STATE_WIDE_OPEN: open_share >= 0.5 and rms <= 1.5 * _MET_ERROR_K, STATE_SHUT: shut_share >= 0.5,
        STATE_OFF_SET_POINT: abs(mean_error) > _MET_ERROR_K or rms > 1.5 * _MET_ERROR_K,
        STATE_HOLDING: command.size >= _SAMPLES_PER_PERIOD and command_range < 0.005,
    }  # fmt: skip
    missing_share = 1.0 - float(np.isfinite(loop.T[hour]).mean())
    limits = {
        f"{100 * missing_share:.0f} % of T_sup is missing": missing_share > 1.0 - 0.9,
        f"no swing faster than {_SAMPLES_PER_PERIOD * grid.interval / 60:.0f} min": grid.interval > COARSE_INTERVAL_S,
        "no error: T_set is not logged": np.isnan(loop.error).all(),
        "no small swing: the set-point changes too often": np.isnan(swing["swing"]) and is_starting.mean() < 0.5,
    }
    state = next((state for state in STATES if applies.get(state)), STATE_IN_CONTROL)
    return numbers, state, "; ".join(limit for limit, holds in limits.items() if holds)


def _measure_hour_swing(swing: Array, hour: slice, interval: float) -> tuple[dict[str, float], int]:
    """Return size, period and regularity of an hour's swing by name, and how often it crosses its mean level."""
    n_beside = max(round(3600.0 / interval), 8)
    one_hour, three_hours = swing[hour], swing[max(hour.start - n_beside, 0) : hour.stop + n_beside]
    measured_swing = one_hour if np.isfinite(one_hour).sum() >= 20 else three_hours
    if np.isfinite(measured_swing).sum() < _SAMPLES_PER_PERIOD:
        return {"swing": np.nan}, 0
    size = float(2.0 * np.sqrt(2.0) * np.nanstd(measured_swing))  # of a sine; sampled too rarely, it is the same
    off_level = np.flatnonzero(np.abs(three_hours) > 0.3 * np.nanstd(three_hours))  # of its hysteresis
    crossings = off_level[1:][np.diff(np.sign(three_hours[off_level])) != 0.0]
    cycles = [c - a for a, c in zip(crossings, crossings[2:], strict=False) if np.isfinite(three_hours[a:c]).all()]
    period = float(np.median(cycles)) if cycles else 0.0  # samples
    if size < LEAST_SWING_K or len(cycles) < _LEAST_CROSSINGS - 2 or period < _SAMPLES_PER_PERIOD:
        return {"swing": size}, crossings.size
    # standard deviation of half periods over the median absolute one of whole periods: 2.1
    spread = max(2.1 * float(np.median(np.abs(cycles - np.array(period)))), 1.0 / 6.0)
    return {"swing": size, "period": period * interval, "regularity": period / 3.0 / spread}, crossings.size


def write_headline(triage: xr.Dataset) -> str:
    """Write the most important finding of a log, and what to log again if that decides, in two sentences at most."""
    operation = triage.isel(hour=triage["state"].values != STATE_OFF)
    n_hours, state, interval = operation["hour"].size, operation["state"].values, float(operation.attrs["interval"])
    if not n_hours:
        return "The plant is off throughout the log: log it in operation, or check the column enabled."
    findings, shut_hours = write_warnings(triage)[:2], operation.isel(hour=state == STATE_SHUT)
    is_calm = np.isin(state, (STATE_IN_CONTROL, STATE_HOLDING, STATE_WIDE_OPEN))
    if not findings and np.isnan(operation["error"]).all():
        findings = [f"{n_hours} h: no fault found; without T_set the control error is unknown"]
    elif not findings:
        rms = float(operation["error_rms"][is_calm].median())
        finding = f"{is_calm.sum()} of {n_hours} h in control, error typically {rms:.2g} K (RMS)"
        findings = [finding] * bool(is_calm.any())
        n_shut = shut_hours["hour"].size
        findings += [f"{n_shut} of {n_hours} h shut with no call for cooling or heating"] * bool(n_shut)
    is_often_shut = shut_hours["hour"].size > _LEAST_FAULT_SHARE * n_hours
    leak_error = float(abs(shut_hours["error"]).median()) if is_often_shut else 0.0
    fastest = f"{_SAMPLES_PER_PERIOD * interval / 60:.0f} min"
    advice = [f"every 10 s for a day: every {interval:.0f} s shows no gap and no swing faster than {fastest}"]
    advice *= bool(interval > COARSE_INTERVAL_S)
    if leak_error > 5.0 and np.isnan(shut_hours["from_air"]).all():  # K
        error_text = f"{leak_error:.2g} K off its set-point"
        advice += [f"T_a_in to see whether the valve leaks: with the valve shut, T_sup is {error_text}"]
    headline = "; ".join(findings) or f"{n_hours} h, too few to judge"
    return f"{headline}." + f" Log {'; log '.join(advice)}." * bool(advice)


def write_warnings(triage: xr.Dataset) -> list[str]:
    """Write a sentence on each fault that lasts for a share of the hours of operation, the worst first."""
    state, n_hours = triage["state"].values, int(np.sum(triage["state"].values != STATE_OFF))
    is_at_end, is_open = triage["saturated"].values >= 0.5, triage["command"].values > 0.5
    is_silent = state == STATE_NOT_RESPONDING
    is_fault = {STATE_OPEN_NOT_MET: (state == STATE_OPEN_NOT_MET) | (is_silent & is_at_end & is_open)}
    is_fault |= {STATE_SHUT: is_silent & is_at_end & ~is_open, STATE_NOT_RESPONDING: is_silent & ~is_at_end}
    is_fault |= {fault: state == fault for fault in (STATE_SHUT_NOT_MET, STATE_SWINGING, STATE_OFF_SET_POINT)}
    # a set-point that moves makes hours off it as well
    least = {STATE_OFF_SET_POINT: 0.3}
    # a fault counts against the hours in which it can show: days without a call do not hide it
    n_shut = int(np.sum((state == STATE_SHUT) | is_fault[STATE_SHUT]))
    n_called = n_hours - n_shut
    counted = {STATE_SHUT: (n_shut, "in which it was shut"), STATE_OFF_SET_POINT: (n_hours, "")}
    warnings = []
    for fault, mask in is_fault.items():
        n_counted, where = counted.get(fault, (n_called, "in which it was called"))
        if mask.sum() > least.get(fault, _LEAST_FAULT_SHARE) * n_counted:
            which = f" {where}" if where and n_counted < n_hours else ""
            description = _describe_fault(fault, triage.isel(hour=mask))
            warnings.append(f"{mask.sum()} of {n_counted} h{which}: {description}")
    return warnings


def _describe_fault(fault: str, hours: xr.Dataset) -> str:
    """Describe a fault by the medians of the ``hours`` in which it occurs."""
    names = ("error", "error_rms", "from_air", "command", "swing", "period", "regularity")
    error, rms, air, command, swing, period, regularity = (float(hours[name].median()) for name in names)
    error_text = f"{abs(error):.2g} K {'above' if error > 0.0 else 'below'} the set-point"
    air_text = f"{abs(air):.2g} K {'above' if air > 0.0 else 'below'} the entering air"
    effect, largest = -hours.attrs["cools"] * air, float(hours["swing"].max())
    is_small = effect < _LEAK_EFFECT_K
    coil_text = "no water or a valve stuck shut" if is_small else "no water, a stuck valve or too small a coil"
    beside = f", {air_text}" if abs(air) > _STEADY_CHANGE_K else ", as warm as the entering air"
    coil_text = f"{'' if np.isnan(air) else beside}: {coil_text}"
    coil_text += f", or something else {'heats' if air > 0.0 else 'cools'} the air" * (effect < -_LEAK_EFFECT_K)
    period_text = f"about every {f'{period:.0f} s' if period < 120.0 else f'{period / 60:.0f} min'}"
    period_text += " or faster" * (hours.attrs["interval"] > COARSE_INTERVAL_S)
    period_text += ", unevenly" * (regularity < LEAST_REGULARITY)
    largest_text = f", up to ± {largest / 2:.2g} K," * (largest > 1.5 * swing)
    rhythm = period_text if np.isfinite(period) else "too fast for this log to show the period"
    times_text = f", {hours.attrs['swing_times']}" if hours.attrs["swing_times"] else ""
    manual = f"command at {100 * command:.0f} %: a slow loop, or one in manual"
    return {
        STATE_OPEN_NOT_MET: f"the valve is wide open and T_sup stays {error_text}{coil_text}",
        STATE_SHUT: f"the valve is shut and T_sup stays {air_text}: it leaks or is stuck open, or a sensor is wrong",
        STATE_NOT_RESPONDING:
            f"the command moves and T_sup stays {error_text}: a stuck valve, a loose linkage or no water",
        STATE_SHUT_NOT_MET:
            f"the command keeps the valve shut while T_sup is {error_text}: look for an interlock or wind-up",
        STATE_OFF_SET_POINT: f"T_sup is {rms:.2g} K (RMS) off, {manual}",
        STATE_SWINGING: f"T_sup swings ± {swing / 2:.2g} K{largest_text} {rhythm}{times_text}",
    }[fault]  # fmt: skip

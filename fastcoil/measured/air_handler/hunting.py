"""Swings of an air handler: which valve makes them, or the set-point, or what comes from outside; and why."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.air_handler.finding import Finding, make_finding
from fastcoil.measured.air_handler.series import SHUT, SIGNS, WIDE_OPEN, AirHandlerSeries

from fastcoil.measured.swings import (  # isort: skip
    SwingWindow, describe_period, detrend, find_swings, judge_gains, moves_with, swing_within,
)  # fmt: skip

_LEAST_SET_POINT_SWING_K = 2.5  # peak to peak
_LONGEST_SET_POINT_HALF_CYCLE_S = 3600.0
_LEAST_OUTSIDE_SWING_K = 2.0
_SET_POINT_SHARE = 0.5  # of the swing of the supply air, from which it only follows its set-point
_OUTSIDE_SHARE = 0.5  # of the swing of the entering air over that of the supply air, from which it makes it
_BLOCK_S = 1800.0  # for which a loop swings or not, by its load
_LEAST_BLOCKS = 8  # at low load and at high load, to compare them
_LOW_LOAD_SHARE, _HIGH_LOAD_SHARE = 0.4, 0.1  # of blocks that swing at low load at least, at high load at most
_LEAST_EXPLAINED = 0.8  # of the command's swing by a PI, for its gains to count
_SAMPLES_PER_PERIOD = 8  # fewest, for these gains
_LARGE_KP = 0.22  # 1/K, more than any coil needs at a period of a few minutes
_SHUT_SHARE = 0.5  # of the cycles of a swing in which the valve shuts, from which it is too large for its load
_LARGEST_LOW_COMMAND = 0.35  # median command that counts as a low load
_LARGE_VALVE = 0.6  # fraction of stroke, never exceeded by a valve that is too large
_LARGE_VALVE_SHARE = 0.8  # of the days


def find_hunting(unit: AirHandlerSeries, faults: Sequence[Finding]) -> list[Finding]:
    """Find swings of the supply air and of its set-points."""
    findings = list(_find_swinging_set_points(unit))
    windows: dict[str, list[SwingWindow]] = {coil: [] for coil in unit.coils}
    outside: dict[str, list[SwingWindow]] = {"entering air": [], "water": []}
    for window in find_swings(unit.T_sup, unit.on, unit.interval):
        if culprit := blame_swing(unit, window):
            (windows if culprit in windows else outside)[culprit].append(window)
    passing = {fault.component.split()[0]: {*unit.day[unit.mask_of(fault.windows)].tolist()}
               for fault in faults if fault.kind in ("leak", "stuck_open")}  # fmt: skip
    for coil in unit.coils:
        fault_days = set().union(*(days for other, days in passing.items() if other != coil))
        beside = [window for window in windows[coil] if unit.day[window.first] in fault_days]
        for its_windows in (beside, [window for window in windows[coil] if window not in beside]):
            if its_windows:
                findings.append(_describe_hunting(unit, coil, its_windows, passing))
    for component, its_windows in outside.items():
        large = [window for window in its_windows if window.peak_to_peak >= _LEAST_OUTSIDE_SWING_K]
        if large:
            findings.append(_describe_outside(unit, component, large))
    return findings


def blame_swing(unit: AirHandlerSeries, window: SwingWindow) -> str:
    """Return what makes a swing: a coil, ``entering air`` or ``water``; blank where a set-point does."""

    def swing(series: Array) -> float:
        return swing_within(series, unit.on, unit.interval, window)

    swings = {coil: swing(unit.command(coil)) for coil in unit.coils}
    moving = {c: s for c, s in swings.items() if moves_with(unit.command(c), window, s, unit.interval)}
    if moving:
        coil = max(moving, key=lambda c: moving[c])
        return "" if swing(unit.T_set(coil)) >= _SET_POINT_SHARE * window.peak_to_peak else coil
    entering = max(swing(T) for T in unit.T_entering)
    return "entering air" if entering >= _OUTSIDE_SHARE * window.peak_to_peak else "water"


def _mask_of(unit: AirHandlerSeries, windows: Sequence[SwingWindow]) -> Mask:
    mask = np.zeros_like(unit.on)
    for window in windows:
        mask[window.first : window.end] = True
    return mask


def _medians(unit: AirHandlerSeries, windows: Sequence[SwingWindow]) -> tuple[float, float]:
    """Return amplitude, K, and period, s, of several windows, weighted by how long they are."""
    repeated = np.repeat([(w.peak_to_peak, w.period) for w in windows], [w.end - w.first for w in windows], axis=0)
    peak_to_peak, period = np.median(repeated, axis=0).tolist()
    return 0.5 * peak_to_peak, period


def _find_swinging_set_points(unit: AirHandlerSeries) -> Iterator[Finding]:
    for name in dict.fromkeys(["T_set", "T_set_cooling", "T_set_heating"]):
        T_set = unit.get(name)
        limits = (_LEAST_SET_POINT_SWING_K, _LONGEST_SET_POINT_HALF_CYCLE_S)
        if windows := find_swings(T_set, unit.on & np.isfinite(T_set), unit.interval, *limits):
            mask, (amplitude, period) = _mask_of(unit, windows), _medians(unit, windows)
            which = {"T_set_cooling": "for cooling ", "T_set_heating": "for heating "}.get(name, "")
            text = f"the set-point {which}itself swings ± {amplitude:.2g} K every {describe_period(period)}, {{when}}"
            cure = "lower its gain or raise its Ti"
            action = f"calm the loop or reset that writes the set-point, before the valve: {cure}"
            yield make_finding(unit, "set-point", "set_point_swings", mask, amplitude, text, action)


def _describe_hunting(
    unit: AirHandlerSeries, coil: str, windows: list[SwingWindow], passing: Mapping[str, set[int]]
) -> Finding:
    mask, (amplitude, period) = _mask_of(unit, windows), _medians(unit, windows)
    command = unit.command(coil)
    swings = [swing_within(command, unit.on, unit.interval, window) for window in windows]
    widest, level = float(np.median(swings)), float(np.median(command[mask]))
    text = f"hunts ± {amplitude:.2g} K every {describe_period(period)}, its command swings by {100 * widest:.0f} % "
    text += f"around {100 * level:.0f} %, for {unit.hours(mask):.1f} h, {{when}}"
    cause, action = _judge_cause(unit, coil, windows, swings, mask, passing)
    return make_finding(unit, f"{coil} valve", "hunt", mask, amplitude, text, action, cause=cause)


def _describe_outside(unit: AirHandlerSeries, component: str, windows: list[SwingWindow]) -> Finding:
    mask, (amplitude, period) = _mask_of(unit, windows), _medians(unit, windows)
    text = (
        f"supply air swings ± {amplitude:.2g} K every {describe_period(period)} while no valve moves with it, {{when}}"
    )
    action = {
        "entering air": "look for dampers or a loop before the coils that hunts",
        "water": "look for a chiller, boiler or pump that cycles",
    }[component]
    return make_finding(unit, component, "swings", mask, amplitude, text, action)


def _judge_cause(
    unit: AirHandlerSeries, coil: str, windows: list[SwingWindow], swings: list[float], mask: Mask,
    passing: Mapping[str, set[int]],
) -> tuple[str, str]:  # fmt: skip
    """Return the cause of hunting in a word, and what to do.

    swings: of the command in each window.  passing: days on which each valve passes water when shut.
    """
    for other, days in passing.items():
        if other != coil and np.isin(unit.day[mask], [*days]).mean() > 0.5:
            return "other_valve", f"repair the {other} valve first: it passes water while this one controls"
    amplitude, period = _medians(unit, windows)
    if load := _swings_at_low_load(unit, coil, windows, mask):
        return "load", f"lower kp at low load, or fit a smaller valve: {load}{_describe_large_valve(unit, coil)}"
    known = [gains for window in windows if (gains := recover_gains(unit, coil, window))]
    if known:
        kp, ti = (float(np.median(values)) for values in zip(*known, strict=True))
        gain_fault = judge_gains(kp, ti, period)
        return gain_fault.cause, gain_fault.action
    # |C| of a PI at the period is the swing of its command over that of its error, and no less than kp
    most_kp = float(np.median([swing / window.peak_to_peak for swing, window in zip(swings, windows, strict=True)]))
    if most_kp >= _LARGE_KP:
        seen = f"its command swings by {100 * float(np.median(swings)):.0f} % for ± {amplitude:.2g} K"
        return "gain", f"halve kp: {seen}, so kp is up to {most_kp:.1g} 1/K"
    cure = "halve kp, and see whether the swing ends"
    if unit.interval > 30.0:
        cure += "; log every 10 s for a day to tell the gap of the valve from the gains"
    return "unknown", cure


def recover_gains(unit: AirHandlerSeries, coil: str, window: SwingWindow) -> tuple[float, float] | None:
    """Recover kp, 1/K, and Ti, s, of the PI from its command and error in a swing; None where that is not clear.

    Of a PI the command less its level is kp (e + the integral of e over Ti): least squares over the window.
    """
    part = slice(window.first, window.end)
    command, error = unit.command(coil)[part], -SIGNS[coil] * (unit.T_sup - unit.T_set(coil))[part]
    good = unit.on[part] & np.isfinite(error) & (command > SHUT) & (command < WIDE_OPEN)
    if good.mean() < 0.6 or window.period < _SAMPLES_PER_PERIOD * unit.interval:
        return None
    e = np.where(np.isfinite(error), error, 0.0)
    centred = e - e[good].mean()
    integral = (np.cumsum(centred) - 0.5 * centred) * unit.interval  # trapezoids: half a sample decides on kp
    series = np.stack([detrend(x, good, unit.interval)[good] for x in (command, e, integral)])
    columns = series[1:].T
    (kp, ki), *_ = np.linalg.lstsq(columns, series[0])
    explained = 1.0 - float(np.var(series[0] - columns @ (kp, ki)) / np.var(series[0]))
    if explained < _LEAST_EXPLAINED or ki <= 0.0 or kp <= -0.3 * ki * window.period:
        return None
    kp = max(kp, 1e-4)  # less than a log shows
    return float(kp), float(kp / ki)


def _swings_at_low_load(unit: AirHandlerSeries, coil: str, windows: Sequence[SwingWindow], mask: Mask) -> str:
    """Describe that a loop swings at low load only, or around the shut valve; blank if it does not."""
    command, size = unit.command(coil), max(1, round(_BLOCK_S / unit.interval))
    n = command.size // size
    blocks = [series[: n * size].reshape(n, size) for series in (command, unit.on, mask)]
    level = blocks[0].mean(axis=1)
    is_used = blocks[1].all(axis=1) & (level > SHUT) & (level < WIDE_OPEN)
    does_swing, level = blocks[2].mean(axis=1)[is_used] > 0.5, level[is_used]
    sides = level < np.median(level), level >= np.median(level)
    if level.size and min(side.sum() for side in sides) >= _LEAST_BLOCKS:
        middle, (low, high) = float(np.median(level)), (100 * float(does_swing[side].mean()) for side in sides)
        if low >= 100 * _LOW_LOAD_SHARE and high <= 100 * _HIGH_LOAD_SHARE:
            where = f"below a command of {100 * middle:.0f} %, and in {high:.0f} % above"
            return f"it swings in {low:.0f} % of the half hours {where}, so the gain is too high there"
    shuts = [_share_of_cycles_shut(command[w.first : w.end], w.period / unit.interval) for w in windows]
    share, middle = float(np.median(shuts)), float(np.median(command[mask]))
    if share >= _SHUT_SHARE and middle <= _LARGEST_LOW_COMMAND:
        return f"the valve shuts in {100 * share:.0f} % of the cycles, so its least flow is too much for this load"
    return ""


def _share_of_cycles_shut(command: Array, samples: float) -> float:
    cycles = np.array_split(command, max(1, round(command.size / samples)))
    return float(np.mean([cycle.min() <= SHUT for cycle in cycles]))


def _describe_large_valve(unit: AirHandlerSeries, coil: str) -> str:
    """Describe that a valve never opens far, on most days, though it controls; blank where it does."""
    command = unit.command(coil)
    in_control = unit.on & (command > SHUT)
    largest = [float(np.quantile(command[rows], 0.99)) for day in unit.days
               if unit.hours(rows := in_control & (unit.day == day)) >= 1.0]  # fmt: skip
    n_small = sum(x < _LARGE_VALVE for x in largest)
    if len(largest) < 3 or n_small < _LARGE_VALVE_SHARE * len(largest):
        return ""
    return f", and the command stays below {100 * _LARGE_VALVE:.0f} % on {n_small} of {len(largest)} days"

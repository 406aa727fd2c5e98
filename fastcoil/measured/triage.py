"""What every hour of a log was like: off, in control, swinging, at an end of the valve, not responding, and so on."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.grid import Grid, held
from fastcoil.measured.measures import COARSE, REGULAR, running_mean, settled
from fastcoil.measured.part import runs

STATES = OFF, STARTING, SILENT, NOT_MET, LOCKED, SWINGS, OPEN, SHUT, ASTRAY, HOLDS, CONTROLS = (
    "off", "start-up", "not responding", "open, not met", "shut, not met", "swinging", "wide open", "shut",
    "off set-point", "holding", "in control",
)  # fmt: skip
"""Of an hour; where several apply, the first counts."""
MET, SWING = 1.0, 1.0
"""K off the set-point up to which a loop is in control, as air handlers are commissioned; K peak to peak from which it
swings: loads and mixing make up to ± 0.5 K."""
_AT_END, _AT_END_FOR = 0.02, 600.0  # of the stroke; s, longer than a swing touches an end
_START, _PAUSE = 3600.0, 1800.0  # s that a start-up may last; that the plant was off before
_FULL_EFFECT = 1800.0  # s after which coil and duct have followed the valve
_NO_EFFECT, _LEAK, _STEADY = 1.0, 3.0, 0.5
"""K between entering and supply air: below the first an open coil has no water (fan heat, sensors); above the second a
shut one has some.  K between the halves of an hour: a duct that cools down or warms up changes by more."""
_MOVES, _LEAST_GAIN, _STANDS = 0.2, 2.0, 0.005
"""Of the stroke; K per stroke below which no coil answers a valve; of the stroke, up to which a command stands still
for an hour."""
_AVERAGE, _LEVEL, _LEVEL_SAMPLES = 600.0, 3600.0, 8  # s of the mean error; s and samples of the level under a swing
_CROSSINGS, _HYSTERESIS, _PER_PERIOD, _FINE, _SPREAD = 4, 0.3, 4, 20, 2.1
"""Crossings of its level in three hours that make a swing, each by that many standard deviations; samples that resolve
a period, and that are enough to measure the size in the hour itself; standard deviation of half periods over the
median absolute one of whole periods."""
_HALF, _NEARLY_ALL, _FAR, _HOUR = 0.5, 0.9, 1.5, 3600.0
_WORTH = 0.15  # share of the hours of operation from which a fault is worth a line

VARIABLES: Mapping[str, tuple[str, str]] = {
    "enabled": ("1", "share of the hour in which the plant was on"),
    "in_control": ("1", f"share of the hour with the plant on and T_sup within {MET:g} K of the set-point"),
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


class _Seen(NamedTuple):
    """The log, sample by sample, (n,); temperatures in K or degC, NaN where they are not logged."""

    on: Mask
    T: Array
    command: Array
    error: Array
    mean_error: Array
    from_air: Array  # T_sup - T_a_in
    swing: Array  # the error, or else the temperature, about its level; NaN where unsettled
    good: Mask  # plant on, command and temperature known
    starting: Mask
    open: Mask  # for a while
    shut: Mask
    cools: float  # 1 of a cooling coil, -1 of a heating coil, 0 if the log does not show it
    interval: float  # s


def triage_of(grid: Grid) -> xr.Dataset:
    """The state of every hour of a log, as far as it has samples, with numbers.

    Returns a Dataset along ``hour``, since the first sample (every further log of a list begins with a new one): the
    variables of ``VARIABLES``, shares from 0 to 1; ``state``, a word of ``STATES``; ``log_limits``, what the log of
    that hour cannot show, blank if nothing.
    """
    seen, of_sample, base = _seen(grid), np.zeros(grid.on.size, dtype=np.int64), 0
    for first, end in zip(grid.starts, (*grid.starts[1:], grid.on.size), strict=True):
        of_sample[first:end] = base + ((grid.time[first:end] - grid.time[first] + 1e-6) // _HOUR)
        base = int(of_sample[end - 1]) + 1
    hours, firsts = np.unique(of_sample, return_index=True)
    rows = [_hour(seen, slice(*pair)) for pair in zip(firsts, [*firsts[1:], of_sample.size], strict=True)]
    ds = xr.Dataset(coords={"hour": ("hour", hours, {"units": "h", "long_name": "hours since the first sample"})})
    for name, (unit, meaning) in VARIABLES.items():
        ds[name] = (
            "hour",
            [numbers.get(name, np.nan) for numbers, _, _ in rows],
            {"units": unit, "long_name": meaning},
        )
    ds["state"] = ("hour", [state for _, state, _ in rows], {"long_name": "what the hour was like"})
    ds["log_limits"] = ("hour", [limit for _, _, limit in rows], {"long_name": "what the log of the hour cannot show"})
    return ds.assign_attrs(interval=grid.interval, cools=seen.cools)


def _seen(grid: Grid) -> _Seen:
    interval, missing = grid.interval, np.full(grid.on.size, np.nan)
    T, T_set, T_a = (grid.values.get(name, missing) for name in ("T_sup", "T_set", "T_a_in"))
    good = grid.on & np.isfinite(T) & np.isfinite(grid.values["command"])
    command, error = held(grid.values["command"]), np.where(good, T - T_set, np.nan)
    known = np.isfinite(error)
    is_open, is_shut = (_for_long(good & at, interval) for at in (command >= 1.0 - _AT_END, command <= _AT_END))
    mean_error = running_mean(np.nan_to_num(error), known, max(1, round(_AVERAGE / interval)))
    starting = np.zeros(good.size, dtype=bool)
    for first, last in runs(good):
        before = np.flatnonzero(grid.on[:first])
        if grid.time[first] - grid.time[before[-1] if before.size else 0] >= _PAUSE:
            end = min(last, first + round(_START / interval))
            met = np.flatnonzero(np.abs(error[first:end]) <= MET)
            starting[first : first + int(met[0]) if met.size else end] = True
    calm = good & ~starting & (settled(T_set, good, interval) if known.any() else True)
    about = np.where(calm, error if known.any() else T, 0.0)
    width = max(round(_LEVEL / interval), _LEVEL_SAMPLES)
    level = running_mean(running_mean(about, calm, width), calm, width)  # twice: once lets swings of 40 min pass
    both = known[1:] & known[:-1]
    # an integral opens a cooling valve while the error is positive
    moved = np.sum((np.diff(command) * (error[1:] + error[:-1]))[both])
    evidence = (moved, np.sum(error[is_open & known]), -np.sum(error[is_shut & known]))
    cools = next((float(np.sign(one)) for one in evidence if one != 0.0), 0.0)
    return _Seen(grid.on, T, command, error, np.where(known, mean_error, np.nan), T - T_a,
                 np.where(calm, about - level, np.nan), good, starting, is_open, is_shut, cools, interval)  # fmt: skip


def _for_long(at: Mask, interval: float) -> Mask:
    """The runs that last ten minutes and two samples, (n,)."""
    found = np.zeros(at.size, dtype=bool)
    for first, last in runs(at):
        found[first:last] = last - first >= 2 and (last - first) * interval >= _AT_END_FOR
    return found


def _hour(seen: _Seen, at: slice) -> tuple[dict[str, float], str, str]:
    """Numbers and state of one hour, and what its log cannot show."""
    good, starting = seen.good[at], seen.starting[at]
    numbers = {"enabled": float(seen.on[at].mean())}
    if min(numbers["enabled"], good.mean() / max(numbers["enabled"], 1e-9)) < _HALF:
        return numbers, OFF, ""
    here = good & ~starting if (good & ~starting).any() else good
    command, error = seen.command[at][here], seen.error[at][here]
    is_open, is_shut = (float((end[at] & here).mean()) for end in (seen.open, seen.shut))
    mean, rms = float(error.mean()), float(np.sqrt(np.mean(error**2)))
    swing, crossings = _swing(seen, at)
    numbers |= swing | {
        "in_control": float((np.abs(seen.error[at]) <= MET).mean()) if np.isfinite(mean) else np.nan,
        "saturated": is_open + is_shut, "not_responding": _not_responding(seen, at, here), "error": mean,
        "error_rms": rms, "command": float(command.mean()), "from_air": float(seen.from_air[at][here].mean()),
    }  # fmt: skip
    swings = numbers["swing"] >= SWING and crossings >= _CROSSINGS
    applies = {
        STARTING: starting.mean() >= _HALF,
        SILENT: numbers["not_responding"] >= _HALF,
        NOT_MET: is_open >= _HALF and abs(mean) > MET,
        LOCKED: is_shut >= _HALF and seen.cools * mean > MET,
        SWINGS: swings and numbers["saturated"] < _NEARLY_ALL,  # of a valve that moves
        OPEN: is_open >= _HALF,
        SHUT: is_shut >= _HALF,
        ASTRAY: abs(mean) > MET or rms > _FAR * MET,
        HOLDS: command.size >= _PER_PERIOD and np.ptp(command) < _STANDS,
    }
    missing = 1.0 - float(np.isfinite(seen.T[at]).mean())
    limits = {
        f"{100 * missing:.0f} % of T_sup is missing": missing > 1.0 - _NEARLY_ALL,
        f"no swing faster than {_PER_PERIOD * seen.interval / 60:.0f} min": seen.interval > COARSE,
        "no error: T_set is not logged": np.isnan(seen.error).all(),
        "no swing: the set-point changes too often": np.isnan(numbers["swing"]) and starting.mean() < _HALF,
    }
    said = "; ".join(limit for limit, holds in limits.items() if holds)
    return numbers, next((state for state in STATES if applies.get(state)), CONTROLS), said


def _not_responding(seen: _Seen, at: slice, here: Mask) -> float:
    """Share of the hour: open without an effect, shut with one, or moving without an answer."""
    command, T, error = seen.command[at][here], seen.T[at][here], seen.mean_error[at][here]
    if np.ptp(command) > _MOVES and np.all(np.abs(error) > MET) and np.ptp(np.sign(error)) == 0.0:
        low, high = int(np.argmin(command)), command.size - 1 - int(np.argmax(command[::-1]))
        if seen.cools * (T[low] - T[high]) < _LEAST_GAIN * np.ptp(command):
            return 1.0
    effect = -seen.cools * seen.from_air[at]  # K by which the coil cools, or heats
    before = np.maximum(np.arange(at.start, at.stop) - round(_FULL_EFFECT / seen.interval), 0)
    long_open, long_shut = (end[at] & end[before] for end in (seen.open, seen.shut))
    half = T.size // 2
    steady = half > 0 and abs(T[:half].mean() - T[half:].mean()) < _STEADY
    off = np.abs(seen.mean_error[at]) > MET
    silent = (long_open & off & (effect < _NO_EFFECT)) | (long_shut & steady & (effect > _LEAK))
    return float((here & silent).mean())


def _swing(seen: _Seen, at: slice) -> tuple[dict[str, float], int]:
    """Size, period and regularity of the swing in an hour and those beside it; how often it crosses its level."""
    beside = max(round(_HOUR / seen.interval), _LEVEL_SAMPLES)
    own, around = seen.swing[at], seen.swing[max(at.start - beside, 0) : at.stop + beside]
    measured = own if np.isfinite(own).sum() >= _FINE else around
    if np.isfinite(measured).sum() < _PER_PERIOD:
        return {"swing": np.nan}, 0
    size = float(2.0 * np.sqrt(2.0) * np.nanstd(measured))  # of a sine; sampled too rarely, it is the same
    beyond = np.flatnonzero(np.abs(around) > _HYSTERESIS * np.nanstd(around))
    crossed = beyond[1:][np.diff(np.sign(around[beyond])) != 0.0]
    cycles = [c - a for a, c in zip(crossed, crossed[2:], strict=False) if np.isfinite(around[a:c]).all()]
    period = float(np.median(cycles)) * seen.interval if cycles else np.nan
    if size < SWING or len(cycles) < _CROSSINGS - 2 or period < _PER_PERIOD * seen.interval:
        return {"swing": size}, crossed.size
    spread = _SPREAD * float(np.median(np.abs(np.array(cycles) * seen.interval - period)))
    return {
        "swing": size,
        "period": period,
        "regularity": period / 3.0 / max(spread, seen.interval / 6.0),
    }, crossed.size


def headline_of(triage: xr.Dataset) -> str:
    """What matters most in a log, and what to log again where that decides: two sentences at most."""
    on = triage.isel(hour=triage["state"].values != OFF)
    hours, state, interval = on["hour"].size, on["state"].values, float(on.attrs["interval"])
    if not hours:
        return "The plant is off in the whole log: log hours of operation, or check the column enabled."
    found, again = warnings_of(triage)[:2], ""
    shut, controlled = on.isel(hour=state == SHUT), on.isel(hour=np.isin(state, (CONTROLS, HOLDS, OPEN)))
    if np.isnan(on["error"]).all():
        found = found or [f"{hours} h: no fault shows; without T_set the error is not known"]
    if not found and controlled["hour"].size:
        rms = float(controlled["error_rms"].median())
        found.append(f"{controlled['hour'].size} of {hours} h in control, error typically {rms:.2g} K (RMS)")
    if len(found) < 2 and not warnings_of(triage) and shut["hour"].size:
        found.append(f"{shut['hour'].size} of {hours} h shut without a call")
    off = float(abs(shut["error"]).median()) if shut["hour"].size > _WORTH * hours else 0.0
    if interval > COARSE:
        again = f" Log every 10 s for a day: a sample every {interval:.0f} s shows no gap, and no swing faster than "
        again += f"{_PER_PERIOD * interval / 60:.0f} min."
    elif off > _LEAK and np.isnan(shut["from_air"]).all():
        again = f" Log T_a_in for a day to see whether the valve leaks: shut, it leaves T_sup {off:.2g} K off."
    return f"{'; '.join(found) or f'{hours} h, too few to judge'}.{again}"


def warnings_of(triage: xr.Dataset) -> list[str]:
    """A sentence on each fault that lasts for more than 15 % of the hours of operation, the worst first."""
    state, hours = triage["state"].values, int(np.sum(triage["state"].values != OFF))
    at_end = (state == SILENT) & (triage["saturated"].values >= _HALF)
    is_open = triage["command"].values > _HALF
    where = {
        NOT_MET: (state == NOT_MET) | (at_end & is_open), SHUT: at_end & ~is_open, SILENT: (state == SILENT) & ~at_end,
        **{fault: state == fault for fault in (LOCKED, SWINGS, ASTRAY)},
    }  # fmt: skip
    return [
        f"{at.sum()} of {hours} h: {_said(fault, triage.isel(hour=at))}"
        for fault, at in where.items()
        if at.sum() > _WORTH * hours
    ]


def _said(fault: str, here: xr.Dataset) -> str:
    """A fault in words: numbers are medians of the hours in which it occurs, ``here``."""
    typical = {name: float(here[name].median()) for name in VARIABLES}
    error, air, size, period = (typical[name] for name in ("error", "from_air", "swing", "period"))
    off, beside = (
        f"{abs(one):.2g} K {'above' if one > 0.0 else 'below'} the {other}"
        for one, other in ((error, "set-point"), (air, "entering air"))
    )
    effect, largest = -here.attrs["cools"] * air, float(here["swing"].max())
    coil = "a stuck valve or too small a coil" if not effect < _LEAK else "a valve stuck shut"
    other = f", or something else {'heats' if air > 0.0 else 'cools'} the air" if effect < -_LEAK else ""
    every = f"{period:.0f} s" if period < 120.0 else f"{period / 60:.0f} min"
    every = f"about every {every}{' or faster' * (here.attrs['interval'] > COARSE)}"
    sentences = {
        NOT_MET: f"the valve is wide open and T_sup stays {off}{f', {beside}' * bool(np.isfinite(air))}: no water, "
                 f"{coil}{other}",
        SHUT: f"the valve is shut and T_sup stays {beside}: it leaks or is stuck open, or a sensor is wrong",
        SILENT: f"the command moves and T_sup stays {off}: a stuck valve, a loose linkage or no water",
        LOCKED: f"the command keeps the valve shut while T_sup is {off}: look for an interlock or wind-up",
        ASTRAY: f"T_sup is {off} with the command at {100 * typical['command']:.0f} %: a slow loop, or one in hand",
        SWINGS: f"T_sup swings ± {size / 2:.2g} K{f', up to ± {largest / 2:.2g} K,' * (largest > _FAR * size)} "
                f"{every if np.isfinite(period) else 'too fast for this log to show the period'}"
                f"{', unevenly' * (typical['regularity'] < REGULAR)}",
    }  # fmt: skip
    return sentences[fault]

"""What a log shows of its loop before any model: how it swings, known indices, its motor; what every hour was like."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.grid import DAY, Grid, held, motor_positions
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
    share, periods = float(covariance[lag] / covariance[0]), float(good.sum()) * interval / period
    return Swing(period, regularity, share, size, periods)


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
    """Strokes and turns of the motor in a day of operation; ``positions``: (n + 1,), at the samples."""
    days = float(on.sum()) * interval / DAY
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
        f"the loop is settled, with the valve between its end stops, for only {watched / 60:.0f} min: log an hour or "
        "more of such operation at a constant set-point": watched < LEAST_WATCHED,
        f"the log has no more than {piece / 60:.0f} min in one piece: log without gaps, or bridge them (max_gap)":
            piece < LEAST_PIECE,
        "the log has no set-point (T_set), and unlogged set-point changes may hide a swing: log T_set as well":
            "T_set" not in grid.values,
        "the swing is too irregular over the log as a whole: log every 10 s, with half an hour between set-point "
        "changes": swing.peak_to_peak > WIDE and swing.regularity > REGULAR,
    }  # fmt: skip
    return next((reason for reason, holds in reasons.items() if holds), "")


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
_TELLING_MOVES = 10  # of a command that show the sign of its controller
_AVERAGE, _LEVEL, _LEVEL_SAMPLES = 600.0, 3600.0, 8  # s of the mean error; s and samples of the level under a swing
_CROSSINGS, _HYSTERESIS, _PER_PERIOD, _FINE, _SPREAD = 4, 0.3, 4, 20, 2.1
"""Crossings of its level in three hours that make a swing, each by that many standard deviations; samples that resolve
a period, and that are enough to measure the size in the hour itself; standard deviation of half periods over the
median absolute one of whole periods."""
_HALF, _NEARLY_ALL, _FAR, _HOUR = 0.5, 0.9, 1.5, 3600.0
_WORTH, _WORTH_ASTRAY, _DOUBTFUL = 0.15, 0.3, 5.0
"""Share of the hours of operation from which a fault is worth a line; of hours off the set-point, which a set-point
that moves makes as well; K off the set-point with the valve shut from which a leak is worth a look."""

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
    silent: Mask  # open without an effect, or shut with one
    cools: float  # 1 of a cooling coil, -1 of a heating coil, 0 if the log does not show it


def triage_of(grid: Grid) -> xr.Dataset:
    """The state of every hour of a log, as far as it has samples, with numbers.

    Returns a Dataset along ``hour``, since the first sample (every further log of a list begins with a new one): the
    variables of ``VARIABLES``, shares from 0 to 1; ``state``, a word of ``STATES``; ``log_limits``, what the log of
    that hour cannot show, blank if nothing.
    """
    of_sample, base = np.zeros(grid.on.size, dtype=np.int64), 0
    for first, end in zip(grid.starts, (*grid.starts[1:], grid.on.size), strict=True):
        of_sample[first:end] = base + ((grid.time[first:end] - grid.time[first] + 1e-6) // _HOUR)
        base = int(of_sample[end - 1]) + 1
    hours, firsts = np.unique(of_sample, return_index=True)
    seen = _seen(grid)
    parts = [slice(*pair) for pair in zip(firsts, [*firsts[1:], of_sample.size], strict=True)]
    numbers, states, limits = zip(*(_hour(seen, at, grid) for at in parts), strict=True)
    ds = xr.Dataset(coords={"hour": ("hour", hours, {"units": "h", "long_name": "hours since the first sample"})})
    for name, (unit, meaning) in VARIABLES.items():
        ds[name] = ("hour", [of.get(name, np.nan) for of in numbers], {"units": unit, "long_name": meaning})
    ds["state"] = ("hour", list(states), {"long_name": "what the hour was like"})
    ds["log_limits"] = ("hour", list(limits), {"long_name": "what the log of the hour cannot show"})
    return ds.assign_attrs(interval=grid.interval, cools=seen.cools)


def _seen(grid: Grid) -> _Seen:
    interval, missing = grid.interval, np.full(grid.on.size, np.nan)
    T, T_set, T_a = (grid.values.get(name, missing) for name in ("T_sup", "T_set", "T_a_in"))
    good = grid.on & np.isfinite(T) & np.isfinite(grid.values["command"])
    command, error = held(grid.values["command"]), np.where(good, T - T_set, np.nan)
    starting, has_set = np.zeros(good.size, dtype=bool), bool(np.isfinite(error).any())
    for first, last in runs(good):
        before = np.flatnonzero(grid.on[:first])
        if grid.time[first] - grid.time[before[-1] if before.size else 0] >= _PAUSE:
            end = min(last, first + round(_START / interval))
            met = np.flatnonzero(np.abs(error[first:end]) <= MET)
            starting[first : first + int(met[0]) if met.size else end] = True
    calm = good & ~starting & (settled(T_set, good, interval) | (not has_set))
    about = np.where(calm, error if has_set else T, 0.0)
    width = max(round(_LEVEL / interval), _LEVEL_SAMPLES)
    level = running_mean(running_mean(about, calm, width), calm, width)  # twice: once lets swings of 40 min pass
    at_end = [good & (command >= 1.0 - _AT_END), good & (command <= _AT_END)]
    is_open, is_shut = (_for_long(at, interval, 0.0) for at in at_end)
    long_open, long_shut = (_for_long(at, interval, _FULL_EFFECT) for at in at_end)
    cools = _cools(command, error)
    effect = cools * (T_a - T)  # K by which the coil cools, or heats
    mean = running_mean(np.where(good, T, 0.0), good, max(1, round(_AVERAGE / interval)))
    steady = np.abs(mean - np.roll(mean, round(_FULL_EFFECT / interval))) < _STEADY
    silent = (long_open & (np.abs(error) > MET) & (effect < _NO_EFFECT)) | (long_shut & steady & (effect > _LEAK))
    swing = np.where(calm, about - level, np.nan)
    return _Seen(T, command, error, T - T_a, swing, good, starting, is_open, is_shut, silent, cools)


def _cools(command: Array, error: Array) -> float:
    """1 of a cooling coil, whose integral opens the valve while the error is positive; -1 of a heating coil, or 0."""
    moves = np.diff(command)
    answer = np.nansum(moves * (error[1:] + error[:-1]))
    at_ends = [np.nansum(error[command >= 1.0 - _AT_END]), -np.nansum(error[command <= _AT_END])]
    evidence = [answer, *at_ends] if np.count_nonzero(moves) >= _TELLING_MOVES else [*at_ends, answer]
    return next((float(np.sign(one)) for one in evidence if one != 0.0), 0.0)


def _for_long(at: Mask, interval: float, after: float) -> Mask:
    """The runs that last ten minutes and four samples, from ``after`` s after their begin, (n,)."""
    found = np.zeros(at.size, dtype=bool)
    for first, last in runs(at):
        if last - first >= _PER_PERIOD and (last - first) * interval >= _AT_END_FOR:
            found[first + round(after / interval) : last] = True
    return found


def _hour(seen: _Seen, at: slice, grid: Grid) -> tuple[dict[str, float], str, str]:
    """Numbers and state of one hour, and what its log cannot show."""
    good, starting, on = seen.good[at], seen.starting[at], float(grid.on[at].mean())
    if on < _HALF or good.mean() < _HALF * on:
        return {"enabled": on}, OFF, ""
    here = good & ~starting if (good & ~starting).any() else good
    T, command, error, air = (series[at][here] for series in seen[:4])
    is_open, is_shut, silent = (float((mask[at] & here).mean()) for mask in (seen.open, seen.shut, seen.silent))
    mean, rms = float(error.mean()), float(np.sqrt(np.mean(error**2)))
    moved = float(np.ptp(command))
    fall = seen.cools * float(T[np.argmin(command)] - T[np.argmax(command)])  # of T_sup, as the valve opens
    stays = np.all(error > MET) or np.all(error < -MET)
    if stays and moved > _MOVES and fall < _LEAST_GAIN * moved:
        silent = 1.0
    swing, crossings = _swing(seen.swing, at, grid.interval)
    numbers = swing | {
        "enabled": on, "in_control": float(np.mean(np.abs(seen.error[at]) <= MET)), "saturated": is_open + is_shut,
        "not_responding": silent, "command": float(command.mean()), "error": mean, "error_rms": rms,
        "from_air": float(air.mean()),
    }  # fmt: skip
    applies = {
        STARTING: starting.mean() >= _HALF, SILENT: silent >= _HALF, NOT_MET: is_open >= _HALF and abs(mean) > MET,
        LOCKED: is_shut >= _HALF and seen.cools * mean > MET,
        SWINGS: swing["swing"] >= SWING and crossings >= _CROSSINGS and is_open + is_shut < _NEARLY_ALL,
        OPEN: is_open >= _HALF and rms <= _FAR * MET, SHUT: is_shut >= _HALF,
        ASTRAY: abs(mean) > MET or rms > _FAR * MET, HOLDS: command.size >= _PER_PERIOD and moved < _STANDS,
    }  # fmt: skip
    missing = 1.0 - float(np.isfinite(seen.T[at]).mean())
    limits = {
        f"{100 * missing:.0f} % of T_sup is missing": missing > 1.0 - _NEARLY_ALL,
        f"no swing faster than {_PER_PERIOD * grid.interval / 60:.0f} min": grid.interval > COARSE,
        "no error: T_set is not logged": np.isnan(seen.error).all(),
        "no swing: the set-point changes too often": np.isnan(swing["swing"]) and starting.mean() < _HALF,
    }
    state = next((state for state in STATES if applies.get(state)), CONTROLS)
    return numbers, state, "; ".join(limit for limit, holds in limits.items() if holds)


def _swing(swing: Array, at: slice, interval: float) -> tuple[dict[str, float], int]:
    """Size, period and regularity of the swing in an hour and those beside it; how often it crosses its level."""
    beside = max(round(_HOUR / interval), _LEVEL_SAMPLES)
    own, around = swing[at], swing[max(at.start - beside, 0) : at.stop + beside]
    measured = own if np.isfinite(own).sum() >= _FINE else around
    if np.isfinite(measured).sum() < _PER_PERIOD:
        return {"swing": np.nan}, 0
    size = float(2.0 * np.sqrt(2.0) * np.nanstd(measured))  # of a sine; sampled too rarely, it is the same
    beyond = np.flatnonzero(np.abs(around) > _HYSTERESIS * np.nanstd(around))
    crossed = beyond[1:][np.diff(np.sign(around[beyond])) != 0.0]
    cycles = [c - a for a, c in zip(crossed, crossed[2:], strict=False) if np.isfinite(around[a:c]).all()]
    period = float(np.median(cycles)) if cycles else 0.0  # samples
    if size < SWING or len(cycles) < _CROSSINGS - 2 or period < _PER_PERIOD:
        return {"swing": size}, crossed.size
    spread = max(_SPREAD * float(np.median(np.abs(cycles - np.array(period)))), 1.0 / 6.0)
    return {"swing": size, "period": period * interval, "regularity": period / 3.0 / spread}, crossed.size


def headline_of(triage: xr.Dataset) -> str:
    """What matters most in a log, and what to log again where that decides: two sentences at most."""
    on = triage.isel(hour=triage["state"].values != OFF)
    hours, state, interval = on["hour"].size, on["state"].values, float(on.attrs["interval"])
    if not hours:
        return "The plant is off throughout the log: log it in operation, or check the column enabled."
    found, shut, calm = warnings_of(triage)[:2], on.isel(hour=state == SHUT), np.isin(state, (CONTROLS, HOLDS, OPEN))
    if not found and np.isnan(on["error"]).all():
        found = [f"{hours} h: no fault found; without T_set the control error is unknown"]
    elif not found:
        rms = float(on["error_rms"][calm].median())
        found = [f"{calm.sum()} of {hours} h in control, error typically {rms:.2g} K (RMS)"] * bool(calm.any())
        n_shut = shut["hour"].size
        found += [f"{n_shut} of {hours} h shut with no call for cooling or heating"] * bool(n_shut)
    off = float(abs(shut["error"]).median()) if shut["hour"].size > _WORTH * hours else 0.0
    fastest = f"{_PER_PERIOD * interval / 60:.0f} min"
    again = [f"every 10 s for a day: every {interval:.0f} s shows no gap and no swing faster than {fastest}"]
    again *= bool(interval > COARSE)
    if off > _DOUBTFUL and np.isnan(shut["from_air"]).all():
        again += [f"T_a_in to see whether the valve leaks: with the valve shut, T_sup is {off:.2g} K off its set-point"]
    return f"{'; '.join(found) or f'{hours} h, too few to judge'}." + f" Log {'; log '.join(again)}." * bool(again)


def warnings_of(triage: xr.Dataset) -> list[str]:
    """A sentence on each fault that lasts for a share of the hours of operation, the worst first."""
    state, hours = triage["state"].values, int(np.sum(triage["state"].values != OFF))
    at_end, is_open = triage["saturated"].values >= _HALF, triage["command"].values > _HALF
    silent = state == SILENT
    where = {NOT_MET: (state == NOT_MET) | (silent & at_end & is_open), SHUT: silent & at_end & ~is_open}
    where |= {SILENT: silent & ~at_end} | {fault: state == fault for fault in (LOCKED, SWINGS, ASTRAY)}
    least = {fault: (_WORTH_ASTRAY if fault == ASTRAY else _WORTH) * hours for fault in where}
    lasting = [(fault, at) for fault, at in where.items() if at.sum() > least[fault]]
    return [f"{at.sum()} of {hours} h: {_said(fault, triage.isel(hour=at))}" for fault, at in lasting]


def _said(fault: str, here: xr.Dataset) -> str:
    """A fault in words: numbers are medians of the hours in which it occurs, ``here``."""
    names = ("error", "error_rms", "from_air", "command", "swing", "period", "regularity")
    error, rms, air, command, swing, period, regularity = (float(here[name].median()) for name in names)
    off = f"{abs(error):.2g} K {'above' if error > 0.0 else 'below'} the set-point"
    beside = f"{abs(air):.2g} K {'above' if air > 0.0 else 'below'} the entering air"
    effect, largest = -here.attrs["cools"] * air, float(here["swing"].max())
    coil = "no water or a valve stuck shut" if effect < _LEAK else "no water, a stuck valve or too small a coil"
    coil = (
        "" if np.isnan(air) else f", {beside}" if abs(air) > _STEADY else ", as warm as the entering air"
    ) + f": {coil}"
    coil += f", or something else {'heats' if air > 0.0 else 'cools'} the air" * (effect < -_LEAK)
    every = f"about every {f'{period:.0f} s' if period < 120.0 else f'{period / 60:.0f} min'}"
    every += " or faster" * (here.attrs["interval"] > COARSE) + ", unevenly" * (regularity < REGULAR)
    up_to = f", up to ± {largest / 2:.2g} K," * (largest > _FAR * swing)
    unresolved = "too fast for this log to show the period"
    return {
        NOT_MET: f"the valve is wide open and T_sup stays {off}{coil}",
        SHUT: f"the valve is shut and T_sup stays {beside}: it leaks or is stuck open, or a sensor is wrong",
        SILENT: f"the command moves and T_sup stays {off}: a stuck valve, a loose linkage or no water",
        LOCKED: f"the command keeps the valve shut while T_sup is {off}: look for an interlock or wind-up",
        ASTRAY: f"T_sup is {rms:.2g} K (RMS) off, command at {100 * command:.0f} %: a slow loop, or one in manual",
        SWINGS: f"T_sup swings ± {swing / 2:.2g} K{up_to} {every if np.isfinite(period) else unresolved}",
    }[fault]

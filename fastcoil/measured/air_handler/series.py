"""An air handler sample by sample: temperatures, commands and set-points by coil, and what the coils do to the air."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs.air_handler import COILS
from fastcoil.measured.clock import Span, seconds_of_day
from fastcoil.measured.grid import SECONDS_PER_DAY, Grid, forward_fill, running_mean
from fastcoil.measured.part import true_runs

SIGNS = {"cooling": -1.0, "heating": 1.0, "preheat": 1.0}  # of the change of the air's temperature by a coil
SHUT, WIDE_OPEN = 0.02, 0.98  # command, fraction of stroke
MET_ERROR_K = 1.0  # control error up to which a set-point is met, as air handlers are commissioned
EFFECT_AFTER_S = 1800.0  # time after which coil and duct have followed the valve
EFFECT_AFTER_LOW_FLOW_S = 3 * 3600.0  # the same at a low air flow
_SMOOTHING_S = 900.0  # of the change of the air's temperature
_LOW_FLOW = 0.4  # of the usual air flow, below which ducts and places of sensors count
_LEAST_BASELINE_DAYS = 4  # that show the offset of the sensors
_LEAST_BASELINE_S = 3600.0  # a day with the valve shut
_PLAUSIBLE_K = 1.5  # by which a sensor of mixed air may be off
_PLAUSIBLE_SHARE = 0.1  # of the time of operation, in which it shows return or outdoor air
_LARGEST_OFFSET_SPREAD_K = 0.35  # half of the middle half of such days


@dataclass(frozen=True)
class AirHandlerSeries:
    """A log of an air handler at equal intervals, (n,) each; NaN where missing."""

    name: str
    grid: Grid
    start: np.datetime64 | None  # of the first sample; None where the log has no clock

    @property
    def interval(self) -> float:
        return self.grid.interval

    def get(self, name: str) -> Array:
        """Return a series of the log; NaN without it."""
        return self.grid.values.get(name, np.full(self.grid.on.size, np.nan))

    @property
    def coils(self) -> list[str]:
        return [coil for coil in COILS if f"{coil}_command" in self.grid.values]

    @property
    def T_sup(self) -> Array:
        return self.get("T_sup")

    def command(self, coil: str) -> Array:
        return forward_fill(self.get(f"{coil}_command"))

    def T_set(self, coil: str) -> Array:
        """Return the set-point of a coil: its own, or the common one."""
        own = f"T_set_{'heating' if coil == 'preheat' else coil}"
        return self.get(own if own in self.grid.values else "T_set")

    @cached_property
    def T_entering(self) -> tuple[Array, Array]:
        """Lowest and highest temperature of the entering air: as measured, else those of return and outdoor air."""
        measured = next((self.get(name) for name in ("T_mixed", "T_a_in") if name in self.grid.values), None)
        if measured is not None:
            return measured, measured
        return self.outdoor_and_return

    @cached_property
    def outdoor_and_return(self) -> tuple[Array, Array]:
        """The colder and the warmer of outdoor and return air; NaN where one of them is not logged."""
        both = np.stack([self.get("T_return"), self.get("T_out")])
        return both.min(axis=0), both.max(axis=0)

    @cached_property
    def is_entering_plausible(self) -> Mask:
        """Whether supply air shows that a coil works without relying on the sensor of mixed air alone, (n,).

        It does where it is outside the range of return and outdoor air.  Elsewhere the sensor has to be one that shows
        either of them at times, as dampers open and close; without both of these there is nothing to compare with.
        """
        low, high = self.outdoor_and_return
        T, known = self.T_entering[0], self.on & np.isfinite(low + self.T_entering[0])
        if not known.any() or not self.is_entering_measured:
            return np.ones(self.on.size, dtype=bool)
        is_near = (np.abs(T - low) < _PLAUSIBLE_K) | (np.abs(T - high) < _PLAUSIBLE_K)
        if np.mean(is_near[known]) >= _PLAUSIBLE_SHARE:
            return np.ones(self.on.size, dtype=bool)
        with np.errstate(invalid="ignore"):
            return (self.T_sup < low - _PLAUSIBLE_K) | (self.T_sup > high + _PLAUSIBLE_K)

    def without(self, masks: Mapping[str, Mask]) -> AirHandlerSeries:
        """Return the series with some values removed, by name."""
        values = {name: np.where(masks.get(name, False), np.nan, v) for name, v in self.grid.values.items()}
        return replace(self, grid=self.grid._replace(values=values)) if masks else self

    @property
    def is_entering_measured(self) -> bool:
        return self.T_entering[0] is self.T_entering[1]

    @cached_property
    def on(self) -> Mask:
        return self.grid.on & np.isfinite(self.T_sup)

    @cached_property
    def day(self) -> Index:
        """Number of the calendar day of each sample, or of 24 h where the log has no clock."""
        return ((self.grid.time + seconds_of_day(self.start)) // SECONDS_PER_DAY).astype(np.int64)

    @cached_property
    def days(self) -> Index:
        """Numbers of the days with an hour of operation or more."""
        numbers, counts = np.unique(self.day[self.on], return_counts=True)
        return numbers[counts * self.interval >= 3600.0]

    @cached_property
    def has_low_flow(self) -> Mask:
        """Whether the air flow is far below the usual one; nowhere if it is not logged."""
        flow = next((self.get(name) for name in ("m_a", "fan_speed") if name in self.grid.values), None)
        if flow is None or not np.isfinite(flow[self.on]).any():
            return np.zeros(self.on.size, dtype=bool)
        return np.nan_to_num(flow) < _LOW_FLOW * float(np.nanquantile(flow[self.on], 0.95))

    def effect(self, coil: str) -> Array:
        """Return by how much the air leaves warmer (cooling: colder) than it enters, smoothed, K, (n,)."""
        low, high = self.T_entering
        effect = low - self.T_sup if SIGNS[coil] < 0.0 else self.T_sup - high
        good = self.on & np.isfinite(effect)
        smooth = running_mean(np.where(good, effect, 0.0), good, max(1, round(_SMOOTHING_S / self.interval)))
        return np.where(good, smooth, np.nan)

    def shortfall(self, coil: str) -> Array:
        """Return by how much the air leaves less warm (cooling: less cold) than the set-point asks, K, (n,)."""
        return SIGNS[coil] * (self.T_set(coil) - self.T_sup)

    def rests(self, coil: str, *, wide_open: bool = False, after: float = EFFECT_AFTER_S) -> Mask:
        """Whether a valve has been commanded shut, or wide open, for so many s, (n,)."""
        command = self.command(coil)
        at_end = command >= WIDE_OPEN if wide_open else command <= SHUT
        mask = np.zeros(command.size, dtype=bool)
        for first, last in true_runs(self.on & at_end):
            mask[first + round(after / self.interval) : last] = True
        return mask

    @cached_property
    def all_rest(self) -> Mask:
        """Whether all valves have been commanded shut for long enough, (n,)."""
        return np.asarray(np.all([self.rests(coil) for coil in self.coils], axis=0))

    def offset(self, coil: str) -> float:
        """Return what the sensors show of a coil while all valves are shut, K, the median of days; NaN if days differ.

        Half of the days may have a valve that leaks.
        """
        is_baseline = self.all_rest & ~self.has_low_flow & np.isfinite(self.effect(coil))
        medians = [
            float(np.median(self.effect(coil)[is_baseline & (self.day == day)]))
            for day in self.days
            if np.sum(is_baseline & (self.day == day)) * self.interval >= _LEAST_BASELINE_S
        ]
        if len(medians) < _LEAST_BASELINE_DAYS:
            return np.nan
        low, middle, high = np.quantile(medians, (0.25, 0.5, 0.75))
        return float(middle) if 0.5 * (high - low) <= _LARGEST_OFFSET_SPREAD_K else np.nan

    def moment(self, seconds: float) -> Any:
        """Return a time, s since the start of the log, as a datetime64; as it is where the log has no clock."""
        return seconds if self.start is None else self.start + np.timedelta64(round(seconds), "s")

    def times(self) -> Any:
        """Return the times of all samples for an axis: datetime64, or h since the start."""
        seconds = self.grid.time
        return seconds / 3600.0 if self.start is None else self.start + seconds.round().astype("timedelta64[s]")

    def on_axis(self, moment: Any) -> float:
        """Return a time where ``times`` puts it on an axis of matplotlib: days since 1970, or h since the start."""
        if self.start is None:
            return float(moment) / 3600.0
        return float((moment - np.datetime64("1970-01-01")) / np.timedelta64(1, "s")) / SECONDS_PER_DAY

    def mask_of(self, windows: Sequence[tuple[Any, Any]]) -> Mask:
        """Return where the samples of some windows are, (n,)."""
        mask = np.zeros(self.on.size, dtype=bool)
        for window in windows:
            first, end = (m if self.start is None else (m - self.start) / np.timedelta64(1, "s") for m in window)
            mask |= (self.grid.time >= first) & (self.grid.time < end)
        return mask

    def spans(self, mask: Mask, *, bridge: float = 1800.0) -> list[Span]:
        """Return start and end of each time in a mask, s since the start; a pause up to ``bridge``, s, ends none."""
        joined: list[list[int]] = []
        for first, last in true_runs(mask).tolist():
            is_same_day = joined and self.day[first] == self.day[joined[-1][1] - 1]
            if is_same_day and self.grid.time[first] - self.grid.time[joined[-1][1] - 1] <= bridge:
                joined[-1][1] = last
            else:
                joined.append([first, last])
        return [
            (float(self.grid.time[first]), float(self.grid.time[last - 1]) + self.interval) for first, last in joined
        ]

    def hours(self, mask: Mask) -> float:
        return float(np.sum(mask)) * self.interval / 3600.0

    def on_days_of(self, mask: Mask, least_hours: float) -> Mask:
        """Return a mask on the days that have so many hours of it."""
        is_kept = np.zeros(mask.size, dtype=bool)
        for day in np.unique(self.day[mask]):
            in_day = mask & (self.day == day)
            if self.hours(in_day) >= least_hours:
                is_kept |= in_day
        return is_kept

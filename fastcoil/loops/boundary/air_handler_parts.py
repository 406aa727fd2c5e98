"""Parts of an air handler and its building, a stand-in: weather by the second, noise, dampers, zones, set-point reset.

Each zone has a load, as a share of what it gets at full air flow and the lowest set-point.  It takes the air that keeps
its temperature, between a least and its full flow; at full flow it becomes warmer instead.  It holds no heat: load,
flow and temperature of a minute belong together.

ASHRAE Guideline 36-2021: section 5.1.14 (trim and respond), section 5.16.2.2 with its table (supply air temperature of
an air handler with several zones), section 5.6.8.1 (requests of zones).

The noise of a day continues that of the day before, and each day can be made alone: its filters start in the white
noise of the day before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError
from fastcoil.loops.boundary.days import Drift, smooth
from fastcoil.loops.boundary.weather_files import Weather

DAY = 86_400
"""Seconds."""


class Outdoors(NamedTuple):
    """Weather of a file: hour of the year of each row, temperature [degC] and humidity ratio, (n_rows,) each.

    pressure: its mean [Pa].
    """

    hour_of_year: Array
    T: Array
    W: Array
    pressure: float

    @property
    def days(self) -> range:
        """The days of the year that the rows cover; before the first row its values hold, up to an hour."""
        first, last = float(self.hour_of_year[0]), float(self.hour_of_year[-1])
        return range(int(-(-(first - 1.0) // 24.0)) + 1, int(last // 24.0) + 1)

    def of_day(self, label: int) -> tuple[Array, Array]:
        """Temperature and humidity ratio at the seconds of a day of the year, (86400,) each."""
        begin = 24.0 * (label - 1)
        low = max(int(np.searchsorted(self.hour_of_year, begin, side="right")) - 1, 0)
        rows = slice(low, int(np.searchsorted(self.hour_of_year, begin + 24.0)) + 1)
        at = begin + np.arange(DAY) / 3600.0
        hours = self.hour_of_year[rows]
        return np.interp(at, hours, self.T[rows]), np.interp(at, hours, self.W[rows])


def outdoors_of(weather: Weather, pressure: float | None, file: str) -> Outdoors:
    """The weather that was read; ``pressure`` [Pa] in the place of that of the file.

    Raises
    ------
    InputError
        If it has no whole day.
    """
    series, p = weather.series, weather.pressure(pressure)
    outdoors = Outdoors(series["hour_of_year"], series["T_drybulb"], weather.humidity(p), float(np.mean(p)))
    if not outdoors.days:
        raise InputError(f"{file} has no whole day from midnight to midnight: give at least 24 h")
    return outdoors


PLANT_STEP, ZONE_STEP = 10, 60
"""Seconds between the samples of the noise, straight between them."""
_PLANT = {
    "m_a": Drift(0.013, 60),
    "T_a_in": Drift(0.10, 120),
    "W_a_in": Drift(0.009, 300),
    "T_w_in": Drift(0.05, 120),
}
"""As strong and as slow as that of `paper_day`; flow and humidity as a share.  The order numbers the random numbers."""
_ZONE = Drift(0.05, 1200)
"""Of the load of one zone, as a share: a guess."""


def plant_drifts(seed: int, day: int) -> dict[str, Array]:
    """Noise of the plant by series at the seconds of a day, (86400,) each."""
    white = _white(PLANT_STEP, seed, day, 0, len(_PLANT))
    return {
        name: by_second(_noise(drift, PLANT_STEP, one), PLANT_STEP)
        for (name, drift), one in zip(_PLANT.items(), white, strict=True)
    }


def zone_drifts(seed: int, day: int, n_zones: int) -> Array:
    """Noise of the loads of the zones each `ZONE_STEP` seconds of a day, (1440, n_zones)."""
    white = _white(ZONE_STEP, seed, day, 1, n_zones)
    return np.stack([_noise(_ZONE, ZONE_STEP, one)[:-1] for one in white], axis=1)


def by_second(values: Array, step: int) -> Array:
    """Values each ``step`` seconds, (n + 1,), at every second up to the last one, (n step,), straight between them."""
    part = np.multiply.outer(np.diff(values), np.arange(step) / step)
    return np.asarray((values[:-1, None] + part).ravel())


def _noise(drift: Drift, step: int, white: Array) -> Array:
    """Noise each ``step`` seconds from midnight to midnight from the white noise of two days, (86400 / step + 1,)."""
    coarse = Drift(drift.std, drift.tau // step)
    return smooth(white[DAY // step - 10 * coarse.tau - 1 :].copy(), coarse)


def _white(step: int, seed: int, day: int, stream: int, n: int) -> Array:
    """White noise of the day before and of a day, (n, 2 x 86400 / step)."""
    draws = [
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(one, stream))).standard_normal((n, DAY // step))
        for one in (day - 1, day)
    ]
    return np.concatenate(draws, axis=1)


DAMPER_TIME = 90
"""Seconds that the dampers take for a full stroke: usual for their motors."""
COIL_ON, COIL_OFF = 0.5, 0.2
"""Deviation of the mixture from the set-point at which the loop of the coil is switched on and off, K."""


def outdoor_share(
    T_out: Array, W_out: Array, T_return: float, W_return: float, T_set: Array, least: Array, limit: float
) -> Array:
    """Share of outdoor air in the dry air of the mixture that an economiser requests, (n,), from ``least`` to 1.

    Below the outdoor temperature ``limit`` [degC] it is the share whose mixture has the temperature ``T_set``, by the
    balance of enthalpy; elsewhere ``least``.
    """
    warm = (1.006 + 1.86 * W_return) * np.maximum(T_return - T_set, 0.0)
    cold = (1.006 + 1.86 * W_out) * np.maximum(T_set - T_out, 0.0)
    wanted = np.divide(warm, warm + cold, out=np.ones_like(T_out), where=cold > 0.0)
    return np.where(T_out < limit, np.maximum(wanted, least), least)


def through_dampers(share: Array) -> Array:
    """A share as the dampers follow it, (n,): its mean over the last ``DAMPER_TIME`` seconds, at first as it is."""
    total = np.cumsum(np.concatenate((np.zeros(1), np.full(DAMPER_TIME, share[0]), share)))
    return np.asarray((total[DAMPER_TIME + 1 :] - total[1:-DAMPER_TIME]) / DAMPER_TIME)


def coil_is_needed(missing: Array) -> Mask:
    """Where the coil's loop is on, (n,): from `COIL_ON` missing kelvins on until less than `COIL_OFF` are missing."""
    decides = (missing > COIL_ON) | (missing < COIL_OFF)
    decides[0] = True
    last = np.maximum.accumulate(np.where(decides, np.arange(missing.size), 0))
    return np.asarray(missing[last] > COIL_ON)


LOOP_HIGH, LOOP_LOW = 0.95, 0.85
"""A zone sends one request from the upper share of its full flow until it falls below the lower one."""
WARM, HOT = 2.0, 3.0
"""Excess temperatures at which a zone sends two and three requests, K."""


class Limits(NamedTuple):
    """Set-points above which zones send requests, each (n_times, n_zones) [degC]: one, until when, two, three."""

    once: Array
    until: Array
    twice: Array
    thrice: Array


def zone_loads(mean: Array, spread: float, noise: Array) -> Array:
    """Loads of the zones, (n_times, n_zones), at least 0.

    mean: their mean, (n_times,).  spread: the zones lie evenly between 1 - spread and 1 + spread times the mean.
    noise: added to each zone, (n_times, n_zones), as a share of the mean.
    """
    n_zones = noise.shape[1]
    shares = np.linspace(1.0 - spread, 1.0 + spread, n_zones) if n_zones > 1 else np.ones(1)
    return np.asarray(np.maximum(mean[:, None] * (shares + noise), 0.0))


def flow_share(loads: Array, T_set: Array, T_zone: float, T_set_min: float, least: float) -> Array:
    """Mean flow of the zones over their full flow, (n_times,)."""
    wanted = loads * ((T_zone - T_set_min) / (T_zone - T_set))[:, None]
    return np.asarray(np.clip(wanted, least, 1.0).mean(axis=1))


def request_limits(loads: Array, T_zone: float, T_set_min: float) -> Limits:
    """Set-points at which the requests of the zones begin and stop.

    With the set-point T a zone of load L wants the share L (T_zone - T_set_min) / (T_zone - T) of its full flow, and at
    full flow it has the temperature T + L (T_zone - T_set_min).
    """
    rise = loads * (T_zone - T_set_min)
    return Limits(T_zone - rise / LOOP_HIGH, T_zone - rise / LOOP_LOW, T_zone - rise + WARM, T_zone - rise + HOT)


class Trim(NamedTuple):
    """Numbers of trim and respond: steps [K], requests that do not count, delay after the start and time step [s]."""

    trim: float
    respond: float
    respond_max: float
    ignored_requests: int
    trim_delay: int
    trim_interval: int


def between(T_out: Array, T_out_min: float, T_out_max: float, at_min: Array | float, at_max: float) -> Array:
    """``at_min`` up to the one outdoor temperature, ``at_max`` from the other on, a straight line between them."""
    share = np.clip((T_out - T_out_min) / (T_out_max - T_out_min), 0.0, 1.0)
    return np.asarray(at_min + share * (at_max - at_min))


def trim_and_respond(trim: Trim, low: float, high: float, share: Array, limits: Limits) -> Array:
    """Upper end of the line at each time step, (n_times,): ``high`` at first, then trimmed and lowered by requests.

    Parameters
    ----------
    trim
        The numbers.  From the step on that is ``trim_delay`` after the start, the value rises by ``trim`` and, with R
        requests, falls by ``respond`` for each beyond ``ignored_requests``, at most by ``respond_max``.
    low, high
        Bounds [degC].
    share
        How far the outdoor temperature is along the line, (n_times,): the zones get air of ``value + share (low -
        value)``.
    limits
        Set-points at which the zones send requests, at each step.
    """
    value, values = high, np.empty(share.size)
    each = np.stack(limits, axis=1)
    asks = np.zeros(each.shape[2], dtype=bool)
    first = -(-trim.trim_delay // trim.trim_interval)
    for k, along in enumerate(share.tolist()):
        above = value + along * (low - value) > each[k]
        asks = above[0] | (asks & above[1])
        if k >= first:
            over = max(int(np.count_nonzero(asks) + np.count_nonzero(above[2:])) - trim.ignored_requests, 0)
            value = min(max(value + trim.trim - min(trim.respond * over, trim.respond_max), low), high)
        values[k] = value
    return values

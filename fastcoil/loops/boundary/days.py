"""Ready-made days: the paper's kind of day, a constant day, an ASHRAE design day, a heating day."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import argument_checks, require_choice, to_builtin
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.loops.boundary.record import Boundary
from fastcoil.loops.boundary.samples import LARGE_BOUNDARY_SAMPLES
from fastcoil.loops.boundary.series import BOUNDARY_SERIES, Values, hours_to_seconds, require_condition, require_seeds
from fastcoil.model.moist_air import humidity_ratio, humidity_ratio_from_wet_bulb, mix
from fastcoil.model.numerics.noise import low_pass


class Drift(NamedTuple):
    """Slow smooth noise of a signal: standard deviation (unit of the signal) and time constant (s)."""

    std: float
    tau: int


def smooth_noise(n_steps: int, drift: Drift, stream: tuple[int, int]) -> Array:
    """Draw Gaussian noise and filter it twice, first order, 1-s samples, (n_steps,).

    ``stream``: seed and number of the signal.  The filters start 10 time constants early, from zero; the scale is the
    theoretical standard deviation: that of the samples differs a little.
    """
    random = np.random.default_rng(np.random.SeedSequence(stream[0], spawn_key=stream[1:]))
    return filter_white_noise(random.standard_normal(10 * drift.tau + n_steps), drift)


def filter_white_noise(white: Array, drift: Drift) -> Array:
    """Turn ``white`` noise of deviation 1, (n,), in place into that of ``drift``, from 10 time constants on."""
    a = np.exp(-1.0 / drift.tau)
    k = 1.0 - a
    for _ in range(2):
        low_pass(white, a, white)
    # The two filters' response to an impulse is k^2 (n + 1) a^n; the sum of its squares:
    stationary_std = k**2 * np.sqrt((1.0 + a**2) / (1.0 - a**2) ** 3)
    return np.asarray(white[10 * drift.tau :] * (drift.std / stationary_std))


SET_POINTS = (14.0, 13.0, 15.0, 14.0, 12.5, 13.5, 15.5, 14.5, 13.0, 12.0, 14.0, 16.0, 15.0, 13.5, 12.5, 14.0)
"""Set-points of `paper_day`, degC, each held for `SET_POINT_HOLD_S`, repeated."""
SET_POINT_HOLD_S = 1800  # s

DRIFTS = {"m_a": Drift(0.015, 60), "T_a_in": Drift(0.10, 120), "RH": Drift(0.005, 300), "T_w_in": Drift(0.05, 120)}
"""Noise of `paper_day`.  The order numbers the random streams: add at the end only."""


def paper_day(hours: float = 8.0, seed: int | Iterable[int] = 1) -> Boundary:
    """Return a cooling day like those of the paper: set-point steps every half hour, slow swings, smooth noise.

    Air 1.15 + 0.18 D kg/s, 25 + 1.5 D degC, relative humidity 0.56 - 0.05 D, with D(h) = sin(pi (h - 1)/9) up to h = 8
    hours from the start, mirrored there and at every further multiple of 8 h; water 7 + 0.4 sin(2 pi h/1.5) degC.  Each
    carries noise as in `DRIFTS`; the humidity ratio is that at 101325 Pa.  The paper publishes no series: this is a
    generic day.

    Parameters
    ----------
    hours
        Length [h], a whole number of seconds.  A shorter day is the beginning of a longer one, to the bit.
    seed
        Whole number from 0 to 2**32 - 1 for the noise; several give a dim ``day`` with the seeds as labels.  Very many
        days are a stream: they are made when they are needed.

    Returns
    -------
    Boundary
        One day, or several along ``day``.

    Examples
    --------
    >>> import fastcoil as fc
    >>> fc.paper_day(hours=1, seed=[1, 2]).extent
    '1 h x 2 days'
    """
    return _days_of_seeds(_paper_day, hours, seed)


def _paper_day(n_steps: int, seed: int) -> dict[str, Values]:
    h, D, noise = _day_signals(n_steps, seed, DRIFTS)
    T_a_in = 25.0 + 1.5 * D + noise["T_a_in"]
    return {
        "m_a": 1.15 + 0.18 * D + noise["m_a"],
        "T_a_in": T_a_in,
        "W_a_in": humidity_ratio(T_a_in, 0.56 - 0.05 * D + noise["RH"]),
        "T_w_in": 7.0 + 0.4 * np.sin(2 * np.pi * h / 1.5) + noise["T_w_in"],
        "T_set": _stepped_set_point(n_steps),
    }


def _day_signals(n_steps: int, seed: int, drifts: Mapping[str, Drift]) -> tuple[Array, Array, dict[str, Array]]:
    """Return hours from the start, D of `paper_day`, and the noise of each signal, whose order numbers its stream."""
    h = np.arange(n_steps) / 3600
    noise = {name: smooth_noise(n_steps, drift, (seed, i)) for i, (name, drift) in enumerate(drifts.items())}
    return h, np.asarray(np.sin(np.pi * ((8.0 - np.abs(8.0 - h % 16.0)) - 1.0) / 9.0)), noise


def _days_of_seeds(make_day: Callable[..., dict[str, Values]], hours: Any, seed: Any, **conditions: Any) -> Boundary:
    """Make the days of some seeds: a single one without a dim ``day``, very many as a stream."""
    with argument_checks() as check:
        n_steps = check(hours_to_seconds, hours)
        seeds = check(require_seeds, seed)
        conditions = {name: check(require_condition, name, value) for name, value in conditions.items()}
    make = partial(make_day, n_steps, **conditions)
    if isinstance(to_builtin(seed), int):
        return Boundary(**make(seeds[0]), day=seeds[0])
    days = Boundary.from_days(make, day=seeds, hours=n_steps / 3600)
    is_large = len(seeds) * n_steps > LARGE_BOUNDARY_SAMPLES
    return days if is_large else Boundary.from_samples(days.to_dataset(), time_zone="", enabled_by_air=True)


def _stepped_set_point(n_steps: int) -> Array:
    return np.array(SET_POINTS)[np.arange(n_steps) // SET_POINT_HOLD_S % len(SET_POINTS)]


def constant_day(
    hours: float = 8.0, *, m_a: Values = 1.15, T_a_in: float = 25.0, W_a_in: Values = None,
    relative_humidity: float | None = None, T_w_in: Values = 7.0, T_set: Values = 14.0, pressure: float = 101325.0,
    T_out: Values = None, Q_room: Values = None, dp_ratio: Values = None,
) -> Boundary:  # fmt: skip
    """Return a day on which nothing changes; the defaults are the centre of `paper_day`.

    Parameters
    ----------
    hours
        Length [h].
    m_a, T_w_in, T_set
        Air flow [kg/s], entering water [degC] and set-point [degC]: numbers or series of 1-s samples.
    T_a_in
        Temperature of the entering air [degC].
    W_a_in, relative_humidity, pressure
        Its humidity ratio [kg/kg], a number or a series, or its relative humidity at a barometric pressure [Pa], by
        default 0.56.
    T_out, Q_room, dp_ratio
        As for `Boundary`: outdoor temperature [degC] and heat gain [kW] of a room, ratio of pressure differences.

    Returns
    -------
    Boundary
        A day without a dim ``day``.

    Examples
    --------
    >>> import fastcoil as fc
    >>> fc.constant_day(hours=1, W_a_in=0.01).describe()
    '1 h: m_a 1.15 kg s-1, T_a_in 25 degC, W_a_in 0.01, T_w_in 7 degC, T_set 14 degC'
    """
    with argument_checks() as check:
        n_steps = check(hours_to_seconds, hours)
        if W_a_in is None:
            T_a_in = check(require_condition, "T_a_in", T_a_in)
            humidity = 0.56 if relative_humidity is None else relative_humidity
            humidity = check(require_condition, "relative_humidity", humidity)
            pressure = check(require_condition, "pressure", pressure)
    if W_a_in is None:
        W_a_in = humidity_ratio(T_a_in, humidity, pressure)
    elif relative_humidity is not None:
        sentence = "W_a_in and relative_humidity are both given: give one of them"
        raise InputError(sentence, "relative_humidity", "conflict")
    noise = np.zeros(n_steps)  # a series, which sets the length
    added = {"T_out": T_out, "Q_room": Q_room, "dp_ratio": dp_ratio}
    return Boundary(m_a=m_a, T_a_in=T_a_in, W_a_in=W_a_in, T_w_in=T_w_in, T_set=T_set, noise=noise, **added)


# fmt: off
RANGE_FRACTIONS = (
    0.88, 0.92, 0.95, 0.98, 1.00, 0.98, 0.91, 0.74, 0.55, 0.38, 0.23, 0.13,
    0.05, 0.00, 0.00, 0.06, 0.14, 0.24, 0.39, 0.50, 0.59, 0.68, 0.75, 0.82,
)
# fmt: on
"""Drop of the temperature below the day's maximum at hours 1 ... 24, as a fraction of the daily range.

ASHRAE Handbook - Fundamentals (2009), chapter 14, table 6 (from research project RP-1363).
"""


class DesignConditions(NamedTuple):
    """Outdoor air (degC, K, degC), return air (degC, 1), entering water and set-point (degC)."""

    T_design: float
    T_daily_range: float
    T_wet_bulb: float | None
    T_return: float
    RH_return: float
    T_w_in: Values
    T_set: Values


DESIGN_CONDITIONS = {
    "cooling": DesignConditions(33.3, 10.5, 23.7, 24.0, 0.50, 7.0, 13.0),
    "heating": DesignConditions(-20.0, 0.0, None, 21.0, 0.30, 60.0, 25.0),
}
"""Outdoor air of Chicago O'Hare (WMO 725300): annual design conditions, ASHRAE Fundamentals (2009).

Cooling: 0.4 % dry bulb, mean coincident wet bulb, daily range of the hottest month.  Heating: 99.6 % dry bulb, all day,
as is the convention for sizing.  Return air, water and set-points are usual values, not published ones.
"""
DESIGN_PRESSURE_PA = 98934.0  # the standard pressure at the station, 201 m


def design_day(
    hours: float = 8.0, mode: str = "cooling", *, start_hour: float = 9.0, T_design: float | None = None,
    T_daily_range: float | None = None, T_wet_bulb: float | None = None, outdoor_fraction: float = 0.3,
    T_return: float | None = None, RH_return: float | None = None, m_a: Values = 1.15, T_w_in: Values = None,
    T_set: Values = None, pressure: float = DESIGN_PRESSURE_PA,
) -> Boundary:  # fmt: skip
    """Return a design day: outdoor air on ASHRAE's diurnal profile, mixed with return air.

    The outdoor temperature follows `RANGE_FRACTIONS` (ASHRAE Handbook - Fundamentals, 2009), straight between hours:
    nothing is faster.  In cooling ``T_design`` is its maximum (hours 14 and 15), in heating its minimum (hour 5).  The
    humidity ratio is constant, that of ``T_wet_bulb`` at ``T_design`` (in heating: saturated there, if not given), but
    at most saturated.  The defaults are in `DESIGN_CONDITIONS`; heating has no daily range there: give one for a day
    that varies, or take `heating_day`, on which set-point, air and water move.

    Parameters
    ----------
    hours, mode, start_hour
        Length [h]; ``cooling`` or ``heating``; hour of the day (0 to 24, solar time) of the first sample.
    T_design, T_daily_range, T_wet_bulb
        Outdoor air: design temperature [degC], daily range [K], wet bulb at the design temperature [degC].
    outdoor_fraction, T_return, RH_return
        Share of outdoor air in the dry air of the mixture; return air [degC, 1].
    m_a, T_w_in, T_set
        Air flow [kg/s], entering water [degC] and set-point [degC]: numbers or series of 1-s samples.
    pressure
        Barometric pressure [Pa].

    Returns
    -------
    Boundary
        A day without a dim ``day``.

    Examples
    --------
    >>> import fastcoil as fc
    >>> fc.design_day(hours=1, outdoor_fraction=1.0).extent
    '1 h'
    """
    arguments = {n: value for n, value in locals().items() if n in DesignConditions._fields and value is not None}
    with argument_checks() as check:
        mode = check(require_choice, "mode", mode, DESIGN_CONDITIONS)
        n_steps = check(hours_to_seconds, hours)
        start_hour = check(require_condition, "start_hour", start_hour)
        for name in arguments.keys() - BOUNDARY_SERIES.keys():
            arguments[name] = check(require_condition, name, arguments[name])
        outdoor_fraction = check(require_condition, "outdoor_fraction", outdoor_fraction)
        pressure = check(require_condition, "pressure", pressure)
    design = DESIGN_CONDITIONS[mode]._replace(**arguments)
    wet_bulb = design.T_design if design.T_wet_bulb is None else design.T_wet_bulb
    if wet_bulb > design.T_design:
        sentence = f"T_wet_bulb = {wet_bulb:g} degC is above T_design = {design.T_design:g} degC: lower it"
        raise InputError(sentence, "T_wet_bulb", "conflict")
    clock = (start_hour + np.arange(n_steps) / 3600) % 24.0
    range_fraction = np.interp(clock, np.arange(25), (RANGE_FRACTIONS[-1], *RANGE_FRACTIONS))
    T_max = design.T_design if mode == "cooling" else design.T_design + design.T_daily_range
    T_out = T_max - range_fraction * design.T_daily_range
    W_design = humidity_ratio_from_wet_bulb(design.T_design, wet_bulb, pressure)
    W_out = np.minimum(W_design, humidity_ratio(T_out, 1.0, pressure))
    W_return = humidity_ratio(design.T_return, design.RH_return, pressure)
    T_a_in, W_a_in = mix(outdoor_fraction, T_out, W_out, design.T_return, W_return)
    return Boundary(m_a=m_a, T_a_in=T_a_in, W_a_in=W_a_in, T_w_in=design.T_w_in, T_set=design.T_set)


WINTER_HUMIDITY_RATIO = 0.0035  # of the mixed air, kg/kg; a heating coil stays dry at any
HEATING_DRIFTS = {"m_a": Drift(0.015, 60), "T_a_in": Drift(0.20, 120), "T_w_in": Drift(0.3, 300)}
"""Noise of `heating_day`.  The order numbers the random streams: add at the end only."""


def heating_day(hours: float = 8.0, seed: int | Iterable[int] = 1, *, T_w_in: float = 60.0) -> Boundary:
    """Return a heating day: set-point steps every half hour, slow swings, smooth noise.

    Air 0.9 + 0.2 D kg/s, 12 + 2 D degC, D as for `paper_day`: with 30 % of outdoor air and return air of 21 degC that
    is -11 to -2 degC outdoors.  Water T_w_in + sin(2 pi h/1.5) degC.  Each carries noise as in `HEATING_DRIFTS`.
    Set-points from 23 to 27 degC.  This day was not measured: it is generic, as `paper_day` is for cooling.

    Parameters
    ----------
    hours, seed
        As for `paper_day`.
    T_w_in
        Mean temperature of the entering water [degC].

    Returns
    -------
    Boundary
        One day, or several along ``day``.

    Examples
    --------
    >>> import fastcoil as fc
    >>> fc.heating_day(hours=1).extremes["T_set"]
    (24.0, 25.0)
    """
    return _days_of_seeds(_heating_day, hours, seed, T_w_in=T_w_in)


def _heating_day(n_steps: int, seed: int, T_w_in: float) -> dict[str, Values]:
    h, D, noise = _day_signals(n_steps, seed, HEATING_DRIFTS)
    return {
        "m_a": 0.9 + 0.2 * D + noise["m_a"],
        "T_a_in": 12.0 + 2.0 * D + noise["T_a_in"],
        "W_a_in": WINTER_HUMIDITY_RATIO,
        "T_w_in": T_w_in + np.sin(2 * np.pi * h / 1.5) + noise["T_w_in"],
        "T_set": _stepped_set_point(n_steps) + 11.0,
    }

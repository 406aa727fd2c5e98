"""Operation of an air handler, and everything that acts on its coil on a day: a stand-in for a building.

Each zone has a load, as a share of what it gets at full air flow and the lowest set-point.  It takes the air that keeps
its temperature, between a least and its full flow; at full flow it becomes warmer instead.  Zones store no heat: load,
flow and temperature of a minute belong together.

ASHRAE Guideline 36-2021: section 5.1.14 (trim and respond), section 5.16.2.2 with its table (supply air temperature of
an air handler with several zones), section 5.6.8.1 (requests of zones).

The noise of a day continues that of the day before, and each day can be made alone: its filters start in the white
noise of the day before.  Thresholds of the operation are usual values or guesses, described in docs/years.md.
"""

from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from fastcoil.base.arguments import argument_checks, raise_problems, require_choice, require_integer
from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError, Problem
from fastcoil.loops.boundary.days import Drift, filter_white_noise
from fastcoil.loops.boundary.series import CONDITIONS, require_condition
from fastcoil.loops.boundary.weather_files import Weather
from fastcoil.model.moist_air import humidity_ratio, mix

Settings: TypeAlias = SimpleNamespace
"""Settings of the air handler; names and units as the arguments of `weather_year`."""
DAY_SECONDS = 86_400
_READ_WITH_RESET = ("set_point", "outdoor_reset", "trim_and_respond")
_MODE_DEFAULTS: dict[str, tuple[Any, Any, Any]] = {
    "economiser": ("differential", "none", None), "economiser_limit": (24.0, 24.0, ("economiser", "fixed")),
    "T_return": (24.0, 21.0, None), "RH_return": (0.5, 0.3, None), "T_balance": (12.0, 15.0, None),
    "internal_load": (0.5, 0.0, None), "set_point": ("outdoor_reset", "outdoor_reset", None),
    "T_set": (13.0, 25.0, ("set_point", "fixed")), "T_set_min": (13.0, 18.0, _READ_WITH_RESET),
    "T_set_max": (18.0, 30.0, _READ_WITH_RESET), "T_out_min": (16.0, -10.0, _READ_WITH_RESET),
    "T_out_max": (21.0, 15.0, _READ_WITH_RESET), "T_w_in": (7.0, 60.0, ("water", "fixed")),
    "T_w_min": (7.0, 40.0, ("water", "load", "outdoor")), "T_w_max": (12.0, 60.0, ("water", "load", "outdoor")),
    "T_out_w_min": (16.0, -7.0, ("water", "outdoor")), "T_out_w_max": (27.0, 10.0, ("water", "outdoor")),
}  # fmt: skip
"""Defaults in cooling and heating, with sources in `weather`; the argument and its words that decide if it is read."""
DEFAULTS = {mode: {n: row[k] for n, row in _MODE_DEFAULTS.items()} for k, mode in enumerate(("cooling", "heating"))}
"""Defaults of `weather_year`, by mode."""
CHOICES = {
    "economiser": ("differential", "fixed", "none"), "set_point": ("fixed", "outdoor_reset", "trim_and_respond"),
    "water": ("fixed", "load", "outdoor"),
}  # fmt: skip
_WHOLE_NUMBER_BOUNDS = {"zones": (1, 1000), "seed": (0, 2**32 - 1)}
_ORDERED_PAIRS = (
    ("m_a_min", "m_a_design"), ("outdoor_air_min", "m_a_design"), ("T_set_min", "T_set_max"),
    ("T_out_min", "T_out_max"), ("T_w_min", "T_w_max"), ("T_out_w_min", "T_out_w_max"),
)  # fmt: skip
MIN_COOLING_K = 2.0  # by which supply air is cooler than the zones: with less they would take endless air
PLANT_STEP_S = 10  # between the samples of the noise of the plant, straight between them
ZONE_STEP_S = 60  # the same of loads and flows
_PLANT_DRIFTS = {
    "m_a": Drift(0.013, 60), "T_a_in": Drift(0.10, 120), "W_a_in": Drift(0.009, 300), "T_w_in": Drift(0.05, 120),
}  # fmt: skip
"""As strong and as slow as that of `paper_day`; flow and humidity as a share.  The order numbers the random numbers."""
_ZONE_DRIFT = Drift(0.05, 1200)  # of the load of one zone, as a share: a guess


class Outdoors(NamedTuple):
    """Weather of a file: hour of the year, temperature [degC], humidity ratio, (n_rows,) each; mean pressure [Pa]."""

    hour_of_year: Array
    T: Array
    W: Array
    pressure: float

    @property
    def days(self) -> range:
        """Days of the year that the rows cover; before the first row its values hold, up to an hour."""
        first, last = float(self.hour_of_year[0]), float(self.hour_of_year[-1])
        return range(int(-(-(first - 1.0) // 24.0)) + 1, int(last // 24.0) + 1)

    def of_day(self, label: int) -> tuple[Array, Array]:
        """Return temperature and humidity ratio at the seconds of a day of the year, (86400,) each."""
        begin = 24.0 * (label - 1)
        low = max(int(np.searchsorted(self.hour_of_year, begin, side="right")) - 1, 0)
        rows = slice(low, int(np.searchsorted(self.hour_of_year, begin + 24.0)) + 1)
        hours_of_day = begin + np.arange(DAY_SECONDS) / 3600.0
        hours = self.hour_of_year[rows]
        return np.interp(hours_of_day, hours, self.T[rows]), np.interp(hours_of_day, hours, self.W[rows])


def make_outdoors(weather: Weather, pressure: float | None, file: str) -> Outdoors:
    """Return the weather of a file; ``pressure`` [Pa] replaces that of the file."""
    series, p = weather.series, weather.pressure(pressure)
    outdoors = Outdoors(series["hour_of_year"], series["T_drybulb"], weather.humidity(p), float(np.mean(p)))
    if not outdoors.days:
        raise InputError(f"{file} has no whole day from midnight to midnight: give at least 24 h", file, "data")
    return outdoors


def check_settings(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Check the arguments of `weather_year` and complete them with the defaults of the mode."""
    with argument_checks() as check:
        mode = check(require_choice, "mode", arguments["mode"], DEFAULTS)
        settings: dict[str, Any]
        settings = {n: check.unless_none(require_choice, n, arguments[n], words) for n, words in CHOICES.items()}
        for name in [name for name in arguments if name in CONDITIONS and name != "pressure"]:
            is_left_out = arguments[name] is None and (name in DEFAULTS["cooling"] or name == "T_design")
            settings[name] = None if is_left_out else check(require_condition, name, arguments[name])
        for name, bounds in _WHOLE_NUMBER_BOUNDS.items():
            settings[name] = check(require_integer, name, arguments[name], *bounds)
    given_names = {name for name, value in settings.items() if value is not None}
    settings |= {name: value for name, value in DEFAULTS[mode].items() if name not in given_names}
    settings["mode"] = mode
    raise_problems(list(_setting_clashes(settings, given_names)))
    return settings


def make_settings(
    chosen: Mapping[str, Any], outdoors: Outdoors, fan: Mapping[int, tuple[float, float] | None], file: str
) -> Settings:
    """Return the settings at a site; ``fan``: first and last hour of the fan by day label, None where it is off.

    They add ``W_return``, the humidity ratio of the return air, and ``high_limit``, the outdoor temperature that locks
    the economiser out [degC].
    """
    values = dict(chosen)
    is_cooling = chosen["mode"] == "cooling"
    if values["T_design"] is None:
        values["T_design"] = float(np.quantile(outdoors.T, 0.996 if is_cooling else 0.004))
    low, high = ("T_balance", "T_design") if is_cooling else ("T_design", "T_balance")
    if values[high] - values[low] < 1.0:
        sentence = f"T_balance = {values['T_balance']:g} degC, T_design = {values['T_design']:.4g} degC in {file}"
        raise InputError(f"{sentence}: give a {low} at least 1 K below {high}", low, "conflict")
    if values["set_point"] == "fixed":
        values["T_set_min"] = values["T_set"]
    limits = {"differential": values["T_return"], "fixed": values["economiser_limit"], "none": -np.inf}
    W_return = float(humidity_ratio(values["T_return"], chosen["RH_return"], outdoors.pressure))
    return Settings(**values, cools=is_cooling, fan=fan, high_limit=limits[values["economiser"]], W_return=W_return)


def _setting_clashes(chosen: Mapping[str, Any], given_names: set[str]) -> Iterator[Problem]:
    for name, (*_, reader) in _MODE_DEFAULTS.items():
        if reader and name in given_names and chosen[reader[0]] not in reader[1:]:
            text = f"{name} = {chosen[name]:g} has no effect with {reader[0]} = {chosen[reader[0]]!r}"
            cure = f"leave it out, or choose {' or '.join(map(repr, reader[1:]))}"
            yield Problem(f"{text}: {cure}", name, "conflict")
    for low, high in _ORDERED_PAIRS:
        if not chosen[low] < chosen[high]:
            text = f"{low} = {chosen[low]:g} is not below {high} = {chosen[high]:g}: exchange or change them"
            yield Problem(text, low, "conflict")
    if chosen["mode"] == "heating":
        if chosen["economiser"] != "none":
            text = f"economiser = {chosen['economiser']!r}: only cooling has one, choose 'none'"
            yield Problem(text, "economiser", "conflict")
        if chosen["set_point"] == "trim_and_respond":
            text = "set_point = 'trim_and_respond': only cooling has it, choose 'outdoor_reset' or 'fixed'"
            yield Problem(text, "set_point", "conflict")
        return
    top = "T_set" if chosen["set_point"] == "fixed" else "T_set_max"
    if chosen[top] > chosen["T_return"] - MIN_COOLING_K:
        text = f"{top} = {chosen[top]:g} degC: the zones need air at least {MIN_COOLING_K:g} K cooler than T_return = "
        yield Problem(f"{text}{chosen['T_return']:g} degC, lower it", top, "conflict")


def make_day_series(s: Settings, outdoors: Outdoors, label: int) -> dict[str, Array]:
    """Return all series of a day by its label, the day of the year from 1: (86400,) each."""
    T_out, W_out = outdoors.of_day(label)
    begin, end = (round(3600 * hour) for hour in s.fan[label] or (0.0, 0.0))
    drifts = {name: s.disturbances * drift for name, drift in plant_drifts(s.seed, label).items()}
    minutes = slice(None, None, ZONE_STEP_S)
    mean_load = building_load(s, T_out[minutes], begin, end)
    loads = zone_loads(mean_load, s.zone_spread, s.disturbances * zone_drifts(s.seed, label, s.zones))
    T_set = set_point_series(s, T_out, loads, begin, end)
    flow = air_flow(s, loads, T_set[minutes])
    m_a = interpolate_to_seconds(np.append(flow, flow[-1]), ZONE_STEP_S) * (1.0 + drifts["m_a"])
    T_a_in, W_a_in = np.full(DAY_SECONDS, s.T_return), np.full(DAY_SECONDS, s.W_return)
    enabled = np.zeros(DAY_SECONDS)
    on = slice(begin, end)
    if end > begin:
        least = np.minimum(s.outdoor_air_min / m_a[on], 1.0)
        air = T_out[on], W_out[on], s.T_return, s.W_return
        requested_share = outdoor_share(*air, T_set[on], least, s.high_limit)
        T_mixed, W_mixed = mix(delay_by_dampers(requested_share), *air)
        # with the dampers at their target: the coil does not run only because they are still moving
        excess = s.T_return + requested_share * (T_out[on] - s.T_return) - T_set[on]
        enabled[on] = is_coil_needed(excess if s.cools else -excess)
        T_a_in[on] = T_mixed + drifts["T_a_in"][on]
        W_a_in[on] = W_mixed * (1.0 + drifts["W_a_in"][on])
    m_a[:begin] = m_a[end:] = 0.0
    T_w_in = water_temperature(s, T_out, loads) + drifts["T_w_in"]
    return {"m_a": m_a, "T_a_in": T_a_in, "W_a_in": W_a_in, "T_w_in": T_w_in, "T_set": T_set, "enabled": enabled}


def building_load(s: Settings, T_out: Array, begin: int, end: int) -> Array:
    """Load as a share of the design load each minute, 0 to 1; ``begin``, ``end``: seconds at which the fan runs.

    The internal load rises over two hours from the start of the fan, and falls over the last two.
    """
    outdoors = np.clip((T_out - s.T_balance) / (s.T_design - s.T_balance), 0.0, 1.0)
    hour = np.arange(T_out.size) * ZONE_STEP_S / 3600.0
    people = np.clip(np.minimum((hour - begin / 3600) / 2.0, (end / 3600 - hour) / 2.0), 0.0, 1.0)
    if not s.cools:
        return np.asarray(np.clip(outdoors - s.internal_load * people, 0.0, 1.0))
    return np.asarray((1.0 - s.internal_load) * outdoors + s.internal_load * people)


def set_point_series(s: Settings, T_out: Array, loads: Array, begin: int, end: int) -> Array:
    """Set-point at each second [degC]."""
    if s.set_point == "fixed":
        return np.full(DAY_SECONDS, s.T_set)
    top: Array | float = s.T_set_max
    if s.set_point == "trim_and_respond" and end > begin:
        step_seconds = np.arange(begin, end, TRIM_INTERVAL_S)
        limits = request_limits(loads[step_seconds // ZONE_STEP_S], s.T_return, s.T_set_min)
        reset_shares = reset_line(T_out[step_seconds], s.T_out_min, s.T_out_max, 0.0, 1.0)
        steps = trim_and_respond(s.T_set_min, s.T_set_max, reset_shares, limits)
        top = np.full(DAY_SECONDS, s.T_set_max)
        top[begin:end] = np.repeat(steps, TRIM_INTERVAL_S)[: end - begin]
    return reset_line(T_out, s.T_out_min, s.T_out_max, top, s.T_set_min)


def air_flow(s: Settings, loads: Array, T_set: Array) -> Array:
    """Air flow each minute [kg/s]."""
    if not s.cools:
        return np.asarray(s.m_a_min + (s.m_a_design - s.m_a_min) * np.clip(loads, 0.0, 1.0).mean(axis=1))
    return np.asarray(s.m_a_design * flow_share(loads, T_set, s.T_return, s.T_set_min, s.m_a_min / s.m_a_design))


def water_temperature(s: Settings, T_out: Array, loads: Array) -> Array:
    """Temperature of the entering water at each second [degC]."""
    if s.water == "fixed":
        return np.full(DAY_SECONDS, s.T_w_in)
    if s.water == "outdoor":
        return reset_line(T_out, s.T_out_w_min, s.T_out_w_max, s.T_w_max, s.T_w_min)
    mean = np.clip(loads, 0.0, 1.0).mean(axis=1)
    share = interpolate_to_seconds(np.append(mean, mean[-1]), ZONE_STEP_S)  # the last minute holds
    idle, full = (s.T_w_max, s.T_w_min) if s.cools else (s.T_w_min, s.T_w_max)
    return np.asarray(idle + share * (full - idle))


def plant_drifts(seed: int, day: int) -> dict[str, Array]:
    """Noise of the plant by series at the seconds of a day, (86400,) each."""
    white = _white_noise(PLANT_STEP_S, seed, day, 0, len(_PLANT_DRIFTS))
    return {
        name: interpolate_to_seconds(_drift_noise(drift, PLANT_STEP_S, row), PLANT_STEP_S)
        for (name, drift), row in zip(_PLANT_DRIFTS.items(), white, strict=True)
    }


def zone_drifts(seed: int, day: int, n_zones: int) -> Array:
    """Noise of the loads of the zones each `ZONE_STEP_S` seconds of a day, (1440, n_zones)."""
    white = _white_noise(ZONE_STEP_S, seed, day, 1, n_zones)
    return np.stack([_drift_noise(_ZONE_DRIFT, ZONE_STEP_S, row)[:-1] for row in white], axis=1)


def interpolate_to_seconds(values: Array, step: int) -> Array:
    """Interpolate values each ``step`` seconds, (n + 1,), to every second but the last one, (n step,)."""
    return np.asarray((values[:-1, None] + np.multiply.outer(np.diff(values), np.arange(step) / step)).ravel())


def _drift_noise(drift: Drift, step: int, white: Array) -> Array:
    """Filter white noise of two days: noise each ``step`` seconds of the second, (86400 / step + 1,)."""
    coarse = Drift(drift.std, drift.tau // step)
    return filter_white_noise(white[DAY_SECONDS // step - 10 * coarse.tau - 1 :].copy(), coarse)


def _white_noise(step: int, seed: int, day: int, stream: int, n: int) -> Array:
    """Draw white noise of the day before and of a day, (n, 2 x 86400 / step)."""
    sources = [np.random.SeedSequence(seed, spawn_key=(noise_day, stream)) for noise_day in (day - 1, day)]
    shape = (n, DAY_SECONDS // step)
    return np.concatenate([np.random.default_rng(source).standard_normal(shape) for source in sources], axis=1)


DAMPER_STROKE_S = 90  # of a full stroke of the dampers: usual for their motors
COIL_ON_K = 0.5  # deviation of the mixture from the set-point at which the loop of the coil is switched on
COIL_OFF_K = 0.2  # the same, switched off


def outdoor_share(
    T_out: Array, W_out: Array, T_return: float, W_return: float, T_set: Array, least: Array, limit: float
) -> Array:
    """Share of outdoor air in the dry air of the mixture that an economiser requests, (n,), from ``least`` to 1.

    Below the outdoor temperature ``limit`` [degC] it is the share whose mixture has the temperature ``T_set``, by the
    balance of enthalpy; elsewhere ``least``.
    """
    warm = (1.006 + 1.86 * W_return) * np.maximum(T_return - T_set, 0.0)
    cold = (1.006 + 1.86 * W_out) * np.maximum(T_set - T_out, 0.0)
    exact_share = np.divide(warm, warm + cold, out=np.ones_like(T_out), where=cold > 0.0)
    return np.where(T_out < limit, np.maximum(exact_share, least), least)


def delay_by_dampers(share: Array) -> Array:
    """Average a share, (n,), over the last ``DAMPER_STROKE_S`` seconds, as the dampers follow it from rest."""
    total = np.cumsum(np.concatenate((np.zeros(1), np.full(DAMPER_STROKE_S, share[0]), share)))
    return np.asarray((total[DAMPER_STROKE_S + 1 :] - total[1:-DAMPER_STROKE_S]) / DAMPER_STROKE_S)


def is_coil_needed(missing: Array) -> Mask:
    """Where the loop of the coil is on, (n,): from `COIL_ON_K` missing until less than `COIL_OFF_K` is."""
    decides = (missing > COIL_ON_K) | (missing < COIL_OFF_K)
    decides[0] = True
    return np.asarray(missing[np.maximum.accumulate(np.where(decides, np.arange(missing.size), 0))] > COIL_ON_K)


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
    return np.asarray(np.clip(loads * ((T_zone - T_set_min) / (T_zone - T_set))[:, None], least, 1.0).mean(axis=1))


def request_limits(loads: Array, T_zone: float, T_set_min: float) -> Array:
    """Set-points at which zones send one request, stop doing so, send two, and three, (n_times, 4, n_zones) [degC].

    Guideline 36, section 5.6.8.1: one request from 95 % of the full flow of the zone until it falls below 85 %, two
    where the zone is 2 K too warm, three from 3 K.  With the set-point T a zone of load L takes the share
    L (T_zone - T_set_min) / (T_zone - T) of its full flow, and at full flow its temperature is
    T + L (T_zone - T_set_min).
    """
    rise = loads * (T_zone - T_set_min)
    return np.stack([T_zone - rise / 0.95, T_zone - rise / 0.85, T_zone - rise + 2.0, T_zone - rise + 3.0], 1)


def reset_line(T_out: Array, T_out_min: float, T_out_max: float, at_min: Array | float, at_max: float) -> Array:
    """Return ``at_min`` up to ``T_out_min``, ``at_max`` from ``T_out_max`` on, and a straight line between them."""
    return np.asarray(at_min + np.clip((T_out - T_out_min) / (T_out_max - T_out_min), 0.0, 1.0) * (at_max - at_min))


TRIM_DELAY_S, TRIM_INTERVAL_S = 600, 120  # from the start of the fan to the first step, and from step to step
TRIM_K, RESPOND_K, RESPOND_MAX_K = 0.1, 0.2, 0.6  # up each time; down for each request that counts, and at most
IGNORED_REQUESTS = 2  # which do not count


def trim_and_respond(low: float, high: float, share: Array, limits: Array) -> Array:
    """Upper end of the reset line at each time step, (n_times,): starts at ``high``, lowered by requests to ``low``.

    share: position of the outdoor temperature on the reset line, (n_times,).  limits: see `request_limits`, at each
    step.
    """
    value, values = high, np.empty(share.size)
    is_requesting = np.zeros(limits.shape[2], dtype=bool)
    for k, reset_share in enumerate(share.tolist()):
        is_above = value + reset_share * (low - value) > limits[k]
        is_requesting = is_above[0] | (is_requesting & is_above[1])
        if k * TRIM_INTERVAL_S >= TRIM_DELAY_S:
            n_requests = int(np.count_nonzero(is_requesting) + np.count_nonzero(is_above[2:]))
            response = min(RESPOND_K * max(n_requests - IGNORED_REQUESTS, 0), RESPOND_MAX_K)
            value = min(max(value + TRIM_K - response, low), high)
        values[k] = value
    return values

"""Valves, loops and conditions of the study of hunting, what is known of them before simulation, and the rules.

A condition is air, water and set-point that stand still for a day: nothing but the loop itself can keep it swinging.
Each day starts with a cold plant and a closed valve, so every loop gets its kick.  A rule is a number that a loop has,
and a limit above which it is said to hunt; ``hunting_index`` and the margins of Bode require the plant, the others
what a step of the command shows: gain K, time constant T and dead time theta.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.design.describing_function import describing_function
from fastcoil.design.operating_points import OperatingPoints
from fastcoil.design.plants import Columns, Plants, loop_response
from fastcoil.model.moist_air import humidity_ratio
from studies.common import HEATING_GAIN, draw_loguniform, pool_days, share_of
from studies.days import HEATING, loop_settings, make_days

LEAST_GAIN = 0.2  # of the plant, K per stroke: with less a valve changes nothing
FREQUENCIES = np.geomspace(3e-4, math.pi, 300)  # at which the loop response is computed, rad/s


def loop_properties(loop: fc.Loop, day: fc.Boundary) -> xr.Dataset:
    """The model K, T, theta, and margins, over the dims of the loop and ``day``, at the mean conditions of each day.

    K: K per unit of command.  T, theta: s, what an engineer reads from a step of the command, with the gap out of the
    way; half a sample time counts as dead time, since a sampled controller acts that much later on average.
    opening: where the valve rests.  hunting_index: largest |L| |N|.  gain_margin.  phase_margin: degrees, 180 where
    |L| < 1.  reachable: whether the valve holds the set-point and changes anything.
    """
    linear = fc.linearise(loop, day)
    X, ts = (xr.DataArray(loop[name]).reset_coords(drop=True) for name in ("backlash", "sample_time"))
    properties = xr.Dataset(
        {
            "K": abs(linear.gain) / (1.0 - X),
            "T": linear.lag,
            "theta": linear.delay + 0.5 * ts,
            "opening": linear.opening,
            "hunting_index": margins(loop, day),
            "gain_margin": linear.gain_margin.fillna(np.inf),
            "phase_margin": linear.phase_margin.fillna(180.0),
            "reachable": linear.reachable.astype(bool) & (abs(linear.gain) > LEAST_GAIN),
        }
    )
    return properties.reset_coords(drop=True)


def margins(loop: fc.Loop, day: fc.Boundary) -> xr.DataArray:
    """Largest |L| |N| over the frequencies at which L and a gap together lag 180 degrees; 0 if there are none.

    N: describing function of a gap, whose lag goes from 0 to 90 degrees as its input shrinks to the gap: Slotine
    and Li (1991), eq 5.21.  A cycle asks for 1.  Motor, limits of the stroke and the curve of the valve are left out;
    ``fc.limit_cycle`` has them.  Proportional to kp.
    """
    points = OperatingPoints(loop, day, None)
    return points.dataset({"hunting_index": (points.evaluate(_margin)["hunting_index"], {})}).hunting_index


def _margin(columns: Columns, plants: Plants) -> Iterator[tuple[str, np.ndarray]]:
    L = loop_response(columns, plants, FREQUENCIES)
    is_defined = np.isfinite(L)  # there is none above half the sampling frequency
    phase_left = np.pi + np.unwrap(np.where(is_defined, np.angle(L), 0.0), axis=1)
    is_inside = is_defined & (phase_left > 0.0) & (phase_left < 0.5 * np.pi)
    yield "hunting_index", np.where(is_inside, np.abs(L) * np.interp(phase_left, *_GAP_TABLE), 0.0).max(axis=1)


def gap_describing_function(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lag, rad, and size of the describing function of a gap; depth: half the gap over the amplitude of its input."""
    N = describing_function(0.5 / depth, np.array(1.0), np.array(1.0))
    return -np.angle(N), np.abs(N)


_GAP_TABLE = gap_describing_function(np.linspace(1e-6, 1.0 - 1e-6, 2000))


WET, DRY = "wet cooling", "dry cooling"
OPERATING_KINDS = (WET, DRY, HEATING)
HOURS = 8
WARM_UP_SECONDS = 3 * 3600
BACKLASH_SIZES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15)
SERIES_NAMES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")
STEP_SIZE = 0.3  # step of the set-point, K
HOURS_BEFORE_STEP, HOURS_AFTER_STEP = 2, 1


def valves(seed: int, size: int, wide: bool = False) -> fc.Loop:
    """Valves and loops along ``sample``: a third to a half of them hunt.

    wide: other plants than those that the rules are chosen on: small and large coils, fast and slow sensors, motors and
    controllers, most of them beyond the ranges of the others.
    """
    rng = np.random.default_rng(seed)

    m_full = draw_loguniform(rng, 0.8, 3.0, size) if wide else np.full(size, 1.7)
    parameters = {
        "backlash": rng.choice(BACKLASH_SIZES, size),
        "rangeability": draw_loguniform(rng, 20, 100, size),
        "authority": draw_loguniform(rng, 0.05, 0.9, size),
        "C_w": m_full * draw_loguniform(rng, 4.5, 15.0, size) if wide else rng.uniform(8.8, 14.0, size),
        "C_c": draw_loguniform(rng, 8.0, 80.0, size) if wide else draw_loguniform(rng, 10.0, 30.0, size),
        "m_full": m_full,
        "sample_time": rng.choice([1.0, 2.0, 20.0, 60.0] if wide else [5.0, 10.0, 15.0, 30.0], size),
        "sensor_time_constant": rng.uniform(0.0, 120.0, size) if wide else rng.uniform(5.0, 60.0, size),
        "stroke_time": rng.uniform(0.0, 300.0, size) if wide else rng.uniform(30.0, 150.0, size),
        "kp": draw_loguniform(rng, 0.003, 0.2, size) if wide else draw_loguniform(rng, 0.005, 0.15, size),
        "ti": draw_loguniform(rng, 3.0, 600.0, size) if wide else draw_loguniform(rng, 4.0, 300.0, size),
    }
    return fc.Loop.preset("lbnl").assign(**{name: ("sample", values) for name, values in parameters.items()})


def conditions(kind: str, seed: int, size: int, hours: int = HOURS) -> fc.Boundary:
    """Days on which air, water and set-point stand still, as the seed draws them."""
    rng = np.random.default_rng([seed, OPERATING_KINDS.index(kind)])

    def uniform(low: float, high: float) -> np.ndarray:
        return rng.uniform(low, high, size)

    air, humidity, water, T_set = {
        WET: ((23, 32), (0.5, 0.8), (5, 9), (12, 16)),
        DRY: ((20, 32), (0.1, 0.25), (5, 9), (12, 18)),
        HEATING: ((0, 18), (0.2, 0.4), (35, 60), (18, 28)),
    }[kind]
    T_a_in = uniform(*air)
    constants = {"T_a_in": T_a_in, "W_a_in": humidity_ratio(T_a_in, uniform(*humidity)), "T_w_in": uniform(*water),
             "T_set": uniform(*T_set), "m_a": uniform(0.6, 1.4)}  # fmt: skip
    series = {name: np.repeat(values[:, None], 3600 * hours, axis=1) for name, values in constants.items()}
    return fc.Boundary(**series, day=list(range(size)))


def adapt_to_kind(loop: fc.Loop, kind: str) -> fc.Loop:
    """Adapt a loop to a kind of day: the controller of a heating coil acts in reverse, with less gain."""
    if kind != HEATING:
        return loop
    return loop.assign(kp=HEATING_GAIN * xr.DataArray(loop["kp"]), **loop_settings(HEATING))


LEAST_REGULARITY = 2 / 3  # share of the periods that are as long as the one before


def simulate_hunting(loop: fc.Loop, day: fc.Boundary) -> xr.Dataset:
    """Simulate whether the loop hunts, its swing (K, peak to peak) and its period (s)."""
    return hunting_metrics(fc.simulate(loop, day, warm_up=WARM_UP_SECONDS))


def hunting_metrics(ds: xr.Dataset) -> xr.Dataset:
    """The metrics of days that stand still; ``regular``: it hunts, and two thirds of its periods are alike."""
    metrics = ds[["hunts", "hunting_swing", "hunting_period"]].reset_coords(drop=True)
    metrics = metrics.rename(hunting_swing="swing", hunting_period="period")
    is_regular = (ds.swing_regularity >= LEAST_REGULARITY).reset_coords(drop=True)
    return metrics.assign(regular=metrics.hunts * is_regular)


def loop_parameters(loop: fc.Loop, *names: str) -> xr.Dataset:
    """Parameters of a loop as a Dataset."""
    return xr.Dataset({name: xr.DataArray(loop[name]) for name in names}).reset_coords(drop=True)


def merge_results(loop: fc.Loop, day: fc.Boundary, metrics: xr.Dataset) -> xr.Dataset:
    """Merge properties, simulated metrics and tuning, over the dims of the loop and ``day``.

    predicted: ``hunts`` of ``fc.limit_cycle``, which counts the motor, the limits of the stroke and the curve, too.
    """
    tuning = loop_parameters(loop, "kp", "ti", "backlash")
    predicted = fc.limit_cycle(loop, day).hunts.reset_coords(drop=True).rename("predicted")
    return xr.merge([loop_properties(loop, day), predicted, metrics, tuning], compat="override")


def population(seed: int, size: int, days: int, wide: bool = False) -> xr.Dataset:
    """Loops in wet and dry cooling and in heating, at conditions of their own: (sample, day)."""
    loop, parts = valves(seed, size, wide), {}
    for kind in OPERATING_KINDS:
        kind_loop, day = adapt_to_kind(loop, kind), conditions(kind, seed + 1, days)
        parts[kind] = merge_results(kind_loop, day, simulate_hunting(kind_loop, day)).assign(
            overshoot=overshoot(kind_loop, kind, seed + 1, days)
        )
    return pool_days(parts, data_vars="all")


def overshoot(loop: fc.Loop, kind: str, seed: int, days: int) -> xr.DataArray:
    """Overshoot of a small set-point step without backlash, as a share of the step: (sample, day)."""
    series = conditions(kind, seed, days, HOURS_BEFORE_STEP + HOURS_AFTER_STEP).series
    sign = 1.0 if kind == HEATING else -1.0
    is_after_step = np.arange(series["T_set"].shape[1]) >= 3600 * HOURS_BEFORE_STEP
    day = fc.Boundary(
        **{**{n: series[n] for n in SERIES_NAMES}, "T_set": series["T_set"] + sign * STEP_SIZE * is_after_step}
    )
    T = fc.simulate(loop.assign(backlash=0.0), day, traces=["T_sup"], trace_interval=20, warm_up=0).T_sup
    T = T.isel(elapsed_time=slice(3600 * HOURS_BEFORE_STEP // 20, None)).drop_vars("day")
    target = xr.DataArray(series["T_set"][:, 0] + sign * STEP_SIZE, dims="day")
    return (sign * (T - target)).max("elapsed_time").reset_coords(drop=True) / STEP_SIZE


def population_on_days(seed: int, size: int, kind: str, seeds: range) -> xr.Dataset:
    """Other valves on days of a kind of ``days.py``, with noise: (sample, day); ``hunts`` is the metric."""
    loop = adapt_to_kind(valves(seed, size), kind)
    loop = loop.assign(noise_std=("sample", np.random.default_rng([seed, 7]).uniform(0.0, 0.05, size)))
    day = make_days(kind, seeds)
    return merge_results(loop, day, fc.simulate(loop, day, seed=seed)[["hunts"]].reset_coords(drop=True))


POWERS, DELAYS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0), (0.0, 1.0, 2.0, 3.0, 4.0)
"""Powers of kp K and multiples of theta that are tried."""
SAFE_SENSITIVITY = 0.995
"""Share of the loops that hunt which the safe form of a rule has to predict on the valves it is chosen on."""
CAUTIOUS_SENSITIVITY = 0.98  # such a share where the formula is used with a single step of the valve
MODEL_NAMES = ("K", "T", "theta")
MODEL_ERROR = 0.2  # by how much a log misleads about each of them, standard deviation


class Rule(NamedTuple):
    """Rule by which a loop hunts where ``indicator(ds)`` exceeds ``limit``; ``safe``: limit that misses hardly any."""

    name: str
    indicator: Callable[[xr.Dataset], xr.DataArray]
    limit: float
    safe: float


def integral_speed(ds: xr.Dataset, power: float, delays: float) -> xr.DataArray:
    """(kp K)^power (T + delays theta) / Ti: how fast the integral is against the plant."""
    return (ds.kp * ds.K) ** power * (ds["T"] + delays * ds.theta) / ds.ti


def candidate_indicators(power: float, delays: float) -> dict[str, Callable[[xr.Dataset], xr.DataArray]]:
    """Indicators that the rules use; large where the loop is near to hunting."""
    return {
        "hunting index of the describing function": lambda ds: ds.hunting_index,
        f"(kp K)^{power:g} (T + {delays:g} θ) / Ti": lambda ds: integral_speed(ds, power, delays),
        "kp K (T + 2 θ) / Ti": lambda ds: integral_speed(ds, 1.0, 2.0),
        "T / Ti": lambda ds: ds["T"] / ds.ti,
        "180° less phase margin": lambda ds: 180.0 - ds.phase_margin,
        "1 / gain margin": lambda ds: 1.0 / ds.gain_margin,
        "overshoot of a set-point step without backlash": lambda ds: ds.overshoot,
        "`fc.limit_cycle`: motor, stroke and curve, too": lambda ds: ds.predicted,
    }


def is_counted(ds: xr.Dataset) -> xr.DataArray:
    """Return the usable loops that have backlash."""
    return is_usable(ds) & (ds.backlash > 0.0)


def is_usable(ds: xr.Dataset) -> xr.DataArray:
    """Return the loops that reach their set-point and whose simulation did not fail."""
    return ds.reachable.astype(bool) & ds.hunts.notnull()


def fit_limits(indicator: xr.DataArray, hunts: xr.DataArray, among: xr.DataArray) -> tuple[float, float]:
    """Fit the limit with the best mean of sensitivity and specificity, and a safe one (``SAFE_SENSITIVITY``)."""
    is_used = among.values.ravel()
    x, h = (
        indicator.transpose(*among.dims).values.ravel()[is_used],
        hunts.transpose(*among.dims).values.ravel()[is_used] > 0.0,
    )
    order = np.argsort(x, kind="stable")
    x, h = x[order], h[order]
    sensitivity = np.concatenate([h[::-1].cumsum()[::-1], [0]]) / h.sum()
    specificity = np.concatenate([[0], (~h).cumsum()]) / (~h).sum()
    best = int(np.argmax(sensitivity + specificity))
    middle = 0.5 * (x[best - 1] + x[best])
    return float(middle), float(min(middle, np.quantile(x[h], 1.0 - SAFE_SENSITIVITY)))


def best_accuracy(indicator: xr.DataArray, hunts: xr.DataArray, among: xr.DataArray) -> float:
    """The best mean of sensitivity and specificity that any limit gives."""
    limit, _ = fit_limits(indicator, hunts, among)
    is_predicted, is_hunting = (indicator > limit), hunts > 0.0
    return 0.5 * float(
        is_predicted.where(among & is_hunting).mean() + (~is_predicted).where(among & ~is_hunting).mean()
    )


def choose_rules(ds: xr.Dataset) -> tuple[list[Rule], tuple[float, float]]:
    """Choose the limits of all rules from these valves; also power and delays of the formula."""
    among = is_counted(ds)
    power, delays = max(product(POWERS, DELAYS), key=lambda at: best_accuracy(integral_speed(ds, *at), ds.hunts, among))
    rules = [
        Rule(name, indicator, *(_round_limit(limit) for limit in fit_limits(indicator(ds), ds.hunts, among)))
        for name, indicator in candidate_indicators(power, delays).items()
    ]
    return rules, (power, delays)


def _round_limit(limit: float) -> float:
    """Round a limit to halves between 1 and 100, else to two digits."""
    return round(2.0 * limit) / 2.0 if 1.0 <= limit < 100.0 else float(f"{limit:.2g}")


def error_shares(ds: xr.Dataset, rule: Rule, among: xr.DataArray | None = None) -> tuple[str, str, str]:
    """Shares of the loops predicted right, of those that hunt and of those that do not, with intervals."""
    among = is_counted(ds) if among is None else among
    is_hunting = ds.hunts > 0.0
    is_right = (rule.indicator(ds) > rule.limit) == is_hunting
    all_share, hunting_share, calm_share = (
        share_or_dash(is_right, part) for part in (among, among & is_hunting, among & ~is_hunting)
    )
    return all_share, hunting_share, calm_share


def share_or_dash(holds: xr.DataArray, among: xr.DataArray, decimals: int = 1) -> str:
    """A share with its interval; a dash without any case."""
    return share_of(holds, among).to_text(decimals) if bool(among.any()) else "—"


def predict_from_one_step(ds: xr.Dataset, choose_condition: Callable[[xr.Dataset], xr.DataArray]) -> xr.Dataset:
    """Predict all conditions from one step of each valve and action; the condition of the step is excluded.

    choose_condition: the step is made where this is lowest among the conditions that the valve can hold.
    """
    is_heating_day, parts = np.array([HEATING in str(day) for day in ds.day.values]), []
    for is_heating in (False, True):
        part = ds.isel(day=np.flatnonzero(is_heating_day == is_heating))
        is_valid = is_usable(part)
        step_condition = choose_condition(part).where(is_valid, np.inf).argmin("day")
        model = {name: part[name].isel(day=step_condition).drop_vars("day", errors="ignore") for name in MODEL_NAMES}
        condition_index = xr.DataArray(np.arange(part.sizes["day"]), dims="day")
        predicted = part.assign({name: value.broadcast_like(part[name]) for name, value in model.items()})
        parts.append(
            predicted.assign(reachable=is_valid & (condition_index != step_condition.drop_vars("day", errors="ignore")))
        )
    return xr.concat(parts, "day", data_vars="all")


def with_model_errors(ds: xr.Dataset) -> xr.Dataset:
    """Multiply the model by random errors, independent for each valve, condition and number."""
    rng = np.random.default_rng(1)
    misread_model = {name: ds[name] * np.exp(rng.normal(0.0, MODEL_ERROR, ds[name].shape)) for name in MODEL_NAMES}
    return ds.assign(misread_model)


def first_condition(ds: xr.Dataset) -> xr.DataArray:
    """The first condition, as the seed draws them."""
    return xr.DataArray(np.arange(ds.sizes["day"]), dims="day").broadcast_like(ds.hunts)


def smallest_opening(ds: xr.Dataset) -> xr.DataArray:
    """The smallest opening."""
    return ds.opening


def cautious_limit(formula: Rule, ds: xr.Dataset) -> float:
    """Return the limit of the formula with ``CAUTIOUS_SENSITIVITY``, from a step at the smallest opening."""
    predicted = predict_from_one_step(ds, smallest_opening)
    return _round_limit(
        float(
            formula.indicator(predicted)
            .where(is_counted(predicted) & (predicted.hunts > 0.0))
            .quantile(1.0 - CAUTIOUS_SENSITIVITY)
        )
    )

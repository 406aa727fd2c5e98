"""Valves, loops and conditions of the study of hunting, what is known of them before simulation, and the rules.

A condition is air, water and set-point that stand still for a day: nothing but the loop itself can keep it swinging.
Each day starts with a cold plant and a closed valve, so every loop gets its kick.  A rule is a number that a loop has,
and a limit above which it is said to hunt; ``hunting_index`` and the margins of Bode require the plant, the others what a step
of the command shows: gain K, time constant T and dead time theta.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.design.describing_function import describing_function
from fastcoil.design.operating_points import OperatingPoints
from fastcoil.design.plants import Columns, Plants, loop_response
from fastcoil.model.metric_table import HUNTING_SWING_K, LEAST_HUNTING_PERIODS
from fastcoil.model.moist_air import humidity_ratio
from studies.common import HEATING_GAIN, loguniform, pooled, share_of
from studies.days import HEATING, of_kind, settings

LEAST_GAIN = 0.2
"""K per stroke: with less a valve changes nothing."""
FREQUENCIES = np.geomspace(3e-4, math.pi, 300)
"""rad/s."""


def foreseen(loop: fc.Loop, day: fc.Boundary) -> xr.Dataset:
    """The model K, T, theta, and margins, over the dims of the loop and ``day``, at the mean conditions of each day.

    K: K per unit of command.  T, theta: s, what an engineer reads from a step of the command, with the gap out of the
    way; half a sample time counts as dead time, since a sampled controller acts that much later on average.
    opening: where the valve rests.  hunting index: largest |L| |N|.  gain_margin.  phase_margin: degrees, 180 if |L| < 1.
    reachable: whether the valve holds the set-point and changes anything.
    """
    linear = fc.linearise(loop, day)
    X, ts = (xr.DataArray(loop[name]).reset_coords(drop=True) for name in ("backlash", "sample_time"))
    found = xr.Dataset(
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
    return found.reset_coords(drop=True)


def margins(loop: fc.Loop, day: fc.Boundary) -> xr.DataArray:
    """Largest |L| |N| over the frequencies at which L and a gap together lag 180 degrees; 0 if there are none.

    N: describing function of a gap, whose lag goes from 0 to 90 degrees as its input shrinks to the gap: Slotine
    and Li (1991), eq 5.21.  A cycle asks for 1.  Motor, limits of the stroke and the curve of the valve are left out;
    ``fc.limit_cycle`` has them.  Proportional to kp.
    """
    points = OperatingPoints(loop, day, None)
    return points.dataset({"hunting_index": (points.evaluate(_margin)["hunting_index"], {})}).hunting_index


def _margin(columns: Columns, _: Mapping[str, np.ndarray], plants: Plants) -> Iterator[tuple[str, np.ndarray]]:
    L = loop_response(columns, plants, FREQUENCIES)
    made = np.isfinite(L)  # there is none above half the sampling frequency
    left = np.pi + np.unwrap(np.where(made, np.angle(L), 0.0), axis=1)
    inside = made & (left > 0.0) & (left < 0.5 * np.pi)
    yield "hunting_index", np.where(inside, np.abs(L) * np.interp(left, *_GAP), 0.0).max(axis=1)


def gap(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lag, rad, and size of the describing function of a gap; depth: half the gap over the amplitude of its input."""
    N = describing_function(0.5 / depth, np.array(1.0), np.array(1.0))
    return -np.angle(N), np.abs(N)


_GAP = gap(np.linspace(1e-6, 1.0 - 1e-6, 2000))


WET, DRY = "wet cooling", "dry cooling"
OPERATING = (WET, DRY, HEATING)
HOURS, WARM_UP = 8, 3 * 3600
BACKLASH = (0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15)
SERIES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")
STEP, STEP_AT, STEP_LASTS = 0.3, 2, 1
"""Of the set-point, K; hours before and after it."""


def valves(seed: int, size: int, wide: bool = False) -> fc.Loop:
    """Valves and loops along ``sample``: a third to a half of them hunt.

    wide: other plants than those that the rules are chosen on: small and large coils, fast and slow sensors, motors and
    controllers, most of them beyond the ranges of the others.
    """
    draw = np.random.default_rng(seed)

    m_full = loguniform(draw, 0.8, 3.0, size) if wide else np.full(size, 1.7)
    drawn = {
        "backlash": draw.choice(BACKLASH, size),
        "rangeability": loguniform(draw, 20, 100, size),
        "authority": loguniform(draw, 0.05, 0.9, size),
        "C_w": m_full * loguniform(draw, 4.5, 15.0, size) if wide else draw.uniform(8.8, 14.0, size),
        "C_c": loguniform(draw, 8.0, 80.0, size) if wide else loguniform(draw, 10.0, 30.0, size),
        "m_full": m_full,
        "sample_time": draw.choice([1.0, 2.0, 20.0, 60.0] if wide else [5.0, 10.0, 15.0, 30.0], size),
        "sensor_time_constant": draw.uniform(0.0, 120.0, size) if wide else draw.uniform(5.0, 60.0, size),
        "stroke_time": draw.uniform(0.0, 300.0, size) if wide else draw.uniform(30.0, 150.0, size),
        "kp": loguniform(draw, 0.003, 0.2, size) if wide else loguniform(draw, 0.005, 0.15, size),
        "ti": loguniform(draw, 3.0, 600.0, size) if wide else loguniform(draw, 4.0, 300.0, size),
    }
    return fc.Loop.preset("lbnl").assign(**{name: ("sample", values) for name, values in drawn.items()})


def conditions(kind: str, seed: int, size: int, hours: int = HOURS) -> fc.Boundary:
    """Days on which air, water and set-point stand still, as the seed draws them."""
    draw = np.random.default_rng([seed, OPERATING.index(kind)])

    def uniform(low: float, high: float) -> np.ndarray:
        return draw.uniform(low, high, size)

    air, moist, water, T_set = {
        WET: ((23, 32), (0.5, 0.8), (5, 9), (12, 16)),
        DRY: ((20, 32), (0.1, 0.25), (5, 9), (12, 18)),
        HEATING: ((0, 18), (0.2, 0.4), (35, 60), (18, 28)),
    }[kind]
    T_a_in = uniform(*air)
    drawn = {"T_a_in": T_a_in, "W_a_in": humidity_ratio(T_a_in, uniform(*moist)), "T_w_in": uniform(*water),
             "T_set": uniform(*T_set), "m_a": uniform(0.6, 1.4)}  # fmt: skip
    still = {name: np.repeat(values[:, None], 3600 * hours, axis=1) for name, values in drawn.items()}
    return fc.Boundary(**still, day=list(range(size)))


def acting(loop: fc.Loop, kind: str) -> fc.Loop:
    """The loop as it is on such a day: the controller of a heating coil acts the other way, with less gain."""
    if kind != HEATING:
        return loop
    return loop.assign(kp=HEATING_GAIN * xr.DataArray(loop["kp"]), **settings(HEATING))


def simulated(loop: fc.Loop, day: fc.Boundary) -> xr.Dataset:
    """Whether the loop hunts at such conditions, how much (K, peak to peak) and with which period (s)."""
    return hunting_of(fc.simulate(loop, day, warm_up=WARM_UP))


def hunting_of(ds: xr.Dataset) -> xr.Dataset:
    """The metrics of days that stand still; ``regular`` is the metric ``hunts``, and ``hunts`` asks for less.

    Where nothing moves a swing need not be regular to be the loop's own: over 0.1 K in ``LEAST_HUNTING_PERIODS`` periods.
    """
    found = ds[["hunts", "hunting_swing", "hunting_period"]].reset_coords(drop=True)
    found = found.rename(hunts="regular", hunting_swing="swing", hunting_period="period")
    longest = (3600 * HOURS - WARM_UP) / LEAST_HUNTING_PERIODS
    own = (found.swing > HUNTING_SWING_K) & (found.period <= longest)
    return found.assign(hunts=own.astype(float).where(found.regular.notnull()))


def of_loop(loop: fc.Loop, *names: str) -> xr.Dataset:
    """Parameters of a loop as a Dataset."""
    return xr.Dataset({name: xr.DataArray(loop[name]) for name in names}).reset_coords(drop=True)


def both(loop: fc.Loop, day: fc.Boundary, found: xr.Dataset) -> xr.Dataset:
    """What is foreseen, what was simulated, and the tuning, over the dims of the loop and ``day``.

    predicted: ``hunts`` of ``fc.limit_cycle``, which counts the motor, the limits of the stroke and the curve, too.
    """
    tuning = of_loop(loop, "kp", "ti", "backlash")
    predicted = fc.limit_cycle(loop, day).hunts.reset_coords(drop=True).rename("predicted")
    return xr.merge([foreseen(loop, day), predicted, found, tuning], compat="override")


def population(seed: int, size: int, days: int, wide: bool = False) -> xr.Dataset:
    """Loops in wet and dry cooling and in heating, at conditions of their own: (sample, day)."""
    loop, parts = valves(seed, size, wide), {}
    for kind in OPERATING:
        one, day = acting(loop, kind), conditions(kind, seed + 1, days)
        parts[kind] = both(one, day, simulated(one, day)).assign(overshoot=overshoot(one, kind, seed + 1, days))
    return pooled(parts, data_vars="all")


def overshoot(loop: fc.Loop, kind: str, seed: int, days: int) -> xr.DataArray:
    """Overshoot of a small set-point step without backlash, as a share of the step: (sample, day)."""
    still = conditions(kind, seed, days, STEP_AT + STEP_LASTS).series
    sign = 1.0 if kind == HEATING else -1.0
    after = np.arange(still["T_set"].shape[1]) >= 3600 * STEP_AT
    day = fc.Boundary(**{**{n: still[n] for n in SERIES}, "T_set": still["T_set"] + sign * STEP * after})
    T = fc.simulate(loop.assign(backlash=0.0), day, traces=["T_sup"], trace_interval=20, warm_up=0).T_sup
    T = T.isel(elapsed_time=slice(3600 * STEP_AT // 20, None)).drop_vars("day")
    target = xr.DataArray(still["T_set"][:, 0] + sign * STEP, dims="day")
    return (sign * (T - target)).max("elapsed_time").reset_coords(drop=True) / STEP


def on_days(seed: int, size: int, kind: str, seeds: range) -> xr.Dataset:
    """Other valves on days of a kind of ``days.py``, with noise: (sample, day); ``hunts`` is the metric."""
    loop = acting(valves(seed, size), kind)
    loop = loop.assign(noise_std=("sample", np.random.default_rng([seed, 7]).uniform(0.0, 0.05, size)))
    day = of_kind(kind, seeds)
    return both(loop, day, fc.simulate(loop, day, seed=seed)[["hunts"]].reset_coords(drop=True))


POWERS, DELAYS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0), (0.0, 1.0, 2.0, 3.0, 4.0)
"""Powers of kp K and multiples of theta that are tried."""
SURE = 0.995
"""Share of the loops that hunt which the safe form of a rule has to predict on the valves it is chosen on."""
FEW = 0.98
"""The same where the formula is used with a single step of the valve."""
MODEL = ("K", "T", "theta")
MISREAD = 0.2
"""By how much a log misleads about each of them, standard deviation."""


class Rule(NamedTuple):
    """A loop hunts where ``of(ds)`` exceeds ``limit``; ``safe`` is the limit that misses hardly any."""

    name: str
    of: Callable[[xr.Dataset], xr.DataArray]
    limit: float
    safe: float


def speed(ds: xr.Dataset, power: float, delays: float) -> xr.DataArray:
    """(kp K)^power (T + delays theta) / Ti: how fast the integral is against the plant."""
    return (ds.kp * ds.K) ** power * (ds["T"] + delays * ds.theta) / ds.ti


def candidates(power: float, delays: float) -> dict[str, Callable[[xr.Dataset], xr.DataArray]]:
    """What each rule looks at; large where the loop is near to hunting."""
    return {
        "hunting index of the describing function": lambda ds: ds.hunting_index,
        f"(kp K)^{power:g} (T + {delays:g} θ) / Ti": lambda ds: speed(ds, power, delays),
        "kp K (T + 2 θ) / Ti": lambda ds: speed(ds, 1.0, 2.0),
        "T / Ti": lambda ds: ds["T"] / ds.ti,
        "180° less phase margin": lambda ds: 180.0 - ds.phase_margin,
        "1 / gain margin": lambda ds: 1.0 / ds.gain_margin,
        "overshoot of a set-point step without backlash": lambda ds: ds.overshoot,
        "`fc.limit_cycle`: motor, stroke and curve, too": lambda ds: ds.predicted,
    }


def counted(ds: xr.Dataset) -> xr.DataArray:
    """Loops with backlash that reach their set-point and whose simulation did not fail."""
    return able(ds) & (ds.backlash > 0.0)


def able(ds: xr.Dataset) -> xr.DataArray:
    """The same with those that have no backlash."""
    return ds.reachable.astype(bool) & ds.hunts.notnull()


def limits(found: xr.DataArray, hunts: xr.DataArray, among: xr.DataArray) -> tuple[float, float]:
    """The limit with the best mean of sensitivity and specificity, and one that predicts ``SURE`` of what hunts."""
    use = among.values.ravel()
    x, h = found.transpose(*among.dims).values.ravel()[use], hunts.transpose(*among.dims).values.ravel()[use] > 0.0
    order = np.argsort(x, kind="stable")
    x, h = x[order], h[order]
    caught = np.concatenate([h[::-1].cumsum()[::-1], [0]]) / h.sum()
    calm = np.concatenate([[0], (~h).cumsum()]) / (~h).sum()
    at = int(np.argmax(caught + calm))
    middle = 0.5 * (x[at - 1] + x[at])
    return float(middle), float(min(middle, np.quantile(x[h], 1.0 - SURE)))


def quality(found: xr.DataArray, hunts: xr.DataArray, among: xr.DataArray) -> float:
    """The best mean of sensitivity and specificity that any limit gives."""
    limit, _ = limits(found, hunts, among)
    said, true = (found > limit), hunts > 0.0
    return 0.5 * float(said.where(among & true).mean() + (~said).where(among & ~true).mean())


def chosen(ds: xr.Dataset) -> tuple[list[Rule], tuple[float, float]]:
    """All rules with the limits that these valves ask for; power and delays of the formula."""
    among = counted(ds)
    power, delays = max(product(POWERS, DELAYS), key=lambda at: quality(speed(ds, *at), ds.hunts, among))
    rules = [
        Rule(name, of, *(_rounded(limit) for limit in limits(of(ds), ds.hunts, among)))
        for name, of in candidates(power, delays).items()
    ]
    return rules, (power, delays)


def _rounded(limit: float) -> float:
    """As one remembers it: tens of degrees, halves between 1 and 100, else two digits."""
    return round(2.0 * limit) / 2.0 if 1.0 <= limit < 100.0 else float(f"{limit:.2g}")


def errors(ds: xr.Dataset, rule: Rule, among: xr.DataArray | None = None) -> tuple[str, str, str]:
    """Shares of the loops predicted right, of those that hunt and of those that do not, with intervals."""
    among = counted(ds) if among is None else among
    true = ds.hunts > 0.0
    right = (rule.of(ds) > rule.limit) == true
    every, hunting, calm = (share_written(right, part) for part in (among, among & true, among & ~true))
    return every, hunting, calm


def share_written(holds: xr.DataArray, among: xr.DataArray, decimals: int = 1) -> str:
    """A share with its interval; a dash without any case."""
    return share_of(holds, among).written(decimals) if bool(among.any()) else "—"


def by_one_step(ds: xr.Dataset, place: Callable[[xr.Dataset], xr.DataArray]) -> xr.Dataset:
    """The same, foreseen from one step of each valve and action; the condition of the step no longer counts.

    place: the step is made where this is lowest among the conditions that the valve can hold.
    """
    heating, parts = np.array([HEATING in str(day) for day in ds.day.values]), []
    for action in (False, True):
        part = ds.isel(day=np.flatnonzero(heating == action))
        ok = able(part)
        step = place(part).where(ok, np.inf).argmin("day")
        model = {name: part[name].isel(day=step).drop_vars("day", errors="ignore") for name in MODEL}
        at = xr.DataArray(np.arange(part.sizes["day"]), dims="day")
        read = part.assign({name: value.broadcast_like(part[name]) for name, value in model.items()})
        parts.append(read.assign(reachable=ok & (at != step.drop_vars("day", errors="ignore"))))
    return xr.concat(parts, "day", data_vars="all")


def misread(ds: xr.Dataset) -> xr.Dataset:
    """The same with a model that is wrong, by another factor for each valve, condition and number."""
    draw = np.random.default_rng(1)
    wrong = {name: ds[name] * np.exp(draw.normal(0.0, MISREAD, ds[name].shape)) for name in MODEL}
    return ds.assign(wrong)


def any_place(ds: xr.Dataset) -> xr.DataArray:
    """The first condition, as the seed draws them."""
    return xr.DataArray(np.arange(ds.sizes["day"]), dims="day").broadcast_like(ds.hunts)


def smallest(ds: xr.Dataset) -> xr.DataArray:
    """The smallest opening."""
    return ds.opening


def cautious(formula: Rule, ds: xr.Dataset) -> float:
    """The limit with which the formula predicts ``FEW`` of what hunts, from a step at the smallest opening."""
    one = by_one_step(ds, smallest)
    return _rounded(float(formula.of(one).where(counted(one) & (one.hunts > 0.0)).quantile(1.0 - FEW)))

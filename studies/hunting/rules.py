"""Rules that tell whether a loop will hunt: chosen on some valves and conditions, judged on others.

A rule is a number that a loop has, and a limit above which it is said to hunt.  ``margin`` and the margins of Bode want
the plant; the others want what a step of the command shows: gain K, time constant T and dead time theta.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.study.analysis.paired import share_of
from studies.days import HEATING

POWERS, DELAYS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0), (0.0, 1.0, 2.0, 3.0, 4.0)
"""Powers of kp K and multiples of theta that are tried."""
SURE = 0.995
"""Share of the loops that hunt which the safe form of a rule has to foretell on the valves it is chosen on."""
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
        "margin of the describing function": lambda ds: ds.margin,
        f"(kp K)^{power:g} (T + {delays:g} θ) / Ti": lambda ds: speed(ds, power, delays),
        "kp K (T + 2 θ) / Ti": lambda ds: speed(ds, 1.0, 2.0),
        "T / Ti": lambda ds: ds["T"] / ds.ti,
        "180° less phase margin": lambda ds: 180.0 - ds.phase_margin,
        "1 / gain margin": lambda ds: 1.0 / ds.gain_margin,
        "overshoot of a set-point step without backlash": lambda ds: ds.overshoot,
        "`fc.limit_cycle`: motor, stroke and curve, too": lambda ds: ds.foretold,
    }


def counted(ds: xr.Dataset) -> xr.DataArray:
    """Loops with backlash that reach their set-point and whose simulation did not fail."""
    return able(ds) & (ds.backlash > 0.0)


def able(ds: xr.Dataset) -> xr.DataArray:
    """The same with those that have no backlash."""
    return ds.reachable.astype(bool) & ds.hunts.notnull()


def limits(found: xr.DataArray, hunts: xr.DataArray, among: xr.DataArray) -> tuple[float, float]:
    """The limit with the best mean of sensitivity and specificity, and one that foretells ``SURE`` of what hunts."""
    use = among.values.ravel()
    x, h = found.transpose(*among.dims).values.ravel()[use], hunts.transpose(*among.dims).values.ravel()[use] > 0.0
    order = np.argsort(x, kind="stable")
    x, h = x[order], h[order]
    told = np.concatenate([h[::-1].cumsum()[::-1], [0]]) / h.sum()
    calm = np.concatenate([[0], (~h).cumsum()]) / (~h).sum()
    at = int(np.argmax(told + calm))
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
    """Shares of the loops told right, of those that hunt and of those that do not, with intervals."""
    among = counted(ds) if among is None else among
    true = ds.hunts > 0.0
    right = (rule.of(ds) > rule.limit) == true
    every, hunting, calm = (written(right, part) for part in (among, among & true, among & ~true))
    return every, hunting, calm


def written(holds: xr.DataArray, among: xr.DataArray, decimals: int = 1) -> str:
    """A share with its interval; a dash where there is nobody to ask."""
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
        told = part.assign({name: value.broadcast_like(part[name]) for name, value in model.items()})
        parts.append(told.assign(reachable=ok & (at != step.drop_vars("day", errors="ignore"))))
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
    """The limit with which the formula foretells ``FEW`` of what hunts, from a step at the smallest opening."""
    one = by_one_step(ds, smallest)
    return _rounded(float(formula.of(one).where(counted(one) & (one.hunts > 0.0)).quantile(1.0 - FEW)))

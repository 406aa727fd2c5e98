"""Rules that tell whether a loop will hunt: chosen on some valves and conditions, judged on others.

A rule is a number that a loop has, and a limit above which it is said to hunt.  ``margin`` and the margins of Bode want
the plant; the others want what a step of the command shows: gain K, time constant T and dead time theta.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr
from kinds import HEATING
from report import write_table
from shares import share_of

POWERS, DELAYS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0), (0.0, 1.0, 2.0, 3.0, 4.0)
"""Powers of kp K and multiples of theta that are tried."""
SURE = 0.995
"""Share of the loops that hunt which the safe form of a rule has to foretell on the valves it is chosen on."""
LINEAR = "1 / gain margin above 1"
MODEL = ("K", "T", "theta")


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
        "describing function: largest \\|L\\|\\|N\\|": lambda ds: ds.margin,
        f"(kp K)^{power:g} (T + {delays:g} θ) / Ti": lambda ds: speed(ds, power, delays),
        "kp K (T + 2 θ) / Ti": lambda ds: speed(ds, 1.0, 2.0),
        "T / Ti": lambda ds: ds["T"] / ds.ti,
        "180° less phase margin": lambda ds: 180.0 - ds.phase_margin,
        "1 / gain margin": lambda ds: 1.0 / ds.gain_margin,
        "overshoot of a set-point step without backlash": lambda ds: ds.overshoot,
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
        if "overshoot" not in name or "overshoot" in ds
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


def any_place(ds: xr.Dataset) -> xr.DataArray:
    """The first condition, as the seed draws them."""
    return xr.DataArray(np.arange(ds.sizes["day"]), dims="day").broadcast_like(ds.hunts)


def write_one_step(rules: list[Rule], ds: xr.Dataset) -> None:
    """Write how good the formula is where the step was made elsewhere."""
    formula = rules[1]
    given = {
        "where it works": ds,
        "anywhere": by_one_step(ds, any_place),
        "at the smallest opening": by_one_step(ds, lambda of: of.opening),
        "at the largest opening": by_one_step(ds, lambda of: -of.opening),
    }
    table = []
    for name, found in given.items():
        safe = formula._replace(limit=formula.safe)
        table.append([name, *errors(found, formula), errors(found, safe)[1], errors(found, safe)[2]])
    write_table(
        "hunting_one_step",
        f"The formula from a single step of each valve, for all its other conditions: {ds.sizes['sample']:,} fresh loops "
        f"× {ds.sizes['day']} conditions",
        ["the step was made", f"limit {formula.limit:g}: right", "of those that hunt", "of the calm",
         f"limit {formula.safe:g}: of those that hunt", "of the calm"],
        table,
    )  # fmt: skip


def write_errors(rules: list[Rule], found: Mapping[str, xr.Dataset]) -> None:
    """Write the error rates of all rules; ``found``: fresh valves, and other plants."""
    (fresh, ds), *others = found.items()
    table = []
    for rule in rules:
        row = [rule.name, f"{rule.limit:g}", *errors(ds, rule)]
        row += [errors(other, rule)[0] if "overshoot" not in rule.name else "—" for _, other in others]
        table.append(row)
    among = counted(ds)
    write_table(
        "hunting_rules",
        f"Rules for hunting on {fresh}: {ds.sizes['sample']:,} loops × {ds.sizes['day']} conditions, of which "
        f"{int(among.sum()):,} can hold their set-point and {share_of(ds.hunts > 0, among)} hunt; shares with 95 % "
        "intervals over valves and conditions",
        ["what it looks at", "hunts above", "told right", "of those that hunt", "of those that are calm",
         *(f"told right, {name}" for name, _ in others)],
        table,
    )  # fmt: skip


def write_by_backlash(rules: list[Rule], ds: xr.Dataset) -> None:
    """Write how often the margin and the formula are right at each size of backlash, and stability without any."""
    table, linear = [], Rule(LINEAR, lambda at: 1.0 / at.gain_margin, 1.0, 1.0)
    for size in np.unique(ds.backlash):
        part = ds.isel(sample=np.flatnonzero(ds.backlash.isel(day=0) == size))
        row = [f"{size:.0%}", share_of(part.hunts > 0, able(part)).written(0)]
        for rule in (*rules[:2], linear):
            row += errors(part, rule, able(part))[:2]
        table.append(row)
    of = [f"{name}: {what}" for name in ("margin", "formula", LINEAR) for what in ("right", "of those that hunt")]
    write_table(
        "hunting_by_backlash",
        f"The same by backlash: {ds.sizes['sample']:,} fresh loops × {ds.sizes['day']} conditions",
        ["backlash", "hunt", *of],
        table,
    )


def write_practice(rules: list[Rule], ds: xr.Dataset) -> None:
    """Write what happens to those who obey a rule of thumb, and to those who do not."""
    formula = rules[1]
    of_two = rules[2]
    given = {
        "Ti ≥ T": ds.ti >= ds["T"],
        "Ti ≥ T / 2": ds.ti >= 0.5 * ds["T"],
        f"Ti ≥ kp K (T + 2 θ) / {of_two.safe:g}": of_two.of(ds) <= of_two.safe,
        f"Ti ≥ {formula.name.removesuffix(' / Ti')} / {formula.safe:g}": formula.of(ds) <= formula.safe,
        f"Ti ≥ {formula.name.removesuffix(' / Ti')} / {formula.limit:g}": formula.of(ds) <= formula.limit,
        f"margin ≤ {rules[0].safe:g}": ds.margin <= rules[0].safe,
    }
    among, hunts, table = counted(ds), ds.hunts > 0.0, []
    for name, obeys in given.items():
        table.append(
            [
                name,
                written(obeys, among, 0),
                written(hunts, among & obeys),
                written(hunts, among & ~obeys, 0),
                written(~obeys, among & ~hunts, 0),
            ]
        )
    write_table(
        "hunting_practice",
        f"Rules of thumb: what becomes of those who obey; {ds.sizes['sample']:,} fresh loops × {ds.sizes['day']} "
        "conditions",
        ["rule", "obey", "hunt although they obey", "hunt of those that do not", "calm loops that it forbids"],
        table,
    )


def write_days(rules: list[Rule], found: Mapping[str, xr.Dataset]) -> None:
    """Write the error rates on days on which air, water and set-point move."""
    table = []
    for kind, ds in found.items():
        among = counted(ds)
        row = [kind, f"{int(among.sum()):,}", str(share_of(ds.hunts > 0, among))]
        for rule in rules[:2]:
            row += errors(ds, rule)
        table.append(row)
    of = [
        f"{name}: {what}" for name in ("margin", "formula") for what in ("right", "of those that hunt", "of the calm")
    ]
    write_table(
        "hunting_days",
        "The same limits on days with noise on which air, water and set-point move, foreseen from the means of the day",
        ["days", "loops × days", "hunt", *of],
        table,
    )

"""The tables of ``hunting_rules.py``: error rates on fresh valves, other plants and other days, and rules of thumb."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from fastcoil.study.analysis.paired import share_of
from studies.common import write_table
from studies.hunting.rules import (
    MISREAD,
    Rule,
    able,
    any_place,
    by_one_step,
    counted,
    errors,
    misread,
    smallest,
    written,
)

SHOWN = ("margin", "formula", "`fc.limit_cycle`")


def write_one_step(formula: Rule, limit: float, ds: xr.Dataset) -> None:
    """Write how good the formula is where the step was made elsewhere; limit: see ``cautious``."""
    given = {
        "where it works": ds,
        f"where it works, K, T and θ off by {MISREAD:.0%}": misread(ds),
        "anywhere": by_one_step(ds, any_place),
        "at the smallest opening": by_one_step(ds, smallest),
        "at the largest opening": by_one_step(ds, lambda of: -of.opening),
    }
    table = []
    for name, found in given.items():
        more = errors(found, formula._replace(limit=limit))
        table.append([name, *errors(found, formula), *more[1:]])
    write_table(
        "hunting/hunting_one_step",
        f"The formula from a single step of each valve, for all its other conditions: {ds.sizes['sample']:,} fresh "
        f"loops × {ds.sizes['day']} conditions",
        ["the step was made", f"limit {formula.limit:g}: right", "of those that hunt", "of the calm",
         f"limit {limit:g}: of those that hunt", "of the calm"],
        table,
    )  # fmt: skip


def write_errors(rules: list[Rule], found: Mapping[str, xr.Dataset]) -> None:
    """Write the error rates of all rules; ``found``: fresh valves, and other plants."""
    (fresh, ds), *others = found.items()
    table = []
    for rule in rules:
        row = [rule.name, f"{rule.limit:g}", *errors(ds, rule)]
        row += [errors(other, rule)[0] for _, other in others]
        table.append(row)
    among = counted(ds)
    write_table(
        "hunting/hunting_rules",
        f"Rules for hunting on {fresh}: {ds.sizes['sample']:,} loops × {ds.sizes['day']} conditions, of which "
        f"{int(among.sum()):,} can hold their set-point and {share_of(ds.hunts > 0, among)} hunt; shares with 95 % "
        "intervals over valves and conditions",
        ["what it looks at", "hunts above", "told right", "of those that hunt", "of those that are calm",
         *(f"told right, {name}" for name, _ in others)],
        table,
    )  # fmt: skip


def write_by_backlash(rules: list[Rule], ds: xr.Dataset) -> None:
    """Write how often the margin, the formula and ``fc.limit_cycle`` are right at each size of backlash."""
    table = []
    for size in np.unique(ds.backlash):
        part = ds.isel(sample=np.flatnonzero(ds.backlash.isel(day=0) == size))
        row = [f"{size:.0%}", share_of(part.hunts > 0, able(part)).written(0)]
        for rule in (*rules[:2], rules[-1]):
            row += errors(part, rule, able(part))[:2]
        table.append(row)
    of = [f"{name}: {what}" for name in SHOWN for what in ("right", "of those that hunt")]
    write_table(
        "hunting/hunting_by_backlash",
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
        "hunting/hunting_practice",
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
        for rule in (*rules[:2], rules[-1]):
            row += errors(ds, rule)
        table.append(row)
    of = [f"{name}: {what}" for name in SHOWN for what in ("right", "of those that hunt", "of the calm")]
    write_table(
        "hunting/hunting_days",
        "The same limits on days with noise on which air, water and set-point move, foreseen from the means of the day",
        ["days", "loops × days", "hunt", *of],
        table,
    )

"""Kinds of days on which a claim is judged: set-points that step, as the paper's, or stand still, and design days.

Days of all kinds with the same seed share air flow, water and noise, so that a claim is compared day by day.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fastcoil.loops.boundary.days import design_day, paper_day
from fastcoil.loops.boundary.record import Boundary

Days = Callable[[float, Sequence[int]], Boundary]
"""Makes a day of so many hours from each seed."""

T_SET = 14.0
"""Where the set-point stands still, °C."""
EXTREME = (33.3, 23.7)
"""Dry and wet bulb of a design day, °C: those of ``design_day``."""
MILDER = (0.0, 6.0)
"""By how much a design day is milder than the extreme, K: limits of what the seed draws."""
OUTDOOR_FRACTIONS = (0.2, 0.6)
"""Limits of the share of outdoor air that the seed draws."""
_STREAM = 20
"""Tells these draws from others with the same seed."""


def stepped(hours: float, seeds: Sequence[int]) -> Boundary:
    """Days as the paper's, with set-point steps every 30 min."""
    return paper_day(hours=hours, seed=list(seeds))


def constant(hours: float, seeds: Sequence[int]) -> Boundary:
    """The same days with a constant set-point."""
    return replaced(stepped(hours, seeds), seeds)


def design(hours: float, seeds: Sequence[int]) -> Boundary:
    """Outdoor air of a design day, milder than the extreme and mixed as the seed draws, and a constant set-point."""
    air = []
    for seed in seeds:
        draw = np.random.default_rng([seed, _STREAM])
        milder, fraction = draw.uniform(*MILDER), draw.uniform(*OUTDOOR_FRACTIONS)
        T_design, T_wet_bulb = (T - milder for T in EXTREME)
        air.append(design_day(hours=hours, T_design=T_design, T_wet_bulb=T_wet_bulb, outdoor_fraction=fraction))
    return replaced(stepped(hours, seeds), seeds, air)


def replaced(days: Boundary, seeds: Sequence[int], air: Sequence[Boundary] = ()) -> Boundary:
    """The days with a constant set-point and, if given, with the entering air of other days, one for each seed."""
    series = dict(days.series)
    series["T_set"] = np.full_like(series["m_a"], T_SET)
    for name in ("T_a_in", "W_a_in") if air else ():
        series[name] = np.concatenate([day.series[name] for day in air])
    return Boundary(**series, day=list(seeds))


KINDS: Mapping[str, Days] = {"stepped": stepped, "constant": constant, "design": design}
"""Kinds of days by name, the paper's first."""


def words(days: Days) -> str:
    """What a kind of days is, from its docstring."""
    return (days.__doc__ or "").strip().splitlines()[0].rstrip(".")

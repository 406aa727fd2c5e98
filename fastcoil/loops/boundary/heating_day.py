"""A heating day with something to do: the counterpart of ``paper_day`` for a heating coil."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fastcoil.base.arguments import checking, plain
from fastcoil.loops.boundary.conditions import condition_of, whole_seconds
from fastcoil.loops.boundary.days import SET_POINT_HOLD, distinct_seeds, require_memory, stepped_set_point, swing
from fastcoil.loops.boundary.drift import Drift, drifts_of
from fastcoil.loops.boundary.record import Boundary

WARMER = 11.0
"""Set-points above those of `paper_day`, K."""
W_IN = 0.0035
"""Humidity ratio of the mixed air of a winter day, kg/kg; a heating coil stays dry whatever it is."""
DRIFTS = {"m_a": Drift(0.015, 60), "T_a_in": Drift(0.20, 120), "T_w_in": Drift(0.3, 300)}
"""Noise of `heating_day`.  The order numbers the random streams: add at the end only."""


def heating_day(hours: float = 8.0, seed: int | Iterable[int] = 1, *, T_w_in: float = 60.0) -> Boundary:
    """A heating day: set-point steps every half hour, slow swings, smooth noise.

    Air 0.9 + 0.2 D kg/s, 12 + 2 D degC, with D(h) = sin(pi (h - 1)/9) up to h = 8 hours from the start, mirrored
    there and at every further multiple of 8 h: with 30 % of outdoor air and return air of 21 degC that is -11 to
    -2 degC outdoors.  Water T_w_in + sin(2 pi h/1.5) degC.  Each carries noise as in `DRIFTS`.  Set-points from 23 to
    27 degC.  Nobody measured this day: it is a generic one, as `paper_day` is for cooling.

    Parameters
    ----------
    hours
        Length, a whole number of seconds.  A shorter day is the beginning of a longer one, to the bit.
    seed
        Whole number from 0 to 2**32 - 1 for the noise; several give a dim ``day`` with the seeds as labels.
    T_w_in
        Mean temperature of the entering water [degC].
    """
    seed = plain(seed)
    with checking() as check:
        n_steps = check(whole_seconds, hours)
        seeds = check(distinct_seeds, seed, n_steps or SET_POINT_HOLD)
        T_w_in = check(condition_of, "T_w_in", T_w_in)
    require_memory(len(seeds), n_steps)
    h = np.arange(n_steps) / 3600
    D, noise = swing(h), drifts_of(DRIFTS, seeds, n_steps)
    several = not isinstance(seed, int)
    rows = slice(None) if several else 0
    return Boundary(
        m_a=(0.9 + 0.2 * D + noise["m_a"])[rows],
        T_a_in=(12.0 + 2.0 * D + noise["T_a_in"])[rows],
        W_a_in=W_IN,
        T_w_in=(T_w_in + np.sin(2 * np.pi * h / 1.5) + noise["T_w_in"])[rows],
        T_set=stepped_set_point(n_steps) + WARMER,
        day=seeds if several else seeds[0],
    )

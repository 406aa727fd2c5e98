"""What a linear model of the loop foretells at the operating points of a day."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index
from fastcoil.design.explanation.operating_points import PointsOfDay
from fastcoil.design.theory.cycles import Cycles, cycles_of
from fastcoil.design.theory.margins import margins_of
from fastcoil.design.theory.plants import Plants, plants_of
from fastcoil.design.theory.tunings import first_order, simc
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import columns_of

UNSURE = (0.7, 1.0)
"""Margins between which theory does not decide."""
SAFE = 0.7
"""Margin that a cure has to reach."""


class Foretold(NamedTuple):
    """A loop at the operating points of a day.

    plants: linear models of valve and coil.  cycles: margin, hunts, period and amplitude, (n_points,) each.
    worst: the point with the largest margin among those at which the set-point can be reached and theory has one; -1 if
    there is none.
    """

    points: PointsOfDay
    plants: Plants
    cycles: Cycles
    worst: int

    @property
    def reached(self) -> Index:
        """The operating points at which the valve can hold the set-point, and theory has a margin."""
        return np.flatnonzero(self.plants.reachable & np.isfinite(self.cycles.margin))

    @property
    def margin(self) -> float:
        """Largest margin of the day; NaN if no set-point can be reached."""
        return float(self.cycles.margin[self.worst]) if self.worst >= 0 else math.nan

    @property
    def hunts(self) -> bool:
        """Whether the loop is foretold to hunt at some operating point."""
        return self.n_hunting > 0

    @property
    def hunting(self) -> Index:
        """The operating points at which it is foretold to hunt."""
        return self.reached[self.cycles.hunts[self.reached] > 0.0]

    @property
    def elsewhere(self) -> Index:
        """The others at which theory has a margin."""
        return self.reached[~(self.cycles.hunts[self.reached] > 0.0)]

    @property
    def n_hunting(self) -> int:
        """How many these are."""
        return int(self.hunting.size)


def foretell(loop: Loop, points: PointsOfDay) -> Foretold:
    """Linearise one loop at the operating points of a day and look for its cycles.

    Parameters
    ----------
    loop
        A single scenario.
    points
        Of one day.
    """
    columns = columns_of(without_dead_band(loop), {}, np.zeros(points.size, dtype=np.int64))
    plants = plants_of(columns, points.conditions)
    cycles = cycles_of(columns, plants)
    found = Foretold(points, plants, cycles, -1)
    reached = found.reached
    return found._replace(worst=int(reached[np.argmax(cycles.margin[reached])])) if reached.size else found


def cycles_at(loop: Loop, plants: Plants, which: Index) -> Cycles:
    """Cycles of every scenario of a sweep at some operating points, (n_scenarios, n_points) each.

    The sweep may change the controller and the backlash, which leave the plants as they are.
    """
    n = math.prod(loop.sizes.values())
    columns = columns_of(without_dead_band(loop), loop.sizes, np.repeat(np.arange(n), which.size))
    found = cycles_of(columns, picked(plants, np.tile(which, n)))
    return Cycles(*(values.reshape(n, which.size) for values in found))


def margins(loop: Loop, plants: Plants, which: Index) -> Array:
    """Their margins alone."""
    return cycles_at(loop, plants, which).margin


def without_dead_band(loop: Loop) -> Loop:
    """Theory knows no dead band: it foretells what the loop does without one, and that is told."""
    return loop.assign(error_dead_band=0.0)


def picked(plants: Plants, which: Index) -> Plants:
    """Some of the plants, in any order, some perhaps several times."""
    fields: Any = (values[which] for values in plants)
    return Plants(*fields)


def gain_margin_without_backlash(loop: Loop, foretold: Foretold) -> float:
    """By how much the kp of one loop may be multiplied behind a perfect valve, where it is worst; below 1 it swings."""
    columns = columns_of(loop, {}, np.zeros(1, dtype=np.int64)) | {"backlash": np.zeros(1)}
    return float(margins_of(columns, picked(foretold.plants, np.array([foretold.worst]))).gain_margin[0])


def simc_gains(loop: Loop, foretold: Foretold) -> tuple[float, float] | None:
    """kp and ti after SIMC for one loop where it is worst; None where the valve changes nothing."""
    columns = columns_of(loop, {}, np.zeros(1, dtype=np.int64))
    plant = picked(foretold.plants, np.array([foretold.worst]))
    gains = simc(columns, plant, first_order(columns, plant))
    found = float(gains.kp[0]), float(gains.ti[0])
    return found if all(map(math.isfinite, found)) else None

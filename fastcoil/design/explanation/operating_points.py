"""The operating points of a day: the mean conditions of every hour at every set-point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError
from fastcoil.loops.boundary import Boundary

CONDITIONS = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")
"""Series that decide an operating point."""
SAME_SET_POINT = 0.5
"""Set-points of an hour that differ by less may count as one, K."""
SHORTEST = 300
"""Seconds that an hour must spend at a set-point before it counts as an operating point of its own."""


class PointsOfDay(NamedTuple):
    """Operating points of a day, in the order of time.

    start, seconds: (n,) first second, and how many the point stands for.  conditions: name → (n,) means.
    of_second: (n_steps,), number of the point that a second belongs to; -1 for none.
    """

    start: Index
    seconds: Index
    conditions: dict[str, Array]
    of_second: Index

    @property
    def size(self) -> int:
        return self.start.size


def operating_points(boundary: Boundary, warm_up: int, at: int | None = None) -> PointsOfDay:
    """Operating points of a boundary of one day.

    Parameters
    ----------
    boundary
        A single day.
    warm_up
        Seconds at the start that do not count, nor do those in which the plant is off.
    at
        A second: only the conditions there.

    Raises
    ------
    InputError
        If the plant is off all day, or at that second.
    """
    series = {name: boundary.series[name][0] for name in CONDITIONS}
    on = boundary.series["enabled"][0] > 0.0
    if at is not None:
        if not on[at]:
            raise InputError(f"at = {at}: the plant is off at that second, give one at which it runs")
        only = np.where(np.arange(on.size) == at, 0, -1)
        return PointsOfDay(np.array([at]), np.array([1]), {n: v[at : at + 1].copy() for n, v in series.items()}, only)
    counted = np.flatnonzero(on & (np.arange(on.size) >= warm_up))
    if not counted.size:
        raise InputError("the loop is off all day: take a day on which it is enabled")
    level = np.round(series["T_set"][counted] / SAME_SET_POINT)
    _, member = np.unique(np.stack([counted // 3600, level]), axis=1, return_inverse=True)
    member = member.reshape(-1)
    seconds = np.bincount(member)
    start = np.full(seconds.size, on.size)
    np.minimum.at(start, member, counted)
    means = {n: np.bincount(member, v[counted]) / seconds for n, v in series.items()}
    long = seconds >= min(SHORTEST, int(seconds.max()))
    order = np.flatnonzero(long)[np.argsort(start[long])]
    number = np.full(seconds.size, -1)
    number[order] = np.arange(order.size)
    of_second = np.full(on.size, -1)
    of_second[counted] = number[member]
    return PointsOfDay(start[order], seconds[order], {n: v[order] for n, v in means.items()}, of_second)

"""The valves and days that a tuning is made on, and those that it is tried on afterwards."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from itertools import islice
from typing import Any, NamedTuple, cast

import numpy as np
import xarray as xr

from fastcoil.base.arguments import is_number, plain
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import columns_of

ONE_OF = 3
"""One valve of so many is held out, and one day."""
VALVE, TUNING = "sample", "tuning"
"""Dim of the population once its own dims are flattened; dim of the tunings that it is tried with."""


class Group(NamedTuple):
    """Valves on days; ``members`` are the valves' flat positions in the loop's own dims."""

    loop: Loop
    boundary: Boundary
    members: tuple[int, ...]

    @property
    def words(self) -> str:
        valves, days = len(self.members), self.boundary.n_days
        return f"{valves:,} valve{'s' * (valves > 1)} × {days:,} day{'s' * (days > 1)}"


def n_valves(loop: Loop) -> int:
    """Members of the population: all combinations of the loop's dims."""
    return int(np.prod(list(loop.sizes.values()), dtype=int))


def held_valves(backlash: np.ndarray, seed: int) -> np.ndarray:
    """One of every three valves, drawn, in the order of their backlash (n,); sorted positions.

    So both groups have good valves and bad ones alike; what is left over at the end is not held out.
    """
    order = np.argsort(backlash, kind="stable")
    threes = order[: order.size // ONE_OF * ONE_OF].reshape(-1, ONE_OF)
    drawn = np.random.default_rng([seed, 1]).integers(0, ONE_OF, threes.shape[0])
    return np.sort(threes[np.arange(threes.shape[0]), drawn])


def part_of(loop: Loop, members: np.ndarray) -> Loop:
    """These members of the population, along one dim."""
    if not loop.sizes:
        return loop
    columns = columns_of(loop, loop.sizes, members)
    return loop.assign(**{name: (VALVE, columns[name]) for name in loop.swept})


def days_of(boundary: Boundary, rows: np.ndarray) -> Boundary:
    """Some days of a boundary, by position."""
    return boundary.isel(day=rows)


def split_days(boundary: Boundary, holdout: object) -> tuple[Boundary, Boundary]:
    """The days to tune on, and those held out: another boundary, labels of days, or by default the last third."""
    n = boundary.n_days
    if isinstance(holdout, Boundary):
        _require_comparable(boundary, holdout)
        return boundary, days_of(holdout, np.arange(holdout.n_days))
    if holdout is None:
        if n < 2:
            raise InputError(
                "boundary is a single day, so that none is left to hold out: give several days, such as "
                "paper_day(seed=[1, 2, 3]), or others with holdout=…"
            )
        held = np.arange(n - max(1, n // ONE_OF), n)
    else:
        held = _labelled(boundary, holdout)
    kept = np.setdiff1d(np.arange(n), held)
    return days_of(boundary, kept), days_of(boundary, held)


def _labelled(boundary: Boundary, holdout: object) -> np.ndarray:
    cure = "give a Boundary of other days, or labels of some days of the boundary, such as [3, 4]"
    listed = isinstance(holdout, (list, tuple, range)) or (isinstance(holdout, np.ndarray) and holdout.ndim == 1)
    # one label more than there are days tells all: a range may have no end to speak of
    labels = [plain(label) for label in islice(cast("Iterable[Any]", holdout), boundary.n_days + 1)] if listed else []
    if not labels or not all(map(is_number, labels)):
        raise InputError(WrongType(f"holdout = {shown(holdout)}: {cure}"))
    known = boundary.day.tolist()
    unknown = [label for label in labels if label not in known]
    if unknown:
        raise InputError(f"holdout: the boundary has no day {shown(unknown[0])}; it has {shown(known)}")
    held = np.array(sorted({known.index(label) for label in labels}))
    if held.size == boundary.n_days:
        raise InputError(f"holdout has all {held.size} days of the boundary: leave some to tune on")
    return held


def _require_comparable(boundary: Boundary, holdout: Boundary) -> None:
    if holdout.n_steps != boundary.n_steps:
        raise InputError(
            f"holdout lasts {holdout.hours:g} h, boundary {boundary.hours:g} h: give days as long, since travel adds up"
        )
    before = {_digest(boundary, k): boundary.day[k] for k in range(boundary.n_days)}
    for k in range(holdout.n_days):
        same = before.get(_digest(holdout, k))
        if same is not None:
            raise InputError(
                f"holdout: its day {holdout.day[k]} is day {same} of the boundary: give days that it does not have"
            )


def _digest(boundary: Boundary, k: int) -> bytes:
    digest = hashlib.sha256()
    for values in boundary.of_day(k).values():
        digest.update(values.tobytes())
    return digest.digest()


def split(loop: Loop, boundary: Boundary, holdout: object, seed: int) -> tuple[Group, Group]:
    """The valves and days to tune on, and others to try the tuning on; with fewer than three valves the same ones."""
    n = n_valves(loop)
    tuned_on, tried_on = split_days(boundary, holdout)
    backlash = np.broadcast_to(columns_of(loop, loop.sizes, np.arange(n))["backlash"], n)
    held = held_valves(backlash, seed)
    everyone = np.arange(n)
    kept, held = (np.setdiff1d(everyone, held), held) if held.size else (everyone, everyone)
    return (
        Group(part_of(loop, kept), tuned_on, tuple(kept.tolist())),
        Group(part_of(loop, held), tried_on, tuple(held.tolist())),
    )


def has_good_valve(loop: Loop) -> bool:
    """Whether a valve without backlash is in the population."""
    return bool(np.any(np.asarray(xr.DataArray(loop["backlash"])) == 0.0))

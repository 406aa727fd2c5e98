"""Shards: the units of work, each a set of scenarios that one worker runs.

Independent days are cut anywhere.  Days that are a sequence are cut into chains: a group of
lanes (one loop and replicate each) on one stretch of days after the other, each begun in the state in which the one
before ended.

A simulation cut into the shards with which its run begins.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.loops.plan import Plan
from fastcoil.model.engine.rows import LANES

END_STATE = "end_state"
"""Variable of a flat part, (lane, number): the state that its lanes carry over, see ``fastcoil.model.engine.lanes``."""


@dataclass(frozen=True)
class Shard:
    """Scenarios of independent days.

    index: (n,), their flat indices, ascending.
    """

    index: np.ndarray

    def __getstate__(self) -> dict[str, Any]:
        """Compressed: a pipe takes 64 KiB, and a longer write waits for a reader that may be dead."""
        return {"index": pack(self.index)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__["index"] = unpack(state["index"])

    @property
    def size(self) -> int:
        return self.index.size

    @property
    def lost(self) -> np.ndarray:
        """Flat indices of all that cannot be run if this shard cannot."""
        return self.index

    def halves(self) -> list[Shard]:
        """Smaller shards with the same scenarios."""
        return [Shard(half) for half in np.array_split(self.index, 2)]

    def includes(self, other: Shard | Stretch) -> bool:
        """Whether another shard, which comes after one of its halves, is part of it."""
        return False

    def after(self, part: xr.Dataset) -> Stretch | None:
        """The shard that follows this one, given its results: none."""
        return None


@dataclass(frozen=True)
class Stretch:
    """A group of lanes on consecutive days, which other stretches of its chain follow; otherwise like a ``Shard``.

    lanes: (n,), positions among the scenarios of a day, ascending.  of: number of scenarios of a day.  end: the day
    before which the chain ends.  length: most days of a stretch.  begins: (n_lanes, n), the state in which its lanes
    begin; ``None`` on the first day.
    """

    lanes: np.ndarray
    of: int
    days: range
    end: int
    length: int
    begins: np.ndarray | None = field(default=None, repr=False)

    @classmethod
    def starting(
        cls, first: int, lanes: np.ndarray, of: int, end: int, length: int, begins: np.ndarray | None = None
    ) -> Stretch:
        """The stretch that starts on day ``first``."""
        return cls(lanes, of, range(first, min(first + length, end)), end, length, begins)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"lanes": pack(self.lanes)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"lanes": unpack(state["lanes"])})

    def on(self, days: range) -> np.ndarray:
        """Flat indices of its lanes on some days, ascending."""
        return np.asarray(np.arange(days.start, days.stop)[:, np.newaxis] * self.of + self.lanes).ravel()

    @property
    def index(self) -> np.ndarray:
        return self.on(self.days)

    @property
    def size(self) -> int:
        return self.lanes.size * len(self.days)

    @property
    def lost(self) -> np.ndarray:
        return self.on(range(self.days.start, self.end))

    @property
    def n_in_chain(self) -> int:
        """Number of stretches from this one to the end."""
        return 1 - (self.days.stop - self.end) // self.length

    def halves(self) -> list[Stretch]:
        """Two groups of lanes; of a single lane, the first half of the days, which the rest comes after."""
        if self.lanes.size == 1:
            return [replace(self, days=self.days[: len(self.days) // 2])]
        return [
            replace(self, lanes=self.lanes[half], begins=None if self.begins is None else self.begins[half])
            for half in np.array_split(np.arange(self.lanes.size), 2)
        ]

    def includes(self, other: Shard | Stretch) -> bool:
        return isinstance(other, Stretch) and other.days.start in self.days

    def after(self, part: xr.Dataset) -> Stretch | None:
        """The next stretch; ``part``: the results of this one."""
        return self.begun(part[END_STATE].values) if self.days.stop < self.end else None

    def begun(self, state: np.ndarray) -> Stretch:
        """The next stretch; ``state``: in which this one ended."""
        return Stretch.starting(self.days.stop, self.lanes, self.of, self.end, self.length, state)


def pack(index: np.ndarray) -> bytes:
    """Ascending indices in few bytes."""
    return zlib.compress(np.diff(index.astype(np.int64), prepend=0).tobytes())


def unpack(packed: bytes) -> np.ndarray:
    """Inverse of ``pack``."""
    return np.cumsum(np.frombuffer(zlib.decompress(packed), np.int64))


class Reached:
    """How far the chains of a sequence have been run, and the states that they ended in.

    of: number of scenarios of a day.
    """

    def __init__(self, of: int) -> None:
        self._of = of
        self._through = np.zeros(of, dtype=np.int64)
        self.day = np.zeros(of, dtype=np.int64)
        """Of each lane the last day, plus 1, at whose end its state is known."""
        self.states: dict[int, np.ndarray] = {}
        """State of a lane there."""

    @classmethod
    def of(cls, plan: Plan) -> Reached:
        """Nothing has been run of a plan."""
        return cls(plan.n_scenarios // len(plan.days))

    def take(self, part: xr.Dataset) -> None:
        """Note the results of a stretch; those of earlier days come first."""
        index = part["scenario"].values
        first, end = int(index[0]) // self._of, int(index[-1]) // self._of + 1
        lanes = index[index // self._of == first] % self._of
        follows = self._through[lanes] >= first
        going_on = lanes[follows]
        self._through[going_on] = np.maximum(self._through[going_on], end)
        if END_STATE not in part or part[END_STATE].shape[0] != lanes.size:
            return
        for lane, state in zip(going_on.tolist(), part[END_STATE].values[follows], strict=True):
            if self.day[lane] < end:
                self.day[lane], self.states[lane] = end, state


def first_shards(
    plan: Plan, n_jobs: int, todo: np.ndarray | None = None, reached: Reached | None = None
) -> list[Shard | Stretch]:
    """The shards that can start immediately; where days are a sequence, others follow.

    todo: flat indices of the scenarios to run, ascending; all by default.  reached: where to go on, from the first day
    on by default.  Days between that and the first to run are run again.
    """
    if not plan.carry_over:
        return [Shard(index) for index in plan.shards(n_jobs, todo)]
    of = plan.n_scenarios // len(plan.days)
    if todo is None:
        chains = [(0, len(plan.days), np.arange(of))]
    else:
        chains = _chains(todo, of, np.zeros(of, dtype=np.int64) if reached is None else reached.day)
    most, days = plan.chain_limits(n_jobs, sum(-(-lanes.size // LANES) for *_, lanes in chains))
    found: list[Shard | Stretch] = []
    for first, end, lanes in chains:
        n_groups = -(-lanes.size // most)
        for group in np.split(lanes, _edges(lanes.size, n_groups)):
            begins = None if first == 0 or reached is None else _stacked([reached.states[k] for k in group.tolist()])
            found.append(Stretch.starting(first, group, of, end, days, begins))
    return found


def _chains(todo: np.ndarray, of: int, reached: np.ndarray) -> list[tuple[int, int, np.ndarray]]:
    """First day, end and lanes of what is to be run, ``of`` scenarios a day."""
    end = np.zeros(of, dtype=np.int64)
    np.maximum.at(end, todo % of, todo // of + 1)
    lanes = np.flatnonzero(end)
    ways, way_of = np.unique(np.stack([reached[lanes], end[lanes]]), axis=1, return_inverse=True)
    return [(int(first), int(last), lanes[way_of.ravel() == k]) for k, (first, last) in enumerate(ways.T)]


def _edges(n: int, n_groups: int) -> np.ndarray:
    """Where ``n`` lanes are cut into groups of whole blocks, about equal."""
    n_blocks = -(-n // LANES)
    return np.arange(1, n_groups) * n_blocks // n_groups * LANES


def _stacked(states: list[np.ndarray]) -> np.ndarray:
    """States as rows; lanes of another kind may have shorter ones."""
    found = np.zeros((len(states), max(state.size for state in states)))
    for row, state in zip(found, states, strict=True):
        row[: state.size] = state
    return found

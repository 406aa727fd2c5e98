"""Shards: the scenarios that one worker runs at once.

Days that have nothing to do with each other are cut anywhere.  Days that are a sequence are cut into chains: a group of
lanes (one loop and replicate each) on one stretch of days after the other, each begun in the state in which the one
before ended.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr

END_STATE = "end_state"
"""Of a flat part, (lane, number): what its lanes carry over; no result, see ``fastcoil.model.engine.carried``."""


@dataclass(frozen=True)
class Shard:
    """Scenarios whose days have nothing to do with each other.

    index: (n,), their flat indices, ascending.
    """

    index: np.ndarray

    def __getstate__(self) -> bytes:
        """Few bytes: a pipe takes 64 KiB, and who writes more waits for a reader that may be dead."""
        return pack(self.index)

    def __setstate__(self, state: bytes) -> None:
        object.__setattr__(self, "index", unpack(state))

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
        """What can be run when this shard is done, with these results: nothing that could not be run before."""
        return None


@dataclass(frozen=True)
class Chain:
    """What the stretches of a group of lanes have in common.

    lanes: (n,), positions among the scenarios of a day, ascending.  of: number of scenarios of a day.  end: the day
    before which the chain ends.  length: most days of a stretch.
    """

    lanes: np.ndarray
    of: int
    end: int
    length: int

    def __getstate__(self) -> tuple[bytes, int, int, int]:
        return pack(self.lanes), self.of, self.end, self.length

    def __setstate__(self, state: tuple[bytes, int, int, int]) -> None:
        for name, value in zip(("lanes", "of", "end", "length"), (unpack(state[0]), *state[1:]), strict=True):
            object.__setattr__(self, name, value)

    def index(self, days: range) -> np.ndarray:
        """Flat indices of its lanes on some days."""
        return np.asarray(np.arange(days.start, days.stop)[:, np.newaxis] * self.of + self.lanes).ravel()

    def stretch(self, first: int, begins: np.ndarray | None) -> Stretch:
        """The stretch that starts on day ``first``."""
        return Stretch(self, range(first, min(first + self.length, self.end)), begins)


@dataclass(frozen=True)
class Stretch:
    """A group of lanes on consecutive days; in everything else like a ``Shard``.

    begins: (n_lanes, n), the state in which its lanes begin; ``None`` on the first day.
    """

    chain: Chain
    days: range
    begins: np.ndarray | None = field(repr=False)

    @property
    def index(self) -> np.ndarray:
        """Flat indices, ascending."""
        return self.chain.index(self.days)

    @property
    def size(self) -> int:
        return self.chain.lanes.size * len(self.days)

    @property
    def lost(self) -> np.ndarray:
        return self.chain.index(range(self.days.start, self.chain.end))

    @property
    def n_in_chain(self) -> int:
        """Number of stretches from this one to the end."""
        return 1 - (self.days.stop - self.chain.end) // self.chain.length

    def halves(self) -> list[Stretch]:
        """Two groups of lanes; of a single lane, the first half of the days, which the rest comes after."""
        lanes, begins = self.chain.lanes, self.begins
        if lanes.size == 1:
            return [replace(self, days=self.days[: len(self.days) // 2])]
        return [
            Stretch(replace(self.chain, lanes=lanes[half]), self.days, None if begins is None else begins[half])
            for half in np.array_split(np.arange(lanes.size), 2)
        ]

    def includes(self, other: Shard | Stretch) -> bool:
        return isinstance(other, Stretch) and other.days.start in self.days

    def after(self, part: xr.Dataset) -> Stretch | None:
        """The next stretch; ``part``: the results of this one."""
        return self.begun(part[END_STATE].values) if self.days.stop < self.chain.end else None

    def begun(self, state: np.ndarray) -> Stretch:
        """The next stretch; ``state``: in which this one ended."""
        return self.chain.stretch(self.days.stop, state)


def pack(index: np.ndarray) -> bytes:
    """Ascending indices in few bytes."""
    return zlib.compress(np.diff(index.astype(np.int64), prepend=0).tobytes())


def unpack(packed: bytes) -> np.ndarray:
    """What was packed."""
    return np.cumsum(np.frombuffer(zlib.decompress(packed), np.int64))

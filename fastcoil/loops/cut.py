"""A simulation cut into the shards with which its run begins."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fastcoil.loops.plan import Plan
from fastcoil.loops.shards import END_STATE, Chain, Shard, Stretch
from fastcoil.model.engine.rows import LANES


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
    """The shards that can be run at once; where days are a sequence, others come after them.

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
            found.append(Chain(group, of, end, days).stretch(first, begins))
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

"""Plants of the user at rest, and their responses to a small step of the opening: found by running them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.model.engine.at_rest import OPENING_STEP
from fastcoil.model.engine.lanes import Block, UserRules, run_sets, work_space
from fastcoil.model.engine.plant import respond_to_step
from fastcoil.model.engine.rows import LANES

_SETTLING_TIMES_S = (7200, 57600, 460800)  # that a plant is given to come to rest, one after the other
_WATCHED_S = 600  # at the end of which a plant has rested
_REST_CHANGE_K = 1e-7  # in that time, up to which it has


class PlantAtRest(NamedTuple):
    """A plant of the user at rest at its set-point; numbers are NaN where it does not come to rest."""

    opening: float  # that holds the set-point, or the end of the stroke that comes nearest
    T: float  # °C, what leaves there
    gain: float  # K per unit opening
    is_reachable: bool
    response: Array  # (n_steps,), K per unit opening, to a step of the opening, from second 1 on
    curve: Array  # (n,), °C, what leaves at rest at each of the openings that were asked for


@dataclass(frozen=True)
class _OwnPlant:
    """One plant under constant conditions.  matrix: (rows, 1), see ``parameter_matrix``; entering: see CONDITIONS."""

    matrix: Array
    rules: UserRules
    entering: Array

    def run(self, before: Array, after: Array, times: tuple[int, int]) -> Array:
        """Temperatures after a step between openings, (n,), up to LANES; times: seconds before, and after it."""
        held = [np.resize(part, LANES) for part in (before, after)]

        def run_block(block: Block, _: Array) -> list[Array]:
            work, T = work_space(block), np.empty((times[1], LANES))
            state = work.S, work.V, work.plant_state
            respond_to_step(block.rows, block.config, self.entering, *held, times[0], *state, T)
            return [T]

        (T,) = run_sets(np.repeat(self.matrix, LANES, axis=1), run_block, self.rules)
        return np.asarray(T.T[: before.size])

    def temperatures(self, openings: Array) -> tuple[Array, int]:
        """Temperatures at rest, (n,), and the seconds in which all rest; NaN where one does not."""
        for seconds in _SETTLING_TIMES_S:
            T = self.run(openings, openings, (seconds - _WATCHED_S, _WATCHED_S))
            if (np.ptp(T, axis=1) <= _REST_CHANGE_K).all():
                return T[:, -1], seconds
        return np.full(openings.size, np.nan), _SETTLING_TIMES_S[0]


def rest_plant(
    matrix: Array, rules: UserRules, entering: Array, T_set: float, openings: Array, n_steps: int
) -> PlantAtRest:
    """Find where a plant of the user rests, its curve over ``openings``, and its response for ``n_steps`` s."""
    plant = _OwnPlant(matrix, rules, np.ascontiguousarray(entering))
    curve, seconds = plant.temperatures(openings)
    if np.isnan(curve).any():
        return PlantAtRest(np.nan, np.nan, np.nan, False, np.full(n_steps, np.nan), curve)
    opening, is_reachable = openings[int(np.argmin(np.abs(curve - T_set)))], False
    grid, T = openings, curve
    for _ in range(4):  # each time 63 times as fine
        crossing = np.flatnonzero((T[:-1] - T_set) * (T[1:] - T_set) <= 0.0)
        if not crossing.size or T[crossing[0]] == T[crossing[0] + 1]:
            break
        k, is_reachable = crossing[0], True
        opening = grid[k] + (T_set - T[k]) / (T[k + 1] - T[k]) * (grid[k + 1] - grid[k])
        grid = np.linspace(grid[k], grid[k + 1], LANES)
        T, _ = plant.temperatures(grid)
    first = opening + OPENING_STEP if opening + OPENING_STEP <= 1.0 else opening - OPENING_STEP
    sides = np.array([first, min(max(2.0 * opening - first, 0.0), 1.0)])
    at_opening = np.full(2, opening)
    ends = plant.run(at_opening, sides, (seconds, n_steps))
    T_rest, _ = plant.temperatures(np.array([opening, *sides]))
    width = sides[0] - sides[1]
    return PlantAtRest(
        float(opening), float(T_rest[0]), float((T_rest[1] - T_rest[2]) / width), is_reachable,
        (ends[0] - ends[1]) / width, curve,
    )  # fmt: skip

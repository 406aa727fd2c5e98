"""Where motor and stem stood while a log was written, for many candidate sizes of the backlash at once."""

from __future__ import annotations

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.model.engine import recorded


def motor_positions(command: Array, most_travel: float) -> Array:
    """Motor position at each sample, just before the command of that sample acts, and one sample after the last.

    command: fraction of stroke, held from sample to sample; most_travel: fraction of stroke between two samples.  The
    motor stands at the first command when the log begins.
    """
    positions = np.empty(command.size + 1)
    recorded.motor_positions(np.ascontiguousarray(command, float), most_travel, positions)
    return positions


def openings(positions: Array, backlash: Array) -> Array:
    """Opening behind each candidate backlash, Eq (1), at each position: (positions, candidates).

    Nobody knows where the stem stood when the log began; it starts in the middle of its play.
    """
    least = positions[:, np.newaxis] - backlash
    q = np.clip(positions[0] - backlash / 2.0, 0.0, 1.0 - backlash)
    found = np.empty_like(least)
    for k, position in enumerate(positions):
        np.maximum(q, least[k], out=q)
        np.minimum(q, position, out=q)
        found[k] = q
    return found / (1.0 - backlash)


def mean_openings(positions: Array, backlash: Array, width: int) -> tuple[Array, Array]:
    """Mean opening behind each candidate backlash and the mean of its square: (pieces, candidates) each.

    A piece is ``width`` intervals between positions; the last that is not complete is left out.
    """
    openings = np.empty(((positions.size - 1) // width, backlash.size))
    squares = np.empty_like(openings)
    recorded.mean_openings(positions, np.ascontiguousarray(backlash, float), width, openings, squares)
    return openings, squares


def turns(positions: Array, least: float) -> int:
    """How often the motor turns and then comes back by more than ``least`` (fraction of stroke)."""
    count, direction, extreme = 0, 0, float(positions[0])
    for position in positions.tolist():
        back = (position - extreme) * (direction or 1)
        if (direction == 0 and abs(back) > least) or (direction != 0 and back < -least):
            count += direction != 0
            direction = 1 if position > extreme else -1
            extreme = position
        elif direction != 0 and back > 0.0:
            extreme = position
    return count

"""What the commands of a log say about the controller: what moved them, and whether the columns fit in time."""

from __future__ import annotations

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask

LEAST_SET_POINT_CHANGE, LEAST_SET_POINT_CHANGES = 0.3, 2
USUAL, JUMP, LEAST_JUMPS, APART = 0.9, 4.0, 3, 600.0
"""What a change of the command leaves unexplained is a jump if it exceeds this quantile of all that many times.  A
start-up makes some, so that three are asked for, these many seconds apart."""
FEWEST, CLOSED = 40, 1e-3
TO_AND_FRO = 0.01
"""Of the stroke: what a command moves one way and at once back again, sample by sample."""
FARTHEST, EXPLAINED, CLEARER = 4, 0.8, 3.0
"""Samples by which columns are moved at most; a shift is told where the control law explains that share of the
variance with it, and leaves so many times less of it than without."""


def is_provoked(command: Array, temperature: Array, good: Mask, T_set: Array | None, interval: float) -> bool:
    """Whether the set-point changed; where the log has none, whether the command jumped as it does then.

    A PI controller answers temperatures alone: its command changes by a linear function of the last temperatures and
    their changes.  What a robust fit of that leaves is 0 but for changes of the set-point, and the like.
    """
    if T_set is not None:
        changed = np.abs(np.diff(np.asarray(T_set, float)))[good[1:] & good[:-1]]
        return bool(np.sum(changed >= LEAST_SET_POINT_CHANGE) >= LEAST_SET_POINT_CHANGES)
    at = np.flatnonzero(np.diff(command) != 0.0) + 1
    if at.size < FEWEST:
        return False
    now, before, long_before = at[2:], at[1:-1], at[:-2]
    bad_before = np.concatenate([[0], np.cumsum(~good)])
    whole = bad_before[now + 1] == bad_before[long_before]
    for end in (now, before):  # a command at its end does not follow the law
        whole &= (command[end] > CLOSED) & (command[end] < 1.0 - CLOSED)
    now, before, long_before = now[whole], before[whole], long_before[whole]
    if now.size < FEWEST:
        return False
    last, one_before = temperature[now] - temperature[before], temperature[before] - temperature[long_before]
    X = np.stack([last, one_before, temperature[now], np.ones(now.size)], axis=1)
    left = np.abs(_left(X, command[now] - command[before]))
    jumps = now[left > JUMP * np.quantile(left, USUAL)]
    return jumps.size > 0 and 1 + int(np.sum(np.diff(jumps) * interval > APART)) >= LEAST_JUMPS


def share_to_and_fro(command: Array, good: Mask) -> float:
    """Share of the samples at which the command moves back what it moved the sample before, or more than it.

    An inverse that chatters does so, and a controller that answers noise.  Where a log shows much of it, the stem may
    have moved between its samples unseen.
    """
    moved = np.diff(command)
    both = good[2:] & good[1:-1] & good[:-2]
    turns = (moved[1:] * moved[:-1] < 0.0) & (np.minimum(np.abs(moved[1:]), np.abs(moved[:-1])) > TO_AND_FRO)
    return float(np.mean(turns[both])) if both.any() else 0.0


def arrivals(command: Array, good: Mask) -> int:
    """How often the command arrives at one of its ends."""
    at_end = (command <= CLOSED) | (command >= 1.0 - CLOSED)
    return int(np.sum(at_end[1:] & ~at_end[:-1] & good[1:] & good[:-1]))


def late(command: Array, temperature: Array, good: Mask) -> int:
    """By how many samples the temperatures stand too late beside the commands; negative: too early; 0 if not sure.

    The change of a command minus the one before is a linear function of temperatures of the same samples.  The lag
    that explains it best tells: a command cannot answer a temperature to come.
    """
    changed = np.flatnonzero(np.diff(command) != 0.0) + 1
    changed = changed[(changed > 2 * FARTHEST) & (changed < command.size - FARTHEST)]
    if changed.size < FEWEST:
        return 0
    first, middle, last = changed[:-2], changed[1:-1], changed[2:]
    even = (middle - first == last - middle) & (last - middle <= 2 * FARTHEST)
    whole = np.concatenate([[0], np.cumsum(~good)])
    even &= first >= FARTHEST
    even &= whole[np.minimum(last + FARTHEST + 1, command.size)] == whole[np.maximum(first - FARTHEST, 0)]
    first, middle, last = first[even], middle[even], last[even]
    if first.size < FEWEST:
        return 0
    moved = command[last] - 2.0 * command[middle] + command[first]
    left = {s: _share_left(moved, temperature, first + s, middle + s, last + s) for s in range(-FARTHEST, FARTHEST + 1)}
    best = min(left, key=lambda s: left[s])
    return best if left[best] <= 1.0 - EXPLAINED and CLEARER * left[best] < left[0] else 0


def _share_left(moved: Array, temperature: Array, first: Index, middle: Index, last: Index) -> float:
    """Share of the variance of second differences of the command that temperatures at these samples leave."""
    change = temperature[last] - temperature[middle]
    left = _left(np.stack([change - (temperature[middle] - temperature[first]), change * (last - middle)], 1), moved)
    usual = np.abs(left) <= np.quantile(np.abs(left), USUAL)
    return float(np.sum(left[usual] ** 2) / max(np.sum(moved[usual] ** 2), 1e-300))


def _left(X: Array, y: Array) -> Array:
    """What a linear model leaves, fitted without the largest tenth of what it leaves."""
    solved = np.linalg.lstsq(X, y, rcond=None)[0]
    for _ in range(3):
        left = np.abs(y - X @ solved)
        usual = left <= np.quantile(left, USUAL)
        solved = np.linalg.lstsq(X[usual], y[usual], rcond=None)[0]
    return np.asarray(y - X @ solved)

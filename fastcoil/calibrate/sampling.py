"""Whether the rows of a log are close enough together: a controller may move the valve between them, unseen."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.arrays import Array
from fastcoil.calibrate.closed_loop import bias_of
from fastcoil.calibrate.valve_problem import LOGS, X_BL, ValveProblem, ValveSolution
from fastcoil.calibrate.valve_record import step_of, why_unidentified

_LEAST_MOVING = 0.4
"""A controller may move the valve between the rows where the command changes at this share of them."""
_STILL = 2e-3
"""Smaller changes of the command are none."""
_AT_AN_END = 0.01
"""A command this close to 0 or 1 may rest there while the valve still travels."""
_FEWEST_STILL = 20
_OF_METER = 1.5
"""Residuals up to this many times the meter's own noise leave nothing to motion between the rows."""
_TINY, _SMALL, _BY_PLAY = 0.04, 0.12, 0.5
"""So little of the flow's change from row to row is left as a residual, that motion between them leaves more.

The second holds if the backlash explains more than half of the residual that there is without it.
"""
_CURE = (
    "log every 10 s, or at least as often as the controller acts; if the command holds from row to row, "
    "say so: holds='command', --hold command"
)


class Judged(NamedTuple):
    """The 95 % interval of the backlash; why it is not identified, empty if it is; a note, empty if there is none."""

    interval: tuple[float, float]
    why: str
    note: str


def judged(problem: ValveProblem, solution: ValveSolution, holds: bool) -> Judged:
    """What remains of the interval of a fit if motion between the rows is allowed for; ``holds``: there is none."""
    interval, x = solution.profile.interval, float(solution.estimate.x[X_BL])
    why = why_unidentified(problem.n_reversals, x, interval, solution.profile.grid[-1])
    if why or holds or not _may_hide(problem, solution):
        return Judged(interval, why, "")
    step = step_of(problem.data, problem.fitting)
    curve = solution.estimate.x[1:5].copy()
    curve[[k - 1 for k in LOGS]] = np.exp(curve[[k - 1 for k in LOGS]])
    fitting = problem.fitting
    bias = bias_of(
        problem.command[fitting],
        np.where(problem.good, problem.flow, np.nan)[fitting],
        problem.batch[fitting],
        step,
        curve,
    )
    if bias is None:
        return Judged(interval, "", "")
    seen = f"rows are {step:g} s apart, and a controller moves the valve between them, unseen"
    if math.isnan(bias.low):
        return Judged(
            interval, f"not identified: {seen}: no simulated loop with this valve moves as this log does; {_CURE}", ""
        )
    low, high = min(interval[0], bias.low), max(interval[1], bias.high)
    least, most = bias.shares
    shown = f"such loops, simulated with this valve and logged as coarsely, show {least:.2g} to {most:.2g} of theirs"
    if why_unidentified(problem.n_reversals, x, (low, high), solution.profile.grid[-1]):
        true = f"a backlash of {low:.2g} to {high:.2g} may lie behind the {x:.2g} found"
        return Judged((low, high), f"not identified: {seen}: {true}; {shown}; {_CURE}", "")
    return Judged((low, high), "", f"{seen}: {shown}; the interval of the backlash allows for that; {_CURE}")


def _may_hide(problem: ValveProblem, solution: ValveSolution) -> bool:
    """Whether the command moves at most rows, and the residuals are more than the meter's noise."""
    n = problem.n_fit
    command, batch = problem.command[:n], problem.batch[:n]
    flow = np.where(problem.good & problem.fitting, problem.flow, np.nan)[:n]
    same_piece = np.diff(batch) == 0
    moves = np.abs(np.diff(command)) > _STILL
    if not same_piece.any() or moves[same_piece].mean() < _LEAST_MOVING:
        return False
    n_compared = max(int(solution.model.used.sum()), 1)
    left, plain = (math.sqrt(one.rss / n_compared) for one in (solution.estimate, solution.without_backlash))
    changes = np.diff(flow)[same_piece]
    change = math.sqrt(float(np.nanmean(changes**2))) if np.isfinite(changes).any() else 0.0
    if left < _TINY * change or (left < _SMALL * change and left < _BY_PLAY * plain):
        return False
    noise = _noise(command, np.where(flow > problem.floor, flow, np.nan), ~moves & same_piece)
    return not left <= _OF_METER * noise


def _noise(command: Array, flow: Array, still: Array) -> float:
    """Standard deviation of the meter's noise where the command rests for three rows, kg/s; 0 if it hardly does.

    Two equal commands may be chance: the valve may have moved between them.
    """
    inner = (command[1:-1] > _AT_AN_END) & (command[1:-1] < 1.0 - _AT_AN_END)
    changes = np.diff(flow)[1:][still[1:] & still[:-1] & inner]
    changes = changes[np.isfinite(changes)]
    if changes.size < _FEWEST_STILL:
        return 0.0
    return float(np.median(np.abs(changes))) / 0.6745 / math.sqrt(2.0)

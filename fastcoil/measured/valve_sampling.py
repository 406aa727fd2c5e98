"""Whether the rows of a log are close enough together for the backlash that fits it to be believed.

Between two rows a controller may move the valve and turn it back, unseen.  What that leaves in the residuals, beside
the noise of the meter, widens the interval of the backlash; where it is much, the backlash is not identified.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.valve_problem import X_BL, ValveProblem, ValveSolution, step_of, why_unidentified

_LEAST_MOVING = 0.4  # a controller may move the valve between the rows where the command changes at this share of them
_STILL = 2e-3  # smaller changes of the command are none
_AT_AN_END = 0.01  # a command this close to 0 or 1 may rest there while the valve still travels
_FEWEST_STILL = 20
_BESIDES_NOISE = 0.5
"""Where the square of the residual, less the meter's noise, is more than this share of what the backlash explains, it
may all be motion between the rows."""
_PER_SHARE, _SLACK = 0.6, 0.002
"""Below that the interval is widened by so much of the backlash for the square root of that share, and by so much."""
_TINY, _SMALL, _BY_PLAY = 0.04, 0.12, 0.5
"""So little of the flow's change from row to row is left as a residual, that motion between them leaves more.

The second holds if the backlash explains more than half of the residual that there is without it.
"""
_WORTH_A_WORD = 0.05  # of the backlash: a smaller allowance is made without a note
_SURELY = 1.2  # squared residuals below this many times the meter's noise may be that noise alone
_OUTLYING = 6.0  # changes of the flow at rest that exceed the typical one by this factor count as that much
_CURE = (
    "log at least as often as the controller acts; if the command holds from row to row, "
    "say so: holds='command', --hold command"
)


class Judged(NamedTuple):
    """The 95 % interval of the backlash; why it is not identified, empty if it is; a note, empty if there is none."""

    interval: tuple[float, float]
    why: str
    note: str


def judged(problem: ValveProblem, solution: ValveSolution, holds: bool) -> Judged:
    """What remains of the interval of a fit if motion between the rows is allowed for; ``holds``: there is none."""
    interval, x, most = solution.profile.interval, float(solution.estimate.x[X_BL]), solution.profile.grid[-1]
    seen = (
        f"rows are {step_of(problem.data, problem.fitting):g} s apart, and a controller may move the valve between "
        "them, unseen"
    )
    why = why_unidentified(problem.n_reversals, x, interval, most, problem.n_pieces)
    share = 0.0 if holds else _besides_noise(problem, solution)
    if share > _BESIDES_NOISE:
        if not why:
            little = "the backlash explains little of what the curve alone leaves of the flow"
            why = f"not identified: {seen}: {little}; {_CURE}"
        elif problem.n_reversals > 1:
            why += f"; or the rows are too far apart: {seen}; {_CURE}"
    if why or share == 0.0:
        return Judged(interval, why, "")
    more = _PER_SHARE * math.sqrt(share) * x + _SLACK
    low, high = max(interval[0] - more, 0.0), interval[1] + more
    if why_unidentified(problem.n_reversals, x, (low, high), most):
        true = f"a backlash of {low:.2g} to {high:.2g} may lie behind the {x:.2g} found"
        return Judged((low, high), f"not identified: {seen}: {true}; {_CURE}", "")
    note = f"{seen}: the interval of the backlash allows {more:.2g} for that; {_CURE}"
    return Judged((low, high), "", note if more > _WORTH_A_WORD * x else "")


def _besides_noise(problem: ValveProblem, solution: ValveSolution) -> float:
    """What motion between the rows may have left in the residuals, as a share of what the backlash explains in them.

    That is their square less that of the meter's noise; 0 if the command rests at most rows, or if so little is left
    that there can be no such motion.
    """
    n = problem.n_fit
    command, batch = problem.command[:n], problem.batch[:n]
    flow = np.where(problem.good & problem.fitting, problem.flow, np.nan)[:n]
    same_piece = np.diff(batch) == 0
    moves = np.abs(np.diff(command)) > _STILL
    if not same_piece.any() or moves[same_piece].mean() < _LEAST_MOVING:
        return 0.0
    n_compared = max(int(solution.model.used.sum()), 1)
    left, plain = (one.rss / n_compared for one in (solution.estimate, solution.without_backlash))
    changes = np.diff(flow)[same_piece]
    change = float(np.nanmean(changes**2)) if np.isfinite(changes).any() else 0.0
    if left < _TINY**2 * change or (left < _SMALL**2 * change and left < _BY_PLAY**2 * plain):
        return 0.0
    noise = _noise(command, np.where(flow > problem.floor, flow, np.nan), ~moves & same_piece) ** 2
    return max(left - _SURELY * noise, 1e-6 * left) / max(plain - min(noise, 0.9 * left), 1e-300)


def _noise(command: Array, flow: Array, still: Mask) -> float:
    """Standard deviation of the meter's noise where the command rests for three rows, kg/s; 0 if it hardly does.

    Two equal commands may be chance: the valve may have moved between them.
    """
    inner = (command[1:-1] > _AT_AN_END) & (command[1:-1] < 1.0 - _AT_AN_END)
    changes = np.abs(np.diff(flow)[1:][still[1:] & still[:-1] & inner])
    changes = changes[np.isfinite(changes)]
    if changes.size < _FEWEST_STILL:
        return 0.0
    return float(np.sqrt(0.5 * np.mean(np.clip(changes, 0.0, _OUTLYING * np.median(changes)) ** 2)))

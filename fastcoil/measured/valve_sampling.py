"""Whether the rows of a log are close enough together, and how far it misleads if they are not.

Between two rows a controller may move the valve and turn it back, unseen.  Loops of many tunings are simulated with the
fitted flow curve and several backlashes, thinned to the interval of the log, and their backlash is estimated as in the
log.  Those that move like the log and show the backlash that it shows say which true backlashes may lie behind it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import paper_day
from fastcoil.loops.loop import Loop
from fastcoil.loops.presets import COOLING
from fastcoil.loops.simulate import simulate
from fastcoil.measured.lag import hats
from fastcoil.measured.least_squares import report_part
from fastcoil.measured.valve_problem import LOGS, X_BL, ValveProblem, ValveSolution, step_of, why_unidentified
from fastcoil.model.engine.recorded import valve_flows

_SHORTEST, _LONGEST = 5.0, 3600.0
"""Intervals of a log that are looked at, s: controllers sample every few seconds, and a loop settles in an hour."""
_SHOWN = np.unique(np.concatenate([np.linspace(0.0, 0.1, 26), np.linspace(0.1, 0.3, 21), [0.35, 0.4, 0.45, 0.5]]))
"""Backlashes that a log may show."""
_TRUE = np.array([0.0, 0.01, 0.02, 0.035, 0.05, 0.07, 0.09, 0.12, 0.16, 0.2, 0.26, 0.34])
"""Backlashes that are simulated."""
_FINE = np.linspace(0.0, _TRUE[-1], 137)
_GAINS = (0.5, 1.0, 1.8)
"""Of the preset's."""
_T_SET = 14.0
"""Of the days with a constant set-point, °C."""
_HOURS, _MOST_DAYS, _SAMPLES, _WARM_UP = 16, 10, 400, 1800
_SCALE = np.array([0.4, 0.12, 0.4, 0.2])
"""Differences of a manner of moving that count as one."""
_LIKE, _NEARLY = 1.2, 1.0
"""A loop moves like the log within the first distance; as much as the best one, within the second of it."""
_STRETCH = 0.5
"""Of a bias, added to it: real loops are none of the simulated ones."""
_LOOP_SLACK = 0.003
_RIDGE = 1e-9


class Bias(NamedTuple):
    """What a coarse log may hide.

    low, high: true backlashes that may lie behind the one shown, NaN if no simulated loop moves like the log.
    shares: least and largest ratio of the backlash shown to the true one in the loops that move like it.
    """

    low: float
    high: float
    shares: tuple[float, float]


class _Shown(NamedTuple):
    """The backlash that a log shows, and how it moves, (4,)."""

    backlash: float
    manner: Array


def bias_of(command: Array, flow: Array, batch: Index, step: float, curve: Array) -> Bias | None:
    """What a log hides, or None if its rows are too close or too far apart to say.

    command, flow, batch: (n,), fraction, kg/s, number of the piece; flow is NaN where it is not compared.  step: s.
    curve: m_max, a, b, c of Eq (2).
    """
    if not _SHORTEST < step < _LONGEST:
        return None
    log = _shown(command, flow, batch)
    found = []
    for loop in _loops(step, curve):
        shown = np.array([one.backlash for one in loop])
        manners = np.array([one.manner for one in loop])
        at = np.interp(_FINE, _TRUE, shown)
        crossed = np.append(False, (at[1:] - log.backlash) * (at[:-1] - log.backlash) <= 0.0)
        near = np.abs(at - log.backlash) <= max(_LOOP_SLACK, 0.05 * log.backlash)
        for i in np.flatnonzero(crossed | near):
            manner = np.array([np.interp(_FINE[i], _TRUE, column) for column in manners.T])
            found.append((float(np.linalg.norm((manner - log.manner) / _SCALE)), float(_FINE[i])))
    nearest = min((distance for distance, _ in found), default=np.inf)
    if nearest > _LIKE:
        return Bias(np.nan, np.nan, (np.nan, np.nan))
    true = np.array([x for distance, x in found if distance <= nearest + _NEARLY] + [log.backlash])
    low, high = float(true.min()), float(true.max())
    low -= _STRETCH * (log.backlash - low) + _LOOP_SLACK
    high += _STRETCH * (high - log.backlash) + _LOOP_SLACK
    shares = log.backlash / np.maximum(true, _LOOP_SLACK)
    return Bias(max(low, 0.0), high, (float(shares.min()), float(shares.max())))


def _loops(step: float, curve: Array) -> list[list[_Shown]]:
    """What logs of simulated loops show: for each loop, each backlash of ``_TRUE``."""
    interval = max(round(step), 1)
    n_days = int(np.clip(np.ceil(_SAMPLES * step / (_HOURS * 3600)), 1, _MOST_DAYS))
    day = paper_day(_HOURS, range(n_days))
    calm = Boundary(**{name: values for name, values in day.series.items() if name in _GIVEN}, T_set=_T_SET)
    m_max, a, b, c = curve
    found: list[list[_Shown]] = []
    for preset in COOLING:
        base = Loop.preset(preset)
        loop = base.assign(
            backlash=("backlash", _TRUE),
            kp=("tuning", float(base["kp"]) * np.array(_GAINS)),  # type: ignore[arg-type]
            m_max=m_max * _full(base) / _flow(1.0, m_max, a, b, c),
            valve_a=a,
            valve_b=b,
            valve_c=c,
        )
        for of in (day, calm):
            report_part("simulated loops", len(found), 2 * len(_GAINS) * len(COOLING))
            ds = simulate(loop, of, traces=["command", "m_w"], trace_interval=interval, n_jobs=1, progress=False)
            ds = ds.isel(elapsed_time=ds["elapsed_time"].values >= _WARM_UP)
            dims = ("tuning", "backlash", "day", "elapsed_time")
            command, flow = (ds[name].transpose(*dims).values for name in ("command", "m_w"))
            batch = np.repeat(np.arange(n_days), command.shape[-1])
            found += [
                [_shown(c.ravel(), m.ravel(), batch) for c, m in zip(*of_tuning, strict=True)]
                for of_tuning in zip(command, flow, strict=True)
            ]
    return found


_GIVEN = ("m_a", "T_a_in", "W_a_in", "T_w_in")


def _full(loop: Loop) -> float:
    """Flow of the preset's valve at full opening, kg/s: its coil is of that size."""
    return _flow(1.0, *(float(loop[name]) for name in ("m_max", "valve_a", "valve_b", "valve_c")))  # type: ignore[arg-type]


def _flow(opening: float, m_max: float, a: float, b: float, c: float) -> float:
    return float(m_max * (1.0 + a * np.exp(-b * (opening - c))) ** (-1.0 / a))


def _shown(command: Array, flow: Array, batch: Index) -> _Shown:
    """The backlash with the least squares of a curve of straight lines from opening to flow; the manner of moving."""
    rows, start = np.ones((5, _SHOWN.size)), np.full((int(batch[-1]) + 1, _SHOWN.size), 0.5)
    rows[0] = _SHOWN
    openings, unused = np.empty((command.size, _SHOWN.size)), np.empty((command.size, _SHOWN.size))
    valve_flows(np.ascontiguousarray(command), batch, rows, start, openings, unused)
    used = np.isfinite(flow)
    terms, measured = hats(openings[used]), flow[used]
    products = np.einsum("njk,njl->jkl", terms, terms, optimize=True)
    answers = np.einsum("njk,n->jk", terms, measured)
    ridge = _RIDGE * used.sum() * np.eye(products.shape[-1])
    flows = np.linalg.solve(products + ridge, answers[..., None])[..., 0]
    errors = (
        measured @ measured - 2.0 * (flows * answers).sum(axis=1) + np.einsum("jk,jkl,jl->j", flows, products, flows)
    )
    moves = np.diff(command)[np.diff(batch) == 0]
    turns = moves[np.abs(moves) > _STILL]
    pieces = np.split(command, np.flatnonzero(np.diff(batch)) + 1)
    manner = [
        np.log(np.abs(moves).mean() + 1e-6),
        (turns[1:] * turns[:-1] < 0.0).mean() if turns.size > 1 else 0.0,
        0.5 * np.log(np.mean([piece.var() for piece in pieces]) + 1e-12),
        (np.abs(moves) > _STILL).mean(),
    ]
    return _Shown(float(_SHOWN[errors.argmin()]), np.array(manner))


_LEAST_MOVING = 0.4
"""A controller may move the valve between the rows where the command changes at this share of them."""
_STILL = 2e-3
"""Smaller changes of the command are none."""
_AT_AN_END = 0.01
"""A command this close to 0 or 1 may rest there while the valve still travels."""
_FEWEST_STILL = 20
_BESIDES_NOISE = 0.5
"""Motion between the rows explains a residual whose square, less the meter's noise, is more than this share of what the
backlash explains."""
_TOO_MUCH = 0.8
"""Beyond this share the backlash explains too little beside it."""
_PER_SHARE, _SLACK = 0.6, 0.002
"""Below that the interval is widened by so much of the backlash for the square root of that share, and by so much."""
_TINY, _SMALL, _BY_PLAY = 0.04, 0.12, 0.5
"""So little of the flow's change from row to row is left as a residual, that motion between them leaves more.

The second holds if the backlash explains more than half of the residual that there is without it.
"""
_WORTH_A_WORD = 0.05
"""Of the backlash: a smaller allowance is made without a note."""
_SURELY = 1.2
"""Squared residuals below this many times the meter's noise may be that noise alone."""
_OUTLYING = 6.0
"""Changes of the flow at rest that exceed the typical one by this factor count as that much."""
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
    interval, x = solution.profile.interval, float(solution.estimate.x[X_BL])
    n_pieces = int(problem.batch[problem.n_fit - 1]) + 1
    why = why_unidentified(problem.n_reversals, x, interval, solution.profile.grid[-1], n_pieces)
    share = 0.0 if holds else _besides_noise(problem, solution)
    if why and share > _BESIDES_NOISE and problem.n_reversals > 1:
        why += f"; or the rows are too far apart: {_seen(problem)}; {_CURE}"
    if why or share == 0.0:
        return Judged(interval, why, "")
    if share <= _BESIDES_NOISE:
        more = _PER_SHARE * math.sqrt(share) * x + _SLACK
        wider = (max(interval[0] - more, 0.0), interval[1] + more)
        if why_unidentified(problem.n_reversals, x, wider, solution.profile.grid[-1]):
            true = f"a backlash of {wider[0]:.2g} to {wider[1]:.2g} may lie behind the {x:.2g} found"
            return Judged(wider, f"not identified: {_seen(problem)}: {true}; {_CURE}", "")
        note = f"{_seen(problem)}: the interval of the backlash allows {more:.2g} for that; {_CURE}"
        return Judged(wider, "", note if more > _WORTH_A_WORD * x else "")
    return _by_simulation(problem, solution, share)


def _by_simulation(problem: ValveProblem, solution: ValveSolution, share: float) -> Judged:
    """What simulated loops leave of the interval; ``share``: as `_besides_noise` finds it."""
    interval, x, seen = solution.profile.interval, float(solution.estimate.x[X_BL]), _seen(problem)
    if share > _TOO_MUCH:
        why = "the backlash explains little of what the curve alone leaves of the flow"
        return Judged(interval, f"not identified: {seen}: {why}; {_CURE}", "")
    curve, fitting = solution.estimate.x[1:5].copy(), problem.fitting
    curve[[k - 1 for k in LOGS]] = np.exp(curve[[k - 1 for k in LOGS]])
    bias = bias_of(
        problem.command[fitting],
        np.where(problem.good, problem.flow, np.nan)[fitting],
        problem.batch[fitting],
        step_of(problem.data, fitting),
        curve,
    )
    if bias is None:
        return Judged(interval, "", "")
    if math.isnan(bias.low):
        why = "no simulated loop with this valve moves as this log does"
        return Judged(interval, f"not identified: {seen}: {why}; {_CURE}", "")
    low, high = min(interval[0], bias.low), max(interval[1], bias.high)
    least, most = bias.shares
    shown = f"such loops, simulated with this valve and logged as coarsely, show {least:.2g} to {most:.2g} of theirs"
    if why_unidentified(problem.n_reversals, x, (low, high), solution.profile.grid[-1]):
        true = f"a backlash of {low:.2g} to {high:.2g} may lie behind the {x:.2g} found"
        return Judged((low, high), f"not identified: {seen}: {true}; {shown}; {_CURE}", "")
    return Judged((low, high), "", f"{seen}: {shown}; the interval of the backlash allows for that; {_CURE}")


def _seen(problem: ValveProblem) -> str:
    step = step_of(problem.data, problem.fitting)
    return f"rows are {step:g} s apart, and a controller may move the valve between them, unseen"


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
    changes = np.diff(flow)[1:][still[1:] & still[:-1] & inner]
    changes = changes[np.isfinite(changes)]
    if changes.size < _FEWEST_STILL:
        return 0.0
    return float(np.sqrt(0.5 * np.mean(np.clip(np.abs(changes), 0.0, _OUTLYING * np.median(np.abs(changes))) ** 2)))

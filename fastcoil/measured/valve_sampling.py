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
from fastcoil.measured.lag import hats, openings_of
from fastcoil.measured.least_squares import report_part
from fastcoil.measured.part import unbroken
from fastcoil.measured.valve_problem import LOGS, X_BL, ValveProblem, ValveSolution, step_of, why_unidentified

_SHORTEST, _LONGEST = 5.0, 3600.0
"""Intervals of a log that are looked at, s: controllers sample every few seconds, and a loop settles in an hour."""
_SHOWN = np.unique(np.concatenate([np.linspace(0.0, 0.1, 26), np.linspace(0.1, 0.3, 21), [0.35, 0.4, 0.45, 0.5]]))
"""Backlashes that a log may show."""
_TRUE = np.array([0.0, 0.01, 0.02, 0.035, 0.05, 0.07, 0.09, 0.12, 0.16, 0.2, 0.26, 0.34])
"""Backlashes that are simulated."""
_FINE = np.linspace(0.0, _TRUE[-1], 137)
_GAINS = (0.5, 1.0, 1.8)  # of the preset's
_GIVEN, _T_SET = ("m_a", "T_a_in", "W_a_in", "T_w_in"), 14.0  # of the days with a constant set-point, °C
_HOURS, _MOST_DAYS, _SAMPLES, _WARM_UP = 16, 10, 400, 1800
_SCALE = np.array([0.4, 0.12, 0.4, 0.2])  # differences of a manner of moving that count as one
_LIKE, _NEARLY = 1.2, 1.0
"""A loop moves like the log within the first distance; as much as the best one, within the second of it."""
_STRETCH = 0.5  # of a bias, added to it: real loops are none of the simulated ones
_LOOP_SLACK = 0.003
_RIDGE = 1e-9


class Bias(NamedTuple):
    """What a coarse log may hide; NaN if no simulated loop moves like it."""

    low: float  # true backlashes that may lie behind the one shown
    high: float
    shares: tuple[float, float]  # least and largest ratio of the backlash shown to the true one in loops like the log's


_Shown = tuple[float, Array]  # the backlash that a log shows, and how it moves, (4,)


def bias_of(command: Array, flow: Array, batch: Index, step: float, curve: Array) -> Bias | None:
    """What a log hides, or None if its rows are too close or too far apart to say.

    command, flow, batch: (n,), fraction, kg/s, number of the piece; flow is NaN where it is not compared.  step: s.
    curve: m_max, a, b, c of Eq (2).
    """
    if not _SHORTEST < step < _LONGEST:
        return None
    x, manner_of_log = _shown(command, flow, batch)
    found = []  # (distance from the log, true backlash)
    for loop in _loops(step, curve):
        at = np.interp(_FINE, _TRUE, [shown for shown, _ in loop])
        manners = np.array([manner for _, manner in loop])
        crossed = np.append(False, (at[1:] - x) * (at[:-1] - x) <= 0.0)
        near = np.abs(at - x) <= max(_LOOP_SLACK, 0.05 * x)
        for i in np.flatnonzero(crossed | near):
            manner = np.array([np.interp(_FINE[i], _TRUE, column) for column in manners.T])
            found.append((float(np.linalg.norm((manner - manner_of_log) / _SCALE)), float(_FINE[i])))
    nearest = min((distance for distance, _ in found), default=np.inf)
    if nearest > _LIKE:
        return Bias(np.nan, np.nan, (np.nan, np.nan))
    true = np.array([gap for distance, gap in found if distance <= nearest + _NEARLY] + [x])
    low, high = float(true.min()), float(true.max())
    low -= _STRETCH * (x - low) + _LOOP_SLACK
    high += _STRETCH * (high - x) + _LOOP_SLACK
    shares = x / np.maximum(true, _LOOP_SLACK)
    return Bias(max(low, 0.0), high, (float(shares.min()), float(shares.max())))


def _loops(step: float, curve: Array) -> list[list[_Shown]]:
    """What logs of simulated loops show: for each loop, each backlash of ``_TRUE``."""
    n_days = int(np.clip(np.ceil(_SAMPLES * step / (_HOURS * 3600)), 1, _MOST_DAYS))
    day = paper_day(_HOURS, range(n_days))
    calm = Boundary(**{name: day.series[name] for name in _GIVEN}, T_set=_T_SET)
    found: list[list[_Shown]] = []
    for preset in COOLING:
        base = Loop.preset(preset)
        of_preset = [float(base[name]) for name in ("m_max", "valve_a", "valve_b", "valve_c")]  # type: ignore[arg-type]
        loop = base.assign(
            backlash=("backlash", _TRUE),
            kp=("tuning", float(base["kp"]) * np.array(_GAINS)),  # type: ignore[arg-type]
            m_max=curve[0] * _full(*of_preset) / _full(*curve),  # its coil is of that size
            **dict(zip(("valve_a", "valve_b", "valve_c"), curve[1:].tolist(), strict=True)),
        )
        for of in (day, calm):
            report_part("simulated loops", len(found), 2 * len(_GAINS) * len(COOLING))
            ds = simulate(
                loop, of, traces=["command", "m_w"], trace_interval=max(round(step), 1), n_jobs=1, progress=False
            )
            ds = ds.isel(elapsed_time=ds["elapsed_time"].values >= _WARM_UP)
            dims = ("tuning", "backlash", "day", "elapsed_time")
            command, flow = (ds[name].transpose(*dims).values for name in ("command", "m_w"))
            batch = np.repeat(np.arange(n_days), command.shape[-1])
            for of_tuning in zip(command, flow, strict=True):
                found.append([_shown(c.ravel(), m.ravel(), batch) for c, m in zip(*of_tuning, strict=True)])
    return found


def _full(m_max: float, a: float, b: float, c: float) -> float:
    """Flow of a valve at full opening, kg/s."""
    return float(m_max * (1.0 + a * np.exp(-b * (1.0 - c))) ** (-1.0 / a))


def _shown(command: Array, flow: Array, batch: Index) -> _Shown:
    """The backlash with the least squares of a curve of straight lines from opening to flow; the manner of moving."""
    used = np.isfinite(flow)
    terms, measured = hats(openings_of(command, batch, _SHOWN)[used]), flow[used]
    products = np.einsum("njk,njl->jkl", terms, terms, optimize=True)
    answers = np.einsum("njk,n->jk", terms, measured)
    ridge = _RIDGE * used.sum() * np.eye(products.shape[-1])
    flows = np.linalg.solve(products + ridge, answers[..., None])[..., 0]
    errors = (
        measured @ measured - 2.0 * (flows * answers).sum(axis=1) + np.einsum("jk,jkl,jl->j", flows, products, flows)
    )
    moves = np.diff(command)[np.diff(batch) == 0]
    turns = moves[np.abs(moves) > _STILL]
    manner = [
        np.log(np.abs(moves).mean() + 1e-6),
        (turns[1:] * turns[:-1] < 0.0).mean() if turns.size > 1 else 0.0,
        0.5 * np.log(np.mean([command[piece].var() for piece in unbroken(batch)]) + 1e-12),
        (np.abs(moves) > _STILL).mean(),
    ]
    return float(_SHOWN[errors.argmin()]), np.array(manner)


_LEAST_MOVING = 0.4  # a controller may move the valve between the rows where the command changes at this share of them
_STILL = 2e-3  # smaller changes of the command are none
_AT_AN_END = 0.01  # a command this close to 0 or 1 may rest there while the valve still travels
_FEWEST_STILL = 20
_BESIDES_NOISE, _TOO_MUCH = 0.5, 0.8
"""Motion between the rows explains a residual whose square, less the meter's noise, is more than the first share of
what the backlash explains.  Beyond the second the backlash explains too little beside it."""
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
    if why and share > _BESIDES_NOISE and problem.n_reversals > 1:
        why += f"; or the rows are too far apart: {seen}; {_CURE}"
    if why or share == 0.0:
        return Judged(interval, why, "")
    if share > _TOO_MUCH:
        little = "the backlash explains little of what the curve alone leaves of the flow"
        return Judged(interval, f"not identified: {seen}: {little}; {_CURE}", "")
    if share <= _BESIDES_NOISE:
        more = _PER_SHARE * math.sqrt(share) * x + _SLACK
        low, high, shown = max(interval[0] - more, 0.0), interval[1] + more, ""
        note = f"{seen}: the interval of the backlash allows {more:.2g} for that; {_CURE}"
        note = note if more > _WORTH_A_WORD * x else ""
    else:
        bias = _simulated(problem, solution)
        if bias is None:
            return Judged(interval, "", "")
        if math.isnan(bias.low):
            none = "no simulated loop with this valve moves as this log does"
            return Judged(interval, f"not identified: {seen}: {none}; {_CURE}", "")
        low, high = min(interval[0], bias.low), max(interval[1], bias.high)
        least, largest = bias.shares
        shown = (
            f"such loops, simulated with this valve and logged as coarsely, show {least:.2g} to {largest:.2g} of theirs"
        )
        note = f"{seen}: {shown}; the interval of the backlash allows for that; {_CURE}"
    if why_unidentified(problem.n_reversals, x, (low, high), most):
        true = f"a backlash of {low:.2g} to {high:.2g} may lie behind the {x:.2g} found"
        return Judged((low, high), "; ".join(filter(None, [f"not identified: {seen}: {true}", shown, _CURE])), "")
    return Judged((low, high), "", note)


def _simulated(problem: ValveProblem, solution: ValveSolution) -> Bias | None:
    curve, fitting = solution.estimate.x[1:5].copy(), problem.fitting
    curve[[k - 1 for k in LOGS]] = np.exp(curve[[k - 1 for k in LOGS]])
    flow = np.where(problem.good, problem.flow, np.nan)
    step = step_of(problem.data, fitting)
    return bias_of(problem.command[fitting], flow[fitting], problem.batch[fitting], step, curve)


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

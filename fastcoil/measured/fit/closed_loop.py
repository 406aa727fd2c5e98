"""How far a log misleads that is coarser than its controller: simulated loops with the fitted valve, logged as it.

Between two rows the controller moves the valve and turns it back, and the log shows nothing of it.  Loops of many
tunings are simulated with the fitted flow curve and several backlashes, thinned to the interval of the log, and their
backlash is sought as in the log.  Those that move like the log and show the backlash that it shows say which true
backlashes may lie behind it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import paper_day
from fastcoil.loops.loop import Loop
from fastcoil.loops.presets import COOLING
from fastcoil.loops.simulate import simulate
from fastcoil.measured.fit import work
from fastcoil.measured.fit.play_curve import hats
from fastcoil.model.engine.recorded import valve_flows

_STILL = 2e-3
"""Smaller changes of the command are none."""
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
_SLACK = 0.003
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
        near = np.abs(at - log.backlash) <= max(_SLACK, 0.05 * log.backlash)
        for i in np.flatnonzero(crossed | near):
            manner = np.array([np.interp(_FINE[i], _TRUE, column) for column in manners.T])
            found.append((float(np.linalg.norm((manner - log.manner) / _SCALE)), float(_FINE[i])))
    nearest = min((distance for distance, _ in found), default=np.inf)
    if nearest > _LIKE:
        return Bias(np.nan, np.nan, (np.nan, np.nan))
    true = np.array([x for distance, x in found if distance <= nearest + _NEARLY] + [log.backlash])
    low, high = float(true.min()), float(true.max())
    low -= _STRETCH * (log.backlash - low) + _SLACK
    high += _STRETCH * (high - log.backlash) + _SLACK
    shares = log.backlash / np.maximum(true, _SLACK)
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
            work.part("simulated loops", len(found), 2 * len(_GAINS) * len(COOLING))
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

"""The least-squares problem of a valve: holds, reversals and floor of its log, the model over it, and its solution."""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs import Log
from fastcoil.logs.series import counted, first_row
from fastcoil.measured.least_squares import Estimate, Model, Uncertainty, minimise, profile, uncertainty, widened
from fastcoil.measured.part import Part
from fastcoil.model.engine.recorded import valve_flows

_STILL = 2e-3
"""Commands within this of each other are one hold, fraction of stroke."""
_TURN = 0.01
"""A reversal goes back by more than this, fraction of stroke."""
_HOLD_SAMPLES = 4
"""If a typical hold has at least this many samples, the command is taken to be held."""
_FLOOR_SHARE, _FLOOR_SAMPLES = 0.02, 5
_SURELY_OPEN = 0.25
"""A valve this much further open than one that passes water passes water too, whatever its backlash."""
_BIN, _BIN_SAMPLES = 0.05, 3
_FEWEST_REVERSALS = 2
_MANY_PIECES = ", or bridge the gaps, between which it is in {n:,} pieces, with max_gap, --max-gap"
_SMALL = 0.02
"""An interval from 0 to less than this means no backlash."""


def settled(log: Log, fitting: Mask, settle: float | None, notes: list[str]) -> Mask:
    """Where the flow has settled after the last change of the command, (n,); ``fitting``: rows that say how long."""
    command, step = log.values["command"], step_of(log, fitting)
    since, lengths, first, held = np.zeros(command.size), [], 0, command[0]
    for t in range(1, command.size):
        if abs(command[t] - held) > _STILL or log.batch[t] != log.batch[t - 1]:
            lengths.append(t - first)
            first, held = t, command[t]
        since[t] = log.time[t] - log.time[first]
    lengths.append(command.size - first)
    last_fitted = int(np.flatnonzero(fitting)[-1])
    lengths = np.diff(np.minimum(np.cumsum([0, *lengths]), last_fitted + 1))
    lengths = lengths[lengths > 0]
    typical = float(np.median(lengths))
    if settle is None and typical < _HOLD_SAMPLES:
        return np.ones(command.size, dtype=bool)
    wait = settle if settle is not None else 0.5 * typical * step
    good = since >= wait
    good[:1] = wait == 0.0
    if not good.all():
        notes.append(
            f"{int((~good).sum()):,} of {good.size:,} flows not compared: less than {wait:g} s after the command "
            f"changed ({lengths.size:,} holds, typically {typical * step:g} s)"
        )
    return np.asarray(good)


def step_of(log: Log, fitting: Mask) -> float:
    """Median time between the rows of the part to fit, s."""
    return float(np.median(np.diff(log.time[fitting]))) if fitting.sum() > 1 else log.step


def reversals(command: Array, batch: Index) -> int:
    """How often the command turns by more than 1 % of stroke."""
    n, extreme, way = 0, command[0], 0
    for t in range(1, command.size):
        if batch[t] != batch[t - 1]:
            extreme, way = command[t], 0
        moved = command[t] - extreme
        if way * moved > 0.0:
            extreme = command[t]
        elif abs(moved) > _TURN:
            n += way != 0
            way, extreme = int(np.sign(moved)), command[t]
    return n


def lowest_reading(flow: Array, notes: list[str]) -> float:
    """The flow meter's floor: its lowest reading above 0 if that is frequent, else 0."""
    above = flow[np.isfinite(flow) & (flow > 0.0)]
    if above.size == 0:
        return 0.0
    lowest = float(above.min())
    times = int((above == lowest).sum())
    if times < max(_FLOOR_SAMPLES, _FLOOR_SHARE * above.size):
        return 0.0
    notes.append(f"the flow meter reads {lowest:.4g} kg/s {times:,} times and never less: taken as its floor")
    return lowest


def sensor_off(command: Array, flow: Array, floor: float, fitting: Mask) -> Mask:
    """Where the valve does not explain that no flow is measured: the sensor or the pump is off.

    That is a reading of 0 below the meter's floor; and 0, or the floor, with the valve much further open than where
    most samples of the part to fit show flow.
    """
    still = flow <= floor
    flows_from = 1.0
    for low in np.arange(0.0, 1.0, _BIN):
        here = (command >= low) & (command < low + _BIN) & np.isfinite(flow) & fitting
        if here.sum() >= _BIN_SAMPLES and still[here].mean() < 0.5:
            flows_from = low
            break
    off = still & (command > flows_from + _SURELY_OPEN)
    return np.asarray(off | (flow == 0.0) if floor > 0.0 else off)


def why_unidentified(
    n_reversals: int, x_BL: float, interval: tuple[float, float], most: float, n_pieces: int = 1
) -> str:
    """Why the data do not identify the backlash; empty if they do.  n_pieces: in which the log is, reversals within.

    They do if its interval is no wider than ``x_BL`` itself, or below ``_SMALL``.  An interval that just misses 0 can
    be chance, and its middle is then too large.
    """
    low, high = interval
    if n_reversals < _FEWEST_REVERSALS:
        return (
            f"not identified: the command turns {n_reversals} times by more than {100 * _TURN:.0f} % of stroke, and "
            "only reversals show backlash; give a log in which it goes up and down"
            + _MANY_PIECES.format(n=n_pieces)
            * (n_pieces > 1)
        )
    if high >= most or high - low > max(x_BL, _SMALL):
        tried = " (the largest value tried)" if high >= most else ""
        return (
            f"not identified: anything from {low:.3g} to {high:.3g}{tried} fits as well (95 %): the flow's noise is "
            "larger than the effect of the backlash, or no reversal ends within it; give a longer log, with small "
            "reversals too, where the curve is steep"
        )
    return ""


FEWEST_SAMPLES = 20
LARGEST_BACKLASH = 0.5
X_BL, M_MAX, _A, _B, _C = range(5)
LOGS = (M_MAX, _A, _B)
"""Parameters that are searched by their logarithm."""
_PROFILE_POINTS = 25
_FINE_POINTS = 12


class BacklashProfile(NamedTuple):
    """Least sum of squares with the backlash held at each value of ``grid``, (n,).

    limit: the sum that the 95 % ``interval`` stays below.
    """

    grid: Array
    sums: Array
    limit: float
    interval: tuple[float, float]


class ValveSolution(NamedTuple):
    """The minimum of a valve's ``model``, how well it is known, and the profile over the backlash.

    without_backlash: the minimum with a backlash of 0.  fixed: indices of the parameters that were held.
    """

    model: Model
    estimate: Estimate
    uncertainty: Uncertainty
    profile: BacklashProfile
    without_backlash: Estimate
    fixed: list[int]


class ValveProblem:
    """The log, which samples of it are compared, and the model over it."""

    def __init__(self, data: Log, floor: float | None, settle: float | None, part: Part) -> None:
        self.data = data
        self.command, self.flow = data.values["command"], data.values["m_w"]
        self.notes = list(data.notes)
        self.fitting = part.fitted(data)
        self.floor = lowest_reading(self.flow[self.fitting], self.notes) if floor is None else floor
        off = sensor_off(self.command, self.flow, self.floor, self.fitting)
        if off.any():
            self.notes.append(
                f"{counted(off, 'flow')} left out, sensor or pump off: 0, or the meter's floor with the valve open "
                f"({first_row(data.rows.tolist(), off)})"
            )
        at_rest = settled(data, self.fitting, settle, self.notes)
        enabled = data.values.get("enabled", np.ones(self.flow.size)) != 0.0
        if not enabled.all():
            self.notes.append(f"{counted(~enabled, 'flow')} not compared: enabled is 0")
        self.good = np.isfinite(self.flow) & ~off & at_rest & enabled
        to_fit = self.good & self.fitting
        if to_fit.sum() < FEWEST_SAMPLES:
            raise InputError(
                f"{data.name}: {counted(to_fit, 'flow')} left to fit: give at least {FEWEST_SAMPLES}, "
                f"lower settle, raise split, or give a longer log ({'; '.join(self.notes)})"
            )
        last = int(np.flatnonzero(self.fitting)[-1]) + 1
        self.n_fit = last
        self.batch = data.batch
        self.top = float(np.nanmax(self.flow[self.fitting]))
        self.n_reversals = reversals(self.command[self.fitting], self.batch[self.fitting])

    def flows(self, sets: Array, start: Array, n: int) -> tuple[Array, Array]:
        """Openings and flows of parameter sets (5, sets) over the first n samples, the meter's floor included."""
        openings, flows = np.empty((n, sets.shape[1])), np.empty((n, sets.shape[1]))
        rows = sets.copy()
        rows[list(LOGS)] = np.exp(rows[list(LOGS)])
        valve_flows(self.command[:n], self.batch[:n], rows, np.ascontiguousarray(start), openings, flows)
        return openings, np.maximum(flows, self.floor)

    def model(self, m_max: float | None, initial: str) -> tuple[Model, list[int]]:
        """The least-squares problem of the part to fit, and the indices of the parameters held in it."""
        n, n_batches = self.n_fit, int(self.batch[self.n_fit - 1]) + 1
        used = self.good[:n] & self.fitting[:n]
        measured = np.where(used, self.flow[:n], 0.0)[:, None]

        def residuals(sets: Array) -> Array:
            return np.where(used[:, None], self.flows(sets[:5], sets[5:], n)[1] - measured, 0.0)

        top = math.log(self.top)
        lower = np.array([0.0, top - 1.0, math.log(0.01), math.log(0.5), -2.0, *[0.0] * n_batches])
        upper = np.array([LARGEST_BACKLASH, top + 3.0, math.log(20.0), math.log(200.0), 3.0, *[1.0] * n_batches])
        if m_max is not None:
            lower[M_MAX] = min(lower[M_MAX], math.log(m_max) - 1.0)
            upper[M_MAX] = max(upper[M_MAX], math.log(m_max) + 1.0)
        step = np.array([1e-3, 1e-4, 1e-4, 1e-4, 1e-4, *[0.02] * n_batches])
        fixed = [] if m_max is None else [M_MAX]
        fixed += [] if initial == "unknown" else list(range(5, 5 + n_batches))
        return Model(residuals, lower, upper, step, self.batch[:n], used, n_batches, self.batch[:n]), fixed

    def starts(self, m_max: float | None, initial: str) -> Array:
        """Parameter sets to start from, (p, sets): shapes of the curve, each with several backlashes."""
        place = {"unknown": 0.5, "rising": 1.0, "falling": 0.0}[initial]
        n_batches = int(self.batch[self.n_fit - 1]) + 1
        flows = [math.log(m_max)] if m_max else [math.log(self.top * f) for f in (1.03, 1.5)]
        shapes = product(
            (0.0, 0.02, 0.04, 0.06, 0.09, 0.13, 0.18, 0.25),
            flows,
            (math.log(0.5), math.log(2.0)),
            (math.log(5.0), math.log(8.0), math.log(14.0)),
            (0.2, 0.4, 0.6, 0.85),
        )
        return np.array([[*shape, *[place] * n_batches] for shape in shapes]).T

    def solve(self, m_max: float | None, initial: str) -> ValveSolution:
        """Fit, profile over the backlash, and fit again from a better minimum if the profile finds one."""
        model, fixed = self.model(m_max, initial)
        best = minimise(model, self.starts(m_max, initial), fixed=fixed)
        for n_restarts in range(3):
            spread = widened(model, best, uncertainty(model, best, fixed, profiled=[X_BL]), fixed)
            grid = _grid(best, spread)
            minima = profile(model, best, X_BL, grid, fixed)
            sums = np.array([one.rss for one in minima])
            if sums.min() > best.rss * (1.0 - 1e-6) or n_restarts == 2:
                break
            best = minimise(model, np.stack([best.x, minima[int(sums.argmin())].x], axis=1), fixed=fixed)
        limit = best.rss + spread.inflation[X_BL] * spread.quantile() ** 2 * spread.variance
        return ValveSolution(
            model=model,
            estimate=best,
            uncertainty=spread,
            profile=BacklashProfile(grid=grid, sums=sums, limit=limit, interval=_interval(grid, sums, best, limit)),
            without_backlash=minima[0],
            fixed=fixed,
        )


def _grid(best: Estimate, spread: Uncertainty) -> Array:
    """Backlashes to profile: coarse over the whole range, fine around the minimum."""
    x, variance = float(best.x[X_BL]), spread.covariance[X_BL, X_BL]
    top = min(max(0.25, 2.0 * x), LARGEST_BACKLASH)
    width = 3.0 * math.sqrt(variance) if np.isfinite(variance) else 0.02
    width = min(max(width, 2e-3), 0.1)
    fine = np.linspace(max(x - width, 0.0), min(x + width, top), _FINE_POINTS)
    return np.unique(np.round(np.concatenate([np.linspace(0.0, top, _PROFILE_POINTS), fine]), 6))


def _interval(grid: Array, sums: Array, best: Estimate, limit: float) -> tuple[float, float]:
    """Where the profile stays below its limit, between the outermost crossings."""
    x = np.append(grid, best.x[X_BL])
    order = np.argsort(x, kind="stable")
    x, y = x[order], np.append(sums, best.rss)[order]
    inside: Index = np.flatnonzero(y <= limit)
    first, last = int(inside[0]), int(inside[-1])
    low, high = x[first], x[last]
    if first > 0:
        low = x[first] + (x[first - 1] - x[first]) * (limit - y[first]) / max(y[first - 1] - y[first], 1e-300)
    if last < x.size - 1:
        high = x[last] + (x[last + 1] - x[last]) * (limit - y[last]) / max(y[last + 1] - y[last], 1e-300)
    return float(low), float(high)

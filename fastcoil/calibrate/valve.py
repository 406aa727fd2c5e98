"""``fit_valve``: x_BL, m_max, a, b, c of Eqs (1) and (2) from recorded commands and flows (section 2.1.3)."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastcoil.arguments import is_number
from fastcoil.boundary.series import Array
from fastcoil.calibrate.data import Log, read_log
from fastcoil.calibrate.least_squares import Estimate, Uncertainty, minimise, profile, uncertainty
from fastcoil.calibrate.result import Fit
from fastcoil.calibrate.valve_problem import FEWEST_SAMPLES, LARGEST_BACKLASH, X_BL, ValveProblem
from fastcoil.errors import InputError

_PROFILE_POINTS = 25
_FINE_POINTS = 12
_LEAST_REACH = 0.02
"""A command that stays below this share of the stroke is in another unit."""
_LEAST_SHARE = 0.8
"""Noise may lift a reading above the asymptotic flow, but not that far."""


def fit_valve(
    log: Any,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    m_max: float | None = None,
    floor: float | None = None,
    settle: float | None = None,
    initial: str = "unknown",
    split: float | None = None,
    fit_until: float | None = None,
    validation: Any = None,
    drop: bool = False,
    jumps: str = "refuse",
    max_gap: float | None = None,
) -> Fit:
    """Fit the backlash and the flow curve of a valve to a log of commands and flows.

    Parameters
    ----------
    log
        Path of a CSV file, or a Dataset: ``command`` (1, percent, deg of 90, V of 10), ``m_w`` (kg/s, L/s, m3/h,
        gpm, …), ``elapsed_time`` or ``timestamp``; if there ``enabled``, 0 where the pump is off, and ``batch``, where
        experiments were put in a row.
    units, columns
        As in ``fc.Boundary.from_csv``.
    m_max
        Asymptotic flow of Eq (2) [kg/s], if it is known; estimated if left out.
    floor
        Lowest reading of the flow meter [kg/s], 0 for none; found from the data if left out.
    settle
        Seconds after a change of the command in which the flow is not compared; half of a typical hold if left out
        and the command is held, else 0.
    initial
        Where in the gap each batch starts: ``unknown`` (estimated), ``rising`` or ``falling``.
    split, fit_until
        Share of the log that is fitted (of its batches, if there are at least four), 0.7 if left out, the rest is held
        back for validation; or the last second that is fitted.
    validation
        Another log, of the same columns, to validate with; then all of the first is fitted.
    drop, jumps, max_gap
        What to do with bad rows, with time that goes back and with gaps: see ``fastcoil.calibrate.data.read_log``.

    Returns
    -------
    Fit
        ``backlash`` is not among its parameters where the data cannot tell it; ``held`` then says why.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments.

    Notes
    -----
    Cai and Braun (2016), section 2.1.3.  In Eq (2) only b/(1 - x_BL) and (1 - x_BL) c act: α = 1/(1 - x_BL) assumes
    that a full command opens fully.
    """
    began = time.perf_counter()
    wrong = []
    if m_max is not None and not (is_number(m_max) and 0.0 < m_max < math.inf):
        wrong.append(f"m_max = {m_max!r}: give a number above 0")
    for name, value in (("floor", floor), ("settle", settle)):
        if value is not None and not (is_number(value) and 0.0 <= value < math.inf):
            wrong.append(f"{name} = {value!r}: give a number, 0 or more")
    if initial not in ("unknown", "rising", "falling"):
        wrong.append(f"initial = {initial!r}: choose 'unknown', 'rising' or 'falling'")
    if wrong:
        raise InputError(wrong)

    def read(source: Any) -> Log:
        return read_log(
            source, ["command", "m_w"], measured=["m_w"], optional=["enabled"], units=units, columns=columns,
            drop=drop, jumps=jumps, max_gap=max_gap,
        )  # fmt: skip

    data = read(log)
    _check(data, floor, m_max)
    if validation is not None:
        data = data.followed_by(read(validation))
    problem = ValveProblem(data, floor, settle, split, fit_until)
    model, fixed = problem.model(m_max, initial)
    best = minimise(model, problem.starts(m_max, initial), fixed=fixed)
    for better_ones in range(3):
        spread = uncertainty(model, best, fixed, profiled=[X_BL])
        grid = _grid(best, spread)
        sums, others = profile(model, best, X_BL, grid, fixed)
        if sums.min() > best.rss * (1.0 - 1e-6) or better_ones == 2:
            break
        best = minimise(model, np.stack([best.x, others[int(sums.argmin())].x], axis=1), fixed=fixed)
    limit = best.rss + spread.inflation[X_BL] * spread.quantile() ** 2 * spread.variance
    interval = _interval(grid, sums, best, limit)
    return problem.result(model, best, spread, (grid, sums, limit, interval), others[0], fixed, began)


def _check(data: Log, floor: float | None, m_max: float | None) -> None:
    command, flow = data.values["command"], data.values["m_w"]
    problems = []
    if np.isfinite(flow).sum() < FEWEST_SAMPLES:
        problems.append(f"{data.name}: {np.isfinite(flow).sum()} flows: give at least {FEWEST_SAMPLES}")
    for name, values in (("command", command), ("m_w", flow[np.isfinite(flow)])):
        if values.size and np.ptp(values) == 0.0:
            problems.append(
                f"{data.name}: {name} is {values[0]:g} from row {data.rows[0]} to row {data.rows[-1]}: "
                "give a log in which the valve moves"
            )
    top, reach = float(np.nanmax(flow)), float(command.max())
    if reach < _LEAST_REACH:
        problems.append(f"{data.name}: command is never above {reach:.3g} of the stroke: check its unit")
    if floor is not None and floor >= top:
        problems.append(f"floor = {floor:g} kg/s: {data.name} has no larger flow than {top:.3g} kg/s, give less")
    if m_max is not None and m_max < _LEAST_SHARE * top:
        problems.append(f"m_max = {m_max:g} kg/s: {data.name} has flows up to {top:.3g} kg/s, give as much at least")
    if problems:
        raise InputError(problems)


def _grid(best: Estimate, spread: Uncertainty) -> Array:
    """Sizes of backlash to profile: coarse over all that may be, fine where the minimum is."""
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
    inside: NDArray[np.int64] = np.flatnonzero(y <= limit)
    first, last = int(inside[0]), int(inside[-1])
    low, high = x[first], x[last]
    if first > 0:
        low = x[first] + (x[first - 1] - x[first]) * (limit - y[first]) / max(y[first - 1] - y[first], 1e-300)
    if last < x.size - 1:
        high = x[last] + (x[last + 1] - x[last]) * (limit - y[last]) / max(y[last + 1] - y[last], 1e-300)
    return float(low), float(high)

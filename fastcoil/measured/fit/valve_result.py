"""The result of a valve fit: parameters as a study takes them, their uncertainty, residuals of the whole log."""

from __future__ import annotations

import math
import time

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.measured.fit.result import (
    AT_BOUND,
    NOT_UNIQUE,
    Fit,
    labelled,
    natural_interval,
    poor,
    rms,
    sample_variables,
)
from fastcoil.measured.fit.sampling import judged
from fastcoil.measured.fit.split import FITTING, UNUSED, VALIDATION
from fastcoil.measured.fit.suspicion import suspicions
from fastcoil.measured.fit.valve_problem import LOGS, M_MAX, X_BL, ValveProblem, ValveSolution
from fastcoil.model.engine.recorded import VALVE_ROWS


def valve_fit(problem: ValveProblem, solution: ValveSolution, holds: bool, started: float) -> Fit:
    """The fit with everything a user may ask of it.

    holds: the command holds between the rows.  started: time of the call, by ``time.perf_counter``.
    """
    best, spread, profiled = solution.estimate, solution.uncertainty, solution.profile
    fitted = problem.good & problem.fitting
    of_signal = suspicions(problem.command[fitted], problem.flow[fitted])
    natural = best.x[:5].copy()
    natural[list(LOGS)] = np.exp(natural[list(LOGS)])
    slope = np.where(np.isin(np.arange(5), LOGS), natural, 1.0)
    covariance = spread.covariance[:5, :5] * np.outer(slope, slope)
    found = judged(problem, solution, holds or of_signal.inverted or problem.data.change_of_value)
    why = f"not identified: {of_signal.notes[0]}" if of_signal.inverted else found.why
    covariance = _as_wide(covariance, profiled.interval, found.interval)
    profiled = profiled._replace(interval=found.interval)
    held = {"backlash": why} if why else {}
    if M_MAX in solution.fixed:
        held["m_max"] = "given"
    for name, variance in zip(VALVE_ROWS[1:], np.diag(spread.covariance)[1:5], strict=True):
        if math.isnan(variance) and name not in held:
            held[name] = AT_BOUND
        elif math.isinf(variance) and name not in held:
            held[name] = NOT_UNIQUE
    parameters = dict(zip(VALVE_ROWS, natural.tolist(), strict=True))
    estimated = [k for k, name in enumerate(VALVE_ROWS) if name not in held]
    half = spread.quantile() * np.sqrt(np.diag(spread.covariance)[:5])
    bounds = [natural_interval(best.x[k], half[k], k in LOGS) for k in range(5)]
    bounds[X_BL] = profiled.interval
    intervals = {VALVE_ROWS[k]: bounds[k] for k in estimated}
    if why:
        del parameters["backlash"]
        problem.notes.append(
            f"the curve belongs to a backlash of {round(natural[X_BL], 4):g}, which is not identified: "
            "sweep it in a study"
        )
    reach = float(problem.command[: problem.n_fit].max())
    if reach < 0.9:
        problem.notes.append(f"commands reach {reach:.2g}: beyond it the curve is an extrapolation")
    problem.notes += [*of_signal.notes, *filter(None, [found.note])]
    n_compared = solution.model.used.sum()
    residuals, rmse = _residuals(problem, solution)
    problem.notes += poor(rmse, problem.flow[fitted], "m_w", "units, columns, and whether the pump ran")
    errors = np.sqrt(np.diag(covariance))
    return Fit(
        kind="valve",
        source=problem.data.name,
        parameters=parameters,
        standard_errors={VALVE_ROWS[k]: float(errors[k]) for k in estimated},
        intervals=intervals,
        covariance=labelled(covariance[np.ix_(estimated, estimated)], [VALVE_ROWS[k] for k in estimated]),
        profile=xr.Dataset(
            {"rmse": ("backlash", np.sqrt(profiled.sums / n_compared), {"units": "kg s-1"})},
            {"backlash": ("backlash", profiled.grid, {"units": "1"})},
            {"limit": math.sqrt(profiled.limit / n_compared), "interval_95": list(profiled.interval)},
        ),
        residuals=residuals,
        rmse=rmse,
        unit="kg/s",
        n_used=spread.n_used,
        n_effective=spread.n_effective,
        held=held,
        notes=problem.notes,
        seconds=time.perf_counter() - started,
        extras={"floor": np.array(problem.floor)} | {"curve": natural},
    )


def _as_wide(covariance: Array, before: tuple[float, float], after: tuple[float, float]) -> Array:
    """The covariance with the deviation of the backlash as much larger as its interval has become."""
    factor = np.ones(covariance.shape[0])
    factor[X_BL] = max((after[1] - after[0]) / max(before[1] - before[0], 1e-12), 1.0)
    return np.asarray(covariance * np.outer(factor, factor))


def _residuals(problem: ValveProblem, solution: ValveSolution) -> tuple[xr.Dataset, dict[str, float]]:
    """Measured and modelled flows over the whole log, also without backlash; RMSE by part."""
    n, n_batches = problem.command.size, int(problem.batch[-1]) + 1
    modelled = []
    for one in (solution.estimate, solution.without_backlash):
        start = np.full((n_batches, 1), 0.5)  # unknown for a batch held back
        start[: one.x.size - 5, 0] = one.x[5:]
        modelled.append([a[:, 0] for a in problem.flows(one.x[:5, None], start, n)])
    (openings, flow), (_, plain) = modelled
    part = np.where(problem.good, np.where(problem.fitting, FITTING, VALIDATION), UNUSED)
    rmse = {}
    for name in (FITTING, VALIDATION):
        here = part == name
        if here.any():
            rmse[name] = rms((flow - problem.flow)[here])
            rmse[f"{name}_without_backlash"] = rms((plain - problem.flow)[here])
    names = ("m_w", "modelled", "modelled_without_backlash", "residual", "command", "opening")
    values = (problem.flow, flow, plain, problem.flow - flow, problem.command, openings)
    ds = xr.Dataset(
        {
            name: ("elapsed_time", v, {"units": "1" if name in ("command", "opening") else "kg s-1"})
            for name, v in zip(names, values, strict=True)
        }
        | sample_variables(problem.data, part),
        {"elapsed_time": ("elapsed_time", problem.data.time, {"units": "s"})},
    )
    return ds, rmse

"""The result of a coil fit: parameters as a study takes them, their uncertainty, residuals of the whole log."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.measured.fit.coil_problem import COUPLED, CoilProblem, CoilSolution, is_coupled
from fastcoil.measured.fit.coil_record import COIL, LN_C_W, LOGS
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
from fastcoil.measured.fit.split import FITTING, UNUSED, VALIDATION
from fastcoil.model.parameter_table import PARAMETERS

_NOTHING = 5.0
"""Half an interval this wide means nothing: a factor of 150, or an exponent."""
_MARCH = ("n_volumes", "air_march", "substeps")
_STABLE = "at the stability limit (γ = 1 at the largest flow)"


def coil_fit(problem: CoilProblem, solution: CoilSolution, started: float) -> Fit:
    """The fit with everything a user may ask of it; ``started``: time of the call, by ``time.perf_counter``."""
    record, data, notes = problem.record, problem.data, problem.notes
    best, spread, wet = solution
    x = problem.complete(best.x[:, None])
    values = record.values(x)[:, 0]
    A = record.named() @ _coupling(problem.held)
    spread_y = A @ np.nan_to_num(spread.covariance, posinf=0.0) @ A.T
    half = spread.quantile() * np.sqrt(np.diag(spread_y))
    slope = np.where(LOGS, values, 1.0)
    covariance = spread_y * np.outer(slope, slope)
    held = {COIL[k]: why for k, why in sorted(problem.held.items())}
    for k, variance in enumerate(np.diag(spread.covariance)):
        if COIL[k] not in held and (math.isinf(variance) or half[k] > _NOTHING):
            held[COIL[k]] = NOT_UNIQUE
        if COIL[k] not in held and math.isnan(variance):
            least = k == LN_C_W and best.x[k] < problem.prior[k]
            held[COIL[k]] = _STABLE if least else AT_BOUND
    estimated = [k for k, name in enumerate(COIL) if name not in held]
    y = A @ x[:, 0]
    residuals, rmse = _residuals(problem, x)
    fitted = problem.compared["T_sup"] & problem.fitting
    notes += poor(rmse, data.values["T_sup"][fitted], "T_sup", "units, columns, and how the inputs run between samples")
    notes.append(f"{100 * (wet > 0).mean():.0f} % of the fitted samples have wet volumes, {wet.mean():.1f} on average")
    most = record.limits.m_w_max
    notes.append(f"stable up to the {most:.3g} kg/s of water in the part fitted; for more, raise C_w in proportion")
    marched = {n: record.loop[n] for n in _MARCH if record.loop[n] != PARAMETERS[n].default}
    if marched:
        given = ", ".join(f"{name} = {value!r}" for name, value in marched.items())
        notes.append(f"fitted with {given}: give the loop the same, the parameters belong to it")
    return Fit(
        kind="coil",
        source=data.name,
        parameters={name: float(v) for name, v in zip(COIL, values, strict=True)},
        standard_errors={COIL[k]: float(np.sqrt(covariance[k, k])) for k in estimated},
        intervals={COIL[k]: natural_interval(y[k], half[k], bool(LOGS[k])) for k in estimated},
        covariance=labelled(covariance[np.ix_(estimated, estimated)], [COIL[k] for k in estimated]),
        profile=None,
        residuals=residuals,
        rmse=rmse,
        unit="K",
        n_used=spread.n_used,
        n_effective=spread.n_effective,
        held=held,
        notes=notes,
        seconds=time.perf_counter() - started,
    )


def _coupling(held: Mapping[int, str]) -> Array:
    """Matrix (8, 8) that gives a coupled parameter the value, and the uncertainty, of the other."""
    C = np.eye(8)
    for k, other in COUPLED.items():
        if is_coupled(held, k):
            C[k, k], C[k, other] = 0.0, 1.0
    return C


def _residuals(problem: CoilProblem, x: Array) -> tuple[xr.Dataset, dict[str, float]]:
    """Measured and modelled temperatures over all samples, and RMSE by part."""
    data, compared = problem.data, problem.compared
    found = {name: values[:, 0] for name, values in problem.record.run(x)._asdict().items()}
    if not problem.record.is_stable(x):
        for values in found.values():
            values[~problem.fitting] = np.nan
        problem.notes.append(
            f"not validated: the coil is unstable at the flows of the part held back, up to "
            f"{problem.record.limits_of_all.m_w_max:.3g} kg/s of water: fit a part that has such flows"
        )
    part = np.where(problem.fitting, FITTING, VALIDATION)
    variables: dict[str, Any] = sample_variables(data, np.where(compared["T_sup"], part, UNUSED))
    rmse = {}
    for name in ("T_sup", "T_w_out"):
        measured = data.values.get(name, np.full(part.size, np.nan))
        variables |= {
            name: ("elapsed_time", measured, {"units": "degC"}),
            f"{name}_modelled": ("elapsed_time", found[name], {"units": "degC"}),
            f"{name}_residual": ("elapsed_time", measured - found[name], {"units": "K"}),
        }
        for p in (FITTING, VALIDATION):
            here = compared.get(name, np.zeros(part.size, dtype=bool)) & (part == p) & np.isfinite(found[name])
            if here.any():
                rmse[p if name == "T_sup" else f"{p}_{name}"] = rms((found[name] - measured)[here])
    variables["wet_volumes"] = ("elapsed_time", found["wet_volumes"], {"units": "1"})
    for name in ("m_w", "m_a"):
        variables[name] = ("elapsed_time", data.values[name], {"units": "kg s-1"})
    return xr.Dataset(variables, {"elapsed_time": ("elapsed_time", data.time, {"units": "s"})}), rmse

"""The least-squares problem of a valve: which samples are compared, the model over them, and the result."""

from __future__ import annotations

import math
import time
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.arrays import Array
from fastcoil.calibrate.least_squares import Estimate, Model, Uncertainty
from fastcoil.calibrate.result import (
    AT_BOUND,
    NOT_UNIQUE,
    Fit,
    labelled,
    natural_interval,
    poor,
    rms,
    sample_variables,
)
from fastcoil.calibrate.split import FITTING, UNUSED, VALIDATION, fitted_part
from fastcoil.calibrate.valve_record import lowest_reading, reversals, sensor_off, settled, why_unidentified
from fastcoil.engine.valve_loop import VALVE_ROWS, valve_flows
from fastcoil.errors import InputError
from fastcoil.logs import Log
from fastcoil.logs.notes import counted, first_row

FEWEST_SAMPLES = 20
LARGEST_BACKLASH = 0.5
X_BL, _M_MAX, _A, _B, _C = range(5)
_LOGS = (_M_MAX, _A, _B)


class BacklashProfile(NamedTuple):
    """Least sum of squares with the backlash held at each value of ``grid``, (n,).

    limit: the sum that the 95 % ``interval`` stays below.
    """

    grid: Array
    sums: Array
    limit: float
    interval: tuple[float, float]


class ValveProblem:
    """The log, which samples of it are compared, and the model over it."""

    def __init__(
        self, data: Log, floor: float | None, settle: float | None, split: float | None, fit_until: float | None
    ) -> None:
        self.data = data
        self.command, self.flow = data.values["command"], data.values["m_w"]
        self.notes = list(data.notes)
        self.floor = lowest_reading(self.flow, self.notes) if floor is None else floor
        off = sensor_off(self.command, self.flow, self.floor)
        if off.any():
            self.notes.append(
                f"{counted(off, 'flow')} left out, sensor or pump off: 0, or the meter's floor with the valve open "
                f"({first_row(data.rows.tolist(), off)})"
            )
        at_rest = settled(data, settle, self.notes)
        enabled = data.values.get("enabled", np.ones(self.flow.size)) != 0.0
        if not enabled.all():
            self.notes.append(f"{counted(~enabled, 'flow')} not compared: enabled is 0")
        self.good = np.isfinite(self.flow) & ~off & at_rest & enabled
        self.fitting = fitted_part(data, split, fit_until)
        to_fit = self.good & self.fitting
        if to_fit.sum() < FEWEST_SAMPLES:
            raise InputError(
                f"{data.name}: {counted(to_fit, 'flow')} left to fit: give at least {FEWEST_SAMPLES}, "
                f"lower settle, raise split, or give a longer log ({'; '.join(self.notes)})"
            )
        last = int(np.flatnonzero(self.fitting)[-1]) + 1
        self.n_fit = last
        self.batch = data.batch
        self.top = float(np.nanmax(self.flow))
        self.n_reversals = reversals(self.command[self.fitting], self.batch[self.fitting])

    def flows(self, sets: Array, start: Array, n: int) -> tuple[Array, Array]:
        """Openings and flows of parameter sets (5, sets) over the first n samples, the meter's floor included."""
        openings, flows = np.empty((n, sets.shape[1])), np.empty((n, sets.shape[1]))
        rows = sets.copy()
        rows[list(_LOGS)] = np.exp(rows[list(_LOGS)])
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
            lower[_M_MAX] = min(lower[_M_MAX], math.log(m_max) - 1.0)
            upper[_M_MAX] = max(upper[_M_MAX], math.log(m_max) + 1.0)
        step = np.array([1e-3, 1e-4, 1e-4, 1e-4, 1e-4, *[0.02] * n_batches])
        fixed = [] if m_max is None else [_M_MAX]
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

    def result(
        self,
        model: Model,
        best: Estimate,
        spread: Uncertainty,
        profiled: BacklashProfile,
        without: Estimate,
        fixed: list[int],
        started: float,
    ) -> Fit:
        """The fit with everything a user may ask of it.

        Parameters
        ----------
        model, best, spread, fixed
            The problem, its minimum, how well it is known, and the indices of the parameters held in it.
        profiled, without
            The profile over the backlash, and the minimum without backlash.
        started
            Time of the call, by ``time.perf_counter``.
        """
        natural = best.x[:5].copy()
        natural[list(_LOGS)] = np.exp(natural[list(_LOGS)])
        slope = np.where(np.isin(np.arange(5), _LOGS), natural, 1.0)
        covariance = spread.covariance[:5, :5] * np.outer(slope, slope)
        why = why_unidentified(self.n_reversals, float(natural[X_BL]), profiled.interval, profiled.grid[-1])
        held = {"backlash": why} if why else {}
        if _M_MAX in fixed:
            held["m_max"] = "given"
        for name, variance in zip(VALVE_ROWS[1:], np.diag(spread.covariance)[1:5], strict=True):
            if math.isnan(variance) and name not in held:
                held[name] = AT_BOUND
            elif math.isinf(variance) and name not in held:
                held[name] = NOT_UNIQUE
        parameters = dict(zip(VALVE_ROWS, natural.tolist(), strict=True))
        estimated = [k for k, name in enumerate(VALVE_ROWS) if name not in held]
        half = spread.quantile() * np.sqrt(np.diag(spread.covariance)[:5])
        bounds = [natural_interval(best.x[k], half[k], k in _LOGS) for k in range(5)]
        bounds[X_BL] = profiled.interval
        intervals = {VALVE_ROWS[k]: bounds[k] for k in estimated}
        if why:
            del parameters["backlash"]
            self.notes.append(
                f"the curve belongs to a backlash of {natural[X_BL]:.3g}, which is not identified: sweep it in a study"
            )
        reach = float(self.command[: self.n_fit].max())
        if reach < 0.9:
            self.notes.append(f"commands reach {reach:.2g}: beyond it the curve is an extrapolation")
        n_compared = model.used.sum()
        residuals, rmse, extras = self._residuals(best, without)
        self.notes += poor(rmse, self.flow[self.good & self.fitting], "m_w", "units, columns, and whether the pump ran")
        errors = np.sqrt(np.diag(covariance))
        return Fit(
            kind="valve",
            source=self.data.name,
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
            notes=self.notes,
            seconds=time.perf_counter() - started,
            extras=extras | {"curve": natural},
        )

    def _residuals(self, best: Estimate, without: Estimate) -> tuple[xr.Dataset, dict[str, float], dict[str, Array]]:
        """Measured and modelled flows over the whole log, also without backlash; RMSE by part; the meter's floor."""
        n, n_batches = self.command.size, int(self.batch[-1]) + 1
        modelled = []
        for one in (best, without):
            start = np.full((n_batches, 1), 0.5)  # unknown for a batch held back
            start[: one.x.size - 5, 0] = one.x[5:]
            modelled.append([a[:, 0] for a in self.flows(one.x[:5, None], start, n)])
        (openings, flow), (_, plain) = modelled
        part = np.where(self.good, np.where(self.fitting, FITTING, VALIDATION), UNUSED)
        rmse = {}
        for name in (FITTING, VALIDATION):
            here = part == name
            if here.any():
                rmse[name] = rms((flow - self.flow)[here])
                rmse[f"{name}_without_backlash"] = rms((plain - self.flow)[here])
        names = ("m_w", "modelled", "modelled_without_backlash", "residual", "command", "opening")
        values = (self.flow, flow, plain, self.flow - flow, self.command, openings)
        ds = xr.Dataset(
            {
                name: ("elapsed_time", v, {"units": "1" if name in ("command", "opening") else "kg s-1"})
                for name, v in zip(names, values, strict=True)
            }
            | sample_variables(self.data, part),
            {"elapsed_time": ("elapsed_time", self.data.time, {"units": "s"})},
        )
        return ds, rmse, {"floor": np.array(self.floor)}

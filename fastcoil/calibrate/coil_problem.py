"""The least-squares problem of a coil: what of a record is compared, what is held, and the fit in full."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.boundary.series import Array
from fastcoil.calibrate.coil_record import (
    BETA2,
    BETA4,
    BETA6,
    COIL,
    LN_C_C,
    LN_C_W,
    LN_NTU_A,
    LN_NTU_STAR,
    LN_NTU_W,
    LOGS,
    Record,
    residual_rows,
)
from fastcoil.calibrate.data import Log
from fastcoil.calibrate.estimate import Estimate, Model, Uncertainty, minimise, uncertainty
from fastcoil.calibrate.parts import fitted_part
from fastcoil.calibrate.result import FITTING, UNUSED, VALIDATION, Fit, labelled, rms
from fastcoil.errors import InputError

_PRIOR_EXPONENT = {BETA2: -0.2, BETA4: -0.45, BETA6: -0.42}
"""Exponents of turbulent flow: NTU = UA/(m cp) with UA rising as m^0.8 in the tubes, m^0.55 over the fins."""
_UNKNOWN = {True: 0.7, False: 0.5}
"""A standard error above this says that the data tell nothing: of a logarithm (factor 2), of an exponent."""
_CONSTANT = 0.02
"""A flow that varies by less than this share is constant."""
_N_STARTS = 256
_STEP = 2e-3
"""Of the differences: long against the jumps where a volume turns wet."""
_FEWEST_SAMPLES = 16
_POOR = 0.8
_WARM = 5.0
_COARSE = 10.0
"""Samples further apart than this leave open what happens between them, s."""
_COUPLED = {LN_NTU_STAR: LN_NTU_A, BETA6: BETA4}


class CoilProblem:
    """The record, what of it is compared, what is held."""

    def __init__(
        self,
        data: Log,
        record: Record,
        outputs: tuple[str, ...],
        warm_up: float,
        split: float,
        fit_until: float | None,
        holds: tuple[str, ...] = (),
    ) -> None:
        self.data, self.record, self.outputs = data, record, outputs
        self.notes = list(data.notes)
        self._leave_out_zeros()
        self.warm = data.time >= warm_up
        self.fitting = fitted_part(data, split, fit_until)
        self.n_fit = int(self.fitting.sum())
        compared = self.warm & self.fitting & np.isfinite(data.values["T_sup"])
        if compared.sum() < _FEWEST_SAMPLES:
            raise InputError(
                f"{data.name}: {int(compared.sum())} temperatures lie between the warm-up of {warm_up:g} s and the end "
                f"of the part to fit, at {data.time[self.n_fit - 1]:g} s: give at least {_FEWEST_SAMPLES}, lower "
                "warm_up, raise split, or give a longer log"
            )
        T_sup = data.values["T_sup"][compared]
        if np.ptp(T_sup) == 0.0:
            raise InputError(f"{data.name}: T_sup is {T_sup[0]:g} throughout: check the sensor")
        if data.step > _COARSE and not holds:
            self.notes.append(
                f"between samples {data.step:g} s apart the inputs run straight: name in holds those that step"
            )
        self.prior = self._prior()
        self.held: dict[int, str] = {}
        for flow, exponents, what in (("m_a", (BETA4, BETA6), "air"), ("m_w", (BETA2,), "water")):
            values = data.values[flow][compared]
            if np.ptp(values) < _CONSTANT * values.mean():
                self.held |= {k: f"held at a prior: the {what} flow is constant" for k in exponents}

    def _leave_out_zeros(self) -> None:
        """A temperature of exactly 0 among far warmer ones is a sensor that is off."""
        for name in ("T_sup", "T_w_out"):
            values = self.data.values.get(name)
            if values is not None and np.nanmedian(values) > _WARM and (off := values == 0.0).any():
                row = self.data.rows[int(np.argmax(off))]
                self.notes.append(f"{int(off.sum())} values left out: {name} is 0, sensor off (first in row {row})")
                self.data.values[name] = np.where(off, np.nan, values)

    def _prior(self) -> Array:
        """What is taken for a parameter that the data do not identify."""
        x = np.array([self._least_C_w() + math.log(1.05), 0.0, math.log(0.35), 0.0, math.log(0.35), 0.0, 0.0, 0.0])
        x[LN_C_C] = x[LN_C_W] + math.log(10.0 / 8.8)
        x[LN_NTU_STAR] = x[LN_NTU_A]
        for k, value in _PRIOR_EXPONENT.items():
            x[k] = value
        return x

    def _least_C_w(self) -> float:
        """ln of the C_w with γ = 1 at the largest flow."""
        loop = self.record.loop
        return math.log(self.record.m_w_max * float(loop["cp_w"]) * int(loop["n_volumes"]) / 8.0)  # type: ignore[arg-type]

    def complete(self, sets: Array) -> Array:
        """Parameter sets with what is coupled to another filled in: a dry coil's ε* is its ε."""
        sets = sets.copy()
        for k, other in _COUPLED.items():
            if self.held.get(k, "").startswith("as"):
                sets[k] = sets[other]
        return sets

    def model(self) -> Model:
        """The least-squares problem of the part to fit."""
        part = self.record.until(self.n_fit)
        n = self.n_fit
        measured = [self.data.values[name][:n] for name in self.outputs]
        used = [self.warm[:n] & np.isfinite(values) for values in measured]

        def residuals(sets: Array) -> Array:
            found = dict(zip(("T_sup", "T_w_out"), part.run(self.complete(sets))[:2], strict=True))
            rows = [residual_rows(found[o], m, u) for o, m, u in zip(self.outputs, measured, used, strict=True)]
            return np.concatenate(rows)

        low = self._least_C_w()
        lower = np.array([low, low - 5.0, -5.0, -2.0, -5.0, -2.0, -5.0, -2.0])
        upper = np.array([low + 4.0, low + 8.0, 3.0, 1.0, 3.0, 1.0, 3.0, 1.0])
        segment = np.repeat(np.arange(len(measured)), n)
        return Model(residuals, lower, upper, np.full(8, _STEP), segment, np.concatenate(used))

    def starts(self) -> Array:
        """A space-filling set of physical guesses, (8, sets)."""
        from scipy.stats import qmc

        unit = qmc.Sobol(8, seed=0).random(_N_STARTS).T
        low, least = np.array([0.02, -1.0, -2.5, -0.6, -2.5, -0.7, -0.4, -0.7]), self._least_C_w()
        high = np.array([1.5, 3.0, 1.0, 0.0, 1.0, 0.0, 0.4, 0.0])
        x = low[:, None] + (high - low)[:, None] * unit
        x[LN_C_W] += least
        x[LN_C_C] += x[LN_C_W]
        x[LN_NTU_STAR] += x[LN_NTU_A]
        for k in self.held:
            x[k] = self.prior[k]
        return np.asarray(x)

    def solve(self, began: float) -> Fit:
        """Fit, hold what turns out to be unknown, and fit again until all that is free is known."""
        model, starts = self.model(), self.starts()
        best = minimise(model, starts, fixed=list(self.held))
        wet = self.record.until(self.n_fit).run(self.complete(best.x[:, None]))[2][self.warm[: self.n_fit]]
        if not wet.any():
            self.held |= {k: "as that of heat alone: the coil is never wet" for k in _COUPLED}
            best = minimise(model, best.x[:, None], fixed=list(self.held))
        spread = uncertainty(model, best, list(self.held))
        needed: set[int] = set()
        while (k := self._least_known(model, best, spread, needed)) is not None:
            x = best.x.copy()
            x[k] = self.prior[k]
            if k in _COUPLED:
                self.held[k] = "as that of heat alone: the data do not tell them apart"
            else:
                self.held[k] = "held at a prior: the data do not identify it"
            tried = minimise(model, x[:, None], fixed=list(self.held))
            if tried.rss - best.rss > spread.quantile() ** 2 * spread.variance * spread.inflation[k]:
                del self.held[k]  # little is known of it, but the prior it is not
                needed.add(k)
                continue
            best, needed = tried, set()
            spread = uncertainty(model, best, list(self.held))
        return self.result(best, spread, wet, began)

    def _least_known(self, model: Model, best: Estimate, spread: Uncertainty, needed: set[int]) -> int | None:
        """The free parameter that the data say least of, if that is nothing."""
        error = np.sqrt(np.diag(spread.covariance)) / np.where(LOGS, _UNKNOWN[True], _UNKNOWN[False])
        span = model.upper - model.lower
        far = (best.x > model.upper - 1e-6 * span) | (best.x < model.lower + 1e-6 * span)
        far[LN_C_W] = False  # its lower bound is where the scheme is still stable, a good answer
        error = np.where(far | np.isin(np.arange(8), spread.dead), np.inf, np.nan_to_num(error, posinf=np.inf))
        # a factor is the last thing to give up: without it nothing is exchanged
        rank = np.where(np.isin(np.arange(8), (LN_NTU_W, LN_NTU_A)), error / 10.0, error)
        rank[[*self.held, *needed]] = 0.0
        k = int(np.argmax(rank))
        return k if error[k] > 1.0 and rank[k] > 0.0 else None

    def result(self, best: Estimate, spread: Uncertainty, wet: Array, began: float) -> Fit:
        """The fit with everything a user may ask of it."""
        x = self.complete(best.x[:, None])
        values = self.record.values(x)[:, 0]
        A = self.record.named()
        if coupled := [k for k, why in self.held.items() if why.startswith("as")]:
            A = A @ self._coupling(coupled)
        spread_y = A @ np.nan_to_num(spread.covariance) @ A.T
        half = spread.quantile() * np.sqrt(np.diag(spread_y))
        slope = np.where(LOGS, values, 1.0)
        covariance = spread_y * np.outer(slope, slope)
        held = {COIL[k]: why for k, why in sorted(self.held.items())}
        for name, variance in zip(COIL, np.diag(spread.covariance), strict=True):
            if math.isnan(variance) and name not in held:
                held[name] = "at the bound of what can be run (γ = 1 at the largest flow)"
        estimated = [k for k, name in enumerate(COIL) if name not in held]
        y = A @ x[:, 0]
        intervals = {}
        for k in estimated:
            low, high = y[k] - half[k], y[k] + half[k]
            intervals[COIL[k]] = (math.exp(low), math.exp(high)) if LOGS[k] else (low, high)
        residuals, rmse = self._residuals(x)
        explained = 1.0 - (rmse[FITTING] / float(np.nanstd(self.data.values["T_sup"][self.warm & self.fitting]))) ** 2
        if explained < _POOR:
            self.notes.append(
                f"the model explains only {max(explained, 0.0):.0%} of the variance of T_sup: check units, columns and "
                "how the inputs run between samples"
            )
        n_volumes = int(self.record.loop["n_volumes"])  # type: ignore[arg-type]
        self.notes.append(f"{(wet > 0).mean():.0%} of the fitted samples have wet volumes, {wet.mean():.1f} on average")
        self.notes.append(
            f"stable up to the recorded {self.record.m_w_max:.3g} kg/s of water; for more, raise C_w in proportion"
        )
        return Fit(
            kind="coil",
            source=self.data.name,
            parameters={name: float(v) for name, v in zip(COIL, values, strict=True)},
            standard_errors={COIL[k]: float(np.sqrt(covariance[k, k])) for k in estimated},
            intervals=intervals,
            covariance=labelled(covariance[np.ix_(estimated, estimated)], [COIL[k] for k in estimated]),
            profile=None,
            residuals=residuals,
            rmse=rmse,
            unit="K",
            n_used=spread.n_used,
            n_effective=spread.n_effective,
            held=held,
            notes=self.notes,
            seconds=time.perf_counter() - began,
            extras={"n_volumes": np.array(n_volumes)},
        )

    @staticmethod
    def _coupling(coupled: list[int]) -> Array:
        C = np.eye(8)
        for k in coupled:
            C[k, k], C[k, _COUPLED[k]] = 0.0, 1.0
        return C

    def _residuals(self, x: Array) -> tuple[xr.Dataset, dict[str, float]]:
        """Measured and modelled temperatures over the whole log, and RMSE by part."""
        found = dict(zip(("T_sup", "T_w_out", "wet_volumes"), (a[:, 0] for a in self.record.run(x)), strict=True))
        part = np.where(self.warm, np.where(self.fitting, FITTING, VALIDATION), UNUSED)
        variables: dict[str, Any] = {"part": ("elapsed_time", part), "row": ("elapsed_time", self.data.rows)}
        rmse = {}
        for name in ("T_sup", "T_w_out"):
            measured = self.data.values.get(name, np.full(part.size, np.nan))
            variables |= {
                name: ("elapsed_time", measured, {"units": "degC"}),
                f"{name}_modelled": ("elapsed_time", found[name], {"units": "degC"}),
                f"{name}_residual": ("elapsed_time", measured - found[name], {"units": "K"}),
            }
            for p in (FITTING, VALIDATION):
                r = (found[name] - measured)[(part == p) & np.isfinite(measured)]
                if r.size:
                    rmse[p if name == "T_sup" else f"{p}_{name}"] = rms(r)
        variables["wet_volumes"] = ("elapsed_time", found["wet_volumes"], {"units": "1"})
        for name in ("m_w", "m_a"):
            variables[name] = ("elapsed_time", self.data.values[name], {"units": "kg s-1"})
        return xr.Dataset(variables, {"elapsed_time": ("elapsed_time", self.data.time, {"units": "s"})}), rmse

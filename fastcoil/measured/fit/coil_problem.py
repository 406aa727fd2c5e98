"""The least-squares problem of a coil: which samples are compared, which parameters are held, and its solution."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs import Log
from fastcoil.logs.notes import counted
from fastcoil.measured.fit.coil_record import (
    BETA2,
    BETA4,
    BETA6,
    LN_C_C,
    LN_C_W,
    LN_NTU_A,
    LN_NTU_STAR,
    LN_NTU_W,
    LOGS,
    Record,
    residual_rows,
)
from fastcoil.measured.fit.least_squares import Estimate, Model, Uncertainty, minimise, uncertainty
from fastcoil.measured.fit.split import fitted_part

_PRIOR_EXPONENT = {BETA2: -0.2, BETA4: -0.45, BETA6: -0.42}
"""Exponents of turbulent flow: NTU = UA/(m cp) with UA rising as m^0.8 in the tubes, m^0.55 over the fins."""
_UNKNOWN = {True: 0.7, False: 0.5}
"""A parameter with a larger standard error is not identified: of a logarithm (a factor of 2), of an exponent."""
_CONSTANT = 0.02
"""A flow that varies by less than this share is constant."""
_N_STARTS = 256
_STEP = 2e-3
"""Of the differences: long compared with the jumps where a volume turns wet."""
_FEWEST_SAMPLES = 16
_STILL = 0.02
"""Water stands still below this share of its typical flow: its sensor then says nothing of the coil."""
_COARSE = 10.0
"""Between samples further apart than this an input may step, s."""
COUPLED = {LN_NTU_STAR: LN_NTU_A, BETA6: BETA4}
"""Parameters that the data may not tell apart: the first is then held at the value of the second."""
_AS_DRY = "as that of heat alone"


class CoilSolution(NamedTuple):
    """The minimum, how well it is known, and the wet volumes of the fitted samples, (n,)."""

    estimate: Estimate
    uncertainty: Uncertainty
    wet_volumes: Array


class CoilProblem:
    """The record, which samples of it are compared, and which parameters are held."""

    def __init__(
        self,
        data: Log,
        record: Record,
        outputs: tuple[str, ...],
        warm_up: float,
        split: float | None,
        fit_until: float | None,
        holds: tuple[str, ...] = (),
    ) -> None:
        self.data, self.record, self.outputs = data, record, outputs
        self.notes = list(data.notes)
        self.warm = data.since_batch() >= warm_up
        self.fitting = fitted_part(data, split, fit_until)
        self.n_fit = int(self.fitting.sum())
        flowing = data.values["m_w"] > _STILL * record.m_w
        self.compared = {
            name: self.warm & np.isfinite(values) & (flowing | (name == "T_sup"))
            for name in ("T_sup", "T_w_out")
            if (values := data.values.get(name)) is not None
        }
        self._note_what_is_not_compared(warm_up, flowing)
        compared = self.compared["T_sup"] & self.fitting
        if compared.sum() < _FEWEST_SAMPLES:
            raise InputError(
                f"{data.name}: {counted(compared, 'temperature')} to compare between the warm-up of {warm_up:g} s and "
                f"the end of the part to fit, at {data.time[self.n_fit - 1]:g} s: give at least {_FEWEST_SAMPLES}, "
                f"lower warm_up, raise split, or give a longer log ({'; '.join(self.notes) or 'no gaps'})"
            )
        T_sup = data.values["T_sup"][compared]
        if np.ptp(T_sup) == 0.0:
            raise InputError(f"{data.name}: T_sup is {T_sup[0]:g} throughout: check the sensor")
        if data.step > _COARSE and not holds:
            self.notes.append(
                f"samples are {data.step:g} s apart and the inputs run straight between them: if some hold until the "
                "next sample, name them: holds=['m_w'], --hold m_w"
            )
        self.prior = self._prior()
        self.held: dict[int, str] = {}
        for flow, exponents, what in (("m_a", (BETA4, BETA6), "air"), ("m_w", (BETA2,), "water")):
            values = data.values[flow][compared]
            if np.ptp(values) < _CONSTANT * values.mean():
                self.held |= {k: f"held at a prior: the {what} flow is constant" for k in exponents}

    def _note_what_is_not_compared(self, warm_up: float, flowing: Mask) -> None:
        batch = self.data.batch
        if self.data.n_batches > 1:
            short = self.data.n_batches - np.unique(batch[self.warm]).size
            self.notes.append(
                f"{counted(self.data.n_batches, 'unbroken piece')}, each starting at "
                f"{self.record.loop['T_initial']:g} degC, the first {warm_up:g} s of each left out "
                f"({short} shorter than that)"
            )
        if "T_w_out" in self.compared and not flowing.all():
            self.notes.append(f"{counted(~flowing, 'sample')} of T_w_out not compared: no water flows")

    def _prior(self) -> Array:
        """The values of parameters that the data do not identify."""
        x = np.array([self._least_C_w() + math.log(1.05), 0.0, math.log(0.35), 0.0, math.log(0.35), 0.0, 0.0, 0.0])
        x[LN_C_C] = x[LN_C_W] + math.log(10.0 / 8.8)
        x[LN_NTU_STAR] = x[LN_NTU_A]
        for k, value in _PRIOR_EXPONENT.items():
            x[k] = value
        return x

    def _least_C_w(self) -> float:
        """ln of the C_w with γ = 1 at the largest flow."""
        loop = self.record.loop
        cp_w, n_volumes, substeps = (float(loop[name]) for name in ("cp_w", "n_volumes", "substeps"))  # type: ignore[arg-type]
        return math.log(self.record.limits.m_w_max * cp_w * n_volumes / 8.0 / substeps)

    def complete(self, sets: Array) -> Array:
        """Parameter sets with the coupled ones filled in: a dry coil's ε* is its ε."""
        sets = sets.copy()
        for k, other in COUPLED.items():
            if is_coupled(self.held, k):
                sets[k] = sets[other]
        return sets

    def model(self) -> Model:
        """The least-squares problem of the part to fit."""
        part = self.record.until(self.n_fit)
        n = self.n_fit
        measured = [self.data.values[name][:n] for name in self.outputs]
        used = [self.compared[name][:n] for name in self.outputs]

        def residuals(sets: Array) -> Array:
            run = part.run(self.complete(sets))
            rows = [residual_rows(getattr(run, o), m, u) for o, m, u in zip(self.outputs, measured, used, strict=True)]
            return np.concatenate(rows)

        low = self._least_C_w()
        lower = np.array([low, low - 5.0, -5.0, -2.0, -5.0, -2.0, -5.0, -2.0])
        upper = np.array([low + 4.0, low + 8.0, 3.0, 1.0, 3.0, 1.0, 3.0, 1.0])
        segment = np.concatenate([self.data.batch[:n] + k * self.data.n_batches for k in range(len(measured))])
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

    def solve(self) -> CoilSolution:
        """Fit, hold parameters that turn out to be unknown, and fit again until all free ones are known."""
        model, starts = self.model(), self.starts()
        best = minimise(model, starts, fixed=list(self.held))
        run = self.record.until(self.n_fit).run(self.complete(best.x[:, None]))
        wet = run.wet_volumes[self.warm[: self.n_fit], 0]
        if not wet.any():
            self.held |= {k: f"{_AS_DRY}: the coil is never wet" for k in COUPLED}
            best = minimise(model, best.x[:, None], fixed=list(self.held))
        spread = uncertainty(model, best, list(self.held))
        needed: set[int] = set()
        while (k := self._least_known(model, best, spread, needed)) is not None:
            x = best.x.copy()
            x[k] = self.prior[k]
            if k in COUPLED:
                self.held[k] = f"{_AS_DRY}: the data do not tell them apart"
            else:
                self.held[k] = "held at a prior: the data do not identify it"
            tried = minimise(model, x[:, None], fixed=list(self.held))
            if tried.rss - best.rss > spread.quantile() ** 2 * spread.variance * spread.inflation[k]:
                del self.held[k]  # little is known of it, but it is not the prior
                needed.add(k)
                continue
            best, needed = tried, set()
            spread = uncertainty(model, best, list(self.held))
        return CoilSolution(estimate=best, uncertainty=spread, wet_volumes=wet)

    def _least_known(self, model: Model, best: Estimate, spread: Uncertainty, needed: set[int]) -> int | None:
        """The free parameter that the data say least about, if they do not identify it."""
        error = np.sqrt(np.diag(spread.covariance)) / np.where(LOGS, _UNKNOWN[True], _UNKNOWN[False])
        span = model.upper - model.lower
        far_down = best.x < model.lower + 1e-6 * span
        far_down[LN_C_W] = False  # a good answer: there the scheme is just stable
        far = far_down | (best.x > model.upper - 1e-6 * span)
        error = np.where(far | np.isin(np.arange(8), spread.dead), np.inf, np.nan_to_num(error, posinf=np.inf))
        # give up a factor last: without it no heat is exchanged
        rank = np.where(np.isin(np.arange(8), (LN_NTU_W, LN_NTU_A)), error / 10.0, error)
        rank[[*self.held, *needed]] = 0.0
        k = int(np.argmax(rank))
        return k if error[k] > 1.0 and rank[k] > 0.0 else None


def is_coupled(held: Mapping[int, str], k: int) -> bool:
    """Whether a parameter is held at the value of another."""
    return held.get(k, "").startswith(_AS_DRY)

"""A log of a coil as 1-s series, and the residuals of many parameter sets on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastcoil.boundary import moist_air
from fastcoil.boundary.series import Array
from fastcoil.calibrate.data import Log
from fastcoil.calibrate.estimate import FORBIDDEN
from fastcoil.engine.coil_loop import COIL_SERIES, run_coil
from fastcoil.engine.lanes import LANES, PARAMETER_ROWS, Block, parameter_matrix
from fastcoil.engine.rates import worst_numbers
from fastcoil.errors import InputError
from fastcoil.layout import columns_of
from fastcoil.scenario import Loop

COIL = ("C_w", "C_c", "beta1", "beta2", "beta3", "beta4", "beta5", "beta6")
LOGS = np.array([True, True, True, False, True, False, True, False])
"""Which of ``COIL`` are searched by their logarithm."""
LN_C_W, LN_C_C, LN_NTU_W, BETA2, LN_NTU_A, BETA4, LN_NTU_STAR, BETA6 = range(8)
"""What is searched: as ``COIL``, but numbers of transfer units at the typical flow in place of their factors."""
_ROWS = np.array([PARAMETER_ROWS.index(name) for name in COIL])
_AIR_FLOWS = 9
_LONGEST = 40 * 86400


@dataclass(frozen=True)
class Record:
    """What enters the coil second by second, and when something is measured.

    series: (n_steps, 5) as ``COIL_SERIES``.  at: (n,), second of each sample.  m_w, m_a: typical flows, kg/s.
    """

    series: Array
    at: NDArray[np.int64]
    loop: Loop
    m_w: float
    m_a: float

    @property
    def m_w_max(self) -> float:
        return float(self.series[:, 4].max())

    def until(self, n_samples: int) -> Record:
        """The record up to its first samples."""
        end = int(self.at[n_samples - 1]) + 1
        return Record(self.series[:end], self.at[:n_samples], self.loop, self.m_w, self.m_a)

    def named(self) -> Array:
        """Matrix that turns what is searched into (the logarithms of) ``COIL``: ln β = ln NTU - β' ln m."""
        A = np.eye(8)
        A[LN_NTU_W, BETA2] = -math.log(self.m_w)
        A[LN_NTU_A, BETA4] = A[LN_NTU_STAR, BETA6] = -math.log(self.m_a)
        return A

    def values(self, sets: Array) -> Array:
        """``COIL`` of parameter sets as searched, (8, sets)."""
        y = self.named() @ sets
        return np.where(LOGS[:, None], np.exp(np.minimum(y, 50.0)), y)

    def run(self, sets: Array) -> tuple[Array, Array, Array]:
        """T_sup, T_w_out and wet volumes of each parameter set, (n, sets); NaN of those that are unstable."""
        n_sets = sets.shape[1]
        base = parameter_matrix(columns_of(self.loop, {}, np.array([0])))
        matrix = np.repeat(base, n_sets, axis=1)
        matrix[_ROWS] = self.values(sets)
        unstable = self._unstable(matrix)
        found = [np.empty((self.at.size, n_sets)) for _ in range(3)]
        n_volumes, lagged = int(base[PARAMETER_ROWS.index("n_volumes"), 0]), bool(self.loop["air_march"] == "lagged")
        for first in range(0, n_sets, LANES):
            lanes = np.minimum(np.arange(first, first + LANES), n_sets - 1)
            rows = np.ascontiguousarray(matrix[:, lanes])
            block = Block(rows, n_volumes, lagged, 1, True, 0, False, False)
            n_used = min(LANES, n_sets - first)
            for whole, part in zip(found, run_coil(block, self.series, self.at), strict=True):
                whole[:, first : first + n_used] = part[:, :n_used]
        for whole in found:
            whole[:, unstable] = np.nan
        return found[0], found[1], found[2]

    def _unstable(self, matrix: Array) -> NDArray[np.bool_]:
        """Sets with γ or λ above 1 at the flows of the record, (sets,)."""
        steep = {"m_max": self.m_w_max, "valve_a": 1.0, "valve_b": 100.0, "valve_c": -5.0, "rangeability": np.nan}
        matrix = matrix.copy()
        for name, value in steep.items():  # a valve that at full opening delivers just that
            matrix[PARAMETER_ROWS.index(name)] = value
        m_a = np.linspace(self.series[:, 0].min(), self.series[:, 0].max(), _AIR_FLOWS)
        gamma, lam = worst_numbers(matrix, m_a, self._wet_slope())
        return np.asarray(~((gamma <= 1.0) & (lam <= 1.0)))

    def _wet_slope(self) -> float:
        pressure = float(self.loop["pressure"])  # type: ignore[arg-type]
        dew_point = float(moist_air.dew_point(self.series[:, 2].max(), pressure))
        coldest = min(self.series[:, 1].min(), self.series[:, 3].min(), float(self.loop["T_initial"]))  # type: ignore[arg-type]
        return 0.0 if coldest >= dew_point else float(moist_air.saturation_enthalpy_slope(dew_point, pressure))


def residual_rows(found: Array, measured: Array, used: NDArray[np.bool_]) -> Array:
    """Modelled less measured, (n, sets): 0 where not compared, ``FORBIDDEN`` where the model could not be run."""
    r = np.where(used[:, None], found - np.where(used, measured, 0.0)[:, None], 0.0)
    return np.where(np.isfinite(r), r, FORBIDDEN)


def record_of(data: Log, loop: Loop, holds: tuple[str, ...]) -> Record:
    """The log in 1-s steps: straight lines between samples, or held where ``holds`` names the series."""
    if data.batch[-1] > 0:
        k = int(np.argmax(data.batch > 0))
        raise InputError(
            f"{data.name}: the record is broken between rows {data.rows[k - 1]} and {data.rows[k]} "
            f"({'; '.join(data.notes)}): a coil needs one unbroken record, cut the log there, or bridge it: "
            f"max_gap={data.time[k] - data.time[k - 1]:g}, --max-gap"
        )
    if data.step < 0.999:
        raise InputError(f"{data.name}: rows are {data.step:g} s apart: thin or average the log to 1 s or more")
    values: Mapping[str, Array] = dict(data.values)
    pressure = float(loop["pressure"])  # type: ignore[arg-type]
    if "RH_a_in" in values:
        values = {**values, "W_a_in": moist_air.humidity_ratio(values["T_a_in"], values["RH_a_in"], pressure)}
    elif "T_dp_in" in values:
        values = {**values, "W_a_in": moist_air.humidity_ratio_from_dew_point(values["T_dp_in"], pressure)}
    n_steps = int(data.time[-1] + 0.5) + 1
    if n_steps > _LONGEST:
        raise InputError(f"{data.name}: the log lasts {n_steps / 86400:.0f} days: cut it to 40 at most")
    seconds = np.arange(n_steps, dtype=float)
    latest = np.searchsorted(data.time, seconds + 1e-6, side="right") - 1
    series = np.stack(
        [
            values[name][latest] if name in holds else np.interp(seconds, data.time, values[name])
            for name in COIL_SERIES
        ],
        axis=1,
    )
    at = np.floor(data.time + 0.5).astype(np.int64)
    problems = [
        f"{data.name}: {name} is 0 throughout: give a log in which it flows"
        for name in ("m_a", "m_w")
        if not values[name].any()
    ]
    if problems:
        raise InputError(problems)
    return Record(series, at, loop, _typical(values["m_w"]), _typical(values["m_a"]))


def _typical(flow: Array) -> float:
    """Geometric mean of a flow where it flows, kg/s."""
    return float(np.exp(np.mean(np.log(flow[flow > 0.01 * flow.max()]))))

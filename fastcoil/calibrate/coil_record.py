"""A log of a coil as 1-s series, and the residuals of many parameter sets on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fastcoil.boundary import moist_air
from fastcoil.boundary.series import Array
from fastcoil.calibrate.columns import counted
from fastcoil.calibrate.data import Log
from fastcoil.calibrate.least_squares import FORBIDDEN
from fastcoil.engine.coil_loop import COIL_COLUMNS, run_coil
from fastcoil.engine.lanes import parameter_matrix
from fastcoil.engine.rows import PARAMETER_ROWS
from fastcoil.engine.step_numbers import worst_numbers
from fastcoil.errors import InputError
from fastcoil.simulation.loop import Loop
from fastcoil.simulation.scenarios import columns_of

COIL = ("C_w", "C_c", "beta1", "beta2", "beta3", "beta4", "beta5", "beta6")
LOGS = np.array([True, True, True, False, True, False, True, False])
"""Which of ``COIL`` are searched by their logarithm."""
LN_C_W, LN_C_C, LN_NTU_W, BETA2, LN_NTU_A, BETA4, LN_NTU_STAR, BETA6 = range(8)
"""What is searched: as ``COIL``, but numbers of transfer units at the typical flow in place of their factors."""
_ROWS = np.array([PARAMETER_ROWS.index(name) for name in COIL])
_AIR_FLOWS = 9
_LONGEST = 60 * 86400
_STILL, _MOSTLY = 0.05, 0.95
"""Air stands still below this share of what is not exceeded most of the time."""


@dataclass(frozen=True)
class Record:
    """What enters the coil second by second, and when something is measured.

    pieces: of each unbroken piece series (n_steps, 5) as ``COIL_COLUMNS``, and at (n,), second of each sample; every
    piece starts from ``T_initial``.  m_w, m_a: typical flows, kg/s.  m_w_max, m_a_span, wet_slope: of the whole log,
    for the limits of stability: largest water flow, least and largest air flow, kg/s, and largest dh_s/dT, kJ/(kg K).
    """

    pieces: tuple[tuple[Array, NDArray[np.int64]], ...]
    loop: Loop
    m_w: float
    m_a: float
    m_w_max: float
    m_a_span: tuple[float, float]
    wet_slope: float

    def until(self, n_samples: int) -> Record:
        """The record up to its first samples."""
        kept = []
        for series, at in self.pieces:
            if n_samples > 0:
                here = at[:n_samples]
                kept.append((series[: int(here[-1]) + 1], here))
            n_samples -= at.size
        return replace(self, pieces=tuple(kept))

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
        base = parameter_matrix(columns_of(self.loop, {}, np.array([0])))
        matrix = np.repeat(base, sets.shape[1], axis=1)
        matrix[_ROWS] = self.values(sets)
        of_pieces = [run_coil(matrix, series, at) for series, at in self.pieces]
        found = [np.concatenate(parts) for parts in zip(*of_pieces, strict=True)]
        unstable = self._unstable(matrix)
        for whole in found:
            whole[:, unstable] = np.nan
        return found[0], found[1], found[2]

    def _unstable(self, matrix: Array) -> NDArray[np.bool_]:
        """Sets with γ or λ above 1 at the flows of the record, (sets,)."""
        steep = {"m_max": self.m_w_max, "valve_a": 1.0, "valve_b": 100.0, "valve_c": -5.0, "rangeability": np.nan}
        matrix = matrix.copy()
        for name, value in steep.items():  # a valve that at full opening delivers just that
            matrix[PARAMETER_ROWS.index(name)] = value
        gamma, lam = worst_numbers(matrix, np.linspace(*self.m_a_span, _AIR_FLOWS), self.wet_slope)
        return np.asarray(~((gamma <= 1.0) & (lam <= 1.0)))


def residual_rows(found: Array, measured: Array, used: NDArray[np.bool_]) -> Array:
    """Modelled less measured, (n, sets): 0 where not compared, ``FORBIDDEN`` where the model could not be run."""
    r = np.where(used[:, None], found - np.where(used, measured, 0.0)[:, None], 0.0)
    return np.where(np.isfinite(r), r, FORBIDDEN)


def in_operation(data: Log) -> Log:
    """The log without the times at which no air flows or ``enabled`` is 0: then the sensors say nothing of the coil.

    After each the record begins anew, as it does after a gap.
    """
    m_a, enabled = data.values["m_a"], data.values.pop("enabled", np.ones(data.time.size))
    on = (m_a > _STILL * np.quantile(m_a, _MOSTLY)) & (enabled != 0.0)
    if not on.any():
        raise InputError(f"{data.name}: m_a is 0 throughout: give a log in which it flows")
    if on.all():
        return data
    spells = int(on[0] == 0) + int(np.sum(np.diff(on.astype(int)) < 0))
    data.notes.append(
        f"{counted(~on, 'sample')} in {counted(spells, 'spell')} left out, no air flows (first in row "
        f"{data.rows[int(np.argmin(on))]}): begun anew after each"
    )
    return data.where(on)


def record_of(data: Log, loop: Loop, holds: tuple[str, ...]) -> Record:
    """The log in 1-s steps: straight lines between samples, or held where ``holds`` names the series."""
    if data.step < 0.999:
        raise InputError(f"{data.name}: rows are {data.step:g} s apart: thin or average the log to 1 s or more")
    values: Mapping[str, Array] = dict(data.values)
    pressure = float(loop["pressure"])  # type: ignore[arg-type]
    if "RH_a_in" in values:
        values = {**values, "W_a_in": moist_air.humidity_ratio(values["T_a_in"], values["RH_a_in"], pressure)}
    elif "T_dp_in" in values:
        values = {**values, "W_a_in": moist_air.humidity_ratio_from_dew_point(values["T_dp_in"], pressure)}
    if not values["m_w"].any():
        raise InputError(f"{data.name}: m_w is 0 throughout: give a log in which it flows")
    unbroken = np.split(np.arange(data.time.size), np.flatnonzero(np.diff(data.batch)) + 1)
    seconds_in_all = sum(data.time[samples[-1]] - data.time[samples[0]] for samples in unbroken)
    if seconds_in_all > _LONGEST:
        days = f"{seconds_in_all / 86400:.0f} days: cut it to {_LONGEST // 86400} at most"
        raise InputError(f"{data.name}: the log lasts {days}, a fit of more takes many minutes")
    pieces = []
    for samples in unbroken:
        time = data.time[samples] - data.time[samples[0]]
        seconds = np.arange(int(time[-1] + 0.5) + 1, dtype=float)
        latest = np.searchsorted(time, seconds + 1e-6, side="right") - 1
        columns = [
            values[name][samples][latest] if name in holds else np.interp(seconds, time, values[name][samples])
            for name in COIL_COLUMNS
        ]
        pieces.append((np.stack(columns, axis=1), np.floor(time + 0.5).astype(np.int64)))
    dew_point = float(moist_air.dew_point(values["W_a_in"].max(), pressure))
    coldest = min(values["T_a_in"].min(), values["T_w_in"].min(), float(loop["T_initial"]))  # type: ignore[arg-type]
    slope = 0.0 if coldest >= dew_point else float(moist_air.saturation_enthalpy_slope(dew_point, pressure))
    m_a, m_w = values["m_a"], values["m_w"]
    span = (float(m_a.min()), float(m_a.max()))
    return Record(tuple(pieces), loop, _typical(m_w), _typical(m_a), float(m_w.max()), span, slope)


def _typical(flow: Array) -> float:
    """Geometric mean of a flow where it flows, kg/s."""
    return float(np.exp(np.mean(np.log(flow[flow > 0.01 * flow.max()]))))

"""How well each candidate backlash explains the supply temperature of a log: a linear model, solved for all at once.

The model is an ARIX: the change of the temperature over half a minute from its own changes before, those of known
disturbances, and those of the opening and of its square, each a mean over half a minute that ends before the sample.
It is linear in all but the backlash, so that each candidate takes one small set of normal equations (separable least
squares, as in Jelali 2008).  The coefficients of the opening have a wide normal prior and are integrated out.

A loop in closed loop has a trap.  The command between two samples answers temperatures that the model has not seen, so
that the bare command foretells the temperature, and a candidate of 0 is its opening.  ``reaction`` gives the command
itself coefficients of its own; then only what the play operator changes counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.measured.diagnosis.motion import mean_openings

HORIZON = 30.0
"""Seconds over which the model foretells: long against the noise of a sensor, short against a coil.  An interval, where
the log has longer ones."""
OWN_LAGS, OPENING_LAGS, DISTURBANCE_LAGS = 8, 4, 3
"""Changes of the temperature, the opening and each known disturbance that enter, one a horizon."""
PRECISION = 0.01
"""Of the prior of the opening's coefficients, 1/K²: each is known to ± 10 K per stroke before the log is read."""
MODEL_ERROR = 0.1
"""Share of what the stem explains that counts as if it were noise: coil and valve curve are not linear, and where the
temperature swings far, as in a loop that hunts, that is what the residuals are made of."""
LEAST_ROWS = 60


class Likelihood(NamedTuple):
    """Log-likelihood of each candidate, without and with coefficients for the command itself; rows that it rests on."""

    plain: Array
    reaction: Array
    rows: int


def likelihoods(
    temperature: Array, positions: Array, disturbances: Sequence[Array], good: Mask, interval: float, candidates: Array
) -> Likelihood | None:
    """Compare candidate sizes of the backlash; None if the log is too short.

    Parameters
    ----------
    temperature
        (n,), °C.
    positions
        (n + 1,), of the motor, see ``motor_positions``.
    disturbances
        Each (n,): what else moves the temperature and is in the log.
    good
        (n,): samples that may be used.  A row of the model uses all its lags or is left out.
    interval
        Seconds from sample to sample.
    candidates
        Fractions of stroke, from 0.
    """
    n, width = temperature.size, max(1, round(HORIZON / interval))
    span = (max(OWN_LAGS, OPENING_LAGS) + 1) * width + 1
    rows = np.arange(-(-span // width) * width, n, width)
    bad_before = np.concatenate([[0], np.cumsum(~good)])
    rows = rows[bad_before[rows + 1] == bad_before[rows - span + 1]]
    if rows.size < LEAST_ROWS:
        return None

    def change(series: Array, lag: int) -> Array:
        return np.asarray(series[rows - lag * width] - series[rows - (lag + 1) * width])

    y = change(temperature, 0)
    common = [change(temperature, lag) for lag in range(1, OWN_LAGS + 1)]
    common += [change(series, lag) for series in disturbances for lag in range(DISTURBANCE_LAGS)]
    Z, _ = np.linalg.qr(np.stack([*common, np.ones(rows.size)], axis=1))
    y = y - Z @ (Z.T @ y)
    total, freedom = float(y @ y), rows.size - Z.shape[1]
    if total <= 0.0:
        return None
    # positions after the last sample have no temperature
    gram, product = _normal_equations(positions[:n], candidates, width, rows, Z, y)
    k = 2 * OPENING_LAGS
    plain = _evidence(gram[:, :k, :k], product[:, :k], total, freedom)
    return Likelihood(plain, _evidence(gram, product, total, freedom), rows.size)


def _normal_equations(
    positions: Array, candidates: Array, width: int, rows: Index, Z: Array, y: Array
) -> tuple[Array, Array]:
    """Left and right sides for each candidate, for what is orthogonal to Z: its opening, the square, then the motor."""
    # the piece that ends at sample r is r / width - 1
    ends, k = rows // width - 2, 2 * OPENING_LAGS
    X = np.empty((candidates.size, k, rows.size))
    for first, means in enumerate(mean_openings(positions, candidates, width)):
        moved = np.ascontiguousarray(np.diff(means, axis=0).T)
        for lag in range(OPENING_LAGS):
            X[:, first * OPENING_LAGS + lag] = moved[:, ends - lag]
    motor = np.diff(mean_openings(positions, np.zeros(1), width)[0][:, 0])
    M = np.stack([motor[ends - lag] for lag in range(OPENING_LAGS)])
    M -= (M @ Z) @ Z.T
    in_common = (X.reshape(-1, rows.size) @ Z).reshape(candidates.size, k, -1)
    gram = np.empty((candidates.size, k + len(M), k + len(M)))
    gram[:, :k, :k] = X @ X.transpose(0, 2, 1) - in_common @ in_common.transpose(0, 2, 1)
    gram[:, :k, k:] = X @ M.T
    gram[:, k:, :k] = gram[:, :k, k:].transpose(0, 2, 1)
    gram[:, k:, k:] = M @ M.T
    return gram, np.concatenate([X @ y, np.broadcast_to(M @ y, (candidates.size, len(M)))], axis=1)


def _evidence(gram: Array, product: Array, total: float, freedom: int) -> Array:
    """Log-likelihood with the coefficients integrated out, for each candidate."""
    unit = np.eye(gram.shape[1])
    precision = PRECISION * total / freedom
    solved = np.linalg.solve(gram + precision * unit, product[..., np.newaxis])[..., 0]
    left = np.maximum(total - np.sum(product * solved, axis=1), 1e-12 * total)
    left += MODEL_ERROR * (total - left.min())
    return np.asarray(-0.5 * freedom * np.log(left / total) - 0.5 * np.linalg.slogdet(unit + gram / precision)[1])

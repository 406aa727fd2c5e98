"""A curve of straight lines from opening to flow, which needs no shape of Eq (2)."""

from __future__ import annotations

import numpy as np

from fastcoil.base.arrays import Array

N_KNOTS = 11
_RIDGE = 1e-9
_TINY = 1e-300


def hats(opening: Array) -> Array:
    """Weights of the knots, evenly spaced from 0 to 1, at each opening: (…,) → (…, knots)."""
    place = np.clip(opening, 0.0, 1.0) * (N_KNOTS - 1)
    return np.asarray(np.maximum(1.0 - np.abs(place[..., None] - np.arange(N_KNOTS)), 0.0))


def solved(products: Array) -> Array:
    """Flows at the knots, (…, k - 1), from sums of products of the weights and, last, the flow, (…, k, k)."""
    A, b = products[..., :-1, :-1], products[..., :-1, -1]
    ridge = _RIDGE * np.trace(A, axis1=-2, axis2=-1) + _TINY
    return np.asarray(np.linalg.solve(A + ridge[..., None, None] * np.eye(A.shape[-1]), b[..., None])[..., 0])


def errors_of(products: Array, flows: Array) -> Array:
    """Sums of squared residuals, (…,), of a curve, (…, k - 1) or (k - 1,)."""
    v = np.concatenate([flows, np.full((*flows.shape[:-1], 1), -1.0)], axis=-1)
    return np.asarray(np.maximum(np.einsum("...ij,...i,...j", products, v, v), 0.0))

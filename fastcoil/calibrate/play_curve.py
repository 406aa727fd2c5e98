"""A curve of straight lines from opening to flow, which needs no shape of Eq (2)."""

from __future__ import annotations

import numpy as np

from fastcoil.arrays import Array

N_KNOTS = 11


def hats(opening: Array) -> Array:
    """Weights of the knots, evenly spaced from 0 to 1, at each opening: (…,) → (…, knots)."""
    place = np.clip(opening, 0.0, 1.0) * (N_KNOTS - 1)
    return np.asarray(np.maximum(1.0 - np.abs(place[..., None] - np.arange(N_KNOTS)), 0.0))

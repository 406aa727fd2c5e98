"""Paths of a motor and of the stem behind its backlash."""

from itertools import accumulate

import numpy as np

from fastcoil.model.physics import backlash


def stem_positions(positions, x_bl):
    """Stem positions of a motor that starts, like the stem, at 0."""
    return np.array(list(accumulate(positions, lambda q, position: backlash(q, position, x_bl), initial=0.0))[1:])

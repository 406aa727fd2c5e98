"""How messages and notes say how many samples they mean and where the first one is."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from fastcoil.base.arrays import Mask


def counted(what: Mask | int, noun: str) -> str:
    """``1 row``, ``2 rows``; of a mask, how many it marks."""
    n = int(np.sum(what))
    return f"{n:,} {noun}{'' if n == 1 else 's'}"


def first_row(row_numbers: Sequence[int], where: Mask) -> str:
    """``first in row 7``: the row number of the first sample that ``where`` marks."""
    return f"first in row {row_numbers[int(np.argmax(where))]}"


def warn_of_reading(name: str, told: Sequence[str]) -> None:
    """Warn, where a result has no place for notes, of what is not self-evident about how a log was read."""
    if told:
        warnings.warn(f"{name}: {'; '.join(told)}", UserWarning, stacklevel=3)

"""Which part of a log is fitted, and which is held back to validate the fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastcoil.calibrate.data import Log
from fastcoil.errors import InputError

_BATCHES_TO_SPLIT_BY = 4


def fitted_part(data: Log, split: float, fit_until: float | None) -> NDArray[np.bool_]:
    """Where the samples are fitted, (n,): the first ``split`` of the log, or what is up to ``fit_until`` s.

    Batches stay whole where there are at least four.
    """
    if fit_until is not None:
        if not data.time[0] < fit_until:
            raise InputError(f"fit_until = {fit_until!r}: give seconds after the first row, which is 0")
        return np.asarray(np.maximum.accumulate(data.time) <= fit_until)
    if not isinstance(split, (int, float)) or not 0.0 < split <= 1.0:
        raise InputError(f"split = {split!r}: give the share to fit, above 0 and at most 1")
    n_batches = int(data.batch[-1]) + 1
    if n_batches >= _BATCHES_TO_SPLIT_BY:
        return np.asarray(data.batch < max(round(split * n_batches), 1))
    return np.arange(data.time.size) < max(round(split * data.time.size), 1)

"""Which part of a log is fitted, and which is held back to validate the fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastcoil.arguments import is_number
from fastcoil.calibrate.data import Log
from fastcoil.errors import InputError

SPLIT = 0.7
"""Share of a log that is fitted if nothing else is said."""
_BATCHES_TO_SPLIT_BY = 4


def fitted_part(data: Log, split: float | None, fit_until: float | None) -> NDArray[np.bool_]:
    """Where the samples are fitted, (n,): the first ``split`` of the log, or what is up to ``fit_until`` s.

    Of at least four batches as many are fitted, whole, as hold that share of the samples; but not the last.  Where
    there is a second log to validate with, all of the first is fitted.
    """
    given = [name for name, value in (("split", split), ("fit_until", fit_until)) if value is not None]
    given += ["validation"] * (len(data.names) - 1)
    if len(given) > 1:
        raise InputError(f"{' and '.join(given)} both say what is held back: give one of them")
    if len(data.names) > 1:
        return np.asarray(data.log == 0)
    if fit_until is not None:
        if not (is_number(fit_until) and data.time[0] < fit_until):
            raise InputError(f"fit_until = {fit_until!r}: give seconds after the first row, which is 0")
        return np.asarray(np.maximum.accumulate(data.time) <= fit_until)
    share = SPLIT if split is None else split
    if not (is_number(share) and 0.0 < share <= 1.0):
        raise InputError(f"split = {split!r}: give the share to fit, above 0 and at most 1")
    if data.n_batches >= _BATCHES_TO_SPLIT_BY and share < 1.0:
        ends = np.cumsum(np.bincount(data.batch)) / data.batch.size
        last = min(int(np.argmax(ends >= share - 1e-9)), data.n_batches - 2)
        return np.asarray(data.batch <= last)
    return np.arange(data.time.size) < max(round(share * data.time.size), 1)

"""Which part of a log is fitted, and which is held back to validate the fit."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import Checks, number_of
from fastcoil.base.arrays import Mask
from fastcoil.logs import Log
from fastcoil.logs.columns import log_of
from fastcoil.logs.series import counted

FITTING, VALIDATION, UNUSED = "fit", "validation", "unused"
"""Names of the parts."""
SPLIT = 0.7
"""Share of a log that is fitted by default."""
_BATCHES_TO_SPLIT_BY = 4
_ABOVE_0 = math.nextafter(0.0, 1.0)


class Part(NamedTuple):
    """The part of a log to fit: a ``split`` (share) of it, or up to ``fit_until`` s; ``validation``: another log."""

    split: float | None = None
    fit_until: float | None = None
    validation: Any = None

    def of(self, data: Log) -> Log:
        """The log, cut after ``fit_until`` where another log validates the fit."""
        if self.validation is None or self.fit_until is None:
            return data
        kept = np.asarray(np.maximum.accumulate(data.time) <= self.fit_until)
        data = data.where(kept)
        if not kept.all():
            data.notes.append(f"{counted(~kept, 'row')} after fit_until left out: the other log validates the fit")
        return data

    def fitted(self, data: Log) -> Mask:
        """Which samples are fitted, (n,).

        A log of at least four batches is split between batches, and the last is never fitted.  With a second log to
        validate with, all of the first is fitted.
        """
        if len(data.names) > 1:
            return np.asarray(data.source == 0)
        if self.fit_until is not None:
            return np.asarray(np.maximum.accumulate(data.time) <= self.fit_until)
        share = SPLIT if self.split is None else self.split
        if data.n_batches >= _BATCHES_TO_SPLIT_BY and share < 1.0:
            ends = np.cumsum(np.bincount(data.batch)) / data.batch.size
            last = min(int(np.argmax(ends >= share - 1e-9)), data.n_batches - 2)
            return np.asarray(data.batch <= last)
        return np.arange(data.time.size) < max(round(share * data.time.size), 1)


def checked_part(check: Checks, split: Any, fit_until: Any, validation: Any) -> Part:
    """The part of a log to fit, from the arguments of a fit."""
    share = "give the share to fit, above 0 and at most 1"
    last = "give seconds after the first row, which is 0"
    part = Part(
        check.unless_none(number_of, "split", split, share, least=_ABOVE_0, most=1.0),
        check.unless_none(number_of, "fit_until", fit_until, last, least=_ABOVE_0, most=math.inf),
        check.unless_none(log_of, "validation", validation),
    )
    other = "fit_until" if part.validation is None else "validation"
    if part.split is not None and getattr(part, other) is not None:
        check.problems.append(f"split and {other} both say what is held back: give one of them")
    return part

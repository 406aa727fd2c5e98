"""The checks of the arguments that both fits take: logs, how they are read, which part is fitted.

Which part of a log is fitted, and which is held back to validate the fit; the names of the parts.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fastcoil.base.arguments import Checks, choice_of, flag_of, number_of
from fastcoil.base.arrays import Mask
from fastcoil.base.errors import InputError
from fastcoil.logs import Log
from fastcoil.logs.columns import max_gap_of, require_mappings
from fastcoil.logs.series import counted

_ABOVE_0 = math.nextafter(0.0, 1.0)


def check_reading(check: Checks, *, drop: Any, jumps: Any, max_gap: Any, **mappings: Any) -> None:
    """Check how logs are to be read; ``mappings``: columns, units, constants."""
    check(flag_of, "drop", drop)
    check(choice_of, "jumps", jumps, ("refuse", "split"))
    check(max_gap_of, max_gap)
    check(require_mappings, **mappings)


def split_of(check: Checks, split: Any, fit_until: Any) -> tuple[float | None, float | None]:
    """Which part of a log is to be fitted: a share of it, or up to a second; None where one is not given."""
    share = "give the share to fit, above 0 and at most 1"
    last = "give seconds after the first row, which is 0"
    return (
        check.unless_none(number_of, "split", split, share, least=_ABOVE_0, most=1.0),
        check.unless_none(number_of, "fit_until", fit_until, last, least=_ABOVE_0, most=math.inf),
    )


FITTING, VALIDATION, UNUSED = "fit", "validation", "unused"
SPLIT = 0.7
"""Share of a log that is fitted by default."""
_BATCHES_TO_SPLIT_BY = 4


def fitted_part(data: Log, split: float | None, fit_until: float | None) -> Mask:
    """Which samples are fitted, (n,): the first ``split`` of the log, or those up to ``fit_until`` s.

    A log of at least four batches is split between batches, and the last is never fitted.  With a second log to
    validate with, all of the first is fitted.
    """
    given = [name for name, value in (("split", split), ("fit_until", fit_until)) if value is not None]
    given += ["validation"] * (len(data.names) - 1)
    if len(given) > 1:
        raise InputError(f"{' and '.join(given)} both say what is held back: give one of them")
    if len(data.names) > 1:
        return np.asarray(data.source == 0)
    if fit_until is not None:
        return np.asarray(np.maximum.accumulate(data.time) <= fit_until)
    share = SPLIT if split is None else split
    if data.n_batches >= _BATCHES_TO_SPLIT_BY and share < 1.0:
        ends = np.cumsum(np.bincount(data.batch)) / data.batch.size
        last = min(int(np.argmax(ends >= share - 1e-9)), data.n_batches - 2)
        return np.asarray(data.batch <= last)
    return np.arange(data.time.size) < max(round(share * data.time.size), 1)


def validated_with(data: Log, other: Log, fit_until: float | None) -> Log:
    """Both logs: the first, up to ``fit_until`` s, to be fitted, and ``other`` to validate the fit."""
    if fit_until is not None:
        kept = np.asarray(np.maximum.accumulate(data.time) <= fit_until)
        data = data.where(kept)
        if not kept.all():
            data.notes.append(f"{counted(~kept, 'row')} after fit_until left out: the other log validates the fit")
    return data.followed_by(other)

"""The checks of the arguments that both fits take: logs, how they are read, which part is fitted."""

from __future__ import annotations

import math
from typing import Any

from fastcoil.base.arguments import Checks, choice_of, flag_of, number_of
from fastcoil.logs.arguments import max_gap_of, require_mappings

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

"""The checks of the arguments that both fits take: logs, how they are read, which part is fitted."""

from __future__ import annotations

import math
from typing import Any

from fastcoil.arguments import Checks, choice_of, flag_of, number_of
from fastcoil.logs.arguments import require_mappings, require_max_gap

_ABOVE_0 = math.nextafter(0.0, 1.0)


def check_reading(check: Checks, *, drop: Any, jumps: Any, max_gap: Any, **mappings: Any) -> None:
    """Check how logs are to be read; ``mappings``: columns, units, constants."""
    check(flag_of, "drop", drop)
    check(choice_of, "jumps", jumps, ("refuse", "split"))
    check(require_max_gap, max_gap)
    check(require_mappings, **mappings)


def check_split(check: Checks, split: Any, fit_until: Any) -> None:
    """Check which part of a log is to be fitted."""
    check.unless_none(
        number_of, "split", split, "give the share to fit, above 0 and at most 1", least=_ABOVE_0, most=1.0
    )
    check.unless_none(
        number_of,
        "fit_until",
        fit_until,
        "give seconds after the first row, which is 0",
        least=_ABOVE_0,
        most=math.inf,
    )

"""Samples of a log on 1-s steps: held, or on straight lines between them."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError

_LEAST_STEP = 0.999
MOST_SECONDS = 50_000_000
"""Of a record on 1-s steps, 19 months: a few GB with its series."""


def require_whole_seconds(name: str, step: float) -> None:
    """Refuse a log whose samples are less than a second apart; ``step``: its median step, s."""
    if step < _LEAST_STEP:
        raise InputError(f"{name}: the rows are {step:g} s apart: thin or average the log to 1 s or more")


def require_span(name: str, seconds: float, cure: str = "cut the log") -> None:
    """Refuse a record that would fill the memory on 1-s steps; ``seconds``: from its first to its last."""
    if seconds > MOST_SECONDS:
        raise InputError(
            f"{name} lasts {seconds:,.0f} s from the first row to the last: at most {MOST_SECONDS:,} s can be read, "
            f"check the unit of the time, or {cure}"
        )


def at_seconds(
    time: Array, values: Mapping[str, Array], seconds: Array, hold: Collection[str], slack: float = 0.0
) -> dict[str, Array]:
    """Each series at the ``seconds`` asked for, (n_seconds,), within the log.

    Parameters
    ----------
    time, values
        Time of the samples [s], ascending, and their values by name, each (n,).
    seconds
        Where to take them [s].
    hold
        Names of the series that hold until the next sample; the others run straight.
    slack
        A sample up to this much late still counts for its second [s]: for times with round-off.
    """
    latest = np.searchsorted(time, seconds + slack, side="right") - 1
    return {
        name: series[latest] if name in hold else np.interp(seconds, time, series) for name, series in values.items()
    }

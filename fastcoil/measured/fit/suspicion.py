"""What a fit of a valve shows of a signal that was read the wrong way: inverted, or 2-10 V taken for 0-10 V."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array

_INVERTED = -0.5
"""With a correlation of command and flow below this the command is probably inverted."""
_LIVE_ZERO = (0.185, 0.215)
"""Where the least command of a 2-10 V signal lies if it is read as 0-10 V."""
_FAR = 0.5
"""A signal that is never above this says nothing of its range."""
_LOWEST, _CLOSED = 0.02, 0.1
"""At commands this close to the least, a closed valve passes no more than this share of the largest flow."""
_FEWEST = 3


class Suspicions(NamedTuple):
    """Sentences for the user, each with its cure; whether the command is inverted, the first of them then."""

    notes: list[str]
    inverted: bool


def suspicions(command: Array, flow: Array) -> Suspicions:
    """What the samples that are fitted show, (n,) each: fractions of stroke, kg/s."""
    with np.errstate(invalid="ignore", divide="ignore"):  # a command that is constant here
        correlation = float(np.corrcoef(command, flow)[0, 1])
    if correlation < _INVERTED:
        return Suspicions(
            ["the flow falls as the command rises: if a full command closes the valve, log 1 - command"], True
        )
    least = float(command.min())
    lowest = flow[command <= least + _LOWEST]
    closed = lowest.size >= _FEWEST and float(np.median(lowest)) <= _CLOSED * float(flow.max())
    if _LIVE_ZERO[0] <= least <= _LIVE_ZERO[1] and command.max() > _FAR and closed:
        return Suspicions(
            [
                f"the valve is closed at a command of {least:.2g} and the command never falls below: it looks like a "
                "signal of 2-10 V that was read as 0-10 V, which makes the backlash a fifth too small; declare its "
                "unit, units={'command': 'V 2-10'}, --unit command='V 2-10', or log (command - 0.2) / 0.8"
            ],
            False,
        )
    return Suspicions([], False)

"""Set-points that move: a line between two outdoor temperatures, and trim and respond.

ASHRAE Guideline 36-2021: section 5.1.14 (trim and respond), section 5.16.2.2 with its table (supply air temperature of
an air handler with several zones).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.loops.boundary.operation.zones import Limits


class Trim(NamedTuple):
    """Numbers of trim and respond: steps [K], requests that do not count, delay after the start and time step [s]."""

    trim: float
    respond: float
    respond_max: float
    ignored_requests: int
    trim_delay: int
    trim_interval: int


def between(T_out: Array, T_out_min: float, T_out_max: float, at_min: Array | float, at_max: float) -> Array:
    """``at_min`` up to the one outdoor temperature, ``at_max`` from the other on, a straight line between them."""
    share = np.clip((T_out - T_out_min) / (T_out_max - T_out_min), 0.0, 1.0)
    return np.asarray(at_min + share * (at_max - at_min))


def trim_and_respond(trim: Trim, low: float, high: float, share: Array, limits: Limits) -> Array:
    """Upper end of the line at each time step, (n_times,): ``high`` at first, then trimmed and lowered by requests.

    Parameters
    ----------
    trim
        The numbers.  From the step on that is ``trim_delay`` after the start, the value rises by ``trim`` and, with R
        requests, falls by ``respond`` for each beyond ``ignored_requests``, at most by ``respond_max``.
    low, high
        Bounds [degC].
    share
        How far the outdoor temperature is along the line, (n_times,): the zones get air of ``value + share (low -
        value)``.
    limits
        At which set-points the zones ask, at each step.
    """
    value, values = high, np.empty(share.size)
    each = np.stack(limits, axis=1)
    asks = np.zeros(each.shape[2], dtype=bool)
    first = -(-trim.trim_delay // trim.trim_interval)
    for k, along in enumerate(share.tolist()):
        above = value + along * (low - value) > each[k]
        asks = above[0] | (asks & above[1])
        if k >= first:
            over = max(int(np.count_nonzero(asks) + np.count_nonzero(above[2:])) - trim.ignored_requests, 0)
            value = min(max(value + trim.trim - min(trim.respond * over, trim.respond_max), low), high)
        values[k] = value
    return values

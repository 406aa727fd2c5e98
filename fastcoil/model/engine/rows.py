"""The state of a block of lanes: which row holds what.

A block is LANES scenarios side by side.  Its state is one flat array of rows of LANES doubles, so that row
offsets are compile-time constants and the compiler needs no alias checks between rows.

Behind the parameters come three groups of rows.  *Derived* rows follow from the parameters and stay as they are.
*State* rows are what a later day would have to carry over.  *Sums* are what the metrics accumulate; they start again
with every run.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterable
from typing import Any

from fastcoil.model.parameter_table import PARAMETERS

LANES = 64

PARAMETER_ROWS = (*PARAMETERS, "replicate")
DERIVED_ROWS = (
    "dt_C_w", "dt_C_c", "ntu_w_factor", "ntu_a_factor", "ntu_star_factor", "log_m_max", "m_0", "m_1", "max_travel",
    "sensor_decay", "ki", "sign", "largest_buffer", "steepness",
)  # fmt: skip
"""What the parameters amount to per step."""
STATE_ROWS = (
    # sensor
    "y_s", "noise", "noise_next", "measured",
    # what a law that is not the PI decided; PI, inverse
    "decided", "u", "integral", "mode", "u_ext", "command",
    # what the estimator sees of the last sample; the estimate, and what the inverse assumes of it
    "T_seen", "e_seen", "switches", "estimate", "assumed",
    # noise measured on line: readings so far, the last two errors, median size of second differences
    "readings", "e_1", "e_2", "difference",
    # actuator, valve
    "position", "motor_runs", "q", "stem_direction", "opening", "growth", "log_m_w", "m_w",
    # backlash as worn so far, what the boundary multiplies it by, the gap that this makes; direction of the last move
    "worn", "backlash_scale", "gap", "last_turn",
    # coil: flow, conductance and effectiveness of this step
    "C_flow", "ntu_w", "G_w", "eps_a", "eps_star", "wet_volumes", "power",
    # since the start of the first day: how far the metal was out of range, and when the estimate was right
    "farthest_T_c", "time_reached", "time_confirmed", "time_identified",
)  # fmt: skip
"""What the next step, or a later day, starts from.

The temperatures of the coil are in VOLUME_ROWS, what an estimator remembers is in rows of its own.
"""
SUM_ROWS = (
    "sum_e2", "sum_e2_settled", "sum_abs_e", "off", "reheat", "recool",
    "T_set_from", "e_previous", "crossings", "highest", "lowest", "sum_swing",
    "e_sampled", "up_at", "periods", "last_period", "alike",
    "sum_switches", "stem_travel", "motor_travel", "reversals", "sum_estimate",
    "sum_power", "sum_power_block", "peak_power", "sum_m_w", "condensate",
    "coldest_wet", "coldest_water", "frost_time", "freeze_time",
)  # fmt: skip
"""What the metrics are made of."""
VOLUME_ROWS = ("T_w", "T_c", "T_a", "W_a", "Q_w", "W_s")
"""Rows of each control volume: the states, heat from the metal into the water, and saturation at T_c.

Volume 0 carries the entering water in T_w, volume N + 1 the entering air in T_a and W_a.
"""


def positions(names: Iterable[str], stride: int = 1) -> Any:
    """Each name's place in an enumeration, times ``stride``; as a named tuple, whose fields the compiler folds."""
    places = namedtuple("Positions", names)  # type: ignore[misc]
    return places(*(stride * k for k in range(len(places._fields))))


R = positions(PARAMETER_ROWS + DERIVED_ROWS + STATE_ROWS + SUM_ROWS, LANES)
"""Offset of each row in the flat state S."""
STATE_AT, SUMS_AT = R[len(PARAMETER_ROWS + DERIVED_ROWS)], R[-len(SUM_ROWS)]
"""Where the state rows and the sums start in S."""
T_W, T_C, T_A, W_A, Q_W, W_S = positions(VOLUME_ROWS, LANES)
"""Offset of each row of volume 0 in the flat state V; volume i is i * VOLUME_STRIDE further."""
VOLUME_STRIDE = LANES * len(VOLUME_ROWS)

"""The state of a block of LANES scenarios: which row holds what, and what a run starts from.

It is one flat array of rows of LANES doubles, so that row offsets are compile-time constants: *parameter* rows,
*derived* rows that follow from them, *state* rows, which carry over to a later day, and *sums* for the metrics.
"""

from collections.abc import Iterable
from types import ModuleType
from typing import Any

import numpy as np

from fastcoil.model.control import FALLING, largest_buffer, noise_buffer, smooth_steepness
from fastcoil.model.numerics.elementary import exp, log
from fastcoil.model.numerics.jit import section
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.model.physics import flow_exponential, installed_valve, log_flow
from fastcoil.model.valve_test import CALM_AIR_TIME_S, Memory

LANES = 64

PARAMETER_ROWS = (*PARAMETERS, "replicate")
DERIVED_ROWS = (
    "dt_C_w", "dt_C_c", "ntu_w_factor", "ntu_a_factor", "ntu_star_factor", "log_m_max", "m_0", "m_1", "max_travel",
    "sensor_decay", "ki", "sign", "largest_buffer", "steepness",
)  # fmt: skip
"""Quantities per step that follow from the parameters."""
STATE_ROWS = (
    # sensor
    "y_s", "noise", "noise_next", "measured",
    # u of a law in place of the PI; PI, inverse
    "u_law", "u", "integral", "mode", "u_ext", "command",
    # reading and error of the last sample, for the estimator; its estimate, and the backlash that the inverse assumes
    "T_seen", "e_seen", "switches", "estimate", "assumed_backlash",
    # whether the valve test runs, and its memory
    "test", *(f"test_{name}" for name in Memory._fields),
    # measured noise: number of readings, the last two errors, median size of second differences
    "readings", "e_1", "e_2", "difference",
    # actuator, valve
    "position", "motor_runs", "q", "stem_direction", "opening", "growth", "log_m_w", "m_w",
    # backlash with wear, its factor from the boundary, the gap that results; direction of the last move
    "worn_backlash", "backlash_scale", "gap", "last_turn",
    # coil: flow, conductance and effectiveness of this step
    "C_flow", "ntu_w", "G_w", "eps_a", "eps_star", "half_C_c", "half_C_w", "T_w_mean", "wet_volumes", "power",
    "T_room",
    # since the start of the first day: largest distance of the metal from mid-range, and when the estimate was right
    "farthest_T_c", "time_reached", "time_confirmed", "time_identified",
)  # fmt: skip
"""State that the next step or a later day starts from, beside that of the coil (VOLUME_ROWS) and of an estimator."""
SUM_ROWS = (
    "sum_e2", "sum_e2_settled", "sum_abs_e", "seconds_off", "reheat", "recool",
    "T_set_from", "highest", "lowest", "sum_range",
    # swing: mean error, periods; disturbance, last extreme; then the signals of the regression, see ``hunting``
    "error_mean", "periods", "last_period", "same_periods", "sum_periods", "turned_up_at", "d_mean", "d", "extreme",
    "direction", "mean_weight", "unit", "g", "g_lagged", "g_lagged_twice", "h",
    "sum_switches", "stem_travel", "motor_travel", "reversals", "sum_estimate", "largest_estimate",
    "sum_power", "sum_power_block", "peak_power", "sum_m_w", "condensate",
    "coldest_wet", "coldest_water", "frost_time", "freeze_time", "coldest", "dampest",
)  # fmt: skip
"""Sums and extremes from which ``summarise`` computes the metrics."""
VOLUME_ROWS = ("T_w", "T_c", "T_a", "W_a", "Q", "W_s")
"""Rows of each control volume: the states, saturation at T_c, and a heat that one half of a march hands to the other:
into the water (lagged) or from the air (quasistatic).

Volume 0 carries the entering water in T_w, volume N + 1 the entering air in T_a and W_a.
"""


def name_offsets(names: Iterable[str], stride: int = 1) -> Any:
    """Return an object with an attribute for each name: its index, times ``stride``.

    It is a module, whose attributes are constants to the compiler: a named tuple took a fifth of a compilation.
    """
    offsets = ModuleType("offsets")
    vars(offsets).update({name: stride * k for k, name in enumerate(names)})
    return offsets


ROWS = PARAMETER_ROWS + DERIVED_ROWS + STATE_ROWS + SUM_ROWS
R = name_offsets(ROWS, LANES)
"""Offset of each row in the flat state S."""
P = name_offsets(PARAMETER_ROWS)
"""Index of each parameter in the rows of a block or a matrix of scenarios."""
STATE_START = len(PARAMETER_ROWS + DERIVED_ROWS) * LANES
SUMS_START = (len(ROWS) - len(SUM_ROWS)) * LANES
T_W, T_C, T_A, W_A, Q, W_S = range(0, len(VOLUME_ROWS) * LANES, LANES)
"""Offset of each row of volume 0 in the flat state V; volume i is i * VOLUME_STRIDE further."""
VOLUME_STRIDE = LANES * len(VOLUME_ROWS)
LINEAR = float(PARAMETERS["curve"].choices.index("linear"))


@section
def derive_rows(S, rows, n_volumes):
    """Fill the parameter rows from a block's ``rows``, and the derived rows; coil parameters are for 8 volumes."""
    for k in range(len(PARAMETER_ROWS)):
        for j in range(LANES):
            S[k * LANES + j] = rows[k, j]
    per_volume = 8.0 / n_volumes
    for j in range(LANES):
        S[R.dt_C_w + j] = 1.0 / (per_volume * S[R.C_w + j]) / S[R.substeps + j]
        S[R.dt_C_c + j] = 1.0 / (per_volume * S[R.C_c + j]) / S[R.substeps + j]
        S[R.ntu_w_factor + j] = per_volume * S[R.beta1 + j]
        S[R.ntu_a_factor + j] = per_volume * S[R.beta3 + j]
        S[R.ntu_star_factor + j] = per_volume * S[R.beta5 + j]
        S[R.max_travel + j] = 1.0 / S[R.stroke_time + j]
        tau = S[R.sensor_time_constant + j]
        S[R.sensor_decay + j] = exp(-1.0 / tau) if tau > 0.0 else 0.0
        S[R.ki + j] = S[R.kp + j] * S[R.sample_time + j] / S[R.ti + j]
        S[R.sign + j] = 1.0 - 2.0 * S[R.action + j]
        if S[R.rangeability + j] > 0.0:
            m_max, a, b, c = installed_valve(S[R.rangeability + j], S[R.authority + j], S[R.m_full + j])
            S[R.m_max + j] = m_max
            S[R.valve_a + j] = a
            S[R.valve_b + j] = b
            S[R.valve_c + j] = c
        S[R.log_m_max + j] = log(S[R.m_max + j])
        for opening, flow in ((0.0, R.m_0), (1.0, R.m_1)):
            growth = flow_exponential(opening, S[R.valve_b + j], S[R.valve_c + j])
            m_w = exp(log_flow(S[R.log_m_max + j], S[R.valve_a + j], growth))
            S[flow + j] = opening * S[R.m_max + j] if S[R.curve + j] == LINEAR else m_w
        highest = largest_buffer(S[R.buffer_swing + j], S[R.plant_gain + j])
        S[R.largest_buffer + j] = highest
        sigma = 0.0 if S[R.buffer_noise + j] > 0.0 else S[R.noise_std + j]
        S[R.buffer + j] = noise_buffer(S[R.buffer + j], S[R.buffer_ratio + j], S[R.kp + j], sigma, highest)
        S[R.steepness + j] = smooth_steepness(S[R.smooth_rate + j], S[R.sample_time + j])


@section
def set_initial_state(S, open_loop):
    """Fill the state rows: everything at rest; NaN for the controller in an open loop."""
    S[STATE_START:SUMS_START] = 0.0
    initial_signal = np.nan if open_loop else 0.0
    for j in range(LANES):
        S[R.u + j] = initial_signal
        S[R.integral + j] = initial_signal
        S[R.mode + j] = 0.0 if open_loop else FALLING
        S[R.estimate + j] = np.nan if open_loop else S[R.backlash_estimate + j]
        S[R.assumed_backlash + j] = S[R.estimate_share + j] * S[R.backlash_estimate + j]
        S[R.worn_backlash + j] = S[R.backlash + j]
        S[R.T_room + j] = S[R.T_initial + j] if S[R.room_capacity + j] > 0.0 else np.nan
        S[R.gap + j] = S[R.backlash + j]
        S[R.backlash_scale + j] = 1.0
        S[R.test_mean + j] = np.nan
        S[R.test_calm_for + j] = CALM_AIR_TIME_S
        S[R.time_reached + j] = np.nan
        S[R.time_confirmed + j] = np.nan
        S[R.time_identified + j] = np.nan


@section
def reset_sums(S, open_loop):
    """Reset the sums."""
    S[SUMS_START:] = 0.0
    for j in range(LANES):
        S[R.sum_switches + j] = np.nan if open_loop else 0.0
        S[R.peak_power + j] = -np.inf
        S[R.last_period + j] = np.nan


@section
def begin_run(S, V, rows, n_volumes, open_loop, is_first, W_a):
    """Fill the rows of a block for a run; in the first one also the coil, with T_initial and humidity ratio W_a."""
    derive_rows(S, rows, n_volumes)
    reset_sums(S, open_loop)
    if not is_first:
        return
    set_initial_state(S, open_loop)
    for i in range(1, n_volumes + 1):
        v = i * VOLUME_STRIDE
        for j in range(LANES):
            V[v + T_W + j] = S[R.T_initial + j]
            V[v + T_C + j] = S[R.T_initial + j]
            V[v + T_A + j] = S[R.T_initial + j]
            V[v + W_A + j] = W_a

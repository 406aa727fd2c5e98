"""The plant of each lane under constant conditions: at rest, and its response to a small step.

The march is that of the emulator with one addition: a volume at its dew point may have no state of rest, since Eq (3)
gives it more heat wet than dry, and here is wet to the share that keeps it in between.  No lane depends on others.
"""

import numpy as np

from fastcoil.model import physics
from fastcoil.model.engine.rows import LANES, T_A, T_C, T_W, VOLUME_STRIDE, W_A, W_S, Q, R, begin_run, name_offsets
from fastcoil.model.engine.valve import scale_water_flow, update_water_flow
from fastcoil.model.numerics.jit import kernel, section

from fastcoil.model.engine.coil import (  # isort: skip
    exchange_heat, half_step_of_metal, march_lagged_water, saturate, update_half_step_of_water,
    update_water_conductance,
)  # fmt: skip

CONDITIONS = ("m_a", "T_a_in", "W_a_in", "T_w_in", "dp_ratio")
"""Rows of the conditions at the inlets of a block's coils and valves, (5, LANES)."""
CONDITION = name_offsets(CONDITIONS)
_SATURATION_SLOPE = 0.065  # d ln W_s / dT near the dew points of air conditioning, 1/K: it only scales the band
_MIN_BAND_K = 0.02  # least width of the band around the dew point in which a volume is partly wet


@section
def set_inlets_per_lane(V, n_volumes, entering):
    """Set the air and the water that enter the coil of each lane."""
    air = V[(n_volumes + 1) * VOLUME_STRIDE :]
    for j in range(LANES):
        air[T_A + j] = entering[CONDITION.T_a_in, j]
        air[W_A + j] = entering[CONDITION.W_a_in, j]
        V[T_W + j] = entering[CONDITION.T_w_in, j]


@section
def begin_per_lane(rows, config, entering, S, V):
    """Set up the coils of a block, dry and at their initial temperature, with their air-side effectiveness, Eq (4)."""
    begin_run(S, V, rows, config.n_volumes, True, True, 0.0)
    for j in range(LANES):
        S[R.eps_a + j] = physics.effectiveness(S[R.ntu_a_factor + j], S[R.beta4 + j], entering[CONDITION.m_a, j])
        S[R.eps_star + j] = physics.effectiveness(S[R.ntu_star_factor + j], S[R.beta6 + j], entering[CONDITION.m_a, j])


@section
def set_openings(S, config, entering, openings):
    """Set the valve opening of each lane, (LANES,)."""
    for j in range(LANES):
        S[R.opening + j] = openings[j]
    update_water_flow(S, config.leaks, config.is_linear)
    for j in range(LANES):
        scale_water_flow(S, j, entering[CONDITION.dp_ratio, j])
    update_water_conductance(S)


@section
def march_second_per_lane(S, V, config, entering):
    """March the coil of each lane through a second; quasistatic, the air passes once more, as before the controller."""
    n_volumes = config.n_volumes
    set_inlets_per_lane(V, n_volumes, entering)
    if config.lagged_air:
        all_volumes = np.ones(n_volumes + 1, np.bool_)
        for _ in range(config.substeps):
            march_lagged_water(S, V, n_volumes, False, all_volumes)
            march_air_per_lane(S, V, n_volumes, True, entering, False)
        return
    update_half_step_of_water(S)
    for j in range(LANES):
        S[R.half_C_c + j] = half_step_of_metal(S, j, entering[CONDITION.m_a, j])
    for substep in range(config.substeps + 1):
        if substep > 0:
            exchange_heat(S, V, n_volumes, np.inf, np.ones(n_volumes + 1, np.bool_))
        for i in range(1, n_volumes + 1):
            saturate(S, V, i, False)
        march_air_per_lane(S, V, n_volumes, False, entering, False)


@section
def march_air_per_lane(S, V, n_volumes, lagged_air, entering, is_settling):
    """March the air as the emulator does, except in volumes at their dew point, see the file's docstring.

    The band is as wide as two changes of T_c by one wet step.  lagged_air: march the metal too; without it, leave the
    heat Q to ``exchange_heat``.  is_settling: march the metal by the largest step that cannot overshoot.
    """
    for j in range(LANES):
        S[R.wet_volumes + j] = 0.0
        S[R.farthest_T_c + j] = 0.0
    for k in range(n_volumes):
        i = k + 1 if lagged_air else n_volumes - k
        pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
        for j in range(LANES):
            T_in, W_in = pair[VOLUME_STRIDE + T_A + j], pair[VOLUME_STRIDE + W_A + j]
            T_c, W_s, Q_w, m_a = pair[T_C + j], pair[W_S + j], pair[Q + j], entering[CONDITION.m_a, j]

            cooled = S[R.eps_a + j] * (T_in - T_c)
            dried = S[R.eps_star + j] * physics.enthalpy_difference(T_in, W_in, T_c, W_s)
            T_out = T_in - cooled
            Q_dry = physics.air_heat(False, m_a, cooled, dried, S[R.cp_a + j])
            Q_wet = physics.air_heat(True, m_a, cooled, dried, S[R.cp_a + j])
            jump = abs(Q_wet - Q_dry)
            band = 2.0 * S[R.dt_C_c + j] * jump
            band = _MIN_BAND_K if band < _MIN_BAND_K else band
            wet = 0.5 + (W_in - W_s) / (band * _SATURATION_SLOPE * W_s)
            wet = 0.0 if wet < 0.0 else wet
            wet = 1.0 if wet > 1.0 else wet
            Q_a = Q_dry if wet == 0.0 else wet * Q_wet + (1.0 - wet) * Q_dry
            dW = wet * physics.condensed_water(True, W_in, cooled, dried, T_out)

            dt_C_c = S[R.dt_C_c + j] if lagged_air else 0.0
            if is_settling:
                slope = physics.heat_capacity(W_s) + physics.vapour_enthalpy(T_c) * (_SATURATION_SLOPE * W_s)
                G_dry, G_wet = S[R.eps_a + j] * S[R.cp_a + j], S[R.eps_star + j] * slope
                G_a = m_a * (G_wet if G_wet > G_dry else G_dry)
                is_near = abs(W_in - W_s) < 0.5 * _SATURATION_SLOPE * W_s  # slow down within 0.5 K of the dew point
                dt_C_c = 1.0 / (S[R.G_w + j] + G_a + (jump / band if is_near else 0.0))
                dt_C_c = 0.0 if S[R.dt_C_w + j] == 0.0 else dt_C_c
            T_next = physics.next_metal_temperature(T_c, Q_a, Q_w, dt_C_c)
            change = abs(T_next - T_c)
            farthest = S[R.farthest_T_c + j]
            S[R.farthest_T_c + j] = change if change > farthest else farthest
            S[R.wet_volumes + j] += wet
            pair[Q + j] = Q_a
            pair[T_C + j] = T_next
            pair[T_A + j] = T_out
            pair[W_A + j] = W_in - dW


STEADY_ROWS = ("opening", "T_sup", "m_w", "wet_volumes", "gain", "T_stepped", "nearest")
"""Rows that describe a plant at rest.

T_stepped: T_sup at rest after the first of ``neighbour_openings``.  nearest: 1 if no opening holds the set-point.
gain: NaN where T_sup jumps past it, as it may if a coil exchanges less when it is wet than when it is dry.
"""
STEADY_ROW = name_offsets(STEADY_ROWS)
OPENING_STEP = 1e-4
"""Change of the opening to each side, for a derivative."""
_REST_TOLERANCE_K = 1e-9  # distance from the set-point at which an opening holds it


@section
def neighbour_openings(opening):
    """Openings OPENING_STEP to both sides of an opening, or, at an end of the stroke, to one side and at it."""
    first = opening + OPENING_STEP if opening + OPENING_STEP <= 1.0 else opening - OPENING_STEP
    return first, min(max(opening + opening - first, 0.0), 1.0)


@section
def settle(S, V, config, entering, openings, is_at_rest):
    """Bring every coil that is not ``is_at_rest`` to rest at an opening, (LANES,) each."""
    n_volumes = config.n_volumes
    set_openings(S, config, entering, openings)
    for j in range(LANES):
        # kW/K; without flow the temperature of the water does not matter
        C_flow = S[R.C_flow + j] if S[R.C_flow + j] > 1e-12 else 1e-12
        S[R.dt_C_w + j] = 0.0 if is_at_rest[j] else 1.0 / C_flow
    all_volumes = np.ones(n_volumes + 1, np.bool_)
    for _ in range(4000):  # sweeps, at most
        set_inlets_per_lane(V, n_volumes, entering)
        march_lagged_water(S, V, n_volumes, False, all_volumes)
        march_air_per_lane(S, V, n_volumes, False, entering, True)
        # at rest when no metal moves by 1e-11 K in a sweep, and then one sweep more, for air that fits the metal
        all_rest = True
        for j in range(LANES):
            all_rest &= S[R.dt_C_w + j] == 0.0
            S[R.dt_C_w + j] = S[R.dt_C_w + j] if S[R.farthest_T_c + j] > 1e-11 else 0.0
        if all_rest:
            break


@kernel
def find_rest(rows, config, entering, T_set, S, V, steady):
    """Find the opening at which each plant of a block rests at its set-point.

    rows, config: of a Block.  entering: (5, LANES), see CONDITIONS.  T_set: (LANES,), °C.  S, V: work space; V holds
    the coils at rest afterwards.  steady: out, (7, LANES), see STEADY_ROWS; gain in K per unit opening.
    """
    begin_per_lane(rows, config, entering, S, V)
    supply = V[VOLUME_STRIDE + T_A : VOLUME_STRIDE + T_A + LANES]

    low, high, openings = np.zeros(LANES), np.ones(LANES), np.zeros(LANES)
    e_low, e_high, direction = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    none_at_rest, is_found = np.zeros(LANES, np.bool_), np.zeros(LANES, np.bool_)
    settle(S, V, config, entering, low, none_at_rest)
    for j in range(LANES):
        e_low[j] = supply[j] - T_set[j]
    settle(S, V, config, entering, high, none_at_rest)
    for j in range(LANES):
        e_high[j] = supply[j] - T_set[j]
        e_low[j] = 0.0 if abs(e_low[j]) < _REST_TOLERANCE_K else e_low[j]
        e_high[j] = 0.0 if abs(e_high[j]) < _REST_TOLERANCE_K else e_high[j]
        direction[j] = 1.0 if e_high[j] > e_low[j] else -1.0
        e_low[j] *= direction[j]
        e_high[j] *= direction[j]
        steady[STEADY_ROW.nearest, j] = 0.0 if e_low[j] <= 0.0 <= e_high[j] and e_low[j] < e_high[j] else 1.0
        openings[j] = 1.0 if e_high[j] < 0.0 else 0.0
        is_found[j] = steady[STEADY_ROW.nearest, j] != 0.0

    for k in range(60):  # openings, at most
        for j in range(LANES):
            if not is_found[j]:
                # the secant, and every third time the middle, so that the bracket shrinks for every curve
                share = 0.5 if k % 3 == 2 else -e_low[j] / (e_high[j] - e_low[j])
                openings[j] = low[j] + share * (high[j] - low[j])
        settle(S, V, config, entering, openings, is_found)
        for j in range(LANES):
            if not is_found[j]:
                e = direction[j] * (supply[j] - T_set[j])
                is_found[j] = abs(e) < _REST_TOLERANCE_K or high[j] - low[j] <= _REST_TOLERANCE_K * _REST_TOLERANCE_K
                if e <= 0.0:
                    low[j] = openings[j]
                    e_low[j] = e
                if e >= 0.0:
                    high[j] = openings[j]
                    e_high[j] = e
                if e == 0.0:
                    e_low[j] -= _REST_TOLERANCE_K * _REST_TOLERANCE_K
        if is_found.all():
            break
    for j in range(LANES):
        steady[STEADY_ROW.opening, j] = openings[j]
        low[j], high[j] = neighbour_openings(openings[j])
    settle(S, V, config, entering, low, none_at_rest)
    for j in range(LANES):
        steady[STEADY_ROW.T_stepped, j] = supply[j]
    settle(S, V, config, entering, high, none_at_rest)
    for j in range(LANES):
        steady[STEADY_ROW.gain, j] = (supply[j] - steady[STEADY_ROW.T_stepped, j]) / (high[j] - low[j])
    settle(S, V, config, entering, openings, none_at_rest)
    for j in range(LANES):
        if steady[STEADY_ROW.nearest, j] == 0.0 and abs(supply[j] - T_set[j]) > 1e-4:  # K: T_sup jumps
            steady[STEADY_ROW.nearest, j] = 1.0
            steady[STEADY_ROW.gain, j] = np.nan
        steady[STEADY_ROW.T_sup, j] = supply[j]
        steady[STEADY_ROW.m_w, j] = S[R.m_w + j]
        steady[STEADY_ROW.wet_volumes, j] = S[R.wet_volumes + j]


@kernel
def rest_curve(rows, config, entering, openings, S, V, T_sup):
    """Fill T_sup, (n, LANES), °C, with the supply temperature at rest at each of the openings, (n,)."""
    begin_per_lane(rows, config, entering, S, V)
    same_openings, none_at_rest = np.empty(LANES), np.zeros(LANES, np.bool_)
    for k in range(openings.size):
        same_openings[:] = openings[k]
        settle(S, V, config, entering, same_openings, none_at_rest)
        for j in range(LANES):
            T_sup[k, j] = V[VOLUME_STRIDE + T_A + j]


TAIL_STEPS = 60
"""Steps before the end of a response over which the ratio of successive changes is taken."""
MAX_TAIL_RATIO = 0.99999
"""Largest such ratio: a time constant of a day."""


@kernel
def simulate_step_response(rows, config, entering, steady, V_at_rest, S, V, tolerance, response, ends):
    """Simulate the response of T_sup to a small step of the opening, K per unit opening.

    steady, V_at_rest: results of ``find_rest``.  response: out, (n_steps, LANES), seconds 1 to n_steps after the step.
    ends: out, (LANES,), the second from which a lane stays within ``tolerance`` (fraction of its gain) of its end; the
    changes after it are a geometric series.  n_steps, if fewer than TAIL_STEPS + 1 seconds are left for that.
    """
    n_steps = response.shape[0]
    begin_per_lane(rows, config, entering, S, V)
    supply = V[VOLUME_STRIDE + T_A : VOLUME_STRIDE + T_A + LANES]
    first, second = np.empty(LANES), np.empty(LANES)
    for j in range(LANES):
        first[j], second[j] = neighbour_openings(steady[STEADY_ROW.opening, j])

    V[:] = V_at_rest
    set_openings(S, config, entering, first)
    ends[:] = 2
    for t in range(n_steps):
        march_second_per_lane(S, V, config, entering)
        for j in range(LANES):
            response[t, j] = supply[j]
            change = steady[STEADY_ROW.T_stepped, j] - steady[STEADY_ROW.T_sup, j]
            remaining = abs(steady[STEADY_ROW.T_stepped, j] - supply[j])
            ends[j] = t + 2 if remaining > tolerance * abs(change) + _REST_TOLERANCE_K else ends[j]

    V[:] = V_at_rest
    set_openings(S, config, entering, second)
    for t in range(n_steps):
        march_second_per_lane(S, V, config, entering)
        for j in range(LANES):
            response[t, j] = (response[t, j] - supply[j]) / (first[j] - second[j])
            response[t, j] = response[t, j] if steady[STEADY_ROW.gain, j] == steady[STEADY_ROW.gain, j] else np.nan
    for j in range(LANES):
        ends[j] = ends[j] if steady[STEADY_ROW.gain, j] == steady[STEADY_ROW.gain, j] else 2
        ends[j] = ends[j] if ends[j] + TAIL_STEPS + 1 <= n_steps else n_steps
        end = ends[j]
        tail_steps = TAIL_STEPS if TAIL_STEPS < end - 1 else end - 1
        k = end - tail_steps
        before = response[k - 1, j] - (response[k - 2, j] if k > 1 else 0.0)
        change, ratio = response[end - 1, j] - response[end - 2, j], 0.0
        if end < n_steps and change * before > 0.0:
            ratio = min((change / before) ** (1.0 / tail_steps), MAX_TAIL_RATIO)
        for t in range(end, n_steps):
            change *= ratio
            response[t, j] = response[t - 1, j] + change

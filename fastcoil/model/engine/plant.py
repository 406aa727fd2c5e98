"""The plant of Fig 6 over a block of lanes: motor, gearbox, stem, water flow, coil; and the limits of its time step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from fastcoil.model import physics
from fastcoil.model.engine.metrics import accumulate_travel
from fastcoil.model.engine.rows import LANES, Q_W, T_A, T_C, T_W, VOLUME_STRIDE, W_A, W_S, P, R
from fastcoil.model.numerics.elementary import exp, log
from fastcoil.model.numerics.jit import kernel, scalar, section
from fastcoil.model.numerics.stages import BUILT_IN, FLAG, INTEGER, ROW_POINTER, StageSignature
from fastcoil.model.physics import LEAST_WATER_FLOW_KG_S

MILD_T = 1.0
"""°C; while everything in a coil is warmer, no metal is near freezing."""
MILD_W = 0.07
"""kg/kg; while all air is drier, no metal above 50 °C gets wet."""
_DEW_POINT_STEP_K = 0.0625  # exact in binary


@section
def update_water_flow(S, leaks):
    """Update water flow, Eq (2), and water-side conductance, Eq (4): a short loop for each exponential and logarithm.

    leaks: whether the leakage of any lane is given.
    """
    for j in range(LANES):
        S[R.growth + j] = physics.flow_exponential(S[R.opening + j], S[R.valve_b + j], S[R.valve_c + j])
    for j in range(LANES):
        S[R.log_m_w + j] = physics.log_flow(S[R.log_m_max + j], S[R.valve_a + j], S[R.growth + j])
    for j in range(LANES):
        S[R.m_w + j] = exp(S[R.log_m_w + j])
        S[R.C_flow + j] = S[R.m_w + j] * S[R.cp_w + j]
    if leaks:  # the lanes without leakage keep the flow of Eq (2)
        for j in range(LANES):
            m_w = physics.leaky_flow(S[R.m_w + j], S[R.m_0 + j], S[R.m_1 + j], S[R.leakage + j])
            S[R.m_w + j] = m_w if S[R.leakage + j] >= 0.0 else S[R.m_w + j]
            S[R.C_flow + j] = S[R.m_w + j] * S[R.cp_w + j]
        for j in range(LANES):
            log_m_w = log(S[R.m_w + j] if S[R.m_w + j] > LEAST_WATER_FLOW_KG_S else LEAST_WATER_FLOW_KG_S)
            S[R.log_m_w + j] = log_m_w if S[R.leakage + j] >= 0.0 else S[R.log_m_w + j]
    update_water_conductance(S)


@section
def update_water_conductance(S):
    """Update the water-side conductance of every lane, Eq (4)."""
    for j in range(LANES):
        S[R.ntu_w + j] = physics.transfer_units(S[R.ntu_w_factor + j], S[R.beta2 + j], S[R.log_m_w + j])
    for j in range(LANES):
        S[R.G_w + j] = physics.effectiveness_from_ntu(S[R.ntu_w + j]) * S[R.C_flow + j]


@section
def update_air_effectiveness(S, m_a):
    """Update the air-side effectiveness of every lane, Eq (4)."""
    for j in range(LANES):
        S[R.eps_a + j] = physics.effectiveness(S[R.ntu_a_factor + j], S[R.beta4 + j], m_a)
        S[R.eps_star + j] = physics.effectiveness(S[R.ntu_star_factor + j], S[R.beta6 + j], m_a)


@section
def fill_air_effectiveness(S, m_a, eps):
    """Fill eps, (2, n_steps), with ε_a and ε_a* of the whole day, for lanes that share β3…β6."""
    eps_a, eps_star = eps[0], eps[1]
    for t in range(eps_a.size):  # out of its column: a loop over every eighth number is not vectorised
        eps_a[t] = m_a[t]
    for t in range(eps_a.size):
        eps_star[t] = physics.effectiveness(S[R.ntu_star_factor], S[R.beta6], eps_a[t])
        eps_a[t] = physics.effectiveness(S[R.ntu_a_factor], S[R.beta4], eps_a[t])


@section
def set_inlets(V, n_volumes, T_a_in, W_a_in, T_w_in):
    """Set the air and the water that enter the coil in this step."""
    air = V[(n_volumes + 1) * VOLUME_STRIDE :]
    for j in range(LANES):
        air[T_A + j] = T_a_in
        air[W_A + j] = W_a_in
        V[T_W + j] = T_w_in


@section
def coldest_and_dampest(S, V, n_volumes):
    """Lowest temperature, °C, and highest humidity ratio, kg/kg, in the coils of a block.

    Within the stability limits of dt, Eqs (3) and (4) take weighted means and only remove humidity: no volume goes
    beyond these values until something colder or damper enters.
    """
    for j in range(LANES):
        S[R.coldest + j] = np.inf
        S[R.dampest + j] = -np.inf
    for i in range(1, n_volumes + 1):
        cv = V[i * VOLUME_STRIDE :]
        for j in range(LANES):
            low = cv[T_W + j] if cv[T_W + j] < S[R.coldest + j] else S[R.coldest + j]
            low = cv[T_C + j] if cv[T_C + j] < low else low
            S[R.coldest + j] = cv[T_A + j] if cv[T_A + j] < low else low
            S[R.dampest + j] = cv[W_A + j] if cv[W_A + j] > S[R.dampest + j] else S[R.dampest + j]
    coldest, dampest = np.inf, -np.inf
    for j in range(LANES):
        coldest, dampest = min(coldest, S[R.coldest + j]), max(dampest, S[R.dampest + j])
    return coldest, dampest


@scalar
def dew_point_bound(T, W, pressure):
    """A temperature, °C, at and above which no air of humidity ratio W condenses on metal; inf if there is none.

    It lies up to ``_DEW_POINT_STEP_K`` above the dew point.  T: where the search starts, the bound before.
    """
    W *= 1.000001  # the pieces of the saturation curve meet to some 1e-9 of it
    T = physics.T_SATURATION_MIN if T == np.inf else T
    while T < physics.T_SATURATION_MAX and physics.saturation_humidity_ratio(T, pressure) < W:
        T += _DEW_POINT_STEP_K
    while T > physics.T_SATURATION_MIN and physics.saturation_humidity_ratio(T - _DEW_POINT_STEP_K, pressure) >= W:
        T -= _DEW_POINT_STEP_K
    return T if T < physics.T_SATURATION_MAX else np.inf


@section
def march_water(S, V, n_volumes, is_mild, may_condense):
    """March the water of every volume, Eq (3); also heat into the water and saturation, which the air march reads.

    It runs from the water's outlet to its inlet, so that the water entering a volume is still in state [t].  It is
    separate from the air march because two short chains of arithmetic overlap better than a long one.
    is_mild: no metal is near freezing, and no air so moist that it condenses above 50 °C.
    may_condense: (at least n_volumes + 1,), whether air may condense in a volume in some lane; saturation is computed
    there only.
    """
    for k in range(n_volumes):
        i = n_volumes - k
        if may_condense[i]:
            water_step(S, V, i, True)
            if not is_mild:
                saturate_cold_and_hot(S, V, i)
        else:
            water_step(S, V, i, False)


@section
def water_step(S, V, i, saturates):
    """March the water of volume i, Eq (3); with ``saturates`` also compute saturation at its metal."""
    pair = V[(i - 1) * VOLUME_STRIDE : (i + 1) * VOLUME_STRIDE]
    for j in range(LANES):
        row = VOLUME_STRIDE + j
        T_w, T_w_in, T_c = pair[row + T_W], pair[T_W + j], pair[row + T_C]
        Q_w = physics.water_heat(S[R.G_w + j], T_c, T_w_in)
        pair[row + T_W] = physics.next_water_temperature(T_w, T_w_in, Q_w, S[R.C_flow + j], S[R.dt_C_w + j])
        pair[row + Q_W] = Q_w
        if saturates:
            pair[row + W_S] = physics.humidity_ratio(physics.saturation_pressure_mild(T_c), S[R.pressure + j])


@section
def saturate_cold_and_hot(S, V, i):
    """Compute saturation at the metal of volume i in the lanes in which it is near freezing or above 50 °C."""
    cv = V[i * VOLUME_STRIDE : (i + 1) * VOLUME_STRIDE]
    cold, hot = False, False
    for j in range(LANES):
        cold |= cv[T_C + j] < physics.T_FROST
        hot |= cv[T_C + j] > physics.T_HOT
    if cold:
        for j in range(LANES):
            W_s = physics.humidity_ratio(physics.saturation_pressure_frost(cv[T_C + j]), S[R.pressure + j])
            cv[W_S + j] = W_s if cv[T_C + j] < physics.T_FROST else cv[W_S + j]
    if hot:
        for j in range(LANES):
            W_s = physics.humidity_ratio(physics.saturation_pressure_hot(cv[T_C + j]), S[R.pressure + j])
            cv[W_S + j] = W_s if cv[T_C + j] > physics.T_HOT else cv[W_S + j]


@section
def march_air(S, V, n_volumes, lagged_air, shares_air_side, eps_a, eps_star, m_a, dt_counted, T_dry, may_condense):
    """Eq (3) for the air and the metal of every volume: states[t] become states[t + 1].

    Air enters volume i from the row of volume i + 1.  In a march that starts at the water's inlet that row still
    holds state [t] (lagged, as printed); in one that starts at the air's inlet, this step's outlet (quasistatic).
    ``shares_air_side``: all lanes have the effectiveness eps_a, eps_star; otherwise it is in the rows of that name.
    dt_counted: the time step, s, or 0 where condensate does not count.
    T_dry: nothing condenses in the next march on metal from here up, °C.  may_condense: this march; out, the next.
    """
    m_a_dt = m_a * dt_counted
    for k in range(n_volumes):
        i = k + 1 if lagged_air else n_volumes - k
        if may_condense[i]:
            may_condense[i] = air_step_wet(S, V, i, shares_air_side, eps_a, eps_star, m_a, m_a_dt, T_dry)
        else:
            may_condense[i] = air_step_dry(S, V, i, shares_air_side, eps_a, m_a, T_dry)


@section
def air_step_wet(S, V, i, shares_air_side, eps_a, eps_star, m_a, m_a_dt, T_dry):
    """March air and metal of volume i, where air may condense; return whether it may again, see ``march_air``."""
    pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
    may_condense = False
    for j in range(LANES):
        T_in, W_in = pair[VOLUME_STRIDE + T_A + j], pair[VOLUME_STRIDE + W_A + j]
        T_c, W_s, Q_w = pair[T_C + j], pair[W_S + j], pair[Q_W + j]

        wet = W_in > W_s
        cooled = (eps_a if shares_air_side else S[R.eps_a + j]) * (T_in - T_c)
        dried = (eps_star if shares_air_side else S[R.eps_star + j]) * physics.enthalpy_difference(T_in, W_in, T_c, W_s)
        T_out = T_in - cooled
        dW = physics.condensed_water(wet, W_in, cooled, dried, T_out)

        Q_a = physics.air_heat(wet, m_a, cooled, dried, S[R.cp_a + j])
        T_next = physics.next_metal_temperature(T_c, Q_a, Q_w, S[R.dt_C_c + j])
        may_condense |= not T_next >= T_dry
        pair[T_C + j] = T_next
        pair[T_A + j] = T_out
        pair[W_A + j] = W_in - dW
        S[R.condensate + j] += m_a_dt * dW
    return may_condense


@section
def air_step_dry(S, V, i, shares_air_side, eps_a, m_a, T_dry):
    """March air and metal of volume i, where no air condenses in any lane: ``air_step_wet`` with less work."""
    pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
    may_condense = False
    for j in range(LANES):
        T_in, T_c = pair[VOLUME_STRIDE + T_A + j], pair[T_C + j]
        cooled = (eps_a if shares_air_side else S[R.eps_a + j]) * (T_in - T_c)
        Q_a = physics.air_heat(False, m_a, cooled, cooled, S[R.cp_a + j])
        T_next = physics.next_metal_temperature(T_c, Q_a, pair[Q_W + j], S[R.dt_C_c + j])
        may_condense |= not T_next >= T_dry
        pair[T_C + j] = T_next
        pair[T_A + j] = T_in - cooled
        pair[W_A + j] = pair[VOLUME_STRIDE + W_A + j]
    return may_condense


@section
def count_wet_volumes(S, V, n_volumes):
    """Count the wet volumes, before a lagged march or after a quasistatic one: the rows hold what it compares."""
    for j in range(LANES):
        S[R.wet_volumes + j] = 0.0
    for i in range(1, n_volumes + 1):
        pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
        for j in range(LANES):
            S[R.wet_volumes + j] += 1.0 if pair[VOLUME_STRIDE + W_A + j] > pair[W_S + j] else 0.0


ACTUATOR_SIGNATURE = StageSignature(S=ROW_POINTER, counted=FLAG, returns=INTEGER)
"""Stages that move motor and stem, see ``actuator_stage``."""
call_actuator = ACTUATOR_SIGNATURE.call
VALVE_MOVED = 1
"""Flag that ``actuate`` returns if any valve moved."""
ACTUATOR_BUSY = 2
"""Flag that ``actuate`` returns if any motor or stem has to be computed in the next second whatever the command."""


@dataclass(frozen=True, kw_only=True)
class ActuatorFeatures:
    """Parts of ``actuate`` that are compiled for a block, because one of its lanes needs them."""

    has_resolution: bool = False
    has_neutral_zone: bool = False
    has_stick_slip: bool = False
    has_wear: bool = False

    @classmethod
    def of_lanes(cls, row: Mapping[str, np.ndarray]) -> ActuatorFeatures:
        """Return the features of a block with these parameters, each (LANES,)."""
        return cls(
            has_resolution=bool(np.any(row["command_resolution"] > 0.0)),
            has_neutral_zone=bool(np.any(row["neutral_zone"] > 0.0)),
            has_stick_slip=bool(np.any(row["slip_jump"] > 0.0)),
            has_wear=bool(np.any(row["wear_rate"] > 0.0)),
        )


def make_actuate(features: ActuatorFeatures) -> Any:
    """Return the section ``actuate`` with these features, see ``make_control``."""
    has_resolution, has_neutral_zone = features.has_resolution, features.has_neutral_zone
    has_stick_slip, has_wear = features.has_stick_slip, features.has_wear

    @section
    def actuate(S, counted):
        """Move motor and gearbox, Eq (1); return VALVE_MOVED and ACTUATOR_BUSY as they apply."""
        moved, running = False, False
        for j in range(LANES):
            target = physics.actuator_input(S[R.command + j], S[R.command_resolution + j] if has_resolution else 0.0)
            previous, max_travel = S[R.position + j], S[R.max_travel + j]
            x_bl, commissioned_gap = S[R.gap + j], S[R.backlash + j]
            if has_neutral_zone:
                runs = S[R.motor_runs + j] != 0.0
                position, runs = physics.move_with_dead_zone(previous, target, max_travel, S[R.neutral_zone + j], runs)
                S[R.motor_runs + j] = 1.0 if runs else 0.0
                running |= runs
            else:
                position = physics.motor_position(previous, target, max_travel)
                running |= position != target
            if has_stick_slip:
                direction = S[R.stem_direction + j]
                q, direction = physics.stick_slip(S[R.q + j], direction, position, previous, x_bl, S[R.slip_jump + j])
                S[R.stem_direction + j] = direction
                running |= direction != 0.0  # it sticks in the second in which the motor has stopped
                open_ = physics.opening(q, commissioned_gap - S[R.slip_jump + j])
            else:
                q = physics.backlash(S[R.q + j], position, x_bl)
                open_ = physics.opening(q, commissioned_gap)
            d_opening, d_position = open_ - S[R.opening + j], position - previous
            if counted:
                accumulate_travel(S, j, d_opening, d_position)
            S[R.position + j] = position
            S[R.q + j] = q
            S[R.opening + j] = open_
            if has_wear:
                S[R.worn_backlash + j] += S[R.wear_rate + j] * abs(d_opening)
                S[R.gap + j] = physics.scaled_backlash(S[R.worn_backlash + j], S[R.backlash_scale + j])
                running |= S[R.gap + j] != x_bl
            moved |= d_opening != 0.0
        return (VALVE_MOVED if moved else 0) + (ACTUATOR_BUSY if running else 0)

    return actuate


actuate = make_actuate(ActuatorFeatures())


@cache
def actuator_stage(features: ActuatorFeatures) -> Any:
    """Return the address of ``actuate`` compiled with these features, see ACTUATOR_SIGNATURE."""
    if features == ActuatorFeatures():
        return BUILT_IN
    actuate_lanes = make_actuate(features)

    def actuator(S, counted):
        return actuate_lanes(S, counted)

    return ACTUATOR_SIGNATURE.compile(actuator, repr(features))


@kernel
def stability_numbers(matrix, m_a, slope):
    """Return γ = m_w c_p,w dt / C_w and λ = dt (G_a + G_w) / C_c of every scenario at full opening, (n,) each.

    dt = 1 s / substeps.  matrix: (len(PARAMETER_ROWS), n).  m_a: air flows to try, kg/s.  slope: dh_s/dT of the
    wettest entering air, kJ/(kg K), for the wet form of λ; 0 where no volume can be wet.
    """
    gamma, lam = np.empty(matrix.shape[1]), np.empty(matrix.shape[1])
    for k in range(matrix.shape[1]):
        p = matrix[:, k]
        per_volume = 8.0 / p[P.n_volumes]
        m_max, a, b, c = p[P.m_max], p[P.valve_a], p[P.valve_b], p[P.valve_c]
        if p[P.rangeability] > 0.0:
            m_max, a, b, c = physics.installed_valve(p[P.rangeability], p[P.authority], p[P.m_full])
        m_w = physics.water_flow(1.0, m_max, a, b, c)
        G_w = physics.effectiveness(per_volume * p[P.beta1], p[P.beta2], m_w) * m_w * p[P.cp_w]
        G_air = 0.0
        for m in m_a:
            G_a = physics.effectiveness(per_volume * p[P.beta3], p[P.beta4], m) * m * p[P.cp_a]
            G_wet = physics.effectiveness(per_volume * p[P.beta5], p[P.beta6], m) * m * slope
            G_air = max(G_air, G_a, G_wet)
        gamma[k] = m_w * p[P.cp_w] / (per_volume * p[P.C_w]) / p[P.substeps]
        lam[k] = (G_air + G_w) / (per_volume * p[P.C_c]) / p[P.substeps]
    return gamma, lam

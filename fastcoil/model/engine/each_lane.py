"""The emulator's march for lanes with conditions of their own, held for ever.

It has one addition.  Eq (3) gives a control volume more heat when it is wet than when it is dry, at the same state.  So
a volume at its dew point may have no state of rest: it changes between wet and dry every few seconds.  Here such a
volume is wet to the share that keeps it in between.  Every other volume is as in the emulator, to the bit.
"""

from __future__ import annotations

import numpy as np

from fastcoil.model.engine.plant import march_water
from fastcoil.model.engine.rows import LANES, Q_W, T_A, T_C, T_W, VOLUME_STRIDE, W_A, W_S, R, positions
from fastcoil.model.numerics.jit import section
from fastcoil.model.physics.coil import air_heat, condensed, effectiveness, metal
from fastcoil.model.physics.psychrometrics import enthalpy_difference, heat_capacity, vapour_enthalpy

CONDITIONS = ("m_a", "T_a_in", "W_a_in", "T_w_in")
"""Rows of what enters the coils of a block, (4, LANES)."""
C = positions(CONDITIONS)
_SATURATION_SLOPE = 0.065
"""d ln W_s / dT near the dew points of air conditioning, 1/K: it only scales the band."""
_LEAST_BAND = 0.02
"""Width of the band around the dew point in which a volume is partly wet, at least, K."""
_NEAR = 0.5
"""No volume on its way to rest passes this distance from the dew point, K, in one sweep without slowing down."""


@section
def enter_each(V, n_volumes, entering):
    """Set the air and the water that enter the coil of each lane."""
    air = V[(n_volumes + 1) * VOLUME_STRIDE :]
    for j in range(LANES):
        air[T_A + j] = entering[C.T_a_in, j]
        air[W_A + j] = entering[C.W_a_in, j]
        V[T_W + j] = entering[C.T_w_in, j]


@section
def air_side_each(S, entering):
    """Air-side effectiveness of every lane at its own air flow, Eq (4)."""
    for j in range(LANES):
        S[R.eps_a + j] = effectiveness(S[R.ntu_a_factor + j], S[R.beta4 + j], entering[C.m_a, j])
        S[R.eps_star + j] = effectiveness(S[R.ntu_star_factor + j], S[R.beta6 + j], entering[C.m_a, j])


@section
def second_each(S, V, common, entering):
    """March the coil of each lane through a second, in the substeps of the block."""
    enter_each(V, common.n_volumes, entering)
    everywhere = np.ones(common.n_volumes + 1, np.bool_)
    for _ in range(common.substeps):
        march_water(S, V, common.n_volumes, False, everywhere)
        march_air_each(S, V, common.n_volumes, common.lagged_air, entering, False)


@section
def march_air_each(S, V, n_volumes, lagged_air, entering, hurries):
    """Eq (3) for air and metal as in ``march_air``, but for volumes at their dew point, see the file's docstring.

    The band is two changes of T_c wide, by one step of being wet: the emulator's own grain.
    hurries: on the way to rest, with the largest step that cannot overshoot in place of a second; lanes without a time
    step of the water stand still.
    """
    for j in range(LANES):
        S[R.wet_volumes + j] = 0.0
        S[R.farthest_T_c + j] = 0.0
    for k in range(n_volumes):
        i = k + 1 if lagged_air else n_volumes - k
        pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
        for j in range(LANES):
            T_in, W_in = pair[VOLUME_STRIDE + T_A + j], pair[VOLUME_STRIDE + W_A + j]
            T_c, W_s, Q_w, m_a = pair[T_C + j], pair[W_S + j], pair[Q_W + j], entering[C.m_a, j]

            cooled = S[R.eps_a + j] * (T_in - T_c)
            dried = S[R.eps_star + j] * enthalpy_difference(T_in, W_in, T_c, W_s)
            T_out = T_in - cooled
            Q_dry = air_heat(False, m_a, cooled, dried, S[R.cp_a + j])
            Q_wet = air_heat(True, m_a, cooled, dried, S[R.cp_a + j])
            jump = abs(Q_wet - Q_dry)
            band = 2.0 * S[R.dt_C_c + j] * jump
            band = _LEAST_BAND if band < _LEAST_BAND else band
            wet = 0.5 + (W_in - W_s) / (band * _SATURATION_SLOPE * W_s)
            wet = 0.0 if wet < 0.0 else wet
            wet = 1.0 if wet > 1.0 else wet
            Q_a = Q_dry if wet == 0.0 else wet * Q_wet + (1.0 - wet) * Q_dry
            dW = wet * condensed(True, W_in, cooled, dried, T_out)

            dt_C_c = S[R.dt_C_c + j]
            if hurries:
                slope = heat_capacity(W_s) + vapour_enthalpy(T_c) * (_SATURATION_SLOPE * W_s)
                G_dry, G_wet = S[R.eps_a + j] * S[R.cp_a + j], S[R.eps_star + j] * slope
                G_a = m_a * (G_wet if G_wet > G_dry else G_dry)
                is_near = abs(W_in - W_s) < _NEAR * _SATURATION_SLOPE * W_s
                dt_C_c = 1.0 / (S[R.G_w + j] + G_a + (jump / band if is_near else 0.0))
                dt_C_c = 0.0 if S[R.dt_C_w + j] == 0.0 else dt_C_c
            T_next = metal(T_c, Q_a, Q_w, dt_C_c)
            change = abs(T_next - T_c)
            farthest = S[R.farthest_T_c + j]
            S[R.farthest_T_c + j] = change if change > farthest else farthest
            S[R.wet_volumes + j] += wet
            pair[T_C + j] = T_next
            pair[T_A + j] = T_out
            pair[W_A + j] = W_in - dW

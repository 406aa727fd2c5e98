"""How fast the explicit scheme of Eq (3) moves: the numbers that must stay at or below 1."""

from __future__ import annotations

import numpy as np

from fastcoil.engine.lanes import PARAMETER_ROWS
from fastcoil.numerics.jit import kernel
from fastcoil.physics.coil import effectiveness
from fastcoil.physics.valve import installed_valve, water_flow

_ROW = {name: k for k, name in enumerate(PARAMETER_ROWS)}
_C_W, _C_C, _N = _ROW["C_w"], _ROW["C_c"], _ROW["n_volumes"]
_BETA1, _BETA2, _BETA3 = _ROW["beta1"], _ROW["beta2"], _ROW["beta3"]
_BETA4, _BETA5, _BETA6 = _ROW["beta4"], _ROW["beta5"], _ROW["beta6"]
_CP_W, _CP_A = _ROW["cp_w"], _ROW["cp_a"]
_M_MAX, _A, _B, _C = _ROW["m_max"], _ROW["valve_a"], _ROW["valve_b"], _ROW["valve_c"]
_R, _AUTHORITY, _M_FULL = _ROW["rangeability"], _ROW["authority"], _ROW["m_full"]


@kernel
def step_numbers(matrix, m_a, slope, gamma, lam):
    """γ = m_w c_p,w dt / C_w and λ = dt (G_a + G_w) / C_c at full opening, per scenario.

    matrix: (len(PARAMETER_ROWS), n).  m_a: air flows to try, kg/s.  slope: dh_s/dT of the wettest entering
    air, kJ/(kg K), for the wet form of λ; 0 where no volume can be wet.  gamma, lam: out, (n,).
    """
    for k in range(matrix.shape[1]):
        p = matrix[:, k]
        per_volume = 8.0 / p[_N]
        m_max, a, b, c = p[_M_MAX], p[_A], p[_B], p[_C]
        if p[_R] > 0.0:
            m_max, a, b, c = installed_valve(p[_R], p[_AUTHORITY], p[_M_FULL])
        m_w = water_flow(1.0, m_max, a, b, c)
        G_w = effectiveness(per_volume * p[_BETA1], p[_BETA2], m_w) * m_w * p[_CP_W]
        G_air = 0.0
        for m in m_a:
            G_a = effectiveness(per_volume * p[_BETA3], p[_BETA4], m) * m * p[_CP_A]
            G_wet = effectiveness(per_volume * p[_BETA5], p[_BETA6], m) * m * slope
            G_air = max(G_air, G_a, G_wet)
        gamma[k] = m_w * p[_CP_W] / (per_volume * p[_C_W])
        lam[k] = (G_air + G_w) / (per_volume * p[_C_C])


def worst_numbers(matrix: np.ndarray, m_a: np.ndarray, slope: float) -> tuple[np.ndarray, np.ndarray]:
    """(γ, λ) of every scenario, each (n,)."""
    gamma, lam = np.empty(matrix.shape[1]), np.empty(matrix.shape[1])
    step_numbers(matrix, m_a, slope, gamma, lam)
    return gamma, lam

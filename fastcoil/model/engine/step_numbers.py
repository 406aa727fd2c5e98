"""γ and λ of the explicit scheme, Eq (3): it is stable where both are at most 1."""

from __future__ import annotations

import numpy as np

from fastcoil.model.engine.rows import PARAMETER_ROWS, positions
from fastcoil.model.numerics.jit import kernel
from fastcoil.model.physics.coil import effectiveness
from fastcoil.model.physics.valve import installed_valve, water_flow

P = positions(PARAMETER_ROWS)


@kernel
def step_numbers(matrix, m_a, slope, gamma, lam):
    """γ = m_w c_p,w dt / C_w and λ = dt (G_a + G_w) / C_c at full opening, per scenario; dt = 1 s / substeps.

    matrix: (len(PARAMETER_ROWS), n).  m_a: air flows to try, kg/s.  slope: dh_s/dT of the wettest entering
    air, kJ/(kg K), for the wet form of λ; 0 where no volume can be wet.  gamma, lam: out, (n,).
    """
    for k in range(matrix.shape[1]):
        p = matrix[:, k]
        per_volume = 8.0 / p[P.n_volumes]
        m_max, a, b, c = p[P.m_max], p[P.valve_a], p[P.valve_b], p[P.valve_c]
        if p[P.rangeability] > 0.0:
            m_max, a, b, c = installed_valve(p[P.rangeability], p[P.authority], p[P.m_full])
        m_w = water_flow(1.0, m_max, a, b, c)
        G_w = effectiveness(per_volume * p[P.beta1], p[P.beta2], m_w) * m_w * p[P.cp_w]
        G_air = 0.0
        for m in m_a:
            G_a = effectiveness(per_volume * p[P.beta3], p[P.beta4], m) * m * p[P.cp_a]
            G_wet = effectiveness(per_volume * p[P.beta5], p[P.beta6], m) * m * slope
            G_air = max(G_air, G_a, G_wet)
        gamma[k] = m_w * p[P.cp_w] / (per_volume * p[P.C_w]) / p[P.substeps]
        lam[k] = (G_air + G_w) / (per_volume * p[P.C_c]) / p[P.substeps]


def worst_numbers(matrix: np.ndarray, m_a: np.ndarray, slope: float) -> tuple[np.ndarray, np.ndarray]:
    """(γ, λ) of every scenario, each (n,)."""
    gamma, lam = np.empty(matrix.shape[1]), np.empty(matrix.shape[1])
    step_numbers(matrix, m_a, slope, gamma, lam)
    return gamma, lam

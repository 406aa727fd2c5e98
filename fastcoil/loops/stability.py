"""Stability of the explicit scheme of Eq (3) at dt = 1 s / substeps, checked before anything runs.

Every temperature stays a weighted mean of its neighbours, and nothing overshoots, exactly if γ ≤ 1 and
λ ≤ 1 in every control volume (γ: Courant number of the water, λ: rate of the metal).
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import Layout
from fastcoil.model import moist_air
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.engine.plant import worst_numbers
from fastcoil.model.engine.rows import PARAMETER_ROWS
from fastcoil.model.parameter_table import PARAMETERS

_CHUNK = 65536
_AIR_FLOWS = 17
"""Air flows tried between the least and the largest of the boundary: λ need not rise with the flow."""


def check_stability(layout: Layout) -> None:
    """Refuse the whole study if one scenario breaks γ ≤ 1 or λ ≤ 1.

    Flows are the largest that can occur: water at full opening, air over the boundary's series.  The wet λ takes
    dh_s/dT at the largest entering dew point, unless the coil cannot get wet.
    """
    coil = _coil_and_valve(layout)
    boundary = layout.boundary
    m_a = _air_flows(boundary)
    n_bad, worst = 0, (0, 0.0, 0.0)
    for start in range(0, coil.size, _CHUNK):
        index = np.arange(start, min(start + _CHUNK, coil.size))
        columns = coil.columns(index)
        gamma, lam = worst_numbers(parameter_matrix(columns), m_a, _wet_slope(boundary, columns))
        broken = np.maximum(gamma, lam)
        n_bad += int(np.count_nonzero(~(broken <= 1.0)))
        k = int(np.nanargmax(broken))
        if broken[k] > max(worst[1:]):
            worst = start + k, float(gamma[k]), float(lam[k])
    if n_bad:
        raise InputError(_verdict(layout, coil, n_bad, m_a, *worst))


def stable(loop: Loop, boundary: Boundary) -> xr.DataArray:
    """Whether γ ≤ 1 and λ ≤ 1, over the dims of ``loop``: as ``check_stability``, without refusing."""
    layout = Layout(loop, boundary)
    columns = layout.columns(np.arange(layout.size))
    gamma, lam = worst_numbers(parameter_matrix(columns), _air_flows(boundary), _wet_slope(boundary, columns))
    holds = (np.maximum(gamma, lam) <= 1.0).reshape(tuple(loop.sizes.values()))
    return xr.DataArray(holds, dims=tuple(loop.sizes), coords=layout.coordinates())


def _air_flows(boundary: Boundary) -> np.ndarray:
    return np.linspace(*boundary.extremes["m_a"], _AIR_FLOWS)


def _coil_and_valve(layout: Layout) -> Layout:
    """The study with only the parameters swept that stability depends on."""
    # whatever a closed valve leaks, fully open it delivers the same
    names = [p.name for p in PARAMETERS.values() if p.group in ("coil", "valve") and p.name != "leakage"]
    given = {n: v for n, v in layout.loop.items() if n in names}
    axes = {d for v in given.values() if isinstance(v, xr.DataArray) for d in v.dims}
    given |= {n: v for n, v in layout.loop.swept.items() if n in axes}
    if "rangeability" in given:
        given = {n: v for n, v in given.items() if n not in ("m_max", "valve_a", "valve_b", "valve_c")}
    return Layout(Loop(**given), layout.boundary)


def _wet_slope(boundary: Boundary, columns: dict[str, np.ndarray]) -> float:
    pressure = float(columns["pressure"].min())
    extremes = boundary.extremes
    dew_point = float(moist_air.wetting_point(extremes["W_a_in"][1], pressure))
    coldest = min(extremes[n][0] for n in ("T_w_in", "T_a_in"))
    if min(coldest, columns["T_initial"].min()) >= dew_point:
        return 0.0
    return float(moist_air.saturation_enthalpy_slope(dew_point, pressure))


def _verdict(layout: Layout, coil: Layout, n_bad: int, m_a: np.ndarray, worst: int, gamma: float, lam: float) -> str:
    """worst: flat index of the least stable scenario, of γ and λ."""
    columns = coil.columns(np.array([worst]))
    matrix, slope = parameter_matrix(columns), _wet_slope(layout.boundary, columns)
    n_volumes, substeps = int(columns["n_volumes"][0]), int(columns["substeps"][0])
    largest_stable = n_volumes
    while largest_stable := largest_stable - 1:
        matrix[PARAMETER_ROWS.index("n_volumes")] = largest_stable
        if max(x[0] for x in worst_numbers(matrix, m_a, slope)) <= 1.0:
            break
    what = [f"γ = m_w cp_w dt/C_w = {gamma:.3g}"] if gamma > 1.0 else []
    what += [f"λ = dt (G_a + G_w)/C_c = {lam:.3g}"] if lam > 1.0 else []
    cures = [f"n_volumes = {largest_stable} or less is stable"] if largest_stable else []
    enough = int(np.ceil(min(max(gamma, lam), 1e6) * substeps * (1 - 1e-12)))
    cures += [f"substeps = {enough} is stable"] if enough <= PARAMETERS["substeps"].upper else []
    for name, number in (("C_w", gamma), ("C_c", lam)):
        if 1.0 < number < np.inf:
            given = float(columns[name][0])
            cures.append(f"raise {name} from {given:g} to at least {_ceil3(given * number):g} kJ/K")
    place = ", ".join(filter(None, [coil.describe(worst), f"n_volumes={n_volumes}"]))
    dt = "1 s" if substeps == 1 else f"1/{substeps} s"
    share = n_bad * (layout.size // coil.size)
    return (
        f"unstable at dt = {dt}: {share:,} of {layout.size:,} scenarios have γ or λ above 1; "
        f"worst: {' and '.join(what)} at {place}; cure: {', or '.join(cures)}"
    )


def _ceil3(x: float) -> float:
    """Round up to 3 significant digits, so that following the advice is enough."""
    scale = 10.0 ** (np.floor(np.log10(x)) - 2)
    return float(np.ceil(x / scale * (1 - 1e-12)) * scale)

"""Whether the columns of a log agree: temperatures of one air stream in one unit, a command that answers them."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fastcoil.base.arguments import raise_problems
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs import CheckedLog
from fastcoil.measured.fitted_plant import LEAST_PI_ROWS, SATURATION_TOLERANCE
from fastcoil.measured.grid import is_range_good
from fastcoil.model.moist_air import saturation_humidity_ratio
from fastcoil.model.parameter_table import PARAMETERS

_LARGEST_TYPICAL_ERROR_K, _FARTHEST_OUTSIDE_INLETS_K = 15.0, 10.0
"""K by which T_sup may typically lie off T_set with the valve in control, and outside of entering air and water."""
_UNIT_MATCH_DEG_F = 10.0  # °F within which temperatures come that only a wrong unit held apart
_LEAST_INLET_DIFFERENCE_K, _LEAST_HEAT_ROWS, _LARGEST_HEAT_RATIO, _LARGEST_HEAT_RATIO_WITHOUT_OUTLET = (
    1.0,
    10,
    3.0,
    60.0,
)
"""K by which air and water change where their heat is compared; rows; factors between both, of a wrong unit: the last
without the water's outlet, where it would change by a sixtieth of what it could."""
_CP_AIR, _CP_WATER, _PRESSURE = np.array([PARAMETERS[name].default for name in ("cp_a", "cp_w", "pressure")], float)
_CONDENSATION_HEAT = 2501.0  # kJ/kg
_CHANGE_SPAN_S, _LEFT_OUT_AFTER_STEP_S = 120.0, 300.0  # s
LARGEST_CLOCK_SHIFT_S = 180.0  # s by which the clocks of two columns may differ
_INLIER_SHARE, _INLIER_SHARE_WITHOUT_SET_POINT, _LEAST_SHIFT_IMPROVEMENT = 0.9, 0.8, 2.0
_COARSEST_RESOLUTION = 0.02  # resolution of a command that is reckoned with, fraction of stroke
_MOST_UNEXPLAINED, _MOST_UNEXPLAINED_PER_SECOND = 0.015, 1 / 2000
"""Share of the variance of the command's changes that the PI of its own temperature leaves at most, in a fast log and
for each second between samples; so much more without a set-point.  Chosen on other valves than those of the table
``claims_misled``, which says how often other plants pass."""
_LARGEST_RESIDUAL_CORRELATION, _NEGLIGIBLE_UNEXPLAINED = 0.25, 0.005
"""Correlation of what the PI leaves with what it leaves a window later, as that of another plant's temperature has and
noise has not; share of the variance below which it does not count."""


def require_agreement(log: CheckedLog) -> list[str]:
    """Refuse a log whose temperatures are in wrong units; return a warning for others that do not agree."""
    values, T = log.values, log.values["T_sup"]
    has_temperature = np.isfinite(T) & (values.get("enabled", np.ones(T.size)) != 0.0)
    checks: list[tuple[tuple[str, ...], Mask, Array, float]] = []
    if "T_set" in values:
        command = values.get("command", np.full(T.size, 0.5))
        controlled = has_temperature & np.isfinite(values["T_set"]) & (command > 0.01) & (command < 0.99)
        checks.append((("T_sup", "T_set"), controlled, np.abs(T - values["T_set"]), _LARGEST_TYPICAL_ERROR_K))
    if "T_a_in" in values and "T_w_in" in values:
        T_air, T_water = values["T_a_in"], values["T_w_in"]
        outside = np.maximum(T - np.maximum(T_air, T_water), np.minimum(T_air, T_water) - T)
        checks.append((("T_sup", "T_a_in", "T_w_in"), has_temperature, outside, _FARTHEST_OUTSIDE_INLETS_K))
    problems, warnings = list(_find_heat_problems(log)), []
    for names, where, deviation, limit in checks:
        if where.any() and np.median(deviation[where]) > limit:
            typical = ", ".join(f"{name} {np.median(values[name][where]):.3g}" for name in names)
            statement = f"{log.name}: {typical} degC, as they typically are, do not agree: check "
            pair = T[where], values[names[1]][where]
            # come together if one is in °F instead of °C, or the reverse
            pairs = (pair, pair[::-1])
            if len(names) > 2 or any(np.median(np.abs(a - 32.0 - 1.8 * b)) < _UNIT_MATCH_DEG_F for a, b in pairs):
                problems.append(f"{statement}their units")
            else:
                warnings.append(f"{statement}the columns, the sensor and the valve")
    raise_problems(problems)
    return warnings


def _find_heat_problems(log: CheckedLog) -> Iterator[str]:
    """A sentence if the water carries less heat than the air by its temperature alone, or more than it can have."""
    if not log.values.keys() >= {"m_w", "m_a", "T_a_in", "T_w_in"}:
        return
    T, m_w, m_a, T_air, T_water = (log.values[name] for name in ("T_sup", "m_w", "m_a", "T_a_in", "T_w_in"))
    T_out = log.values.get("T_w_out", T_air)  # closer to the air it cannot come
    is_usable = (
        (np.abs(T_air - T) > _LEAST_INLET_DIFFERENCE_K)
        & (np.abs(T_out - T_water) > _LEAST_INLET_DIFFERENCE_K)
        & (m_w * m_a > 0.0)
    )
    if is_usable.sum() < _LEAST_HEAT_ROWS:
        return
    vapour = np.maximum(log.humidity_ratio(_PRESSURE) - saturation_humidity_ratio(T_water), 0.0)
    air_heat, condensation_heat = _CP_AIR * m_a * (T_air - T), _CONDENSATION_HEAT * m_a * vapour * (T < T_air)
    water_heat = _CP_WATER * m_w * (T_out - T_water)
    low, high = (float(np.median((water_heat / heat)[is_usable])) for heat in (air_heat, air_heat + condensation_heat))
    if low < 1.0 / _LARGEST_HEAT_RATIO or high > (
        _LARGEST_HEAT_RATIO if "T_w_out" in log.values else _LARGEST_HEAT_RATIO_WITHOUT_OUTLET
    ):
        ratio = f"{'' if 'T_w_out' in log.values else 'at most '}{low if low < 1.0 else high:.3g} times"
        flows = " and ".join(f"{name} of {np.median(log.values[name][is_usable]):.3g} kg/s" for name in ("m_w", "m_a"))
        yield f"{log.name}: water takes up {ratio} the heat of the air ({flows}): check the units of both flows"


class ImpliedPI(NamedTuple):
    """The PI that a command implies: how much of the command it explains, and the clock on which it does so."""

    temperature_lag: int = 0  # samples by which the temperature stands late beside the command; negative: early
    explained: float = np.nan  # of the variance of the command's changes; NaN if too few can be compared
    least_explained: float = 0.0  # share that the command's own temperature explains
    ti: float = np.nan  # s; below 0, the command moves before the temperature that it answers
    residual_correlation: float = 0.0  # correlation of what it leaves with what it leaves a window later

    @property
    def is_another(self) -> bool:
        """Whether the command answers another temperature, or under another law."""
        return self.explained < self.least_explained or (
            self.residual_correlation > _LARGEST_RESIDUAL_CORRELATION and 1.0 - self.explained > _NEGLIGIBLE_UNEXPLAINED
        )


def imply_pi(
    command: Array, temperature: Array, T_set: Array | None, good: Mask, interval: float, *, settled: bool = True
) -> ImpliedPI:
    """How well a PI of the temperature explains the command, at the shift of the clock that explains it best.

    Changes over two minutes are regressed on those of the error and its integral.  settled: whether a while after each
    change of the set-point is left out, which every loop of one schedule answers alike; not if nothing is left then.
    Without a set-point two such changes in a row are compared, from which one that stands still falls out.  The least
    explained part is left out, where the command was overridden, and what the resolution of the command explains is
    not missed.
    """
    width, largest_shift = max(1, round(_CHANGE_SPAN_S / interval)), int(LARGEST_CLOCK_SHIFT_S / interval)
    compared, error = good, np.where(good, temperature - np.mean(temperature[good]), 0.0)
    if T_set is not None:
        if settled:
            changed = np.append(False, np.diff(T_set) != 0.0)
            shortly_after = np.convolve(changed, np.ones(int(_LEFT_OUT_AFTER_STEP_S / interval) + 1))[: good.size] > 0.5
            compared = good & ~shortly_after
        error = np.where(compared, temperature - T_set, 0.0)
    error_integral = np.concatenate([[0.0], np.cumsum(interval * error)])
    before = width if T_set is None else 0
    first = np.arange(largest_shift + before, max(command.size - width - largest_shift, largest_shift + before))
    first = first[is_range_good(compared, first - largest_shift - before, first + width + largest_shift)]
    ends = np.stack([command[first - before], command[first], command[first + width]])
    first = first[(ends.min(axis=0) > SATURATION_TOLERANCE) & (ends.max(axis=0) < 1.0 - SATURATION_TOLERANCE)]

    def changes(at: Index) -> Array:
        columns = (
            error[at + width] - error[at],
            error_integral[at + width + 1] - error_integral[at + 1],
            np.ones(at.size),
        )
        return np.stack(columns, axis=1)

    command_change = command[first + width] - command[first]
    if before:
        command_change = command_change - (command[first] - command[first - width])
    if first.size < LEAST_PI_ROWS or not np.any(command_change):
        if T_set is None or not settled:
            return ImpliedPI()
        unsettled_pi = imply_pi(command, temperature, T_set, good, interval, settled=False)
        return unsettled_pi if unsettled_pi.explained >= unsettled_pi.least_explained else ImpliedPI()
    command_levels = np.diff(np.unique(command[compared]))
    rounding = (
        min(float(command_levels.min()), _COARSEST_RESOLUTION) ** 2 / 6.0
    )  # variance of a change, of its rounding alone
    unexplained_shares, ti, correlations = {}, {}, {}
    for shift in sorted(range(-largest_shift, largest_shift + 1), key=abs):
        at = first + shift
        X = changes(at) - changes(at - width) if before else changes(at)
        is_inlier = np.ones(at.size, dtype=bool)
        for _ in range(3):
            coefficients = np.linalg.lstsq(X[is_inlier], command_change[is_inlier], rcond=None)[0]
            residual = command_change - X @ coefficients
            is_inlier = np.abs(residual) <= np.quantile(
                np.abs(residual), _INLIER_SHARE_WITHOUT_SET_POINT if before else _INLIER_SHARE
            )
        variance = float(np.sum((command_change[is_inlier] - command_change.mean()) ** 2))
        unexplained = max(float(np.sum(residual[is_inlier] ** 2)) - rounding * is_inlier.sum(), 0.0)
        unexplained_shares[shift], ti[shift] = (
            unexplained / max(variance, 1e-300),
            float(coefficients[0] / coefficients[1]),
        )
        is_window_apart = at[width:] - at[:-width] == width
        inlier_residual = np.where(is_inlier, residual, 0.0)
        lagged_product = float(inlier_residual[width:][is_window_apart] @ inlier_residual[:-width][is_window_apart])
        correlations[shift] = lagged_product / max(float(inlier_residual @ inlier_residual), 1e-300)
    best = min(unexplained_shares, key=lambda shift: unexplained_shares[shift])
    shift = best if _LEAST_SHIFT_IMPROVEMENT * unexplained_shares[best] < unexplained_shares[0] else 0
    least = (
        1.0 - max(_MOST_UNEXPLAINED, _MOST_UNEXPLAINED_PER_SECOND * interval) - (_MOST_UNEXPLAINED if before else 0.0)
    )
    return ImpliedPI(shift, 1.0 - unexplained_shares[shift], least, ti[shift], correlations[shift])

"""Agreement of the columns of a log: temperatures in one unit, and a command that answers them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from fastcoil.base.arguments import raise_problems
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import Problem
from fastcoil.logs import CheckedLog
from fastcoil.measured import thresholds
from fastcoil.measured.fitted_plant import LEAST_PI_ROWS, is_unsaturated
from fastcoil.measured.grid import is_range_good
from fastcoil.model.moist_air import saturation_humidity_ratio
from fastcoil.model.parameter_table import PARAMETERS

_CP_AIR, _CP_WATER = np.array([PARAMETERS[name].default for name in ("cp_a", "cp_w")], float)  # kJ/(kg K)
_PRESSURE_PA = np.array([PARAMETERS["pressure"].default], float)[0]


def require_agreement(log: CheckedLog) -> list[str]:
    """Refuse a log whose temperatures or flows are in wrong units; return warnings of other contradictions."""
    values, T = log.values, log.values["T_sup"]
    has_temperature = np.isfinite(T) & (values.get("enabled", np.ones(T.size)) != 0.0)
    checks: list[tuple[tuple[str, ...], Mask, Array, float]] = []
    if "T_set" in values:
        command = values.get("command", np.full(T.size, 0.5))
        is_controlled = has_temperature & np.isfinite(values["T_set"]) & (command > 0.01) & (command < 0.99)
        checks.append((("T_sup", "T_set"), is_controlled, np.abs(T - values["T_set"]), 15.0))
    if "T_a_in" in values and "T_w_in" in values:
        T_air, T_water = values["T_a_in"], values["T_w_in"]
        outside_by = np.maximum(T - np.maximum(T_air, T_water), np.minimum(T_air, T_water) - T)
        checks.append((("T_sup", "T_a_in", "T_w_in"), has_temperature, outside_by, 10.0))
    problems, warnings = list(_find_heat_problems(log)), []
    for names, where, deviation, limit in checks:
        if where.any() and np.median(deviation[where]) > limit:  # K
            typical = ", ".join(f"{name} {np.median(values[name][where]):.3g}" for name in names)
            statement = f"{log.name}: {typical} degC, as they typically are, do not agree: check "
            pair = T[where], values[names[1]][where]
            # come together if one is in °F instead of °C, or the reverse
            if len(names) > 2 or any(np.median(np.abs(a - 32.0 - 1.8 * b)) < 10.0 for a, b in (pair, pair[::-1])):  # °F
                problems.append(Problem(f"{statement}their units", names[0], "unit"))
            else:
                warnings.append(f"{statement}the columns, the sensor and the valve")
    raise_problems(problems)
    return warnings


def _find_heat_problems(log: CheckedLog) -> Iterator[Problem]:
    """Find flows in wrong units: water that takes up less than the air's sensible heat, or more than its total heat."""
    if not log.values.keys() >= {"m_w", "m_a", "T_a_in", "T_w_in"}:
        return
    T, m_w, m_a, T_air, T_water = (log.values[name] for name in ("T_sup", "m_w", "m_a", "T_a_in", "T_w_in"))
    T_out = log.values.get("T_w_out", T_air)  # closer to the air it cannot come
    is_usable = (np.abs(T_air - T) > 1.0) & (np.abs(T_out - T_water) > 1.0) & (m_w * m_a > 0.0)
    if is_usable.sum() < 10:
        return
    vapour = np.maximum(log.humidity_ratio(_PRESSURE_PA) - saturation_humidity_ratio(T_water), 0.0)
    air_heat, condensation_heat = _CP_AIR * m_a * (T_air - T), 2501.0 * m_a * vapour * (T < T_air)  # kW
    water_heat = _CP_WATER * m_w * (T_out - T_water)
    low, high = (float(np.median((water_heat / heat)[is_usable])) for heat in (air_heat, air_heat + condensation_heat))
    # factors of a wrong unit; without the outlet, the water would change by a sixtieth of what it could
    if low < 1.0 / 3.0 or high > (3.0 if "T_w_out" in log.values else 60.0):
        ratio = f"{'' if 'T_w_out' in log.values else 'at most '}{low if low < 1.0 else high:.3g} times"
        flows = " and ".join(f"{name} of {np.median(log.values[name][is_usable]):.3g} kg/s" for name in ("m_w", "m_a"))
        sentence = f"{log.name}: water takes up {ratio} the heat of the air ({flows}): check the units of both flows"
        yield Problem(sentence, "m_w", "unit")


class ImpliedPI(NamedTuple):
    """The PI controller that a command implies, and the clock on which it explains the command best."""

    temperature_lag: int = 0  # samples by which the temperature is logged after the command; negative: before
    explained: float = np.nan  # of the variance of the command's changes; NaN if too few can be compared
    least_explained: float = 0.0  # share that the command's own temperature explains
    ti: float = np.nan  # s; below 0, the command moves before the temperature that it answers
    residual_correlation: float = 0.0  # correlation of what it leaves with what it leaves a window later
    unexplained_shares: Mapping[int, float] = MappingProxyType({})  # by shift of the temperature, samples

    @property
    def is_another(self) -> bool:
        """Whether the command answers another temperature, or under another law."""
        return self.explained < self.least_explained or (
            self.residual_correlation > thresholds.LARGEST_RESIDUAL_CORRELATION
            and 1.0 - self.explained > thresholds.NEGLIGIBLE_UNEXPLAINED
        )


def imply_pi(
    command: Array, temperature: Array, T_set: Array | None, good: Mask, interval: float, *, settled: bool = True,
    shifts: Sequence[int] = (),
) -> ImpliedPI:  # fmt: skip
    """Fit a PI controller to the changes of a command, and the clock shift with which it explains them best.

    Changes over two minutes are regressed on those of the error and its integral.  settled: leave out five minutes
    after each change of the set-point, which every loop on one schedule answers alike; if nothing is left, they
    stay.  Without a set-point, two such changes in a row are compared, which cancels a constant one.  The part
    explained least is left out, where the command may have been overridden, and what the resolution of the command
    explains is not counted.  shifts: of the clock to compare, samples, among them 0; up to three minutes by default.
    """
    width, usual_shift = max(1, round(120.0 / interval)), int(180.0 / interval)  # s
    shifts = shifts or range(-usual_shift, usual_shift + 1)
    largest_shift = max(shifts)
    is_compared, error = good, np.where(good, temperature - np.mean(temperature[good]), 0.0)
    if T_set is not None:
        if settled:
            is_changed = np.append(False, np.diff(T_set) != 0.0)
            is_compared = good & (np.convolve(is_changed, np.ones(int(300.0 / interval) + 1))[: good.size] <= 0.5)  # s
        error = np.where(is_compared, temperature - T_set, 0.0)
    error_integral = np.concatenate([[0.0], np.cumsum(interval * error)])
    n_before = width if T_set is None else 0
    starts = np.arange(largest_shift + n_before, max(command.size - width - largest_shift, largest_shift + n_before))
    starts = starts[is_range_good(is_compared, starts - largest_shift - n_before, starts + width + largest_shift)]
    starts = starts[is_unsaturated(command[starts + np.array([[-n_before], [0], [width]])]).all(axis=0)]

    def regressors(starts: Index) -> Array:
        integral_change = error_integral[starts + width + 1] - error_integral[starts + 1]
        return np.stack((error[starts + width] - error[starts], integral_change, np.ones(starts.size)), axis=1)

    command_change = command[starts + width] - command[starts]
    command_change -= command[starts] - command[starts - n_before]  # 0 with a set-point
    if starts.size < LEAST_PI_ROWS or not np.any(command_change):
        if T_set is None or not settled:
            return ImpliedPI()
        pi = imply_pi(command, temperature, T_set, good, interval, settled=False, shifts=shifts)
        if pi.explained >= pi.least_explained:
            return pi
        return ImpliedPI(pi.temperature_lag, unexplained_shares=pi.unexplained_shares)  # its clock alone
    # variance of a change, of its rounding alone
    rounding_variance = min(float(np.diff(np.unique(command[is_compared])).min()), 0.02) ** 2 / 6.0
    unexplained_shares, ti, correlations = {}, {}, {}
    for shift in sorted(shifts, key=abs):
        shifted_starts = starts + shift
        X = regressors(shifted_starts) - regressors(shifted_starts - width) if n_before else regressors(shifted_starts)
        is_inlier = np.ones(shifted_starts.size, dtype=bool)
        for _ in range(3):
            coefficients = np.linalg.lstsq(X[is_inlier], command_change[is_inlier], rcond=None)[0]
            residual = command_change - X @ coefficients
            is_inlier = np.abs(residual) <= np.quantile(np.abs(residual), 0.8 if n_before else 0.9)
        variance = float(np.sum((command_change[is_inlier] - command_change.mean()) ** 2))
        unexplained_sum = max(float(np.sum(residual[is_inlier] ** 2)) - rounding_variance * is_inlier.sum(), 0.0)
        unexplained_shares[shift] = unexplained_sum / max(variance, 1e-300)
        ti[shift] = float(coefficients[0] / coefficients[1])
        is_window_apart = shifted_starts[width:] - shifted_starts[:-width] == width
        inlier_residual = np.where(is_inlier, residual, 0.0)
        lagged_product = float(inlier_residual[width:][is_window_apart] @ inlier_residual[:-width][is_window_apart])
        correlations[shift] = lagged_product / max(float(inlier_residual @ inlier_residual), 1e-300)
    best_shift = min(unexplained_shares, key=lambda shift: unexplained_shares[shift])
    shift = best_shift if 2.0 * unexplained_shares[best_shift] < unexplained_shares[0] else 0
    most_unexplained = max(thresholds.MOST_UNEXPLAINED, thresholds.MOST_UNEXPLAINED_PER_SECOND * interval)
    least_explained = 1.0 - most_unexplained - (thresholds.MOST_UNEXPLAINED if n_before else 0.0)
    explained = 1.0 - unexplained_shares[shift]
    return ImpliedPI(shift, explained, least_explained, ti[shift], correlations[shift], unexplained_shares)


def plausible_lags(
    days: Iterable[tuple[Array, Array, Array | None, Mask]], interval: float, assumed: float
) -> tuple[list[float], bool]:
    """Return up to two other lags of the temperature, s, with which a PI explains the commands of all days about best.

    Also return whether the ``assumed`` lag is as good.  days: the first four arguments of ``imply_pi``.
    """
    step = max(1, round(60.0 / interval))
    shifts = np.arange(-int(900.0 / interval / step), int(900.0 / interval / step) + 1) * step
    implied = [imply_pi(*day, interval=interval, shifts=shifts.tolist()).unexplained_shares for day in days]
    shares = np.array([[by_shift[shift] for shift in shifts.tolist()] for by_shift in implied if by_shift])
    if not shares.size:
        return [], True
    mean, lags = shares.mean(axis=0), shifts * interval
    by_share = [k for k in np.argsort(mean) if mean[k] <= thresholds.LARGEST_LAG_RATIO * mean.min()]
    others = [float(lags[k]) for k in by_share if abs(lags[k] - assumed) >= 0.5 * step * interval]
    return others[:2], len(others) < len(by_share)

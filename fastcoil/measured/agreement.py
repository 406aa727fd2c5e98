"""Whether the columns of a log agree: temperatures of one air stream in one unit, a command that answers them."""

from __future__ import annotations

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs import Log
from fastcoil.measured.fitted_plant import regressed_pi

_FROM_SET_POINT, _OUTSIDE = 15.0, 10.0
"""K by which T_sup may typically lie off T_set with the valve in control, and outside of entering air and water."""
_MOVES, _STANDS = 0.5, 0.05
"""A set-point that changes at more than the first share of the samples, beside a temperature that changes at less than
the second, is that temperature."""
_HOT = 45.0  # °C; no cooling coil delivers such air, few heating coils do
_OVER, _LATEST = 120.0, 30.0  # s
LEAST_ANSWERED = 0.9
"""Share of the command's changes over two minutes that a PI of the temperature explains, at the best of delays to 30 s.
Of 66 simulated loops whose gap is claimed two have less; of those with another loop's temperature 2 % have more."""


def require_agreement(log: Log) -> None:
    """Refuse a log whose temperatures cannot be of one air stream in one unit, or are in each other's columns."""
    problems, T = [], log.values["T_sup"]
    known = np.isfinite(T) & (log.values.get("enabled", np.ones(T.size)) != 0.0)
    T_set, command = log.values.get("T_set"), log.values.get("command", np.full(T.size, 0.5))
    if T_set is not None:
        controlled = known & np.isfinite(T_set) & (command > 0.01) & (command < 0.99)
        if controlled.any():
            here, wanted = (float(np.median(series[controlled])) for series in (T, T_set))
            if np.median(np.abs(T - T_set)[controlled]) > _FROM_SET_POINT:
                problems.append(
                    f"T_sup is typically {here:.3g} degC and T_set {wanted:.3g} degC with the valve in control: check "
                    "the units of both"
                )
        both = known & np.isfinite(T_set)
        stands, moves = (np.mean(np.diff(series[both]) != 0.0) if both.sum() > 1 else 0.0 for series in (T, T_set))
        if moves > _MOVES and stands < _STANDS:
            problems.append(
                f"T_set changes at {100 * moves:.0f} % of the samples and T_sup at {100 * stands:.0f} %: if the two "
                "are swapped, say which is which (columns, --column), else log T_sup to 0.1 K"
            )
    if "T_a_in" in log.values and "T_w_in" in log.values and known.any():
        of_air, of_water = log.values["T_a_in"], log.values["T_w_in"]
        outside = np.maximum(T - np.maximum(of_air, of_water), np.minimum(of_air, of_water) - T)
        if np.median(outside[known]) > _OUTSIDE:
            here, air, water = (float(np.median(series[known])) for series in (T, of_air, of_water))
            problems.append(
                f"T_sup is typically {here:.3g} degC, with air entering at {air:.3g} and water at {water:.3g} degC: "
                "check their units"
            )
    if problems:
        raise InputError([f"{log.name}: {problem}" for problem in problems])


def note_of_heat(log: Log, kp: float) -> list[str]:
    """Refuse air that no cooling coil delivers, and note such air of another loop: both may be in degF.

    kp: of the controller that was recovered, above 0 for cooling; NaN if there is none.
    """
    typical = float(np.nanmedian(log.values["T_sup"]))
    if typical < _HOT:
        return []
    cure = "if it is logged in degF, declare that: units={'T_sup': 'degF'}, --unit T_sup=degF"
    if kp > 0.0:
        raise InputError(f"{log.name}: T_sup is typically {typical:.3g} degC in a cooling loop: {cure}")
    return [f"T_sup is typically {typical:.3g} degC: {cure}"]


def answered(command: Array, temperature: Array, T_set: Array, good: Mask, interval: float) -> float:
    """Share of the command's changes over two minutes that a PI of the temperature explains; 1 if there are too few."""
    width = max(1, round(_OVER / interval))
    error = np.where(good, temperature - T_set, 0.0)
    total = np.concatenate([[0.0], np.cumsum(interval * error)])
    bad = np.concatenate([[0], np.cumsum(~good)])
    shares = []
    for lag in range(int(_LATEST / interval) + 1):
        first = np.arange(lag, command.size - width)
        first = first[bad[first + width + 1] == bad[first - lag]]
        integral = total[first - lag + width + 1] - total[first - lag + 1]
        fit = regressed_pi(command, np.roll(error, lag), first, first + width, integral)
        shares += [] if fit is None else [fit.explained]
    return max(shares, default=1.0)

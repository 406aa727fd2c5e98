"""Whether the columns of a log agree: temperatures of one air stream in one unit, a command that answers them."""

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs import Log
from fastcoil.measured.fitted_plant import regressed_pi

_FROM_SET_POINT, _OUTSIDE = 15.0, 10.0
"""K by which T_sup may typically lie off T_set with the valve in control, and outside of entering air and water."""
_OVER, _LATEST = 120.0, 30.0  # s
LEAST_ANSWERED = 0.9
"""Share of the command's changes over two minutes that a PI of the temperature explains, at the best of delays to 30 s.
Of 66 simulated loops whose gap is claimed two have less; of those with another loop's temperature 2 % have more."""


def require_agreement(log: Log) -> None:
    """Refuse a log whose temperatures cannot be of one air stream."""
    values, T = log.values, log.values["T_sup"]
    known = np.isfinite(T) & (values.get("enabled", np.ones(T.size)) != 0.0)
    checks: list[tuple[tuple[str, ...], Mask, Array, float]] = []
    if "T_set" in values:
        command = values.get("command", np.full(T.size, 0.5))
        controlled = known & np.isfinite(values["T_set"]) & (command > 0.01) & (command < 0.99)
        checks.append((("T_sup", "T_set"), controlled, np.abs(T - values["T_set"]), _FROM_SET_POINT))
    if "T_a_in" in values and "T_w_in" in values:
        of_air, of_water = values["T_a_in"], values["T_w_in"]
        outside = np.maximum(T - np.maximum(of_air, of_water), np.minimum(of_air, of_water) - T)
        checks.append((("T_sup", "T_a_in", "T_w_in"), known, outside, _OUTSIDE))
    problems = []
    for names, here, apart, most in checks:
        if here.any() and np.median(apart[here]) > most:
            typical = ", ".join(f"{name} {np.median(values[name][here]):.3g}" for name in names)
            problems.append(f"{log.name}: {typical} degC, as they typically are, do not agree: check their units")
    if problems:
        raise InputError(problems)


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

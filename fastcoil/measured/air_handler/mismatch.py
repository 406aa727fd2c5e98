"""Whether the commands of an air handler belong to its temperatures, or explain them better in another order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from fastcoil.base.arrays import Array
from fastcoil.measured.air_handler.finding import Finding, make_finding
from fastcoil.measured.air_handler.series import SIGNS, AirHandlerSeries
from fastcoil.measured.grid import running_mean

_STEP_S = 600.0  # between the values that are compared
_SMOOTHING_S = 1800.0  # of commands, as of coil and duct
_SHIFT_S = 1800.0  # between the hours that are tried
_LONGEST_SHIFT_S = 12 * 3600.0
_LEAST_EXPLAINED = 0.7  # share of the variance, of an order that fits
_LEAST_GAIN = 0.25  # of that share over the order of the log
_LEAST_EFFECT_K = 4.0  # that the coils have in that order: sensors and dampers make smaller ones


def find_mismatch(unit: AirHandlerSeries) -> Finding | None:
    """Find that temperatures follow the commands of other hours, backwards, or of exchanged headers; None otherwise.

    The change of the air over both coils is the sum of what each does, in proportion to its command; no coil does the
    reverse.  In a log in order this explains as much as in any other order, and of stuck valves nothing does.
    """
    step, width = round(_STEP_S / unit.interval) or 1, max(1, round(_SMOOTHING_S / unit.interval))
    change = unit.T_sup - 0.5 * (unit.T_entering[0] + unit.T_entering[1])
    good = unit.on & np.isfinite(change)
    change = running_mean(np.where(good, change, 0.0), good, width // 2 or 1)[::step]
    everywhere = np.ones(good.size, dtype=bool)
    commands = [running_mean(unit.command(coil), everywhere, width)[::step] for coil in unit.coils]
    good, signs = good[::step], [SIGNS[coil] for coil in unit.coils]
    if good.sum() < 2 * len(commands) + 10:
        return None
    in_order = _explained(change[good], [c[good] for c in commands], signs)[0]
    orders = {"with the headers of the valves exchanged": commands[::-1]} if len({*signs}) > 1 else {}
    shifts = np.arange(-_LONGEST_SHIFT_S, _LONGEST_SHIFT_S + 1.0, _SHIFT_S)
    for shift in shifts[np.abs(shifts) > _SHIFT_S]:
        hours = f"{abs(shift) / 3600.0:g} h {'earlier' if shift > 0.0 else 'later'}"
        samples = round(shift / (step * unit.interval))
        orders[f"of {hours}"] = [np.roll(c, samples) for c in commands]
        orders[f"in reverse, {hours}"] = [np.roll(c[::-1], samples) for c in commands]
    fits = {name: _explained(change[good], [c[good] for c in order], signs) for name, order in orders.items()}
    fits = {name: fit for name, fit in fits.items() if fit[1] >= _LEAST_EFFECT_K}
    best = max(fits, key=lambda name: fits[name][0], default="")
    if not best or fits[best][0] < max(_LEAST_EXPLAINED, in_order + _LEAST_GAIN):
        return None
    text = f"the commands {best} explain {100 * fits[best][0]:.0f} % of the changes of the air, those of the same time "
    text += f"{100 * max(in_order, 0.0):.0f} %, so no valve is accused of leaking or sticking, {{when}}"
    action = "check that all columns share one clock, and which command drives which valve"
    return make_finding(unit, "log", "mismatch", unit.on, fits[best][1], text, action)


def _explained(change: Array, commands: Sequence[Array], signs: Sequence[float]) -> tuple[float, float]:
    """Return the share of the variance that coils in proportion to commands explain, and the largest effect, K."""
    effects = [sign * command for sign, command in zip(signs, commands, strict=True)]
    ones = np.ones(change.size)
    strengths, residual = nnls(np.stack([*effects, ones, -ones], axis=1), change)
    variance = float(np.var(change))
    ranges = [strength * float(np.ptp(c)) for strength, c in zip(strengths, commands, strict=False)]
    return (1.0 - residual**2 / change.size / variance if variance > 0.0 else 0.0), max(ranges)

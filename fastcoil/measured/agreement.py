"""Whether the columns of a log agree: temperatures of one air stream in one unit, a command that answers them."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fastcoil.base.arguments import refuse
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs import Log
from fastcoil.measured.fitted_plant import EDGE, LEAST_PI_ROWS
from fastcoil.measured.grid import all_good
from fastcoil.model.moist_air import saturation_humidity_ratio
from fastcoil.model.parameter_table import PARAMETERS

_FROM_SET_POINT, _OUTSIDE = 15.0, 10.0
"""K by which T_sup may typically lie off T_set with the valve in control, and outside of entering air and water."""
_TOGETHER = 10.0  # °F within which temperatures come that only a wrong unit held apart
_LEAST_CHANGE, _LEAST_ROWS, _OTHER_FLOW, _FAR_TOO_MUCH = 1.0, 10, 3.0, 60.0
"""K by which air and water change where their heat is compared; rows; factors between both, of a wrong unit: the last
without the water's outlet, where it would change by a sixtieth of what it could."""
_CP_AIR, _CP_WATER, _PRESSURE = np.array([PARAMETERS[name].default for name in ("cp_a", "cp_w", "pressure")], float)
_CONDENSATION = 2501.0  # kJ/kg
_OVER, _AFTER_SET_POINT = 120.0, 300.0  # s
FARTHEST = 180.0  # s by which the clocks of two columns may differ
_USUAL, _USUAL_TWICE, _CLEARER = 0.9, 0.8, 2.0
_COARSEST = 0.02  # resolution of a command that is reckoned with, fraction of stroke
_UNANSWERED, _UNANSWERED_PER_SECOND = 0.015, 1 / 2000
"""Share of the variance of the command's changes that the PI of its own temperature leaves at most, in a fast log and
for each second between samples; so much more without a set-point.  Chosen on other valves than those of the table
``claims_misled``, which says how often other plants pass."""
_FORGOTTEN, _LITTLE = 0.25, 0.005
"""Correlation of what the PI leaves with what it leaves a window later, as that of another plant's temperature has and
noise has not; share of the variance below which it does not count."""


def require_agreement(log: Log) -> list[str]:
    """Refuse a log whose temperatures are in wrong units; return a warning for others that do not agree."""
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
    problems, warnings = list(_heat_problems(log)), []
    for names, here, apart, most in checks:
        if here.any() and np.median(apart[here]) > most:
            typical = ", ".join(f"{name} {np.median(values[name][here]):.3g}" for name in names)
            said = f"{log.name}: {typical} degC, as they typically are, do not agree: check "
            both = T[here], values[names[1]][here]
            # come together if one is in °F instead of °C, or the reverse
            pairs = (both, both[::-1])
            if len(names) > 2 or any(np.median(np.abs(a - 32.0 - 1.8 * b)) < _TOGETHER for a, b in pairs):
                problems.append(f"{said}their units")
            else:
                warnings.append(f"{said}the columns, the sensor and the valve")
    refuse(problems)
    return warnings


def _heat_problems(log: Log) -> Iterator[str]:
    """A sentence if the water carries less heat than the air by its temperature alone, or more than it can have."""
    if not log.values.keys() >= {"m_w", "m_a", "T_a_in", "T_w_in"}:
        return
    T, m_w, m_a, T_air, T_water = (log.values[name] for name in ("T_sup", "m_w", "m_a", "T_a_in", "T_w_in"))
    T_out = log.values.get("T_w_out", T_air)  # closer to the air it cannot come
    here = (np.abs(T_air - T) > _LEAST_CHANGE) & (np.abs(T_out - T_water) > _LEAST_CHANGE) & (m_w * m_a > 0.0)
    if here.sum() < _LEAST_ROWS:
        return
    vapour = np.maximum(log.humidity_ratio(_PRESSURE) - saturation_humidity_ratio(T_water), 0.0)
    of_air, condensed = _CP_AIR * m_a * (T_air - T), _CONDENSATION * m_a * vapour * (T < T_air)
    of_water = _CP_WATER * m_w * (T_out - T_water)
    low, high = (float(np.median((of_water / most)[here])) for most in (of_air, of_air + condensed))
    if low < 1.0 / _OTHER_FLOW or high > (_OTHER_FLOW if "T_w_out" in log.values else _FAR_TOO_MUCH):
        ratio = f"{'' if 'T_w_out' in log.values else 'at most '}{low if low < 1.0 else high:.3g} times"
        flows = " and ".join(f"{name} of {np.median(log.values[name][here]):.3g} kg/s" for name in ("m_w", "m_a"))
        yield f"{log.name}: water takes up {ratio} the heat of the air ({flows}): check the units of both flows"


class Law(NamedTuple):
    """The PI that a command implies: how much of the command it explains, and the clock on which it does so."""

    late: int = 0  # samples by which the temperature stands late beside the command; negative: early
    share: float = np.nan  # of the variance of the command's changes; NaN if too few can be compared
    least: float = 0.0  # share that the command's own temperature explains
    ti: float = np.nan  # s; below 0, the command moves before the temperature that it answers
    memory: float = 0.0  # correlation of what it leaves with what it leaves a window later

    @property
    def is_another(self) -> bool:
        """Whether the command answers another temperature, or under another law."""
        return self.share < self.least or (self.memory > _FORGOTTEN and 1.0 - self.share > _LITTLE)


def implied_law(
    command: Array, temperature: Array, T_set: Array | None, good: Mask, interval: float, *, settled: bool = True
) -> Law:
    """How well a PI of the temperature explains the command, at the shift of the clock that explains it best.

    Changes over two minutes are regressed on those of the error and its integral.  settled: whether a while after each
    change of the set-point is left out, which every loop of one schedule answers alike; not if nothing is left then.
    Without a set-point two such changes in a row are compared, from which one that stands still falls out.  The least
    explained part is left out, where the command was overridden, and what the resolution of the command explains is
    not missed.
    """
    width, farthest = max(1, round(_OVER / interval)), int(FARTHEST / interval)
    compared, error = good, np.where(good, temperature - np.mean(temperature[good]), 0.0)
    if T_set is not None:
        if settled:
            changed = np.append(False, np.diff(T_set) != 0.0)
            shortly_after = np.convolve(changed, np.ones(int(_AFTER_SET_POINT / interval) + 1))[: good.size] > 0.5
            compared = good & ~shortly_after
        error = np.where(compared, temperature - T_set, 0.0)
    total = np.concatenate([[0.0], np.cumsum(interval * error)])
    before = width if T_set is None else 0
    first = np.arange(farthest + before, max(command.size - width - farthest, farthest + before))
    first = first[all_good(compared, first - farthest - before, first + width + farthest)]
    ends = np.stack([command[first - before], command[first], command[first + width]])
    first = first[(ends.min(axis=0) > EDGE) & (ends.max(axis=0) < 1.0 - EDGE)]

    def changes(at: Index) -> Array:
        columns = error[at + width] - error[at], total[at + width + 1] - total[at + 1], np.ones(at.size)
        return np.stack(columns, axis=1)

    moved = command[first + width] - command[first]
    if before:
        moved = moved - (command[first] - command[first - width])
    if first.size < LEAST_PI_ROWS or not np.any(moved):
        if T_set is None or not settled:
            return Law()
        at_all = implied_law(command, temperature, T_set, good, interval, settled=False)
        return at_all if at_all.share >= at_all.least else Law()
    values = np.diff(np.unique(command[compared]))
    rounding = min(float(values.min()), _COARSEST) ** 2 / 6.0  # variance of a change, of its rounding alone
    left, ti, memory = {}, {}, {}
    for late in sorted(range(-farthest, farthest + 1), key=abs):
        at = first + late
        X = changes(at) - changes(at - width) if before else changes(at)
        usual = np.ones(at.size, dtype=bool)
        for _ in range(3):
            solved = np.linalg.lstsq(X[usual], moved[usual], rcond=None)[0]
            rest = moved - X @ solved
            usual = np.abs(rest) <= np.quantile(np.abs(rest), _USUAL_TWICE if before else _USUAL)
        variance = float(np.sum((moved[usual] - moved.mean()) ** 2))
        unexplained = max(float(np.sum(rest[usual] ** 2)) - rounding * usual.sum(), 0.0)
        left[late], ti[late] = unexplained / max(variance, 1e-300), float(solved[0] / solved[1])
        a_window = at[width:] - at[:-width] == width
        of_usual = np.where(usual, rest, 0.0)
        again = float(of_usual[width:][a_window] @ of_usual[:-width][a_window])
        memory[late] = again / max(float(of_usual @ of_usual), 1e-300)
    best = min(left, key=lambda late: left[late])
    late = best if _CLEARER * left[best] < left[0] else 0
    least = 1.0 - max(_UNANSWERED, _UNANSWERED_PER_SECOND * interval) - (_UNANSWERED if before else 0.0)
    return Law(late, 1.0 - left[late], least, ti[late], memory[late])

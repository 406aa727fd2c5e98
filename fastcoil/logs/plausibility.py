"""Whether columns can be in the units that they declare: each by its numbers, and together by physics.

A unit that header and caller both declare is trusted.
"""

import math
from collections.abc import Collection, Mapping

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.logs.series import AIR_FLOW, COLUMNS, FRACTION, HUMIDITIES, HUMIDITY_RATIO, TRAVEL, WATER_FLOW
from fastcoil.model import moist_air

_AIR = ("T_sup", "T_set")
_TEMPERATURES = (*_AIR, "T_a_in", "T_w_in")
_COLDEST, _WARMEST = 2.0, 45.0  # medians of air at a coil, degC
_HOTTEST_WATER = 95.0  # median, degC
_HOT_WATER = 5.0  # by which water is warmer than air that it heats, K
_OFF_SET = 12.0  # by which the medians of temperature and set-point differ at most, K
_OUTSIDE = 4.0  # by which supply air lies outside entering air and water: sensors, fan, K
_LEAST_OF_F, _MOST_OF_C, _MOST_OF_WATER = 32.0, 45.0, 100.0  # numbers of °F; of °C
_FEWEST_VALUES, _LEAST_TRAVEL = 5, 0.2  # of a command that is a fraction, and not a valve that leaks
_LEAST_G = 0.1  # g/kg
_LEAST_AIR, _LEAST_WATER = 0.002, 0.001  # largest flow of a log, kg/s; less is none of a coil
_UNIT_JUMP, _UNIT_MATCH, _UNIT_ROWS = 25.0, 3.0, 10  # K, K, rows on either side: where °C goes over to °F
_SLACK_DEW_POINT, _SLACK_W, _LOWEST_PRESSURE = 1.0, 1.05, 75e3
"""A reading so far above saturation, K and a share, at a pressure up in the mountains, Pa, is none of air."""
_AT_LIMIT = 0.01  # of the travel
_SIGNALS = {"V": (0.0, 10.0), "V 2-10": (2.0, 10.0), "mA 4-20": (4.0, 20.0)}
"""The ends of signals to a valve, in their own units."""
_NEAR_END, _BEYOND, _AT_END, _BETWEEN = 0.12, 0.05, 3, 20
"""Shares of a signal's span; readings at each end, and different numbers in all, of what is certainly a signal."""
_SCALE_ROWS, _LEAST_SPAN, _NO_LEAP, _RARELY = 30, 0.5, 0.2, 0.3
"""Rows in another unit; shares of its full travel: what they span, the leap into it; share of other rows within it."""
_LEAP, _CROSSED = 8.0, 0.25  # by which both columns leap; share of it to which they go on with each other's numbers
_FAULT_LEAP, _FAULT_MATCH = 20.0, 5.0  # K by which readings are off those on both sides; by which these differ at most
_DRIEST = 0.12  # relative humidity of air at a coil
_FEWEST_ROWS, _MOVES, _STANDS = 50, 0.5, 0.05
"""A set-point that changes in more than one share of the rows, while the temperature does in less than the other."""


def misread_units(values: Mapping[str, Array], units: Mapping[str, str], trusted: Collection[str]) -> dict[str, str]:
    """The unit, by name, that columns seem to be in, if not the declared one; ``trusted`` ones are not questioned."""
    found = {}
    for name, one in values.items():
        family = COLUMNS[name].units
        scale, offset = family[units[name]]
        numbers = (one[np.isfinite(one)] - offset) / scale
        if name in trusted or not numbers.size or scale == 1.0:
            continue
        top = float(numbers.max())
        is_fraction = family in (FRACTION, TRAVEL) and 0.0 < top <= 1.0
        signal, is_certain = signal_of(numbers, units[name]) if family is TRAVEL else ("", False)
        moves = top > _LEAST_TRAVEL and np.unique(numbers).size >= _FEWEST_VALUES
        if family is HUMIDITY_RATIO and 0.0 < top < _LEAST_G:
            found[name] = "kg/kg"
        elif family in (AIR_FLOW, WATER_FLOW) and 0.0 < scale * top < (_LEAST_AIR if name == "m_a" else _LEAST_WATER):
            found[name] = "kg/s"
        elif is_fraction and (name == "RH_a_in" or moves):
            found[name] = "1"
        elif is_certain:
            found[name] = signal
    if units.get("T_dp_in") == "degF" and "T_dp_in" not in trusted and "T_a_in" in values:
        T, T_dp = (float(np.nanmedian(values[name])) for name in ("T_a_in", "T_dp_in"))
        vapour, of_C = moist_air.saturation_pressure([T_dp, 1.8 * T_dp + 32.0]) / moist_air.saturation_pressure(T)
        if vapour < _DRIEST < of_C <= 1.0:
            found["T_dp_in"] = "degC"
    on = _in_control(values)
    medians = {}
    for name in _TEMPERATURES:
        if name in values and (known := values[name][on][np.isfinite(values[name][on])]).size:
            scale, offset = COLUMNS[name].units[units[name]]
            medians[name] = (float(np.median(known)) - offset) / scale
    return found | _misread_temperatures(medians, units, trusted)


def _in_control(values: Mapping[str, Array]) -> Mask | slice:
    """Where the loop is in operation, its valve between the limits, (n,); everywhere if that is nowhere or unknown."""
    sizes = {one.size for one in values.values()}
    if len(sizes) > 1 or "command" not in values:
        return slice(None)
    good = np.abs(values["command"] - 0.5) < 0.5 - _AT_LIMIT
    if "enabled" in values:
        good &= values["enabled"] != 0.0
    return good if good.any() else slice(None)


def _misread_temperatures(
    medians: Mapping[str, float], units: Mapping[str, str], trusted: Collection[str]
) -> dict[str, str]:
    """The unit by name with which the median numbers of temperatures contradict nothing, if they do as declared."""
    others = {}
    for name, number in medians.items():
        if units[name] == "degC" and number >= _LEAST_OF_F and name not in trusted:
            others[name] = "degF"
        most = _MOST_OF_WATER if name == "T_w_in" else _MOST_OF_C
        if units[name] == "degF" and number <= most and name not in trusted:
            others[name] = "degC"

    def contradicts(changed: Mapping[str, str]) -> bool:
        scales = {name: COLUMNS[name].units[changed.get(name, units[name])] for name in medians}
        return _is_contradictory({name: scale * medians[name] + offset for name, (scale, offset) in scales.items()})

    if not others or not contradicts({}):
        return {}
    trials = [others] * (others.keys() == medians.keys()) + [{name: unit} for name, unit in others.items()]
    return next((trial for trial in trials if not contradicts(trial)), {})


def _is_contradictory(T: Mapping[str, float]) -> bool:
    """Whether median temperatures [degC] contradict each other, or are none of a coil."""
    air = [T[name] for name in _AIR if name in T]
    warmest = 100.0 if air and T.get("T_w_in", -math.inf) >= max(air) + _HOT_WATER else _WARMEST
    if any(not _COLDEST <= one <= warmest for one in air):
        return True
    if T.get("T_a_in", 0.0) > _WARMEST or T.get("T_w_in", 0.0) > _HOTTEST_WATER:
        return True
    if len(air) == 2 and abs(air[0] - air[1]) > _OFF_SET:
        return True
    if not T.keys() >= {"T_a_in", "T_w_in"}:
        return False
    low, high = sorted((T["T_a_in"], T["T_w_in"]))
    if "T_sup" not in T:  # set-points above both stand for days on which nothing is cooled
        return T.get("T_set", low) < low - _OUTSIDE
    return not low - _OUTSIDE <= T["T_sup"] <= high + _OUTSIDE


def exchanged_with_supply(values: Mapping[str, Array]) -> str:
    """The entering temperature that seems exchanged with ``T_sup``, which is outside both; blank if none does."""
    on, names = _in_control(values), ("T_sup", "T_w_in", "T_a_in")
    if not all(name in values and np.isfinite(values[name][on]).any() for name in names):
        return ""
    T = {name: float(np.nanmedian(values[name][on])) for name in names}
    trials = [name for name in names[1:] if not _is_contradictory(T | {"T_sup": T[name], name: T["T_sup"]})]
    return trials[0] if trials and _is_contradictory(T) else ""


def row_of_new_unit(T: Array) -> int:
    """Index from which an air temperature [degC] goes on in °F instead of °C, or the reverse; 0 if nowhere."""
    for k in (np.flatnonzero(np.abs(np.diff(T)) > _UNIT_JUMP) + 1).tolist()[:_UNIT_ROWS]:
        sides = T[max(k - _UNIT_ROWS, 0) : k], T[k : k + _UNIT_ROWS]
        low, high = sorted(float(np.nanmedian(side)) for side in sides)
        if abs(1.8 * low + 32.0 - high) < _UNIT_MATCH:
            return k
    return 0


def signal_of(numbers: Array, unit: str) -> tuple[str, bool]:
    """The signal that a command seems to be, since it spans that; blank if none; and whether that is certain."""
    for name, (closed, full) in _SIGNALS.items() if unit in ("V", "deg", *FRACTION) and numbers.size else ():
        x = (numbers - closed) / (full - closed)
        if name != unit and all(-_BEYOND <= end <= _NEAR_END for end in (x.min(), 1.0 - x.max())):
            stops = min(np.sum(x == 0.0), np.sum(x == 1.0))
            return name, bool(unit != "V" and stops >= _AT_END and np.unique(x).size >= _BETWEEN)
    return "", False


def row_of_new_scale(percent: Array) -> int:
    """Index from which a command [%] goes on as a fraction or in V, or the reverse; 0 if nowhere."""
    for full, step in ((1.0, 1), (10.0, 1), (1.0, -1), (10.0, -1)):
        one = percent[::step]
        k = int(np.max(np.flatnonzero(one > full), initial=-1)) + 1
        small, last = one[k:], one[k - 1]
        if k and small.size >= _SCALE_ROWS and last >= 2.0 * full and np.mean(one[:k] <= full) <= _RARELY:
            goes_on = abs(small[0] - last * full / 100.0) < _NO_LEAP * full
            if goes_on and np.min(small) > 0.0 and np.ptp(small) >= _LEAST_SPAN * full:
                return k if step > 0 else percent.size - k
    return 0


def row_of_exchange(T: Array, command: Array) -> int:
    """Index from which a temperature goes on with the numbers of the command, and the reverse; 0 if nowhere."""
    (old, new), (old_command, new_command) = ((one[:-1], one[1:]) for one in (T, command))
    leap = np.minimum(np.abs(new - old), np.abs(new_command - old_command))
    off = np.maximum(np.abs(new - old_command), np.abs(new_command - old))
    return int(np.argmax(np.append(False, (leap > _LEAP) & (off < _CROSSED * leap))))


def sensor_faults(T: Array) -> Mask:
    """Where a temperature [degC] leaps away and back, in one reading or in several of one number."""
    known = np.isfinite(T)
    run = np.cumsum(np.diff(T[known], prepend=np.inf) != 0.0) - 1
    level = T[known][np.unique(run, return_index=True)[1]]
    leaps = np.abs(np.diff(level)) > _FAULT_LEAP
    is_back = leaps[1:] & leaps[:-1] & (np.abs(level[2:] - level[:-2]) < _FAULT_MATCH)
    faulty = np.zeros(T.size, dtype=bool)
    faulty[known] = np.isin(run, np.flatnonzero(is_back) + 1)
    return faulty


def looks_like(unit: str) -> str:
    """The end of a sentence on numbers that are in another unit than the declared one."""
    return f"its numbers look like {'a fraction' if unit == '1' else unit}"


def above_saturation(values: Mapping[str, Array | float]) -> tuple[str, Mask]:
    """The humidity beside ``T_a_in``, and where it is clearly above saturation, (n,) or (); blank without both."""
    name = next((one for one in HUMIDITIES if one in values), "RH_a_in")
    if name == "RH_a_in" or "T_a_in" not in values:
        return "", np.zeros(0, dtype=bool)
    T, humidity = np.asarray(values["T_a_in"]), np.asarray(values[name])
    with np.errstate(all="ignore"):
        if name == "T_dp_in":
            return name, np.asarray(humidity > T + _SLACK_DEW_POINT)
        most = moist_air.humidity_ratio(np.clip(T, -40.0, 60.0), 1.0, _LOWEST_PRESSURE)
        return name, np.asarray(humidity > _SLACK_W * most)


def are_exchanged(T_sup: Array, T_set: Array) -> bool:
    """Whether the temperature stands like a set-point while the set-point moves like a temperature."""
    both = np.isfinite(T_sup) & np.isfinite(T_set)
    if both.sum() < _FEWEST_ROWS:
        return False
    moves = [float(np.mean(np.diff(series[both]) != 0.0)) for series in (T_sup, T_set)]
    return moves[0] < _STANDS and moves[1] > _MOVES

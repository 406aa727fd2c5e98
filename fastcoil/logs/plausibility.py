"""Whether columns can be in the units that they declare: each by its numbers, and together by physics.

A unit that header and caller both declare is trusted.  The limits are wide: a log that breaks one is not of a coil, or
not in that unit.  tests/logs/test_plausibility.py has a log of each kind that they must tell from a sound one.
"""

import math
from collections.abc import Collection, Mapping

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.logs.series import AIR_FLOW, COLUMNS, FRACTION, HUMIDITY_COLUMNS, HUMIDITY_RATIO, TRAVEL, WATER_FLOW
from fastcoil.model import moist_air

_AIR_TEMPERATURES = ("T_sup", "T_set")
_MAX_AIR_CELSIUS = 45.0  # median of air at a coil, and number from which a temperature may be in °F
_SUPPLY_AIR_TOLERANCE_K = 4.0  # by which supply air lies outside entering air and water: sensors, fan
_SIGNAL_ENDS = {"V": (0.0, 10.0), "V 2-10": (2.0, 10.0), "mA 4-20": (4.0, 20.0)}
"""Values of a signal to a valve for closed and open, by its unit."""


def find_misread_units(
    values: Mapping[str, Array], units: Mapping[str, str], trusted: Collection[str]
) -> dict[str, str]:
    """Return the likely unit of each column whose numbers contradict the declared one, but for ``trusted`` ones."""
    likely_units = {}
    for name, converted in values.items():
        family = COLUMNS[name].units
        scale, offset = family[units[name]]
        numbers = (converted[np.isfinite(converted)] - offset) / scale
        if name in trusted or not numbers.size or scale == 1.0:
            continue
        largest = float(numbers.max())
        is_fraction = family in (FRACTION, TRAVEL) and 0.0 < largest <= 1.0
        signal, is_certain = detect_signal(numbers, units[name]) if family is TRAVEL else ("", False)
        least_flow = {"m_a": 0.002, "m_w": 0.001}.get(name, 0.0)  # kg/s; less is the largest flow of no coil
        if family is HUMIDITY_RATIO and 0.0 < largest < 0.1:  # g/kg
            likely_units[name] = "kg/kg"
        elif family in (AIR_FLOW, WATER_FLOW) and 0.0 < scale * largest < least_flow:
            likely_units[name] = "kg/s"
        # few numbers, or only small ones, are those of a valve that stays nearly closed
        elif is_fraction and (name == "RH_a_in" or (largest > 0.2 and np.unique(numbers).size >= 5)):
            likely_units[name] = "1"
        elif is_certain:
            likely_units[name] = signal
    if units.get("T_dp_in") == "degF" and "T_dp_in" not in trusted and "T_a_in" in values:
        T, T_dp = (float(np.nanmedian(values[name])) for name in ("T_a_in", "T_dp_in"))
        pressures = moist_air.saturation_pressure([T_dp, 1.8 * T_dp + 32.0])
        humidity_if_degF, humidity_if_degC = pressures / moist_air.saturation_pressure(T)
        if humidity_if_degF < 0.12 < humidity_if_degC <= 1.0:  # relative humidity of the driest air at a coil
            likely_units["T_dp_in"] = "degC"
    is_in_control = _control_mask(values)
    medians = {}
    for name in (*_AIR_TEMPERATURES, "T_a_in", "T_w_in"):
        if name in values and (finite := values[name][is_in_control][np.isfinite(values[name][is_in_control])]).size:
            scale, offset = COLUMNS[name].units[units[name]]
            medians[name] = (float(np.median(finite)) - offset) / scale
    return likely_units | _find_misread_temperatures(medians, units, trusted)


def _control_mask(values: Mapping[str, Array]) -> Mask | slice:
    """Return where the loop is on and its valve between the ends, (n,); everywhere if that is nowhere or unknown."""
    if len({series.size for series in values.values()}) > 1 or "command" not in values:
        return slice(None)
    is_in_control = np.abs(values["command"] - 0.5) < 0.49
    if "enabled" in values:
        is_in_control &= values["enabled"] != 0.0
    return is_in_control if is_in_control.any() else slice(None)


def _find_misread_temperatures(
    medians: Mapping[str, float], units: Mapping[str, str], trusted: Collection[str]
) -> dict[str, str]:
    """Return other units by name with which the median temperatures agree; none if they agree as declared."""
    other_units = {}
    for name, number in medians.items():
        if units[name] == "degC" and number >= 32.0 and name not in trusted:
            other_units[name] = "degF"
        largest = 100.0 if name == "T_w_in" else _MAX_AIR_CELSIUS
        if units[name] == "degF" and number <= largest and name not in trusted:
            other_units[name] = "degC"

    def contradicts(changed_units: Mapping[str, str]) -> bool:
        scales = {name: COLUMNS[name].units[changed_units.get(name, units[name])] for name in medians}
        return _is_contradictory({name: scale * medians[name] + offset for name, (scale, offset) in scales.items()})

    if not other_units or not contradicts({}):
        return {}
    trials = [other_units] * (other_units.keys() == medians.keys())
    trials += [{name: unit} for name, unit in other_units.items()]
    return next((trial for trial in trials if not contradicts(trial)), {})


def _is_contradictory(T: Mapping[str, float]) -> bool:
    """Whether median temperatures [degC] contradict each other, or are impossible at a coil."""
    air_temperatures = [T[name] for name in _AIR_TEMPERATURES if name in T]
    is_heating = bool(air_temperatures) and T.get("T_w_in", -math.inf) >= max(air_temperatures) + 5.0
    if any(not 2.0 <= temperature <= (100.0 if is_heating else _MAX_AIR_CELSIUS) for temperature in air_temperatures):
        return True
    if T.get("T_a_in", 0.0) > _MAX_AIR_CELSIUS or T.get("T_w_in", 0.0) > 95.0:
        return True
    if len(air_temperatures) == 2 and abs(air_temperatures[0] - air_temperatures[1]) > 12.0:
        return True
    if not T.keys() >= {"T_a_in", "T_w_in"}:
        return False
    low, high = sorted((T["T_a_in"], T["T_w_in"]))
    if "T_sup" not in T:  # set-points above both stand for days on which nothing is cooled
        return T.get("T_set", low) < low - _SUPPLY_AIR_TOLERANCE_K
    return not low - _SUPPLY_AIR_TOLERANCE_K <= T["T_sup"] <= high + _SUPPLY_AIR_TOLERANCE_K


def find_unit_change(T: Array) -> int:
    """Find the index from which an air temperature [degC] goes on in °F instead of °C, or the reverse; 0 if nowhere."""
    for k in (np.flatnonzero(np.abs(np.diff(T)) > 25.0) + 1).tolist()[:10]:
        low, high = sorted(float(np.nanmedian(side)) for side in (T[max(k - 10, 0) : k], T[k : k + 10]))
        if abs(1.8 * low + 32.0 - high) < 3.0:
            return k
    return 0


def detect_signal(numbers: Array, unit: str) -> tuple[str, bool]:
    """Return the unit of a signal that a command spans from end to end, or blank; and whether that is certain."""
    for name, (closed, opened) in _SIGNAL_ENDS.items() if unit in ("V", "deg", *FRACTION) and numbers.size else ():
        x = (numbers - closed) / (opened - closed)
        if name != unit and all(-0.05 <= end <= 0.12 for end in (x.min(), 1.0 - x.max())):
            n_at_end = min(np.sum(x == 0.0), np.sum(x == 1.0))
            return name, bool(unit != "V" and n_at_end >= 3 and np.unique(x).size >= 20)
    return "", False


def find_scale_change(percent: Array) -> int:
    """Find the index from which a command [%] goes on as a fraction or in V, or the reverse; 0 if nowhere."""
    for full_travel, step in ((1.0, 1), (10.0, 1), (1.0, -1), (10.0, -1)):
        ordered_percent = percent[::step]
        k = int(np.max(np.flatnonzero(ordered_percent > full_travel), initial=-1)) + 1
        other_scale, last_percent = ordered_percent[k:], ordered_percent[k - 1]
        if not k or other_scale.size < 30 or last_percent < 2.0 * full_travel:
            continue
        has_few_small = np.mean(ordered_percent[:k] <= full_travel) <= 0.3
        is_continuous = abs(other_scale[0] - last_percent * full_travel / 100.0) < 0.2 * full_travel
        has_travel = np.min(other_scale) > 0.0 and np.ptp(other_scale) >= 0.5 * full_travel
        if has_few_small and is_continuous and has_travel:
            return k if step > 0 else percent.size - k
    return 0


def find_sensor_faults(T: Array) -> Mask:
    """Find where a temperature [degC] leaps by 20 K and back to within 5 K, in one reading or several of one number."""
    is_finite = np.isfinite(T)
    run_number = np.cumsum(np.diff(T[is_finite], prepend=np.inf) != 0.0) - 1
    run_values = T[is_finite][np.unique(run_number, return_index=True)[1]]
    is_jump = np.abs(np.diff(run_values)) > 20.0
    is_back = is_jump[1:] & is_jump[:-1] & (np.abs(run_values[2:] - run_values[:-2]) < 5.0)
    is_faulty = np.zeros(T.size, dtype=bool)
    is_faulty[is_finite] = np.isin(run_number, np.flatnonzero(is_back) + 1)
    return is_faulty


def describe_likely_unit(unit: str) -> str:
    """Return the clause that numbers look like another unit than the declared one."""
    return f"its numbers look like {'a fraction' if unit == '1' else unit}"


def find_supersaturation(values: Mapping[str, Array | float]) -> tuple[str, Mask]:
    """Return the name of the logged humidity, and where it is above saturation, (n,) or (); blank without one.

    Clearly above it: by more than 1 K of dew point, or 5 % of the humidity ratio at a pressure up in the mountains.
    """
    name = next((column for column in HUMIDITY_COLUMNS if column in values), "RH_a_in")
    if name == "RH_a_in" or "T_a_in" not in values:
        return "", np.zeros(0, dtype=bool)
    T, humidity = np.asarray(values["T_a_in"]), np.asarray(values[name])
    with np.errstate(all="ignore"):
        if name == "T_dp_in":
            return name, np.asarray(humidity > T + 1.0)
        return name, np.asarray(humidity > 1.05 * moist_air.humidity_ratio(np.clip(T, -70.0, 60.0), 1.0, 75e3))


def is_set_point_exchanged(T_sup: Array, T_set: Array) -> bool:
    """Whether supply temperature and set-point seem exchanged: the first hardly ever changes, the second mostly."""
    is_finite = np.isfinite(T_sup) & np.isfinite(T_set)
    T_sup_changes, T_set_changes = (np.diff(series[is_finite]) != 0.0 for series in (T_sup, T_set))
    return bool(is_finite.sum() >= 50 and np.mean(T_sup_changes) < 0.05 and np.mean(T_set_changes) > 0.5)

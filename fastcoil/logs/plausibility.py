"""Whether columns can be in the units that they declare: each by its numbers, and together by physics.

A unit that header and caller both declare is trusted.
"""

import math
from collections.abc import Collection, Mapping

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.logs.series import AIR_FLOW, COLUMNS, FRACTION, HUMIDITY_COLUMNS, HUMIDITY_RATIO, TRAVEL, WATER_FLOW
from fastcoil.model import moist_air

_AIR_TEMPERATURES = ("T_sup", "T_set")
_TEMPERATURES = (*_AIR_TEMPERATURES, "T_a_in", "T_w_in")
_MIN_AIR_CELSIUS, _MAX_AIR_CELSIUS = 2.0, 45.0  # medians of air at a coil, degC
_MAX_WATER_CELSIUS = 95.0  # median, degC
_HEATING_WATER_EXCESS_K = 5.0  # by which water is warmer than air that it heats, K
_MAX_SET_POINT_OFFSET_K = 12.0  # by which the medians of temperature and set-point differ at most, K
_SUPPLY_AIR_TOLERANCE_K = 4.0  # by which supply air lies outside entering air and water: sensors, fan, K
_MIN_FAHRENHEIT_NUMBER, _MAX_AIR_CELSIUS_NUMBER, _MAX_WATER_CELSIUS_NUMBER = 32.0, 45.0, 100.0  # numbers of °F; of °C
_MIN_COMMAND_VALUES, _MIN_COMMAND_FRACTION = 5, 0.2  # of a command that is a fraction, and not a valve that leaks
_MIN_HUMIDITY_G_PER_KG = 0.1  # g/kg
_MIN_AIR_FLOW_KG_S, _MIN_WATER_FLOW_KG_S = 0.002, 0.001  # largest flow of a log, kg/s; less is none of a coil
_UNIT_CHANGE_JUMP_K, _UNIT_CHANGE_TOLERANCE_K, _UNIT_CHANGE_ROWS = (
    25.0,
    3.0,
    10,
)  # K, K, rows on either side: where °C goes over to °F
_DEW_POINT_TOLERANCE_K, _HUMIDITY_RATIO_TOLERANCE, _MIN_PRESSURE_PA = 1.0, 1.05, 75e3
"""A reading so far above saturation, K and a share, at a pressure up in the mountains, Pa, is none of air."""
_TRAVEL_END_SHARE = 0.01  # of the travel
_SIGNAL_ENDS = {"V": (0.0, 10.0), "V 2-10": (2.0, 10.0), "mA 4-20": (4.0, 20.0)}
"""The ends of signals to a valve, in their own units."""
_SIGNAL_END_TOLERANCE, _SIGNAL_OVERSHOOT, _MIN_READINGS_AT_SIGNAL_END, _MIN_DIFFERENT_SIGNAL_NUMBERS = 0.12, 0.05, 3, 20
"""Shares of a signal's span; readings at each end, and different numbers in all, of what is certainly a signal."""
_MIN_ROWS_IN_OTHER_SCALE, _MIN_SPAN_IN_OTHER_SCALE, _MAX_JUMP_INTO_OTHER_SCALE, _MAX_SHARE_BEFORE_OTHER_SCALE = (
    30,
    0.5,
    0.2,
    0.3,
)
"""Rows in another unit; shares of its full travel: what they span, the leap into it; share of other rows within it."""
_MIN_EXCHANGE_JUMP, _EXCHANGE_MATCH_SHARE = (
    8.0,
    0.25,
)  # by which both columns leap; share of it to which they go on with each other's numbers
_MIN_SENSOR_FAULT_JUMP_K, _MAX_SENSOR_FAULT_DRIFT_K = (
    20.0,
    5.0,
)  # K by which readings are off those on both sides; by which these differ at most
_MIN_RELATIVE_HUMIDITY = 0.12  # relative humidity of air at a coil
_MIN_EXCHANGE_ROWS, _MIN_MOVING_SHARE, _MAX_CONSTANT_SHARE = 50, 0.5, 0.05
"""A set-point that changes in more than one share of the rows, while the temperature does in less than the other."""


def find_misread_units(
    values: Mapping[str, Array], units: Mapping[str, str], trusted: Collection[str]
) -> dict[str, str]:
    """The unit, by name, that columns seem to be in, if not the declared one; ``trusted`` ones are not questioned."""
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
        has_travel = largest > _MIN_COMMAND_FRACTION and np.unique(numbers).size >= _MIN_COMMAND_VALUES
        if family is HUMIDITY_RATIO and 0.0 < largest < _MIN_HUMIDITY_G_PER_KG:
            likely_units[name] = "kg/kg"
        elif family in (AIR_FLOW, WATER_FLOW) and 0.0 < scale * largest < (
            _MIN_AIR_FLOW_KG_S if name == "m_a" else _MIN_WATER_FLOW_KG_S
        ):
            likely_units[name] = "kg/s"
        elif is_fraction and (name == "RH_a_in" or has_travel):
            likely_units[name] = "1"
        elif is_certain:
            likely_units[name] = signal
    if units.get("T_dp_in") == "degF" and "T_dp_in" not in trusted and "T_a_in" in values:
        T, T_dp = (float(np.nanmedian(values[name])) for name in ("T_a_in", "T_dp_in"))
        humidity_if_degF, humidity_if_degC = moist_air.saturation_pressure(
            [T_dp, 1.8 * T_dp + 32.0]
        ) / moist_air.saturation_pressure(T)
        if humidity_if_degF < _MIN_RELATIVE_HUMIDITY < humidity_if_degC <= 1.0:
            likely_units["T_dp_in"] = "degC"
    in_control = _control_mask(values)
    medians = {}
    for name in _TEMPERATURES:
        if name in values and (finite := values[name][in_control][np.isfinite(values[name][in_control])]).size:
            scale, offset = COLUMNS[name].units[units[name]]
            medians[name] = (float(np.median(finite)) - offset) / scale
    return likely_units | _find_misread_temperatures(medians, units, trusted)


def _control_mask(values: Mapping[str, Array]) -> Mask | slice:
    """Where the loop is in operation, its valve between the limits, (n,); everywhere if that is nowhere or unknown."""
    sizes = {series.size for series in values.values()}
    if len(sizes) > 1 or "command" not in values:
        return slice(None)
    in_control = np.abs(values["command"] - 0.5) < 0.5 - _TRAVEL_END_SHARE
    if "enabled" in values:
        in_control &= values["enabled"] != 0.0
    return in_control if in_control.any() else slice(None)


def _find_misread_temperatures(
    medians: Mapping[str, float], units: Mapping[str, str], trusted: Collection[str]
) -> dict[str, str]:
    """The unit by name with which the median numbers of temperatures contradict nothing, if they do as declared."""
    other_units = {}
    for name, number in medians.items():
        if units[name] == "degC" and number >= _MIN_FAHRENHEIT_NUMBER and name not in trusted:
            other_units[name] = "degF"
        max_celsius = _MAX_WATER_CELSIUS_NUMBER if name == "T_w_in" else _MAX_AIR_CELSIUS_NUMBER
        if units[name] == "degF" and number <= max_celsius and name not in trusted:
            other_units[name] = "degC"

    def contradicts(changed_units: Mapping[str, str]) -> bool:
        scales = {name: COLUMNS[name].units[changed_units.get(name, units[name])] for name in medians}
        return _is_contradictory({name: scale * medians[name] + offset for name, (scale, offset) in scales.items()})

    if not other_units or not contradicts({}):
        return {}
    trials = [other_units] * (other_units.keys() == medians.keys()) + [
        {name: unit} for name, unit in other_units.items()
    ]
    return next((trial for trial in trials if not contradicts(trial)), {})


def _is_contradictory(T: Mapping[str, float]) -> bool:
    """Whether median temperatures [degC] contradict each other, or are none of a coil."""
    air = [T[name] for name in _AIR_TEMPERATURES if name in T]
    warmest = 100.0 if air and T.get("T_w_in", -math.inf) >= max(air) + _HEATING_WATER_EXCESS_K else _MAX_AIR_CELSIUS
    if any(not _MIN_AIR_CELSIUS <= temperature <= warmest for temperature in air):
        return True
    if T.get("T_a_in", 0.0) > _MAX_AIR_CELSIUS or T.get("T_w_in", 0.0) > _MAX_WATER_CELSIUS:
        return True
    if len(air) == 2 and abs(air[0] - air[1]) > _MAX_SET_POINT_OFFSET_K:
        return True
    if not T.keys() >= {"T_a_in", "T_w_in"}:
        return False
    low, high = sorted((T["T_a_in"], T["T_w_in"]))
    if "T_sup" not in T:  # set-points above both stand for days on which nothing is cooled
        return T.get("T_set", low) < low - _SUPPLY_AIR_TOLERANCE_K
    return not low - _SUPPLY_AIR_TOLERANCE_K <= T["T_sup"] <= high + _SUPPLY_AIR_TOLERANCE_K


def find_column_exchanged_with_supply(values: Mapping[str, Array]) -> str:
    """The entering temperature that seems exchanged with ``T_sup``, which is outside both; blank if none does."""
    in_control, names = _control_mask(values), ("T_sup", "T_w_in", "T_a_in")
    if not all(name in values and np.isfinite(values[name][in_control]).any() for name in names):
        return ""
    T = {name: float(np.nanmedian(values[name][in_control])) for name in names}
    trials = [name for name in names[1:] if not _is_contradictory(T | {"T_sup": T[name], name: T["T_sup"]})]
    return trials[0] if trials and _is_contradictory(T) else ""


def find_unit_change(T: Array) -> int:
    """Index from which an air temperature [degC] goes on in °F instead of °C, or the reverse; 0 if nowhere."""
    for k in (np.flatnonzero(np.abs(np.diff(T)) > _UNIT_CHANGE_JUMP_K) + 1).tolist()[:_UNIT_CHANGE_ROWS]:
        sides = T[max(k - _UNIT_CHANGE_ROWS, 0) : k], T[k : k + _UNIT_CHANGE_ROWS]
        low, high = sorted(float(np.nanmedian(side)) for side in sides)
        if abs(1.8 * low + 32.0 - high) < _UNIT_CHANGE_TOLERANCE_K:
            return k
    return 0


def detect_signal(numbers: Array, unit: str) -> tuple[str, bool]:
    """The signal that a command seems to be, since it spans that; blank if none; and whether that is certain."""
    for name, (closed, opened) in _SIGNAL_ENDS.items() if unit in ("V", "deg", *FRACTION) and numbers.size else ():
        x = (numbers - closed) / (opened - closed)
        if name != unit and all(-_SIGNAL_OVERSHOOT <= end <= _SIGNAL_END_TOLERANCE for end in (x.min(), 1.0 - x.max())):
            n_at_end = min(np.sum(x == 0.0), np.sum(x == 1.0))
            return name, bool(
                unit != "V"
                and n_at_end >= _MIN_READINGS_AT_SIGNAL_END
                and np.unique(x).size >= _MIN_DIFFERENT_SIGNAL_NUMBERS
            )
    return "", False


def find_scale_change(percent: Array) -> int:
    """Index from which a command [%] goes on as a fraction or in V, or the reverse; 0 if nowhere."""
    for full_travel, step in ((1.0, 1), (10.0, 1), (1.0, -1), (10.0, -1)):
        directed = percent[::step]
        k = int(np.max(np.flatnonzero(directed > full_travel), initial=-1)) + 1
        other_scale, last_percent = directed[k:], directed[k - 1]
        if (
            k
            and other_scale.size >= _MIN_ROWS_IN_OTHER_SCALE
            and last_percent >= 2.0 * full_travel
            and np.mean(directed[:k] <= full_travel) <= _MAX_SHARE_BEFORE_OTHER_SCALE
        ):
            is_continuous = (
                abs(other_scale[0] - last_percent * full_travel / 100.0) < _MAX_JUMP_INTO_OTHER_SCALE * full_travel
            )
            if (
                is_continuous
                and np.min(other_scale) > 0.0
                and np.ptp(other_scale) >= _MIN_SPAN_IN_OTHER_SCALE * full_travel
            ):
                return k if step > 0 else percent.size - k
    return 0


def find_column_exchange(T: Array, command: Array) -> int:
    """Index from which a temperature goes on with the numbers of the command, and the reverse; 0 if nowhere."""
    (T_before, T_after), (command_before, command_after) = ((series[:-1], series[1:]) for series in (T, command))
    jump = np.minimum(np.abs(T_after - T_before), np.abs(command_after - command_before))
    mismatch = np.maximum(np.abs(T_after - command_before), np.abs(command_after - T_before))
    return int(np.argmax(np.append(False, (jump > _MIN_EXCHANGE_JUMP) & (mismatch < _EXCHANGE_MATCH_SHARE * jump))))


def find_sensor_faults(T: Array) -> Mask:
    """Where a temperature [degC] leaps away and back, in one reading or in several of one number."""
    finite = np.isfinite(T)
    run_number = np.cumsum(np.diff(T[finite], prepend=np.inf) != 0.0) - 1
    level = T[finite][np.unique(run_number, return_index=True)[1]]
    is_jump = np.abs(np.diff(level)) > _MIN_SENSOR_FAULT_JUMP_K
    is_back = is_jump[1:] & is_jump[:-1] & (np.abs(level[2:] - level[:-2]) < _MAX_SENSOR_FAULT_DRIFT_K)
    faulty = np.zeros(T.size, dtype=bool)
    faulty[finite] = np.isin(run_number, np.flatnonzero(is_back) + 1)
    return faulty


def describe_likely_unit(unit: str) -> str:
    """The end of a sentence on numbers that are in another unit than the declared one."""
    return f"its numbers look like {'a fraction' if unit == '1' else unit}"


def find_supersaturation(values: Mapping[str, Array | float]) -> tuple[str, Mask]:
    """The humidity beside ``T_a_in``, and where it is clearly above saturation, (n,) or (); blank without both."""
    name = next((column for column in HUMIDITY_COLUMNS if column in values), "RH_a_in")
    if name == "RH_a_in" or "T_a_in" not in values:
        return "", np.zeros(0, dtype=bool)
    T, humidity = np.asarray(values["T_a_in"]), np.asarray(values[name])
    with np.errstate(all="ignore"):
        if name == "T_dp_in":
            return name, np.asarray(humidity > T + _DEW_POINT_TOLERANCE_K)
        max_humidity_ratio = moist_air.humidity_ratio(np.clip(T, -40.0, 60.0), 1.0, _MIN_PRESSURE_PA)
        return name, np.asarray(humidity > _HUMIDITY_RATIO_TOLERANCE * max_humidity_ratio)


def is_set_point_exchanged(T_sup: Array, T_set: Array) -> bool:
    """Whether the temperature stands like a set-point while the set-point moves like a temperature."""
    is_finite = np.isfinite(T_sup) & np.isfinite(T_set)
    if is_finite.sum() < _MIN_EXCHANGE_ROWS:
        return False
    change_shares = [float(np.mean(np.diff(series[is_finite]) != 0.0)) for series in (T_sup, T_set)]
    return change_shares[0] < _MAX_CONSTANT_SHARE and change_shares[1] > _MIN_MOVING_SHARE

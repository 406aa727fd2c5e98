"""Write the signals of an air handler as a log of a building system: headers, units, resolution, rows that lack."""

from __future__ import annotations

import numpy as np
import pandas as pd

NAMES = ("T_sup", "T_set", "T_set_cooling", "T_set_heating", "T_mixed", "T_out", "T_return", "m_a", "cooling_command",
         "heating_command", "damper", "enabled", "occupied")  # fmt: skip
HEADERS = {
    "Datetime": (
        "AHU: Supply Air Temperature", "AHU: Supply Air Temperature Set Point",
        "AHU: Supply Air Temperature Cooling Set Point", "AHU: Supply Air Temperature Heating Set Point",
        "AHU: Mixed Air Temperature", "AHU: Outdoor Air Temperature", "AHU: Return Air Temperature",
        "AHU: Supply Air Flow", "AHU: Cooling Coil Valve Control Signal", "AHU: Heating Coil Valve Control Signal",
        "AHU: Outdoor Air Damper Control Signal", "AHU: Supply Air Fan Status", "Occupancy Mode Indicator",
    ),
    "Timestamp": (
        "AHU1 Discharge Air Temp", "AHU1 Discharge Air Temp Setpoint", "AHU1 Discharge Air Temp Cooling Setpoint",
        "AHU1 Discharge Air Temp Heating Setpoint", "AHU1 Mixed Air Temp", "Outside Air Temp", "AHU1 Return Air Temp",
        "AHU1 Supply Air Flow", "AHU1 Cooling Valve Command", "AHU1 Heating Valve Command",
        "AHU1 Outside Air Damper Command", "AHU1 Supply Fan Status", "AHU1 Occupied",
    ),
    "Time": (
        "AHU-3.SA-T", "AHU-3.SA-T-SP", "AHU-3.SA-T-CLG-SP", "AHU-3.SA-T-HTG-SP", "AHU-3.MA-T", "AHU-3.OA-T",
        "AHU-3.RA-T", "AHU-3.SA-FLOW", "AHU-3.CHW-VLV", "AHU-3.HW-VLV", "AHU-3.OA-DMPR", "AHU-3.SF-STS", "AHU-3.OCC",
    ),
}  # fmt: skip
"""Headers of ``NAMES`` by that of the time stamps, which each building system writes its way."""


def write_log(s: pd.DataFrame, seed: int, *, has_one_set_point: bool) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return a log of signals, and its headers by our names.

    s: signals with ``T_reading`` and ``T_mixed_reading``, °C.  Some logs have no air flow; in some, rows lack.
    """
    rng = np.random.default_rng([seed, 4])
    time = list(HEADERS)[rng.integers(len(HEADERS))]
    headers = dict(zip(NAMES, HEADERS[time], strict=True))
    is_fahrenheit, resolution, scale = rng.uniform() < 0.5, rng.choice([0.01, 0.05, 0.1]), rng.choice([0.1, 1.0])
    left_out = {"T_set_cooling", "T_set_heating"} if has_one_set_point else {"T_set"}
    left_out |= {"m_a"} if rng.uniform() < 0.4 else set()
    offsets = {name: rng.normal(0.0, 0.5) for name in ("T_out", "T_return")}
    values = s.assign(T_sup=s.T_reading, T_mixed=s.T_mixed_reading, T_set=s.T_set_cooling)
    log, columns = pd.DataFrame({time: s.index.strftime("%Y-%m-%d %H:%M")}), {}
    for name in (name for name in NAMES if name not in left_out):
        x, unit = values[name].to_numpy() + offsets.get(name, 0.0), ""
        if name.startswith("T_"):
            x, unit = (1.8 * x + 32.0, " [°F]") if is_fahrenheit else (x, " [°C]")
            x = ((x / resolution).round() * resolution).round(2)
        elif name in ("cooling_command", "heating_command", "damper"):
            x, unit = ((100.0 * x / scale).round() * scale).round(1), " [%]"
        elif name == "m_a":
            x, unit = x.round(3), " [kg/s]"
        else:
            x = x.astype(int)
        columns[name] = headers[name] + unit
        log[columns[name]] = x
    is_lost = rng.uniform(size=len(log)) < rng.choice([0.0, 0.001])
    return log[~is_lost].reset_index(drop=True), columns

"""Made-up logs of an air handler: a still plant whose coils change the air in proportion to their openings."""

import numpy as np
import pandas as pd

HEADERS = {
    "T_sup": "AHU-3 Supply Air Temp", "T_mixed": "AHU-3 Mixed Air Temp", "T_return": "AHU-3 Return Air Temp",
    "T_out": "AHU-3 OA Temp", "T_set": "AHU-3 SAT Setpoint", "cooling_command": "AHU-3 CHW Valve",
    "heating_command": "AHU-3 HHW Valve", "enabled": "AHU-3 SF Status", "occupied": "AHU-3 Occ",
    "fan_speed": "AHU-3 SF Speed",
}  # fmt: skip
COOLING_K, HEATING_K = -14.0, 18.0  # change of the air by a coil wide open


def make_unit_log(days=1.0, cooling=0.0, heating=0.0, leak=(0.0, 0.0), noise=0.03, start="2026-03-02", **series):
    """A row a minute: commands, the air that leaves with them, and any series, of arrays or functions of hours.

    leak: least opening of the cooling and of the heating valve, whatever the command; or functions of hours.
    """
    hours = np.arange(round(days * 1440)) / 60.0

    def along(signal):
        return np.broadcast_to(signal(hours) if callable(signal) else signal, hours.shape).astype(float)

    commands = {"cooling_command": along(cooling), "heating_command": along(heating)}
    openings = [np.maximum(c, along(least)) for c, least in zip(commands.values(), leak, strict=True)]
    draws = np.random.default_rng(1).normal(0.0, noise, (2, hours.size))
    T_mixed = along(series.pop("T_mixed", 18.0)) + draws[0]
    T_sup = T_mixed + COOLING_K * openings[0] + HEATING_K * openings[1] + draws[1]
    values = {"T_sup": T_sup, "T_mixed": T_mixed, **commands, **series}
    frame = pd.DataFrame({HEADERS.get(name, name): along(signal) for name, signal in values.items()})
    frame.insert(0, "Timestamp", pd.Timestamp(start) + pd.to_timedelta(60 * np.arange(hours.size), "s"))
    return frame


def kinds_of(unit):
    """Component and kind of each finding."""
    return [(finding.component, finding.kind) for finding in unit.findings]

"""What of a controller clashes: parameters that need one another, and a dead band that no set-point leaves."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fastcoil.arrays import Array
from fastcoil.parameter_table import PARAMETERS
from fastcoil.simulation.loop import Loop

ONE_SET_POINT = 1.0
"""Set-points that lie closer together than this count as one, K: a record of a constant one drifts and has steps."""


def control_problems(loop: Loop, T_set: Array) -> list[str]:
    """One sentence for each clash.  T_set: all the set-points that the loop will see, °C."""
    return _buffer_problems(loop) + _compensation_problems(loop) + _dead_band_problems(loop, T_set)


def _buffer_problems(loop: Loop) -> list[str]:
    problems = []
    ratio, swing = xr.DataArray(loop["buffer_ratio"]), xr.DataArray(loop["buffer_swing"])
    measures = xr.DataArray(loop["buffer_noise"]) == "measured"
    for name, is_on in (("buffer_noise = 'measured'", measures), ("buffer_swing", swing > 0.0)):
        if bool(is_on.any()) and not bool((is_on & (ratio > 0.0)).any()):
            problems.append(f"{name} without buffer_ratio: give buffer_ratio, or leave {name.split()[0]} out")
    gain = loop["plant_gain"]
    if gain is None and bool((swing > 0.0).any()):
        problems.append("buffer_swing without plant_gain: give plant_gain, by which the swing limits the buffer")
    if not problems:
        buffer = (ratio * abs(xr.DataArray(loop["kp"])) * xr.DataArray(loop["noise_std"])).where(~measures, 0.0)
        if gain is not None:
            highest = xr.DataArray(swing / xr.DataArray(gain))
            buffer = buffer.where((swing == 0.0) | (buffer < highest), highest)
        largest = float(buffer.max())
        if largest >= 1.0:
            problems.append(f"buffer_ratio × kp × noise_std reaches {largest:g}: a buffer must stay below 1, lower one")
    return problems


def _compensation_problems(loop: Loop) -> list[str]:
    changed = bool(np.any(np.asarray(loop["smooth_rate"]) != PARAMETERS["smooth_rate"].default))
    if changed and not _has(loop, "compensation", "smooth"):
        return ["smooth_rate without compensation = 'smooth': give that word, or leave smooth_rate out"]
    return []


def _dead_band_problems(loop: Loop, T_set: Array) -> list[str]:
    """Refuse a dead band in which every change of the set-point would be too small to act on."""
    widest = float(np.max(np.asarray(loop["error_dead_band"])))
    width = float(np.max(T_set) - np.min(T_set))
    if ONE_SET_POINT <= width <= widest:
        return [
            f"error_dead_band = {widest:g} K: the set-points lie within {width:g} K, so none of their changes would "
            "move the valve, give less"
        ]
    return []


def _has(loop: Loop, name: str, word: str) -> bool:
    return bool(np.any(np.asarray(loop[name]) == word))

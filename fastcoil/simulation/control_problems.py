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
    ratio, swing = loop["buffer_ratio"], loop["buffer_swing"]
    measures = _has(loop, "buffer_noise", "measured")
    if ratio is None and measures:
        problems.append("buffer_noise = 'measured' without buffer_ratio: give buffer_ratio, or leave buffer_noise out")
    if ratio is None and swing is not None:
        problems.append("buffer_swing without buffer_ratio: give buffer_ratio, or leave buffer_swing out")
    if swing is not None and loop["plant_gain"] is None:
        problems.append("buffer_swing without plant_gain: give plant_gain, by which the swing limits the buffer")
    if ratio is not None and not problems:
        buffer = xr.DataArray(ratio) * abs(xr.DataArray(loop["kp"])) * xr.DataArray(loop["noise_std"])
        if swing is not None:
            highest = xr.DataArray(swing) / xr.DataArray(loop["plant_gain"])
            buffer = buffer.where(buffer < highest, highest)
        largest = float(buffer.where(xr.DataArray(loop["buffer_noise"]) == "given", 0.0).max())
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

"""Warnings of loops and days that do not suit each other, when a run is planned; nothing is refused.

Each is right whatever the coil: it rests on the bounds that entering air and water set to the supply air, or on gains
that nobody chose for heating.
"""

from __future__ import annotations

import warnings

import numpy as np

from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop, words_used
from fastcoil.loops.presets import COOLING

FAR = 35.0
"""Water that much warmer than the air, K, changes it at least twice as much per stroke as chilled water does."""


def tell_doubts(loop: Loop, boundary: Boundary, *, closed: bool = True) -> None:
    """Warn where loop and days do not suit each other.  closed: the controller is on, its action and gains count."""
    for doubt in _doubts(loop, boundary) if closed else ():
        warnings.warn(doubt, stacklevel=5)


def _doubts(loop: Loop, boundary: Boundary) -> list[str]:
    """What does not suit, a sentence each."""
    actions = np.unique(np.asarray(loop["action"]))
    turns = bool(np.any(np.asarray(loop["kp"]) < 0.0))
    if turns or words_used(loop, "law") != {"pi"}:  # what the action then means is the user's own business
        return []
    found = []
    (w_low, w_high), (a_low, a_high), (low, high) = (boundary.extremes[n] for n in ("T_w_in", "T_a_in", "T_set"))
    if "heating" in actions and w_high < a_low:
        found.append(
            f"action = 'heating', but the water (up to {w_high:.3g} degC) is never warmer than the air (from "
            f"{a_low:.3g} degC): opening the valve cools; give action = 'cooling', or days of heating"
        )
    elif "heating" in actions and max(w_high, a_high) < low:
        found.append(
            f"T_set is {low:.3g} degC or more, water and air {max(w_high, a_high):.3g} degC at most: no opening warms "
            "the air that far; lower T_set, or give warmer water"
        )
    elif "heating" in actions and w_high - a_low > FAR:
        found += _cooling_gains(loop)
    if "cooling" in actions and w_low > a_high:
        found.append(
            f"action = 'cooling', but the water (from {w_low:.3g} degC) is never colder than the air (up to "
            f"{a_high:.3g} degC): opening the valve warms; give action = 'heating', or days of cooling"
        )
    elif "cooling" in actions and min(w_low, a_low) > high:
        found.append(
            f"T_set is {high:.3g} degC or less, water and air {min(w_low, a_low):.3g} degC at least: no opening cools "
            "the air that far; raise T_set, or give colder water"
        )
    return found


def _cooling_gains(loop: Loop) -> list[str]:
    """A sentence on gains that are those of a preset for cooling; none where they are swept."""
    kp, ti = (loop.constants.get(name) for name in ("kp", "ti"))
    for name in COOLING:
        preset = Loop.preset(name)
        if (kp, ti) == (preset["kp"], preset["ti"]):
            return [
                f"action = 'heating' with kp = {kp:g} 1/K and ti = {ti:g} s, those of the cooling coil {name}: with "
                "hot water they may ring, or be slow; begin with the preset heating or heating_45, or give other gains"
            ]
    return []

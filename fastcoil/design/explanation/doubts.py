"""Where theory cannot tell whether a loop hunts, and what it leaves out."""

from __future__ import annotations

import numpy as np

from fastcoil.design.explanation.predicted import Foretold, without_dead_band
from fastcoil.design.theory.elements import unknown
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import columns_of


def why_not_linear(loop: Loop) -> tuple[str, ...]:
    """Why theory does not hold for a single loop, a clause each; empty where it does."""
    if loop["law"] == "pi" and float(loop["kp"]) <= 0.0:  # type: ignore[arg-type]
        return (f"kp = {loop['kp']:g} does not control: a kp has to be above 0",)
    columns = columns_of(without_dead_band(loop), {}, np.zeros(1, dtype=np.int64))
    # behind the colon stands what to do about it in Python
    return tuple(reason.partition(":")[0] for reason, holds in unknown(columns).items() if holds.any())


def acts_the_wrong_way(loop: Loop, foretold: Foretold) -> tuple[str, ...]:
    """Where no opening does what the loop opens its valve for, a clause; empty elsewhere."""
    gain = foretold.plants.gain[foretold.reached]
    heats = loop["action"] == "heating"
    if not gain.size or ((gain > 0.0) if heats else (gain < 0.0)).any():
        return ()
    does, other = ("cools", "cooling") if heats else ("warms", "heating")
    return (f"the valve acts the wrong way round: opening it {does} the air, so give action = {other}",)


def why_no_margin(foretold: Foretold) -> tuple[str, ...]:
    """Why theory has no margin at any operating point, a clause."""
    if not foretold.plants.reachable.any():
        return ("no set-point of the day can be held: the valve is at its end all the time",)
    return ("its compensation crosses the gap too slowly to count as an inverse",)


def left_out(loop: Loop, foretold: Foretold) -> tuple[str, ...]:
    """What the margin does not see, a clause each."""
    found = []
    if float(loop["error_dead_band"]) > 0.0:  # type: ignore[arg-type]
        band = f"the error dead band of {loop['error_dead_band']:g} K"
        found.append(f"{band}, which may hold a loop still that is foretold to hunt, or make another hunt")
    n, missed = foretold.points.size, int(np.count_nonzero(~foretold.plants.reachable))
    if missed:
        found.append(
            f"{missed} of {n} operating points, at which the valve is at its end and cannot hold the set-point"
        )
    return tuple(found)

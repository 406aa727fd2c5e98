"""Where a linear model with a describing function cannot tell whether a loop hunts, and what it leaves out."""

from __future__ import annotations

import numpy as np

from fastcoil.explanation.foretold import Foretold
from fastcoil.simulation.loop import Loop, words_used

_LEFT_OUT = {
    "error_dead_band": "the error dead band may hold a loop still that is foretold to hunt, or make another hunt",
    "command_resolution": "steps of the command may keep up a swing of their own",
    "sensor_resolution": "steps of the measured temperature may keep up a swing of their own",
}
"""Parameters that the margin does not see where they are above 0."""


def why_not_linear(loop: Loop) -> tuple[str, ...]:
    """Why the theory does not hold for a single loop, a clause each; empty where it does."""
    found = []
    (law,), (estimator,) = words_used(loop, "law"), words_used(loop, "estimator")
    if law != "pi":
        found.append(f"its control law is {law}, not the PI that the theory knows")
    elif float(loop["kp"]) <= 0.0:  # type: ignore[arg-type]
        found.append(f"kp = {loop['kp']:g}: a gain above 0 closes the loop, this one does not")
    if estimator != "none" and float(loop["estimate_share"]) > 0.0:  # type: ignore[arg-type]
        found.append(f"the estimator {estimator} changes the inverse while the loop runs")
    if float(loop["slip_jump"]) > 0.0:  # type: ignore[arg-type]
        found.append("the stem sticks and slips, and the theory knows only backlash")
    return tuple(found)


def why_no_margin(foretold: Foretold) -> tuple[str, ...]:
    """Why theory has no margin at any operating point, a clause."""
    if not foretold.plants.reachable.any():
        return ("no set-point of the day can be held: the valve is at its end all the time",)
    return ("its compensation crosses the gap too slowly to count as an inverse",)


def left_out(loop: Loop, foretold: Foretold) -> tuple[str, ...]:
    """What the margin does not see, a clause each."""
    found = [f"{text} ({name} = {loop[name]:g})" for name, text in _LEFT_OUT.items() if float(loop[name]) > 0.0]  # type: ignore[arg-type]
    n, missed = foretold.points.size, int(np.count_nonzero(~foretold.plants.reachable))
    if missed:
        found.append(f"at {missed} of {n} operating points the valve is at its end and cannot hold the set-point")
    return tuple(found)

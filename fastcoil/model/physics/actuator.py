"""The motor between the controller and the gearbox: input resolution, stroke time and neutral zone.

The paper's actuator has none of them (0 = off); real ones take 30 to 150 s for a stroke.
"""

from __future__ import annotations

from fastcoil.model.numerics.jit import scalar
from fastcoil.model.physics.sensor import quantised


@scalar
def accepted(command, resolution):
    """Command as the actuator's input sees it, fraction of stroke, at most 1."""
    target = quantised(command, resolution)
    return 1.0 if target > 1.0 else target


@scalar
def motor(position, target, max_travel):
    """Motor position one step on: ``target``, or as near as ``max_travel`` (inf: no limit) lets it come."""
    low, high = position - max_travel, position + max_travel
    reached = low if target < low else target
    return high if reached > high else reached


@scalar
def driven(position, target, max_travel, neutral_zone, runs):
    """Motor position one step on, and whether the motor still runs, with a neutral zone around the target.

    A motor at rest starts where the target is further away than ``neutral_zone`` (fraction of stroke), and then runs
    until it reaches the target.  0: it follows every target.
    """
    runs |= abs(target - position) > neutral_zone
    reached = motor(position, target, max_travel)
    reached = reached if runs else position
    return reached, runs & (reached != target)

"""A rule of the user's own, the one of ``docs/own-rule.md``: count the mode switches every quarter of an hour."""

from __future__ import annotations

from typing import NamedTuple

import fastcoil as fc


class Parameters(NamedTuple):
    """Parameters of the rule."""

    window: float = fc.parameter(900.0, unit="s", lower=60.0, text="time between two looks at the switches")
    climb: float = fc.parameter(0.005, lower=0.0, upper=0.1, text="step of the estimate")
    most: float = fc.parameter(10.0, lower=0.0, text="mode switches in a window that are not too many")


class Memory(NamedTuple):
    """What it remembers."""

    next_look: float = 0.0
    switches: float = 0.0


@fc.estimator(Parameters, Memory)
def by_count(now, p, memory):
    """Raise the estimate where switches are few, lower it where they are many."""
    if now.t < memory.next_look:
        return now.estimate, memory
    too_many = now.switches - memory.switches > p.most
    estimate = now.estimate - p.climb if too_many else now.estimate + p.climb
    return min(max(estimate, 0.0), 0.2), Memory(now.t + p.window, now.switches)

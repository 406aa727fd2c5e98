"""Loops to start from: every preset, and the one that was given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from fastcoil.base.errors import InputError
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop, words_used
from fastcoil.loops.presets import PRESETS
from fastcoil.model.metric_table import WARM_UP
from fastcoil.study.maintenance import Scenario

GIVEN = "given"
"""Name of the loop that was given, which is no preset."""
LONGEST = 24 * 3600
"""Seconds of a day that is given: more is no picture."""


class Start(NamedTuple):
    """A loop to start from.

    title: as the page names it.  day: its own; None for a preset.  T_w_in: the water that a preset is meant for, degC.
    warm_up, seed: of the study that it comes from.
    """

    title: str
    loop: Loop
    day: Boundary | None = None
    T_w_in: float = 7.0
    warm_up: int = WARM_UP
    seed: int = 0

    @property
    def heats(self) -> bool:
        """Whether it is a heating coil."""
        return bool(self.loop["action"] == "heating")


def starts(given: Scenario | None = None) -> Mapping[str, Start]:
    """Loops to start from by name: the presets, after the one that was given.

    Raises
    ------
    InputError
        If the day of that one is too long.
    """
    found = {}
    if given is not None:
        if given.boundary.n_steps > LONGEST:
            raise InputError(
                f"{given.title}: its day lasts {given.boundary.hours:g} h: give at most {LONGEST // 3600} h"
            )
        loop = _with_estimate(given.loop)
        found[GIVEN] = Start(given.title, loop, given.boundary, warm_up=given.warm_up, seed=given.seed)
    return found | {name: Start(name, Loop.preset(name), T_w_in=preset.T_w_in) for name, preset in PRESETS.items()}


def estimator_of(loop: Loop) -> str:
    """The word of a single loop's estimator."""
    (word,) = words_used(loop, "estimator")
    return word


def _with_estimate(loop: Loop) -> Loop:
    """The loop with its estimate as such: the backlash moves without it."""
    if loop["estimate_ratio"] is None:
        return loop
    return loop.assign(backlash_estimate=loop["estimate_ratio"] * loop["backlash"])  # type: ignore[operator]

"""The settings of the page: every number and word that can be moved, the loops to start from, and stories."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple
from urllib.parse import urlencode

from fastcoil.base.errors import InputError, nearest, shown
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
    """Loops to start from by name: the presets, after the one that was given."""
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


Value = float | str


class Dial(NamedTuple):
    """A number of the page.

    name: the parameter, in settings, links and files alike.  factor: from there to what is read.  steps: where the
    dial stands still; the first and the last are its limits.
    """

    name: str
    label: str
    unit: str
    steps: tuple[float, ...]
    factor: float = 1.0

    def text(self, value: float) -> str:
        """A value as the page writes it."""
        return f"{self.factor * value:.4g} {self.unit}"


class Choice(NamedTuple):
    """A word of the page, and what the page calls each of its values."""

    name: str
    label: str
    words: Mapping[str, str]


_SIZES = tuple(round(0.005 * k, 3) for k in range(31))
# fmt: off
DIALS = {
    dial.name: dial
    for dial in (
        Dial("backlash", "Gap of the valve", "% of stroke", _SIZES, 100.0),
        Dial("backlash_estimate", "Estimate of the gap", "% of stroke", _SIZES, 100.0),
        Dial("kp", "Gain Kp", "1/K",
             (0.002, 0.003, 0.004, 0.005, 0.006, 0.008, 0.01, 0.012, 0.015, 0.018, 0.02, 0.025, 0.03, 0.035, 0.04, 0.05,
              0.06, 0.07, 0.08, 0.1, 0.12, 0.15)),
        Dial("ti", "Integral time Ti", "s",
             (4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 120.0, 150.0,
              200.0, 250.0, 300.0, 400.0, 500.0, 600.0, 800.0)),
        Dial("noise_std", "Noise of the sensor", "K",
             (0.0, 0.005, 0.01, 0.02, 0.03, 0.04, 0.05, 0.075, 0.1, 0.15, 0.2)),
        Dial("stroke_time", "Motor, full stroke", "s",
             (0.0, 15.0, 30.0, 45.0, 60.0, 90.0, 120.0, 150.0, 200.0, 250.0, 300.0)),
        Dial("m_a", "Load: air flow", "kg/s", tuple(round(0.3 + 0.05 * k, 2) for k in range(25))),
    )
}
# fmt: on
CHOICES = {
    choice.name: choice
    for choice in (
        Choice(
            "valve",
            "Valve curve",
            {"own": "of the loop", "0.7": "authority 0.7", "0.3": "authority 0.3", "0.1": "authority 0.1"},
        ),
        Choice(
            "estimator",
            "Learning",
            {"none": "none", "learner": "learner", "identify": "identify", "own": "of the loop"},
        ),
        Choice("day", "Day", {"own": "of the loop", "steps": "steps", "constant": "constant", "design": "design day"}),
        Choice("axes", "Map over", {"tuning": "Kp and Ti", "size": "gap and estimate"}),
        Choice("colour", "Colour", {"rmse": "RMS error", "hunting_swing": "hunting swing"}),
        Choice("window", "Time shown", {"day": "whole day", "2h": "2 h", "half": "30 min"}),
    )
}  # fmt: skip
STEADY_LOAD = {"cooling": 1.15, "heating": 0.9}
"""Air flow of the days on which nothing happens, kg/s."""


@dataclass(frozen=True)
class Settings:
    """Where everything stands: the loop to start from, the dials, the choices."""

    loop: str
    backlash: float
    backlash_estimate: float
    kp: float
    ti: float
    noise_std: float
    stroke_time: float
    m_a: float
    valve: str = "own"
    estimator: str = "none"
    day: str = "steps"
    axes: str = "tuning"
    colour: str = "rmse"
    window: str = "2h"

    def turned(self, **values: Value) -> Settings:
        """A copy with some values changed."""
        return replace(self, **values)  # type: ignore[arg-type]

    @property
    def values(self) -> dict[str, Value]:
        """Every value by its name."""
        return asdict(self)


def settings_of(name: str, start: Start) -> Settings:
    """Settings as a loop has them."""
    loop = start.loop
    numbers = {dial: float(loop[dial]) for dial in DIALS if dial != "m_a"}  # type: ignore[arg-type]
    own = {"day": "own" if start.day is not None else "steps", "estimator": "own" if learns(start) else "none"}
    return Settings(loop=name, m_a=STEADY_LOAD[str(loop["action"])], **numbers, **own)  # type: ignore[arg-type]


def learns(start: Start) -> bool:
    """Whether a loop has an estimator of its own."""
    return estimator_of(start.loop) != "none"


def words_of(choice: Choice, start: Start) -> Mapping[str, str]:
    """The words of a choice that a loop allows."""
    without = {"day": start.day is None, "estimator": not learns(start)}.get(choice.name, False)
    return {word: text for word, text in choice.words.items() if not (without and word == "own")}


def limits_of(dial: Dial, settings: Settings) -> tuple[float, float]:
    """Least and most of a dial: its own limits, or those of the loop where it lies beyond them."""
    own = float(settings.values[dial.name])
    return min(dial.steps[0], own), max(dial.steps[-1], own)


def query_of(settings: Settings, starts: Mapping[str, Start], first: str) -> str:
    """The part of a link behind the ``?``: what differs from the loop as it is.  first: that of a link without one."""
    usual = settings_of(settings.loop, starts[settings.loop]).values
    differs = {name: value for name, value in settings.values.items() if value != usual[name]}
    differs |= {"loop": settings.loop} if settings.loop != first else {}
    return urlencode({name: f"{value:g}" if isinstance(value, float) else value for name, value in differs.items()})


def read_query(query: Mapping[str, str], starts: Mapping[str, Start], first: str) -> tuple[Settings, list[str]]:
    """The settings of a link, and a sentence for each mistake in it; what is wrong stays as the loop has it."""
    problems: list[str] = []
    name = query.get("loop", first)
    if name not in starts:
        known = ", ".join(one for one in starts if one != GIVEN)
        problems.append(f"loop = {shown(name)}: unknown{nearest(name, starts)}; choose one of {known}")
        name = first
    usual = settings_of(name, starts[name])
    values: dict[str, Value] = {}
    for key, text in query.items():
        if key == "loop":
            continue
        try:
            values[key] = _value(key, text, usual, starts[name])
        except InputError as error:
            problems += error.problems
    return usual.turned(**values), problems


def _value(name: str, text: str, usual: Settings, start: Start) -> Value:
    if name in CHOICES:
        words = words_of(CHOICES[name], start)
        if text not in words:
            raise InputError(f"{name} = {shown(text)}: choose one of {', '.join(words)}")
        return text
    if name not in DIALS:
        known = [*DIALS, *CHOICES]
        raise InputError(f"{shown(name)} is not a setting{nearest(name, known)}: leave it out")
    least, most = limits_of(DIALS[name], usual)
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not least <= number <= most:
        raise InputError(f"{name} = {shown(text)}: give a number from {least:g} to {most:g}")
    return number


ON = "paper_like"
"""The loop of all stories."""


class Story(NamedTuple):
    """Settings that show one thing: what their button says, and what differs from ``ON``."""

    title: str
    values: Mapping[str, Value]


STORIES = (
    Story("A good valve", {"backlash": 0.0}),
    Story("7 % gap, plain PI", {}),
    Story("With the inverse", {"backlash_estimate": 0.065}),
    Story("Estimate too large", {"backlash_estimate": 0.1, "window": "half"}),
    Story("Learning", {"estimator": "identify", "window": "day"}),
    Story("Slower instead", {"ti": 40.0}),
)


def settings_of_story(story: Story, starts: Mapping[str, Start]) -> Settings:
    """The settings of a story."""
    return settings_of(ON, starts[ON]).turned(**story.values)

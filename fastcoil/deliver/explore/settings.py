"""The settings of the page: every number and word that can be moved, the loops to start from, links and stories."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple
from urllib.parse import urlencode

from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop, words_used
from fastcoil.loops.presets import PRESETS
from fastcoil.model.metric_table import WARM_UP
from fastcoil.study.maintenance import Scenario

GIVEN = "given"
"""Name of the loop of a study, which is no preset."""
_LONGEST = 24 * 3600  # seconds of the day of a study; longer days are refused


class Start(NamedTuple):
    """A loop to start from.  day: that of a study; None for a preset.  T_w_in: design water of a preset, degC."""

    title: str
    loop: Loop
    day: Boundary | None = None
    T_w_in: float = 7.0
    warm_up: int = WARM_UP
    seed: int = 0

    @property
    def heats(self) -> bool:
        return bool(self.loop["action"] == "heating")


def starts(given: Scenario | None = None) -> dict[str, Start]:
    """Loops to start from by name: the one of a study, then the presets."""
    found = {}
    if given is not None:
        if given.boundary.n_steps > _LONGEST:
            raise InputError(
                f"{given.title}: its day lasts {given.boundary.hours:g} h: give at most {_LONGEST // 3600} h"
            )
        loop, ratio = given.loop, given.loop["estimate_ratio"]
        if ratio is not None:  # the gap moves without the estimate
            loop = loop.assign(backlash_estimate=ratio * loop["backlash"])  # type: ignore[operator]
        found[GIVEN] = Start(given.title, loop, given.boundary, warm_up=given.warm_up, seed=given.seed)
    return found | {name: Start(name, Loop.preset(name), T_w_in=preset.T_w_in) for name, preset in PRESETS.items()}


def estimator_of(loop: Loop) -> str:
    """The estimator of a single loop."""
    (word,) = words_used(loop, "estimator")
    return word


class Dial(NamedTuple):
    """A slider.  factor: from the parameter's unit to the one shown; steps: values in the unit of the parameter."""

    label: str
    unit: str
    steps: tuple[float, ...]
    factor: float = 1.0

    def text(self, value: float) -> str:
        """A value as the page shows it."""
        return f"{self.factor * value:.4g} {self.unit}"


class Choice(NamedTuple):
    """A menu: its label, and the text of each of its words."""

    label: str
    words: Mapping[str, str]


_SIZES = tuple(round(0.005 * k, 3) for k in range(31))
DIALS = {
    "backlash": Dial("Gap of the valve", "%", _SIZES, 100.0),
    "backlash_estimate": Dial("Estimate of the gap", "%", _SIZES, 100.0),
    "kp": Dial(
        "Gain Kp", "1/K",
        (0.002, 0.003, 0.004, 0.005, 0.006, 0.008, 0.01, 0.012, 0.015, 0.018, 0.02, 0.025, 0.03, 0.035, 0.04, 0.05,
         0.06, 0.07, 0.08, 0.1, 0.12, 0.15),
    ),
    "ti": Dial(
        "Integral time Ti", "s",
        (4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 120.0, 150.0, 200.0,
         250.0, 300.0, 400.0, 500.0, 600.0, 800.0),
    ),
    "noise_std": Dial(
        "Noise of the sensor", "K", (0.0, 0.005, 0.01, 0.02, 0.03, 0.04, 0.05, 0.075, 0.1, 0.15, 0.2)
    ),
    "stroke_time": Dial(
        "Motor, full stroke", "s", (0.0, 15.0, 30.0, 45.0, 60.0, 90.0, 120.0, 150.0, 200.0, 250.0, 300.0)
    ),
    "m_a": Dial("Load: air flow", "kg/s", tuple(round(0.3 + 0.05 * k, 2) for k in range(25))),
}  # fmt: skip
"""By parameter; ``m_a`` is of the day, all others are of the loop."""
CHOICES = {
    "valve": Choice("Valve curve", {"own": "of the loop", **{a: f"authority {a}" for a in ("0.7", "0.3", "0.1")}}),
    "estimator": Choice(
        "Learning", {"none": "none", "learner": "learner", "identify": "identify", "own": "of the loop"}
    ),
    "day": Choice("Day", {"own": "of the loop", "steps": "steps", "constant": "constant", "design": "design day"}),
    "axes": Choice("Map over", {"tuning": "Kp and Ti", "size": "gap and estimate"}),
    "colour": Choice("Colour", {"rmse": "RMS error", "hunting_swing": "hunting swing"}),
    "window": Choice("Time shown", {"day": "whole day", "2h": "2 h", "half": "30 min"}),
}  # fmt: skip
_STEADY_LOAD = {"cooling": 1.15, "heating": 0.9}  # air flow, kg/s


@dataclass(frozen=True)
class Settings:
    """The loop to start from, the positions of the dials, and the words chosen."""

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


def settings_of(name: str, start: Start) -> Settings:
    """The settings at which a loop is as it was given."""
    numbers: Any = {dial: float(start.loop[dial]) for dial in DIALS if dial != "m_a"}  # type: ignore[arg-type]
    estimator = "none" if estimator_of(start.loop) == "none" else "own"
    day = "steps" if start.day is None else "own"
    return Settings(name, m_a=_STEADY_LOAD[str(start.loop["action"])], estimator=estimator, day=day, **numbers)


def words_of(name: str, start: Start) -> dict[str, str]:
    """The words of a menu that suit a loop: "own" only where it has a day or an estimator of its own."""
    without = {"day": start.day is None, "estimator": estimator_of(start.loop) == "none"}.get(name, False)
    return {word: text for word, text in CHOICES[name].words.items() if not (without and word == "own")}


def query_of(settings: Settings, starts: Mapping[str, Start]) -> str:
    """The query of a link: the loop, and what differs from it as it was given."""
    start = starts[settings.loop]
    usual = asdict(settings_of(settings.loop, start))
    differs = {name: value for name, value in asdict(settings).items() if value != usual[name]}
    texts = {
        name: repr(value).removesuffix(".0") if isinstance(value, float) else value for name, value in differs.items()
    }
    return urlencode({"loop": start.title} | texts)


def read_query(query: Mapping[str, str], starts: Mapping[str, Start], first: str) -> tuple[Settings, list[str]]:
    """The settings of a link, and a sentence for each mistake in it; a mistaken value is ignored.

    first: the loop of a link that names none.
    """
    links = {start.title: name for name, start in starts.items()}
    asked = query.get("loop", starts[first].title)
    name = links.get(asked, first)
    usual = settings_of(name, starts[name])
    if asked not in links:
        known = f"unknown{nearest(asked, links)}; choose one of {', '.join(links)}"
        return usual, [f"loop = {shown(asked)}: {known}", f"The link is not shown, but {starts[name].title}."]
    problems: list[str] = []
    values: dict[str, Any] = {}
    for key, text in query.items():
        words = words_of(key, starts[name]) if key in CHOICES else {}
        # the loop itself may lie beyond the steps
        within = (*DIALS[key].steps, getattr(usual, key)) if key in DIALS else ()
        if text in words:
            values[key] = text
        elif within and min(within) <= _number(text) <= max(within):
            values[key] = float(text)
        elif words or within:
            cure = f"one of {', '.join(words)}" if words else f"a number from {min(within):g} to {max(within):g}"
            problems.append(f"{key} = {shown(text)}: give {cure}")
        elif key != "loop":
            problems.append(f"{shown(key)} is not a setting{nearest(key, [*DIALS, *CHOICES])}: leave it out")
    rest = ["The rest of the link is shown."] if problems else []
    if values and "loop" not in query:
        rest.append(f"The link names no loop: its values are those of {starts[name].title} here.")
    return replace(usual, **values), [*problems, *rest]


def _number(text: str) -> float:
    with suppress(ValueError):
        return float(text)
    return math.nan


STORIES: Mapping[str, Mapping[str, Any]] = {
    "A good valve": {"backlash": 0.0},
    "7 % gap, plain PI": {},
    "With the inverse": {"backlash_estimate": 0.065},
    "Estimate too large": {"backlash_estimate": 0.1, "window": "half"},
    "Learning": {"estimator": "identify", "window": "day"},
    "Slower instead": {"ti": 40.0},
}
"""Text of a button, and what it changes of the preset ``paper_like``."""


def settings_of_story(title: str, starts: Mapping[str, Start]) -> Settings:
    """The settings of a story."""
    return replace(settings_of("paper_like", starts["paper_like"]), **STORIES[title])

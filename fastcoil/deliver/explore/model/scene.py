"""From settings to a loop and a day: what is simulated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

from fastcoil.deliver.explore.model.settings import Settings
from fastcoil.deliver.explore.model.start import Start
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import W_IN, constant_day, design_day, heating_day, paper_day
from fastcoil.loops.clashes import unread_values
from fastcoil.loops.loop import Loop
from fastcoil.model.parameter_table import PARAMETERS, Scalar

_RANGEABILITY, _FLOW = 50.0, 1.7
"""An equal-percentage valve, and the flow in kg/s that the cooling coil of the presets takes."""
_LEARNING_STEP = 0.01
"""Finds a gap of 7 % in half a day."""
_SHARE = 0.95
"""Of what is identified: an estimate above the gap chatters."""
_HEATING_AIR, _HEATING_SET_POINT = 12.0, 25.0
"""degC, the means of ``heating_day``."""


_MAKERS: Mapping[str, Callable[..., Boundary]] = {
    "paper_day": paper_day,
    "heating_day": heating_day,
    "constant_day": constant_day,
    "design_day": design_day,
}


class Day(NamedTuple):
    """A day by the function of fastcoil that makes it, and its arguments."""

    maker: str
    arguments: Mapping[str, Any]


class Scene(NamedTuple):
    """A single loop on a single day."""

    loop: Loop
    day: Boundary
    warm_up: int
    seed: int


def scene_of(settings: Settings, start: Start) -> Scene:
    """The loop and the day of some settings."""
    made = day_of(settings, start)
    day = start.day if made is None else _made(made.maker, tuple(sorted(made.arguments.items())))
    assert day is not None  # "own" is offered only where there is one
    return Scene(loop_of(settings, start), day, start.warm_up, start.seed)


def loop_of(settings: Settings, start: Start) -> Loop:
    """The loop of some settings."""
    numbers: dict[str, Scalar] = {
        name: getattr(settings, name)
        for name in ("backlash", "backlash_estimate", "kp", "ti", "noise_std", "stroke_time")
    }
    loop = start.loop.assign(**numbers, **_valve(settings, start))
    if settings.estimator == "own":
        return loop
    loop = loop.assign(estimator=settings.estimator, **_learning(settings))
    return loop.assign(**{name: PARAMETERS[name].default for name in unread_values(loop)})


def _valve(settings: Settings, start: Start) -> dict[str, Scalar]:
    if settings.valve == "own":
        return {}
    own = start.loop["m_full"]
    m_full = _FLOW if own is None else float(own)  # type: ignore[arg-type]
    return {"rangeability": _RANGEABILITY, "authority": float(settings.valve), "m_full": m_full}


def _learning(settings: Settings) -> dict[str, Scalar]:
    if settings.estimator == "learner":
        return {"learning_step": _LEARNING_STEP}
    if settings.estimator == "identify":
        return {"estimate_share": _SHARE, "identify_stroke_time": settings.stroke_time}
    return {}


def day_of(settings: Settings, start: Start) -> Day | None:
    """The day of some settings; None for that of the loop."""
    if settings.day == "own":
        return None
    if settings.day == "steps":
        return Day("heating_day", {"T_w_in": start.T_w_in}) if start.heats else Day("paper_day", {})
    load = {"m_a": settings.m_a}
    if settings.day == "design":
        return Day("design_day", {"mode": "heating", "T_w_in": start.T_w_in} | load if start.heats else load)
    if start.heats:
        air = {"T_a_in": _HEATING_AIR, "W_a_in": W_IN, "T_w_in": start.T_w_in, "T_set": _HEATING_SET_POINT}
        return Day("constant_day", air | load)
    return Day("constant_day", load)


@lru_cache(maxsize=64)
def _made(maker: str, arguments: tuple[tuple[str, Any], ...]) -> Boundary:
    return _MAKERS[maker](**dict(arguments))

"""Settings in; traces, metrics, predictions and a map of the loop out.  Repeated requests cost nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.deliver.explore.settings import (
    DIALS,
    GIVEN,
    STORIES,
    Settings,
    Start,
    estimator_of,
    settings_of,
    settings_of_story,
    starts,
)
from fastcoil.design.limit_cycle import limit_cycle
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import W_IN, constant_day, design_day, heating_day, paper_day
from fastcoil.loops.clashes import unread_values
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.model.parameter_table import PARAMETERS, Scalar
from fastcoil.study.maintenance import Scenario

_RANGEABILITY, _FLOW = 50.0, 1.7
"""An equal-percentage valve, and the flow in kg/s that the cooling coil of the presets takes."""
_LEARNING_STEP = 0.01  # finds a gap of 7 % in half a day
_SHARE = 0.95  # of what is identified: an estimate above the gap chatters
_HEATING_AIR, _HEATING_SET_POINT = 12.0, 25.0  # degC, the means of ``heating_day``


_MAKERS: Mapping[str, Callable[..., Boundary]] = {
    maker.__name__: maker for maker in (paper_day, heating_day, constant_day, design_day)
}


class DayCall(NamedTuple):
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
    numbers: dict[str, Scalar] = {name: getattr(settings, name) for name in DIALS if name != "m_a"}
    loop = start.loop.assign(**numbers, **_valve(settings, start))
    if settings.estimator == "own":
        return loop
    loop = loop.assign(estimator=settings.estimator, **_learning(settings))
    unread: dict[str, Any] = {name: PARAMETERS[name].default for name in unread_values(loop)}
    return loop.assign(**unread)


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


def day_of(settings: Settings, start: Start) -> DayCall | None:
    """The day of some settings; None for that of the loop."""
    if settings.day == "own":
        return None
    if settings.day == "steps":
        return DayCall("heating_day", {"T_w_in": start.T_w_in}) if start.heats else DayCall("paper_day", {})
    load = {"m_a": settings.m_a}
    if settings.day == "design":
        return DayCall("design_day", {"mode": "heating", "T_w_in": start.T_w_in} | load if start.heats else load)
    if start.heats:
        air = {"T_a_in": _HEATING_AIR, "W_a_in": W_IN, "T_w_in": start.T_w_in, "T_set": _HEATING_SET_POINT}
        return DayCall("constant_day", air | load)
    return DayCall("constant_day", load)


@lru_cache(maxsize=64)
def _made(maker: str, arguments: tuple[tuple[str, Any], ...]) -> Boundary:
    return _MAKERS[maker](**dict(arguments))


EVERY = 5
"""Seconds between the samples of a trace."""
TRACES = ("T_sup", "T_measured", "u", "command", "opening", "estimate")
NOW, NO_GAP, PLAIN = range(3)
"""The loop as it is, behind a perfect valve, and with nothing that compensates the gap."""
_OF_A_GAP = ("backlash", "slip_jump", "wear_rate")


class Prediction(NamedTuple):
    """What theory says of a loop in the mean conditions of its day; doubt: why it says nothing, else empty.

    swing: peak to peak, K.  period: s.  Both are NaN where it does not hunt.
    """

    margin: float = np.nan
    hunts: bool = False
    swing: float = np.nan
    period: float = np.nan
    doubt: str = ""


class Run(NamedTuple):
    """One loop on one day.

    hours, traces: one sample each ``EVERY`` seconds.  metrics: by name, (3,), of ``NOW``, ``NO_GAP`` and ``PLAIN``.
    """

    scene: Scene
    hours: Array
    traces: Mapping[str, Array]
    metrics: xr.Dataset
    predicted: Prediction

    def value(self, metric: str, case: int = NOW) -> float:
        """A metric of a case."""
        return float(self.metrics[metric].values[case])

    def parameter(self, name: str) -> float:
        """A number of the loop."""
        return float(self.scene.loop[name])  # type: ignore[arg-type]

    @property
    def failed(self) -> bool:
        """Whether the loop left the range of the model."""
        return bool(self.value("status") != STATUS_OK)

    @property
    def compensates(self) -> bool:
        """Whether anything compensates the gap."""
        return self.parameter("backlash_estimate") > 0.0 or self.learns

    @property
    def learns(self) -> bool:
        """Whether an estimator changes the estimate."""
        return estimator_of(self.scene.loop) != "none"


def run(scene: Scene) -> Run:
    """Simulate a loop as it is, without its gap and without compensation, and predict it."""
    loop = scene.loop
    ds = simulate(
        loop.assign(**_cases(loop)), scene.day, traces=TRACES, trace_interval=EVERY, warm_up=scene.warm_up,
        seed=scene.seed, n_jobs=1, progress=False,
    )  # fmt: skip
    now = ds.isel(case=NOW)
    T_set = scene.day.series["T_set"][0][::EVERY]
    traces = {name: now[name].values for name in TRACES} | {"T_set": T_set}
    metrics = ds.drop_vars(TRACES)
    return Run(scene, ds["elapsed_time"].values / 3600.0, traces, metrics, predict(scene))


def _cases(loop: Loop) -> dict[str, tuple[str, list[Scalar]]]:
    """The loop as it is, without a gap, and without compensation."""
    found: dict[str, tuple[str, list[Scalar]]] = {}
    for name in _OF_A_GAP:
        own = float(loop[name])  # type: ignore[arg-type]
        if own or name == "backlash":
            found[name] = ("case", [own, 0.0, own])
    found["backlash_estimate"] = ("case", [float(loop["backlash_estimate"]), 0.0, 0.0])  # type: ignore[arg-type]
    if estimator_of(loop) != "none":
        found["estimator"] = ("case", [estimator_of(loop), "none", "none"])
    return found


def predict(scene: Scene) -> Prediction:
    """What theory says in the mean conditions of the day."""
    try:
        found = limit_cycle(scene.loop, scene.day)
    except InputError as error:
        # behind the first colon stands the reason, behind the second what to do about it in Python
        parts = error.problems[0].split(": ")
        return Prediction(doubt=parts[1] if len(parts) > 1 else parts[0])
    margin, amplitude, period = (float(found[name]) for name in ("margin", "amplitude", "period"))
    return Prediction(margin, bool(found["hunts"] > 0), 2.0 * amplitude, period)


METRICS = ("rmse", "hunting_swing")


class Axis(NamedTuple):
    """A parameter along a side of the map: its values, and whether they grow by ratios."""

    name: str
    values: tuple[float, ...]
    ratios: bool


# fmt: off
AXES: Mapping[str, tuple[Axis, Axis]] = {
    "tuning": (
        Axis("ti", (4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 100.0, 140.0, 200.0, 280.0, 400.0, 560.0, 800.0),
             True),
        Axis("kp", (0.002, 0.003, 0.0045, 0.0065, 0.01, 0.015, 0.02, 0.03, 0.045, 0.065, 0.1, 0.15), True),
    ),
    "size": (
        Axis("backlash", tuple(round(0.01 * k, 2) for k in range(16)), False),
        Axis("backlash_estimate", tuple(round(0.01 * k, 2) for k in range(16)), False),
    ),
}
# fmt: on
"""Sides of a map, x first: three or four blocks of lanes."""


class Map(NamedTuple):
    """Metrics over two parameters: values by metric, (n_y, n_x)."""

    x: Axis
    y: Axis
    values: Mapping[str, Array]


def without_its_point(settings: Settings) -> Settings:
    """The settings on which the map depends: where its point lies does not change it, nor what is shown of it."""
    x, y = AXES[settings.axes]
    return settings.turned(colour=METRICS[0], window="day", **{x.name: x.values[-1], y.name: y.values[0]})


def map_of(axes: str, scene: Scene) -> Map:
    """Simulate all loops of the map."""
    x, y = AXES[axes]
    # the point of the scene is none of them: what it has along the sides is replaced
    swept = scene.loop.assign(**{y.name: list(y.values), x.name: list(x.values)})
    ds = simulate(swept, scene.day, warm_up=scene.warm_up, seed=scene.seed, n_jobs=1, progress=False)
    return Map(x, y, {name: ds[name].transpose(y.name, x.name).values for name in METRICS})


_RUNS, _MAPS = 200, 100  # so many are kept: 0.3 MB and 4 kB each


class Model:
    """The loops to start from, and what becomes of them; threads may share it.

    given: a loop beside the presets.  preset: the one that a page without a link begins with, if none is given.
    """

    def __init__(self, given: Scenario | None = None, preset: str = "paper_like") -> None:
        self.starts: Mapping[str, Start] = starts(given)
        self.first = GIVEN if given is not None else preset
        self._run = lru_cache(maxsize=_RUNS)(self._simulate)
        self._map = lru_cache(maxsize=_MAPS)(self._sweep)

    @property
    def usual(self) -> Settings:
        """What a page without a link shows."""
        return settings_of(self.first, self.starts[self.first])

    def run(self, settings: Settings) -> Run:
        """The loop of some settings, simulated and predicted."""
        return self._run(settings.turned(axes="tuning", colour="rmse", window="day"))

    def map(self, settings: Settings) -> Map:
        """The map around it."""
        return self._map(without_its_point(settings))

    def prepare(self) -> None:
        """Compile the kernel, and have what the page shows first and its stories ready."""
        compile_kernel()
        for settings in (self.usual, *(settings_of_story(story, self.starts) for story in STORIES)):
            # a loop that cannot be simulated is refused on the page
            with suppress(InputError):
                self.run(settings)
                self.map(settings)

    def _simulate(self, settings: Settings) -> Run:
        return run(scene_of(settings, self.starts[settings.loop]))

    def _sweep(self, settings: Settings) -> Map:
        return map_of(settings.axes, scene_of(settings, self.starts[settings.loop]))

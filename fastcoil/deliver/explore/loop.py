"""Settings in; traces, metrics, an explanation and a map of the loop out.  Repeated requests come from a cache."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.deliver.explore.settings import DIALS, GIVEN, Settings, Start, estimator_of, starts
from fastcoil.design.advice import NO_INVERSE, REPAIRED, per_cent
from fastcoil.design.explain import explain
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import W_IN, constant_day, design_day, heating_day, paper_day
from fastcoil.loops.clashes import unread_values
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.maintenance import Scenario

_VALVE = {"rangeability": 50.0, "m_full": 1.7}  # an equal-percentage valve; flow in kg/s of the presets' cooling coil
_LEARNING_STEP = 0.01  # finds a gap of 7 % in half a day
_SHARE = 0.95  # of what is identified: an estimate above the gap chatters
_HEATING_DAY = {"T_a_in": 12.0, "W_a_in": W_IN, "T_set": 25.0}  # means of ``heating_day``, degC


def loop_of(settings: Settings, start: Start) -> Loop:
    """The loop of some settings."""
    values: dict[str, Any] = {name: getattr(settings, name) for name in DIALS if name != "m_a"}
    if settings.valve != "own":
        given = {} if start.loop["m_full"] is None else {"m_full": start.loop["m_full"]}
        values |= _VALVE | given | {"authority": float(settings.valve)}
    loop = start.loop.assign(**values)
    if settings.estimator == "own":
        return loop
    learning: dict[str, Any] = {}
    if settings.estimator == "learner":
        learning = {"learning_step": _LEARNING_STEP}
    elif settings.estimator == "identify":
        learning = {"estimate_share": _SHARE, "identify_stroke_time": settings.stroke_time}
    loop = loop.assign(estimator=settings.estimator, **learning)
    unread: dict[str, Any] = {name: PARAMETERS[name].default for name in unread_values(loop)}
    return loop.assign(**unread)


def day_of(settings: Settings, start: Start) -> Boundary:
    """The day of some settings."""
    water: dict[str, Any] = {"T_w_in": start.T_w_in} if start.heats else {}
    if settings.day == "own" and start.day is not None:
        return start.day
    if settings.day == "steps":
        return heating_day(**water) if start.heats else paper_day()
    if settings.day == "design":
        return design_day(mode="heating" if start.heats else "cooling", m_a=settings.m_a, **water)
    return constant_day(m_a=settings.m_a, **(_HEATING_DAY if start.heats else {}), **water)


def scene_of(settings: Settings, start: Start) -> Scenario:
    """The loop and the day of some settings."""
    return Scenario(start.title, loop_of(settings, start), day_of(settings, start), start.warm_up, start.seed)


EVERY = 5
"""Seconds between the samples of a trace."""
TRACES = ("T_sup", "T_measured", "u", "command", "opening", "estimate")


class Run(NamedTuple):
    """One loop on one day: a sample of each trace every ``EVERY`` seconds, its metrics, and what ``explain`` says.

    margin: NaN where theory cannot tell.  without: what the day shows without the gap, and without the inverse.
    """

    scene: Scenario
    hours: Array
    traces: Mapping[str, Array]
    metrics: xr.Dataset
    answer: str
    why: str
    advice: str
    margin: float
    without: Mapping[str, str]

    def value(self, metric: str) -> float:
        """A metric."""
        return float(self.metrics[metric])

    def parameter(self, name: str) -> float:
        """A number of the loop."""
        return float(self.scene.loop[name])  # type: ignore[arg-type]

    @property
    def learns(self) -> bool:
        return estimator_of(self.scene.loop) != "none"

    @property
    def compared(self) -> str:
        """What the same day shows without the gap, and without the inverse."""
        others = [f"Without {what}: {shown}." for what, shown in self.without.items()]
        return "  ".join(others if self.parameter("backlash") else ["The valve has no gap.", *others])

    @property
    def learning(self) -> str:
        """What an estimator has found; empty without one."""
        found, right = self.value("estimate_final"), self.value("time_identified") / 3600.0
        if not self.learns or not math.isfinite(found):
            return ""
        since = f", right since hour {right:.1f}" if math.isfinite(right) else ", which is not right yet"
        gap = per_cent(self.value("backlash_final"))
        return f"The estimate ends at {per_cent(round(found, 3))} for a gap of {gap}{since}."


def run(scene: Scenario) -> Run:
    """Simulate a loop, and explain it."""
    loop, day, warm_up, seed = scene.loop, scene.boundary, scene.warm_up, scene.seed
    ds = simulate(loop, day, traces=TRACES, trace_interval=EVERY, warm_up=warm_up, seed=seed, n_jobs=1, progress=False)
    traces = {name: ds[name].values for name in TRACES} | {"T_set": day.series["T_set"][0][::EVERY]}
    found = explain(loop, day, warm_up=warm_up, seed=seed)
    words = {REPAIRED: "the gap", NO_INVERSE: "the inverse"}
    without = {what: found.shows(name) for name, what in words.items() if name in found.cures["cure"]}
    hours, metrics = ds["elapsed_time"].values / 3600.0, ds.drop_vars(TRACES)
    return Run(scene, hours, traces, metrics, found.answer, found.why, found.advice, found.margin, without)


_TI = (4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 100.0, 140.0, 200.0, 280.0, 400.0, 560.0, 800.0)
_KP = (0.002, 0.003, 0.0045, 0.0065, 0.01, 0.015, 0.02, 0.03, 0.045, 0.065, 0.1, 0.15)
_SIZES = tuple(round(0.01 * k, 2) for k in range(16))
AXES: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "tuning": {"ti": _TI, "kp": _KP},
    "size": {"backlash": _SIZES, "backlash_estimate": _SIZES},
}
"""Parameters along the sides of a map and their values, x first: three or four blocks of lanes."""


def map_of(axes: str, scene: Scenario) -> Mapping[str, Array]:
    """Simulate all loops of a map: metrics over its two parameters by name, (n_y, n_x)."""
    (x, along_x), (y, along_y) = AXES[axes].items()
    swept = scene.loop.assign(**{y: list(along_y), x: list(along_x)})
    ds = simulate(swept, scene.boundary, warm_up=scene.warm_up, seed=scene.seed, n_jobs=1, progress=False)
    return {name: ds[name].transpose(y, x).values for name in ("rmse", "hunting_swing")}


_RUNS, _MAPS = 200, 100  # sizes of the caches: 0.3 MB and 4 kB an entry


class Model:
    """The loops to start from, simulated as the page asks; shared by threads.

    given: the scenario of a study, added to the presets and shown first.  preset: shown first without one.
    """

    def __init__(self, given: Scenario | None = None, preset: str = "paper_like") -> None:
        self.starts = starts(given)
        self.first = preset if given is None else GIVEN
        self._run = lru_cache(_RUNS)(lambda settings: run(scene_of(settings, self.starts[settings.loop])))
        self._map = lru_cache(_MAPS)(
            lambda settings: map_of(settings.axes, scene_of(settings, self.starts[settings.loop]))
        )

    def run(self, settings: Settings) -> Run:
        """The loop of some settings, simulated and predicted."""
        return self._run(replace(settings, axes="tuning", colour="rmse", window="day"))

    def map(self, settings: Settings) -> Mapping[str, Array]:
        """The map around it, which does not depend on where its own point lies."""
        (x, along_x), (y, along_y) = AXES[settings.axes].items()
        point: Any = {x: along_x[-1], y: along_y[0]}
        return self._map(replace(settings, colour="rmse", window="day", **point))

"""The model behind the page: settings in; traces, metrics, an explanation and a map of the loop out, cached."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.base.text import format_kelvin, format_percent
from fastcoil.design.advice import NO_INVERSE, REPAIRED_VALVE
from fastcoil.design.explain import explain
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import WINTER_HUMIDITY_RATIO, constant_day, design_day, heating_day, paper_day
from fastcoil.loops.clashes import unread_values
from fastcoil.loops.loop import Loop, used_choices
from fastcoil.loops.presets import PRESETS
from fastcoil.loops.simulate import simulate
from fastcoil.loops.valve_test import ValveTest
from fastcoil.measured.read_test import read_test
from fastcoil.model.metric_table import TEST_ABORTED_MEANINGS, WARM_UP_S
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.maintenance import Scenario

STUDY_LOOP_NAME = "given"  # of the loop of a study, beside those of the presets


class Start(NamedTuple):
    """A loop to start from.  day: that of a study; None for a preset.  T_w_in: design water of a preset, degC."""

    title: str
    loop: Loop
    day: Boundary | None = None
    T_w_in: float = 7.0
    warm_up: int = WARM_UP_S
    seed: int = 0

    @property
    def heats(self) -> bool:
        return bool(self.loop["action"] == "heating")


def start_loops(study_scenario: Scenario | None = None) -> dict[str, Start]:
    """Return the loops to start from by name: the one of a study, then the presets."""
    loops = {}
    if study_scenario is not None:
        title, loop, day, warm_up, seed = study_scenario
        if day.n_steps > 24 * 3600:
            raise InputError(f"{title}: its day lasts {day.hours:g} h: give at most 24 h", "hours", "size")
        if loop["estimate_ratio"] is not None:  # the slider of the gap leaves the estimate
            loop = loop.assign(backlash_estimate=loop["estimate_ratio"] * loop["backlash"])  # type: ignore[operator]
        loops[STUDY_LOOP_NAME] = Start(title, loop, day, warm_up=warm_up, seed=seed)
    return loops | {
        name: Start(name, Loop.preset(name), T_w_in=preset.day.get("T_w_in", 7.0))
        for name, preset in PRESETS.items()
        if not preset.has_room
    }


class Dial(NamedTuple):
    """A slider.  factor: from the parameter's unit to the one shown; steps: values in the unit of the parameter."""

    label: str
    unit: str
    steps: tuple[float, ...]
    factor: float = 1.0

    def value_text(self, value: float) -> str:
        return f"{self.factor * value:.4g} {self.unit}"


class Menu(NamedTuple):
    """A menu: its label, and the text shown for each of its words."""

    label: str
    words: Mapping[str, str]


_DIAL_GAP_SIZES = tuple(round(0.005 * k, 3) for k in range(31))  # fractions of stroke
DIALS = {
    "backlash": Dial("Gap of the valve", "%", _DIAL_GAP_SIZES, 100.0),
    "backlash_estimate": Dial("Estimate of the gap", "%", _DIAL_GAP_SIZES, 100.0),
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
    "noise_std": Dial("Noise of the sensor", "K", (0.0, 0.005, 0.01, 0.02, 0.03, 0.04, 0.05, 0.075, 0.1, 0.15, 0.2)),
    "stroke_time": Dial(
        "Motor, full stroke", "s", (0.0, 15.0, 30.0, 45.0, 60.0, 90.0, 120.0, 150.0, 200.0, 250.0, 300.0)
    ),
    "m_a": Dial("Load: air flow", "kg/s", tuple(round(0.3 + 0.05 * k, 2) for k in range(25))),
}  # fmt: skip
"""Sliders by parameter; ``m_a`` is of the day, all others are of the loop."""
MENUS = {
    "valve": Menu("Valve curve", {"own": "of the loop", **{a: f"authority {a}" for a in ("0.7", "0.3", "0.1")}}),
    "estimator": Menu("Learning", {"none": "none", "learner": "learner", "identify": "identify", "own": "of the loop"}),
    "day": Menu("Day", {"own": "of the loop", "steps": "steps", "constant": "constant", "design": "design day"}),
    "test": Menu("Valve test", {"none": "none", "usual": "usual", "gentle": "gentle"}),
    "axes": Menu("Map over", {"tuning": "Kp and Ti", "size": "gap and estimate"}),
    "colour": Menu("Colour", {"rmse": "RMS error", "hunting_swing": "hunting swing"}),
    "window": Menu("Time shown", {"day": "whole day", "2h": "2 h", "half": "30 min"}),
}  # fmt: skip
_USUAL_AIR_FLOW_KG_S = {"cooling": 1.15, "heating": 0.9}


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
    test: str = "none"
    axes: str = "tuning"
    colour: str = "rmse"
    window: str = "2h"


def initial_settings(name: str, start: Start) -> Settings:
    """Return the settings with which a loop to start from is shown first."""
    numbers: Any = {dial: float(start.loop[dial]) for dial in DIALS if dial != "m_a"}  # type: ignore[arg-type]
    estimator = "none" if used_choices(start.loop, "estimator") == {"none"} else "own"
    day = "steps" if start.day is None else "own"
    return Settings(name, m_a=_USUAL_AIR_FLOW_KG_S[str(start.loop["action"])], estimator=estimator, day=day, **numbers)


def menu_words(name: str, start: Start) -> dict[str, str]:
    """Return the words of a menu and their texts for a loop: "own" only if it has a day or an estimator of its own."""
    is_missing = {"day": start.day is None, "estimator": used_choices(start.loop, "estimator") == {"none"}}
    return {word: text for word, text in MENUS[name].words.items() if word != "own" or not is_missing.get(name)}


STORIES: Mapping[str, Mapping[str, Any]] = {
    "A good valve": {"backlash": 0.0},
    "7 % gap, plain PI": {},
    "With the inverse": {"backlash_estimate": 0.065},
    "Estimate too large": {"backlash_estimate": 0.1, "window": "half"},
    "Learning": {"estimator": "identify", "window": "day"},
    "Slower instead": {"ti": 40.0},
    "A valve test": {"day": "constant", "test": "gentle", "noise_std": 0.02},
}
"""Text of a button, and what it changes of the preset ``paper_like``."""


def loop_settings(settings: Settings) -> Settings:
    """Return the settings with those of map and window reset, which do not change the simulation."""
    return replace(settings, axes="tuning", colour="rmse", window="day")


def story_settings(title: str, starts: Mapping[str, Start]) -> Settings:
    """Return the settings of one of ``STORIES``."""
    return replace(initial_settings("paper_like", starts["paper_like"]), **STORIES[title])


def build_loop(settings: Settings, start: Start) -> Loop:
    """Return the loop that the settings describe."""
    values: dict[str, Any] = {name: getattr(settings, name) for name in DIALS if name != "m_a"}
    if settings.valve != "own":  # an equal-percentage valve
        m_full = start.loop["m_full"]
        values |= {"rangeability": 50.0, "authority": float(settings.valve)}
        values["m_full"] = 1.7 if m_full is None else m_full  # kg/s, of the presets' cooling coil
    loop = start.loop.assign(**values)
    if settings.estimator == "own":
        return loop
    estimator_values: dict[str, Any] = {}
    if settings.estimator == "learner":
        estimator_values = {"learning_step": 0.01}  # finds a gap of 7 % in half a day
    elif settings.estimator == "identify":  # an estimate above the gap chatters
        estimator_values = {"estimate_share": 0.95, "identify_stroke_time": settings.stroke_time}
    loop = loop.assign(estimator=settings.estimator, **estimator_values)
    unread_defaults: dict[str, Any] = {name: PARAMETERS[name].default for name in unread_values(loop)}
    return loop.assign(**unread_defaults)


@lru_cache(8)  # of 2 MB each; most moves leave the day as it is
def _make_menu_day(name: str, m_a: float, heating_water: float | None) -> Boundary:
    """Make the day of a word of the menu; m_a: air flow, kg/s; heating_water: degC, None for a cooling coil."""
    heats = heating_water is not None
    water_series: dict[str, Any] = {"T_w_in": heating_water} if heats else {}
    if name == "steps":
        return heating_day(**water_series) if heats else paper_day()
    if name == "design":
        return design_day(mode="heating" if heats else "cooling", m_a=m_a, **water_series)
    # the means of ``heating_day``
    mean_series: dict[str, Any] = {"T_a_in": 12.0, "W_a_in": WINTER_HUMIDITY_RATIO, "T_set": 25.0} if heats else {}
    return constant_day(m_a=m_a, **mean_series, **water_series)


def build_scene(settings: Settings, start: Start) -> Scenario:
    """Return the loop and the day that the settings describe."""
    day = start.day if settings.day == "own" else None
    day = day or _make_menu_day(settings.day, settings.m_a, start.T_w_in if start.heats else None)
    return Scenario(start.title, build_loop(settings, start), day, start.warm_up, start.seed)


def build_valve_test(settings: Settings, scene: Scenario) -> ValveTest | None:
    """Return the valve test that the settings ask for, in the last 75 min of the day; None without one."""
    if settings.test == "none":
        return None
    make_usual = ValveTest.heating if scene.loop["action"] == "heating" else ValveTest
    make_test = ValveTest.gentle if settings.test == "gentle" else make_usual
    return make_test(start=max(0.0, scene.boundary.n_steps - 4500.0), settle=300.0)


TRACE_INTERVAL_S = 5  # between the samples of a trace
TRACES = ("T_sup", "T_measured", "u", "command", "opening", "estimate", "test")


class Run(NamedTuple):
    """One loop on one day: traces every ``TRACE_INTERVAL_S``, metrics, result of a valve test in words."""

    scene: Scenario
    hours: Array
    traces: Mapping[str, Array]
    metrics: xr.Dataset
    reading_text: str

    def metric(self, name: str) -> float:
        return float(self.metrics[name])

    def parameter(self, name: str) -> float:
        return float(self.scene.loop[name])  # type: ignore[arg-type]

    @property
    def has_estimator(self) -> bool:
        return used_choices(self.scene.loop, "estimator") != {"none"}

    @property
    def error_text(self) -> str:
        """RMS error in words; empty where the loop cannot be simulated."""
        return f"RMS error {format_kelvin(rmse)}" if math.isfinite(rmse := self.metric("rmse")) else ""

    @property
    def learning_text(self) -> str:
        """Result of an estimator in words; empty without one."""
        estimate, hour = self.metric("estimate_final"), self.metric("time_identified") / 3600.0
        if not self.has_estimator or not math.isfinite(estimate):
            return ""
        since = f", right since hour {hour:.1f}" if math.isfinite(hour) else ", which is not right yet"
        gap = format_percent(self.metric("backlash_final"))
        return f"The estimate ends at {format_percent(round(estimate, 3))} for a gap of {gap}{since}."


def simulate_scene(scene: Scenario, test: ValveTest | None = None) -> Run:
    """Simulate a loop on its day, with a valve test if one is given."""
    loop, day = scene.loop, scene.boundary
    options: Any = {"traces": TRACES, "trace_interval": TRACE_INTERVAL_S, "n_jobs": 1}
    ds = simulate(loop, day, test=test, warm_up=scene.warm_up, seed=scene.seed, progress=False, **options)
    traces = {name: ds[name].values for name in TRACES} | {"T_set": day.series["T_set"][0][::TRACE_INTERVAL_S]}
    hours, metrics = ds["elapsed_time"].values / 3600.0, ds.drop_vars(TRACES)
    reading = "" if test is None else describe_reading(ds, float(loop["stroke_time"]))  # type: ignore[arg-type]
    return Run(scene, hours, traces, metrics, reading)


def describe_reading(ds: xr.Dataset, stroke_time: float) -> str:
    """Read the valve test in a simulation, and describe the result."""
    reason = TEST_ABORTED_MEANINGS[int(ds["test_aborted"])].replace("_", " ")
    end = "ended early" if (began := bool(ds["test"].any())) else "did not begin"
    ending = f"  The test {end}: {reason}." if ds["test_aborted"] else ""
    if not began:
        return ending.strip()
    reading = read_test(ds[["command", "T_measured", "test"]], stroke_time=stroke_time)
    low, high = map(format_percent, reading.interval)
    if reading.identified:
        return f"The valve test reads a gap of {format_percent(reading.backlash)} (95 %: {low} to {high}).{ending}"
    return f"The valve test shows a gap of {low} to {high} and claims no size: {reading.reason}.{ending}"


class ExplanationText(NamedTuple):
    """Sentences of ``explain`` on a loop."""

    answer: str
    compared: str  # the day without the gap, and without the inverse
    why: str
    advice: str
    hunting_index: float  # NaN where theory does not apply


def explain_scene(scene: Scenario) -> ExplanationText:
    """Return the sentences of ``explain`` on a loop; this takes several times as long as its simulation."""
    e = explain(scene.loop, scene.boundary, warm_up=scene.warm_up, seed=scene.seed)
    comparisons = [] if scene.loop["backlash"] else ["The valve has no gap."]
    for cure, part in ((REPAIRED_VALVE, "the gap"), (NO_INVERSE, "the inverse")):
        if cure in e.cures["cure"].values:
            error = format_kelvin(float(e.cures["rmse"].sel(cure=cure)))
            comparisons.append(f"Without {part} it {e.judge(cure).clause}, RMS error {error}.")
    return ExplanationText(e.answer, "  ".join(comparisons), e.why, e.advice, e.hunting_index)


_MAP_GAP_SIZES = tuple(round(0.01 * k, 2) for k in range(16))  # fractions of stroke
MAP_AXES: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "tuning": {
        "ti": (4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 100.0, 140.0, 200.0, 280.0, 400.0, 560.0, 800.0),
        "kp": (0.002, 0.003, 0.0045, 0.0065, 0.01, 0.015, 0.02, 0.03, 0.045, 0.065, 0.1, 0.15),
    },
    "size": {"backlash": _MAP_GAP_SIZES, "backlash_estimate": _MAP_GAP_SIZES},
}
"""Parameters along the sides of a map and their values, x first; a map is three or four blocks of lanes."""


def simulate_map(axes: str, scene: Scenario) -> Mapping[str, Array]:
    """Simulate all loops of a map: metrics over its two parameters by name, (n_y, n_x)."""
    (x, along_x), (y, along_y) = MAP_AXES[axes].items()
    swept = scene.loop.assign(**{y: list(along_y), x: list(along_x)})
    ds = simulate(swept, scene.boundary, warm_up=scene.warm_up, seed=scene.seed, n_jobs=1, progress=False)
    return {name: ds[name].transpose(y, x).values for name in ("rmse", "hunting_swing")}


class Model:
    """Simulates, explains and maps loops, with caches for all threads; shows a study's loop first, else ``preset``."""

    def __init__(self, study_scenario: Scenario | None = None, preset: str = "paper_like") -> None:
        self.starts = start_loops(study_scenario)
        self.first = preset if study_scenario is None else STUDY_LOOP_NAME
        self._run = lru_cache(200)(self._run_with_test)  # 0.3 MB an entry
        self._explain = lru_cache(200)(lambda settings: explain_scene(self._scene_for(settings)))
        self._map = lru_cache(100)(lambda settings: simulate_map(settings.axes, self._scene_for(settings)))  # 4 kB each

    def _scene_for(self, settings: Settings) -> Scenario:
        return build_scene(settings, self.starts[settings.loop])

    def _run_with_test(self, settings: Settings) -> Run:
        return simulate_scene(scene := self._scene_for(settings), build_valve_test(settings, scene))

    def run(self, settings: Settings) -> Run:
        return self._run(loop_settings(settings))

    def explain(self, settings: Settings) -> ExplanationText:
        return self._explain(replace(loop_settings(settings), test="none"))

    def map(self, settings: Settings) -> Mapping[str, Array]:
        """Simulate the map for these settings, from the cache for all points on it."""
        (x, along_x), (y, along_y) = MAP_AXES[settings.axes].items()
        point: Any = {x: along_x[-1], y: along_y[0]}
        return self._map(replace(settings, colour="rmse", window="day", test="none", **point))

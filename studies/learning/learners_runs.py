"""Conditions under which the estimators are tried, their simulation, and what counts as wrong or harm.

The four loops are those on which the growing rule was chosen (``learning_step.toml``), each condition changing
one thing; the valves are drawn as in ``valve_population.toml``, with gains as somebody left them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.study.file.spec import read_study
from studies.common import HEATING_GAIN, STUDIES, Share, concat_along, draw_loguniform, progress_printer, share_of
from studies.days import (
    CONSTANT,
    DESIGN,
    HEATING,
    OUTDOOR_FRACTION,
    STEPPED,
    T_SET,
    WEATHER,
    kinds,
    loop_settings,
    make_days,
)
from studies.remedies import runs
from studies.remedies.runs import select_loop
from studies.robustness.best_pi import PRESETS, simc_gains

STUDY = STUDIES / "learning" / "learners.toml"
HOURS = 16
LOOP_DAYS, VALVE_DAYS = range(6101, 6111), range(6201, 6206)
BACKLASHES = (0.03, 0.07, 0.075, 0.12)
NOISES = (0.0, 0.02, 0.05)
SEED = 6126
KIND_LABELS = {
    STEPPED: "set-point steps",
    CONSTANT: "constant set-point",
    DESIGN: "design days",
    WEATHER: "weather, 30 % outdoor air",
    HEATING: "heating",
}
LOOPS_LABEL, VALVES_LABEL, GOOD_LABEL = "four loops", "valves", "no backlash"
"""Where the labels of conditions begin."""
MORNING_STEPS = f"{VALVES_LABEL}: steps in the first four hours alone"
LOW_AUTHORITY, SMALL_BACKLASH = f"{VALVES_LABEL}: authority 0.02 to 0.1", f"{VALVES_LABEL}: backlash 0.5 to 2 %"
ONE_DAY, THREE_DAYS = f"{VALVES_LABEL} of `remedies`: a day of 8 h", f"{VALVES_LABEL} of `remedies`: 24 h"


class Condition(NamedTuple):
    """Loops along ``sample`` and days of a kind that they meet."""

    name: str
    loop: fc.Loop
    kind: str
    seeds: Sequence[int]
    hours: int = HOURS
    outdoor: float = OUTDOOR_FRACTION
    steps_for: int | None = None
    """Hours after which the set-point stands still; without, it does what it does on days of this kind."""

    def days(self) -> fc.Boundary:
        """The days themselves."""
        days = make_days(self.kind, self.seeds, hours=self.hours, outdoor_fraction=self.outdoor)
        if self.steps_for is None:
            return days
        series = {name: values.copy() for name, values in days.series.items()}
        series["T_set"][:, self.steps_for * 3600 :] = T_SET
        return fc.Boundary(**series, day=list(self.seeds))


def four_loops(backlashes: Sequence[float] = BACKLASHES) -> fc.Loop:
    """The presets with every noise and backlash, along ``sample``."""
    cases = list(product(PRESETS, NOISES, backlashes))
    parameters = {"noise_std": [noise for _, noise, _ in cases], "backlash": [x for *_, x in cases]}
    for name in ("C_c", "kp", "ti", "sample_time", "sensor_time_constant", "stroke_time"):
        parameters[name] = [float(fc.Loop.preset(preset)[name]) for preset, *_ in cases]  # type: ignore[arg-type]
    return fc.Loop(converged=True, **{name: ("sample", values) for name, values in parameters.items()})


def valves() -> fc.Loop:
    """The valves and loops of the study, with its plain PI."""
    return select_loop(read_study(STUDY).plan.layout.loop, controller=0)


def conditions(size: int | None = None) -> Iterator[Condition]:
    """All conditions; those of weather only where there is a weather file.  size: only so many loops and valves."""
    for condition in (*_valve_conditions(), *_loop_conditions()):
        loop = select_loop(condition.loop, sample=slice(0, size))
        is_heating = condition.kind == HEATING
        kp = xr.DataArray(loop["kp"]) * (HEATING_GAIN if is_heating else 1.0)
        yield condition._replace(loop=loop.assign(kp=kp, **loop_settings(condition.kind)))


def _loop_conditions() -> Iterator[Condition]:
    loops = four_loops()
    yield Condition(f"{LOOPS_LABEL}: {KIND_LABELS[STEPPED]}", loops, STEPPED, LOOP_DAYS)
    yield Condition(f"{LOOPS_LABEL}: {KIND_LABELS[CONSTANT]}", loops, CONSTANT, LOOP_DAYS)
    if WEATHER in kinds():
        yield Condition(f"{LOOPS_LABEL}: {KIND_LABELS[WEATHER]}", loops, WEATHER, LOOP_DAYS)
        yield Condition(f"{LOOPS_LABEL}: weather, 100 % outdoor air", loops, WEATHER, LOOP_DAYS, outdoor=1.0)
    larger_coil = loops.assign(C_w=1.5 * xr.DataArray(loops["C_w"]), C_c=2.0 * xr.DataArray(loops["C_c"]))
    yield Condition(f"{LOOPS_LABEL}: larger coil", larger_coil, STEPPED, LOOP_DAYS)
    yield Condition(f"{LOOPS_LABEL}: gentler valve", loops.assign(valve_b=5.0), STEPPED, LOOP_DAYS)
    low_authority = loops.assign(rangeability=50.0, authority=0.05, m_full=2.0)
    yield Condition(f"{LOOPS_LABEL}: authority 0.05", low_authority, STEPPED, LOOP_DAYS)
    yield Condition(f"{LOOPS_LABEL}: backlash 2 %", four_loops([0.02]), STEPPED, LOOP_DAYS)
    yield Condition(f"{GOOD_LABEL}, {LOOPS_LABEL}: {KIND_LABELS[STEPPED]}", four_loops([0.0]), STEPPED, LOOP_DAYS)


def _valve_conditions() -> Iterator[Condition]:
    plain = valves()
    for kind in kinds():
        yield Condition(f"{VALVES_LABEL}: {KIND_LABELS[kind]}", plain, kind, VALVE_DAYS)
    yield Condition(MORNING_STEPS, plain, STEPPED, VALVE_DAYS, steps_for=4)
    rng, n = np.random.default_rng(SEED), int(plain.coordinates()["sample"].size)
    low_authority = plain.assign(authority=("sample", draw_loguniform(rng, 0.02, 0.1, n)))
    small_backlash = plain.assign(backlash=("sample", rng.uniform(0.005, 0.02, n)))
    yield Condition(LOW_AUTHORITY, low_authority, STEPPED, VALVE_DAYS)
    yield Condition(SMALL_BACKLASH, small_backlash, STEPPED, VALVE_DAYS)
    other_valves = select_loop(runs.population(n), controller=0)
    yield Condition(ONE_DAY, other_valves, STEPPED, VALVE_DAYS, hours=8)
    yield Condition(THREE_DAYS, other_valves, STEPPED, VALVE_DAYS, hours=24)
    for kind in kinds():
        yield Condition(
            f"{GOOD_LABEL}, {VALVES_LABEL}: {KIND_LABELS[kind]}", plain.assign(backlash=0.0), kind, VALVE_DAYS
        )


PI, KNOWN_INVERSE, KNOWN_STROKE = "pi", "fixed_95", "identify_stroke"
METRICS = ("rmse", "rmse_settled", "motor_travel", "estimate_final", "time_identified", "status")
RELATIVE_TOLERANCE, STROKE_TOLERANCE = 0.2, 0.01
"""Right is what lies within 20 % of the backlash or, where the study says so, 1 % of the stroke."""
ROUND_OFF = 1e-9
HARM_RISE_GOOD, HARM_RISE_WORN = 0.01, 0.02
"""Rise of the RMSE of a loop that counts on a good valve, and on one with backlash."""


class Run(NamedTuple):
    """Result of a condition."""

    condition: Condition
    ds: xr.Dataset
    backlash: xr.DataArray

    @property
    def is_good(self) -> bool:
        """Whether the valves have no backlash."""
        return self.condition.name.startswith(GOOD_LABEL)


@cache
def controllers() -> dict[str, dict[str, object]]:
    """The rows of the study: parameters by name."""
    return read_study(STUDY).tables["cases"]["controller"]  # type: ignore[no-any-return]


def run(size: int | None = None, names: Collection[str] | None = None) -> list[Run]:
    """Run every controller under every condition, or under those in ``names``; ``size``: number of loops and valves."""
    report, results = progress_printer(), []
    for condition in conditions(size):
        if names is not None and condition.name not in names:
            continue
        ds = simulate_condition(condition)
        backlash = xr.DataArray(condition.loop["backlash"]).broadcast_like(ds.rmse.isel(controller=0, day=0, drop=True))
        results.append(Run(condition, ds, backlash))
        report(condition.name)
    return results


def simulate_condition(condition: Condition) -> xr.Dataset:
    """Metrics of every controller under a condition; the plant's gain comes from a step of the command."""
    gain = simc_gains(condition.loop, HEATING if condition.kind == HEATING else STEPPED).plant_gain
    loop, days = condition.loop.assign(plant_gain=gain), condition.days()
    known_stroke = {KNOWN_STROKE: {"identify_stroke_time": loop["stroke_time"]}}
    datasets = {
        name: fc.simulate(loop.assign(**parameters | known_stroke.get(name, {})), days)
        for name, parameters in controllers().items()
    }
    return concat_along(
        "controller", {name: ds[list(METRICS)].reset_coords(drop=True) for name, ds in datasets.items()}
    )


def is_wrong(run: Run, name: str, *, stroke_tolerance: float = STROKE_TOLERANCE) -> xr.DataArray:
    """Return whether the last estimate of a day is wrong; NaN is.  stroke_tolerance: error that is always right."""
    tolerance = np.maximum(RELATIVE_TOLERANCE * run.backlash, stroke_tolerance) + ROUND_OFF
    return ~(abs(run.ds.estimate_final.sel(controller=name) - run.backlash) <= tolerance)


def relative_change(run: Run, name: str, metric: str = "rmse") -> xr.DataArray:
    """By how much a metric of every loop, the mean of its days, differs from that of its plain PI; as a share of it."""
    loop_means = run.ds[metric].mean("day")
    return loop_means.sel(controller=name) / loop_means.sel(controller=PI) - 1.0


def harmed_share(run: Run, name: str) -> Share:
    """Share of loops that are worse than plain PI by more than the tolerated rise."""
    return share_of(relative_change(run, name) > (HARM_RISE_GOOD if run.is_good else HARM_RISE_WORN))

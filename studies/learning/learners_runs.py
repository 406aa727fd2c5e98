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
from studies.common import HEATING_GAIN, STUDIES, Share, along, loguniform, progress, share_of
from studies.days import CONSTANT, DESIGN, HEATING, OUTDOOR_AIR, STEPPED, T_SET, WEATHER, kinds, of_kind, settings
from studies.remedies import runs
from studies.remedies.runs import picked
from studies.robustness.best_pi import PRESETS, simc_gains

STUDY = STUDIES / "learning" / "learners.toml"
HOURS = 16
LOOP_DAYS, VALVE_DAYS = range(6101, 6111), range(6201, 6206)
BACKLASHES = (0.03, 0.07, 0.075, 0.12)
NOISES = (0.0, 0.02, 0.05)
SEED = 6126
LABELS = {
    STEPPED: "set-point steps",
    CONSTANT: "constant set-point",
    DESIGN: "design days",
    WEATHER: "weather, 30 % outdoor air",
    HEATING: "heating",
}
LOOPS, VALVES, GOOD = "four loops", "valves", "no backlash"
"""Where the labels of conditions begin."""
MORNING = f"{VALVES}: steps in the first four hours alone"
LOW_AUTHORITY, SMALL = f"{VALVES}: authority 0.02 to 0.1", f"{VALVES}: backlash 0.5 to 2 %"
ONE_DAY, THREE_DAYS = f"{VALVES} of `remedies`: a day of 8 h", f"{VALVES} of `remedies`: 24 h"


class Condition(NamedTuple):
    """Loops along ``sample`` and days of a kind that they meet."""

    name: str
    loop: fc.Loop
    kind: str
    seeds: Sequence[int]
    hours: int = HOURS
    outdoor: float = OUTDOOR_AIR
    steps_for: int | None = None
    """Hours after which the set-point stands still; without, it does what it does on days of this kind."""

    def days(self) -> fc.Boundary:
        """The days themselves."""
        days = of_kind(self.kind, self.seeds, hours=self.hours, outdoor=self.outdoor)
        if self.steps_for is None:
            return days
        series = {name: values.copy() for name, values in days.series.items()}
        series["T_set"][:, self.steps_for * 3600 :] = T_SET
        return fc.Boundary(**series, day=list(self.seeds))


def four_loops(backlashes: Sequence[float] = BACKLASHES) -> fc.Loop:
    """The presets with every noise and backlash, along ``sample``."""
    cases = list(product(PRESETS, NOISES, backlashes))
    given = {"noise_std": [noise for _, noise, _ in cases], "backlash": [x for *_, x in cases]}
    for name in ("C_c", "kp", "ti", "sample_time", "sensor_time_constant", "stroke_time"):
        given[name] = [float(fc.Loop.preset(preset)[name]) for preset, *_ in cases]  # type: ignore[arg-type]
    return fc.Loop(**{name: ("sample", values) for name, values in given.items()})


def valves() -> fc.Loop:
    """The valves and loops of the study, with its plain PI."""
    return picked(read_study(STUDY).plan.layout.loop, controller=0)


def conditions(size: int | None = None) -> Iterator[Condition]:
    """All conditions; those of weather only where there is a weather file.  size: only so many loops and valves."""
    for condition in (*_of_valves(), *_of_loops()):
        few = picked(condition.loop, sample=slice(0, size))
        heats = condition.kind == HEATING
        kp = xr.DataArray(few["kp"]) * (HEATING_GAIN if heats else 1.0)
        yield condition._replace(loop=few.assign(kp=kp, **settings(condition.kind)))


def _of_loops() -> Iterator[Condition]:
    loops = four_loops()
    yield Condition(f"{LOOPS}: {LABELS[STEPPED]}", loops, STEPPED, LOOP_DAYS)
    yield Condition(f"{LOOPS}: {LABELS[CONSTANT]}", loops, CONSTANT, LOOP_DAYS)
    if WEATHER in kinds():
        yield Condition(f"{LOOPS}: {LABELS[WEATHER]}", loops, WEATHER, LOOP_DAYS)
        yield Condition(f"{LOOPS}: weather, 100 % outdoor air", loops, WEATHER, LOOP_DAYS, outdoor=1.0)
    larger = loops.assign(C_w=1.5 * xr.DataArray(loops["C_w"]), C_c=2.0 * xr.DataArray(loops["C_c"]))
    yield Condition(f"{LOOPS}: larger coil", larger, STEPPED, LOOP_DAYS)
    yield Condition(f"{LOOPS}: gentler valve", loops.assign(valve_b=5.0), STEPPED, LOOP_DAYS)
    installed = loops.assign(rangeability=50.0, authority=0.05, m_full=2.0)
    yield Condition(f"{LOOPS}: authority 0.05", installed, STEPPED, LOOP_DAYS)
    yield Condition(f"{LOOPS}: backlash 2 %", four_loops([0.02]), STEPPED, LOOP_DAYS)
    yield Condition(f"{GOOD}, {LOOPS}: {LABELS[STEPPED]}", four_loops([0.0]), STEPPED, LOOP_DAYS)


def _of_valves() -> Iterator[Condition]:
    plain = valves()
    for kind in kinds():
        yield Condition(f"{VALVES}: {LABELS[kind]}", plain, kind, VALVE_DAYS)
    yield Condition(MORNING, plain, STEPPED, VALVE_DAYS, steps_for=4)
    draw, n = np.random.default_rng(SEED), int(plain.coordinates()["sample"].size)
    low = plain.assign(authority=("sample", loguniform(draw, 0.02, 0.1, n)))
    small = plain.assign(backlash=("sample", draw.uniform(0.005, 0.02, n)))
    yield Condition(LOW_AUTHORITY, low, STEPPED, VALVE_DAYS)
    yield Condition(SMALL, small, STEPPED, VALVE_DAYS)
    others = picked(runs.population(n), controller=0)
    yield Condition(ONE_DAY, others, STEPPED, VALVE_DAYS, hours=8)
    yield Condition(THREE_DAYS, others, STEPPED, VALVE_DAYS, hours=24)
    for kind in kinds():
        yield Condition(f"{GOOD}, {VALVES}: {LABELS[kind]}", plain.assign(backlash=0.0), kind, VALVE_DAYS)


PI, KNOWN, KNOWN_STROKE = "pi", "fixed_95", "identify_stroke"
METRICS = ("rmse", "rmse_settled", "motor_travel", "estimate_final", "time_identified", "status")
TWENTY, ONE = 0.2, 0.01
"""Right is what lies within 20 % of the backlash or, where the study says so, 1 % of the stroke."""
ROUND_OFF = 1e-9
HARM, WORSE = 0.01, 0.02
"""Rise of the RMSE of a loop that counts on a good valve, and on one with backlash."""


class Run(NamedTuple):
    """What came of a condition."""

    condition: Condition
    ds: xr.Dataset
    backlash: xr.DataArray

    @property
    def is_good(self) -> bool:
        """Whether the valves have no backlash."""
        return self.condition.name.startswith(GOOD)


@cache
def controllers() -> dict[str, dict[str, object]]:
    """The rows of the study: parameters by name."""
    return read_study(STUDY).tables["cases"]["controller"]  # type: ignore[no-any-return]


def run(size: int | None = None, chosen: Collection[str] | None = None) -> list[Run]:
    """Every controller under every condition, or the ``chosen``; ``size``: only so many loops and valves."""
    done, found = progress(), []
    for condition in conditions(size):
        if chosen is not None and condition.name not in chosen:
            continue
        ds = tried(condition)
        backlash = xr.DataArray(condition.loop["backlash"]).broadcast_like(ds.rmse.isel(controller=0, day=0, drop=True))
        found.append(Run(condition, ds, backlash))
        done(condition.name)
    return found


def tried(condition: Condition) -> xr.Dataset:
    """Metrics of every controller under a condition; the plant's gain comes from a step of the command."""
    gain = simc_gains(condition.loop, HEATING if condition.kind == HEATING else STEPPED).plant_gain
    loop, days = condition.loop.assign(plant_gain=gain), condition.days()
    stroke = {KNOWN_STROKE: {"identify_stroke_time": loop["stroke_time"]}}
    ran = {name: fc.simulate(loop.assign(**how | stroke.get(name, {})), days) for name, how in controllers().items()}
    return along("controller", {name: ds[list(METRICS)].reset_coords(drop=True) for name, ds in ran.items()})


def fails(run: Run, name: str, *, one: float = ONE) -> xr.DataArray:
    """Whether the last estimate of a day is wrong; one of NaN is.  one: what is always right, of the stroke."""
    tolerance = np.maximum(TWENTY * run.backlash, one) + ROUND_OFF
    return ~(abs(run.ds.estimate_final.sel(controller=name) - run.backlash) <= tolerance)


def change(run: Run, name: str, metric: str = "rmse") -> xr.DataArray:
    """By how much a metric of every loop, the mean of its days, differs from that of its plain PI; as a share of it."""
    of_loop = run.ds[metric].mean("day")
    return of_loop.sel(controller=name) / of_loop.sel(controller=PI) - 1.0


def harmed(run: Run, name: str) -> Share:
    """The share of loops that are worse than plain PI by more than may be."""
    return share_of(change(run, name) > (HARM if run.is_good else WORSE))

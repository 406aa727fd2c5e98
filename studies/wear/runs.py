"""Valves whose gap grows, and the sequences of days that stand for a year of their life.

No source gives the rate at which the gap of an HVAC valve grows.  It is chosen by its consequence: under its plain PI,
if the gap did not change how the stem moves, the gap of a valve would grow by so much in the year.
"""

from __future__ import annotations

import warnings
from functools import cache
from typing import NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.study.file.spec import read_study
from studies.common import HEATING_GAIN, STUDIES, concat_along, progress_printer
from studies.days import CONSTANT, HEATING, STEPPED, WEATHER_FILE, loop_settings, make_days
from studies.learning.learners_runs import RELATIVE_TOLERANCE, ROUND_OFF, STROKE_TOLERANCE
from studies.remedies.runs import select_loop
from studies.robustness.best_pi import simc_gains
from studies.year import operation

STUDY = STUDIES / "wear" / "wear.toml"
PI, KNOWN_ONCE = "pi", "known_once"
DAYS, HOURS = 24, 12
"""Days that stand for a year, and the hours of operation of each."""
DAYS_OF_YEAR = 365
FAN_HOURS = (6, 20)  # hours between which the fan of a real day runs
GROWTHS = (0.0, 0.01, 0.02, 0.04)  # of the gap in the year, fraction of stroke, as long as it does not feed on itself
LARGEST_WEAR_RATE = 0.01  # that a loop may have
LOOSE_FACTOR, REPAIRED_FACTOR = 2.0, 0.25
"""What the gap is multiplied by in the second third of the days, after a linkage came loose, and in the last."""
MONTHLY_STEPS, REAL_WEATHER = "weather, steps on one day in six", "weather"
FAST_FACTORS = {"kp": 2.5, "ti": 1.0 / 6.0}
"""What the gains of every valve are multiplied by, for loops of which many hunt."""
STEP_SIZE = 1.0  # of the set-point on a morning of steps, K, up and down every half hour for four hours


class Sequence(NamedTuple):
    """Loops, the days they live through, and how the gap changes: by wear, in steps, or there is none."""

    name: str
    kind: str
    is_fast: bool
    in_steps: bool
    is_good: bool
    seed: int


def sequences(seed: int) -> list[Sequence]:
    """Every kind of days; ``seed``: of the days."""
    all_sequences = [Sequence(kind, kind, False, False, False, seed) for kind in available_kinds()]
    all_sequences += [Sequence(f"{kind}, fast gains", kind, True, False, False, seed) for kind in (STEPPED, CONSTANT)]
    stepped_kinds = [kind for kind in available_kinds() if kind in (STEPPED, MONTHLY_STEPS)]
    all_sequences += [Sequence(f"{kind}, loose and repaired", kind, False, True, False, seed) for kind in stepped_kinds]
    return all_sequences + [Sequence(f"{kind}, no gap", kind, False, False, True, seed) for kind in available_kinds()]


def available_kinds() -> tuple[str, ...]:
    """The kinds of days; those of weather only where there is a weather file."""
    weather = (REAL_WEATHER, MONTHLY_STEPS) if WEATHER_FILE.is_file() else ()
    return (STEPPED, CONSTANT, *weather, HEATING)


@cache
def controllers() -> dict[str, dict[str, object]]:
    """Parameters of the study's controllers, and of an inverse that knows the gap of the first day."""
    study_controllers = dict(read_study(STUDY).tables["cases"]["controller"])
    buffer = {name: value for name, value in study_controllers["identify"].items() if name.startswith("buffer")}
    return {PI: study_controllers.pop(PI), KNOWN_ONCE: {"estimate_ratio": 0.95, **buffer}, **study_controllers}


@cache
def valves(size: int | None = None) -> fc.Loop:
    """The valves of the study under plain PI, without wear; the plant's gain is that of a step of each."""
    loop = select_loop(read_study(STUDY).plan.layout.loop, controller=0, sample=slice(0, size)).assign(wear_rate=0.0)
    return loop.assign(plant_gain=simc_gains(loop, STEPPED).plant_gain)


def sequence_loops(sequence: Sequence, size: int | None = None) -> fc.Loop:
    """Valves with the gains of the sequence."""
    loop = valves(size)
    factors = FAST_FACTORS if sequence.is_fast else {"kp": HEATING_GAIN} if sequence.kind == HEATING else {}
    parameters = {name: xr.DataArray(loop[name]) * factor for name, factor in factors.items()}
    if sequence.is_good:
        parameters["backlash"] = xr.zeros_like(xr.DataArray(loop["backlash"]))
    return loop.assign(**parameters, **loop_settings(sequence.kind))


def target_growths(loop: fc.Loop) -> xr.DataArray:
    """What the gap of each valve is to grow by in the year, fraction of stroke: the same share of all sizes."""
    n = xr.DataArray(loop["backlash"]).sizes["sample"]
    growth_indices = np.random.default_rng([7, n]).permutation(n) % len(GROWTHS)
    return xr.DataArray(np.array(GROWTHS)[growth_indices], dims="sample")


def wear_rates(growth: xr.DataArray, plain: xr.Dataset) -> xr.DataArray:
    """Wear of each valve by which its gap grows so far in the year; plain: that year under plain PI, without wear."""
    return np.minimum(growth / plain.stem_travel.sum("day").clip(1e-3), LARGEST_WEAR_RATE).reset_coords(drop=True)


def sequence_days(sequence: Sequence, n: int = DAYS) -> fc.Boundary:
    """The days of a sequence, each of the hours in which the fan runs."""
    labels = np.arange(sequence.seed, sequence.seed + n)
    if sequence.kind in (REAL_WEATHER, MONTHLY_STEPS):
        days = weather_days(labels, sequence.kind == MONTHLY_STEPS)
    else:
        days = make_days(sequence.kind, labels.tolist(), hours=HOURS)
    if not sequence.in_steps:
        return days
    scale = np.repeat([1.0, LOOSE_FACTOR, REPAIRED_FACTOR], -(-n // 3))[:n, None]
    return days.assign(backlash_scale=np.broadcast_to(scale, (n, days.n_steps)))


def weather_year(seed: int, days: list[int] | None = None) -> fc.Boundary:
    """Days of the weather file with a fixed set-point, of 24 h each; all of the year without ``days``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return operation.weather_year(
            WEATHER_FILE, year=2023, set_point="fixed", T_set=13.0, fan_hours=FAN_HOURS, weekend_fan_hours=FAN_HOURS,
            days=days,
            seed=seed,
        )  # fmt: skip


def weather_days(labels: np.ndarray, is_stepped: bool) -> fc.Boundary:
    """Days of a year of weather, evenly over it, from the start of the fan to its end."""
    days_of_year = np.linspace(0, DAYS_OF_YEAR, labels.size, endpoint=False).astype(int) + 1 + int(labels[0]) % 7
    year = weather_year(int(labels[0]), days_of_year.tolist())
    hours = slice(FAN_HOURS[0] * 3600, FAN_HOURS[1] * 3600)
    day_series = [{name: values[hours] for name, values in year.of_day(k).items()} for k in range(labels.size)]
    series = {name: np.stack([day_values[name] for day_values in day_series]) for name in day_series[0]}
    if is_stepped:
        start, seconds = 3 * 3600, np.arange(4 * 3600)
        series["T_set"][::6, start : start + seconds.size] += STEP_SIZE * (seconds // 1800 % 2)
    return fc.Boundary(**series, day=labels)


SEED = 20261122
FRESH_FIRST_DAY = 7301  # seed of the first day
METRICS = (
    "rmse", "estimate_final", "backlash_final", "stem_travel", "motor_travel", "reversals", "coil_energy",
    "reheat_energy", "recool_energy", "hunts", "status",
)  # fmt: skip


class Run(NamedTuple):
    """Result of a sequence."""

    sequence: Sequence
    ds: xr.Dataset
    """Metrics over controller, sample, day."""
    plain: xr.Dataset
    """Of the plain PI whose gap does not grow."""
    first_gap: xr.DataArray
    """Gap of the first day, fraction of stroke."""
    growth: xr.DataArray
    """That it was given, fraction of stroke in the year."""


def run(size: int | None = None, first_day: int = FRESH_FIRST_DAY, names: list[str] | None = None) -> list[Run]:
    """Run every controller on every sequence; ``size``: number of valves; ``names``: only these sequences."""
    report, results = progress_printer(), []
    for sequence in sequences(first_day):
        if names is None or sequence.name in names:
            results.append(simulate_sequence(sequence, size))
            report(sequence.name)
    return results


def simulate_sequence(sequence: Sequence, size: int | None = None) -> Run:
    """Simulate every controller on a sequence.  The wear rate of a valve follows from its travel under plain PI."""
    loop, days = sequence_loops(sequence, size), sequence_days(sequence)
    plain = _simulate_metrics(loop, days)
    growth = target_growths(loop) * (0.0 if sequence.in_steps or sequence.is_good else 1.0)
    loop = loop.assign(wear_rate=wear_rates(growth, plain))
    ds = concat_along(
        "controller",
        {name: _simulate_metrics(loop.assign(**parameters), days) for name, parameters in controllers().items()},
    )
    return Run(sequence, ds, plain, xr.DataArray(loop["backlash"]), growth)


def _simulate_metrics(loop: fc.Loop, days: fc.Boundary) -> xr.Dataset:
    ds = fc.simulate(loop, days, carry_over=True, seed=SEED)
    return ds[list(METRICS)].reset_coords(drop=True).assign_coords(day=np.arange(ds.sizes["day"]))


def is_wrong(run: Run, name: str) -> xr.DataArray:
    """Whether the estimate at the end of a day is off by over 20 % of the gap and 1 % of the stroke, or missing."""
    ds = run.ds.sel(controller=name)
    tolerance = np.maximum(RELATIVE_TOLERANCE * ds.backlash_final, STROKE_TOLERANCE) + ROUND_OFF
    return ~(abs(ds.estimate_final - ds.backlash_final) <= tolerance)


def relative_change(run: Run, name: str, metric: str = "rmse") -> xr.DataArray:
    """By how much a metric of every valve and day differs from that under plain PI; as a share of it."""
    return run.ds[metric].sel(controller=name) / run.ds[metric].sel(controller=PI) - 1.0


def yearly_change(run: Run, name: str, metric: str) -> xr.DataArray:
    """The change of a metric summed over the days of the sequence, by valve, as a share of that under plain PI."""
    total = run.ds[metric].sum("day")
    return total.sel(controller=name) / total.sel(controller=PI) - 1.0


def actual_growth(run: Run, name: str) -> xr.DataArray:
    """Growth of the gap from the first to the last day, fraction of stroke, by valve."""
    return run.ds.backlash_final.sel(controller=name).isel(day=-1) - run.first_gap

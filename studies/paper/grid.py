"""The simulations of the study: those behind the figures, and a grid of tunings on several kinds of days.

The loops are the presets, generic and searched for so that the paper's phenomena appear, not the paper's unpublished
fit, and for the grid gains × sample times × ideal and real loops.  Every simulation of the grid has the dim ``tuning``,
with the presets first, by name, and those on days the dim ``kind``.  Tunings that hunt without any backlash are tried
and counted, but left out of the shares.  Days of all kinds with the same seed share air flow, water and noise, so that
a claim is compared day by day.  Nothing is digitised from the paper's figures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.text import format_share
from fastcoil.loops.boundary.days import constant_day, design_day, paper_day
from fastcoil.loops.boundary.record import Boundary
from fastcoil.loops.clashes import is_stable
from fastcoil.loops.loop import Loop
from fastcoil.loops.presets import COOLING_PRESETS
from fastcoil.loops.provenance import content_sha256, provenance
from fastcoil.loops.simulate import simulate
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.model.physics import water_flow

Days = Callable[[float, Sequence[int]], Boundary]  # makes a day of so many hours from each seed
Kinds = Mapping[str, Days]

T_SET = 14.0  # where the set-point stands still, °C
DESIGN_TEMPERATURES = (33.3, 23.7)  # dry and wet bulb of a design day, °C: those of ``design_day``
MILDER_RANGE = (0.0, 6.0)  # by how much a design day is milder than the extreme, K: limits of what the seed draws
OUTDOOR_FRACTIONS = (0.2, 0.6)  # limits of the share of outdoor air that the seed draws
_SEED_STREAM = 20  # separates these draws from others with the same seed


def stepped_days(hours: float, seeds: Sequence[int]) -> Boundary:
    """Days as the paper's, with set-point steps every 30 min."""
    return paper_day(hours=hours, seed=list(seeds))


def constant_days(hours: float, seeds: Sequence[int]) -> Boundary:
    """The same days with a constant set-point."""
    return with_constant_set_point(stepped_days(hours, seeds), seeds)


def design_days(hours: float, seeds: Sequence[int]) -> Boundary:
    """Outdoor air of a design day, milder than the extreme and mixed as the seed draws, and a constant set-point."""
    air = []
    for seed in seeds:
        rng = np.random.default_rng([seed, _SEED_STREAM])
        milder, fraction = rng.uniform(*MILDER_RANGE), rng.uniform(*OUTDOOR_FRACTIONS)
        T_design, T_wet_bulb = (T - milder for T in DESIGN_TEMPERATURES)
        air.append(design_day(hours=hours, T_design=T_design, T_wet_bulb=T_wet_bulb, outdoor_fraction=fraction))
    return with_constant_set_point(stepped_days(hours, seeds), seeds, air)


def with_constant_set_point(days: Boundary, seeds: Sequence[int], air: Sequence[Boundary] = ()) -> Boundary:
    """Replace the set-point by a constant and, if given, the entering air by that of other days, one for each seed."""
    series = dict(days.series)
    series["T_set"] = np.full_like(series["m_a"], T_SET)
    for name in ("T_a_in", "W_a_in") if air else ():
        series[name] = np.concatenate([day.series[name] for day in air])
    return Boundary(**series, day=list(seeds))


KINDS: Kinds = {
    "stepped": stepped_days,
    "constant": constant_days,
    "design": design_days,
}  # kinds of days by name, the paper's first


def kind_in_words(days: Days) -> str:
    """Describe a kind of days, from its docstring."""
    return (days.__doc__ or "").strip().splitlines()[0].rstrip(".")


FIGURE_PRESETS = ("paper_like", "paper_like_fast")
BACKLASH = 0.07
STEP = 0.007
INTERVAL = 1800  # of the learner, s; it, BACKLASH and STEP are as printed in the paper
THREE_HOURS = 3 * 3600  # in less than this, the paper says, the rule finds the backlash
NOISE = 0.05  # standard deviation of the measurement noise, K: our choice, the paper gives none
BUFFER_SIGMAS = 6.0
"""Buffer in standard deviations Kp σ of the noise on the PI's output: our choice, the paper gives none."""
SEED = 2016  # seed of the measurement noise
FIGURE_DAY = 2000
BAND_DAYS = range(2000, 2010)  # seeds of the days: no other study of this repository uses them

RULES: dict[str, dict[str, Any]] = {
    "literal": {},
    "every 15 min": {"learning_interval": 900},
    "twice the step": {"learning_step": 2 * STEP, "backlash_estimate": 2 * STEP},
    "growing steps": {"learning_growth": 1.5, "learning_early_trip": 1, "learning_shrink": 0.5},
}
"""The learning rule as printed, and variants meant to be faster."""
LITERAL_RULE = {"learning_step": STEP, "backlash_estimate": STEP, "learning_interval": INTERVAL}


def buffers_by_case(loop: Loop, cases: Iterable[str], suffix: str = "buffer", noise: float = NOISE) -> xr.DataArray:
    """Buffers that keep most of the noise from turning the inverse in cases that end so; else the default."""
    names = list(cases)
    is_buffered = xr.DataArray([float(name.endswith(suffix)) for name in names], coords={"case": names})
    return (1 - is_buffered) * float(str(PARAMETERS["buffer"].default)) + is_buffered * (
        BUFFER_SIGMAS * noise * xr.DataArray(loop["kp"])
    )


def cases_along(dim: str, cases: Mapping[str, Mapping[str, Any]]) -> dict[str, xr.DataArray]:
    """Named alternatives zipped along ``dim``; a parameter that one of them does not give has its default there."""
    names = list(dict.fromkeys(n for case in cases.values() for n in case))
    labels = {dim: np.array(list(cases))}
    return {
        n: xr.DataArray([case.get(n, PARAMETERS[n].default) for case in cases.values()], dims=dim, coords=labels)
        for n in names
    }


def preset_loops() -> Loop:
    """The two loops of the figures along a dim ``preset``."""
    names = ("C_c", "kp", "ti", "sample_time")
    return Loop(**cases_along("preset", {p: {n: Loop.preset(p)[n] for n in names} for p in FIGURE_PRESETS}))


def simulate_valve_curves() -> xr.Dataset:
    """Fig 1: simulate the valve driven open and closed, with a small loop inside, in open loop."""
    knots = (0.0, 1.0, 0.0, 0.6, 0.4, 0.6, 0.5, 0.6, 0.0)
    seconds = 600
    command = np.interp(np.arange(seconds * (len(knots) - 1) + 1) / seconds, np.arange(len(knots)), knots)
    day = constant_day(hours=command.size / 3600)
    loop = Loop.preset(FIGURE_PRESETS[0]).assign(backlash=BACKLASH)
    return simulate(loop, day, command=command, traces=["command", "opening", "m_w"], warm_up=0, progress=False)


def simulate_tracking() -> xr.Dataset:
    """Figs 7, 9 and 10: simulate one day without backlash, with it, and with inverses of 60 % and 95 %."""
    cases = {"no backlash": {"backlash": 0.0, "backlash_estimate": 0.0}} | {
        name: {"backlash": BACKLASH, "backlash_estimate": ratio * BACKLASH}
        for name, ratio in (("plain PI", 0.0), ("60 %", 0.6), ("95 %", 0.95))
    }
    day = paper_day(hours=8, seed=FIGURE_DAY)
    loop = preset_loops().assign(**cases_along("case", cases))
    ds = simulate(loop, day, traces=["T_sup", "command", "opening"], trace_interval=10, progress=False)
    attrs = {"long_name": "set-point of the supply air temperature", "units": "degC"}
    ds["T_set"] = ("elapsed_time", day.series["T_set"][0][ds["elapsed_time"].values.astype(int)], attrs)
    return with_new_hash(ds)


def simulate_estimates(*, quick: bool = False, n_jobs: int | None = None) -> xr.Dataset:
    """Fig 11: simulate estimates of 0 to 150 % over days and noise realisations: no noise, noise, noise and buffer."""
    noise = {"no noise": 0.0, "noise": NOISE, "noise, buffer": NOISE}
    loop = preset_loops().assign(backlash=BACKLASH, estimate_ratio=np.linspace(0.0, 1.5, 7 if quick else 31))
    loop = loop.assign(**cases_along("case", {name: {"noise_std": std} for name, std in noise.items()}))
    loop = loop.assign(buffer=buffers_by_case(loop, noise))
    days = paper_day(hours=8, seed=BAND_DAYS[:2] if quick else BAND_DAYS)
    return simulate(loop, days, seed=SEED, replicates=2 if quick else 3, n_jobs=n_jobs, progress=False)


def simulate_staircases() -> xr.Dataset:
    """Fig 12: simulate the learned estimate by rule, and the switches that it saw in blocks of 10 min."""
    rules = {name: LITERAL_RULE | rule for name, rule in RULES.items()}
    loop = preset_loops().assign(backlash=BACKLASH, **cases_along("rule", rules))
    day, interval, block = paper_day(hours=8, seed=FIGURE_DAY), 10, 600
    ds = simulate(loop, day, traces=["estimate", "mode"], trace_interval=interval, progress=False)
    has_switched = ds["mode"] != ds["mode"].shift(elapsed_time=1, fill_value=-1)  # the first rise counts
    blocks = (
        has_switched.coarsen(elapsed_time=block // interval, boundary="trim").sum().rename(elapsed_time="block_start")
    )
    start = block * np.arange(blocks.sizes["block_start"], dtype=float)
    blocks = blocks.assign_coords(block_start=("block_start", start, {"long_name": "start of a block", "units": "s"}))
    ds["switches"] = blocks.astype(float).assign_attrs({"long_name": f"mode switches in {block} s", "units": "1"})
    return with_new_hash(ds.drop_vars("mode"))


def with_new_hash(ds: xr.Dataset, **attrs: Any) -> xr.Dataset:
    """Add attributes to the Dataset, and renew the hash of its content."""
    ds = ds.assign_attrs(attrs)
    ds.attrs["content_sha256"] = content_sha256(ds)
    return ds


def explain_three_hours() -> str:
    """Explain from the paper's own numbers why the literal rule cannot keep three hours."""
    steps, updates = round((BACKLASH - STEP) / STEP), (THREE_HOURS - 1) // INTERVAL
    hours_reached, hours_confirmed = (n * INTERVAL / 3600 for n in (steps, steps + 2))
    sizes = (STEP, BACKLASH, BACKLASH + STEP, (updates + 1) * STEP)
    start, backlash, tried_size, largest_size = (format_share(size, decimals=1) for size in sizes)
    return (
        f"From {start}, {steps} steps of {start} every {INTERVAL // 60} min are needed to reach {backlash}: "
        f"{steps} × {INTERVAL / 3600:g} h = {hours_reached:g} h, and {hours_confirmed:g} h until {tried_size} has "
        f"been tried and taken back.  In less than {THREE_HOURS // 3600} h there are {updates} updates, which lead to "
        f"{largest_size} at most."
    )


REAL_LOOP = {n: Loop.preset("lbnl")[n] for n in ("C_c", "sensor_time_constant", "stroke_time")}
DAYS = range(2030, 2040)
LONG_DAYS = range(2040, 2050)
SEARCH_DAYS = range(2020, 2022)  # seeds of the days of each kind; no other study of this repository uses them
BEST_KP, BEST_TI = np.geomspace(0.002, 0.4, 12), np.geomspace(5.0, 600.0, 10)
"""Gains among which the best ones are sought."""
SEARCH_NOISE = 0.02  # measurement noise of the search, K: without any, the fastest gains look better than they are
DEAD_BAND = 0.2  # error dead band of the PI that the inverse is compared with, K
GAIN_NAMES = ("kp", "ti")
PLANT_NAMES = ("C_c", "sensor_time_constant", "stroke_time", "sample_time")
"""What differs between tunings: gains, and what they are gains for."""
RATIOS = (0.0, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.0, 1.1, 1.2, 1.5)  # estimates relative to the backlash
STARTS_AND_STEPS = ((0.001, 0.0035), (0.007, 0.007), (0.02, 0.007), (0.001, 0.014), (0.028, 0.028))
"""Initial guess and step of the learner; the first pair needs 10 h to reach the backlash."""
LONG_HOURS = 24
QUIET_HOURS = 6
STEP_AT = 3 * 3600
T_BEFORE, T_AFTER = 14.0, 15.0
"""Hours of the quiet day, and its only event: a set-point step at this second, from and to these temperatures (°C)."""
HUNTING_SWING = 0.1
"""Peak-to-peak supply temperature in the last hour of the quiet day above which a loop hunts, if it crosses the
set-point, K."""
MOST_VOLUMES = 30


def tunings(*, quick: bool = False) -> Loop:
    """Loops of the presets, then of the grid, along the dim ``tuning``."""
    n = 2 if quick else 8
    # all with the march that the paper prints
    varied = sorted({name for preset in COOLING_PRESETS.values() for name in preset.values} - {"air_march"})
    cases: dict[str, Mapping[str, Any]] = {p: {name: Loop.preset(p)[name] for name in varied} for p in COOLING_PRESETS}
    sample_times = (5.0, 30.0) if quick else (1.0, 5.0, 10.0, 15.0, 30.0, 60.0)
    kp, ti = np.geomspace(0.005, 0.08, n), np.geomspace(5.0, 600.0, n)
    for (kind, plant), Ts, K, T in product((("ideal", {}), ("real", REAL_LOOP)), sample_times, kp, ti):
        values = {"sample_time": Ts, "kp": float(f"{K:.3g}"), "ti": float(f"{T:.3g}")}
        name = f"{kind} loop, kp={values['kp']:g}, ti={values['ti']:g}, sample_time={Ts:g}"
        cases[name] = values | plant
    return Loop(**cases_along("tuning", cases))


def preset_labels(tuning: xr.DataArray) -> list[str]:
    """Find the presets among the labels of ``tuning``."""
    return [name for name in COOLING_PRESETS if name in tuning.values]


def simulate_quiet_day(loop: Loop, n_jobs: int | None = None) -> xr.Dataset:
    """Simulate the quiet day: overshoot without backlash, and whether the loop hunts by itself, without and with it."""
    T_set = np.full(QUIET_HOURS * 3600, T_BEFORE)
    T_set[STEP_AT:] = T_AFTER
    day = constant_day(hours=QUIET_HOURS, T_set=T_set)
    swept = loop.assign(**cases_along("case", {"no backlash": {"backlash": 0.0}, "plain PI": {"backlash": BACKLASH}}))
    ds = simulate(swept, day, traces=["T_sup"], trace_interval=5, n_jobs=n_jobs, progress=False)
    peak = ds["T_sup"].sel(case="no backlash", elapsed_time=slice(STEP_AT, None)).max("elapsed_time")
    last_hour = ds["T_sup"].sel(elapsed_time=slice((QUIET_HOURS - 1) * 3600, None))
    low, high = last_hour.min("elapsed_time"), last_hour.max("elapsed_time")
    hunts = (high - low > HUNTING_SWING) & (low < T_AFTER) & (high > T_AFTER)
    overshoot = ((peak - T_AFTER) / (T_AFTER - T_BEFORE)).drop_vars("case")
    ds["overshoot"] = overshoot.assign_attrs(long_name="overshoot of a set-point step without backlash", units="1")
    ds["swing"] = (high - low).assign_attrs(long_name="peak-to-peak T_sup in the last hour", units="K")
    comment = f"swing above {HUNTING_SWING} K across the set-point"
    ds["hunts"] = hunts.assign_attrs(long_name="hunts by itself", units="1", comment=comment)
    return with_new_hash(ds.drop_vars(["T_sup", "elapsed_time"]))


def best_gains(loop: Loop, kinds: Kinds = KINDS, *, quick: bool = False, n_jobs: int | None = None) -> dict[str, Loop]:
    """The tunings with the best gains for the same plant and sample time: of the plain PI, and of the inverse of 95 %.

    Best is the lowest mean, over the kinds of days, of the RMSE relative to the lowest one on that kind, of all gains
    with which the loop does not hunt without backlash: a new valve must not make it hunt.
    """
    tuning = xr.DataArray(loop["kp"])["tuning"]
    rows, plant_of_tuning = np.unique([loop[n] for n in PLANT_NAMES], axis=1, return_inverse=True)
    plants = Loop(**{n: xr.DataArray(row, dims="coil") for n, row in zip(PLANT_NAMES, rows, strict=True)})
    kp, ti = (values[::4] if quick else values for values in (BEST_KP, BEST_TI))
    cases = {
        "no backlash": {"backlash": 0.0, "backlash_estimate": 0.0},
        "best PI": {"backlash": BACKLASH, "backlash_estimate": 0.0},
        "best inverse": {"backlash": BACKLASH, "backlash_estimate": 0.95 * BACKLASH},
    }
    swept = plants.assign(noise_std=SEARCH_NOISE, kp=kp, ti=ti, **cases_along("case", cases))
    swept = swept.assign(buffer=buffers_by_case(swept, cases, "best inverse", SEARCH_NOISE))
    ds = simulate_kinds(swept, kinds, 4 if quick else 8, SEARCH_DAYS, n_jobs)
    is_ringing = (ds["hunts"].sel(case="no backlash", drop=True) > 0.0).any(["kind", "day"])
    cost = relative_cost(ds["rmse"].where(~is_ringing)).stack(gains=GAIN_NAMES).transpose("case", "coil", "gains")
    best = {}
    for name in ("best PI", "best inverse"):
        pairs = cost["gains"].values[cost.sel(case=name).argmin("gains").values[np.ravel(plant_of_tuning)]]
        gains = zip(GAIN_NAMES, zip(*pairs, strict=True), strict=True)
        best[name] = loop.assign(**{n: xr.DataArray(list(column), coords={"tuning": tuning}) for n, column in gains})
    return best


def relative_cost(error: xr.DataArray) -> xr.DataArray:
    """Mean, over the kinds of days, of the error relative to that of the best gains on that kind; failed is worst."""
    of_kind = error.fillna(np.inf).mean("day")
    return (of_kind / of_kind.min(GAIN_NAMES)).mean("kind")


def simulate_kinds(
    loop: Loop, kinds: Kinds, hours: float, seeds: Sequence[int], n_jobs: int | None = None
) -> xr.Dataset:
    """Simulate days of every kind, along a dim ``kind``; the kinds have the same seeds and the same noise."""
    datasets = [simulate(loop, days(hours, seeds), seed=SEED, n_jobs=n_jobs, progress=False) for days in kinds.values()]
    labels = xr.DataArray(list(kinds), dims="kind", name="kind")
    concat_options: Any = {
        "data_vars": "all",
        "coords": "minimal",
        "compat": "override",
        "combine_attrs": "drop_conflicts",
    }
    return with_new_hash(xr.concat(datasets, labels, **concat_options))


def simulate_days(
    loop: Loop, best: Mapping[str, Loop], kinds: Kinds = KINDS, *, quick: bool = False, n_jobs: int | None = None
) -> xr.Dataset:
    """Simulate days: no backlash, plain PIs and inverses of all estimates, without noise, with it, and with a buffer.

    ``best``: loops with the best gains, for the cases whose names begin with theirs.
    """
    cases: dict[str, dict[str, float]] = {"no backlash": {"backlash": 0.0}}
    cases |= {case_label(ratio): {"backlash_estimate": ratio * BACKLASH} for ratio in RATIOS}
    cases |= {"plain PI, noise": {}, "dead band": {"error_dead_band": DEAD_BAND}, "best PI": {}, "best PI, noise": {}}
    for name in ("95 %, noise", "95 %, noise, buffer", "best PI, 95 %", "best inverse", "best inverse, noise, buffer"):
        cases[name] = {"backlash_estimate": 0.95 * BACKLASH}
    for name, values in cases.items():
        values.setdefault("backlash", BACKLASH)
        values["noise_std"] = NOISE if "noise" in name else 0.0
    names = xr.DataArray(list(cases), coords={"case": list(cases)})
    gains = {n: xr.DataArray(loop[n]) for n in GAIN_NAMES}
    for name, best_loop in best.items():
        gains = {n: xr.DataArray(best_loop[n]).where(names.str.startswith(name), gains[n]) for n in GAIN_NAMES}
    swept = loop.assign(**cases_along("case", cases), **gains)
    return simulate_kinds(
        swept.assign(buffer=buffers_by_case(swept, cases)), kinds, 8, DAYS[:2] if quick else DAYS, n_jobs
    )


def case_label(ratio: float) -> str:
    """Label of an estimate, relative to the backlash, without noise."""
    return format_share(ratio) if ratio else "plain PI"


def simulate_learning(
    loop: Loop, kinds: Kinds = KINDS, *, quick: bool = False, n_jobs: int | None = None
) -> xr.Dataset:
    """Simulate the learning rule as printed, faster variants, and the printed rule with noise and with a buffer."""
    cases = {name: LITERAL_RULE | rule for name, rule in RULES.items()}
    cases |= {name: LITERAL_RULE | {"noise_std": NOISE} for name in ("noise", "noise, buffer")}
    swept = loop.assign(backlash=BACKLASH, **cases_along("case", cases), buffer=buffers_by_case(loop, cases))
    return simulate_kinds(swept, kinds, 8, DAYS[:2] if quick else DAYS, n_jobs)


def start_in_words(start: float, step: float) -> str:
    """An initial guess of the learner and its step."""
    return f"{format_share(start, decimals=1)} by {format_share(step, decimals=2)}"


def simulate_starts(loop: Loop, kinds: Kinds = KINDS, *, quick: bool = False, n_jobs: int | None = None) -> xr.Dataset:
    """Simulate the printed rule from several initial guesses with several steps, on days long enough for all."""
    cases = {
        f"from {start_in_words(start, step)}": LITERAL_RULE | {"backlash_estimate": start, "learning_step": step}
        for start, step in (STARTS_AND_STEPS[1:3] if quick else STARTS_AND_STEPS)
    }
    swept = loop.assign(backlash=BACKLASH, **cases_along("case", cases))
    return simulate_kinds(swept, kinds, 12 if quick else LONG_HOURS, LONG_DAYS[:2] if quick else LONG_DAYS, n_jobs)


def find_stable_volumes(*, quick: bool = False) -> xr.Dataset:
    """Find the numbers of control volumes with which a coil is stable at 1 s: presets, then water contents × flows."""
    n = 3 if quick else 24
    names = ("C_w", "C_c", "m_max")
    cases: dict[str, Mapping[str, Any]] = {p: {name: Loop.preset(p)[name] for name in names} for p in COOLING_PRESETS}
    for C_w, m_max in product(np.geomspace(4.0, 20.0, n), np.geomspace(1.0, 4.0, n)):
        cases[f"C_w={C_w:.3g}, m_max={m_max:.3g}"] = {"C_w": float(C_w), "m_max": float(m_max)}
    loop = Loop(**cases_along("tuning", cases), n_volumes=list(range(1, MOST_VOLUMES + 1)))
    ds = is_stable(loop, paper_day(hours=8, seed=DAYS[0])).to_dataset(name="stable")
    ds["stable"].attrs = {"long_name": "γ ≤ 1 and λ ≤ 1 at dt = 1 s", "units": "1"}
    largest = ds["n_volumes"].where(ds["stable"]).max("n_volumes")
    a, b, c = (loop[n] for n in ("valve_a", "valve_b", "valve_c"))
    flow = [water_flow(1.0, m_max, a, b, c) for m_max in ds["m_max"].values]
    ds["full_flow"] = ("tuning", flow, {"long_name": "water flow of the open valve, Eq (2)", "units": "kg s-1"})
    ds["largest"] = largest.assign_attrs(long_name="largest stable number of control volumes", units="1")
    return with_new_hash(ds, title="largest stable numbers of control volumes", **provenance())

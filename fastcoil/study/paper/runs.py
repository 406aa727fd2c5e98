"""The simulations behind the paper's figures, as labelled Datasets.

All of them run on the presets ``paper_like`` and ``paper_like_fast``: generic loops, searched for so that the
paper's phenomena appear, not the paper's unpublished fit.  Nothing is digitised from its figures.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.loops.boundary.days import constant_day, paper_day
from fastcoil.loops.loop import Loop
from fastcoil.loops.provenance import content_sha256
from fastcoil.loops.simulate import simulate
from fastcoil.model.parameter_table import PARAMETERS

FIGURE_PRESETS = ("paper_like", "paper_like_fast")
BACKLASH = 0.07
STEP = 0.007
INTERVAL = 1800
"""Backlash, step and interval of the learner: as printed in the paper."""
THREE_HOURS = 3 * 3600
"""In less than this, the paper says, the rule finds the backlash."""
NOISE = 0.05
"""Standard deviation of the measurement noise, K: our choice, the paper gives none."""
BUFFER_SIGMAS = 6.0
"""Buffer in standard deviations Kp σ of the noise on the PI's output: our choice, the paper gives none."""
SEED = 2016
"""Seed of the measurement noise."""
FIGURE_DAY = 2000
BAND_DAYS = range(2000, 2010)
"""Seeds of the days: no other study of this repository uses them."""

RULES: dict[str, dict[str, Any]] = {
    "literal": {},
    "every 15 min": {"learning_interval": 900},
    "twice the step": {"learning_step": 2 * STEP, "backlash_estimate": 2 * STEP},
    "growing steps": {"learning_growth": 1.5, "learning_early_trip": 1, "learning_shrink": 0.5},
}
"""The learning rule as printed, and variants meant to be faster."""
LITERAL = {"learning_step": STEP, "backlash_estimate": STEP, "learning_interval": INTERVAL}


def percent(share: float, digits: int = 0) -> str:
    """Write a share in per cent."""
    return f"{100 * share:.{digits}f} %"


def buffers(is_buffered: xr.DataArray, loop: Loop, noise: float = NOISE) -> xr.DataArray:
    """Buffers that keep most of the noise from turning the inverse where ``is_buffered`` is 1; else the default."""
    wide = BUFFER_SIGMAS * noise * xr.DataArray(loop["kp"])
    return (1 - is_buffered) * float(str(PARAMETERS["buffer"].default)) + is_buffered * wide


def along(dim: str, cases: Mapping[str, Mapping[str, Any]]) -> dict[str, xr.DataArray]:
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
    return Loop(**along("preset", {p: {n: Loop.preset(p)[n] for n in names} for p in FIGURE_PRESETS}))


def valve_curves() -> xr.Dataset:
    """Fig 1: simulate the valve driven open and closed, with a small loop inside, in open loop."""
    knots = (0.0, 1.0, 0.0, 0.6, 0.4, 0.6, 0.5, 0.6, 0.0)
    seconds = 600
    command = np.interp(np.arange(seconds * (len(knots) - 1) + 1) / seconds, np.arange(len(knots)), knots)
    day = constant_day(hours=command.size / 3600)
    loop = Loop.preset(FIGURE_PRESETS[0]).assign(backlash=BACKLASH)
    return simulate(loop, day, command=command, traces=["command", "opening", "m_w"], warm_up=0, progress=False)


def tracking() -> xr.Dataset:
    """Figs 7, 9 and 10: simulate one day without backlash, with it, and with inverses of 60 % and 95 %."""
    cases = {"no backlash": {"backlash": 0.0, "backlash_estimate": 0.0}} | {
        name: {"backlash": BACKLASH, "backlash_estimate": ratio * BACKLASH}
        for name, ratio in (("plain PI", 0.0), ("60 %", 0.6), ("95 %", 0.95))
    }
    day = paper_day(hours=8, seed=FIGURE_DAY)
    loop = preset_loops().assign(**along("case", cases))
    ds = simulate(loop, day, traces=["T_sup", "command", "opening"], trace_interval=10, progress=False)
    return with_set_point(ds, day)


def with_set_point(ds: xr.Dataset, day: Any) -> xr.Dataset:
    """Add the set-point at the points of the traces."""
    points = ds["elapsed_time"].values.astype(int)
    attrs = {"long_name": "set-point of the supply air temperature", "units": "degC"}
    ds["T_set"] = ("elapsed_time", day.series["T_set"][0][points], attrs)
    return rehashed(ds)


def estimates(*, quick: bool = False, n_jobs: int | None = None) -> xr.Dataset:
    """Fig 11: simulate estimates of 0 to 150 % over days and noise realisations: no noise, noise, noise and buffer."""
    loop = preset_loops()
    cases = ("no noise", "noise", "noise, buffer")
    labels = {"case": np.array(cases)}
    is_buffered = xr.DataArray([0.0, 0.0, 1.0], dims="case", coords=labels)
    loop = loop.assign(
        backlash=BACKLASH,
        estimate_ratio=np.linspace(0.0, 1.5, 7 if quick else 31),
        noise_std=xr.DataArray([0.0, NOISE, NOISE], dims="case", coords=labels),
        buffer=buffers(is_buffered, loop),
    )
    days = paper_day(hours=8, seed=BAND_DAYS[:2] if quick else BAND_DAYS)
    return simulate(loop, days, seed=SEED, replicates=2 if quick else 3, n_jobs=n_jobs, progress=False)


def staircases() -> xr.Dataset:
    """Fig 12: simulate the learned estimate by rule, and the switches that it saw in blocks of 10 min."""
    rules = {name: LITERAL | rule for name, rule in RULES.items()}
    loop = preset_loops().assign(backlash=BACKLASH, **along("rule", rules))
    ds = simulate(
        loop, paper_day(hours=8, seed=FIGURE_DAY), traces=["estimate", "mode"], trace_interval=10, progress=False
    )
    ds["switches"] = switches_per_block(ds["mode"])
    return rehashed(ds.drop_vars("mode"))


def switches_per_block(mode: xr.DataArray, seconds: int = 600) -> xr.DataArray:
    """Count the mode switches in every block of ``seconds``; the first rise counts."""
    step = int(mode["elapsed_time"][1] - mode["elapsed_time"][0])
    turned = mode != mode.shift(elapsed_time=1, fill_value=-1)
    blocks = turned.coarsen(elapsed_time=seconds // step, boundary="trim").sum()
    blocks = blocks.rename(elapsed_time="block_start")
    start = seconds * np.arange(blocks.sizes["block_start"], dtype=float)
    blocks = blocks.assign_coords(block_start=("block_start", start, {"long_name": "start of a block", "units": "s"}))
    return blocks.astype(float).assign_attrs({"long_name": f"mode switches in {seconds} s", "units": "1"})


def rehashed(ds: xr.Dataset, **attrs: Any) -> xr.Dataset:
    """The Dataset with more attributes, and with the hash of its present content."""
    ds = ds.assign_attrs(attrs)
    ds.attrs["content_sha256"] = content_sha256(ds)
    return ds


def arithmetic() -> str:
    """Why the literal rule cannot keep the paper's three hours, by its own numbers."""
    steps = round((BACKLASH - STEP) / STEP)
    reached, known = steps * INTERVAL, (steps + 2) * INTERVAL
    updates = (THREE_HOURS - 1) // INTERVAL
    start, backlash = percent(STEP, 1), percent(BACKLASH, 1)
    return (
        f"From {start}, {steps} steps of {start} every {INTERVAL // 60} min are needed to reach {backlash}: "
        f"{steps} × {INTERVAL / 3600:g} h = {reached / 3600:g} h, and {known / 3600:g} h until "
        f"{percent(BACKLASH + STEP, 1)} has been tried and taken back.  In less than {THREE_HOURS // 3600} h there are "
        f"{updates} updates, which lead to {percent((updates + 1) * STEP, 1)} at most."
    )

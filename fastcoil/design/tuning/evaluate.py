"""Tunings tried on valves and days: every tuning of a generation in one sweep."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.design.tuning.measures import MARGIN, Measure
from fastcoil.design.tuning.predicted import margins, theory_sha256
from fastcoil.design.tuning.space import Space
from fastcoil.design.tuning.split import TUNING, VALVE, Group
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop, words_used
from fastcoil.loops.simulate import simulate
from fastcoil.model.numerics.jit import model_sha256

_MOST_AT_ONCE = 200_000
"""Scenarios of one sweep: bounds the memory that a generation takes."""


class Run(NamedTuple):
    """How every tuning is tried; none of the numbers depends on ``n_jobs``."""

    warm_up: int
    seed: int
    replicates: int
    n_jobs: int


def tried(group: Group, space: Space, values: Array, run: Run, measures: Sequence[Measure]) -> dict[str, Array]:
    """Metrics of tunings (n, d) on a group: metric → (n, day, valve, replicate)."""
    per_tuning = len(group.members) * group.boundary.n_days * run.replicates
    step = max(1, _MOST_AT_ONCE // per_tuning)
    metrics = list(dict.fromkeys(measure.metric for measure in measures))
    parts = [_swept(group, space, values[k : k + step], run, metrics) for k in range(0, len(values), step)]
    return {metric: np.concatenate([part[metric] for part in parts]) for metric in metrics}


def _swept(group: Group, space: Space, values: Array, run: Run, metrics: Sequence[str]) -> dict[str, Array]:
    given = {name: (TUNING, values[:, k]) for k, name in enumerate(space.names)}
    return _cases(group.loop.assign(**given), group.boundary, run, metrics)


def as_it_is(
    group: Group, run: Run, measures: Sequence[Measure], own: Mapping[str, Array] | None = None
) -> dict[str, Array]:
    """The same for the loop as it came, or with each valve's ``own`` gains, (valve,): metric → (1, day, …)."""
    changes = {name: (VALVE, values) for name, values in (own or {}).items()}
    metrics = list(dict.fromkeys(measure.metric for measure in measures))
    return _cases(group.loop.assign(**changes) if own else group.loop, group.boundary, run, metrics)


def _cases(loop: Loop, boundary: Boundary, run: Run, metrics: Sequence[str]) -> dict[str, Array]:
    ds = simulate(
        loop, boundary, warm_up=run.warm_up, seed=run.seed, replicates=run.replicates, n_jobs=run.n_jobs,
        progress=False,
    )  # fmt: skip
    order = (TUNING, "day", VALVE, "replicate")
    found = {metric: ds[metric] for metric in metrics if metric != MARGIN}
    if MARGIN in metrics:
        found[MARGIN] = margins(loop, boundary, run.warm_up)
    return {metric: _all_dims(values, order) for metric, values in found.items()}


def _all_dims(values: xr.DataArray, order: Sequence[str]) -> Array:
    missing = [dim for dim in order if dim not in values.dims]
    return np.asarray(values.reset_coords(drop=True).expand_dims(missing).transpose(*order).values, dtype=float)


def measured(cases: Mapping[str, Array], measures: Sequence[Measure]) -> dict[str, Array]:
    """The measures (n,) from metrics of all cases (n, …)."""
    return {m.name: m.of(cases[m.metric].reshape(len(cases[m.metric]), -1)) for m in measures}


def key_of(group: Group, space: Space, run: Run, measures: Sequence[Measure]) -> str:
    """Hash of everything that decides what is measured of a tuning: the model, the valves, the days, the noise."""
    loop = group.loop
    digest = hashlib.sha256(model_sha256(frozenset(words_used(loop, "estimator"))).encode())
    known = {name: value for name, value in loop.constants.items() if name not in space.names}
    parts = [json.dumps(known), group.boundary.sha256, json.dumps([run.warm_up, run.seed, run.replicates])]
    parts += [json.dumps([measure.name for measure in measures]), json.dumps(space.names)]
    parts += [theory_sha256() for measure in measures if measure.metric == MARGIN]
    parts += [rule.code_sha256 for rule in loop.rules.values()]
    digest.update("\0".join(parts).encode())
    for name, value in loop.swept.items():
        if name not in space.names:
            digest.update(f"{name}{value.values.tolist()}".encode())
    return digest.hexdigest()

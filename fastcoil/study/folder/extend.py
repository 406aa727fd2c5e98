"""Extending a study: what was computed before is found again by what it depends on, and only the rest is run."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.engine.lanes import parameter_matrix
from fastcoil.errors import InputError
from fastcoil.outputs import STATUS_NOT_RUN
from fastcoil.simulation.loop import Loop
from fastcoil.simulation.plan import Plan, simulation_attributes
from fastcoil.simulation.scenarios import columns_of

_AT_ONCE = 10_000
_SAME = {
    "seed": "[run] seed",
    "warm_up_s": "[run] warm_up",
    "rng": "the random numbers",
    "traces": "[run] traces",
    "reduction_sha256": "[run] reduce",
    "model_sha256": "the sources of the model",
}
"""What a scenario depends on besides its parameters and its day."""


def reusable(plan: Plan, attrs: dict[str, Any], earlier: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Flat indices (in ``earlier``, in ``plan``) of the scenarios that both have and that were run.

    attrs: those that the results of ``plan`` will have.

    Raises
    ------
    InputError
        If the study depends on something else than ``earlier`` did, or would drop a scenario of it.
    """
    attrs = simulation_attributes(plan) | attrs
    differs = [words for name, words in _SAME.items() if str(attrs.get(name)) != str(earlier.attrs.get(name))]
    if differs:
        raise InputError(
            f"--extend: {' and '.join(differs)} changed, so that nothing can be kept: choose another folder with -o"
        )
    new = {key: k for k, key in enumerate(_keys(plan.layout.loop, plan.layout.sizes, json.loads(attrs["day_sha256"])))}
    sizes = {str(d): n for d, n in earlier["status"].sizes.items()}
    old = _keys(Loop.from_dataset(earlier), sizes, json.loads(earlier.attrs["day_sha256"]))
    place = np.array([new.get(key, -1) for key in old])
    dropped = int((place < 0).sum())
    if dropped:
        raise InputError(
            f"--extend: {dropped:,} of the {place.size:,} scenarios in the folder are not in the study any more: keep "
            "all values and add to them (a Latin hypercube of another size shares no point: use sobol or random), "
            "or choose another folder with -o"
        )
    run = np.flatnonzero(earlier["status"].values.ravel() != STATUS_NOT_RUN)
    return run, place[run]


def as_part(earlier: xr.Dataset, old: np.ndarray, new: np.ndarray, n_volumes: int) -> xr.Dataset:
    """The scenarios ``old`` of an earlier result as a flat part of a study in which they are ``new``.

    n_volumes: the largest number of volumes there; the earlier result may have had only smaller coils.
    """
    dims = earlier["status"].dims
    part = xr.Dataset(coords={"scenario": new})
    for name, variable in earlier.data_vars.items():
        values = variable.values.reshape(-1, *variable.shape[len(dims) :])
        part[name] = (("scenario", *variable.dims[len(dims) :]), values[old], variable.attrs)
    part = part.assign_coords({n: c for n, c in earlier.coords.items() if n in part.dims and n != "scenario"})
    if "volume" in part.dims and part.sizes["volume"] < n_volumes:
        part = part.reindex(volume=np.arange(1, n_volumes + 1))
    return part


def _keys(loop: Loop, sizes: dict[str, int], days: list[str]) -> list[bytes]:
    """One hash per scenario, over all that its result depends on."""
    n = int(np.prod(list(sizes.values()), dtype=np.int64))
    keys = []
    for start in range(0, n, _AT_ONCE):
        columns = columns_of(loop, sizes, np.arange(start, min(start + _AT_ONCE, n)))
        rows = np.ascontiguousarray(parameter_matrix(columns).T)
        for row, day in zip(rows, columns["day"], strict=True):
            keys.append(hashlib.blake2b(row.tobytes() + days[day].encode(), digest_size=16).digest())
    return keys

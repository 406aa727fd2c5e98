"""Which scenarios of an earlier result a study has too, found by everything their outcome depends on."""

from __future__ import annotations

import hashlib
import json
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import Plan
from fastcoil.loops.scenarios import columns_of
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.metric_table import STATUS_NOT_RUN
from fastcoil.model.numerics.jit import same_model
from fastcoil.model.user_rules.rule import KINDS
from fastcoil.model.user_rules.same_code import refuse_other_code

_AT_ONCE = 10_000
_MUST_AGREE = {
    "seed": "[run] seed",
    "warm_up_s": "[run] warm_up",
    "carry_over": "[run] carry_over",
    "rng": "the random numbers",
    "traces": "[run] traces",
    "reduction_sha256": "[run] reduce",
}
"""What a scenario depends on besides its parameters and its day: attribute and its name in messages."""


class Match(NamedTuple):
    """Flat indices, equally many, of the scenarios that were run: in the earlier result and in the study."""

    old: np.ndarray
    new: np.ndarray


def match_scenarios(plan: Plan, attrs: dict[str, Any], earlier: xr.Dataset) -> Match:
    """Match the scenarios of an earlier result with those of a plan, whose results will have the attributes ``attrs``.

    Raises
    ------
    InputError
        If something else changed on which the results depend, or the plan lacks a scenario of ``earlier``.
    """
    differs = [words for name, words in _MUST_AGREE.items() if str(attrs.get(name)) != str(earlier.attrs.get(name))]
    if not same_model(str(attrs.get("model_sha256")), str(earlier.attrs.get("model_sha256"))):
        differs.append("the sources of the model")
    if differs:
        raise InputError(
            f"--extend: {' and '.join(differs)} changed, so that nothing can be kept: choose another folder with -o"
        )
    now, before = _rules(attrs), _rules(earlier.attrs)
    own_code = json.loads(attrs.get("own_code", "{}"))
    # of a rule with another source the scenarios are no longer in the study
    refuse_other_code(
        {name: own_code[name] for name in own_code if now.get(name) == before.get(name)},
        json.loads(earlier.attrs.get("own_code", "{}")),
    )
    loop = plan.layout.loop
    keys = _keys(loop, plan.layout.sizes, json.loads(attrs["day_sha256"]), now)
    new = {key: k for k, key in enumerate(keys)}
    sizes = {str(d): n for d, n in earlier["status"].sizes.items()}
    unknown = sorted(before.keys() - loop.rules.keys())
    if unknown:
        raise InputError(
            f"--extend: the rule {unknown[0]} is no longer in the study: keep it, or choose another folder with -o"
        )
    smaller = Loop.from_dataset(earlier, [loop.rules[name] for name in before])
    old = _keys(smaller, sizes, json.loads(earlier.attrs["day_sha256"]), before)
    place = np.array([new.get(key, -1) for key in old])
    dropped = int((place < 0).sum())
    if dropped:
        days = "add days at the end alone, for each goes on from those before it" if plan.carry_over else ""
        hypercube = "a Latin hypercube of another size shares no point: use sobol or random"
        raise InputError(
            f"--extend: {dropped:,} of the {place.size:,} scenarios in the folder are no longer in the study: keep "
            f"all values and add to them ({days or hypercube}), or choose another folder with -o"
        )
    run = np.flatnonzero(earlier["status"].values.ravel() != STATUS_NOT_RUN)
    return Match(run, place[run])


def as_part(earlier: xr.Dataset, match: Match, n_volumes: int) -> xr.Dataset:
    """The matched scenarios of an earlier result as a flat part of the study.

    n_volumes: the largest number of volumes there; the earlier result may have had only smaller coils.
    """
    dims = earlier["status"].dims
    part = xr.Dataset(coords={"scenario": match.new})
    for name, variable in earlier.data_vars.items():
        values = variable.values.reshape(-1, *variable.shape[len(dims) :])
        part[name] = (("scenario", *variable.dims[len(dims) :]), values[match.old], variable.attrs)
    part = part.assign_coords({n: c for n, c in earlier.coords.items() if n in part.dims and n != "scenario"})
    if "volume" in part.dims and part.sizes["volume"] < n_volumes:
        part = part.reindex(volume=np.arange(1, n_volumes + 1))
    return part


def _rules(attrs: dict[Any, Any]) -> dict[str, str]:
    """The rules of a study's own: name → hash of the code."""
    return {name: rule.get("sha256", "") for name, rule in json.loads(attrs.get("rules", "{}")).items()}


def _keys(loop: Loop, sizes: dict[str, int], days: list[str], rules: dict[str, str]) -> list[bytes]:
    """One hash per scenario, over everything its result depends on."""
    read = {name: rule.own for name, rule in loop.rules.items()}
    n = int(np.prod(list(sizes.values()), dtype=np.int64))
    keys = []
    for start in range(0, n, _AT_ONCE):
        columns = columns_of(loop, sizes, np.arange(start, min(start + _AT_ONCE, n)))
        rows = np.ascontiguousarray(parameter_matrix(columns).T)
        for k, (row, day) in enumerate(zip(rows, columns["day"], strict=True)):
            words = [str(columns[kind][k]) for kind in KINDS]
            own = [f"{w} {rules[w]} {[(n, float(columns[n][k])) for n in read[w]]}" for w in words if w in rules]
            keys.append(hashlib.blake2b(row.tobytes() + "".join([days[day], *own]).encode(), digest_size=16).digest())
    return keys

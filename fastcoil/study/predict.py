"""``[run] predict``: what theory foretells of every scenario of a study, as numbers beside its metrics."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from fastcoil.loops.dataset import attributes
from fastcoil.loops.plan import Plan
from fastcoil.loops.scenarios import columns_of
from fastcoil.model.metric_table import PREDICTIONS

_AT_ONCE = 2048
"""Scenarios; their responses take up to 60 MB."""
_DIGITS = "%.6g"
"""Theory is not that good, and the last bits are those of the machine's libraries."""


def predictions(plan: Plan) -> xr.Dataset:
    """Foretell margin and limit cycle of every scenario of a study.

    The mean conditions and the mean set-point of each day's enabled seconds after the warm-up count, as if they were
    held for ever; noise does not, so that all replicates are alike.  All scenarios are foretold together, whoever ran
    them and when, so that their number alone decides the numbers.

    Returns
    -------
    xarray.Dataset
        ``PREDICTIONS`` over the dims of the study; the attribute ``prediction_note`` says why some are NaN, if they
        are.
    """
    from fastcoil.design.theory.cycles import cycles_of
    from fastcoil.design.theory.elements import unknown
    from fastcoil.design.theory.operating_points import mean_conditions
    from fastcoil.design.theory.plants import plants_of

    loop, sizes = plan.layout.loop, plan.layout.sizes
    alike = {dim: n for dim, n in sizes.items() if dim != "replicate"}
    n = math.prod(alike.values())
    entering = mean_conditions(plan.layout.boundary, plan.warm_up, carry_over=plan.carry_over)
    found = {name: np.full(n, np.nan) for name in PREDICTIONS}
    reasons: dict[str, int] = {}
    for start in range(0, n, _AT_ONCE):
        index = np.arange(start, min(start + _AT_ONCE, n))
        day = columns_of(loop, alike, index)["day"]
        seen = index[np.isfinite(entering["T_set"][day])]
        if seen.size < index.size:
            _count(reasons, "no second is enabled after the warm-up", index.size - seen.size)
        if not seen.size:
            continue
        columns = columns_of(loop, alike, seen)
        for reason, loops in unknown(columns).items():
            _count(reasons, reason, int(loops.sum()))
        conditions = {name: means[columns["day"]] for name, means in entering.items()}
        cycles = cycles_of(columns, plants_of(columns, conditions))
        told = cycles.margin, cycles.hunts, cycles.period, 2.0 * cycles.amplitude
        for name, value in zip(found, told, strict=True):
            found[name][seen] = np.char.mod(_DIGITS, value).astype(float)
    ds = xr.Dataset()
    for name, flat in found.items():
        values = xr.DataArray(flat.reshape(tuple(alike.values())), dims=tuple(alike))
        whole = values.expand_dims({d: k for d, k in sizes.items() if d not in alike}).transpose(*sizes)
        ds[name] = (tuple(sizes), np.array(whole.values), attributes(PREDICTIONS[name]))
    note = "; ".join(f"{reason}: {count:,} of {n:,}" for reason, count in reasons.items())
    return ds.assign_attrs({"prediction_note": f"theory says nothing: {note}"} if note else {})


def _count(reasons: dict[str, int], reason: str, n: int) -> None:
    if n:
        reasons[reason] = reasons.get(reason, 0) + n

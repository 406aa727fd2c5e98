"""What SIMC gives each valve of a population: what a technician would set after a step on that valve."""

from __future__ import annotations

import warnings

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.design.theory.linearise import linearise
from fastcoil.design.tuning.predicted import mean_days
from fastcoil.design.tuning.space import Space
from fastcoil.design.tuning.split import Group

GAINS = ("kp", "ti")


def own_gains(group: Group, space: Space, warm_up: int) -> dict[str, Array]:
    """kp and ti after SIMC for each valve of a group, (valve,): the median of its days at their mean conditions.

    A valve that cannot hold the set-point on any day gets the median of the others.  Empty where kp and ti are not what
    is searched, or SIMC gives no valve anything.
    """
    if not set(GAINS) <= set(space.names):
        return {}
    ds = linearise(group.loop, mean_days(group.boundary, warm_up), at=0)
    n = len(group.members)
    found = {}
    for name in GAINS:
        given = ds[f"{name}_simc"].where(ds["reachable"])
        values = given.transpose("day", ...).values.reshape(group.boundary.n_days, -1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of valves without a day: told above
            of_valves = np.broadcast_to(np.nanmedian(values, axis=0), n)
            found[name] = np.where(np.isfinite(of_valves), of_valves, np.nanmedian(of_valves))
    usable = all(np.isfinite(values).all() and (values > 0.0).all() for values in found.values())
    return found if usable else {}

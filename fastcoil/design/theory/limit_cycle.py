"""``limit_cycle``: loops × days × seconds → margin, and whether, how fast and how far each loop hunts."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.design.theory.cycles import DISTURBANCE, HUNTS_ABOVE, Cycles, cycles_of
from fastcoil.design.theory.elements import unknown
from fastcoil.design.theory.operating_points import OperatingPoints
from fastcoil.design.theory.plants import plants_of
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import check_memory
from fastcoil.loops.provenance import provenance

_NAMES: Mapping[str, Mapping[str, str]] = {
    "margin": {
        "long_name": "margin of the describing function", "units": "1",
        "comment": f"largest |L| |N| where L and N lag 180 degrees together, over swings up to {DISTURBANCE:g} K; from "
        f"{HUNTS_ABOVE:g} on a gap keeps the loop swinging; without a gap 1/gain margin; 0 if T_set is out of reach",
    },
    "hunts": {
        "long_name": "whether the loop is foretold to hunt", "units": "1",
        "comment": f"1 if a swing of {DISTURBANCE:g} K ends in one that goes on, by more than 0.1 K from peak to peak",
    },
    "period": {"long_name": "period of the foretold cycle", "units": "s", "comment": "NaN where it does not hunt"},
    "amplitude": {
        "long_name": "amplitude of T_sup in the foretold cycle", "units": "K",
        "comment": "half of peak to peak; NaN where it does not hunt",
    },
    "frequency": {"long_name": "angular frequency of the margin", "units": "rad s-1"},
}  # fmt: skip


def limit_cycle(loop: Loop, boundary: Boundary, *, at: Any = None) -> xr.Dataset:
    """Foretell, without simulating, whether each loop hunts on each day, how fast and how far.

    The loop is linear but for one element, the describing function of all that lies between the controller's u and the
    supply temperature at rest: limits of the stroke, the motor's speed, neutral zone, gap, inverse with a right or
    wrong estimate, buffer, and the curve of valve and coil.  Noise and the resolutions are left out.

    Parameters
    ----------
    loop, boundary
        As for ``simulate``; a sweep and several days give results of these dims.
    at
        Where on the day: None for the mean conditions and the mean set-point of the enabled seconds after the warm-up
        of 1,800 s; a second, or a list of them, for the conditions of that second, as if they were held for ever.  A
        list becomes the dim ``elapsed_time``.

    Returns
    -------
    xarray.Dataset
        margin, hunts (0 or 1), period [s], amplitude [K, half of peak to peak, of true T_sup], frequency of the margin
        [rad/s].  The attributes of each say what it is.  All are NaN, with a warning that says why, in scenarios about
        which theory says nothing: a law of your own, an estimator that changes the estimate, stick-slip, an error dead
        band, a smooth compensation slower than the cycle.

    Raises
    ------
    InputError
        With one sentence for each mistake; for an unstable coil; if theory says nothing about any scenario.
    """
    points = OperatingPoints(loop, boundary, at)
    check_memory(2 * 8 * len(_NAMES) * points.size, points.size)
    found = Cycles(*(np.empty(points.size) for _ in Cycles._fields))
    reasons: dict[str, int] = {}
    unknown_loops = 0
    for index in points.chunks():
        columns = points.columns(index)
        plants, why = plants_of(columns, points.conditions(index)), unknown(columns)
        why |= {"T_sup jumps past the set-point, from dry to wet: there is nothing to linearise": np.isnan(plants.gain)}
        unknown_loops += int(np.any(list(why.values()), axis=0).sum())
        for reason, where in why.items():
            reasons[reason] = reasons.get(reason, 0) + int(where.sum())
        for values, part in zip(found, cycles_of(columns, plants), strict=True):
            values[index] = part
    note = _note(reasons, unknown_loops, found)
    ds = points.dataset({name: (getattr(found, name), _NAMES[name]) for name in Cycles._fields})
    return ds.assign_attrs(title="fastcoil limit cycles, foretold", **({"note": note} if note else {}), **provenance())


def _note(reasons: Mapping[str, int], unknown_loops: int, found: Cycles) -> str:
    """A sentence for each reason why scenarios are NaN, which is also a warning; refuses if all are."""
    nothing = np.isnan(found.hunts)
    why = {reason: count for reason, count in reasons.items() if count}
    slow = int(nothing.sum()) - unknown_loops
    if slow:
        why["the smooth compensation crosses the gap more slowly than u turns: lower smooth_rate, or simulate it"] = (
            slow
        )
    if nothing.all():
        raise InputError([f"limit_cycle says nothing about these loops: {reason}" for reason in why])
    note = "; ".join(f"NaN in {count:,} of {nothing.size:,} scenarios: {reason}" for reason, count in why.items())
    if note:
        warnings.warn(note, stacklevel=3)
    return note

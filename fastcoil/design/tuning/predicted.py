"""The margin of the describing function as a measure beside the metrics: it needs no simulation."""

from __future__ import annotations

import hashlib
import warnings
from pathlib import Path

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.design import theory
from fastcoil.design.theory.elements import unknown
from fastcoil.design.theory.limit_cycle import limit_cycle
from fastcoil.design.theory.operating_points import mean_conditions
from fastcoil.design.tuning.measures import MARGIN
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.scenarios import columns_of


def margins(loop: Loop, boundary: Boundary, warm_up: int) -> xr.DataArray:
    """Margin of every loop on every day, at the mean conditions of the seconds that count."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of loops without a margin: an infinite one breaks every limit
        return limit_cycle(loop, mean_days(boundary, warm_up), at=0)[MARGIN].reset_coords(drop=True)


def require_margins(loop: Loop) -> None:
    """Refuse loops about which theory says nothing.

    Raises
    ------
    InputError
        With a sentence for each reason.
    """
    index = np.arange(int(np.prod(list(loop.sizes.values()), dtype=int)))
    reasons = [reason for reason, where in unknown(columns_of(loop, loop.sizes, index)).items() if np.any(where)]
    if reasons:
        raise InputError([f"limits: {MARGIN}: theory has none for some of these loops: {reason}" for reason in reasons])


def theory_sha256() -> str:
    """Hash of the sources of the theory."""
    digest = hashlib.sha256()
    for source in sorted(Path(str(theory.__file__)).parent.glob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()


def mean_days(boundary: Boundary, warm_up: int) -> Boundary:
    """Days of one second with the mean conditions of those that count; of all, where the plant is off throughout."""
    found = mean_conditions(boundary, warm_up)
    for k in np.flatnonzero(np.isnan(found["T_set"])):
        for name, values in boundary.of_day(int(k)).items():
            if name in found:
                found[name][k] = values.mean()
    return Boundary(**{name: means[:, None] for name, means in found.items()}, enabled=1.0, day=boundary.day)

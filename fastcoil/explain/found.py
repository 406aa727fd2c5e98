"""What was found out about one loop on one day, before it is put into words."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.boundary import Boundary
from fastcoil.explain.cures import Distance
from fastcoil.explain.foretold import UNSURE, Foretold
from fastcoil.explain.phase import Response
from fastcoil.outputs import STATUS_OK
from fastcoil.simulation.loop import Loop


class Found(NamedTuple):
    """Everything behind an explanation.

    loop, boundary: a single scenario.  foretold, response, distance: None where theory cannot tell, for the reasons in
    ``doubts``; the response is that of the worst operating point.  left_out: what the margin does not see.
    cures: over ``cure``, as it is first, with the trace T_sup.  best: index of the recommended one.
    hints: what else would help, not tried.
    """

    loop: Loop
    boundary: Boundary
    foretold: Foretold | None
    response: Response | None
    distance: Distance | None
    phase: xr.DataArray | None
    doubts: tuple[str, ...]
    left_out: tuple[str, ...]
    cures: xr.Dataset
    best: int
    hints: tuple[str, ...]

    @property
    def now(self) -> xr.Dataset:
        """The loop as it is, simulated."""
        return self.cures.isel(cure=0)

    @property
    def failed(self) -> bool:
        """Whether the simulation of the loop as it is failed."""
        return int(self.now["status"]) != STATUS_OK

    @property
    def hunts(self) -> bool:
        """Whether the simulated day hunts."""
        return bool(self.now["hunts"] > 0)

    @property
    def unsure(self) -> bool:
        """Whether the margin is so near its limit that it does not decide."""
        return self.foretold is not None and UNSURE[0] <= self.foretold.margin <= UNSURE[1]

    def value(self, name: str) -> float:
        """A parameter of the loop."""
        return float(self.loop[name])  # type: ignore[arg-type]

    @property
    def points(self) -> xr.Dataset | None:
        """The operating points with their margins."""
        if self.foretold is None:
            return None
        points, plants, cycles, _ = self.foretold
        return xr.Dataset(
            {
                "start": ("point", points.start, {"units": "s", "long_name": "first second"}),
                "seconds": ("point", points.seconds, {"units": "s", "long_name": "seconds spent there"}),
                **{name: ("point", values) for name, values in points.conditions.items()},
                "opening": ("point", np.asarray(plants.opening)),
                "gain": ("point", np.asarray(plants.gain), {"units": "K", "long_name": "K per unit of opening"}),
                "reachable": ("point", np.asarray(plants.reachable)),
                "margin": ("point", np.asarray(cycles.margin)),
                "hunts": ("point", np.asarray(cycles.hunts)),
                "period": ("point", np.asarray(cycles.period), {"units": "s"}),
                "amplitude": ("point", np.asarray(cycles.amplitude), {"units": "K"}),
            }
        )

"""What was found out about one loop on one day, before it is put into words."""

from __future__ import annotations

from typing import NamedTuple

import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.design.explanation.cures import Distance
from fastcoil.design.explanation.phase import Response
from fastcoil.design.explanation.predicted import UNSURE, Foretold
from fastcoil.design.explanation.try_cures import hunting
from fastcoil.design.theory.cycles import HUNTS_ABOVE
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.model.metric_table import STATUS_OK

_LOST = 0.5
"""Share of the time off the set-point from which a loop does not control."""


class Told(NamedTuple):
    """What theory tells of a loop.

    response, phase, gain_margin: at the worst operating point; phase has the degrees that each part of the loop takes
    over ``part``; the gain margin is that behind a perfect valve.  swings: simulated at each operating point, K.
    """

    foretold: Foretold
    response: Response
    distance: Distance
    phase: xr.DataArray
    gain_margin: float
    swings: Array

    @property
    def rings(self) -> bool:
        """Whether the loop would swing behind a perfect valve, too."""
        return self.gain_margin <= 1.0

    @property
    def too_large(self) -> bool:
        """Whether the margin alone makes it hunt: a slow motor may keep a large swing up where it does not."""
        return self.foretold.margin > HUNTS_ABOVE

    @property
    def unsure(self) -> bool:
        """Whether the margin is so near its limit that it does not decide."""
        return UNSURE[0] <= self.foretold.margin <= UNSURE[1]

    @property
    def points(self) -> xr.Dataset:
        """The operating points with their margins."""
        points, plants, cycles, _ = self.foretold
        kelvin, second = {"units": "K"}, {"units": "s"}
        return xr.Dataset(
            {
                "start": ("point", points.start, second | {"long_name": "first second"}),
                "seconds": ("point", points.seconds, second | {"long_name": "seconds spent there"}),
                **{name: ("point", values) for name, values in points.conditions.items()},
                "opening": ("point", plants.opening),
                "gain": ("point", plants.gain, kelvin | {"long_name": "change per unit of opening"}),
                "reachable": ("point", plants.reachable),
                "margin": ("point", cycles.margin),
                "hunts": ("point", cycles.hunts),
                "period": ("point", cycles.period, second),
                "amplitude": ("point", cycles.amplitude, kelvin | {"long_name": "half of peak to peak"}),
                "swing": ("point", self.swings, kelvin | {"long_name": "simulated, peak to peak"}),
            }
        )


class Found(NamedTuple):
    """Everything behind an explanation.

    loop, boundary: a single scenario.  told: None where theory cannot tell, for the reasons in ``doubts``.
    left_out: what the margin does not see.  hints: what else would help, not tried.
    cures: over ``cure``, as it is first, with the trace T_sup.  best: index of the recommended one.
    """

    loop: Loop
    boundary: Boundary
    told: Told | None
    doubts: tuple[str, ...]
    left_out: tuple[str, ...]
    hints: tuple[str, ...]
    cures: xr.Dataset
    best: int

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
    def lost(self) -> bool:
        """Whether it is off its set-point for most of the time."""
        return bool(self.now["share_off"] > _LOST)

    @property
    def needs_cure(self) -> bool:
        """Whether it hunts, for a part of the day at least."""
        return bool(hunting(self.cures)[0])

    def value(self, name: str) -> float:
        """A parameter of the loop."""
        return float(self.loop[name])  # type: ignore[arg-type]

    def cured(self, name: str) -> int | None:
        """Index of a cure; None if it was not tried."""
        names = self.cures["cure"].values.tolist()
        return int(names.index(name)) if name in names else None

    def with_cure(self, parameter: str, k: int) -> float:
        """A parameter of the loop with a cure."""
        values = self.cures[parameter] if parameter in self.cures.coords else None
        return float(values[k]) if values is not None and values.ndim else self.value(parameter)

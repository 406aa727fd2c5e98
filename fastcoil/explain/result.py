"""The explanation of one loop: answer, reasons, cures; in words and as a figure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import xarray as xr

from fastcoil.explain.found import Found
from fastcoil.explain.words import sentences, why_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Explanation:
    """Why one loop hunts on one day, or does not.

    Attributes
    ----------
    hunts
        Whether the simulated day hunts, see the metric of that name.
    foretold
        Whether the linear model foretells hunting at some operating point; None where it cannot tell.
    margin
        Largest describing-function margin of the day; above 0.8 a loop hunts.  NaN where theory cannot tell.
    period, amplitude
        Of the foretold cycle at the worst operating point, s and K (half of peak to peak); NaN without.
    why
        The reason in a sentence.
    doubts
        Why theory cannot tell, or what it leaves out; empty where there is nothing.
    phase
        DataArray over ``part``: degrees that each part of the loop takes at the critical frequency; None without.
    points
        Dataset over ``point``: each hour at each set-point with its margin; None where theory cannot tell.
    cures
        Dataset over ``cure``, ``as_it_is`` first: the parameters that change, the foretold ``margin``, the simulated
        metrics, ``words`` and ``verdict``.
    recommended
        The cure to take; ``as_it_is`` where the loop is good, or nothing helps.
    """

    hunts: bool
    foretold: bool | None
    margin: float
    period: float
    amplitude: float
    why: str
    doubts: tuple[str, ...]
    phase: xr.DataArray | None
    points: xr.Dataset | None
    cures: xr.Dataset
    recommended: str
    _found: Found = field(repr=False)

    @classmethod
    def of(cls, found: Found) -> Explanation:
        """Make one of what was found."""
        told = found.foretold
        at = told.worst if told is not None else -1
        cycle = (float(told.cycles.period[at]), float(told.cycles.amplitude[at])) if told else (float("nan"),) * 2
        return cls(
            hunts=found.hunts,
            foretold=told.hunts if told else None,
            margin=told.margin if told else float("nan"),
            period=cycle[0],
            amplitude=cycle[1],
            why=why_of(found),
            doubts=found.doubts + found.left_out,
            phase=found.phase,
            points=found.points,
            cures=found.cures.drop_vars("T_sup").drop_vars("elapsed_time"),
            recommended=str(found.cures["cure"].values[found.best]),
            _found=found,
        )

    @property
    def text(self) -> str:
        """The explanation in plain sentences, the answer first."""
        return "\n".join(sentences(self._found))

    def __str__(self) -> str:
        return self.text

    def plot(self) -> Figure:
        """The explanation on one page, as a matplotlib ``Figure``."""
        from fastcoil.explain.figure import page

        return page(self._found)

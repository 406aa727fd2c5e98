"""The explanation of one loop: answer, reasons, cures; in words and as a figure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import xarray as xr

from fastcoil.base.results import card
from fastcoil.design.explanation.answer import answer_of, why_of
from fastcoil.design.explanation.theory import Found
from fastcoil.design.explanation.words import sentences

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Explanation:
    """Why one loop hunts on one day, or does not.

    Attributes
    ----------
    hunts
        Whether the simulated day hunts, see the metric of that name.
    foretold
        Whether the linear model foretells hunting at some operating point; None where it cannot tell.
    margin
        Largest describing-function margin of the day; above 0.85 a loop hunts.  NaN where theory cannot tell.
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
    _found: Found

    @classmethod
    def of(cls, found: Found) -> Explanation:
        """Make one of what was found."""
        told = found.told.foretold if found.told is not None else None
        nothing = float("nan")
        return cls(
            hunts=found.hunts,
            foretold=told.hunts if told is not None else None,
            margin=told.margin if told is not None else nothing,
            period=float(told.cycles.period[told.worst]) if told is not None else nothing,
            amplitude=float(told.cycles.amplitude[told.worst]) if told is not None else nothing,
            why=why_of(found),
            doubts=found.doubts + found.left_out,
            phase=found.told.phase if found.told is not None else None,
            points=found.told.points if found.told is not None else None,
            cures=found.cures.drop_vars(["T_sup", "elapsed_time", "uncounted"]),
            recommended=str(found.cures["cure"].values[found.best]),
            _found=found,
        )

    @property
    def text(self) -> str:
        """The explanation in plain sentences, the answer first."""
        return "\n".join(sentences(self._found))

    def __repr__(self) -> str:
        return f"<fastcoil explanation: {answer_of(self._found)}>"

    def _repr_html_(self) -> str:
        first, *others = sentences(self._found)
        return card("fastcoil explanation", first, others)

    def __str__(self) -> str:
        return self.text

    def plot(self) -> Figure:
        """The explanation on one page, as a matplotlib ``Figure``."""
        from fastcoil.design.explanation.figure import page

        return page(self._found)

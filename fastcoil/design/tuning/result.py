"""The result of a tuning: what was chosen, what it does on others, the front; in words, as TOML, as a figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from fastcoil.base.results import Result, as_toml, in_toml
from fastcoil.design.tuning.measures import Limit, Measure
from fastcoil.design.tuning.words import Findings, in_words, value_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Tuning(Result):
    """What a search found for the valves and days of a population.

    Attributes
    ----------
    parameters
        The values that were chosen, by name.
    meets_limits
        Whether a tuning was found that keeps every limit on the valves and days of the search.  If not, ``parameters``
        break them least, and are no recommendation.
    held_out, trained
        Datasets over ``tuning`` (``now``, the loop as it came, ``chosen``, and ``simc`` where kp and ti were searched)
        and ``edge`` (value, low, high: 95 % by bootstrap over valves and days): the objective, every limited
        metric, motor travel and share that hunts; ``change`` of the objective against now.  ``held_out``: on valves
        and days that the search never saw, which is the result; ``trained``: on its own.
    front
        Dataset over ``point``: the tunings of which no other has both a lower objective and less motor travel on the
        valves and days of the search, with the same measures on those held out (``held_out_…``).
    evaluations
        Dataset over ``evaluation``: every tuning that was tried.
    objective, limits
        What was sought, what was limited.
    axes
        Error and travel that the front is made of.
    notes
        What to mind: a limit broken on the hold-out, an end of a range reached, what the population lacks.
    """

    parameters: Mapping[str, float]
    meets_limits: bool
    held_out: xr.Dataset
    trained: xr.Dataset
    front: xr.Dataset
    evaluations: xr.Dataset
    objective: Measure
    limits: tuple[Limit, ...]
    notes: tuple[str, ...]
    axes: tuple[Measure, Measure]

    @property
    def _findings(self) -> Findings:
        return Findings(
            dict(self.parameters), self.meets_limits, self.trained, self.held_out, self.limits, self.notes
        )  # fmt: skip

    def summary(self) -> list[str]:
        """The tuning in words, and a table of now and chosen, line by line."""
        return in_words(self._findings, self.evaluations.sizes["evaluation"])

    def plot(self) -> Figure:
        """The front and what the hold-out makes of it, as a matplotlib ``Figure``."""
        from fastcoil.design.tuning.figure import draw_front

        return draw_front(self.front, self.trained, self.held_out, *self.axes, self.limits)

    def to_toml(self, path: str | Path | None = None) -> str:
        """The chosen values as TOML, written to ``path`` if given; for ``include`` in the ``[loop]`` of a study file.

        ``[loop]`` has nothing where no tuning keeps the limits; ``[fit]`` is for readers.
        """
        return as_toml(self._toml(), path)

    def _toml(self) -> list[str]:
        lines = ["# settings chosen by fastcoil tune", *(f"# {line}".rstrip() for line in self.summary())]
        chosen = self.parameters if self.meets_limits else {}
        lines += ["", "[loop]", *(f"{name} = {value_of(name, value)}" for name, value in chosen.items())]
        lines += ["", "[fit]", 'kind = "tuning"', f"objective = {in_toml(self.objective.name)}"]
        lines += [f"meets_limits = {in_toml(self.meets_limits)}"]
        lines += [f"notes = {in_toml(self.notes)}"]
        for name, ds in (("held_out", self.held_out), ("trained", self.trained)):
            chosen_there = ds.sel(tuning="chosen")
            lines += ["", f"[fit.{name}]"]
            lines += [f"{variable} = {in_toml(chosen_there[variable].values.tolist())}" for variable in ds.data_vars]
        return lines

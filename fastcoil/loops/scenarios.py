"""The scenarios of a study in one flat order: every loop × day × replicate, each made only when needed."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr

from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clock import check_names
from fastcoil.loops.loop import Loop, forgetting, words_used


class Layout:
    """Dimensions of a study and the parameters of its scenarios by flat index (C order; the last dim is fastest).

    ``day`` comes first if the boundary has that dimension, so that neighbours share a day, then the loop's own
    dimensions, then ``replicate`` if there are several.
    """

    def __init__(self, loop: Loop, boundary: Boundary, replicates: int = 1) -> None:
        check_names(loop, boundary)
        self.loop = _with_used_rules(loop)
        self.boundary = boundary
        self.sizes = ({"day": boundary.n_days} if boundary.has_day_dim else {}) | self.loop.sizes
        if replicates > 1:
            self.sizes["replicate"] = replicates
        self.size = math.prod(self.sizes.values())
        self._labels = self.loop.coordinates()

    def columns(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Every parameter of the scenarios ``index``, see ``columns_of``."""
        return columns_of(self.loop, self.sizes, index)

    def describe(self, flat: int) -> str:
        """One scenario in words: its labels in the sweep; empty if there is only one scenario."""
        labels, swept = self.coordinates(), self.loop.swept
        place = np.unravel_index(flat, tuple(self.sizes.values())) if self.sizes else ()
        at = {d: labels[d].values[i] for d, i in zip(self.sizes, place, strict=True)}
        named = [f"{d}={v}" if isinstance(v, str) else f"{d}={v:g}" for d, v in at.items() if d in swept or d in labels]
        return ", ".join(named)

    def coordinates(self) -> dict[str, xr.DataArray]:
        """Labels of every dimension and the swept parameters along them."""
        coordinates = dict(self._labels)
        if "day" in self.sizes:
            coordinates["day"] = xr.DataArray(self.boundary.day, dims="day")
        if "replicate" in self.sizes:
            coordinates["replicate"] = xr.DataArray(np.arange(self.sizes["replicate"]), dims="replicate")
        return coordinates


def _with_used_rules(loop: Loop) -> Loop:
    """The loop without rules that no scenario has, unless their parameters were changed."""
    used = [rule for rule in loop.rules.values() if rule.name in words_used(loop, rule.kind)]
    read = {n for rule in used for n in rule.own}
    unused = [
        rule.name
        for rule in loop.rules.values()
        if rule not in used and all(n in read or loop[n] is p.default for n, p in rule.own.items())
    ]
    return forgetting(loop, unused) if unused else loop


def columns_of(loop: Loop, sizes: Mapping[str, int], index: np.ndarray) -> dict[str, np.ndarray]:
    """Every parameter of the scenarios ``index`` of a study with these sizes, (n,) each; NaN where one is not given.

    ``day`` is the position along that dimension, ``replicate`` the replicate's number.
    """
    place = dict(zip(sizes, np.unravel_index(index, tuple(sizes.values())), strict=True)) if sizes else {}
    columns: dict[str, np.ndarray] = {}
    for name in loop.parameters:
        value = loop[name]
        if isinstance(value, xr.DataArray):
            columns[name] = value.values[tuple(place[str(d)] for d in value.dims)]
        else:
            columns[name] = np.full(index.size, math.nan if value is None else value)
    if loop["estimator"] is None:
        columns["estimator"] = np.where(columns["learning_step"] > 0.0, "learner", "none")
    for dim in ("day", "replicate"):
        columns[dim] = place.get(dim, np.zeros(index.size, dtype=np.int64))
    return columns

"""Settings in, everything that the page shows out; asked again, at no cost."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache

from fastcoil.base.errors import InputError
from fastcoil.deliver.explore.model import map as maps
from fastcoil.deliver.explore.model.map import Map, map_of
from fastcoil.deliver.explore.model.run import Run, run
from fastcoil.deliver.explore.model.scene import scene_of
from fastcoil.deliver.explore.model.settings import Settings, settings_of
from fastcoil.deliver.explore.model.start import GIVEN, Start, starts
from fastcoil.deliver.explore.model.stories import STORIES, told
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.study.maintenance import Scenario

_RUNS, _MAPS = 200, 100
"""So many are kept: 0.3 MB and 4 kB each."""


class Model:
    """The loops to start from, and what becomes of them; threads may share it.

    given: a loop beside the presets.  preset: the one that a page without a link begins with, if none is given.
    """

    def __init__(self, given: Scenario | None = None, preset: str = "paper_like") -> None:
        self.starts: Mapping[str, Start] = starts(given)
        self.first = GIVEN if given is not None else preset
        self._run = lru_cache(maxsize=_RUNS)(self._simulate)
        self._map = lru_cache(maxsize=_MAPS)(self._sweep)

    @property
    def usual(self) -> Settings:
        """What a page without a link shows."""
        return settings_of(self.first, self.starts[self.first])

    def run(self, settings: Settings) -> Run:
        """The loop of some settings, simulated and foretold."""
        return self._run(settings.turned(axes="tuning", colour="rmse", window="day"))

    def map(self, settings: Settings) -> Map:
        """The map around it."""
        return self._map(maps.without_its_point(settings))

    def prepare(self) -> None:
        """Compile the kernel, and have what the page shows first and its stories ready."""
        compile_kernel()
        for settings in (self.usual, *(told(story, self.starts) for story in STORIES)):
            # a loop that cannot be simulated is refused on the page
            with suppress(InputError):
                self.run(settings)
                self.map(settings)

    def _simulate(self, settings: Settings) -> Run:
        return run(scene_of(settings, self.starts[settings.loop]))

    def _sweep(self, settings: Settings) -> Map:
        return map_of(settings.axes, scene_of(settings, self.starts[settings.loop]))

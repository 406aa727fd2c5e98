"""The map: one sweep of the kernel around the loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from fastcoil.base.arrays import Array
from fastcoil.deliver.explore.model.scene import Scene
from fastcoil.deliver.explore.model.settings import Settings
from fastcoil.loops.simulate import simulate

METRICS = ("rmse", "hunting_swing")


class Axis(NamedTuple):
    """A parameter along a side of the map: its values, and whether they grow by ratios."""

    name: str
    values: tuple[float, ...]
    ratios: bool


# fmt: off
AXES: Mapping[str, tuple[Axis, Axis]] = {
    "tuning": (
        Axis("ti", (4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 100.0, 140.0, 200.0, 280.0, 400.0, 560.0, 800.0),
             True),
        Axis("kp", (0.002, 0.003, 0.0045, 0.0065, 0.01, 0.015, 0.02, 0.03, 0.045, 0.065, 0.1, 0.15), True),
    ),
    "size": (
        Axis("backlash", tuple(round(0.01 * k, 2) for k in range(16)), False),
        Axis("backlash_estimate", tuple(round(0.01 * k, 2) for k in range(16)), False),
    ),
}
# fmt: on
"""Sides of a map, x first: three or four blocks of lanes."""


class Map(NamedTuple):
    """Metrics over two parameters: values by metric, (n_y, n_x)."""

    x: Axis
    y: Axis
    values: Mapping[str, Array]


def without_its_point(settings: Settings) -> Settings:
    """The settings on which the map depends: where its point lies does not change it, nor what is shown of it."""
    x, y = AXES[settings.axes]
    return settings.turned(colour=METRICS[0], window="day", **{x.name: x.values[-1], y.name: y.values[0]})


def map_of(axes: str, scene: Scene) -> Map:
    """Simulate all loops of the map.

    Raises
    ------
    InputError
        If one of them cannot be simulated on this day.
    """
    x, y = AXES[axes]
    # the point of the scene is none of them: what it has along the sides is replaced
    swept = scene.loop.assign(**{y.name: list(y.values), x.name: list(x.values)})
    ds = simulate(swept, scene.day, warm_up=scene.warm_up, seed=scene.seed, n_jobs=1, progress=False)
    return Map(x, y, {name: ds[name].transpose(y.name, x.name).values for name in METRICS})

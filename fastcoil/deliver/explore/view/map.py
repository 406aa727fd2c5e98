"""The map: a coloured cell for every loop, and where this one lies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from bokeh.events import Tap
from bokeh.models import ColorBar, ColumnDataSource, HoverTool, LinearColorMapper, Range1d
from bokeh.palettes import Cividis256
from bokeh.plotting import figure

from fastcoil.base.arrays import Array
from fastcoil.base.figures import RED
from fastcoil.deliver.explore.model.map import Axis, Map
from fastcoil.deliver.explore.model.settings import CHOICES, DIALS, Settings
from fastcoil.deliver.explore.view.looks import INK, MARK, plain, text

MOST = {"tuning": {"rmse": 1.2, "hunting_swing": 2.5}, "size": {"rmse": 0.6, "hunting_swing": 1.5}}
"""Upper end of the colours, K: the same for all loops, so that maps can be compared."""
_LABELLED = 3
"""Every so many cells."""
_FAILED = "#dddddd"


class MapFigure(NamedTuple):
    """The figure, its cells and its point; cells lie at 0, 1, 2, … whatever the parameter."""

    fig: Any
    cells: ColumnDataSource
    point: ColumnDataSource
    colours: LinearColorMapper
    bar: ColorBar

    def show(self, found: Map, settings: Settings) -> None:
        """Fill it with a map."""
        sides = found.x.name, found.y.name
        columns = dict(self.cells.data)
        if self.fig.tags != [*sides]:
            self.fig.tags = [*sides]
            columns |= self._laid_out(found.x, found.y)
        most = MOST[settings.axes][settings.colour]
        if self.colours.high != most:
            self.colours.high = most
            self.bar.title = f"{CHOICES['colour'].words[settings.colour]} [K]"
        self.cells.data = columns | {"value": found.values[settings.colour].ravel()}

    def _laid_out(self, *sides: Axis) -> dict[str, Any]:
        """Where the cells of two parameters lie, x first; ticks and labels of the axes follow."""
        columns: dict[str, Any] = {}
        at = np.meshgrid(*(np.arange(len(axis.values)) for axis in sides))
        for axis, cells, name, side, ends in zip(
            sides, at, ("x", "y"), (self.fig.xaxis[0], self.fig.yaxis[0]), (self.fig.x_range, self.fig.y_range),
            strict=True,
        ):  # fmt: skip
            dial, n = DIALS[axis.name], len(axis.values)
            texts = [dial.text(value) for value in axis.values]
            columns |= {name: cells.ravel(), f"at_{name}": [texts[k] for k in cells.ravel()]}
            side.axis_label = f"{dial.label} [{dial.unit.partition(' of')[0]}]"
            side.ticker = list(range(0, n, _LABELLED))
            side.major_label_overrides = {k: f"{dial.factor * axis.values[k]:.3g}" for k in range(n)}
            ends.update(start=-0.5, end=n - 0.5)
        return columns

    def clear(self) -> None:
        """Show no map."""
        for source in (self.cells, self.point):
            source.data = {name: [] for name in source.data}
        self.fig.tags = []

    def mark(self, found: tuple[Axis, Axis], settings: Settings) -> bool:
        """Move the point to a loop; whether it lies on the map."""
        x, y = (cell_of(axis, float(settings.values[axis.name])) for axis in found)
        on_map = -0.5 <= x <= len(found[0].values) - 0.5 and -0.5 <= y <= len(found[1].values) - 0.5
        self.point.data = {"x": [x], "y": [y]} if on_map else {"x": [], "y": []}
        return on_map


def cell_of(axis: Axis, value: float) -> float:
    """Where a value lies, in cells; -1 where a scale of equal ratios has no place for it."""
    if axis.ratios and value <= 0.0:
        return -1.0
    along: Array = np.log(axis.values) if axis.ratios else np.array(axis.values)
    at = float(np.log(value)) if axis.ratios else value
    k = int(np.clip(np.searchsorted(along, at) - 1, 0, along.size - 2))
    return float(k + (at - along[k]) / (along[k + 1] - along[k]))


def map_figure(on_tap: Callable[[int, int], None]) -> MapFigure:
    """Make it.  on_tap: called with the cell that somebody clicks, x first."""
    cells = ColumnDataSource({name: [] for name in ("x", "y", "value", "at_x", "at_y")}, name="cells")
    point = ColumnDataSource({"x": [], "y": []}, name="here")
    fig = figure(name="map", x_range=Range1d(-0.5, 15.5), y_range=Range1d(-0.5, 11.5), title="Map", **plain())
    colours = LinearColorMapper(Cividis256, low=0.0, high=MOST["tuning"]["rmse"], nan_color=_FAILED)
    drawn = fig.rect(
        "x", "y", 1.0, 1.0, source=cells, fill_color={"field": "value", "transform": colours}, line_color=None
    )
    for width, colour in ((7, "white"), (4, RED)):
        fig.scatter(
            "x", "y", source=point, marker="circle", size=22, fill_color=None, line_color=colour, line_width=width
        )
    bar = ColorBar(
        color_mapper=colours, title="RMS error [K]", title_text_font_size=MARK, title_text_color=INK,
        title_text_font_style="normal", major_label_text_font_size=MARK, width=14, padding=4, title_standoff=6,
    )  # fmt: skip
    fig.add_layout(bar, "right")
    fig.add_tools(HoverTool(renderers=[drawn], tooltips=[("", "@value{0.00} K at @at_x, @at_y")]))
    fig.on_event(Tap, lambda event: on_tap(round(event.x), round(event.y)))
    text(fig)
    fig.grid.visible = False
    fig.title.text = "Map: click to move the ring"
    return MapFigure(fig, cells, point, colours, bar)

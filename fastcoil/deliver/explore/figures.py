"""The figures of the page: empty at first, then filled with a loop or a map; large type and few colours."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from bokeh.events import Tap
from bokeh.models import BoxAnnotation, ColorBar, ColumnDataSource, HoverTool, LinearColorMapper, Range1d, Span, Text
from bokeh.palettes import Cividis256
from bokeh.plotting import figure

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, RED, YELLOW
from fastcoil.deliver.explore.loop import EVERY, Axis, Map, Run
from fastcoil.deliver.explore.settings import CHOICES, DIALS, Settings
from fastcoil.design.limit_cycle import HUNTS_ABOVE
from fastcoil.design.phase_budget import UNSURE

INK, SHADE = "#222222", "#cccccc"
LINE, MARK = 3, "16px"
"""Width of the lines that count, px; letters, until the page knows how large its own are."""
LETTERS = """
const size = Math.round(parseFloat(getComputedStyle(document.documentElement).fontSize)) + 'px'
for (const [model, name] of letters) model[name] = size
"""
"""JavaScript: all letters as large as those of the page."""


def _figure(name: str, x_range: Range1d, y_range: Range1d, **options: Any) -> Any:
    """A figure that fills its place, without tools that could be clicked by mistake."""
    return figure(
        name=name, x_range=x_range, y_range=y_range, sizing_mode="stretch_both", toolbar_location=None, tools="",
        min_height=60, min_width=120, **options,
    )  # fmt: skip


def text(fig: Any) -> Any:
    """A figure with letters that the last row can read."""
    fig.title.update(text_font_size=MARK, text_color=INK)
    for axis in fig.axis:
        axis.update(
            axis_label_text_font_size=MARK, axis_label_text_font_style="normal", axis_label_standoff=4,
            axis_label_text_color=INK, major_label_text_font_size=MARK, major_label_text_color=INK,
            minor_tick_line_color=None,
        )  # fmt: skip
    fig.outline_line_color = None
    fig.grid.grid_line_alpha = 0.5
    return fig


def legend(fig: Any) -> Any:
    """A figure with its legend in a row above it."""
    box = fig.legend[0]
    fig.add_layout(box, "above")
    box.update(
        orientation="horizontal", label_text_font_size=MARK, label_text_color=INK, border_line_color=None, padding=0,
        margin=2, spacing=14, glyph_width=24,
    )  # fmt: skip
    return fig


def show_line(fig: Any, name: str, visible: bool) -> None:
    """Show a line, and its entry in the legend, or neither."""
    line = fig.select_one({"name": name})
    line.visible = visible
    for item in fig.legend[0].items:
        if line in item.renderers:
            item.visible = visible


def letters(*figs: Any) -> list[tuple[Any, str]]:
    """What has letters in some figures, and the property that says how large."""
    found: list[tuple[Any, str]] = []
    for fig in figs:
        found.append((fig.title, "text_font_size"))
        for axis in fig.axis:
            found += [(axis, "axis_label_text_font_size"), (axis, "major_label_text_font_size")]
        found += [(box, "label_text_font_size") for box in fig.legend]
        for bar in fig.select({"type": ColorBar}):
            found += [(bar, "title_text_font_size"), (bar, "major_label_text_font_size")]
        found += [(text, "text_font_size") for text in fig.select({"type": Text})]
    return found


WINDOWS = {"day": None, "2h": 2.0, "half": 0.5}
"""Hours shown, the last of the day."""
_MARGINS, _MARKED = (0.03, 30.0), (0.036, 25.0)
"""Ends of the scale, and of where the mark lies: in full on it."""
_GREY = "#999999"


class Figures(NamedTuple):
    """Figures by their place on the page, and the data behind them."""

    temperature: Any
    opening: Any
    estimate: Any
    gap: Any
    margin: Any
    traces: ColumnDataSource
    play: ColumnDataSource
    point: ColumnDataSource

    @property
    def all(self) -> tuple[Any, ...]:
        """The figures alone."""
        return self.temperature, self.opening, self.estimate, self.gap, self.margin

    def show(self, run: Run, window: str) -> None:
        """Fill them with one loop."""
        first = _first(run, WINDOWS[window])
        shown = {name: values[first:] for name, values in run.traces.items()}
        per_cent = {name: 100.0 * shown[name] for name in ("u", "command", "opening", "estimate")}
        backlash = np.full(shown["opening"].size, 100.0 * run.parameter("backlash"))
        self.traces.data = {
            "hours": run.hours[first:],
            **{name: shown[name] for name in ("T_sup", "T_measured", "T_set")},
            **per_cent,
            "backlash": backlash,
        }
        self.play.data = _play(run.parameter("backlash"))
        margin = float(np.clip(np.nan_to_num(run.predicted.margin), *_MARKED))
        self.point.data = {"margin": [] if run.predicted.doubt else [margin], "at": [] if run.predicted.doubt else [0]}
        self.temperature.x_range.update(start=float(run.hours[first]), end=float(run.hours[-1]))
        self.estimate.visible = run.learns
        senses = run.parameter("noise_std") > 0.0 or run.parameter("sensor_time_constant") > 0.0
        show_line(self.temperature, "measured", senses)
        for each in (self.opening, self.gap):
            show_line(each, "asked", run.compensates)
        _fit(self.temperature.y_range, 1.0, shown["T_sup"], shown["T_set"], *[shown["T_measured"]] * senses)
        asked = [per_cent["u"]] * run.compensates
        _fit(self.opening.y_range, 10.0, per_cent["command"], per_cent["opening"], *asked)
        _fit(self.gap.x_range, 12.0, per_cent["command"], *asked)
        _fit(self.gap.y_range, 12.0, per_cent["opening"])
        _fit(self.estimate.y_range, 8.0, per_cent["estimate"], backlash, np.zeros(1))


def _fit(span: Range1d, least: float, *values: Array) -> None:
    """Make an axis show all values, at least so much of it."""
    known = [each[np.isfinite(each)] for each in values]
    found = np.concatenate(known) if any(each.size for each in known) else np.zeros(1)
    low, high = float(found.min()), float(found.max())
    room = max(0.04 * (high - low), 0.5 * (least - (high - low)))
    span.update(start=low - room, end=high + room)


def _first(run: Run, hours: float | None) -> int:
    """First sample of a window; a whole day begins when the start is over."""
    counted = min(run.scene.warm_up // EVERY, run.hours.size - 1)
    return counted if hours is None else max(0, run.hours.size - int(hours * 3600 / EVERY) - 1)


def _play(backlash: float) -> dict[str, list[float]]:
    """Both flanks of Eq (1): the opening while the motor opens the valve, and while it closes it, %."""
    slope = 100.0 / (1.0 - backlash)
    return {
        "command": [100.0 * backlash, 100.0, np.nan, 0.0, 100.0 * (1.0 - backlash)],
        "opening": [0.0, (1.0 - backlash) * slope, np.nan, 0.0, 100.0],
    }


def figures() -> Figures:
    """Make them."""
    names = ("hours", "T_sup", "T_measured", "T_set", "u", "command", "opening", "estimate", "backlash")
    traces = ColumnDataSource({name: [] for name in names}, name="traces")
    play = ColumnDataSource({"command": [], "opening": []})
    point = ColumnDataSource({"margin": [], "at": []})
    hours = Range1d(0.0, 8.0)
    return Figures(
        _temperature(traces, hours), _opening(traces, hours), _estimate(traces, hours), _gap(traces, play),
        _margin(point), traces, play, point,
    )  # fmt: skip


def _temperature(traces: ColumnDataSource, hours: Range1d) -> Any:
    fig = _figure("temperature", hours, Range1d(12.0, 16.0), y_axis_label="temperature [°C]")
    measured = fig.line("hours", "T_measured", source=traces, color=_GREY, width=1, legend_label="sensor")
    measured.name = "measured"
    fig.line("hours", "T_set", source=traces, color=INK, width=2, dash=[8, 4], legend_label="set-point")
    fig.line("hours", "T_sup", source=traces, color=BLUE, width=LINE, legend_label="supply air")
    return legend(text(fig))


def _opening(traces: ColumnDataSource, hours: Range1d) -> Any:
    fig = _figure("opening", hours, Range1d(0.0, 100.0), x_axis_label="time [h]", y_axis_label="valve [%]")
    asked = fig.step(
        "hours", "u", source=traces, color=INK, width=1.5, dash=[2, 3], mode="after", legend_label="PI asks"
    )
    asked.name = "asked"
    fig.step("hours", "command", source=traces, color=RED, width=2, mode="after", legend_label="command")
    fig.line("hours", "opening", source=traces, color=BLUE, width=LINE, legend_label="opening")
    return legend(text(fig))


def _estimate(traces: ColumnDataSource, hours: Range1d) -> Any:
    fig = _figure("estimate", hours, Range1d(0.0, 8.0), x_axis_label="time [h]", y_axis_label="gap [%]", visible=False)
    fig.line("hours", "backlash", source=traces, color=INK, width=2, dash=[8, 4], legend_label="gap")
    fig.step("hours", "estimate", source=traces, color=RED, width=LINE, mode="after", legend_label="estimate")
    fig.yaxis.ticker.desired_num_ticks = 3
    return legend(text(fig))


def _gap(traces: ColumnDataSource, play: ColumnDataSource) -> Any:
    whole = (Range1d(0.0, 100.0), Range1d(0.0, 100.0))
    fig = _figure("gap", *whole, x_axis_label="command [%]", y_axis_label="opening [%]")
    fig.line("command", "opening", source=play, color=_GREY, width=1.5, dash=[4, 4], legend_label="edges")
    fig.line("command", "opening", source=traces, color=RED, width=1.5, legend_label="over command")
    asked = fig.line("u", "opening", source=traces, color=BLUE, width=LINE, legend_label="over what PI asks")
    asked.name = "asked"
    return legend(text(fig))


def _margin(point: ColumnDataSource) -> Any:
    fig = _figure(
        "margin", Range1d(*_MARGINS), Range1d(-1.0, 1.0), x_axis_type="log", title="Margin, predicted by theory"
    )
    band: Any = {"fill_alpha": 0.5, "line_alpha": 0.0, "level": "underlay"}
    fig.add_layout(BoxAnnotation(left=UNSURE[0], right=UNSURE[1], fill_color=SHADE, **band))
    fig.add_layout(BoxAnnotation(left=UNSURE[1], fill_color=YELLOW, **band))
    fig.add_layout(Span(location=HUNTS_ABOVE, dimension="height", line_color=INK, line_dash=[6, 4], line_width=2))
    fig.text([0.15, 7.0], [-0.35, -0.35], text=["calm", "hunts"], text_align="center", text_font_size=MARK)
    fig.scatter("margin", "at", source=point, marker="diamond", size=26, color=BLUE, line_color="white")
    fig.x_range.bounds = _MARGINS
    fig.yaxis.visible = False
    fig.ygrid.visible = False
    fig.xaxis.ticker = [0.1, 0.3, 0.85, 3, 10]
    return text(fig)


MOST = {"tuning": {"rmse": 1.2, "hunting_swing": 2.5}, "size": {"rmse": 0.6, "hunting_swing": 1.5}}
"""Upper end of the colours, K: the same for all loops, so that maps can be compared."""
_LABELLED = 3  # every so many cells
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
    """Make it.  on_tap: called with the cell that is clicked, x first."""
    cells = ColumnDataSource({name: [] for name in ("x", "y", "value", "at_x", "at_y")}, name="cells")
    point = ColumnDataSource({"x": [], "y": []}, name="here")
    fig = _figure("map", Range1d(-0.5, 15.5), Range1d(-0.5, 11.5), title="Map: click to move the ring")
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
    return MapFigure(fig, cells, point, colours, bar)

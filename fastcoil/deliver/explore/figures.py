"""The Bokeh figures of the page, filled with a loop or with a map."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from bokeh.events import Tap
from bokeh.models import BoxAnnotation, ColorBar, ColumnDataSource, HoverTool, LinearColorMapper, Range1d, Span
from bokeh.palettes import Cividis256
from bokeh.plotting import figure

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, RED, YELLOW
from fastcoil.deliver.explore.loop import DIALS, MAP_AXES, MENUS, TRACE_INTERVAL_S, Run, Settings
from fastcoil.design.advice import UNSURE_HUNTING_INDEX
from fastcoil.design.limit_cycle import HUNTING_INDEX_LIMIT

_INK = "#222222"  # colour of text and thin lines
_SHADE_GREY = "#cccccc"
_FONT_SIZE = "1rem"
_LINE_WIDTH_PX = 3  # of the main lines of a figure
_COLOUR_MAXIMA_K = {"tuning": {"rmse": 1.2, "hunting_swing": 2.5}, "size": {"rmse": 0.6, "hunting_swing": 1.5}}
"""Upper end of the colours of a map, the same for all loops, so that maps can be compared."""
Change = tuple[str, dict[str, Any]]
"""Id of a Bokeh model, new values of its properties.  Bokeh would send each as a message, and draw in between."""


def _figure(name: str, x: tuple[float, float] | Range1d, y: tuple[float, float], **options: Any) -> Any:
    """Make a Bokeh figure in our style that fills its place, without tools that could be clicked by mistake."""
    fig = figure(
        name=name, x_range=x if isinstance(x, Range1d) else Range1d(*x), y_range=Range1d(*y), toolbar_location=None,
        sizing_mode="stretch_both", tools="", min_height=60, min_width=120, outline_line_color=None, **options,
    )  # fmt: skip
    fig.title.update(text_font_size=_FONT_SIZE, text_color=_INK)
    for axis in fig.axis:
        axis.update(
            axis_label_text_font_size=_FONT_SIZE, axis_label_text_font_style="normal", axis_label_standoff=4,
            axis_label_text_color=_INK, major_label_text_font_size=_FONT_SIZE, major_label_text_color=_INK,
            minor_tick_line_color=None,
        )  # fmt: skip
    fig.grid.grid_line_alpha = 0.5
    return fig


def _move_legends_above(*figs: Any) -> None:
    for fig in figs:
        box = fig.legend[0]
        fig.add_layout(box, "above")
        box.update(
            orientation="horizontal", label_text_font_size=_FONT_SIZE, label_text_color=_INK, border_line_color=None,
            padding=0, margin=2, spacing=14, glyph_width=24,
        )  # fmt: skip


def _show_or_hide_line(fig: Any, label: str, visible: bool) -> list[Change]:
    """Return the changes that show or hide the line with this label, and its entry in the legend."""
    (item,) = [item for item in fig.legend[0].items if item.label.value == label]
    return [(model.id, {"visible": visible}) for model in (item, item.renderers[0])]


class LoopFigures:
    """The figures of the page that show one loop on one day; they change by the `Change` that a method returns."""

    def __init__(self) -> None:
        names = ("hours", "T_sup", "T_measured", "T_set", "u", "command", "opening", "estimate", "backlash")
        self._traces = traces = ColumnDataSource({name: [] for name in names}, name="traces")
        self._edges = ColumnDataSource({"command": [], "opening": []})
        self._point = ColumnDataSource({"hunting_index": [], "at": []}, name="hunting_indices")
        hours = Range1d(0.0, 8.0)
        dashed_style: Any = {"source": traces, "color": _INK, "width": 2, "dash": [8, 4]}

        self.temperature = fig = _figure("temperature", hours, (12.0, 16.0), y_axis_label="temperature [°C]")
        fig.line("hours", "T_measured", source=traces, color="#999999", width=1, legend_label="sensor")
        fig.line("hours", "T_set", legend_label="set-point", **dashed_style)
        fig.line("hours", "T_sup", source=traces, color=BLUE, width=_LINE_WIDTH_PX, legend_label="supply air")

        self.valve = fig = _figure("opening", hours, (0, 100), x_axis_label="time [h]", y_axis_label="valve [%]")
        thin_style: Any = {"color": _INK, "width": 1.5, "dash": [2, 3]}
        fig.step("hours", "u", source=traces, mode="after", legend_label="PI asks", **thin_style)
        fig.step("hours", "command", source=traces, color=RED, width=2, mode="after", legend_label="command")
        fig.line("hours", "opening", source=traces, color=BLUE, width=_LINE_WIDTH_PX, legend_label="opening")

        self._test_shades = []
        for fig in (self.temperature, self.valve):
            shade = BoxAnnotation(fill_color=_SHADE_GREY, fill_alpha=0.5, line_alpha=0.0, level="underlay")
            fig.add_layout(shade)
            self._test_shades.append(shade)

        self.estimate = fig = _figure("estimate", hours, (0, 8), x_axis_label="time [h]", y_axis_label="gap [%]")
        fig.line("hours", "backlash", legend_label="gap", **dashed_style)
        thick_style: Any = {"color": RED, "width": _LINE_WIDTH_PX}
        fig.step("hours", "estimate", source=traces, mode="after", legend_label="estimate", **thick_style)
        fig.yaxis.ticker.desired_num_ticks = 3

        self.gap = fig = _figure("gap", (0, 100), (0, 100), x_axis_label="command [%]", y_axis_label="opening [%]")
        edge_style: Any = {"color": "#999999", "width": 1.5, "dash": [4, 4]}
        fig.line("command", "opening", source=self._edges, legend_label="edges", **edge_style)
        fig.line("command", "opening", source=traces, color=RED, width=1.5, legend_label="command")
        fig.line("u", "opening", source=traces, color=BLUE, width=_LINE_WIDTH_PX, legend_label="PI asks")
        _move_legends_above(self.temperature, self.valve, self.estimate, self.gap)

        title = "Hunting index, predicted by theory"
        self.hunting_index = fig = _figure("hunting_index", (0.03, 30.0), (-1.0, 1.0), x_axis_type="log", title=title)
        band_style: Any = {"fill_alpha": 0.5, "line_alpha": 0.0, "level": "underlay"}
        low, high = UNSURE_HUNTING_INDEX
        fig.add_layout(BoxAnnotation(left=low, right=high, fill_color=_SHADE_GREY, **band_style))
        fig.add_layout(BoxAnnotation(left=high, fill_color=YELLOW, **band_style))
        limit_style: Any = {"line_color": _INK, "line_dash": [6, 4], "line_width": 2}
        fig.add_layout(Span(location=HUNTING_INDEX_LIMIT, dimension="height", **limit_style))
        fig.text([0.15, 7.0], [-0.35, -0.35], text=["calm", "hunts"], text_align="center", text_font_size=_FONT_SIZE)
        mark_style: Any = {"marker": "diamond", "size": 26, "color": BLUE, "line_color": "white"}
        fig.scatter("hunting_index", "at", source=self._point, **mark_style)
        fig.yaxis.visible = fig.ygrid.visible = False
        fig.xaxis.ticker = [0.1, 0.3, 0.85, 3, 10]
        self.all = (self.temperature, self.valve, self.estimate, self.gap, self.hunting_index)

    def show(self, run: Run, window: str) -> list[Change]:
        """Return the changes that show a loop: all of the day after the warm-up, or by ``window`` its last hours."""
        n, seconds = run.hours.size, {"2h": 7200, "half": 1800}.get(window)
        first_sample = min(run.scene.warm_up // TRACE_INTERVAL_S, n - 1)
        if seconds is not None:
            first_sample = max(0, n - seconds // TRACE_INTERVAL_S - 1)
        hours, traces = run.hours[first_sample:], {name: values[first_sample:] for name, values in run.traces.items()}
        for name in ("u", "command", "opening", "estimate"):
            traces[name] = 100.0 * traces[name]
        traces["backlash"] = np.full(n - first_sample, 100.0 * run.parameter("backlash"))
        test_hours = hours[traces.pop("test") > 0.0]
        left, right = test_hours.min(initial=np.inf), test_hours.max(initial=-np.inf)
        test_shade = {"left": left, "right": right, "visible": test_hours.size > 0}
        has_sensor = run.parameter("noise_std") > 0.0 or run.parameter("sensor_time_constant") > 0.0
        has_compensation = run.has_estimator or run.parameter("backlash_estimate") > 0.0
        pi_output, sensor_trace = [traces["u"]] * has_compensation, [traces["T_measured"]] * has_sensor
        return [
            (self._traces.id, {"data": {"hours": hours, **traces}}),
            (self._edges.id, {"data": _edges(run.parameter("backlash"))}),
            *((shade.id, test_shade) for shade in self._test_shades),
            *_show_or_hide_line(self.temperature, "sensor", has_sensor),
            *_show_or_hide_line(self.valve, "PI asks", has_compensation),
            *_show_or_hide_line(self.gap, "PI asks", has_compensation),
            (self.estimate.id, {"visible": run.has_estimator}),
            (self.temperature.x_range.id, {"start": float(hours[0]), "end": float(hours[-1])}),
            _fit_axis(self.temperature.y_range, 1.0, traces["T_sup"], traces["T_set"], *sensor_trace),
            _fit_axis(self.valve.y_range, 10.0, traces["command"], traces["opening"], *pi_output),
            _fit_axis(self.gap.x_range, 12.0, traces["command"], *pi_output),
            _fit_axis(self.gap.y_range, 12.0, traces["opening"]),
            _fit_axis(self.estimate.y_range, 8.0, traces["estimate"], traces["backlash"], np.zeros(1)),
        ]

    def show_hunting_index(self, *hunting_index: float) -> list[Change]:
        """Return the change that marks a hunting index, at the end of the scale if beyond it, or none without one."""
        shown_index = np.clip(hunting_index, 0.036, 25.0).tolist()
        return [(self._point.id, {"data": {"hunting_index": shown_index, "at": [0] * len(shown_index)}})]


def _fit_axis(axis_range: Range1d, least: float, *values: Array) -> Change:
    """Return the change of an axis that shows all finite values, over a length of at least ``least``."""
    finite = np.concatenate(values)
    finite = finite[np.isfinite(finite)] if np.isfinite(finite).any() else np.zeros(1)
    low, high = float(finite.min()), float(finite.max())
    margin = max(0.04 * (high - low), 0.5 * (least - (high - low)))
    return axis_range.id, {"start": low - margin, "end": high + margin}


def _edges(backlash: float) -> dict[str, list[float]]:
    """Return both edges of Eq (1) in %: the opening while the motor opens the valve, and while it closes it."""
    command = [100.0 * backlash, 100.0, np.nan, 0.0, 100.0 * (1.0 - backlash)]
    return {"command": command, "opening": [0.0, 100.0, np.nan, 0.0, 100.0]}


class MapFigure:
    """The map; cells lie at 0, 1, 2, … whatever the parameter.  on_tap: called with the place clicked, x first."""

    def __init__(self, on_tap: Callable[[float, float], None]) -> None:
        self._axes, self._cell_data = "", dict[str, Any]()
        self._cells = ColumnDataSource({name: [] for name in ("x", "y", "value", "at_x", "at_y")}, name="cells")
        self._point = ColumnDataSource({"x": [], "y": []}, name="here")
        self.fig = _figure("map", (-0.5, 15.5), (-0.5, 11.5), title="Map: click to move the ring")
        self._colours = LinearColorMapper(Cividis256, low=0.0, nan_color="#dddddd")
        fill = {"field": "value", "transform": self._colours}
        cell_glyphs = self.fig.rect("x", "y", 1.0, 1.0, source=self._cells, line_color=None, fill_color=fill)
        ring_style: Any = {"source": self._point, "marker": "circle", "size": 22, "fill_color": None}
        self.fig.scatter("x", "y", line_color="white", line_width=7, **ring_style)
        self.fig.scatter("x", "y", line_color=RED, line_width=4, **ring_style)
        self._bar = ColorBar(
            color_mapper=self._colours, title_text_font_size=_FONT_SIZE, title_text_color=_INK,
            title_text_font_style="normal", title_standoff=6, major_label_text_font_size=_FONT_SIZE, width=14,
            padding=4,
        )  # fmt: skip
        self.fig.add_layout(self._bar, "right")
        self.fig.add_tools(HoverTool(renderers=[cell_glyphs], tooltips=[("", "@value{0.00} K at @at_x, @at_y")]))
        self.fig.on_event(Tap, lambda event: on_tap(event.x, event.y))
        self.fig.grid.visible = False

    def show(self, metrics: Mapping[str, Array], settings: Settings) -> tuple[list[Change], bool]:
        """Return the changes that show a map and mark a loop on it, and whether the loop lies on the map."""
        if self._axes != settings.axes:
            self._axes, self._cell_data = settings.axes, self._label_axes(settings.axes)
        point = {}
        for side, (name, values) in zip("xy", MAP_AXES[settings.axes].items(), strict=True):
            point[side] = [np.interp(getattr(settings, name), values, range(len(values)), left=np.nan, right=np.nan)]
        changes: list[Change] = [
            (self._colours.id, {"high": _COLOUR_MAXIMA_K[settings.axes][settings.colour]}),
            (self._bar.id, {"title": f"{MENUS['colour'].words[settings.colour]} [K]"}),
            (self._cells.id, {"data": self._cell_data | {"value": metrics[settings.colour].ravel()}}),
            (self._point.id, {"data": point}),
        ]
        return changes, bool(np.isfinite([*point["x"], *point["y"]]).all())

    def _label_axes(self, axes: str) -> dict[str, Any]:
        """Label the axes of a map; return the columns of its cells: where they are, and their values in words."""
        columns: dict[str, Any] = {}
        sides = (self.fig.xaxis[0], self.fig.yaxis[0]), (self.fig.x_range, self.fig.y_range)
        cell_indices = np.meshgrid(*(np.arange(len(values)) for values in MAP_AXES[axes].values()))
        by_side = zip("xy", MAP_AXES[axes].items(), cell_indices, *sides, strict=True)
        for side, (name, values), cells, axis, extent in by_side:
            dial, n = DIALS[name], len(values)
            texts = [dial.value_text(value) for value in values]
            columns |= {side: cells.ravel(), f"at_{side}": [texts[k] for k in cells.ravel()]}
            axis.axis_label = f"{dial.label} [{dial.unit}]"
            axis.ticker = list(range(0, n, 3))
            axis.major_label_overrides = {k: f"{dial.factor * values[k]:.3g}" for k in range(n)}
            extent.update(start=-0.5, end=n - 0.5)
        return columns

    def clear(self) -> list[Change]:
        """Return the changes that empty the map."""
        return [(source.id, {"data": {name: [] for name in source.data}}) for source in (self._cells, self._point)]

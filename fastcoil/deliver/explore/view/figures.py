"""The figures of the page, empty, and how they are filled."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from bokeh.models import BoxAnnotation, ColumnDataSource, Range1d, Span
from bokeh.plotting import figure

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, RED, YELLOW
from fastcoil.deliver.explore.model.run import EVERY, Run
from fastcoil.deliver.explore.view.looks import INK, LINE, MARK, SHADE, legend, plain, show_line, text
from fastcoil.design.explanation.predicted import UNSURE
from fastcoil.design.theory.cycles import HUNTS_ABOVE

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
        margin = float(np.clip(np.nan_to_num(run.foretold.margin), *_MARKED))
        self.point.data = {"margin": [] if run.foretold.doubt else [margin], "at": [] if run.foretold.doubt else [0]}
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
    fig = figure(
        name="temperature", x_range=hours, y_range=Range1d(12.0, 16.0), y_axis_label="temperature [°C]",
        **plain(),
    )  # fmt: skip
    measured = fig.line("hours", "T_measured", source=traces, color=_GREY, width=1, legend_label="sensor")
    measured.name = "measured"
    fig.line("hours", "T_set", source=traces, color=INK, width=2, dash=[8, 4], legend_label="set-point")
    fig.line("hours", "T_sup", source=traces, color=BLUE, width=LINE, legend_label="supply air")
    return legend(text(fig))


def _opening(traces: ColumnDataSource, hours: Range1d) -> Any:
    fig = figure(
        name="opening", x_range=hours, y_range=Range1d(0.0, 100.0), x_axis_label="time [h]",
        y_axis_label="valve [%]", **plain(),
    )  # fmt: skip
    asked = fig.step(
        "hours", "u", source=traces, color=INK, width=1.5, dash=[2, 3], mode="after", legend_label="PI asks"
    )
    asked.name = "asked"
    fig.step("hours", "command", source=traces, color=RED, width=2, mode="after", legend_label="command")
    fig.line("hours", "opening", source=traces, color=BLUE, width=LINE, legend_label="opening")
    return legend(text(fig))


def _estimate(traces: ColumnDataSource, hours: Range1d) -> Any:
    fig = figure(
        name="estimate", x_range=hours, y_range=Range1d(0.0, 8.0), x_axis_label="time [h]",
        y_axis_label="gap [%]", visible=False, **plain(),
    )  # fmt: skip
    fig.line("hours", "backlash", source=traces, color=INK, width=2, dash=[8, 4], legend_label="gap")
    fig.step("hours", "estimate", source=traces, color=RED, width=LINE, mode="after", legend_label="estimate")
    fig.yaxis.ticker.desired_num_ticks = 3
    return legend(text(fig))


def _gap(traces: ColumnDataSource, play: ColumnDataSource) -> Any:
    fig = figure(
        name="gap", x_range=Range1d(0.0, 100.0), y_range=Range1d(0.0, 100.0), x_axis_label="command [%]",
        y_axis_label="opening [%]", **plain(),
    )  # fmt: skip
    fig.line("command", "opening", source=play, color=_GREY, width=1.5, dash=[4, 4], legend_label="edges")
    fig.line("command", "opening", source=traces, color=RED, width=1.5, legend_label="over command")
    asked = fig.line("u", "opening", source=traces, color=BLUE, width=LINE, legend_label="over what PI asks")
    asked.name = "asked"
    return legend(text(fig))


def _margin(point: ColumnDataSource) -> Any:
    fig = figure(
        name="margin", x_axis_type="log", x_range=Range1d(*_MARGINS), y_range=Range1d(-1.0, 1.0),
        title="Margin, foretold by theory", **plain(),
    )  # fmt: skip
    fig.add_layout(
        BoxAnnotation(
            left=UNSURE[0], right=UNSURE[1], fill_color=SHADE, fill_alpha=0.5, line_alpha=0.0, level="underlay"
        )
    )
    fig.add_layout(BoxAnnotation(left=UNSURE[1], fill_color=YELLOW, fill_alpha=0.5, line_alpha=0.0, level="underlay"))
    fig.add_layout(Span(location=HUNTS_ABOVE, dimension="height", line_color=INK, line_dash=[6, 4], line_width=2))
    fig.text([0.15, 7.0], [-0.35, -0.35], text=["calm", "hunts"], text_align="center", text_font_size=MARK)
    fig.scatter("margin", "at", source=point, marker="diamond", size=26, color=BLUE, line_color="white")
    fig.x_range.bounds = _MARGINS
    fig.yaxis.visible = False
    fig.ygrid.visible = False
    fig.xaxis.ticker = [0.1, 0.3, 0.85, 3, 10]
    return text(fig)

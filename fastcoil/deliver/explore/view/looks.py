"""Large type and few colours, for all figures of the page."""

from __future__ import annotations

from typing import Any

from bokeh.models import ColorBar, Text

INK, SHADE = "#222222", "#cccccc"
LINE, MARK = 3, "16px"
"""Width of the lines that count, px; letters, until the page knows how large its own are."""
LETTERS = """
const size = Math.round(parseFloat(getComputedStyle(document.documentElement).fontSize)) + 'px'
for (const [model, name] of letters) model[name] = size
"""
"""JavaScript: all letters as large as those of the page."""


def plain() -> dict[str, Any]:
    """Of every figure: it fills its place, and there is nothing to click by mistake."""
    return {"sizing_mode": "stretch_both", "toolbar_location": None, "tools": "", "min_height": 60, "min_width": 120}


def text(fig: Any) -> Any:
    """A figure with letters that the last row can read."""
    fig.title.text_font_size = MARK
    fig.title.text_color = INK
    for axis in fig.axis:
        axis.axis_label_text_font_size = MARK
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_standoff = 4
        axis.major_label_text_font_size = MARK
        axis.axis_label_text_color = axis.major_label_text_color = INK
        axis.minor_tick_line_color = None
    fig.outline_line_color = None
    fig.grid.grid_line_alpha = 0.5
    return fig


def legend(fig: Any) -> Any:
    """A figure with its legend in a row above it."""
    box = fig.legend[0]
    fig.add_layout(box, "above")
    box.orientation = "horizontal"
    box.label_text_font_size = MARK
    box.label_text_color = INK
    box.border_line_color = None
    box.padding, box.margin, box.spacing, box.glyph_width = 0, 2, 14, 24
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

"""The figures of the learning rules: time against failures, maps over settings, noise and sample time.

Maps go from light (good) to dark (bad), with the number in each cell; bold numbers are safe.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from fastcoil.base.figures import BLUE, LINE_GREY, RED, YELLOW, apply_style, wrap_text
from fastcoil.loops.labels import quantity

FIGURE_WIDTH = 7.0
SMALL_FONT = 7  # font size of the small print
DARK_SHARE = 0.55  # share of the scale above which numbers are white
ARROW_SHARE = 0.25  # share of the failures below which a kind of failure gets no arrow
SHORTEST_HOURS = 0.25  # start of the scale of hours


def _figure(rows: int, columns: int, height: float, small_print: str) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(FIGURE_WIDTH, height), layout="constrained")
    figure.supxlabel(wrap_text(small_print, FIGURE_WIDTH, SMALL_FONT), fontsize=SMALL_FONT, color="0.3")
    return figure, figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)


def _draw_cells(axes: Axes, values: np.ndarray, texts: Sequence[str], norm: Normalize, safe: np.ndarray) -> AxesImage:
    """Draw a map of ``values``, first row below, with a text in each cell."""
    image = axes.imshow(values, origin="lower", aspect="auto", cmap="cividis", norm=norm)
    for (row, column), text in zip(np.ndindex(values.shape), texts, strict=True):
        colour = "white" if norm(values[row, column]) > DARK_SHARE else "black"
        weight = "bold" if safe[row, column] else "normal"
        axes.text(column, row, text, ha="center", va="center", fontsize=6, color=colour, weight=weight)
    axes.set_xticks(np.arange(values.shape[1] + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(values.shape[0] + 1) - 0.5, minor=True)
    axes.grid(visible=True, which="minor", color="white", lw=0.8, alpha=1.0)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_visible(False)
    return image


def failure_arrow(low: float, high: float) -> str:
    """Arrow of the failures: down where learners stop early, up where they run away, or both."""
    if low + high == 0.0:
        return ""
    down, up = low >= ARROW_SHARE * (low + high), high >= ARROW_SHARE * (low + high)
    return "↕" if down and up else "↓" if down else "↑"


def draw_failure_map(judgement: xr.Dataset, safe: float, small_print: str) -> Figure:
    """Draw failures over noise × sample time: loops side by side, rules and buffers below each other."""
    norm = Normalize(0.0, 100.0)
    variants = [(rule, buffer) for rule in judgement.rule.values for buffer in judgement.buffer.values]
    with apply_style(axes_grid=False):
        figure, axes = _figure(len(variants), judgement.sizes["tuning"], 1.9 * len(variants) + 0.8, small_print)
        for row, (rule, buffer) in zip(axes, variants, strict=True):
            for panel, tuning in zip(row, judgement.tuning.values, strict=True):
                cell = judgement.sel(rule=rule, buffer=buffer, tuning=tuning).transpose("noise_std", "sample_time")
                low, high, share_failed = (cell[n].values for n in ("low", "high", "failed"))
                texts = [
                    f"{100 * f:.0f}{failure_arrow(a, b)}"
                    for a, b, f in zip(low.flat, high.flat, share_failed.flat, strict=True)
                ]
                image = _draw_cells(panel, 100 * share_failed, texts, norm, share_failed <= safe)
            buffer_text = f"buffer {100 * buffer:.0f} %" if buffer > 1e-6 else "no buffer"
            row[0].set_ylabel(f"{rule}, {buffer_text}\nnoise [K]")
        _label_axes(axes, judgement.tuning.values, quantity("sample_time").axis)
        axes[0, 0].set_xticks(range(judgement.sizes["sample_time"]), [f"{t:g}" for t in judgement.sample_time.values])
        axes[0, 0].set_yticks(range(judgement.sizes["noise_std"]), [f"{s:g}" for s in judgement.noise_std.values])
        figure.colorbar(
            image, ax=axes, label="failures [% of learners]   ↓ stops early   ↑ runs away   ↕ both", aspect=40
        )
    return figure


def draw_settings(judgement: xr.Dataset, rules: Sequence[str], hours: float, safe: float, small_print: str) -> Figure:
    """Draw failures, then hours to confirm, over step, interval and ratio: loops side by side, a row for each rule."""
    lines = judgement.stack(line=["learning_interval", "learning_ratio"]).transpose("line", "learning_step", ...)
    with apply_style(axes_grid=False):
        figure, axes = _figure(2 * len(rules), judgement.sizes["tuning"], 2.2 * 2 * len(rules) + 0.6, small_print)
        quantities = (
            (100 * lines.failed, "{:.0f}", Normalize(0.0, 100.0), "failures [% of learners]"),
            (lines.confirmed, "{:.1f}", LogNorm(SHORTEST_HOURS, hours, clip=True), "confirmed after [h]; –: never"),
        )
        for rows, (values, template, norm, name) in zip(np.split(axes, 2), quantities, strict=True):
            for row, rule in zip(rows, rules, strict=True):
                for panel, tuning in zip(row, judgement.tuning.values, strict=True):
                    cell = {"rule": rule, "tuning": tuning}
                    cell_values = values.sel(cell).values
                    texts = [template.format(x) if np.isfinite(x) else "–" for x in cell_values.flat]
                    is_safe = lines.failed.sel(cell).values <= safe
                    image = _draw_cells(panel, np.minimum(cell_values, norm.vmax), texts, norm, is_safe)
                row[0].set_ylabel(f"{rule}\ninterval [min], ratio")
            bar = figure.colorbar(image, ax=rows, label=name, aspect=40)
            if isinstance(norm, LogNorm):
                bar.set_ticks([SHORTEST_HOURS, 1, 4, hours], labels=[f"{t:g}" for t in (SHORTEST_HOURS, 1, 4, hours)])
                bar.minorticks_off()
        _label_axes(axes, judgement.tuning.values, quantity("learning_step").axis)
        axes[0, 0].set_xticks(
            range(judgement.sizes["learning_step"]), [f"{100 * s:g}" for s in judgement.learning_step.values]
        )
        axes[0, 0].set_yticks(range(lines.sizes["line"]), [f"{i / 60:.0f}, {r:g}" for i, r in lines.line.values])
    return figure


RULE_LINES = {
    "literal": {"color": BLUE, "ls": "-", "lw": 1.2},
    "hold": {"color": LINE_GREY, "ls": "--", "lw": 1.2},
    "early": {"color": "black", "ls": ":", "lw": 1.4},
    "growing": {"color": YELLOW, "ls": "-", "lw": 2.4},
    "stopping": {"color": RED, "ls": "-.", "lw": 1.2},
}


def draw_front(judgement: xr.Dataset, measure: str, label: str, y_max: float, hours: float, small_print: str) -> Figure:
    """Draw for each rule the lowest ``measure`` (a share, drawn in %) of the choices that confirm by a time.

    A line for each rule, loops side by side, noises below each other.
    """
    choices = [d for d in judgement.confirmed.dims if d not in ("tuning", "noise_std", "rule")]
    with apply_style():
        figure, axes = _figure(
            judgement.sizes["noise_std"], judgement.sizes["tuning"], 1.6 * judgement.sizes["noise_std"] + 1, small_print
        )
        for row, noise in zip(axes, judgement.noise_std.values, strict=True):
            for panel, tuning in zip(row, judgement.tuning.values, strict=True):
                for rule in map(str, judgement.rule.values):
                    cell = judgement.sel(tuning=tuning, noise_std=noise, rule=rule).stack(choice=choices)
                    cell = cell.isel(choice=np.isfinite(cell.confirmed.values)).sortby("confirmed")
                    lowest = np.minimum.accumulate(100 * cell[measure].values)
                    xy = [*cell.confirmed.values, hours], [*lowest, *lowest[-1:]]
                    panel.step(*(xy if lowest.size else ([], [])), where="post", label=rule, **RULE_LINES[rule])
            row[0].set_ylabel(f"noise {noise:g} K\n{label}")
        _label_axes(axes, judgement.tuning.values, "confirmed after [h]")
        axes[0, 0].set(xscale="log", xlim=(SHORTEST_HOURS, hours), ylim=(-0.03 * y_max, y_max))
        axes[0, 0].set_xticks([0.5, 1, 2, 4, 8], ["½", "1", "2", "4", "8"])
        for panel in axes.flat:
            panel.minorticks_off()
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False)
    return figure


def _label_axes(axes: np.ndarray, tunings: np.ndarray, x_label: str) -> None:
    """Name the loops above the columns, and the x axis below."""
    for panel, tuning in zip(axes[0], tunings, strict=True):
        panel.set_title(str(tuning))
    for panel in axes[-1]:
        panel.set_xlabel(x_label)

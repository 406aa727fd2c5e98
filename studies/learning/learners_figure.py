"""The figure of ``learners.py``: where each estimator finds the backlash, and where it makes a loop worse."""

from __future__ import annotations

from collections.abc import Callable

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from fastcoil.base.figures import BLUE, FAINT, RED, YELLOW, apply_style
from fastcoil.study.analysis.paired import Share, share_of
from studies.common import save_figure
from studies.learning.learners_run import HARM, KNOWN, WORSE, Run, controllers, fails, harmed
from studies.learning.learners_tables import LABELS

PALE = "#EE99AA"
MARKS = {
    "paper": (YELLOW, "v"),
    "growing": (RED, "s"),
    "hagglund": ("0.6", "^"),
    "gradient": (PALE, "P"),
    "identify": (BLUE, "o"),
    KNOWN: ("black", "x"),
}
"""Colour and mark of the controllers that are shown, in the order of the legend."""
ROW = 0.5
"""Height of a condition, inches."""


@apply_style()
def draw(runs: list[Run]) -> None:
    """Draw wrong estimates and loops that get worse side by side, a row for each condition; good valves come last."""
    runs = sorted(runs, key=lambda run: run.is_good)
    shown = [name for name in MARKS if name in controllers()]
    figure, panels = plt.subplots(1, 2, figsize=(10.0, 1.6 + ROW * len(runs)), sharey=True, layout="constrained")
    worn = [run for run in runs if not run.is_good]
    _panel(panels[0], worn, [name for name in shown if name != KNOWN], lambda run, name: share_of(fails(run, name)))
    _panel(panels[1], runs, shown, harmed)
    panels[0].set(xlabel="wrong estimates at the end [%]", xlim=(-3, 103))
    panels[1].set(xlabel="loops worse than their plain PI [%]", xlim=(-3, 103))
    panels[0].set_yticks(range(len(runs)), [run.condition.name.replace("`", "") for run in runs])
    panels[0].set_ylim(len(runs) - 0.5, -0.5)
    _note(panels[1], 0, WORSE)
    if len(worn) < len(runs):
        _note(panels[1], len(worn), HARM)
        panels[0].text(50, 0.5 * (len(worn) + len(runs) - 1), "nothing to find", ha="center", va="center", color="0.3")
        for panel in panels:
            panel.axhline(len(worn) - 0.5, color="0.4", lw=0.8)
    figure.legend(*panels[1].get_legend_handles_labels(), loc="outside lower center", ncols=len(shown))
    save_figure(figure, "learning/learners.png")


def _note(panel: Axes, row: int, least: float) -> None:
    """Say from this row on what counts as worse."""
    panel.text(103, row - 0.4, f"by more than {100 * least:.0f} %", ha="right", va="top", color="0.3", fontsize=8)


def _panel(panel: Axes, runs: list[Run], names: list[str], share: Callable[[Run, str], Share]) -> None:
    """A mark with its interval for each condition and controller."""
    for place, name in enumerate(names):
        colour, mark = MARKS[name]
        shares = [share(run, name) for run in runs]
        at = [row + 0.72 * ((place + 0.5) / len(names) - 0.5) for row in range(len(runs))]
        for y, one in zip(at, shares, strict=True):
            panel.plot([100 * one.low, 100 * one.high], [y, y], color=colour, lw=1.0, zorder=2)
        panel.plot([100 * one.value for one in shares], at, mark, color=colour, ms=4.5, zorder=3, label=LABELS[name])
    for row in range(0, len(runs), 2):
        panel.axhspan(row - 0.5, row + 0.5, color=FAINT, alpha=0.5, zorder=0, lw=0)
    panel.grid(visible=False, axis="y")

"""The figure of ``remedies.py``: error over motor travel, both against the best PI of the same valve."""

from __future__ import annotations

import matplotlib.pyplot as plt
import xarray as xr
from kinds import STEPPED
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter
from remedies_front import front, others
from remedies_run import SIMC
from remedies_tables import LABELS
from report import HERE

from fastcoil.plots.style import BLUE, RED, YELLOW, apply_style

CURVES = {
    "pi": (BLUE, "-", "o"),
    "dead_band_025": ("black", "--", "s"),
    "inverse_80_buffer": (YELLOW, "-", "^"),
    "inverse_95_small_buffer": (RED, "-", "D"),
    "learner_growing": ("0.5", ":", "v"),
}
"""Colour, line and mark of remedies with gains of their own."""
POINTS = {
    SIMC: ("PI", (6, 4)),
    "half_kp": ("PI, half kp", (6, 4)),
    "dead_band_025": ("dead band 0.25 K", (6, 4)),
    "inverse_80_buffer": ("inverse 80 %", (-6, -11)),
    "inverse_95_small_buffer": ("inverse 95 %", (6, -9)),
    "hagglund_inverse": ("Hägglund", (6, 1)),
    "gradient": ("gradient", (6, -7)),
    "own_rule": ("own rule", (6, 4)),
    "learner_growing": ("learner", (6, 4)),
}
"""Remedies with the gains of SIMC: name and where it stands, points from the mark."""
TICKS = (5, 10, 20, 50, 100, 200, 500)
WIDEST = 150
"""Largest change of RMSE shown, %."""


@apply_style()
def draw(own: dict[str, xr.Dataset], by_simc: dict[str, xr.Dataset]) -> None:
    """Draw days whose set-point stands still and days on which it steps side by side."""
    still = [kind for kind in own if kind != STEPPED]
    figure, panels = plt.subplots(1, 2, figsize=(10.0, 5.2), sharey=True, layout="constrained")
    for panel, some, title in ((panels[0], still, "set-point stands still"), (panels[1], [STEPPED], "set-point steps")):
        _curves(panel, own, [kind for kind in some if kind in own])
        _points(panel, own, by_simc, [kind for kind in some if kind in own])
        panel.axhline(0.0, color="0.8", zorder=0)
        panel.axvline(100.0, color="0.8", zorder=0)
        panel.set(
            title=title, xscale="log", xlim=(3, 800), ylim=(-45, WIDEST), xlabel="motor travel [% of the best PI]"
        )
        panel.set_xticks(TICKS, [f"{tick}" for tick in TICKS])
        panel.xaxis.set_minor_formatter(NullFormatter())
    panels[0].set_ylabel("RMSE, mean change against the best PI [%]")
    panels[0].yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:+.0f}" if y else "0"))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    path = HERE / "remedies.png"
    figure.savefig(path, dpi=150)
    plt.close(figure)
    print(path)


def _curves(panel: Axes, own: dict[str, xr.Dataset], some: list[str]) -> None:
    found = front(own, some)
    for name, (colour, line, mark) in CURVES.items():
        travel, change = found[name]
        panel.plot(100 * travel, 100 * change, line, marker=mark, color=colour, ms=4.5, zorder=3,
                   label=f"{LABELS[name]}, own gains")  # fmt: skip


def _points(panel: Axes, own: dict[str, xr.Dataset], by_simc: dict[str, xr.Dataset], some: list[str]) -> None:
    found = others(own, by_simc, some)
    for k, (name, (text, place)) in enumerate(POINTS.items()):
        travel, change = found[name]
        panel.plot(100 * travel, 100 * change, "o", color="black", ms=5, fillstyle="none", zorder=4,
                   label="others: gains of SIMC" if k == 0 else None)  # fmt: skip
        ends = "right" if place[0] < 0 else "left"
        panel.annotate(text, (100 * travel, 100 * change), place, textcoords="offset points", fontsize=7.5, ha=ends,
                       color="0.2")  # fmt: skip

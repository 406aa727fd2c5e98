"""The figure of ``remedies.py``: error over motor travel, both against the best PI of the same valve."""

from __future__ import annotations

import matplotlib.pyplot as plt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from fastcoil.base.figures import BLUE, RED, YELLOW, apply_style
from studies.common import save_figure
from studies.days import STEPPED
from studies.remedies.front import front, others
from studies.remedies.run import SIMC
from studies.remedies.tables import LABELS

PALE = "#EE99AA"
CURVES = {
    "pi": (BLUE, "-", "o"),
    "dead_band_025": ("black", "--", "s"),
    "inverse_80_buffer": (YELLOW, "-", "^"),
    "inverse_95_noise_buffer": (RED, "-", "D"),
    "inverse_95_small_buffer": (PALE, "--", "D"),
    "learner_growing": ("0.5", ":", "v"),
}
"""Colour, line and mark of remedies with gains of their own."""
POINTS = (
    SIMC,
    "faster",
    "half_kp",
    "dead_band_025",
    "inverse_80_buffer",
    "inverse_95_noise_buffer",
    "hagglund_inverse",
    "gradient",
    "learner_growing",
    "own_rule",
)
"""Remedies that are shown with the gains of SIMC, as numbers."""
TICKS = (5, 10, 20, 50, 100, 200)
LOWEST, WIDEST = -45, 175
"""Changes of RMSE that are shown, %."""


@apply_style()
def draw(own: dict[str, xr.Dataset], by_simc: dict[str, xr.Dataset]) -> None:
    """Draw days whose set-point stands still and days on which it steps side by side."""
    still = [kind for kind in own if kind != STEPPED]
    figure, panels = plt.subplots(1, 2, figsize=(10.0, 6.0), sharey=True, layout="constrained")
    for panel, some, title in ((panels[0], still, "set-point stands still"), (panels[1], [STEPPED], "set-point steps")):
        _curves(panel, own, some)
        _points(panel, own, by_simc, some)
        panel.axhline(0.0, color="0.8", zorder=0)
        panel.axvline(100.0, color="0.8", zorder=0)
        panel.set(
            title=title, xscale="log", xlim=(2.5, 400), ylim=(LOWEST, WIDEST), xlabel="motor travel [% of the best PI]"
        )
        panel.set_xticks(TICKS, [f"{tick}" for tick in TICKS])
        panel.xaxis.set_minor_formatter(NullFormatter())
    key = "\n".join(f"{number:>2}  {LABELS[name]}" for number, name in enumerate(POINTS, start=1))
    panels[1].text(0.97, 0.96, f"gains of SIMC\n{key}", transform=panels[1].transAxes, fontsize=8, ha="right", va="top",
                   ma="left", bbox={"facecolor": "white", "edgecolor": "0.8"})  # fmt: skip
    panels[0].set_ylabel("RMSE, mean change against the best PI [%]")
    panels[0].yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:+.0f}" if y else "0"))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    save_figure(figure, "remedies/remedies.png")


def _curves(panel: Axes, own: dict[str, xr.Dataset], some: list[str]) -> None:
    found = front(own, some)
    for name, (colour, line, mark) in CURVES.items():
        travel, change = found[name]
        panel.plot(100 * travel, 100 * change, line, marker=mark, color=colour, ms=4.5, zorder=3,
                   label=f"{LABELS[name]}, own gains")  # fmt: skip


def _points(panel: Axes, own: dict[str, xr.Dataset], by_simc: dict[str, xr.Dataset], some: list[str]) -> None:
    found = others(own, by_simc, some)
    for number, name in enumerate(POINTS, start=1):
        travel, change = found[name]
        panel.plot(100 * travel, 100 * change, "o", mfc="white", mec="black", mew=0.8, ms=10, zorder=4)
        panel.annotate(str(number), (100 * travel, 100 * change), fontsize=7, ha="center", va="center", zorder=5)

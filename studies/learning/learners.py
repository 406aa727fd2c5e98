"""Estimators of the backlash under many conditions: tables of failures, harm and cost, the figure, and ``main``.

The estimators are the rows of ``learners.toml``.  All estimators of a loop see the same days and the same noise.
"""

from __future__ import annotations

from collections.abc import Callable

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from fastcoil.base.figures import BLUE, RED, SHADE_GREY, YELLOW, apply_style
from studies.common import Share, change_in_words, compare_rows, failures, pooled, save_figure, share_of, write_table
from studies.days import STEPPED
from studies.learning import learners_runs
from studies.learning.learners_runs import (
    GOOD,
    HARM,
    KNOWN,
    LOOPS,
    MORNING,
    ONE,
    PI,
    ROUND_OFF,
    SMALL,
    VALVES,
    WORSE,
    Run,
    change,
    controllers,
    fails,
    harmed,
)
from studies.learning.learners_runs import LABELS as OF_KINDS

LABELS = {
    PI: "plain PI",
    KNOWN: "fixed 95 %",
    "paper": "paper's rule",
    "growing": "growing rule",
    "growing_averaged": "growing, averaged reference",
    "growing_error": "growing, error trip too",
    "hagglund": "Hägglund",
    "gradient": "gradient",
    "identify": "identify",
    "identify_stroke": "identify, stroke time known",
}
"""The names of the controllers for readers."""


def estimators() -> list[str]:
    """The controllers that look for the backlash."""
    return [name for name in controllers() if name not in (PI, KNOWN)]


def remedies() -> list[str]:
    """All controllers but the one they are compared with."""
    return [name for name in controllers() if name != PI]


def failure_rows(runs: list[Run], *, one: float = ONE) -> list[list[str]]:
    """A row for each condition with backlash: the share of wrong estimates of each estimator."""
    return [
        [run.condition.name, *(str(share_of(fails(run, name, one=one))) for name in estimators())]
        for run in runs
        if not run.is_good
    ]


def worse_rows(runs: list[Run]) -> list[list[str]]:
    """A row for each condition with backlash: the share of loops that are worse than plain PI."""
    return [[run.condition.name, *(str(harmed(run, name)) for name in remedies())] for run in runs if not run.is_good]


def good_rows(runs: list[Run]) -> list[list[str]]:
    """A row for each condition without backlash: loops that get worse, median change, estimates above 1 %."""
    table = []
    for run in (run for run in runs if run.is_good):
        cells = []
        for name in remedies():
            called = float((run.ds.estimate_final.sel(controller=name) > ONE + ROUND_OFF).mean())
            middle = 100 * float(change(run, name).median())
            cells.append(f"{harmed(run, name)}, {middle:+.1f} %, {100 * called:.0f} %")
        table.append([run.condition.name, *cells])
    return table


def cost_rows(run: Run) -> list[list[str]]:
    """A row for each controller: what the estimates do to error and travel, and whether and when they are right."""
    table = []
    for name in controllers():
        settled, travel = (
            100 * float(change(run, name, metric).median()) for metric in ("rmse_settled", "motor_travel")
        )
        cells = [change_in_words(run.ds, name, PI), f"{settled:+.0f} %", f"× {1 + travel / 100:.2f}"]
        table.append([LABELS[name], *cells, *(_found(run, name) if name in estimators() else ["—"] * 4)])
    return table


def every_kind(runs: list[Run]) -> Run:
    """The valves with backlash on days of every kind, as one dim of days."""
    some = {
        r.condition.kind: r for r in runs if r.condition.name in {f"{VALVES}: {text}" for text in OF_KINDS.values()}
    }
    return some[STEPPED]._replace(ds=pooled({kind: run.ds for kind, run in some.items()}))


def _found(run: Run, name: str) -> list[str]:
    """Wrong estimates below and above the backlash, days that end with a right one, and since when it was right."""
    estimate, wrong = run.ds.estimate_final.sel(controller=name), fails(run, name)
    low, high = (100 * float((wrong & beyond).mean()) for beyond in (estimate < run.backlash, estimate > run.backlash))
    since = np.sort(run.ds.time_identified.sel(controller=name).fillna(np.inf).values.ravel())
    middle = since[(since.size - 1) // 2] / 3600
    return [f"{low:.0f} %", f"{high:.0f} %", str(share_of(~wrong)), f"{middle:.1f} h" if np.isfinite(middle) else "—"]


COST = [
    "estimator", "RMSE, mean change (95 %)", "settled RMSE, median", "motor travel, median", "too low", "too high",
    "right at the end (95 %)", "right since, median",
]  # fmt: skip


def write(runs: list[Run]) -> None:
    """Write every table."""
    loops, valves = (next(run for run in runs if run.condition.name.startswith(f"{of}: ")) for of in (LOOPS, VALVES))
    sizes = " and ".join(
        f"{run.ds.sizes['sample']} {what} × {run.ds.sizes['day']} days"
        for run, what in ((loops, "loops"), (valves, "valves"))
    )
    finding, all_names = ([LABELS[name] for name in of] for of in (estimators(), remedies()))
    write_table(
        "learning/learners_failures",
        f"Wrong estimates at the end: off by more than 20 % of the backlash and 1 % of the stroke; {sizes} "
        f"({failures(run.ds for run in runs)})",
        ["condition", *finding],
        failure_rows(runs),
    )
    write_table(
        "learning/learners_twenty",
        "Wrong estimates at the end: off by more than 20 % of the backlash, however small",
        ["condition", *finding],
        failure_rows(runs, one=0.0),
    )
    write_table(
        "learning/learners_worse",
        f"Loops whose RMSE is more than 2 % above that of their plain PI; {sizes}",
        ["condition", *all_names],
        worse_rows(runs),
    )
    write_table(
        "learning/learners_good",
        "Valves without backlash: loops whose RMSE rises by more than 1 %, median change, estimates above 1 % of the "
        "stroke",
        ["condition", *all_names],
        good_rows(runs),
    )
    by_name = {run.condition.name: run for run in runs}
    for table, run, where in (
        ("learning/learners_cost", every_kind(runs), "days of every kind"),
        ("learning/learners_cost_stepped", by_name[f"{VALVES}: {OF_KINDS[STEPPED]}"], "days with set-point steps"),
        (
            "learning/learners_cost_morning",
            by_name[MORNING],
            "days whose set-point steps in the first four hours alone",
        ),
    ):
        write_table(table, f"Valves with backlash on {where}, against their plain PI", COST, cost_rows(run))


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
        panel.axhspan(row - 0.5, row + 0.5, color=SHADE_GREY, alpha=0.5, zorder=0, lw=0)
    panel.grid(visible=False, axis="y")


def sample() -> None:
    """Two conditions, one of them without a gap."""
    runs = learners_runs.run(chosen=(SMALL, f"{GOOD}, {LOOPS}: {OF_KINDS[STEPPED]}"))
    compare_rows("learning/learners_failures", failure_rows(runs))
    compare_rows("learning/learners_worse", worse_rows(runs))
    compare_rows("learning/learners_good", good_rows(runs))


def main(size: int | None = None) -> None:
    """Run everything, write the tables and draw the figure; ``size``: only so many loops and valves."""
    runs = learners_runs.run(size)
    write(runs)
    draw(runs)

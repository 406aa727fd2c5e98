"""Estimators of the backlash under many conditions: tables of failures, harm and cost, the figure, and ``main``.

The estimators are the rows of ``learners.toml``.  All estimators of a loop see the same days and the same noise.
"""

from __future__ import annotations

from collections.abc import Callable

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from fastcoil.base.figures import BLUE, RED, SHADE_GREY, YELLOW, apply_style
from studies.common import (
    Share,
    change_in_words,
    compare_rows,
    failures_in_words,
    pool_days,
    save_figure,
    share_of,
    write_table,
)
from studies.days import STEPPED
from studies.learning import learners_runs
from studies.learning.learners_runs import (
    GOOD_LABEL,
    HARM_RISE_GOOD,
    HARM_RISE_WORN,
    KIND_LABELS,
    KNOWN_INVERSE,
    LOOPS_LABEL,
    MORNING_STEPS,
    PI,
    ROUND_OFF,
    SMALL_BACKLASH,
    STROKE_TOLERANCE,
    VALVES_LABEL,
    Run,
    controllers,
    harmed_share,
    is_wrong,
    relative_change,
)

CONTROLLER_LABELS = {
    PI: "plain PI",
    KNOWN_INVERSE: "fixed 95 %",
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
    return [name for name in controllers() if name not in (PI, KNOWN_INVERSE)]


def remedies() -> list[str]:
    """All controllers but the one they are compared with."""
    return [name for name in controllers() if name != PI]


def failure_rows(runs: list[Run], *, stroke_tolerance: float = STROKE_TOLERANCE) -> list[list[str]]:
    """A row for each condition with backlash: the share of wrong estimates of each estimator."""
    return [
        [
            run.condition.name,
            *(str(share_of(is_wrong(run, name, stroke_tolerance=stroke_tolerance))) for name in estimators()),
        ]
        for run in runs
        if not run.is_good
    ]


def worse_rows(runs: list[Run]) -> list[list[str]]:
    """A row for each condition with backlash: the share of loops that are worse than plain PI."""
    return [
        [run.condition.name, *(str(harmed_share(run, name)) for name in remedies())] for run in runs if not run.is_good
    ]


def good_rows(runs: list[Run]) -> list[list[str]]:
    """A row for each condition without backlash: loops that get worse, median change, estimates above 1 %."""
    table = []
    for run in (run for run in runs if run.is_good):
        cells = []
        for name in remedies():
            share_above_one_percent = float(
                (run.ds.estimate_final.sel(controller=name) > STROKE_TOLERANCE + ROUND_OFF).mean()
            )
            middle = 100 * float(relative_change(run, name).median())
            cells.append(f"{harmed_share(run, name)}, {middle:+.1f} %, {100 * share_above_one_percent:.0f} %")
        table.append([run.condition.name, *cells])
    return table


def cost_rows(run: Run) -> list[list[str]]:
    """A row for each controller: what the estimates do to error and travel, and whether and when they are right."""
    table = []
    for name in controllers():
        settled, travel = (
            100 * float(relative_change(run, name, metric).median()) for metric in ("rmse_settled", "motor_travel")
        )
        cells = [change_in_words(run.ds, name, PI), f"{settled:+.0f} %", f"× {1 + travel / 100:.2f}"]
        table.append(
            [CONTROLLER_LABELS[name], *cells, *(_estimate_cells(run, name) if name in estimators() else ["—"] * 4)]
        )
    return table


def pool_kinds(runs: list[Run]) -> Run:
    """The valves with backlash on days of every kind, as one dim of days."""
    by_kind = {
        run.condition.kind: run
        for run in runs
        if run.condition.name in {f"{VALVES_LABEL}: {text}" for text in KIND_LABELS.values()}
    }
    return by_kind[STEPPED]._replace(ds=pool_days({kind: run.ds for kind, run in by_kind.items()}))


def _estimate_cells(run: Run, name: str) -> list[str]:
    """Wrong estimates below and above the backlash, days that end with a right one, and since when it was right."""
    estimate, wrong = run.ds.estimate_final.sel(controller=name), is_wrong(run, name)
    low, high = (100 * float((wrong & beyond).mean()) for beyond in (estimate < run.backlash, estimate > run.backlash))
    right_since = np.sort(run.ds.time_identified.sel(controller=name).fillna(np.inf).values.ravel())
    middle = right_since[(right_since.size - 1) // 2] / 3600
    return [f"{low:.0f} %", f"{high:.0f} %", str(share_of(~wrong)), f"{middle:.1f} h" if np.isfinite(middle) else "—"]


COST_HEAD = [
    "estimator", "RMSE, mean change (95 %)", "settled RMSE, median", "motor travel, median", "too low", "too high",
    "right at the end (95 %)", "right since, median",
]  # fmt: skip


def write_tables(runs: list[Run]) -> None:
    """Write every table."""
    loops, valves = (
        next(run for run in runs if run.condition.name.startswith(f"{group}: "))
        for group in (LOOPS_LABEL, VALVES_LABEL)
    )
    sizes = " and ".join(
        f"{run.ds.sizes['sample']} {description} × {run.ds.sizes['day']} days"
        for run, description in ((loops, "loops"), (valves, "valves"))
    )
    estimator_names, remedy_names = (
        [CONTROLLER_LABELS[name] for name in group] for group in (estimators(), remedies())
    )
    write_table(
        "learning/learners_failures",
        f"Wrong estimates at the end: off by more than 20 % of the backlash and 1 % of the stroke; {sizes} "
        f"({failures_in_words(run.ds for run in runs)})",
        ["condition", *estimator_names],
        failure_rows(runs),
    )
    write_table(
        "learning/learners_twenty",
        "Wrong estimates at the end: off by more than 20 % of the backlash, however small",
        ["condition", *estimator_names],
        failure_rows(runs, stroke_tolerance=0.0),
    )
    write_table(
        "learning/learners_worse",
        f"Loops whose RMSE is more than 2 % above that of their plain PI; {sizes}",
        ["condition", *remedy_names],
        worse_rows(runs),
    )
    write_table(
        "learning/learners_good",
        "Valves without backlash: loops whose RMSE rises by more than 1 %, median change, estimates above 1 % of the "
        "stroke",
        ["condition", *remedy_names],
        good_rows(runs),
    )
    by_name = {run.condition.name: run for run in runs}
    for table, run, days_text in (
        ("learning/learners_cost", pool_kinds(runs), "days of every kind"),
        (
            "learning/learners_cost_stepped",
            by_name[f"{VALVES_LABEL}: {KIND_LABELS[STEPPED]}"],
            "days with set-point steps",
        ),
        (
            "learning/learners_cost_morning",
            by_name[MORNING_STEPS],
            "days whose set-point steps in the first four hours alone",
        ),
    ):
        write_table(table, f"Valves with backlash on {days_text}, against their plain PI", COST_HEAD, cost_rows(run))


PALE_RED = "#EE99AA"
MARKS = {
    "paper": (YELLOW, "v"),
    "growing": (RED, "s"),
    "hagglund": ("0.6", "^"),
    "gradient": (PALE_RED, "P"),
    "identify": (BLUE, "o"),
    KNOWN_INVERSE: ("black", "x"),
}
"""Colour and mark of the controllers that are shown, in the order of the legend."""
ROW_INCHES = 0.5  # height of a condition, inches


@apply_style()
def draw(runs: list[Run]) -> None:
    """Draw wrong estimates and loops that get worse side by side, a row for each condition; good valves come last."""
    runs = sorted(runs, key=lambda run: run.is_good)
    names = [name for name in MARKS if name in controllers()]
    figure, panels = plt.subplots(1, 2, figsize=(10.0, 1.6 + ROW_INCHES * len(runs)), sharey=True, layout="constrained")
    worn_runs = [run for run in runs if not run.is_good]
    _draw_shares(
        panels[0],
        worn_runs,
        [name for name in names if name != KNOWN_INVERSE],
        lambda run, name: share_of(is_wrong(run, name)),
    )
    _draw_shares(panels[1], runs, names, harmed_share)
    panels[0].set(xlabel="wrong estimates at the end [%]", xlim=(-3, 103))
    panels[1].set(xlabel="loops worse than their plain PI [%]", xlim=(-3, 103))
    panels[0].set_yticks(range(len(runs)), [run.condition.name.replace("`", "") for run in runs])
    panels[0].set_ylim(len(runs) - 0.5, -0.5)
    _label_threshold(panels[1], 0, HARM_RISE_WORN)
    if len(worn_runs) < len(runs):
        _label_threshold(panels[1], len(worn_runs), HARM_RISE_GOOD)
        panels[0].text(
            50, 0.5 * (len(worn_runs) + len(runs) - 1), "nothing to find", ha="center", va="center", color="0.3"
        )
        for panel in panels:
            panel.axhline(len(worn_runs) - 0.5, color="0.4", lw=0.8)
    figure.legend(*panels[1].get_legend_handles_labels(), loc="outside lower center", ncols=len(names))
    save_figure(figure, "learning/learners.png")


def _label_threshold(panel: Axes, row: int, least: float) -> None:
    """Label the threshold of harm that holds from this row on."""
    panel.text(103, row - 0.4, f"by more than {100 * least:.0f} %", ha="right", va="top", color="0.3", fontsize=8)


def _draw_shares(panel: Axes, runs: list[Run], names: list[str], share_of_run: Callable[[Run, str], Share]) -> None:
    """A mark with its interval for each condition and controller."""
    for position, name in enumerate(names):
        colour, marker = MARKS[name]
        shares = [share_of_run(run, name) for run in runs]
        heights = [row + 0.72 * ((position + 0.5) / len(names) - 0.5) for row in range(len(runs))]
        for y, interval in zip(heights, shares, strict=True):
            panel.plot([100 * interval.low, 100 * interval.high], [y, y], color=colour, lw=1.0, zorder=2)
        panel.plot(
            [100 * interval.value for interval in shares],
            heights,
            marker,
            color=colour,
            ms=4.5,
            zorder=3,
            label=CONTROLLER_LABELS[name],
        )
    for row in range(0, len(runs), 2):
        panel.axhspan(row - 0.5, row + 0.5, color=SHADE_GREY, alpha=0.5, zorder=0, lw=0)
    panel.grid(visible=False, axis="y")


def sample() -> None:
    """Run a sample of the study: two conditions, one of them without a gap."""
    runs = learners_runs.run(names=(SMALL_BACKLASH, f"{GOOD_LABEL}, {LOOPS_LABEL}: {KIND_LABELS[STEPPED]}"))
    compare_rows("learning/learners_failures", failure_rows(runs))
    compare_rows("learning/learners_worse", worse_rows(runs))
    compare_rows("learning/learners_good", good_rows(runs))


def main(size: int | None = None) -> None:
    """Run everything, write the tables and draw the figure; ``size``: only so many loops and valves."""
    runs = learners_runs.run(size)
    write_tables(runs)
    draw(runs)

"""The tables of ``learners.py``: failures, harm, and what the estimates cost."""

from __future__ import annotations

import numpy as np

from fastcoil.study.analysis.paired import share_of
from studies.common import write_table
from studies.days import STEPPED
from studies.learning.learners_conditions import LABELS as OF_KINDS
from studies.learning.learners_conditions import LOOPS, MORNING, VALVES
from studies.learning.learners_run import KNOWN, ONE, PI, ROUND_OFF, Run, change, controllers, fails, harmed
from studies.remedies.tables import cell, pooled

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
        cells = [cell(run.ds, name, PI), f"{settled:+.0f} %", f"× {1 + travel / 100:.2f}"]
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
    failed, days = (
        sum(int(n) for n in counts)
        for counts in (((run.ds.status > 0).sum() for run in runs), (run.ds.status.size for run in runs))
    )
    finding, all_names = ([LABELS[name] for name in of] for of in (estimators(), remedies()))
    write_table(
        "learning/learners_failures",
        f"Wrong estimates at the end: off by more than 20 % of the backlash and 1 % of the stroke; {sizes} "
        f"({failed} of {days:,} days failed)",
        ["condition", *finding],
        failure_rows(runs),
    )
    write_table(
        "learning/learners_twenty",
        "The same by 20 % of the backlash alone",
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

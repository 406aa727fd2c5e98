"""The tables of ``learners.py``: failures, harm, and what the estimates cost."""

from __future__ import annotations

import numpy as np
import xarray as xr
from kinds import STEPPED
from learners_conditions import LOOPS, VALVES
from learners_run import KNOWN, ONE, PI, ROUND_OFF, Run, change, controllers, fails, harmed
from report import write_table
from shares import share_of

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


def cost_rows(runs: list[Run], *, kind: str | None) -> list[list[str]]:
    """A row for each controller, over the valves with backlash on days of a kind, or of all kinds."""
    some = [run for run in runs if is_of_kinds(run) and kind in (None, run.condition.kind)]
    table = []
    for name in controllers():
        error, settled, travel = (
            np.concatenate([change(run, name, metric).values for run in some])
            for metric in ("rmse", "rmse_settled", "motor_travel")
        )
        cells = [f"{100 * float(error.mean()):+.0f} %", f"{100 * float(np.median(settled)):+.0f} %",
                 f"× {1 + float(np.median(travel)):.2f}"]  # fmt: skip
        table.append([LABELS[name], *cells, *(_found(some, name) if name in estimators() else ["—"] * 4)])
    return table


def is_of_kinds(run: Run) -> bool:
    """Whether a condition is that of the valves on one kind of day, nothing else changed."""
    plain = {"set-point steps", "constant set-point", "design days", "weather, 30 % outdoor air", "heating"}
    return run.condition.name.removeprefix(f"{VALVES}: ") in plain


def _found(runs: list[Run], name: str) -> list[str]:
    """Wrong estimates below and above the backlash, loop-days that are right at the end, and since when."""
    at = {"controller": name}
    low, high = (
        np.concatenate([(fails(run, name) & beyond(run.ds.estimate_final.sel(at), run.backlash)).values.ravel()
                        for run in runs])
        for beyond in (xr.DataArray.__lt__, xr.DataArray.__gt__)
    )  # fmt: skip
    since = np.concatenate([run.ds.time_identified.sel(at).values.ravel() for run in runs])
    middle = float(np.sort(np.nan_to_num(since, nan=np.inf))[(since.size - 1) // 2])
    share = 100 * np.isfinite(since).mean()
    hours = f"{middle / 3600:.1f} h" if np.isfinite(middle) else "—"
    return [f"{100 * low.mean():.0f} %", f"{100 * high.mean():.0f} %", f"{share:.0f} %", hours]


COST = [
    "estimator", "RMSE, mean change", "settled RMSE, median", "motor travel, median", "too low", "too high",
    "right at the end", "right since, median",
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
        "learners_failures",
        f"Wrong estimates at the end: off by more than 20 % of the backlash and 1 % of the stroke; {sizes} "
        f"({failed} of {days:,} days failed)",
        ["condition", *finding],
        failure_rows(runs),
    )
    write_table(
        "learners_twenty",
        "The same by 20 % of the backlash alone",
        ["condition", *finding],
        failure_rows(runs, one=0.0),
    )
    write_table(
        "learners_worse",
        f"Loops whose RMSE is more than 2 % above that of their plain PI; {sizes}",
        ["condition", *all_names],
        worse_rows(runs),
    )
    write_table(
        "learners_good",
        "Valves without backlash: loops whose RMSE rises by more than 1 %, median change, estimates above 1 % of the "
        "stroke",
        ["condition", *all_names],
        good_rows(runs),
    )
    for table, kind, where in (
        ("learners_cost", None, "all kinds of days"),
        ("learners_cost_stepped", STEPPED, "days with set-point steps"),
    ):
        write_table(table, f"Valves with backlash on {where}, against their plain PI", COST,
                    cost_rows(runs, kind=kind))  # fmt: skip

"""What the table ``[tune]`` of a study asks for."""

from __future__ import annotations

from pathlib import Path

from fastcoil.base.errors import InputError, shown
from fastcoil.design.tuning.plan import Asked, plan_tuning
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.study.file.boundary import build_boundary
from fastcoil.study.file.tables import RunTable, TuneTable


def asked_of_tuning(table: TuneTable, run: RunTable, loop: Loop, boundary: Boundary, folder: Path) -> Asked:
    """The tuning of the valves and days of a study; ``holdout`` is labels of days, or a table like ``[boundary]``."""
    if run.carry_over:
        raise InputError("every day is tried by itself: leave [run] carry_over out, or tune in a study of its own")
    holdout: object = table.holdout
    if isinstance(holdout, dict):
        try:
            holdout = build_boundary(holdout, folder)
        except InputError as error:
            raise InputError([f"holdout: {p.removeprefix('[boundary] ')}" for p in error.problems]) from None
    elif holdout is not None and not isinstance(holdout, list):
        raise InputError(
            f"holdout = {shown(holdout)}: give days as in [boundary], such as {{ seed = [2, 3] }}, or labels of some "
            "days of it, such as [4, 5]"
        )
    return plan_tuning(
        loop,
        boundary,
        search=table.search,
        objective=table.objective,
        quantile=table.quantile,
        limits=table.limits,
        holdout=holdout,
        evaluations=table.evaluations,
        warm_up=run.warm_up,
        seed=run.seed,
        replicates=run.replicates,
    )

"""The result of a fit of a loop: the backlash, how well it is known, residuals, in words and as a figure."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fastcoil.measured.fit.loop_problem import LARGEST, LoopProblem, LoopSolution
from fastcoil.measured.fit.result import Fit, labelled, poor, rms, sample_variables
from fastcoil.measured.fit.split import FITTING, UNUSED, VALIDATION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FEWEST_REVERSALS, FEWEST_BLOCKS = 2, 6
TOLERANCE, GOOD = 0.2, 0.01
"""A size is identified if its interval reaches no further than this share of it, or this share of the stroke."""
LEAST_EXPLAINED = 0.8
"""Share of the changes of T_sup below which the model is one of another coil."""


@dataclass(frozen=True, repr=False)
class LoopFit(Fit):
    """A fitted loop; see ``Fit`` for what it shares with the other fits."""

    @property
    def backlash(self) -> float:
        """The best size, fraction of stroke, identified or not."""
        return float(self.extras["backlash"])

    @property
    def interval(self) -> tuple[float, float]:
        """Of 95 %."""
        low, high = self.extras["interval"]
        return float(low), float(high)

    @property
    def identified(self) -> bool:
        """Whether the log tells the size, to 20 % of itself or 1 % of the stroke."""
        return not self.reason

    @property
    def reason(self) -> str:
        """Why not; empty if identified."""
        return self.held.get("backlash", "")

    def plot(self) -> Figure:
        """The profile over the backlash, and measured and modelled temperatures, as a matplotlib ``Figure``."""
        from fastcoil.measured.fit.loop_figure import loop_figure

        assert self.profile is not None
        return loop_figure(self.residuals, self.profile, identified=self.identified)


def loop_fit(problem: LoopProblem, solution: LoopSolution, started: float) -> LoopFit:
    """The fit with everything a user may ask of it; ``started``: time of the call, by ``time.perf_counter``."""
    residuals, rmse = _residuals(problem, solution)
    fitted = problem.compared & problem.fitting
    why = why_unidentified(problem, solution)
    problem.notes += poor(
        rmse, problem.T_sup[fitted], "T_sup", "units, columns, and whether the loop is that of the log"
    )
    known = {} if why else {"backlash": solution.backlash}
    n = float(fitted.sum())
    return LoopFit(
        kind="loop",
        source=problem.data.name,
        parameters=known,
        standard_errors={name: solution.error for name in known},
        intervals=dict.fromkeys(known, solution.interval),
        covariance=labelled(np.full((len(known), len(known)), solution.error**2), list(known)),
        profile=xr.Dataset(
            {"rmse": ("backlash", solution.rmse, {"units": "K"})},
            {"backlash": ("backlash", solution.grid, {"units": "1"})},
            {"interval_95": list(solution.interval)},
        ),
        residuals=residuals,
        rmse=rmse,
        unit="K",
        n_used=int(n),
        n_effective=float(solution.n_blocks),
        held={"backlash": why} if why else {},
        notes=problem.notes,
        seconds=time.perf_counter() - started,
        extras={
            "backlash": np.array(solution.backlash),
            "interval": np.array(solution.interval),
            "explained": np.array(solution.explained),
        },
    )


def why_unidentified(problem: LoopProblem, solution: LoopSolution) -> str:
    """Why the log does not tell the backlash; empty if it does."""
    low, high = solution.interval
    x = solution.backlash
    why = ""
    if problem.n_reversals < FEWEST_REVERSALS:
        why = (
            f"the command turns {problem.n_reversals} times by more than 1 % of stroke, and only reversals show "
            "backlash; give a log in which it goes up and down"
        )
    elif solution.n_blocks < FEWEST_BLOCKS:
        why = f"{solution.n_blocks} half hours are left to compare: give a log of five hours or more"
    elif problem.is_coarse:
        why = (
            f"samples are {problem.data.step:g} s apart and the command moves between them; turns are missed, so that "
            f"the {x:.3g} that fits best is too small: log every 60 s or faster"
        )
    elif not solution.explained > LEAST_EXPLAINED:
        why = (
            f"the model explains {100 * max(solution.explained, 0.0):.0f} % of the changes of T_sup: fit the coil "
            "first, or check units and columns"
        )
    elif high >= LARGEST:
        why = f"the gap is {low:.3g} or more, and {LARGEST:g} is the largest that is tried"
    elif max(high - x, x - low) > max(TOLERANCE * x, GOOD):
        why = (
            f"anything from {low:.3g} to {high:.3g} fits as well (95 %): give a longer log, or one in which the "
            "set-point goes up and down"
        )
    return f"not identified: {why}" if why else ""


def _residuals(problem: LoopProblem, solution: LoopSolution) -> tuple[xr.Dataset, dict[str, float]]:
    """Measured and modelled temperatures over the whole log, also without backlash; RMSE by part."""
    found, plain, measured = solution.modelled, solution.without_backlash, problem.T_sup
    part = np.where(problem.compared, np.where(problem.fitting, FITTING, VALIDATION), UNUSED)
    rmse = {}
    for name in (FITTING, VALIDATION):
        here = (part == name) & np.isfinite(found)
        if here.any():
            rmse[name] = rms((found - measured)[here])
            rmse[f"{name}_without_backlash"] = rms((plain - measured)[here])
    values = {
        "T_sup": measured, "modelled": found, "modelled_without_backlash": plain, "residual": measured - found,
        "command": problem.data.values["command"],
    }  # fmt: skip
    ds = xr.Dataset(
        {
            name: ("elapsed_time", v, {"units": {"command": "1", "residual": "K"}.get(name, "degC")})
            for name, v in values.items()
        }
        | sample_variables(problem.data, part),
        {"elapsed_time": ("elapsed_time", problem.data.time, {"units": "s"})},
    )
    return ds, rmse

"""``fit_loop``: the backlash of a valve from recorded commands and supply temperatures, with a model of its coil."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fastcoil.base.arguments import checking, instance_of, number_of
from fastcoil.base.errors import shown
from fastcoil.logs.columns import Wanted, checked_reading, log_of
from fastcoil.logs.series import HUMIDITIES
from fastcoil.loops.loop import Loop
from fastcoil.measured.coil_problem import in_operation
from fastcoil.measured.fit import Fit, poor, profile_of, rmse_of
from fastcoil.measured.loop_problem import LARGEST, LoopProblem, LoopSolution
from fastcoil.measured.part import FITTING, UNUSED, VALIDATION, checked_part
from fastcoil.model.metric_table import WARM_UP

FEWEST_REVERSALS, FEWEST_BLOCKS = 2, 6
TOLERANCE, GOOD = 0.2, 0.01
"""A size is identified if its interval reaches no further than this share of it, or this share of the stroke."""
LEAST_EXPLAINED = 0.8  # share of the changes of T_sup below which the model is one of another coil
_WANTED = Wanted(
    needed=("command", "m_a", "T_w_in", "T_a_in", HUMIDITIES, "T_sup"), optional=("enabled",), measured=("T_sup",)
)


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
        """Whether the log resolves the size, to 20 % of itself or 1 % of the stroke."""
        return not self.reason

    @property
    def reason(self) -> str:
        """Why not; empty if identified."""
        return self.held.get("backlash", "")


def fit_loop(
    log: Any,
    loop: Loop,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, float] | None = None,
    warm_up: float = WARM_UP,
    split: float | None = None,
    fit_until: float | None = None,
    validation: Any = None,
    drop: bool = False,
    jumps: str = "refuse",
    max_gap: float | None = None,
    time_format: str | None = None,
) -> LoopFit:
    """Fit the backlash of a valve to a log of commands and supply temperatures; no flow meter is needed.

    Parameters
    ----------
    log
        Path of a CSV file, or a Dataset.  Needed: ``command``, ``T_sup``, ``m_a``, ``T_w_in``, ``T_a_in``, one of
        ``W_a_in``, ``RH_a_in``, ``T_dp_in``, and ``elapsed_time`` or ``timestamp``; optional: ``enabled``.  The
        command holds until the next sample.
    loop
        Valve curve, coil, motor and sensor: fitted (``fc.Loop(**fit.parameters)``) or of a preset.  They need not be
        quite right: the modelled temperature is corrected by a straight line in each unbroken piece of the log.  Its
        ``backlash`` and its controller play no part.
    units, columns, constants
        As in ``fc.Boundary.from_csv``.
    warm_up
        Seconds left out at each start of the model [s].
    split, fit_until, validation
        As in ``fc.fit_valve``.
    drop, jumps, max_gap
        What to do with bad rows, with time that goes back and with gaps: see ``fastcoil.logs.Reading``.
    time_format
        How ``timestamp`` is written, as in ``fc.Boundary.from_csv``.

    Returns
    -------
    LoopFit
        ``backlash``, ``interval``, ``identified`` and, if not, the ``reason``; ``backlash`` is not among its
        ``parameters`` if the log does not identify it.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments, and for a loop that is unstable.

    Notes
    -----
    The emulator of Cai and Braun (2016) in open loop behind the logged command, once for each candidate backlash.
    """
    started = time.perf_counter()
    with checking() as check:
        log = check(log_of, "log", log)
        check(instance_of, "loop", loop, Loop, "give a fastcoil.Loop")
        warm_up = check(number_of, "warm_up", warm_up, "give a number of seconds, 0 or more", least=0.0)
        how = checked_reading(check, columns=columns, units=units, constants=constants, drop=drop, jumps=jumps,
                              max_gap=max_gap, time_format=time_format, has_command=True)  # fmt: skip
        part = checked_part(check, split, fit_until, validation)
        for name, values in loop.swept.items() if isinstance(loop, Loop) else ():
            if name != "backlash":
                check.problems.append(f"loop has {name} = {shown(values.values.tolist())}: give one value")
        if isinstance(loop, Loop) and (loop["slip_jump"] or 0.0) != 0.0:
            check.problems.append("loop has a slip_jump: give it none, a backlash without one is fitted")

    problem = LoopProblem(part.read(log, _WANTED, how, in_operation), loop, warm_up, part)
    if problem.is_coarse:
        warnings.warn(
            f"{problem.data.name}: samples are {problem.data.step:g} s apart and the command moves between them: the "
            "backlash comes out too small, log every 60 s or faster",
            stacklevel=2,
        )
    return _fit_of(problem, problem.solve(), started)


def _fit_of(problem: LoopProblem, solution: LoopSolution, started: float) -> LoopFit:
    """The fit with everything a user may ask of it."""
    data, measured, fitted = problem.data, problem.T_sup, problem.compared & problem.fitting
    found, plain = solution.modelled, solution.without_backlash
    part = np.where(problem.compared, np.where(problem.fitting, FITTING, VALIDATION), UNUSED)
    rmse = rmse_of(part, {"": found - measured, "_without_backlash": plain - measured})
    series = {
        "T_sup": (measured, "degC"),
        "modelled": (found, "degC"),
        "modelled_without_backlash": (plain, "degC"),
        "residual": (measured - found, "K"),
        "command": (data.values["command"], "1"),
    }
    why = _why_unidentified(problem, solution)
    notes = problem.notes + poor(
        rmse, measured[fitted], "T_sup", "units, columns, and whether the loop is that of the log"
    )
    known = {} if why else {"backlash": solution.backlash}
    return LoopFit.of(
        data, started, part, series, list(known), np.full((len(known), len(known)), solution.error**2),
        kind="loop", unit="K", parameters=known, intervals=dict.fromkeys(known, solution.interval),
        profile=profile_of(solution.grid, solution.rmse, "K", solution.interval),
        rmse=rmse, held={"backlash": why} if why else {}, notes=notes,
        n_used=int(fitted.sum()), n_effective=float(solution.n_blocks),
        extras={"backlash": np.array(solution.backlash), "interval": np.array(solution.interval)},
    )  # fmt: skip


def _why_unidentified(problem: LoopProblem, solution: LoopSolution) -> str:
    """Why the log does not resolve the backlash; empty if it does."""
    (low, high), x = solution.interval, solution.backlash
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

"""``fit_loop``: the backlash of a valve from recorded commands and supply temperatures, with a model of its coil."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from typing import Any

from fastcoil.base.arguments import checking, instance_of, number_of
from fastcoil.base.errors import shown
from fastcoil.logs import Log, read_log
from fastcoil.logs.arguments import Wanted, log_of
from fastcoil.logs.series import HUMIDITIES
from fastcoil.logs.timestamps import time_format_of
from fastcoil.loops.loop import Loop
from fastcoil.measured.fit.arguments import check_reading, split_of
from fastcoil.measured.fit.coil_record import in_operation
from fastcoil.measured.fit.loop_problem import LoopProblem
from fastcoil.measured.fit.loop_result import LoopFit, loop_fit
from fastcoil.measured.fit.split import validated_with
from fastcoil.model.metric_table import WARM_UP

_WANTED = Wanted(
    needed=("command", "m_a", "T_w_in", "T_a_in", HUMIDITIES, "T_sup"), optional=("enabled",), measured=("T_sup",)
)


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
        What to do with bad rows, with time that goes back and with gaps: see ``fastcoil.logs.read_log``.
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
        validation = check.unless_none(log_of, "validation", validation)
        warm_up = check(number_of, "warm_up", warm_up, "give a number of seconds, 0 or more", least=0.0)
        check_reading(check, units=units, columns=columns, constants=constants, drop=drop, jumps=jumps, max_gap=max_gap)
        time_format = check.unless_none(time_format_of, "time_format", time_format)
        split, fit_until = split_of(check, split, fit_until)
        for name, values in loop.swept.items() if isinstance(loop, Loop) else ():
            if name != "backlash":
                check.problems.append(f"loop has {name} = {shown(values.values.tolist())}: give one value")
        if isinstance(loop, Loop) and (loop["slip_jump"] or 0.0) != 0.0:
            check.problems.append("loop has a slip_jump: give it none, a backlash without one is fitted")

    def read(source: Any) -> Log:
        found = read_log(
            source,
            _WANTED,
            units=units,
            columns=columns,
            constants={} if constants is None else constants,
            drop=drop,
            jumps=jumps,
            max_gap=max_gap,
            time_format=time_format,
            has_command=True,
        )
        return in_operation(found)

    data = read(log)
    if validation is not None:
        data, fit_until = validated_with(data, read(validation), fit_until), None
    problem = LoopProblem(data, loop, warm_up, split, fit_until)
    if problem.is_coarse:
        warnings.warn(
            f"{data.name}: samples are {data.step:g} s apart and the command moves between them: the backlash comes "
            "out too small, log every 60 s or faster",
            stacklevel=2,
        )
    return loop_fit(problem, problem.solve(), started)

"""``fit_valve``: x_BL, m_max, a, b, c of Eqs (1) and (2) from recorded commands and flows (section 2.1.3)."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from fastcoil.base.arguments import checking, choice_of, number_of, plain
from fastcoil.base.errors import InputError
from fastcoil.logs import Log, read_log
from fastcoil.logs.arguments import Wanted, log_of
from fastcoil.logs.timestamps import time_format_of
from fastcoil.measured.fit.arguments import check_reading, split_of
from fastcoil.measured.fit.lag import with_lag, without_lag
from fastcoil.measured.fit.result import Fit
from fastcoil.measured.fit.split import validated_with
from fastcoil.measured.fit.valve_problem import FEWEST_SAMPLES, ValveProblem
from fastcoil.measured.fit.valve_result import valve_fit

_LEAST_REACH = 0.02
"""A command that stays below this share of the stroke has the wrong unit."""
_LEAST_SHARE = 0.8
"""Noise may lift readings above the asymptotic flow, but it is at least this share of them."""
_LARGEST_FLOW = 1e6
"""Of any valve, kg/s."""
_FEWEST_ROWS = 3
"""Rows of a piece of the log, on average: where in its gap a piece starts is one more unknown."""
_LONGEST_LAG = 86400.0
_MANY_PIECES = 50
"""A fit of more takes minutes."""
_WANTED = Wanted(needed=("command", "m_w"), optional=("enabled",), measured=("m_w",))


def fit_valve(
    log: Any,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    m_max: float | None = None,
    floor: float | None = None,
    settle: float | None = None,
    initial: str = "unknown",
    split: float | None = None,
    fit_until: float | None = None,
    validation: Any = None,
    lag: float | str = "auto",
    holds: str | None = None,
    drop: bool = False,
    jumps: str = "refuse",
    max_gap: float | None = None,
    time_format: str | None = None,
) -> Fit:
    """Fit the backlash and the flow curve of a valve to a log of commands and flows.

    Parameters
    ----------
    log
        Path of a CSV file, or a Dataset.  Needed: ``command`` (1, percent, deg of 90, V of 10), ``m_w`` (kg/s, L/s,
        m3/h, gpm, …), and ``elapsed_time`` or ``timestamp``; optional: ``enabled``, 0 where the pump is off, and
        ``batch``, the number of the experiment if the log holds several.
    units, columns
        As in ``fc.Boundary.from_csv``.
    m_max
        Asymptotic flow of Eq (2) [kg/s], if it is known; estimated if left out.
    floor
        Lowest reading of the flow meter [kg/s], 0 for none; found from the data if left out.
    settle
        Seconds after a change of the command in which the flow is not compared; half of a typical hold if left out
        and the command is held, else 0.
    initial
        Where in the gap each batch starts: ``unknown`` (estimated), ``rising`` or ``falling``.
    split, fit_until
        Share of the log that is fitted (of its batches, if it has at least four), 0.7 if left out; or the last second
        that is fitted.  The rest is held back for validation.
    validation
        Another log, of the same columns, to validate with; then all of the first is fitted, or all up to
        ``fit_until``.  It has no influence on the fit.
    lag
        Seconds by which the flow is logged after the command, negative if before; ``auto``: sought in each piece of the
        log, told, and taken out.
    holds
        ``command`` if the command holds from row to row, as in a test of the valve; else a controller may move it
        between the rows, and the interval of the backlash allows for that.
    drop, jumps, max_gap
        What to do with bad rows, with time that goes back and with gaps: see ``fastcoil.logs.read_log``.
    time_format
        How ``timestamp`` is written, as in ``fc.Boundary.from_csv``.

    Returns
    -------
    Fit
        ``backlash`` is not among its parameters if the data do not identify it; ``held`` then says why.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments.

    Notes
    -----
    Cai and Braun (2016), section 2.1.3.  Only b/(1 - x_BL) and (1 - x_BL) c enter Eq (2): α = 1/(1 - x_BL) assumes
    that a full command opens the valve fully.
    """
    started = time.perf_counter()
    flow = {"least": math.nextafter(0.0, 1.0), "most": _LARGEST_FLOW}
    with checking() as check:
        log = check(log_of, "log", log)
        validation = check.unless_none(log_of, "validation", validation)
        m_max = check.unless_none(number_of, "m_max", m_max, "give a number above 0 and at most 1e6 kg/s", **flow)
        floor = check.unless_none(number_of, "floor", floor, "give a number, 0 or more", least=0.0)
        settle = check.unless_none(number_of, "settle", settle, "give a number, 0 or more", least=0.0)
        initial = check(choice_of, "initial", initial, ("unknown", "rising", "falling"))
        lag = check(_lag_of, lag)
        holds = check.unless_none(choice_of, "holds", holds, ("command",))
        check_reading(check, units=units, columns=columns, drop=drop, jumps=jumps, max_gap=max_gap)
        time_format = check.unless_none(time_format_of, "time_format", time_format)
        split, fit_until = split_of(check, split, fit_until)

    def read(source: Any) -> Log:
        return read_log(
            source,
            _WANTED,
            units=units,
            columns=columns,
            drop=drop,
            jumps=jumps,
            max_gap=max_gap,
            time_format=time_format,
            has_command=True,
        )

    data = read(log)
    _check_order(data)
    _check(data, floor, m_max)
    if validation is not None:
        to_validate = read(validation)
        _check_order(to_validate)
        data, fit_until = validated_with(data, to_validate, fit_until), None
    if isinstance(lag, float):
        data = with_lag(data, lag)
    problem = ValveProblem(data, floor, settle, split, fit_until)
    if lag == "auto":
        moved = without_lag(data, problem.good, problem.fitting)
        problem = problem if moved is data else ValveProblem(moved, floor, settle, split, fit_until)
    return valve_fit(problem, problem.solve(m_max, initial), holds is not None, started)


def _lag_of(lag: Any) -> float | str:
    """A shift in seconds, or ``auto``."""
    if isinstance(lag := plain(lag), str) and lag == "auto":
        return lag
    cure = "give seconds by which the flow is logged after the command, or 'auto'"
    return float(number_of("lag", lag, cure, least=-_LONGEST_LAG, most=_LONGEST_LAG))


def _check_order(data: Log) -> None:
    """Refuse a log that is no record in time, before any work; warn of one whose fit takes long."""
    n_back, n_rows, n_pieces = int((np.diff(data.time) <= 0.0).sum()), data.time.size, data.n_batches
    if 2 * n_back > n_rows:
        raise InputError(
            f"{data.name}: time goes back after {n_back:,} of {n_rows:,} rows: the log looks reversed, newest row "
            "first; sort its rows, oldest first"
        )
    if n_rows < _FEWEST_ROWS * n_pieces:
        raise InputError(
            f"{data.name}: its {n_rows:,} rows are in {n_pieces:,} pieces, each with a start of its own to be found: "
            f"give at least {_FEWEST_ROWS} rows for each piece; where gaps cut the log, pass max_gap to bridge them, "
            "where time goes back, sort the rows, oldest first"
        )
    if n_pieces > _MANY_PIECES:
        warnings.warn(
            f"{data.name} is in {n_pieces:,} pieces, each with a start of its own to be found: this takes minutes; "
            "where gaps cut the log, max_gap bridges them",
            stacklevel=3,
        )


def _check(data: Log, floor: float | None, m_max: float | None) -> None:
    command, flow = data.values["command"], data.values["m_w"]
    problems = []
    if np.isfinite(flow).sum() < FEWEST_SAMPLES:
        problems.append(f"{data.name}: {np.isfinite(flow).sum()} flows: give at least {FEWEST_SAMPLES}")
    for name, values in (("command", command), ("m_w", flow[np.isfinite(flow)])):
        if values.size and np.ptp(values) == 0.0:
            problems.append(
                f"{data.name}: {name} is {values[0]:g} from row {data.rows[0]} to row {data.rows[-1]}: "
                "give a log in which the valve moves"
            )
    top, reach = float(np.nanmax(flow)), float(command.max())
    if reach < _LEAST_REACH:
        problems.append(f"{data.name}: command is never above {reach:.3g} of the stroke: check its unit")
    if floor is not None and floor >= top:
        problems.append(f"floor = {floor:g} kg/s: {data.name} has no larger flow than {top:.3g} kg/s, lower it")
    if m_max is not None and m_max < _LEAST_SHARE * top:
        problems.append(f"m_max = {m_max:g} kg/s: {data.name} has flows up to {top:.3g} kg/s, give at least that")
    if problems:
        raise InputError(problems)

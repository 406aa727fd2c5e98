"""``fit_valve``: x_BL, m_max, a, b, c of Eqs (1) and (2) from recorded commands and flows (section 2.1.3)."""

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from fastcoil.base.arguments import checking, choice_of, number_of, plain
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.logs import Log
from fastcoil.logs.columns import Wanted, checked_reading, log_of
from fastcoil.measured.fit import AT_BOUND, NOT_UNIQUE, Fit, finished, natural_interval, profile_of
from fastcoil.measured.lag import with_lag, without_lag
from fastcoil.measured.part import ABOVE_0, checked_part
from fastcoil.measured.valve_problem import LOGS, X_BL, ValveProblem, ValveSolution, judged
from fastcoil.model.engine.recorded import VALVE_ROWS

_WANTED = Wanted(needed=("command", "m_w"), optional=("enabled",), measured=("m_w",))
_LEAST_REACH = 0.02  # a command that stays below this share of the stroke has the wrong unit
_LEAST_SHARE = 0.8  # noise may lift readings above the asymptotic flow, but it is at least this share of them
_FEWEST_ROWS = 3  # rows of a piece, on average: where in its gap a piece starts is one more unknown
_LONGEST_LAG = 86400.0

# what is suspicious about a command
_INVERTED = -0.5  # its correlation with the flow is below this
_LIVE_ZERO = (0.185, 0.215)  # where the least command of a 2-10 V signal lies if it is read as 0-10 V
_FAR = 0.5  # a signal that is never above this says nothing of its range
_LOWEST, _CLOSED = 0.02, 0.1
"""At commands this close to the least, a closed valve passes no more than this share of the largest flow."""
_FEWEST = 3


@np.errstate(all="ignore")
def fit_valve(
    log: Any,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    m_max: float | None = None,
    split: float | None = None,
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
        CSV file, DataFrame or Dataset.  Needed: ``command`` (1, percent, deg of 90, V of 10), ``m_w`` (kg/s, L/s,
        m3/h, gpm, …), and ``elapsed_time`` or ``timestamp``; optional: ``enabled``, 0 where the pump is off, and
        ``batch``, the number of the experiment if the log holds several.
    m_max
        Asymptotic flow of Eq (2) [kg/s], if it is known; estimated if left out.
    split
        Share of the log that is fitted (of its batches, if it has at least four), 0.7 if left out.  The rest is held
        back for validation.
    validation
        Another log, of the same columns, to validate with; then all of the first is fitted.  What is held back has no
        influence on the fit.
    lag
        Seconds by which the flow is logged after the command, negative if before; ``auto``: estimated for each piece
        of the part that is fitted, reported, removed; what is held back is moved like the last of them.
    holds
        ``command`` if the command holds from row to row, as in a test of the valve; else a controller may move it
        between the rows, and the interval of the backlash allows for that.
    units, columns, drop, jumps, max_gap, time_format
        How the log is read: see ``fastcoil.logs.Reading``.

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
    Cai and Braun (2016), section 2.1.3.  Where in the gap each batch starts, and the floor of the meter, are
    estimated.  If the command is held, flows of the first half of a typical hold are not compared.  Only b/(1 - x_BL)
    and (1 - x_BL) c enter Eq (2): α = 1/(1 - x_BL) assumes that a full command opens the valve fully.
    """
    started = time.perf_counter()
    with checking() as check:
        log = check(log_of, "log", log)
        m_max = check.unless_none(number_of, "m_max", m_max, "give a flow above 0 kg/s", least=ABOVE_0)
        lag = check(_lag_of, lag)
        holds = check.unless_none(choice_of, "holds", holds, ("command",))
        how = checked_reading(check, columns=columns, units=units, drop=drop, jumps=jumps,
                              max_gap=max_gap, time_format=time_format, has_command=True)  # fmt: skip
        part = checked_part(check, split, validation)

    data = part.read(log, _WANTED, how, _in_order)
    _check(data, m_max)
    if isinstance(lag, float):
        data = with_lag(data, lag, part.fitted(data))
    problem = ValveProblem(data, part)
    if lag == "auto":
        moved = without_lag(data, problem.good, problem.fitting)
        problem = problem if moved is data else ValveProblem(moved, part)
    return _fit_of(problem, problem.solve(m_max), holds is not None, started)


def _lag_of(lag: Any) -> float | str:
    """A shift in seconds, or ``auto``."""
    if isinstance(lag := plain(lag), str) and lag == "auto":
        return lag
    cure = "give seconds by which the flow is logged after the command, or 'auto'"
    return float(number_of("lag", lag, cure, least=-_LONGEST_LAG, most=_LONGEST_LAG))


def _in_order(data: Log) -> Log:
    """Refuse a log that is no record in time, before any work."""
    n_rows, n_pieces = data.time.size, data.n_batches
    if n_rows < _FEWEST_ROWS * n_pieces:
        raise InputError(
            f"{data.name}: its {n_rows:,} rows are in {n_pieces:,} pieces, each with a start of its own to be found: "
            f"give at least {_FEWEST_ROWS} rows for each piece; where gaps cut the log, pass max_gap to bridge them, "
            "where time goes back, sort the rows, oldest first"
        )
    return data


def _check(data: Log, m_max: float | None) -> None:
    """Refuse arguments that do not fit the log, and a log in which the valve stands still."""
    first = data.source == 0
    command, flow = data.values["command"][first], data.values["m_w"][first]
    known = flow[np.isfinite(flow)]
    top, reach = float(known.max()), float(command.max())
    rows = f"from row {data.rows[first][0]} to row {data.rows[first][-1]}"
    problems = [
        f"{data.name}: {name} is {values[0]:g} {rows}: give a log in which the valve moves"
        for name, values in (("command", command), ("m_w", known))
        if np.ptp(values) == 0.0
    ]
    if reach < _LEAST_REACH:
        problems.append(f"{data.name}: command is never above {reach:.3g} of the stroke: check its unit")
    if m_max is not None and m_max < _LEAST_SHARE * top:
        problems.append(f"m_max = {m_max:g} kg/s: {data.name} has flows up to {top:.3g} kg/s, give at least that")
    if problems:
        raise InputError(problems)


def has_live_zero(command: Array, flow: Array) -> bool:
    """Whether the samples look like a signal of 2-10 V that was read as 0-10 V: closed at 20 %, never below."""
    least = float(command.min())
    lowest = flow[command <= least + _LOWEST]
    closed = lowest.size >= _FEWEST and float(np.median(lowest)) <= _CLOSED * float(flow.max())
    return bool(_LIVE_ZERO[0] <= least <= _LIVE_ZERO[1] and command.max() > _FAR and closed)


def _fit_of(problem: ValveProblem, solution: ValveSolution, holds: bool, started: float) -> Fit:
    """The fit with everything a user may ask of it; ``holds``: the command holds between the rows."""
    best, spread, profiled, notes = solution.estimate, solution.uncertainty, solution.profile, problem.notes
    fitted = problem.good & problem.fitting
    command, flow = problem.command[fitted], problem.flow[fitted]
    natural = np.where(LOGS, np.exp(best.x[:5]), best.x[:5])
    inverted = bool(np.corrcoef(command, flow)[0, 1] < _INVERTED)
    found = judged(problem, solution, holds or inverted or problem.data.change_of_value)
    of_signal = []
    if inverted:
        of_signal = ["the flow falls as the command rises: if a full command closes the valve, log 1 - command"]
        found = found._replace(why=f"not identified: {of_signal[0]}")
    elif has_live_zero(command, flow):
        of_signal = [
            f"the valve is closed at a command of {command.min():.2g} and the command never falls below: it looks like "
            "a signal of 2-10 V that was read as 0-10 V, which makes the backlash a fifth too small; declare its unit, "
            "units={'command': 'V 2-10'}, --unit command='V 2-10', or log (command - 0.2) / 0.8"
        ]

    variances = np.diag(spread.covariance)[:5]
    held = {"backlash": found.why} if found.why else {}
    if solution.is_m_max_given:
        held["m_max"] = "given"
    for name, variance in list(zip(VALVE_ROWS, variances, strict=True))[1:]:
        if not math.isfinite(variance):
            held.setdefault(name, AT_BOUND if math.isnan(variance) else NOT_UNIQUE)
    estimated = [k for k, name in enumerate(VALVE_ROWS) if name not in held]
    names = [VALVE_ROWS[k] for k in estimated]
    half = spread.quantile() * np.sqrt(variances)
    intervals = {VALVE_ROWS[k]: natural_interval(best.x[k], half[k], bool(LOGS[k])) for k in estimated}
    if not found.why:
        intervals["backlash"] = found.interval
    # the deviation of the backlash belongs to its interval
    width = 0.5 * (found.interval[1] - found.interval[0]) / max(half[X_BL], 1e-12)
    scale = np.where(LOGS, natural, 1.0)
    scale[X_BL] = max(1.0, width)
    covariance = spread.covariance[:5, :5] * np.outer(scale, scale)

    parameters = dict(zip(VALVE_ROWS, natural.tolist(), strict=True))
    if found.why:
        x = parameters.pop("backlash")
        notes.append(
            f"the curve belongs to a backlash of {round(x, 4):g}, which is not identified: sweep it in a study"
        )
    reach = float(problem.command[: problem.n_fit].max())
    if reach < 0.9:
        notes.append(f"commands reach {reach:.2g}: beyond it the curve is an extrapolation")
    if problem.n_reversals > 1:
        parts = ", ".join(f"{100 * x:.3g}" for x in profiled.parts)
        notes.append(f"parts of the log, one after the other, give a backlash of {parts} %")
    notes += [*of_signal, *filter(None, [found.note])]
    both = np.stack([best.x, solution.without_backlash.x], axis=1)
    start = np.full((int(problem.batch[-1]) + 1, 2), 0.5)  # unknown for a batch held back
    start[: both.shape[0] - 5] = both[5:]
    openings, modelled = problem.flows(both[:5], start, problem.command)
    with_it, without = modelled.T
    measured = np.where(problem.good, problem.flow, np.nan)
    errors = {"": with_it - measured, "_without_backlash": without - measured}
    n_compared = solution.model.used.sum()
    limit = math.sqrt(profiled.limit / n_compared)
    series = {
        "m_w": (problem.flow, "kg s-1"),
        "modelled": (with_it, "kg s-1"),
        "modelled_without_backlash": (without, "kg s-1"),
        "residual": (problem.flow - with_it, "kg s-1"),
        "command": (problem.command, "1"),
        "opening": (openings[:, 0], "1"),
    }
    return finished(
        problem.data, started, problem.good, problem.fitting, errors, series, names,
        covariance[np.ix_(estimated, estimated)],
        kind="valve", parameters=parameters, intervals=intervals, held=held, notes=notes,
        profile=profile_of(
            profiled.grid, np.sqrt(profiled.sums / n_compared), "kg s-1", float(natural[X_BL]), found.interval,
            limit=limit,
        ),
        n_used=spread.n_used, n_effective=spread.n_effective,
    )  # fmt: skip

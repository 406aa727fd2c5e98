"""``inspect``: an air handler from its log, with all its valves at once."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np

from fastcoil.base.arguments import argument_checks, require_path
from fastcoil.base.errors import InputError
from fastcoil.base.files import read_text
from fastcoil.logs.air_handler import read_air_handler, require_answers
from fastcoil.logs.log import Log, as_log
from fastcoil.measured.air_handler.faults import find_faults
from fastcoil.measured.air_handler.hunting import find_hunting
from fastcoil.measured.air_handler.series import AirHandlerSeries
from fastcoil.measured.air_handler.unit import AirHandler
from fastcoil.measured.grid import common_start, join_grids, resample_log
from fastcoil.measured.part import LogSource

_MAX_ANSWERS_BYTES = 2**20


@np.errstate(all="ignore")
def inspect(
    log: LogSource | Sequence[LogSource], *, answers: str | PathLike[str] | Mapping[str, Any] | None = None
) -> AirHandler:
    """Inspect an air handler: which valve leaks, sticks or hunts, when, how much, and what to do.

    Cooling, heating and preheat valves are judged together, so that no valve is blamed for another one, and no coil
    for what it cannot do: heating does not cool.

    Parameters
    ----------
    log : path, DataFrame, Dataset or Log, or a list of them
        A list holds days of one unit.  A row a minute or so, with any of ``cooling_command``, ``heating_command`` and
        ``preheat_command``; ``T_sup``; ``T_set``, or ``T_set_cooling`` and ``T_set_heating``; ``T_mixed`` (or
        ``T_a_in``, or ``T_return`` and ``T_out``), without which nothing is said about leaks; ``m_a`` or ``fan_speed``;
        ``enabled`` and ``occupied``.  Columns are found by the usual names of these points; units that headers lack are
        proposed from the numbers, which ``notes`` says.  Values that cannot be read are left out and counted.
    answers : path or mapping, optional
        What `AirHandler.to_toml` wrote for another unit: its headers, where the log has them, and its units.

    Returns
    -------
    AirHandler
        ``findings``, the worst first, and ``valves``, the diagnosis of each.

    Raises
    ------
    InputError
        With every question at once: one sentence for each column or unit that is not clear.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> minutes = np.arange(600)
    >>> log = pd.DataFrame({"timestamp": pd.Timestamp("2026-01-05") + pd.to_timedelta(minutes, "min")})
    >>> log["Cooling Valve [%]"], log["Heating Valve [%]"] = 0.0, 20.0 + 2.0 * np.sin(minutes / 40.0)
    >>> log["MAT [°C]"], log["SAT [°C]"] = 20.0, 15.0 + 0.1 * np.sin(minutes / 30.0)
    >>> [finding] = fc.inspect(log).findings
    >>> finding.component, finding.kind, round(finding.size)
    ('cooling valve', 'leak', 5)
    """
    with argument_checks() as check:
        sources = [check(as_log, "log", source) for source in (log if isinstance(log, (list, tuple)) else [log])]
        known = check.unless_none(_read_answers, "answers", answers)
    if not sources:
        raise InputError("log = []: give a log, or a list of logs of one air handler", "log", "missing")
    if known is not None:
        sources = [_with_answers(source, known) for source in sources]
    read_logs = [read_air_handler(source) for source in sources]
    (data, points), resampled = read_logs[0], [resample_log(data) for data, _ in read_logs]
    starts = [data.start for data, _ in read_logs]
    if len({start is None for start in starts}) > 1:
        raise InputError("log: some have a timestamp and some elapsed_time: give one of them", "log", "time")
    grid = join_grids([grid for grid, _ in resampled], starts)
    name = data.name if len(sources) == 1 else f"{data.name} and {len(sources) - 1} more"
    series = AirHandlerSeries(name, grid, common_start(starts))
    faults = find_faults(series)
    findings = sorted(faults + find_hunting(series, faults), key=lambda finding: finding.severity)
    log_notes = [note for data, _ in read_logs for note in data.notes]
    notes = list(dict.fromkeys([*points.notes, *log_notes, *(note for _, its in resampled for note in its)]))
    if not series.is_entering_measured and np.isnan(series.T_entering[0]).all():
        notes.append("without T_mixed, or T_return and T_out, nothing is said about valves that leak: log one of them")
    elif not series.is_entering_measured:
        notes.append("T_mixed is not logged: the entering air is taken to be between T_return and T_out")
    return AirHandler(name, findings, points, notes, series, sources)


def _read_answers(name: str, answers: Any) -> dict[str, dict[str, str]]:
    if isinstance(answers, Mapping):
        return require_answers(name, answers)
    path = require_path(name, answers, "give the TOML file that `fastcoil diagnose -o` wrote for another unit")
    try:
        return require_answers(f"{name} {path}", tomllib.loads(read_text(path, "a TOML file", _MAX_ANSWERS_BYTES)))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{name} {path}: not TOML: {error}", name, "format") from None


def _with_answers(log: Log, answers: Mapping[str, Mapping[str, str]]) -> Log:
    """Return a log that is read with the headers of ``answers`` that it has, and their units."""
    headers = {*log.table().header}
    columns = {name: header for name, header in answers["columns"].items() if header in headers}
    given = log.options
    return log.with_options(
        columns={**columns, **(given.columns or {})} or None, units={**answers["units"], **given.units}
    )

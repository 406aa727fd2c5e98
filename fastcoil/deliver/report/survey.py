"""``survey``: the valves of a building, diagnosed from their logs and ranked, as a Dataset, a page and a table."""

import concurrent.futures as cf
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import xarray as xr

from fastcoil.base import files
from fastcoil.base.arguments import argument_checks, collect_problems, require_flag, require_path
from fastcoil.base.errors import FastcoilError, InputError, StorageError
from fastcoil.base.progress import Advance, display_for_call
from fastcoil.base.text import MISSING_VALUE, escape_formulas, format_count
from fastcoil.deliver.report.page import Page, Section, Table, format_significant, require_page
from fastcoil.logs.air_handler import count_valves
from fastcoil.logs.log import Log, check_read_options, read_log
from fastcoil.loops.provenance import content_sha256
from fastcoil.loops.simulate import number_of_threads
from fastcoil.measured.cause import CAUSE_UNKNOWN
from fastcoil.measured.diagnose import diagnose
from fastcoil.measured.diagnosis import INDICES, Diagnosis
from fastcoil.measured.identify import GOOD_BACKLASH

from fastcoil.deliver.report.units import (  # isort: skip
    UNITS_MARK, find_in_unit, findings_dataset, require_no_valve_options, rows_to_dataset, units_page, unread_section,
)  # fmt: skip

_NUMBER_COLUMNS = {
    "degree_hours": ("K h d-1", "control error that the valve could act on, integrated over a day of operation"),
    "motor_travel": INDICES["motor_travel"],
    "backlash": ("1", "most probable backlash, fraction of stroke; valid only if identified"),
    "low": ("1", "lower end of its 95 % interval"),
    "high": ("1", "upper end of its 95 % interval"),
    "hours": ("h", "hours of operation in the log"),
} | INDICES
_TEXT_COLUMNS = ("cause", "because", "warnings", "advice", "reason", "notes", "problem", "log")
_EMPTY_ROW: dict[str, Any] = {**dict.fromkeys(_NUMBER_COLUMNS, np.nan), "identified": False, "hunts": False,
                            **dict.fromkeys(_TEXT_COLUMNS, "")}  # fmt: skip
_TABLE_MARK = b"valve,degree_hours [K h d-1],"  # begins the header of a table
_MAX_LOOKED_AT = 5  # logs, by whose headers those of air handlers are recognised


def survey(
    logs: Any, out: str | os.PathLike[str] | None = None, *, n_jobs: int | None = None,
    read: Mapping[str, Any] | None = None, progress: bool | None = None, **options: Any,
) -> xr.Dataset:  # fmt: skip
    """Diagnose the valves of a building and rank them by the control error that they leave.

    Logs of air handlers, with more than one valve, are inspected instead, and ranked unit by unit.

    Parameters
    ----------
    logs
        A log for each valve, or each air handler: CSV files and folders of them, or a mapping of names to what
        `diagnose` accepts.  Tables of earlier surveys are skipped.
    out
        FILE.html, a page; FILE.csv, a table; or a folder for both, ``survey.html`` and ``survey.csv``.
    n_jobs
        Processes; all cores by default.
    read
        Options of `read_log` for all logs, such as ``{"drop": True}``; a `Log` has its own.
    progress
        Whether to show the number of finished logs on stderr: True always, False never; None on a terminal, after 2 s.
    options
        Of `diagnose`, for all logs: ``stroke_time``, ``sample_time``, ``lag``, …; of `inspect`: ``answers``.

    Returns
    -------
    xarray.Dataset
        Along ``valve`` (name of the file, with its folder where several are alike), the costliest first.
        ``degree_hours``: size of the control error integrated over a day of operation, K h d-1, 0 where the valve is
        shut as it should be, NaN without a set-point or an hour of operation; ``backlash``, ``low``, ``high``
        (fractions), ``identified``, ``hunts``, ``cause``, ``because``, ``warnings``, ``advice``, ``reason``, ``notes``
        and the indices of `diagnose`; ``hours`` of operation; ``log``.  ``problem`` says why a log cannot be
        diagnosed; its numbers are NaN, and it is last.  Of air handlers along ``finding``: ``air_handler``,
        ``component``, ``kind``, ``size``, ``unit``, ``hours``, ``days``, ``first``, ``last``, ``cause``, ``text``,
        ``action``.

    Raises
    ------
    InputError
        With one sentence for each mistake in the arguments; if there is no log.
    StorageError
        If a folder cannot be read or ``out`` cannot be written; no partial file remains.

    Examples
    --------
    >>> loops = {"good": fc.Loop.preset("lbnl"), "worn": fc.Loop.preset("lbnl").assign(backlash=0.1, kp=0.04, ti=18)}
    >>> traces = ["command", "T_sup"]
    >>> logs = {name: fc.simulate(loop, fc.paper_day(hours=2), traces=traces) for name, loop in loops.items()}
    >>> fc.survey(logs, n_jobs=1).valve.values.tolist()
    ['worn', 'good']
    """
    answers = options.pop("answers", None)
    with argument_checks() as check:
        with collect_problems(check.problems):
            diagnose([], **options)  # checks its arguments before its logs
        check.problems[:] = [problem for problem in check.problems if not problem.startswith("log = []")]
        n_jobs = check(number_of_threads, n_jobs)
        check.unless_none(lambda _, value: check_read_options(value), "read", read)
        progress = check.unless_none(require_flag, "progress", progress)
        targets = check.unless_none(_target_files, "out", out) or []
        logs_by_valve = check(_logs_by_valve, logs)
    are_units = any(_has_more_valves(log, read or {}) for log in list(logs_by_valve.values())[:_MAX_LOOKED_AT])
    if are_units:
        require_no_valve_options(options)
    elif answers is not None:
        raise InputError("answers: they are for logs of air handlers: leave them out", "answers", "conflict")
    judge = partial(find_in_unit, answers=answers) if are_units else partial(_diagnose_valve, **options)
    with display_for_call(progress) as display:
        advance = display.start(len(logs_by_valve), items="logs")
        results = dict(_judge_logs(judge, logs_by_valve, read or {}, n_jobs, advance))
    ds = findings_dataset(results) if are_units else _valves_dataset(results, logs_by_valve)
    for target in targets:
        with files.convert_os_errors(target.parent, "written"):
            files.make_folder(target.parent, parents=True)
        is_table, make_page = target.suffix.lower() == ".csv", units_page if are_units else _valves_page
        files.write_atomically(target, (_csv_text(ds) if is_table else make_page(ds).html()).encode())
    return ds


def _has_more_valves(log: Any, read: Mapping[str, Any]) -> bool:
    """Whether a log is one of an air handler; False where it cannot be read."""
    try:
        return count_valves(log if isinstance(log, Log) else read_log(log, **read)) > 1
    except FastcoilError:
        return False


def _target_files(name: str, out: Any) -> list[Path]:
    """Return the files that a survey writes; refuse, before any work, an existing one that is no earlier survey."""
    path = require_path(name, out, "give FILE.html, FILE.csv or a folder")
    if files.is_folder(path) or not (path.suffix or files.exists(path)):
        targets = [path / "survey.html", path / "survey.csv"]
    else:
        files.require_output_file(name, path, ".html", ".htm", ".csv")
        targets = [path]
    for target in filter(files.exists, targets):
        if target.suffix.lower() != ".csv":
            require_page(target, name)
        elif not (files.has_mark(target, _TABLE_MARK) or files.has_mark(target, UNITS_MARK)):
            raise InputError(f"{name} {target}: the file exists and is not a survey: choose another name", name, "path")
    return targets


def _logs_by_valve(logs: Any) -> dict[str, Any]:
    """Return the logs by name of the valve: the stem of the file, with folder or path where several are alike."""
    if isinstance(logs, Mapping) and logs and not hasattr(logs, "data_vars"):
        return {str(valve): log for valve, log in logs.items()}
    sources = list(logs) if isinstance(logs, list | tuple | Iterator) else [logs]
    cure = "give CSV files, a folder of them, or a mapping of names to logs"
    log_files: dict[Path, None] = {}
    for path in (require_path("logs", source, cure) for source in sources):
        files_inside = files.list_folder(path) if files.is_folder(path) else [path]
        log_files |= dict.fromkeys(file for file in files_inside if file == path or file.suffix.lower() == ".csv")
    paths = [file for file in log_files if not any(files.has_mark(file, mark) for mark in (_TABLE_MARK, UNITS_MARK))]
    if not paths:
        raise InputError(f"logs: no CSV file: {cure}", "logs", "missing")
    names = [path.stem for path in paths]
    for longer_name in (lambda path: f"{path.absolute().parent.name}/{path.stem}", str):
        name_counts = Counter(names)
        names = [name if name_counts[name] == 1 else longer_name(path) for name, path in zip(names, paths, strict=True)]
    return dict(zip(names, paths, strict=True))


def _judge_logs(
    judge: Callable[[Any], Any], logs: Mapping[str, Any], read: Mapping[str, Any], n_jobs: int, advance: Advance
) -> Iterator[tuple[str, Any]]:
    """Judge logs and yield each name with the result; in processes, since threads share the interpreter's lock."""
    tasks = (joblib.delayed(_judge_log)(judge, log, read) for log in logs.values())
    n_processes = max(1, min(n_jobs, len(logs) // 3))  # fewer logs do not pay for the start of a process
    try:
        for name, result in zip(logs, joblib.Parallel(n_processes, return_as="generator")(tasks), strict=True):
            yield name, result
            advance(1)
    except cf.BrokenExecutor:
        raise StorageError("a process was killed, probably for want of memory: use fewer (n_jobs, --jobs)") from None


def _judge_log(judge: Callable[[Any], Any], log: Any, read: Mapping[str, Any]) -> Any:
    """Return what is found in a log, or why it cannot be read, a text."""
    try:
        return judge(log if isinstance(log, Log) or not read else read_log(log, **read))
    except Exception as error:  # one log must not end the survey of all others
        bug_text = "" if isinstance(error, FastcoilError) else f"please report this error: {type(error).__name__}: "
        return bug_text + "; ".join(str(error).split("\n"))


def _diagnose_valve(log: Any, **options: Any) -> dict[str, Any]:
    """Return the diagnosis of a log as numbers and texts by name."""
    d = diagnose(log, **options)
    row = {name: getattr(d, name) for name in ("backlash", "identified", "hunts", "cause", "because", "reason")}
    row |= {name: "; ".join(getattr(d, name)) for name in ("warnings", "notes")}
    row |= {"degree_hours": degree_hours(d), "hours": d.signals.attrs["hours"], "advice": d.advice.reason}
    indices = {str(name): float(value) for name, value in d.indices.items()}
    if row["hours"] < 1.0:  # less than an hour of operation says nothing of a day
        row |= dict.fromkeys(("degree_hours", "motor_travel", "reversals"), np.nan)
    return indices | row | dict(zip(("low", "high"), d.interval, strict=True))


def degree_hours(d: Diagnosis) -> float:
    """Return the control error integrated over 24 h of operation, K h/d; NaN without a set-point.

    There is no error while the valve is shut and the air is colder than the set-point (of a heating coil: warmer).
    """
    if "T_set" not in d.signals:
        return np.nan
    T, T_set, command = (d.signals[name].values for name in ("T_sup", "T_set", "command"))
    is_on = d.signals["enabled"].values > 0.0 if "enabled" in d.signals else True
    # up to 0.5 % of the stroke a valve counts as shut
    is_counted = (command > 0.005) | (d.triage.attrs["cools"] * (T - T_set) > 0.0)
    error = np.where(is_counted, np.abs(T - T_set), 0.0)[np.isfinite(T + T_set + command) & is_on]
    return 24.0 * float(error.mean()) if error.size else np.nan


def _ranking_key(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the sort key of a row: costliest first, without a set-point by motor travel, not diagnosed last."""
    cost, travel = row["degree_hours"], row["motor_travel"]
    return row["problem"] != "", np.isnan(cost), -np.nan_to_num(cost), -np.nan_to_num(travel), row["valve"]


def _valves_dataset(results: Mapping[str, Any], logs: Mapping[str, Any]) -> xr.Dataset:
    """Return the ranked rows of valves; of a log that could not be read its problem and no numbers."""
    rows = [
        {"valve": valve, **_EMPTY_ROW, "log": str(logs[valve]) if isinstance(logs[valve], Path) else ""}
        | ({"problem": result} if isinstance(result, str) else result)
        for valve, result in results.items()
    ]
    ds = rows_to_dataset(sorted(rows, key=_ranking_key), "valve", ("valve", *_EMPTY_ROW))
    for name, (unit, meaning) in _NUMBER_COLUMNS.items():
        ds[name].attrs = {"units": unit, "long_name": meaning}
    return ds.set_coords("valve").assign_attrs(title="fastcoil survey")


def _csv_text(ds: xr.Dataset) -> str:
    """Return the rows of a survey as a table with units in its header."""
    ds = ds.drop_dims("unread", errors="ignore")
    frame = ds.to_dataframe().reset_index(drop=not ds.indexes)
    for name in frame:
        if ds[name].dtype == object:
            frame[name] = frame[name].map(escape_formulas)
    units = {name: ds[name].attrs.get("units", "1") for name in frame}
    header = [name if unit == "1" else f"{name} [{unit}]" for name, unit in units.items()]
    return str(frame.to_csv(index=False, header=header, lineterminator="\n"))


AT_FAULT, _OTHER_FAULT = "with hunting or a gap", "with another fault"
RANKING_HEADER = ("valve", "K·h a day", "strokes a day", "gap", "swing", "cause")


def ranked_rows(ds: xr.Dataset) -> list[list[str]]:
    """Return the cells of ``RANKING_HEADER`` for each valve with a diagnosis."""
    rows, to_text = [], format_significant
    for k in np.flatnonzero(ds["problem"].values == ""):
        v = {str(name): values.values[k] for name, values in ds.variables.items()}
        gap = f"{100 * v['backlash']:.3g} % ({100 * v['low']:.3g} to {100 * v['high']:.3g})"
        swing = f"± {to_text(v['peak_to_peak'] / 2, 2)} K, {to_text(v['period'] / 60, 2)} min"
        gap, swing = gap if v["identified"] else MISSING_VALUE, swing if v["hunts"] else MISSING_VALUE
        rows.append([v["valve"], to_text(v["degree_hours"]), to_text(v["motor_travel"]), gap, swing, v["cause"]])
    return rows


def state_counts(ds: xr.Dataset) -> dict[str, int]:
    """Count the valves by state; each is in one."""
    is_at_fault = ds["hunts"] | (ds["identified"] & (ds["backlash"] > GOOD_BACKLASH))
    masks = {"not read": ds["problem"] != "", AT_FAULT: is_at_fault, _OTHER_FAULT: ds["warnings"] != "",
             "undecided": ds["cause"] == CAUSE_UNKNOWN}  # fmt: skip
    states = np.select([*masks.values()], [*masks], "without").tolist()
    return {state: states.count(state) for state in (AT_FAULT, _OTHER_FAULT, "without", "undecided", "not read")}


def describe_counts(ds: xr.Dataset) -> str:
    """Describe how many valves are in each state, in a sentence."""
    head = format_count(ds.sizes["valve"], "valve")
    return f"{head}: " + ", ".join(f"{n:,} {state}" for state, n in state_counts(ds).items() if n)


def _valves_page(ds: xr.Dataset) -> Page:
    is_read = ds["problem"].values == ""
    texts = (ds[name].values[is_read] for name in ("warnings", "advice", "reason"))
    rows = [[*row, ". ".join(filter(None, text[:2])) or text[2] or MISSING_VALUE] for row, *text in
            zip(ranked_rows(ds), *texts, strict=True)]  # fmt: skip
    note = (
        "K·h: size of the difference between supply temperature and set-point, integrated over 24 h of operation, 0 "
        "while the valve is shut and rightly so; 0.1 K all day is 2.4 K·h.  Strokes: of the motor.  Gap: share of the "
        "stroke, with its 95 % interval.  Swing: of the supply temperature, with its period."
    )
    ranking_tables = [Table("", [*RANKING_HEADER, "faults, and what to do"], rows, note)] if rows else []
    unread = unread_section("valve", ds["valve"].values[~is_read], ds["problem"].values[~is_read])
    sections = [Section("Ranked by control error", ranking_tables), unread]
    question = "Which valves cost most if they are left as they are, and what helps?"
    title = f"Survey of {ds.sizes['valve']:,} valves"
    return Page("Survey", title, question, [], [describe_counts(ds)], sections, content_sha256(ds))

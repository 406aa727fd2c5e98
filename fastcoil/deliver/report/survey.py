"""``survey``: the valves of a building, diagnosed from their logs and ranked, as a Dataset, a page and a table."""

import concurrent.futures as cf
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, collecting, flag_of, path_of
from fastcoil.base.errors import FastcoilError, InputError, StorageError
from fastcoil.base.files import commit, entries, exists, has_mark, is_folder, make_folder, require_file, storage_errors
from fastcoil.base.progress import Advance, progress_of_call
from fastcoil.base.text import NONE, no_formula, printable
from fastcoil.deliver.report.page import Page, Section, Table, number, require_page
from fastcoil.loops.provenance import content_sha256
from fastcoil.loops.simulate import workers
from fastcoil.measured.cause import UNKNOWN
from fastcoil.measured.diagnose import diagnose
from fastcoil.measured.diagnosis import INDICES, Diagnosis
from fastcoil.measured.identify import GOOD

CLOSED = 0.005  # of the stroke: up to this command a valve counts as shut
_FEWEST = 4  # logs for each process: fewer do not pay for its start
_NUMBERS = {
    "degree_hours": ("K h d-1", "control error that the valve could act on, integrated over a day of operation"),
    "motor_travel": INDICES["motor_travel"],
    "backlash": ("1", "most probable backlash, fraction of stroke; valid only if identified"),
    "low": ("1", "lower end of its 95 % interval"),
    "high": ("1", "upper end of its 95 % interval"),
    "hours": ("h", "hours of operation in the log"),
} | INDICES
_TEXTS = ("cause", "because", "warnings", "advice", "reason", "notes", "problem", "log")
_MISSING: dict[str, Any] = {**dict.fromkeys(_NUMBERS, np.nan), "identified": False, "hunts": False,
                            **dict.fromkeys(_TEXTS, "")}  # fmt: skip
_CURE = "give CSV files, a folder of them, or a mapping of names to logs"
_FIRST = b"valve,degree_hours [K h d-1],"  # begins the header of a table


def survey(
    logs: Any,
    out: str | os.PathLike[str] | None = None,
    *,
    n_jobs: int | None = None,
    progress: bool | None = None,
    **options: Any,
) -> xr.Dataset:
    """Diagnose the valves of a building and rank them by the control error that they leave.

    Parameters
    ----------
    logs
        A log for each valve: CSV files and folders of them, or a mapping of names to what `diagnose` accepts.  Tables
        of earlier surveys are skipped.
    out
        FILE.html, a page; FILE.csv, a table; or a folder for both, ``survey.html`` and ``survey.csv``.
    n_jobs
        Processes; all cores by default.
    progress
        Whether to show how many logs are done, on stderr: True always, False never; None on a terminal, after 2 s.
    options
        Of `diagnose`, for all logs: ``stroke_time``, ``sample_time``, ``lag``, ``units``, ``columns``, ``drop``, …

    Returns
    -------
    xarray.Dataset
        Along ``valve`` (name of the file, with its folder where several are alike), the costliest first.
        ``degree_hours``: size of the control error, but where the valve is shut and rightly so, integrated over a day
        of operation, K h d-1, NaN without a set-point; ``backlash``, ``low``, ``high`` (fractions of stroke),
        ``identified``, ``hunts``, ``cause``, ``because``, ``warnings``, ``advice``, ``reason``, ``notes`` and the
        indices of `diagnose`; ``hours`` of operation; ``log``.  ``problem`` says why a log cannot be diagnosed; its
        numbers are NaN, and it is last.

    Raises
    ------
    InputError
        With one sentence for each mistake in the arguments; if there is no log.
    StorageError
        If a folder cannot be read or ``out`` cannot be written; no partial file remains.
    """
    with checking() as check:
        with collecting(check.problems):
            diagnose([], **options)  # its arguments are checked before its logs
        check.problems[:] = [problem for problem in check.problems if not problem.startswith("log = []")]
        n_jobs = check(workers, n_jobs)
        progress = check.unless_none(flag_of, "progress", progress)
        targets = check.unless_none(_targets, "out", out) or []
        found = check(_by_valve, logs)
    with progress_of_call(progress) as shown:
        rows = list(_rows(found, options, n_jobs, shown.start(len(found), what="logs")))
    ds = _dataset(sorted(rows, key=_rank))
    for target in targets:
        with storage_errors(target.parent, "written"):
            make_folder(target.parent, parents=True)
        text = _csv(ds) if target.suffix.lower() == ".csv" else _page(ds).html()
        commit(target, text.encode())
    return ds


def _targets(name: str, out: Any) -> list[Path]:
    """The files to write; refused, before any work, where one exists that is no earlier survey."""
    path = path_of(name, out, "give FILE.html, FILE.csv or a folder")
    if is_folder(path) or not (path.suffix or exists(path)):
        targets = [path / "survey.html", path / "survey.csv"]
    else:
        require_file(name, path, ".html", ".htm", ".csv")
        targets = [path]
    for target in filter(exists, targets):
        if target.suffix.lower() != ".csv":
            require_page(target, name)
        elif not has_mark(target, _FIRST):
            raise InputError(f"{name} {target}: the file exists and is not a survey: choose another name, or delete it")
    return targets


def _by_valve(logs: Any) -> dict[str, Any]:
    """Log by name of the valve: the stem of its file, with the folder or the whole path where several are alike."""
    if isinstance(logs, Mapping) and logs and not hasattr(logs, "data_vars"):
        return {str(valve): log for valve, log in logs.items()}
    several = list(logs) if isinstance(logs, list | tuple | Iterator) else [logs]
    files: dict[Path, None] = {}
    for path in (path_of("logs", one, _CURE) for one in several):
        inside = entries(path) if is_folder(path) else [path]
        files |= dict.fromkeys(file for file in inside if file == path or file.suffix.lower() == ".csv")
    paths = [file for file in files if not has_mark(file, _FIRST)]
    if not paths:
        raise InputError(f"logs: no CSV file: {_CURE}")
    names = [path.stem for path in paths]
    for longer in (lambda path: f"{path.absolute().parent.name}/{path.stem}", str):
        times = Counter(names)
        names = [name if times[name] == 1 else longer(path) for name, path in zip(names, paths, strict=True)]
    return dict(zip(names, paths, strict=True))


def _rows(
    logs: Mapping[str, Any], options: Mapping[str, Any], n_jobs: int, advance: Advance
) -> Iterator[dict[str, Any]]:
    """The row of each log; from processes, since two threads, which share the interpreter's lock, are no faster."""
    tasks = (joblib.delayed(row_of)(valve, log, options) for valve, log in logs.items())
    try:
        for row in joblib.Parallel(max(1, min(n_jobs, len(logs) // _FEWEST)), return_as="generator")(tasks):
            yield row
            advance(1)
    except cf.BrokenExecutor:
        raise StorageError("a process was killed, probably for want of memory: use fewer (n_jobs, --jobs)") from None


def row_of(valve: str, log: Any, options: Mapping[str, Any]) -> dict[str, Any]:
    """The diagnosis of one log as numbers and texts by name; without numbers and with its ``problem`` if it fails."""
    row = {"valve": valve, **_MISSING, "log": str(log) if isinstance(log, Path) else ""}
    try:
        d = diagnose(log, **options)
    except Exception as error:  # one log must not end the survey of all others
        bug = "" if isinstance(error, FastcoilError) else f"please report this error: {type(error).__name__}: "
        return row | {"problem": bug + "; ".join(str(error).split("\n"))}
    return row | {str(name): float(value) for name, value in d.indices.items()} | {
        "degree_hours": degree_hours(d), "hours": d.signals.attrs["hours"],
        "backlash": d.backlash, "low": d.interval[0], "high": d.interval[1], "identified": d.identified,
        "hunts": d.hunts, "cause": d.cause, "because": d.because, "advice": d.advice.reason, "reason": d.reason,
        "warnings": "; ".join(d.warnings), "notes": "; ".join(d.notes),
    }  # fmt: skip


def degree_hours(d: Diagnosis) -> float:
    """Control error integrated over 24 h of operation, K h/d; NaN without a set-point.

    A valve that is shut while the air is colder than the set-point (of a heating coil: warmer) counts as no error.
    """
    if "T_set" not in d.signals:
        return np.nan
    T, T_set, command = (d.signals[name].values for name in ("T_sup", "T_set", "command"))
    on = d.signals["enabled"].values > 0.0 if "enabled" in d.signals else True
    counts = (command > CLOSED) | (d.triage.attrs["cools"] * (T - T_set) > 0.0)
    error = np.where(counts, np.abs(T - T_set), 0.0)[np.isfinite(T + T_set + command) & on]
    return 24.0 * float(error.mean()) if error.size else np.nan


def _rank(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """Costliest first; logs without a set-point by the travel of the motor; then those without a diagnosis."""
    cost, travel = row["degree_hours"], row["motor_travel"]
    return row["problem"] != "", np.isnan(cost), -np.nan_to_num(cost), -np.nan_to_num(travel), row["valve"]


def _dataset(rows: list[dict[str, Any]]) -> xr.Dataset:
    for row in rows:  # names of files may hold any byte
        row |= {name: printable(row[name]) for name in ("valve", *_TEXTS)}
    ds = xr.Dataset(coords={"valve": np.array([row["valve"] for row in rows], dtype=object)})
    for name in _MISSING:
        attrs = dict(zip(("units", "long_name"), _NUMBERS.get(name, ()), strict=False))
        ds[name] = ("valve", np.array([row[name] for row in rows], dtype=object if name in _TEXTS else None), attrs)
    return ds.assign_attrs(title="fastcoil survey")


def _csv(ds: xr.Dataset) -> str:
    frame = ds.to_dataframe().reset_index()
    for name in ("valve", *_TEXTS):
        frame[name] = frame[name].map(no_formula)
    units = {name: values.attrs.get("units", "1") for name, values in ds.data_vars.items()}
    header = [name if units.get(name, "1") == "1" else f"{name} [{units[name]}]" for name in frame]
    return str(frame.to_csv(index=False, header=header, lineterminator="\n"))


AT_FAULT = "with hunting or a gap"
HEAD = ("valve", "K·h a day", "strokes a day", "gap", "swing", "cause")


def cells(ds: xr.Dataset) -> list[list[str]]:
    """Rows of ``HEAD`` for the valves with a diagnosis."""
    rows = []
    for k in np.flatnonzero(ds["problem"].values == ""):
        one = {str(name): values.values[k] for name, values in ds.variables.items()}
        gap = f"{100 * one['backlash']:.3g} % ({100 * one['low']:.3g} to {100 * one['high']:.3g})"
        swing = f"± {number(one['peak_to_peak'] / 2, 2)} K, {number(one['period'] / 60, 2)} min"
        rows.append([one["valve"], number(one["degree_hours"]), number(one["motor_travel"]),
                     gap if one["identified"] else NONE, swing if one["hunts"] else NONE, one["cause"]])  # fmt: skip
    return rows


def states(ds: xr.Dataset) -> dict[str, int]:
    """How many valves are in which state; each is in one."""
    failed, work = ds["problem"] != "", ds["hunts"] | (ds["identified"] & (ds["backlash"] > GOOD))
    other = ~work & (ds["warnings"] != "")
    unclear = ~(failed | work | other) & (ds["cause"] == UNKNOWN)
    found = {AT_FAULT: work, "with another fault": other, "without": ~(failed | work | other | unclear),
             "undecided": unclear, "not read": failed}  # fmt: skip
    return {words: int(state.sum()) for words, state in found.items()}


def headline(ds: xr.Dataset) -> str:
    """``states`` in a sentence."""
    return f"{ds.sizes['valve']:,} valves: " + ", ".join(f"{n:,} {words}" for words, n in states(ds).items() if n)


def _page(ds: xr.Dataset) -> Page:
    is_read = ds["problem"].values == ""
    texts = (ds[name].values[is_read] for name in ("warnings", "advice", "reason"))
    rows = [[*row, ". ".join(filter(None, text[:2])) or text[2] or NONE] for row, *text in
            zip(cells(ds), *texts, strict=True)]  # fmt: skip
    problems = list(zip(*(ds[name].values[~is_read] for name in ("valve", "problem")), strict=True))
    note = (
        "K·h: size of the difference between supply temperature and set-point, integrated over 24 h of operation, 0 "
        "while the valve is shut and rightly so; 0.1 K all day is 2.4 K·h.  Strokes: of the motor.  Gap: share of the "
        "stroke, with its 95 % interval.  Swing: of the supply temperature, with its period."
    )
    sections = [
        Section("Ranked by control error", [Table("", [*HEAD, "faults, and what to do"], rows, note)] if rows else []),
        Section("Logs that could not be read", [Table("", ["valve", "reason"], problems)] if problems else []),
    ]
    question = "Which valves cost most if they are left as they are, and what helps?"
    title = f"Survey of {ds.sizes['valve']:,} valves"
    return Page("Survey", title, question, [], [headline(ds)], sections, content_sha256(ds))

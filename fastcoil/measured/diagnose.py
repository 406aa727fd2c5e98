"""``diagnose``: whether a valve has backlash, and whether that is why its loop hunts, from a trend log."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, instance_of, number_of
from fastcoil.base.errors import InputError
from fastcoil.logs import Log, read_log
from fastcoil.logs.columns import Wanted, checked_reading, log_of
from fastcoil.logs.series import COLUMNS, counted
from fastcoil.measured.agreement import require_agreement
from fastcoil.measured.cause import Known, after_hold, cause_of, dies, predictions_of
from fastcoil.measured.diagnosis import INDICES, Diagnosis, ValveReading, profile_of
from fastcoil.measured.fitted_loop import fit_loop_model
from fastcoil.measured.grid import Grid, in_a_row, on_grid
from fastcoil.measured.identify import CANDIDATES, CURE, USUAL_STROKE_TIME, Identification, backlash_of, shown_by
from fastcoil.measured.measures import Measures, measures_of, triage_of, warnings_of
from fastcoil.measured.part import runs

_MEASURED = ("T_sup", "T_set", "m_a", "T_a_in")
WANTED = Wanted(needed=("command", "T_sup"), optional=(*_MEASURED[1:], "enabled"), measured=_MEASURED)
_LONGEST, _SHORTEST_SAMPLE = 3600.0, 0.1  # of a stroke or of the time between two samples of a controller, s
_LEAST_KP, _MOST_KP = 1e-5, 10.0  # 1/K
_WITHOUT_SET_POINT = 600.0  # s; values that are missing for less are held
WIDE_SWING, LARGEST_INCREMENT = 0.4, 0.06
"""Swing of the command, fraction of stroke, and change of a temperature that makes the log write it, K, above which no
size is claimed."""
WIDEST = 0.1  # interval of a backlash that may be claimed, fraction of stroke


@np.errstate(all="ignore")
def diagnose(
    log: Any,
    stroke_time: float | None = None,
    sample_time: float | None = None,
    *,
    lag: float | None = None,
    kp: float | None = None,
    ti: float | None = None,
    test: ValveReading | None = None,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    drop: bool = False,
    jumps: str = "refuse",
    max_gap: float | None = None,
    time_format: str | None = None,
) -> Diagnosis:
    """Find the backlash of a valve in a trend log of its loop, and why the loop hunts if it does.

    Parameters
    ----------
    log
        CSV file, DataFrame or Dataset; or a list of them, days of one valve at one interval, whose evidence is added.
        Needed: ``command`` (1, percent, deg of 90, V of 10), ``T_sup`` (°C, °F, K),
        and ``elapsed_time`` or ``timestamp``; of a Dataset of ``fc.simulate``, ``T_measured`` is taken if it is there.
        Optional: ``T_set``, without which no cause can be given; ``m_a`` and ``T_a_in``, air flow and entering air,
        with which smaller gaps show; ``enabled``, 0 where the plant is off.
    stroke_time
        Seconds of the motor from closed to open, 0 if it is as good as immediate; 90 if left out.
    sample_time
        Seconds between two samples of the controller; found from the log if left out.
    lag
        Seconds by which T_sup is logged late beside the command, negative if early; found from the log if left out.
    kp, ti
        Gain, 1/K, and integral time, s, of the controller, both; found from the log if left out.
    test
        What ``fc.read_test`` found of this valve: its gap is taken if identified, and what a held command left of the
        swing counts.
    units, columns, drop, jumps, max_gap, time_format
        How the log is read: see ``fastcoil.logs.Reading``.

    Returns
    -------
    Diagnosis
        ``backlash`` counts only if ``identified``; ``reason`` says why it is not.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments.
    """
    with checking() as check:
        logs = [check(log_of, "log", one) for one in (log if isinstance(log, (list, tuple)) else [log])]
        stroke_time = check.unless_none(seconds_of, "stroke_time", stroke_time, 0.0)
        sample_time = check.unless_none(seconds_of, "sample_time", sample_time, _SHORTEST_SAMPLE)
        lag = check.unless_none(seconds_of, "lag", lag, -_LONGEST)
        gains = check(_gains_of, kp, ti)
        test = check.unless_none(instance_of, "test", test, ValveReading, "give what fastcoil.read_test found")
        how = checked_reading(check, columns=columns, units=units, drop=drop, jumps=jumps,
                              max_gap=max_gap, time_format=time_format, has_command=True)  # fmt: skip
    if not logs:
        raise InputError("log = []: give a log, or a list of logs of one valve")
    names, grids, notes, warnings = [], [], [], []
    for one in logs:
        data = read_log(as_measured(one) if "T_sup" not in (columns or {}) else one, WANTED, how)
        warnings += require_agreement(data)
        _off_without_set_point(data)
        grid, of_grid = on_grid(data)
        names.append(data.name)
        grids.append(grid)
        notes += [note for note in (*data.notes, *of_grid) if note not in notes]
    grid = grids[0] if len(grids) == 1 else in_a_row(grids)
    values, interval = grid.values, grid.interval
    seconds = USUAL_STROKE_TIME if stroke_time is None else stroke_time
    found, measures = identified(grid, seconds, sample_time, lag)
    if test is not None and test.identified:
        low, high = test.interval
        of_test = test.profile["probability"].values
        found = Identification(test.backlash, low, high, True, test.reason, of_test, found.late)
    backlash = found.backlash if np.isfinite(found.backlash) else 0.0
    loop = fit_loop_model(
        values["command"], values["T_sup"], values.get("T_set"), interval, backlash, seconds, sample_time, grid.on,
        gains,
    )  # fmt: skip
    held = (np.nan, 0.0) if test is None else (test.held_swing, test.held_for)
    known = Known(found.identified, own=dies(measures, *held))
    cause = after_hold(cause_of(measures, loop, known), measures, *held)
    doubt = loop if isinstance(loop, str) else loop.doubt
    attrs = {name: {"units": unit, "long_name": meaning} for name, (unit, meaning) in INDICES.items()}
    indices = dict.fromkeys(INDICES, np.nan) | measures.indices
    if not isinstance(loop, str):
        indices |= {"kp": abs(loop.pi.kp), "ti": loop.pi.ti, "sample_time": loop.pi.sample_time}
        indices |= {} if doubt else {"plant_gain": loop.plant.gain}
    if stroke_time is None:
        notes.append(f"the motor is assumed to take {seconds:g} s per stroke: give stroke_time if you know it")
    if lag is None and found.late:
        notes.append(
            f"judging by the controller's response, T_sup is logged {abs(found.late):g} s "
            f"{'later' if found.late > 0.0 else 'earlier'} than the command, which was corrected; if that is wrong, "
            "give the lag (lag, --lag)"
        )
    if "T_set" not in values:
        notes.append("without a set-point (T_set), no control error, cause or prediction is computed")
    elif doubt:
        notes.append(f"no prediction: {doubt}")
    if sample_time is not None and sample_time < interval:
        notes.append(
            f"the log has a sample every {interval:.4g} s, the controller one every {sample_time:.4g} s: reversals "
            "of the command between two samples are missed"
        )
    triage = triage_of(grid)
    return Diagnosis(
        source=names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more",
        backlash=found.backlash,
        interval=(found.low, found.high),
        identified=found.identified,
        reason=found.reason,
        cause=cause.name,
        because=cause.because,
        hunts=measures.swing.is_regular,
        profile=profile_of(found),
        indices=xr.Dataset({name: ((), value, attrs[name]) for name, value in indices.items()}),
        predictions=None if doubt or isinstance(loop, str) else predictions_of(loop, cause.name),
        signals=_signals(grid, measures),
        triage=triage,
        warnings=[*warnings_of(triage), *warnings],
        notes=notes,
    )


def as_measured(log: Any) -> Any:
    """A Dataset of ``fc.simulate`` with the temperature that its controller read."""
    return log.assign(T_sup=log["T_measured"]) if hasattr(log, "data_vars") and "T_measured" in log else log


def _off_without_set_point(log: Log) -> None:
    """Take the plant for off where the set-point is missing for ten minutes or more, if no column says when it is."""
    if "T_set" not in log.values or "enabled" in log.values or log.change_of_value:
        return
    missing = np.isnan(log.values["T_set"])
    off = np.zeros(missing.size, dtype=bool)
    for first, last in runs(missing):
        off[first:last] = last - first > 1 and (last - first) * log.step >= _WITHOUT_SET_POINT
    if off.any():
        log.values["enabled"] = np.where(off, 0.0, 1.0)
        log.notes.append(f"{counted(off, 'row')} without T_set: the plant counts as off there")


def seconds_of(name: str, value: Any, least: float) -> float:
    """A time of the plant or the log, from ``least`` to an hour."""
    return number_of(name, value, f"give seconds, from {least:g} to {_LONGEST:g}", least=least, most=_LONGEST)


def _gains_of(kp: Any, ti: Any) -> tuple[float, float] | None:
    if (kp is None) != (ti is None):
        raise InputError("kp, ti: give both, or leave both out")
    if kp is None:
        return None
    cure = f"give 1/K, from {_LEAST_KP:g} to {_MOST_KP:g}"
    return number_of("kp", kp, cure, least=_LEAST_KP, most=_MOST_KP), seconds_of("ti", ti, _SHORTEST_SAMPLE)


def identified(
    grid: Grid, stroke_time: float, sample_time: float | None = None, lag: float | None = None
) -> tuple[Identification, Measures]:
    """The backlash as far as a log may claim it, and what it shows before any model; times in s."""
    days = []
    for day in map(grid.part, grid.days()):
        values = day.values
        inputs = tuple(values[name] for name in ("m_a", "T_a_in") if name in values)
        days.append(
            shown_by(values["command"], values["T_sup"], grid.interval, values.get("T_set"), inputs, day.on,
                     stroke_time, sample_time, lag)
        )  # fmt: skip
    measures = measures_of(grid, stroke_time)
    return _doubted(backlash_of(days), grid, measures), measures


def _doubted(found: Identification, grid: Grid, measures: Measures) -> Identification:
    """The backlash, not identified where the log holds a trap that the likelihood does not know."""
    if not found.identified:
        return found
    low, high = 0.0, float(CANDIDATES[-1])
    if measures.swing.is_regular and measures.command_swing > WIDE_SWING:
        # the squared opening of the model does not follow the curve of a valve over so much of its stroke
        reason = (
            f"the command swings over {100 * measures.command_swing:.0f} % of the stroke, where the valve's curve "
            "hides the gap: raise Ti until the loop is calm, then log again"
        )
    elif grid.increment > LARGEST_INCREMENT:
        reason = (
            f"the temperature is logged when it has changed by {grid.increment:.2g} K, which looks like a gap: log it "
            "at fixed times, or at changes of 0.05 K"
        )
    elif found.high - found.low > WIDEST:
        low, high = found.low, found.high
        reason = f"gaps from {100 * low:.2g} to {100 * high:.2g} % explain the log: {CURE}"
    else:
        return found
    return found._replace(low=low, high=high, identified=False, reason=reason)


def _signals(grid: Grid, measures: Measures) -> xr.Dataset:
    series = {name: ("elapsed_time", values, {"units": COLUMNS[name].unit}) for name, values in grid.values.items()}
    series["position"] = ("elapsed_time", measures.position, {"units": "1"})
    attrs = {"interval": grid.interval, "hours": float(grid.on.sum()) * grid.interval / 3600.0}
    ds = xr.Dataset(series, {"elapsed_time": ("elapsed_time", grid.time, {"units": "s"})}, attrs)
    return ds.assign(calm=("elapsed_time", measures.calm))

"""``diagnose``: backlash of a valve, and whether it is why its loop hunts, from a trend log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_instance, require_number
from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.log import CheckedLog, as_log
from fastcoil.logs.series import COLUMNS, format_count
from fastcoil.measured import identify, thresholds
from fastcoil.measured.agreement import plausible_lags, require_agreement
from fastcoil.measured.cause import PriorEvidence, judge_cause, predict_cases, revise_after_hold, stops_on_hold
from fastcoil.measured.diagnosis import INDICES, Diagnosis, ValveReading, probability_profile
from fastcoil.measured.fitted_loop import fit_loop_model
from fastcoil.measured.fitted_plant import recover_pi
from fastcoil.measured.grid import Grid, common_start, forward_fill, join_grids, keep_own_values, resample_log
from fastcoil.measured.identify import DayEvidence, Identification, combine_days, gather_evidence
from fastcoil.measured.measures import Measures, measure_loop
from fastcoil.measured.part import LogSource, true_runs
from fastcoil.measured.triage import hourly_summary, write_warnings

_MEASURED_COLUMNS = ("T_sup", "T_set", "m_a", "T_a_in", "T_w_in")
DIAGNOSIS_COLUMNS = ColumnSpec(("command", "T_sup"), (*_MEASURED_COLUMNS[1:], "enabled"), _MEASURED_COLUMNS)
_SHORTEST_TIME_S = 0.1  # between two samples of a controller
_LONGEST_TIME_S = 3600.0  # of a stroke, a sample time, an integral time or a lag
_KP_RANGE = (1e-5, 10.0)  # 1/K, of the argument kp


@np.errstate(all="ignore")
def diagnose(
    log: LogSource | Sequence[LogSource], stroke_time: float | None = None, sample_time: float | None = None, *,
    lag: float | None = None, kp: float | None = None, ti: float | None = None, test: ValveReading | None = None,
) -> Diagnosis:  # fmt: skip
    """Find the backlash of a valve in a trend log of its loop, and why the loop hunts if it does.

    Parameters
    ----------
    log : path, DataFrame, Dataset or Log, or a list of them
        A list holds days of one valve at one interval, whose evidence is added.  Needed: ``command`` (fraction of
        stroke, %, deg of 90, V of 10), ``T_sup`` (°C, °F, K), and ``elapsed_time`` or ``timestamp``; of a Dataset of
        `simulate`, ``T_measured`` is read as ``T_sup``.  Optional: ``T_set``, without which no cause can be given;
        ``m_a`` and ``T_a_in``, air flow and entering air, with which smaller gaps show; with ``T_w_in``, entering
        water, as well, an irregular swing gets a culprit; ``enabled``, 0 where the plant is off.  `read_log` has the
        options of reading.
    stroke_time : float, default 90
        Time of the motor from closed to open, s; 0 if it is immediate.
    sample_time : float, optional
        Time between two samples of the controller, s; estimated by default.
    lag : float, optional
        Time by which T_sup is logged after the command, s, negative if before; estimated by default.
    kp, ti : float, optional
        Gain, 1/K, and integral time, s, of the controller, both or neither; estimated by default.
    test : ValveReading, optional
        Result of `read_test` for this valve: its gap is used if identified, and the swing that remained while the
        command was held decides on the cause.

    Returns
    -------
    Diagnosis
        ``backlash``, fraction of stroke, counts only if ``identified``; ``reason`` says why it is not.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments.

    Examples
    --------
    >>> loop = fc.Loop.preset("lbnl").assign(backlash=0.06, noise_std=0.01)
    >>> ds = fc.simulate(loop, fc.paper_day(hours=4), traces=["command", "T_measured"], trace_interval=15)
    >>> diagnosis = fc.diagnose(ds, stroke_time=90)
    >>> f"{diagnosis.backlash:.3f}", diagnosis.identified
    ('0.060', True)
    """
    with argument_checks() as check:
        logs = [check(as_log, "log", source) for source in (log if isinstance(log, (list, tuple)) else [log])]
        stroke_time = check.unless_none(require_seconds, "stroke_time", stroke_time, 0.0)
        sample_time = check.unless_none(require_seconds, "sample_time", sample_time, _SHORTEST_TIME_S)
        lag = check.unless_none(require_seconds, "lag", lag, -_LONGEST_TIME_S)
        gains = check(_require_gains, kp, ti)
        test = check.unless_none(require_instance, "test", test, ValveReading, "give what fastcoil.read_test found")
    if not logs:
        raise InputError("log = []: give a log, or a list of logs of one valve", "log", "missing")
    names, grids, starts, notes, warnings = [], [], [], [], []
    for source in logs:
        data = source.read(DIAGNOSIS_COLUMNS, use_sensor=True)
        warnings += require_agreement(data)
        _infer_off_times(data)
        grid, grid_notes = resample_log(data)
        names.append(data.name)
        grids.append(grid)
        starts.append(data.start)
        notes += [note for note in (*data.notes, *grid_notes) if note not in notes]
    if None not in starts:
        order = np.argsort(np.array(starts, dtype="datetime64[s]"), kind="stable")
        grids, starts = [grids[k] for k in order], [starts[k] for k in order]
    grid, own_notes = keep_own_values(join_grids(grids, starts))
    notes += own_notes
    values, interval = grid.values, grid.interval
    motor_seconds = identify.USUAL_STROKE_TIME if stroke_time is None else stroke_time
    given_lag, is_clear = lag, False
    while not is_clear:
        identification, measures = identify_and_measure(grid, motor_seconds, sample_time, lag)
        late_by = identification.temperature_lag if lag is None else lag
        if test is not None and test.identified:
            (low, high), probability = test.interval, test.profile["probability"].values
            identification = Identification(test.backlash, low, high, True, test.reason, probability, late_by)
        backlash = identification.backlash if np.isfinite(identification.backlash) else 0.0
        # a command that is late, on a clock that is not clear, may be that of a slow controller
        moved = grid.at_lag(max(late_by, 0.0) if lag is None else lag).values
        loop = fit_loop_model(
            moved["command"], moved["T_sup"], moved.get("T_set"), interval, backlash, motor_seconds, sample_time,
            grid.on, gains,
        )  # fmt: skip
        doubt = loop if isinstance(loop, str) else loop.doubt
        is_exact = not isinstance(loop, str) and loop.pi.explained > thresholds.LEAST_CLOCK_EXPLAINED
        if lag is None and (late_by or doubt or not is_exact):
            lag = _find_lag(grid, late_by, sample_time)
        is_clear = lag in (None, late_by)
    hold = (np.nan, 0.0) if test is None else (test.held_swing, test.held_for)
    evidence = PriorEvidence(identification.identified, is_own_swing=stops_on_hold(measures, *hold))
    cause = revise_after_hold(judge_cause(measures, loop, evidence), measures, *hold)
    attrs = {name: {"units": unit, "long_name": meaning} for name, (unit, meaning) in INDICES.items()}
    indices = dict.fromkeys(INDICES, np.nan) | measures.indices
    if not isinstance(loop, str):
        indices |= {"kp": abs(loop.pi.kp), "ti": loop.pi.ti, "sample_time": loop.pi.sample_time}
        indices |= {} if doubt else {"plant_gain": loop.plant.gain}
    notes += note_stroke_time(stroke_time)
    if given_lag is None and late_by:
        when = f"{abs(late_by):g} s {'later' if late_by > 0.0 else 'earlier'} than the command, which was corrected"
        cure = "if that is wrong, give the lag (lag, --lag)"
        notes.append(f"judging by the controller's response, T_sup is logged {when}; {cure}")
    if "T_set" not in values:
        notes.append("without a set-point (T_set), no control error, cause or prediction is computed")
    elif doubt:
        notes.append(f"no prediction: {doubt}")
    if sample_time is not None and sample_time < interval:
        rhythms = f"the log has a sample every {interval:.4g} s, the controller one every {sample_time:.4g} s"
        notes.append(f"{rhythms}: reversals of the command between two samples are missed")
    triage, signals = hourly_summary(grid, common_start(starts)), _signals_dataset(grid, measures)
    if stroke_time is not None:
        signals.attrs["stroke_time"] = stroke_time
    return Diagnosis(
        source=names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more",
        backlash=identification.backlash, interval=(identification.low, identification.high),
        identified=identification.identified, reason=identification.reason, cause=cause.name, because=cause.because,
        hunts=measures.swing.is_regular, is_own=measures.is_own, profile=probability_profile(identification),
        indices=xr.Dataset({name: ((), value, attrs[name]) for name, value in indices.items()}),
        predictions=None if doubt or isinstance(loop, str) else predict_cases(loop, cause),
        signals=signals, triage=triage, warnings=[*write_warnings(triage), *warnings], notes=notes,
    )  # fmt: skip


def _infer_off_times(log: CheckedLog) -> None:
    """Set ``enabled`` to 0 where the set-point is missing for ten minutes or more, unless it is logged."""
    if "T_set" not in log.values or "enabled" in log.values or log.change_of_value:
        return
    is_missing = np.isnan(log.values["T_set"])
    is_off = np.zeros(is_missing.size, dtype=bool)
    for first, last in true_runs(is_missing):
        is_off[first:last] = last - first > 1 and (last - first) * log.step >= 600.0
    if is_off.any():
        log.values["enabled"] = np.where(is_off, 0.0, 1.0)
        log.notes.append(f"{format_count(is_off, 'row')} without T_set: the plant counts as off there")


def require_seconds(name: str, value: Any, least: float) -> float:
    """Require a number of seconds from ``least`` to an hour."""
    cure = f"give seconds, from {least:g} to {_LONGEST_TIME_S:g}"
    return require_number(name, value, cure, least=least, most=_LONGEST_TIME_S)


def note_stroke_time(stroke_time: float | None) -> list[str]:
    """Return a note on a stroke time, s, that is assumed or unusual."""
    if stroke_time is None:
        assumed = f"the motor is assumed to take {identify.USUAL_STROKE_TIME:g} s per stroke"
        return [f"{assumed}: give stroke_time if you know it"]
    is_usual = not stroke_time or 10.0 <= stroke_time <= 600.0
    return [] if is_usual else [f"stroke_time = {stroke_time:g} s: most motors take 10 to 600 s: check the unit"]


def _require_gains(kp: Any, ti: Any) -> tuple[float, float] | None:
    if (kp is None) != (ti is None):
        raise InputError("kp, ti: give both, or leave both out", "ti" if ti is None else "kp", "missing")
    if kp is None:
        return None
    least, most = _KP_RANGE
    kp = require_number("kp", kp, f"give 1/K, from {least:g} to {most:g}", least=least, most=most)
    return kp, require_seconds("ti", ti, _SHORTEST_TIME_S)


def _find_lag(grid: Grid, assumed: float, sample_time: float | None) -> float:
    """Return the only lag of T_sup, s, at which a PI explains nearly every move of the command, else ``assumed``."""
    end = max(np.flatnonzero(grid.on), default=0) + 1  # of the last half a day of operation, which suffices
    grid = grid.part(slice(max(end - int(43200.0 / grid.interval), 0), end))
    step = grid.interval * max(1, round(5.0 / grid.interval))  # s
    n, left = int(30.0 / step), {}  # s; what a PI leaves at each lag
    for lag in sorted({assumed, *(step * np.arange(-n, n + 1)).tolist()}):
        command, T_sup, T_set, known = _known_loop(grid.at_lag(lag))
        pi = "" if T_set is None else recover_pi(command, T_sup, T_set, grid.interval, known, sample_time)
        left[lag] = 1.0 if isinstance(pi, str) else max(1.0 - pi.explained, 1e-5)
    best = next(lag for lag in left if left[lag] <= 1.25 * min(left.values()))
    # a command that answers the sample before is explained a sample later as well
    rival = min((left[lag] for lag in left if not best <= lag < best + 1.5 * step), default=0.0)
    return best if left[best] < min(1.0 - thresholds.LEAST_CLOCK_EXPLAINED, 0.25 * rival) else assumed


def identify_and_measure(
    grid: Grid, stroke_time: float, sample_time: float | None = None, lag: float | None = None
) -> tuple[Identification, Measures]:
    """Identify the backlash, unless the log has a trap for it, and measure the loop; times in s."""
    days = [grid.part(rows) for rows in grid.day_slices()]

    def identify_at(lag: float | None) -> Identification:
        return combine_days([_gather_day(day, stroke_time, sample_time, lag) for day in days])

    identification, measures = identify_at(lag), measure_loop(grid, stroke_time)
    if identification.identified and len(days) > 1 and lag is None:
        late_by = identification.temperature_lag
        other_lags, is_clock_right = plausible_lags(map(_known_loop, days), grid.interval, late_by)
        # a command that answers a temperature logged later looks like one without a gap
        if not is_clock_right or identification.backlash <= identify.GOOD_BACKLASH:
            for other_lag in other_lags:
                identification = _require_survival(identification, identify_at(other_lag), other_lag)
    return _withhold_doubtful(identification, grid, measures), measures


def _gather_day(day: Grid, stroke_time: float, sample_time: float | None, lag: float | None) -> DayEvidence:
    values = day.values
    inputs = tuple(values[name] for name in ("m_a", "T_a_in") if name in values)
    series = values["command"], values["T_sup"], day.interval, values.get("T_set"), inputs, day.on
    return gather_evidence(*series, stroke_time, sample_time, lag)


def _known_loop(day: Grid) -> tuple[Array, Array, Array | None, Mask]:
    """Return command, temperature and set-point, filled where missing, and where all are known."""
    series = [day.values[name] for name in ("command", "T_sup", "T_set") if name in day.values]
    command, temperature, *T_set = map(forward_fill, series)
    return command, temperature, T_set[0] if T_set else None, np.all([*map(np.isfinite, series), day.on], axis=0)


def _require_survival(claim: Identification, other: Identification, lag: float) -> Identification:
    """Withhold a claim that does not survive another ``lag``, s, with which a PI explains the commands of all days."""
    tolerance = max(identify.SIZE_TOLERANCE * claim.backlash, identify.GOOD_BACKLASH) + 1e-9
    if not claim.identified or (other.identified and abs(other.backlash - claim.backlash) <= tolerance):
        return claim
    lateness = f"{abs(lag):g} s {'later' if lag > 0.0 else 'earlier'} than the command"
    reason = f"over all days, the controller's response fits T_sup {lateness}, and there the log shows no such gap: "
    reason += "check that both points share one clock, or give the lag between them (lag, --lag)"
    return claim._replace(low=0.0, high=float(identify.CANDIDATES[-1]), identified=False, reason=reason)


def _withhold_doubtful(identification: Identification, grid: Grid, measures: Measures) -> Identification:
    """Mark a gap as not identified if the log has a trap: a wide swing, coarse readings, a wide interval."""
    if not identification.identified:
        return identification
    low, high = 0.0, float(identify.CANDIDATES[-1])
    if measures.swing.is_regular and measures.command_swing > thresholds.WIDEST_COMMAND_SWING:
        swings = f"the command swings over {100 * measures.command_swing:.0f} % of the stroke"
        reason = f"{swings}, where the valve's curve hides the gap: raise Ti until the loop is calm, then log again"
    elif grid.increment > thresholds.LARGEST_INCREMENT_K:
        jumps = f"the temperature is logged when it has changed by {grid.increment:.2g} K, which looks like a gap"
        reason = f"{jumps}: log it at fixed times, or at changes of 0.05 K"
    elif identification.high - identification.low > thresholds.WIDEST_INTERVAL:
        low, high = identification.low, identification.high
        reason = f"gaps from {100 * low:.2g} to {100 * high:.2g} % explain the log: {identify.MORE_EVIDENCE_CURE}"
    else:
        return identification
    return identification._replace(low=low, high=high, identified=False, reason=reason)


def _signals_dataset(grid: Grid, measures: Measures) -> xr.Dataset:
    """Return the log as resampled, the motor's position and whether the loop was calm, along ``elapsed_time``."""
    series = {name: ("elapsed_time", values, {"units": COLUMNS[name].unit}) for name, values in grid.values.items()}
    series["position"] = ("elapsed_time", measures.position, {"units": "1"})
    attrs = {"interval": grid.interval, "hours": float(grid.on.sum()) * grid.interval / 3600.0}
    ds = xr.Dataset(series, {"elapsed_time": ("elapsed_time", grid.time, {"units": "s"})}, attrs)
    return ds.assign(calm=("elapsed_time", measures.calm))

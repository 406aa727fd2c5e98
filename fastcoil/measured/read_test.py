"""``read_test``: backlash of a valve from the log of a valve test, and whether it is why the loop hunts.

The temperature answers the opening behind the gap through two lags and a dead time; the rest is drift, whose changes
are coloured, and noise: an ARIMA(1,1,1).  For each candidate gap, start of the stem, pair of lags, dead time
and colour of the noise, the gain has a wide normal prior and is integrated out; the likelihoods of all but the gap are
summed.  Nothing is fitted by iteration, so that a log has one answer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_number
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, short_repr
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.log import as_log
from fastcoil.measured.cause import CAUSE_UNKNOWN, Cause, PriorEvidence, judge_cause, revise_after_hold, stops_on_hold
from fastcoil.measured.diagnose import identify_and_measure, note_stroke_time, require_seconds
from fastcoil.measured.diagnosis import ValveReading, probability_profile
from fastcoil.measured.fitted_loop import fit_loop_model
from fastcoil.measured.fitted_plant import is_unsaturated
from fastcoil.measured.grid import Grid, forward_fill, keep_own_values, motor_positions, resample_log, running_mean
from fastcoil.measured.identify import CANDIDATES, LEAST_REVERSAL, USUAL_STROKE_TIME, Identification, judge_size
from fastcoil.measured.part import LogSource, count_reversals, true_runs

DISTURBANCE_COLUMNS = ("m_a", "T_a_in", "T_w_in")
TEST_COLUMNS = ColumnSpec(
    ("command", "T_sup"), ("test", "T_set", *DISTURBANCE_COLUMNS, "enabled"), ("T_sup", "T_set", *DISTURBANCE_COLUMNS)
)
_AFTER_TEST_S = 600.0  # that show the gap as well


@np.errstate(all="ignore")
def read_test(
    log: LogSource, stroke_time: float | None = None, *, between: tuple[float, float] | None = None
) -> ValveReading:
    """Read the backlash of a valve from the log of a valve test.

    Parameters
    ----------
    log : path, DataFrame, Dataset or Log
        A row every 15 s or faster, better 5 s.  Needed: ``command``, ``T_sup`` and ``elapsed_time`` or ``timestamp``,
        as for `diagnose`.  Optional: ``test``, 1 while the test runs, without which ``between`` is needed; ``T_set``,
        without which no cause is given; ``m_a``, ``T_a_in``, ``T_w_in``, with which the gap shows more clearly;
        ``enabled``.  With an hour before the test the cause of hunting is judged.  `read_log` has the options of
        reading.
    stroke_time : float, default 90
        Time of the motor from closed to open, s; 0 if it is immediate.
    between : (float, float), optional
        Start and end of the test, s from the start of the log, if the log has no column ``test``.  The last of several
        tests in that column is read.

    Returns
    -------
    ValveReading
        ``backlash``, fraction of stroke, counts only if ``identified``; ``reason`` says why it is not.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments.

    Examples
    --------
    >>> loop = fc.Loop.preset("lbnl").assign(backlash=0.06, noise_std=0.01, sample_time=5)
    >>> traces = ["command", "T_measured", "test"]
    >>> test = fc.ValveTest(start=1800, minutes=20)
    >>> ds = fc.simulate(loop, fc.paper_day(hours=1), test=test, traces=traces, trace_interval=10)
    >>> reading = fc.read_test(ds, stroke_time=90)
    >>> f"{reading.backlash:.3f}", reading.identified
    ('0.060', True)
    """
    with argument_checks() as check:
        source = check(as_log, "log", log)
        stroke_time = check.unless_none(require_seconds, "stroke_time", stroke_time, 0.0)
        between = check.unless_none(_require_between, "between", between)
    data = source.read(TEST_COLUMNS, use_sensor=True)
    grid, notes = resample_log(data)
    grid, own_notes = keep_own_values(grid)
    if grid.interval > 15.0:
        sentence = f"{data.name}: a sample every {grid.interval:.4g} s: log the test every 5 s, 15 s at most"
        raise InputError(sentence, "log", "time")
    grid = grid.part(slice(None, None, max(1, round(10.0 / grid.interval))))  # which shows the gap as well
    notes = [*data.notes, *notes, *own_notes]
    notes += note_stroke_time(stroke_time)
    stroke_time = USUAL_STROKE_TIME if stroke_time is None else stroke_time
    first, last = _find_test_rows(data.name, grid, between, notes)
    window = slice(max(first - round(600.0 / grid.interval), 0), last + round(_AFTER_TEST_S / grid.interval))
    command = forward_fill(grid.values["command"][: window.stop])
    positions = motor_positions(command, grid.interval, stroke_time)[:-1]
    identification, response = _identify_gap(grid, positions, first, last, window)
    if response.dead_time in CLOCK_SKEWS_S:
        order = "after" if response.dead_time < 0.0 else "before"
        skew = f"the command seems to be logged {abs(response.dead_time):g} s {order} the temperature"
        notes.append(f"{skew}, and the reading corrects for this: log both with one clock")
    swing, held_for = _measure_hold(grid, command, first, last)
    cause = _judge_cause_before(grid, stroke_time, first, last, identification, (swing, held_for))
    return ValveReading(
        source=data.name, backlash=identification.backlash, interval=(identification.low, identification.high),
        identified=identification.identified, reason=identification.reason, gain=response.gain, lag=response.lag,
        dead_time=response.dead_time, held_swing=swing, held_for=held_for, cause=cause.name, because=cause.because,
        explained=response.explained, minutes=(last - first) * grid.interval / 60.0,
        profile=probability_profile(identification),
        signals=_signals(grid, command, response, first, last, window), notes=notes,
    )  # fmt: skip


def _require_between(name: str, value: Any) -> tuple[float, float]:
    cure = "give start and end in seconds from the start of the log, such as (5400, 6600)"
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise InputError(f"{name} = {short_repr(value)}: {cure}", name, "type")
    start, end = (require_number(name, bound, cure, least=0.0, most=1e9) for bound in value)
    if end <= start:
        raise InputError(f"{name} = {short_repr(value)}: the end is not after the start, {cure}", name, "value")
    return start, end


def _find_test_rows(name: str, grid: Grid, between: tuple[float, float] | None, notes: list[str]) -> tuple[int, int]:
    """First row of the test, and the first after it."""
    if between is not None:
        if between[1] > grid.time[-1] + grid.interval:
            ends = f"between ends at {between[1]:g} s, the log at {grid.time[-1]:g} s"
            raise InputError(f"{ends}: give seconds from the start of the log", "between", "value")
        is_test = (grid.time >= between[0]) & (grid.time <= between[1])
    elif "test" in grid.values:
        is_test = np.nan_to_num(forward_fill(grid.values["test"])) > 0.0
    else:
        sentence = f"{name}: no column test: say when the test ran (between, --between START END)"
        raise InputError(sentence, "between", "missing")
    tests = true_runs(is_test)
    if not len(tests):
        words = "the column test is 0 throughout, or between lies outside the log"
        raise InputError(f"{name}: the log contains no test: {words}", "test" if between is None else "between", "data")
    if len(tests) > 1:
        notes.append(f"the log has {len(tests)} tests: the last is read, for another give between, --between")
    first, last = int(tests[-1][0]), int(tests[-1][1])
    if between is not None and not rests_as_in_test(forward_fill(grid.values["command"])[first:last], grid.interval):
        window = f"between = ({between[0]:g}, {between[1]:g}): the command does not hold and ramp as in a valve test"
        raise InputError(f"{window}: give start and end of a test (fastcoil valve-test plan)", "between", "data")
    if np.unique(forward_fill(grid.values["T_sup"])[first : last + round(_AFTER_TEST_S / grid.interval)]).size < 2:
        sentence = f"{name}: T_sup does not move in the test: check its sensor and how it is logged"
        raise InputError(sentence, "T_sup", "data")
    return first, last


def rests_as_in_test(command: Array, interval: float) -> bool:
    """Whether a command rests between its ends for 45 s, and twice as long as between its moves, as in a test."""
    is_moved = (np.abs(np.diff(command)) > 0.001) | ~is_unsaturated(command[1:])
    *others, longest = np.sort(np.diff([0, *np.flatnonzero(is_moved) + 1, command.size])) * interval
    return bool(longest >= max(45.0, 2.0 * float(np.median(others or [0.0]))))


def _identify_gap(
    grid: Grid, positions: Array, first: int, last: int, window: slice
) -> tuple[Identification, ThermalResponse]:
    T = grid.values["T_sup"][: window.stop]
    logged_inputs = [grid.values[name][: window.stop] for name in DISTURBANCE_COLUMNS if name in grid.values]
    inputs = [forward_fill(series) for series in logged_inputs if np.isfinite(series).any()]
    missing = float(np.mean(~np.isfinite(T[window])))
    doubt = ""
    if missing > 0.05:
        doubt = f"{100 * missing:.0f} % of the temperatures are missing: test again, and log all"
    elif not count_reversals(positions[first:last], LEAST_REVERSAL):
        doubt = "the command does not reverse during the test, and a gap shows only at reversals: test again, "
        doubt += "for longer"
    response = fit_response(forward_fill(T), positions, window.start, first, grid.interval, inputs, CANDIDATES)
    if not doubt and abs(response.dead_time) >= max(CLOCK_SKEWS_S):
        doubt = "command and temperature are logged minutes apart: log both with one clock, and test again"
    elif not doubt and response.explained < 0.5:
        share = f"{100 * max(response.explained, 0.0):.0f} % of the temperature changes"
        cure = "something else moves the temperature; test again when water and air are steady"
        doubt = f"the command explains only {share}: {cure}"
    weighted = 0.65 * response.likelihood  # residuals are neither independent nor normal
    cure = "test again, for 30 minutes or more, or log m_a, T_a_in and T_w_in too"
    return judge_size(np.exp(weighted - np.logaddexp.reduce(weighted)), True, doubt, cure), response


def _measure_hold(grid: Grid, command: Array, first: int, last: int) -> tuple[float, float]:
    """Swing of the temperature, K, in the second half of the time before the first move, and that half, s."""
    moves = np.flatnonzero(command[first + 1 : last] != command[first + 1])
    end = first + 1 + (int(moves[0]) if moves.size else last - first - 1)
    hold = grid.values["T_sup"][(first + end) // 2 : end]
    seconds, is_known = hold.size * grid.interval, np.isfinite(hold)
    smooth = running_mean(hold, is_known, max(1, min(round(60.0 / grid.interval), hold.size // 3)))[is_known]
    return (float(np.ptp(smooth)) if smooth.size > 1 else math.nan), seconds


def _judge_cause_before(
    grid: Grid, stroke_time: float, first: int, last: int, identification: Identification, hold: tuple[float, float]
) -> Cause:
    """Judge why the loop swung before the test; the plant is fitted to all rows, the controller to those before."""
    values = {name: series[:last] for name, series in grid.values.items()}
    if "T_set" not in values or first * grid.interval < 3600.0:
        return Cause(CAUSE_UNKNOWN, "log T_set, and an hour or more of normal operation before the test")
    logged, measures = identify_and_measure(grid.part(slice(first)), stroke_time)
    is_by_test = identification.identified
    agrees = logged.identified and identification.low <= logged.backlash <= identification.high
    identification = logged if agrees and not is_by_test else identification
    gap = identification.backlash if np.isfinite(identification.backlash) else 0.0
    fitted = fit_loop_model(
        values["command"], values["T_sup"], values["T_set"], grid.interval, gap, stroke_time,
        enabled=grid.on[:last], by_hand=np.arange(last) >= first,
    )  # fmt: skip
    evidence = PriorEvidence(identification.identified, is_by_test, stops_on_hold(measures, *hold))
    return revise_after_hold(judge_cause(measures, fitted, evidence), measures, *hold)


def _signals(grid: Grid, command: Array, response: ThermalResponse, first: int, last: int, window: slice) -> xr.Dataset:
    rows = np.arange(window.start, command.size)
    model = np.full(rows.size, np.nan)
    model[first - window.start :] = response.model + forward_fill(grid.values["T_sup"])[first]
    series = {"T_sup": grid.values["T_sup"][window], "command": command[window], "stem": response.stem,
              "model": model, "test": ((rows >= first) & (rows < last)).astype(float)}  # fmt: skip
    units = {"T_sup": "degC", "model": "degC"}
    return xr.Dataset(
        {name: ("elapsed_time", values, {"units": units.get(name, "1")}) for name, values in series.items()},
        {"elapsed_time": ("elapsed_time", grid.time[window], {"units": "s"})},
    )


LAGS_S = (8.0, 15.0, 25.0, 40.0, 65.0, 100.0, 150.0)  # in pairs: sensor, metal, water and air of a coil
INPUT_LAGS_S = (15.0, 60.0, 200.0)  # of each known disturbance
DEAD_TIMES_S = (0.0, 10.0, 20.0)
CLOCK_SKEWS_S = (-150.0, -120.0, -90.0, -60.0, -30.0, 40.0, 60.0, 90.0, 120.0, 150.0)
"""Dead times of a log whose command and temperature have different clocks; negative: the command is late."""
AR = (0.0, 0.5, 0.8, 0.95)  # memory of the changes of the drift, from sample to sample
MA = (0.0, 0.4, 0.7, 0.85, 0.95)  # share of them that the noise of the sensor takes back
GAIN_DEVIATION = 40.0  # K per stroke, standard deviation of the prior
_LIKELIHOOD_RANGE = 15.0  # log-likelihood below the best from which lags and dead times are left out
_TINY = 1e-9  # share of a variance that is none


class ThermalResponse(NamedTuple):
    """Response of the temperature: log-likelihood of each candidate, and the most probable model."""

    likelihood: Array
    gain: float  # K per stroke
    lag: float  # sum of both, s
    dead_time: float  # s
    explained: float  # share of the variance of the temperature that the known disturbances leave
    stem: Array  # its place behind the most probable gap, fraction of stroke, from the first row that is modelled on
    model: Array  # temperature of the model without drift, K from its start, at the samples that are compared


def stem_places(positions: Array, candidates: Array, starts: Array) -> Array:
    """Place of the stem behind each candidate gap, Eq (1), from each start, (…, candidates): (n, …, candidates)."""
    q, places = starts, np.empty((positions.size, *starts.shape))
    for k, position in enumerate(positions.tolist()):
        q = np.minimum(np.maximum(q, position - candidates), position)
        places[k] = q
    return places


def fit_response(
    temperature: Array, positions: Array, first: int, from_row: int, interval: float, inputs: Sequence[Array],
    candidates: Array,
) -> ThermalResponse:  # fmt: skip
    """Compare candidate gaps: rows from ``first`` are modelled, from ``from_row`` compared, others place the stem."""
    from scipy.signal import lfilter

    def apply_lag(series: Array, lag: float) -> Array:
        a = np.exp(-interval / lag)
        return np.asarray(lfilter([1.0 - a], [1.0, -a], series, axis=-1, zi=a * series[..., :1])[0])

    def delay(series: Array, dead_time: float) -> Array:
        return np.take(series, np.arange(series.shape[-1]) - round(dead_time / interval), axis=-1, mode="clip")

    before = positions[: first + 1]
    low = stem_places(before, candidates, np.maximum(before[0] - candidates, 0.0))[-1]
    high = stem_places(before, candidates, np.full(candidates.size, before[0]))[-1]
    starts = low + (high - low) * np.linspace(0.0, 1.0, (4 if np.max(high - low) > 1e-3 else 1))[:, np.newaxis]
    places = np.moveaxis(stem_places(positions[first:], candidates, starts), 0, -1)
    openings = places / (1.0 - candidates[:, np.newaxis])
    compared = slice(from_row - first, None)
    openings -= openings[..., compared][..., :1]
    y = temperature[first:] - temperature[from_row]
    filtered_inputs = [apply_lag(series[first:] - series[from_row], lag) for series in inputs for lag in INPUT_LAGS_S]

    def whiten(series: Array, ar: float, ma: float) -> Array:
        return np.asarray(lfilter(np.convolve([1.0, -1.0], [1.0, -ar]), [1.0, -ma], series, axis=-1)[..., compared])

    def evidence(answers: Array, ar: float, ma: float) -> tuple[Array, Array]:
        """Log-likelihood of each opening, with its gain integrated out, and the gain."""
        Y, W = whiten(y, ar, ma), whiten(answers, ar, ma)
        known = [np.ones(Y.size), *(whiten(series, ar, ma) for series in filtered_inputs)]
        Z, _ = np.linalg.qr(np.stack(known, axis=1))
        Y, W = Y - Z @ (Z.T @ Y), W - (W @ Z) @ Z.T
        n, total = Y.size - Z.shape[1], float(Y @ Y)
        square, product = np.sum(W * W, axis=-1), W @ Y
        variance = np.full(square.shape, 0.5 * total / n)
        for _ in range(2):
            gain = product / (square + variance / GAIN_DEVIATION**2)
            variance = np.maximum(total - product * gain, _TINY * total) / n
        doubt = np.log1p(square * GAIN_DEVIATION**2 / variance)
        return np.asarray(-0.5 * (n * np.log(variance) + doubt)), np.asarray(gain)

    pairs = [(slow, fast) for i, slow in enumerate(LAGS_S) for fast in LAGS_S[: i + 1]]
    dynamics = [(*pair, dead) for pair in pairs for dead in (*DEAD_TIMES_S, *CLOCK_SKEWS_S)]

    def simulate_answers(slow: float, fast: float, dead: float, every: int = 1) -> Array:
        return delay(apply_lag(apply_lag(openings[:, ::every], slow), fast), dead)

    prior = dict.fromkeys(DEAD_TIMES_S, 0.0) | dict.fromkeys(CLOCK_SKEWS_S, -3.0)  # log-likelihood
    # every eighth gap, with a typical colour, chooses the dynamics
    coarse = [float(evidence(simulate_answers(*p, 8), 0.5, 0.8)[0].max()) + prior[p[-1]] for p in dynamics]
    likely = [p for p, height in zip(dynamics, coarse, strict=True) if height > max(coarse) - _LIKELIHOOD_RANGE]
    total, best = np.full(candidates.size, -np.inf), (-np.inf, (0.0, 0.0, 0.0), 0, 0, 0.0)
    for dynamic in likely:
        answers = simulate_answers(*dynamic)
        for ar in AR:
            for ma in MA:
                likelihood, gains = evidence(answers, ar, ma)
                likelihood = likelihood + prior[dynamic[-1]]
                total = np.logaddexp(total, np.logaddexp.reduce(likelihood, axis=0))
                at = np.unravel_index(int(likelihood.argmax()), likelihood.shape)
                if likelihood[at] > best[0]:
                    best = (float(likelihood[at]), dynamic, int(at[0]), int(at[1]), float(gains[at]))
    _, (slow, fast, dead), start, size, gain = best
    model = gain * delay(apply_lag(apply_lag(openings[start, size], slow), fast), dead)[compared]
    known, _ = np.linalg.qr(np.stack([np.ones(model.size), *(x[compared] for x in filtered_inputs)], axis=1))
    squares = [float(np.sum((x - known @ (known.T @ x)) ** 2)) for x in (y[compared] - model, y[compared])]
    unexplained = squares[0] / max(squares[1], _TINY * model.size)
    return ThermalResponse(total, gain, slow + fast, dead, 1.0 - float(unexplained), places[start, size], model)

"""``read_test``: the backlash of a valve from the log of a valve test, and whether it is why the loop hunts.

The temperature answers the opening behind the gap through two lags and a dead time; what is left is drift, whose
changes are coloured, and noise: an ARIMA(1,1,1).  For each candidate gap, start of the stem, pair of lags, dead time
and colour of the noise, the gain has a wide normal prior and is integrated out; the likelihoods of all but the gap are
summed.  Nothing is fitted by iteration, so that a log has one answer.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_number
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, WrongTypeMessage, short_repr
from fastcoil.logs import read_checked_log
from fastcoil.logs.columns import ColumnSpec, check_reading_options, require_log
from fastcoil.measured.cause import UNKNOWN, Cause, PriorEvidence, judge_cause, revise_after_hold, stops_on_hold
from fastcoil.measured.diagnose import identify_and_measure, require_seconds, use_measured_temperature
from fastcoil.measured.diagnosis import ValveReading, probability_profile
from fastcoil.measured.fitted_loop import fit_loop_model
from fastcoil.measured.grid import Grid, forward_fill, motor_positions, resample_log
from fastcoil.measured.identify import CANDIDATES, USUAL_STROKE_TIME, Identification, judge_size
from fastcoil.measured.measures import running_mean
from fastcoil.measured.part import count_reversals, true_runs

DISTURBANCE_COLUMNS = ("m_a", "T_a_in", "T_w_in")
TEST_COLUMNS = ColumnSpec(
    required=("command", "T_sup"),
    optional=("test", "T_set", *DISTURBANCE_COLUMNS, "enabled"),
    measured=("T_sup", "T_set", *DISTURBANCE_COLUMNS),
)
LONGEST_INTERVAL, COMPARED_INTERVAL_S = 15.0, 10.0  # s between samples, in a log and in what is compared
BEFORE_TEST_S, AFTER_TEST_S = 600.0, 600.0
"""Seconds before the test that the lags of the coil reach back, and after it that tell of the gap as well."""
LEAST_TURN_SIZE = 0.005  # fraction of stroke, of the command in the test
MOST_MISSING = 0.05  # share of the temperatures
LIKELIHOOD_WEIGHT = 0.65  # share of the log-likelihood that counts: residuals are neither independent nor normal
LEAST_EXPLAINED = 0.5  # share of the variance of the temperature that the command has to explain
SMOOTHING_TIME_S = 60.0  # seconds whose mean takes the noise away
LEAST_OPERATION_BEFORE_S = 3600.0  # seconds of normal operation by which the cause is judged


@np.errstate(all="ignore")
def read_test(
    log: Any,
    stroke_time: float | None = None,
    *,
    between: tuple[float, float] | None = None,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    drop: bool = False,
    jumps: str = "refuse",
    max_gap: float | None = None,
    time_format: str | None = None,
) -> ValveReading:
    """Read the backlash of a valve from the log of a valve test, see ``fc.ValveTest``.

    Parameters
    ----------
    log
        CSV file, DataFrame or Dataset with a row every 15 s or faster, better 5 s.  Needed: ``command``, ``T_sup`` and
        ``elapsed_time`` or ``timestamp``, as for ``fc.diagnose``.  Optional: ``test``, 1 while the test runs, without
        which ``between`` is needed; ``T_set``, without which no cause is given; ``m_a``, ``T_a_in``, ``T_w_in``, with
        which the gap shows more clearly; ``enabled``.  With an hour before the test the cause of hunting is judged.
    stroke_time
        Seconds of the motor from closed to open, 0 if it is as good as immediate; 90 if left out.
    between
        Start and end of the test, s from the start of the log, if the log has no column ``test``.  Of several tests in
        that column the last is read.
    units, columns, drop, jumps, max_gap, time_format
        How the log is read: see ``fastcoil.logs.ReadingOptions``.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments.
    """
    with argument_checks() as check:
        source = check(require_log, "log", log)
        stroke_time = check.unless_none(require_seconds, "stroke_time", stroke_time, 0.0)
        between = check.unless_none(_require_between, "between", between)
        reading = check_reading_options(check, columns=columns, units=units, drop=drop, jumps=jumps,
                              max_gap=max_gap, time_format=time_format, has_command=True)  # fmt: skip
    data = read_checked_log(
        use_measured_temperature(source) if "T_sup" not in (columns or {}) else source, TEST_COLUMNS, reading
    )
    grid, notes = resample_log(data)
    if grid.interval > LONGEST_INTERVAL:
        raise InputError(f"{data.name}: a sample every {grid.interval:.4g} s: log the test every 5 s, 15 s at most")
    grid = grid.part(
        slice(None, None, max(1, round(COMPARED_INTERVAL_S / grid.interval)))
    )  # which shows the gap as well
    notes = [*data.notes, *notes]
    if stroke_time is None:
        stroke_time = USUAL_STROKE_TIME
        notes.append(f"the motor is assumed to take {stroke_time:g} s per stroke: give stroke_time if you know it")
    first, last = _find_test_rows(data.name, grid, between, notes)
    window = slice(max(first - round(BEFORE_TEST_S / grid.interval), 0), last + round(AFTER_TEST_S / grid.interval))
    command = forward_fill(grid.values["command"][: window.stop])
    positions = motor_positions(command, grid.interval, stroke_time)[:-1]
    identification, test_response = _identify_gap(grid, positions, first, last, window)
    if test_response.dead_time in CLOCK_SKEWS_S:
        order = "after" if test_response.dead_time < 0.0 else "before"
        notes.append(
            f"the command seems to be logged {abs(test_response.dead_time):g} s {order} the temperature, and the reading "
            "corrects for this: log both with one clock"
        )
    swing, held_for = _measure_hold(grid, command, first, last)
    cause = _judge_cause_before(grid, stroke_time, first, last, identification, (swing, held_for))
    return ValveReading(
        source=data.name, backlash=identification.backlash, interval=(identification.low, identification.high), identified=identification.identified,
        reason=identification.reason, gain=test_response.gain, lag=test_response.lag, dead_time=test_response.dead_time,
        held_swing=swing, held_for=held_for,
        cause=cause.name, because=cause.because, explained=test_response.explained,
        minutes=(last - first) * grid.interval / 60.0,
        profile=probability_profile(identification),
        signals=_signals(grid, command, test_response, first, last, window), notes=notes,
    )  # fmt: skip


def _require_between(name: str, value: Any) -> tuple[float, float]:
    cure = "give start and end in seconds from the start of the log, such as (5400, 6600)"
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise InputError(WrongTypeMessage(f"{name} = {short_repr(value)}: {cure}"))
    start, end = (require_number(name, bound, cure, least=0.0, most=1e9) for bound in value)
    if end <= start:
        raise InputError(f"{name} = {short_repr(value)}: the end is not after the start, {cure}")
    return start, end


def _find_test_rows(name: str, grid: Grid, between: tuple[float, float] | None, notes: list[str]) -> tuple[int, int]:
    """First row of the test, and the first after it."""
    if between is not None:
        if between[1] > grid.time[-1] + grid.interval:
            ends = f"between ends at {between[1]:g} s, the log at {grid.time[-1]:g} s"
            raise InputError(f"{ends}: give seconds from the start of the log")
        is_test = (grid.time >= between[0]) & (grid.time <= between[1])
    elif "test" in grid.values:
        is_test = np.nan_to_num(forward_fill(grid.values["test"])) > 0.0
    else:
        raise InputError(f"{name}: no column test: say when the test ran (between, --between START END)")
    tests = true_runs(is_test)
    if not len(tests):
        raise InputError(
            f"{name}: the log contains no test: the column test is 0 throughout, or between lies outside the log"
        )
    if len(tests) > 1:
        notes.append(f"the log has {len(tests)} tests: the last is read, for another give between, --between")
    first, last = int(tests[-1][0]), int(tests[-1][1])
    if np.unique(forward_fill(grid.values["T_sup"])[first : last + round(AFTER_TEST_S / grid.interval)]).size < 2:
        raise InputError(f"{name}: T_sup does not move in the test: check its sensor and how it is logged")
    return first, last


def _identify_gap(
    grid: Grid, positions: Array, first: int, last: int, window: slice
) -> "tuple[Identification, TestResponse]":
    T = grid.values["T_sup"][: window.stop]
    logged_inputs = [grid.values[name][: window.stop] for name in DISTURBANCE_COLUMNS if name in grid.values]
    inputs = [forward_fill(series) for series in logged_inputs if np.isfinite(series).any()]
    missing = float(np.mean(~np.isfinite(T[window])))
    doubt = ""
    if missing > MOST_MISSING:
        doubt = f"{100 * missing:.0f} % of the temperatures are missing: test again, and log all"
    elif not count_reversals(positions[first:last], LEAST_TURN_SIZE):
        doubt = (
            "the command does not reverse during the test, and a gap shows only at reversals: test again, for longer"
        )
    test_response = fit_response(forward_fill(T), positions, window.start, first, grid.interval, inputs, CANDIDATES)
    if not doubt and abs(test_response.dead_time) >= max(CLOCK_SKEWS_S):
        doubt = "command and temperature are logged minutes apart: log both with one clock, and test again"
    elif not doubt and test_response.explained < LEAST_EXPLAINED:
        doubt = (
            f"the command explains only {100 * max(test_response.explained, 0.0):.0f} % of the temperature changes: something "
            "else moves the temperature; test again when water and air are steady"
        )
    weighted = LIKELIHOOD_WEIGHT * test_response.likelihood
    cure = "test again, for 30 minutes or more, or log m_a, T_a_in and T_w_in too"
    return judge_size(np.exp(weighted - np.logaddexp.reduce(weighted)), True, doubt, cure), test_response


def _measure_hold(grid: Grid, command: Array, first: int, last: int) -> tuple[float, float]:
    """Highest less lowest temperature, K, in the second half of the time before the first move, and that half, s."""
    moves = np.flatnonzero(command[first + 1 : last] != command[first + 1])
    end = first + 1 + (int(moves[0]) if moves.size else last - first - 1)
    hold = grid.values["T_sup"][(first + end) // 2 : end]
    seconds, is_known = hold.size * grid.interval, np.isfinite(hold)
    smooth = running_mean(hold, is_known, max(1, min(round(SMOOTHING_TIME_S / grid.interval), hold.size // 3)))[
        is_known
    ]
    return (float(np.ptp(smooth)) if smooth.size > 1 else math.nan), seconds


def _judge_cause_before(
    grid: Grid, stroke_time: float, first: int, last: int, identification: Identification, hold: tuple[float, float]
) -> Cause:
    """Why the loop swung before the test: the plant is fitted to both, the controller to the time before."""
    values = {name: series[:last] for name, series in grid.values.items()}
    if "T_set" not in values or first * grid.interval < LEAST_OPERATION_BEFORE_S:
        return Cause(UNKNOWN, "log T_set, and an hour or more of normal operation before the test")
    log_identification, measures = identify_and_measure(grid.part(slice(first)), stroke_time)
    is_by_test = identification.identified
    agrees = log_identification.identified and identification.low <= log_identification.backlash <= identification.high
    identification = log_identification if agrees and not is_by_test else identification
    gap = identification.backlash if np.isfinite(identification.backlash) else 0.0
    fitted = fit_loop_model(
        values["command"], values["T_sup"], values["T_set"], grid.interval, gap, stroke_time,
        enabled=grid.on[:last], by_hand=np.arange(last) >= first,
    )  # fmt: skip
    evidence = PriorEvidence(identification.identified, is_by_test, stops_on_hold(measures, *hold))
    return revise_after_hold(judge_cause(measures, fitted, evidence), measures, *hold)


def _signals(
    grid: Grid, command: Array, test_response: "TestResponse", first: int, last: int, window: slice
) -> xr.Dataset:
    rows = np.arange(window.start, command.size)
    model = np.full(rows.size, np.nan)
    model[first - window.start :] = test_response.model + forward_fill(grid.values["T_sup"])[first]
    series = {"T_sup": grid.values["T_sup"][window], "command": command[window], "stem": test_response.stem, "model": model,
              "test": ((rows >= first) & (rows < last)).astype(float)}  # fmt: skip
    units = {"T_sup": "degC", "model": "degC"}
    return xr.Dataset(
        {name: ("elapsed_time", values, {"units": units.get(name, "1")}) for name, values in series.items()},
        {"elapsed_time": ("elapsed_time", grid.time[window], {"units": "s"})},
    )


LAGS = (8.0, 15.0, 25.0, 40.0, 65.0, 100.0, 150.0)
"""Lags that are tried, in pairs, s: sensor, metal, water and air of a coil."""
DEAD_TIMES = (0.0, 10.0, 20.0)  # s
CLOCK_SKEWS_S = (-150.0, -120.0, -90.0, -60.0, -30.0, 40.0, 60.0, 90.0, 120.0, 150.0)
"""Dead times of a log whose command and temperature have clocks of their own, s; negative: the command is late."""
_SKEW_PENALTY = 3.0  # logarithm of how much less likely than clocks that agree
AR, MA = (0.0, 0.5, 0.8, 0.95), (0.0, 0.4, 0.7, 0.85, 0.95)
"""Of the changes of the drift: memory from sample to sample, and the share that the noise of the sensor takes back."""
_TYPICAL_AR_MA = (0.5, 0.8)  # of these two, with which lags and dead times are chosen
GAIN_DEVIATION = 40.0  # K per stroke, standard deviation of the prior
N_STARTS = 4  # places of the stem in its gap that are tried at first, where what came before leaves it open
_LIKELIHOOD_RANGE = 15.0  # logarithm of likelihood below the best from which lags and dead times are left out
_COARSE_STRIDE = 8  # every so many candidates choose them
INPUT_LAGS = (15.0, 60.0, 200.0)  # s, of each known disturbance
_SAME_START, _TINY = 1e-3, 1e-9
"""Fraction of stroke within which all starts of the stem are one; share of a variance that is none."""


class TestResponse(NamedTuple):
    """How the temperature answers: log-likelihood of each candidate, and the most probable model."""

    likelihood: Array
    gain: float  # K per stroke
    lag: float  # sum of both, s
    dead_time: float  # s
    explained: float  # share of the variance of the temperature
    stem: Array  # its place behind the most probable gap, fraction of stroke, from the first row that is modelled on
    model: Array  # temperature of the model without drift, K from its start, at the samples that are compared


def stem_places(positions: Array, candidates: Array, starts: Array) -> Array:
    """Place of the stem behind each candidate gap, Eq (1), from each start: (n, …) like ``starts``, (…, candidates)."""
    q, places = starts, np.empty((positions.size, *starts.shape))
    for k, position in enumerate(positions.tolist()):
        q = np.minimum(np.maximum(q, position - candidates), position)
        places[k] = q
    return places


def fit_response(
    temperature: Array, positions: Array, first: int, from_row: int, interval: float, inputs: Sequence[Array],
    candidates: Array,
) -> TestResponse:  # fmt: skip
    """Compare gaps: rows from ``first`` are modelled, from ``from_row`` compared; those before place the stem."""
    from scipy.signal import lfilter

    def apply_lag(series: Array, lag: float) -> Array:
        a = np.exp(-interval / lag)
        return np.asarray(lfilter([1.0 - a], [1.0, -a], series, axis=-1, zi=a * series[..., :1])[0])

    def delay(series: Array, dead_time: float) -> Array:
        rows = np.arange(series.shape[-1]) - round(dead_time / interval)
        return np.take(series, rows, axis=-1, mode="clip")

    before = positions[: first + 1]
    low = stem_places(before, candidates, np.maximum(before[0] - candidates, 0.0))[-1]
    high = stem_places(before, candidates, np.full(candidates.size, before[0]))[-1]
    n_starts = N_STARTS if np.max(high - low) > _SAME_START else 1
    starts = low + (high - low) * np.linspace(0.0, 1.0, n_starts)[:, np.newaxis]
    places = np.moveaxis(stem_places(positions[first:], candidates, starts), 0, -1)
    openings = places / (1.0 - candidates[:, np.newaxis])
    compared = slice(from_row - first, None)
    openings -= openings[..., compared][..., :1]
    y = temperature[first:] - temperature[from_row]
    filtered_inputs = [apply_lag(series[first:] - series[from_row], lag) for series in inputs for lag in INPUT_LAGS]

    def whiten(series: Array, ar: float, ma: float) -> Array:
        return np.asarray(lfilter(np.convolve([1.0, -1.0], [1.0, -ar]), [1.0, -ma], series, axis=-1)[..., compared])

    def evidence(answers: Array, ar: float, ma: float) -> tuple[Array, Array]:
        """Log-likelihood of each opening, with its gain integrated out, and the gain."""
        Y, W = whiten(y, ar, ma), whiten(answers, ar, ma)
        Z, _ = np.linalg.qr(
            np.stack([np.ones(Y.size), *(whiten(series, ar, ma) for series in filtered_inputs)], axis=1)
        )
        Y, W = Y - Z @ (Z.T @ Y), W - (W @ Z) @ Z.T
        n, total = Y.size - Z.shape[1], float(Y @ Y)
        square, product = np.sum(W * W, axis=-1), W @ Y
        variance = np.full(square.shape, 0.5 * total / n)
        for _ in range(2):
            gain = product / (square + variance / GAIN_DEVIATION**2)
            variance = np.maximum(total - product * gain, _TINY * total) / n
        doubt = np.log1p(square * GAIN_DEVIATION**2 / variance)
        return np.asarray(-0.5 * (n * np.log(variance) + doubt)), np.asarray(gain)

    dynamics = [
        (slow, fast, dead)
        for i, slow in enumerate(LAGS)
        for fast in LAGS[: i + 1]
        for dead in (*DEAD_TIMES, *CLOCK_SKEWS_S)
    ]

    def simulate_answers(slow: float, fast: float, dead: float, every: int = 1) -> Array:
        return delay(apply_lag(apply_lag(openings[:, ::every], slow), fast), dead)

    prior = {dead: 0.0 for dead in DEAD_TIMES} | {dead: -_SKEW_PENALTY for dead in CLOCK_SKEWS_S}
    coarse_likelihoods = [
        float(evidence(simulate_answers(*point, _COARSE_STRIDE), *_TYPICAL_AR_MA)[0].max()) + prior[point[-1]]
        for point in dynamics
    ]
    likely_dynamics = [
        point
        for point, likelihood in zip(dynamics, coarse_likelihoods, strict=True)
        if likelihood > max(coarse_likelihoods) - _LIKELIHOOD_RANGE
    ]
    total_likelihood, best = np.full(candidates.size, -np.inf), (-np.inf, (0.0, 0.0, 0.0), 0, 0, 0.0)
    for dynamic in likely_dynamics:
        answers = simulate_answers(*dynamic)
        for ar in AR:
            for ma in MA:
                likelihood, gains = evidence(answers, ar, ma)
                likelihood = likelihood + prior[dynamic[-1]]
                total_likelihood = np.logaddexp(total_likelihood, np.logaddexp.reduce(likelihood, axis=0))
                at = np.unravel_index(int(likelihood.argmax()), likelihood.shape)
                if likelihood[at] > best[0]:
                    best = (float(likelihood[at]), dynamic, int(at[0]), int(at[1]), float(gains[at]))
    _, (slow, fast, dead), start, size, gain = best
    model = gain * delay(apply_lag(apply_lag(openings[start, size], slow), fast), dead)[compared]
    compared_temperature = y[compared]
    unexplained_share = np.var(compared_temperature - model) / max(float(np.var(compared_temperature)), _TINY)
    return TestResponse(
        total_likelihood, gain, slow + fast, dead, 1.0 - float(unexplained_share), places[start, size], model
    )

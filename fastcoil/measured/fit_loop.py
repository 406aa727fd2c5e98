"""``fit_loop``: the backlash of a valve from recorded commands and supply temperatures, with a model of its coil.

The grey-box problem: the emulator behind the logged command with each candidate backlash, and which fits.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import argument_checks, require_instance, require_number
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.log import CheckedLog, as_log
from fastcoil.logs.pieces import require_whole_seconds
from fastcoil.logs.series import HUMIDITY_COLUMNS, format_count
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.measured.fit import Fit, backlash_series, build_fit, rmse_profile
from fastcoil.measured.fit_coil import drop_idle_samples, piece_notes, require_temperatures, resample_to_seconds
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE
from fastcoil.measured.part import LogSource, LogSplit, check_split, split_segments
from fastcoil.measured.valve_problem import count_piece_reversals, why_unidentified
from fastcoil.model.metric_table import WARM_UP_S

_LOOP_COLUMNS = ColumnSpec(("command", "m_a", "T_w_in", "T_a_in", HUMIDITY_COLUMNS, "T_sup"), ("enabled",), ("T_sup",))
LARGEST_CANDIDATE = 0.25  # backlash that is tried, fraction of stroke, as the two steps
_COARSE_STEP = 0.005  # of the candidates, over the whole range
_FINE_STEP = 0.0005  # of the candidates near the best
_CHANGE_SPAN_S = 120.0  # time between the temperatures whose difference is compared
_LEAST_MOVING_SHARE = 0.25  # of the samples, at which the command changes: it then moves between them as well
_FEWEST_SAMPLES = 60  # temperatures to compare
_OPEN_LOOP_SETTINGS: dict[str, Any] = {
    "noise_std": 0.0, "sensor_resolution": 0.0, "backlash_estimate": 0.0, "learning_step": 0.0, "estimator": "none",
    "law": "pi", "controlled": "T_sup",
}  # fmt: skip
"""What a loop may have and an emulator in open loop does not use."""


@np.errstate(all="ignore")
def fit_loop(
    log: LogSource,
    loop: Loop,
    *,
    warm_up: float = WARM_UP_S,
    split: float | None = None,
    validation: LogSource | None = None,
) -> Fit:
    """Fit the backlash of a valve to a log of commands and supply temperatures; no flow meter is needed.

    Parameters
    ----------
    log : path, DataFrame, Dataset or Log
        Needed: ``command``, ``T_sup``, ``m_a``, ``T_w_in``, ``T_a_in``, one of ``W_a_in``, ``RH_a_in``, ``T_dp_in``,
        and ``elapsed_time`` or ``timestamp``; optional: ``enabled``.  The command holds until the next sample.
        `read_log` has the options of reading.
    loop : Loop
        Valve curve, coil, motor and sensor: fitted (``fc.Loop(**fit.parameters)``) or of a preset.  They may be
        approximate: the modelled temperature is corrected by a straight line in each unbroken piece of the log.  Its
        ``backlash`` and its controller are not used.
    warm_up : float, default 1800
        Time left out at each start of the model, s.
    split, validation
        As in `fit_valve`.

    Returns
    -------
    Fit
        ``backlash`` (fraction of stroke), ``interval``, ``identified`` and, if not, the ``reason``; ``backlash`` is not
        among its ``parameters`` if the log does not identify it.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments, and for a loop that is unstable.

    Notes
    -----
    The emulator of Cai and Braun (2016) in open loop behind the logged command, once for each candidate backlash.

    Examples
    --------
    >>> day, loop = fc.paper_day(hours=6), fc.Loop.preset("lbnl").assign(backlash=0.08)
    >>> ds = fc.simulate(loop, day, traces=["command", "T_measured"]).rename(T_measured="T_sup")
    >>> log = ds[["command", "T_sup"]].merge(day.to_dataset()[["m_a", "T_a_in", "W_a_in", "T_w_in"]])
    >>> fit = fc.fit_loop(log.isel(elapsed_time=slice(None, None, 60)), loop)
    >>> f"{fit.backlash:.3f}", fit.identified
    ('0.081', True)
    """
    start_time = time.perf_counter()
    with argument_checks() as check:
        log = check(as_log, "log", log)
        check(require_instance, "loop", loop, Loop, "give a fastcoil.Loop")
        warm_up = check(require_number, "warm_up", warm_up, "give a number of seconds, 0 or more", least=0.0)
        part = check_split(check, log, split, validation)
        for name, values in loop.swept.items() if isinstance(loop, Loop) else ():
            if name != "backlash":
                sentence = f"loop has {name} = {short_repr(values.values.tolist())}: give one value"
                check.problems.append(Problem(sentence, name, "value"))
        if isinstance(loop, Loop) and (loop["slip_jump"] or 0.0) != 0.0:
            sentence = "loop has a slip_jump: give it none, a backlash without one is fitted"
            check.problems.append(Problem(sentence, "slip_jump", "unsupported"))
    return _assemble_fit(LoopProblem(part.read(log, _LOOP_COLUMNS, drop_idle_samples), loop, warm_up, part), start_time)


def _assemble_fit(problem: LoopProblem, start_time: float) -> Fit:
    """Assemble the fit of a loop: the best candidate, and its interval from resampled blocks of the log."""
    grid, temperatures = problem.simulate_candidates()
    sums = problem.sum_blocks(temperatures)
    correction = fit_correction(sums)
    k = int(correction.rss.argmin())
    x = float(grid[k])
    estimates = grid[[int(fit_correction(resampled).rss.argmin()) for resampled in _resample_blocks(sums)]]
    low, high = np.quantile(estimates, (0.5 - 0.95 / 2, 0.5 + 0.95 / 2))
    # what the model gets wrong widens both sides by half a per cent of the stroke
    interval = max(float(low) - 0.005, 0.0), min(float(high) + 0.005, LARGEST_CANDIDATE)
    explained_share = 1.0 - float(correction.rss[k]) / max(correction.total, 1e-12)
    why = _why_unidentified(problem, x, *interval, sums.n.size, explained_share)
    with_gap, without_gap = (problem.correct_temperature(temperatures, correction, candidate) for candidate in (k, 0))
    series, errors = backlash_series("T_sup", "degC", problem.T_sup, with_gap, without_gap, problem.compared)
    series["command"] = problem.data.values["command"], "1"
    return build_fit(
        problem.data, start_time, problem.compared, problem.fitting, errors, series, ["backlash"],
        np.full((1, 1), float(estimates.std()) ** 2), {"backlash": why} if why else {}, [interval], kind="loop",
        parameters={} if why else {"backlash": x},
        profile=rmse_profile(grid, np.sqrt(np.maximum(correction.rss, 0.0) / sums.n.sum()), "K", x, interval),
        notes=problem.notes, n_used=int(problem.used.sum()), n_effective=float(sums.n.size),
    )  # fmt: skip


def _why_unidentified(problem: LoopProblem, x: float, low: float, high: float, n_blocks: int, explained: float) -> str:
    """Return why the log does not resolve the backlash; empty if it does."""
    why = ""
    if n_blocks < 6:
        why = f"not identified: {n_blocks} half hours are left to compare: give a log of five hours or more"
    elif problem.data.step > 90.0 and problem.moving_share > _LEAST_MOVING_SHARE:
        coarse = f"samples are {problem.data.step:.4g} s apart and the command moves between them; reversals are missed"
        why = f"not identified: {coarse}, so the best fit, {x:.3g}, is too small: log every 60 s or faster"
    elif not explained > 0.8:  # the model is one of another coil
        share = f"{100 * max(explained, 0.0):.0f} % of the changes of T_sup"
        why = f"not identified: the model explains {share}: fit the coil first, or check units and columns"
    is_wide = not why and (high >= LARGEST_CANDIDATE or max(high - x, x - low) > max(SIZE_TOLERANCE * x, GOOD_BACKLASH))
    return why_unidentified(problem.n_reversals, (low, high), is_wide=is_wide) or why


class BlockSums(NamedTuple):
    """Sums over the compared changes of each block: measured y, modelled m of each candidate."""

    piece: Index  # of each block, (blocks,)
    n: Array  # (blocks,), as y and yy
    y: Array
    yy: Array
    m: Array  # (blocks, candidates), as mm and my
    mm: Array
    my: Array


class Correction(NamedTuple):
    """Slope of measured over modelled changes, (pieces, candidates); residual and total sums of squares, K²."""

    slope: Array
    rss: Array
    total: float


class _LoopPiece(NamedTuple):
    """An unbroken piece of the log with samples to compare, as inputs of a simulation."""

    samples: Index
    day: Boundary
    commands: dict[str, Array]  # by how they run between samples
    seconds: Index  # from the start of the day to each sample


class LoopProblem:
    """The fit of a loop: its log, a loop to simulate behind the logged command, and the samples that are compared."""

    def __init__(self, data: CheckedLog, loop: Loop, warm_up: float, part: LogSplit) -> None:
        require_whole_seconds(data.name, data.step)
        self.data, self.notes = data, [*data.notes, *piece_notes(data, loop, warm_up)]
        self.loop = loop.assign(**_OPEN_LOOP_SETTINGS)
        self.T_sup, command = data.values["T_sup"], data.values["command"]
        self.fitting = part.fitting_mask(data)
        self.compared = (data.seconds_since_batch_start() >= warm_up) & np.isfinite(self.T_sup)
        self.used = self.compared & self.fitting
        require_temperatures(data, self.used, _FEWEST_SAMPLES, warm_up, self.notes)
        self.n_reversals = count_piece_reversals(command[self.used], data.batch[self.used])
        self.moving_share = float(np.mean(np.abs(np.diff(command)) > 2e-3))
        self.pieces = self._make_pieces()

    def _make_pieces(self) -> list[_LoopPiece]:
        """Resample the unbroken pieces of the log at 1 s, as inputs of a simulation."""
        data, pieces = self.data, []
        values = {name: data.values[name] for name in ("m_a", "T_a_in", "T_w_in")}
        values |= dict.fromkeys(("held", "straight"), data.values["command"])
        values["W_a_in"] = data.humidity_ratio(self.loop["pressure"])
        for samples in split_segments(data.batch):
            if not self.compared[samples].any():
                continue
            piece_values = {name: series[samples] for name, series in values.items()}
            series, seconds = resample_to_seconds(data.time[samples], piece_values, ("held",))
            commands = {course: series.pop(course) for course in ("held", "straight")}
            pieces.append(_LoopPiece(samples, Boundary(**series, T_set=0.0, enabled=1.0), commands, seconds))
        return pieces

    def simulate_temperature(self, backlash: Array, course: str) -> Array:
        """Simulate T_sup at the samples, (n, candidates), °C; course: the command is ``held`` or runs ``straight``."""
        temperatures = np.full((self.data.time.size, backlash.size), np.nan)
        sweep = self.loop.assign(backlash=("candidate", backlash))
        for piece in self.pieces:
            interval = int(np.gcd.reduce(piece.seconds))
            ds = simulate(
                sweep, piece.day, command=piece.commands[course], traces=["T_measured"], trace_interval=interval,
                warm_up=0, progress=False,
            )  # fmt: skip
            T = ds["T_measured"].transpose("elapsed_time", "candidate")
            temperatures[piece.samples] = T.values[piece.seconds // interval]
        return temperatures

    def sum_blocks(self, temperatures: Array) -> BlockSums:
        """Sum changes of T_sup, measured and simulated, and their products over each block of half an hour.

        Changes over ``_CHANGE_SPAN_S`` are compared, not temperatures: the error of an approximate coil changes slowly,
        and a command that follows the temperature would be blamed for it.
        """
        is_used, batch, width = self.used, self.data.batch, max(1, round(_CHANGE_SPAN_S / self.data.step))
        piece_of_sample = np.concatenate([np.full(piece.samples.size, k) for k, piece in enumerate(self.pieces)])
        samples = np.concatenate([piece.samples for piece in self.pieces])
        earlier = np.maximum(samples - width, 0)
        is_compared = (samples >= width) & is_used[samples] & is_used[earlier] & (batch[samples] == batch[earlier])
        samples, piece_of_sample = samples[is_compared], piece_of_sample[is_compared]
        if samples.size < _FEWEST_SAMPLES:
            available = f"{format_count(samples.size, 'change')} of T_sup over {_CHANGE_SPAN_S:g} s"
            cure = f"give at least {_FEWEST_SAMPLES}, with fewer gaps"
            raise InputError(f"{self.data.name}: {available} to compare: {cure}", "log", "data")
        block = (self.data.seconds_since_batch_start()[samples] // 1800.0).astype(np.int64)
        block_starts = np.flatnonzero(np.diff(block, prepend=-1) | np.diff(piece_of_sample, prepend=-1))
        _, piece = np.unique(piece_of_sample[block_starts], return_inverse=True)
        y, m = (T[samples] - T[samples - width] for T in (self.T_sup, temperatures))
        columns = (np.ones(y.size), y, y * y, m, m * m, y[:, np.newaxis] * m)
        return BlockSums(piece, *(np.add.reduceat(column, block_starts, axis=0) for column in columns))

    def simulate_candidates(self) -> tuple[Array, Array]:
        """Return candidate gaps, finer near the best, and T_sup of each, with the command held or straight, as fits."""
        coarse = np.arange(0.0, LARGEST_CANDIDATE + _COARSE_STEP / 2, _COARSE_STEP)
        courses = ("held", "straight") if self.moving_share > _LEAST_MOVING_SHARE else ("held",)
        sums = {course: self.sum_blocks(self.simulate_temperature(coarse, course)) for course in courses}
        rss = {course: fit_correction(sums[course]).rss for course in courses}
        course = min(rss, key=lambda course: float(rss[course].min()))
        best = float(coarse[rss[course].argmin()])
        fine = np.arange(max(best - 0.01, 0.0), min(best + 0.01, LARGEST_CANDIDATE) + _FINE_STEP / 2, _FINE_STEP)
        grid = np.unique(np.round(np.concatenate([coarse, fine]), 6))
        return grid, self.simulate_temperature(grid, course)

    def correct_temperature(self, temperatures: Array, correction: Correction, k: int) -> Array:
        """Return the corrected T_sup of candidate k at every sample; a piece held back gets the mean correction."""
        batch, is_used, n_batches = self.data.batch, self.used, self.data.n_batches
        slope = np.full(n_batches, correction.slope[:, k].mean())
        fitted_batches = np.unique(batch[is_used])
        if fitted_batches.size == correction.slope.shape[0]:
            slope[fitted_batches] = correction.slope[:, k]
        scaled = slope[batch] * temperatures[:, k]
        n_samples = np.bincount(batch[is_used], minlength=n_batches)
        offset = np.bincount(batch[is_used], (self.T_sup - scaled)[is_used], n_batches) / np.maximum(n_samples, 1)
        offset[n_samples == 0] = offset[n_samples > 0].mean()
        return np.asarray(scaled + offset[batch])


def fit_correction(sums: BlockSums) -> Correction:
    """Fit measured to simulated changes by a slope and a drift in each piece, for each candidate, by least squares.

    The slope removes most of what an approximate coil does to the temperature, and nothing of what a gap does at its
    reversals.
    """
    is_of_piece = np.zeros((int(sums.piece[-1]) + 1, sums.n.size))
    is_of_piece[sums.piece, np.arange(sums.n.size)] = 1.0
    n, y, yy, m, mm, my = (is_of_piece @ values for values in sums[1:])
    n = np.maximum(n, 1.0)  # a piece that no resampled block is of
    n, y, yy = n[:, np.newaxis], y[:, np.newaxis], yy[:, np.newaxis]
    var_y, var_m, cov = yy - y * y / n, mm - m * m / n, my - m * y / n
    slope = np.maximum(cov / np.maximum(var_m, 1e-12), 0.02)
    return Correction(slope, np.sum(var_y - 2.0 * slope * cov + slope * slope * var_m, axis=0), float(var_y.sum()))


def _resample_blocks(sums: BlockSums) -> Iterator[BlockSums]:
    """Yield 400 bootstrap samples of the blocks, drawn with replacement (Künsch 1989)."""
    rng = np.random.default_rng(0)
    for _ in range(400):
        draws = np.bincount(rng.integers(0, sums.n.size, sums.n.size), minlength=sums.n.size).astype(float)
        yield BlockSums(sums.piece, *(draws * v if v.ndim == 1 else draws[:, np.newaxis] * v for v in sums[1:]))

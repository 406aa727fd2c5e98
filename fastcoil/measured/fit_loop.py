"""``fit_loop``: the backlash of a valve from recorded commands and supply temperatures, with a model of its coil.

The grey-box problem: the emulator behind the logged command with each candidate backlash, and which fits.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import argument_checks, require_instance, require_number
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, short_repr
from fastcoil.logs import CheckedLog
from fastcoil.logs.columns import ColumnSpec, check_reading_options, require_log
from fastcoil.logs.pieces import require_whole_seconds
from fastcoil.logs.series import HUMIDITY_COLUMNS, format_count
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.measured.fit import Fit, build_fit, rmse_profile
from fastcoil.measured.fit_coil import drop_idle_samples, piece_notes, require_temperatures, resample_to_seconds
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE
from fastcoil.measured.part import LogSplit, check_split, split_segments
from fastcoil.measured.valve_problem import count_piece_reversals, why_unidentified
from fastcoil.model.metric_table import WARM_UP_S

FEWEST_BLOCKS = 6
LEAST_EXPLAINED = 0.8  # share of the changes of T_sup below which the model is one of another coil
_LOOP_COLUMNS = ColumnSpec(
    required=("command", "m_a", "T_w_in", "T_a_in", HUMIDITY_COLUMNS, "T_sup"),
    optional=("enabled",),
    measured=("T_sup",),
)

LARGEST_CANDIDATE = 0.25  # candidate, fraction of stroke
_COARSE_STEP, _FINE_STEP, _FINE_RANGE = 0.005, 0.0005, 0.01
"""Steps of the candidates, over the whole range and this near to the best, fractions of stroke."""
_BLOCK_LENGTH_S = 1800.0  # seconds whose residuals are taken to belong together
_N_RESAMPLES = 400
_FEWEST_SAMPLES = 60
_CHANGE_SPAN_S = 120.0  # seconds between the temperatures whose difference is compared
_LEAST_SLOPE = 0.02  # of measured over modelled changes
_CONFIDENCE, _INTERVAL_ALLOWANCE = 0.95, 0.005
"""Of the interval, and by how much it is widened on both sides for what the model gets wrong, fraction of stroke."""
_COARSE_INTERVAL_S = 90.0  # above so many seconds between samples, turns of a command that moves are missed
_LARGEST_HELD_CHANGE, _LEAST_MOVING_SHARE = 2e-3, 0.25
"""A command that changes by more than the first in more than this share of the samples also moves between them."""
_OPEN_LOOP_SETTINGS: dict[str, Any] = {"noise_std": 0.0, "sensor_resolution": 0.0, "backlash_estimate": 0.0, "learning_step": 0.0,
            "estimator": "none", "law": "pi"}  # fmt: skip
"""What a loop may have and an emulator in open loop does not use."""


@np.errstate(all="ignore")
def fit_loop(
    log: Any,
    loop: Loop,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, float] | None = None,
    warm_up: float = WARM_UP_S,
    split: float | None = None,
    validation: Any = None,
    drop: bool = False,
    jumps: str = "refuse",
    max_gap: float | None = None,
    time_format: str | None = None,
) -> Fit:
    """Fit the backlash of a valve to a log of commands and supply temperatures; no flow meter is needed.

    Parameters
    ----------
    log
        CSV file, DataFrame or Dataset.  Needed: ``command``, ``T_sup``, ``m_a``, ``T_w_in``, ``T_a_in``, one of
        ``W_a_in``, ``RH_a_in``, ``T_dp_in``, and ``elapsed_time`` or ``timestamp``; optional: ``enabled``.  The
        command holds until the next sample.
    loop
        Valve curve, coil, motor and sensor: fitted (``fc.Loop(**fit.parameters)``) or of a preset.  They need not be
        quite right: the modelled temperature is corrected by a straight line in each unbroken piece of the log.  Its
        ``backlash`` and its controller play no part.
    warm_up
        Seconds left out at each start of the model [s].
    split, validation
        As in ``fc.fit_valve``.
    units, columns, constants, drop, jumps, max_gap, time_format
        How the log is read: see ``fastcoil.logs.ReadingOptions``.

    Returns
    -------
    Fit
        ``backlash``, ``interval``, ``identified`` and, if not, the ``reason``; ``backlash`` is not among its
        ``parameters`` if the log does not identify it.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments, and for a loop that is unstable.

    Notes
    -----
    The emulator of Cai and Braun (2016) in open loop behind the logged command, once for each candidate backlash.
    """
    start_time = time.perf_counter()
    with argument_checks() as check:
        log = check(require_log, "log", log)
        check(require_instance, "loop", loop, Loop, "give a fastcoil.Loop")
        warm_up = check(require_number, "warm_up", warm_up, "give a number of seconds, 0 or more", least=0.0)
        reading = check_reading_options(check, columns=columns, units=units, constants=constants, drop=drop, jumps=jumps,
                              max_gap=max_gap, time_format=time_format, has_command=True)  # fmt: skip
        part = check_split(check, split, validation)
        for name, values in loop.swept.items() if isinstance(loop, Loop) else ():
            if name != "backlash":
                check.problems.append(f"loop has {name} = {short_repr(values.values.tolist())}: give one value")
        if isinstance(loop, Loop) and (loop["slip_jump"] or 0.0) != 0.0:
            check.problems.append("loop has a slip_jump: give it none, a backlash without one is fitted")

    problem = LoopProblem(part.read(log, _LOOP_COLUMNS, reading, drop_idle_samples), loop, warm_up, part)
    return _assemble_fit(problem, start_time)


def _assemble_fit(problem: LoopProblem, start_time: float) -> Fit:
    """The best candidate, how far it moves when blocks of the log are resampled, and what a user may ask beside it."""
    data, measured = problem.data, problem.T_sup
    grid, modelled = problem.candidates()
    sums = problem.sum_blocks(modelled)
    best = fit_correction(sums)
    k = int(best.rss.argmin())
    x = float(grid[k])
    draws = grid[[int(fit_correction(resampled).rss.argmin()) for resampled in _resample_blocks(sums)]]
    low, high = np.quantile(draws, (0.5 - _CONFIDENCE / 2, 0.5 + _CONFIDENCE / 2))
    interval = max(float(low) - _INTERVAL_ALLOWANCE, 0.0), min(float(high) + _INTERVAL_ALLOWANCE, LARGEST_CANDIDATE)
    explained = 1.0 - float(best.rss[k]) / max(best.total, 1e-12)
    why = _why_unidentified(problem, x, interval, sums.n.size, explained)
    with_backlash, without = (problem.correct_temperature(modelled, best, candidate) for candidate in (k, 0))
    compared_T_sup = np.where(problem.compared, measured, np.nan)
    series = {
        "T_sup": (measured, "degC"),
        "modelled": (with_backlash, "degC"),
        "modelled_without_backlash": (without, "degC"),
        "residual": (measured - with_backlash, "K"),
        "command": (data.values["command"], "1"),
    }
    parameters = {} if why else {"backlash": x}
    return build_fit(
        data, start_time, problem.compared, problem.fitting, {"": with_backlash - compared_T_sup, "_without_backlash": without - compared_T_sup},
        series, list(parameters), np.full((len(parameters), len(parameters)), float(draws.std()) ** 2),
        kind="loop", parameters=parameters, intervals=dict.fromkeys(parameters, interval), held={"backlash": why} if why else {},
        profile=rmse_profile(grid, np.sqrt(np.maximum(best.rss, 0.0) / sums.n.sum()), "K", x, interval),
        notes=problem.notes, n_used=int(problem.used.sum()), n_effective=float(sums.n.size),
    )  # fmt: skip


def _why_unidentified(
    problem: LoopProblem, x: float, interval: tuple[float, float], n_blocks: int, explained: float
) -> str:
    """Why the log does not resolve the backlash; empty if it does."""
    low, high = interval
    why = ""
    if n_blocks < FEWEST_BLOCKS:
        why = f"not identified: {n_blocks} half hours are left to compare: give a log of five hours or more"
    elif problem.data.step > _COARSE_INTERVAL_S and problem.moving_share > _LEAST_MOVING_SHARE:
        why = (
            f"not identified: samples are {problem.data.step:.4g} s apart and the command moves between them; "
            f"reversals are missed, so the best fit, {x:.3g}, is too small: log every 60 s or faster"
        )
    elif not explained > LEAST_EXPLAINED:
        why = (
            f"not identified: the model explains {100 * max(explained, 0.0):.0f} % of the changes of T_sup: fit the "
            "coil first, or check units and columns"
        )
    is_wide = not why and (high >= LARGEST_CANDIDATE or max(high - x, x - low) > max(SIZE_TOLERANCE * x, GOOD_BACKLASH))
    return why_unidentified(problem.n_reversals, interval, is_wide=is_wide) or why


class BlockSums(NamedTuple):
    """Sums over the compared changes in each block: measured y, modelled m for each candidate."""

    piece: Index  # of each block, (blocks,)
    n: Array  # (blocks,), as y and yy
    y: Array
    yy: Array
    m: Array  # (blocks, candidates), as mm and my
    mm: Array
    my: Array


class Correction(NamedTuple):
    """Measured over modelled change, (pieces, candidates); squares left, (candidates,), and of the changes, K²."""

    slope: Array
    rss: Array
    total: float


class _LoopPiece(NamedTuple):
    """An unbroken piece that has something to compare."""

    samples: Index
    day: Boundary
    commands: dict[str, Array]  # by how they run between samples
    at: Index  # second of each sample


class LoopProblem:
    """A log, the emulator that is run behind its command, and which samples are compared."""

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
        self.moving_share = float(np.mean(np.abs(np.diff(command)) > _LARGEST_HELD_CHANGE))
        self.pieces = self._pieces()

    def _pieces(self) -> list[_LoopPiece]:
        data, pieces = self.data, []
        values = {name: data.values[name] for name in ("m_a", "T_a_in", "T_w_in")}
        values |= dict.fromkeys(("held", "straight"), data.values["command"])
        values["W_a_in"] = data.humidity_ratio(self.loop["pressure"])
        for samples in split_segments(data.batch):
            if not self.compared[samples].any():
                continue
            piece_values = {name: series[samples] for name, series in values.items()}
            series, at = resample_to_seconds(data.time[samples], piece_values, ("held",))
            commands = {course: series.pop(course) for course in ("held", "straight")}
            pieces.append(_LoopPiece(samples, Boundary(**series, T_set=0.0, enabled=1.0), commands, at))
        return pieces

    def simulate_temperature(self, backlash: Array, course: str) -> Array:
        """T_sup at the samples, (n, candidates), °C, if the command is ``held`` or ``straight``; NaN where left out."""
        temperatures = np.full((self.data.time.size, backlash.size), np.nan)
        sweep = self.loop.assign(backlash=("candidate", backlash))
        for piece in self.pieces:
            every = int(np.gcd.reduce(piece.at))
            ds = simulate(
                sweep, piece.day, command=piece.commands[course], traces=["T_measured"], trace_interval=every,
                warm_up=0, progress=False,
            )  # fmt: skip
            temperatures[piece.samples] = (
                ds["T_measured"].transpose("elapsed_time", "candidate").values[piece.at // every]
            )
        return temperatures

    def sum_blocks(self, modelled: Array) -> BlockSums:
        """Sums over the fitted changes of each block.

        Changes over ``_CHANGE_SPAN_S`` s are compared, not temperatures: what a coil that is not quite the right one gets wrong
        changes slowly, and a command that follows the temperature would be blamed for it.
        """
        used, batch, width = self.used, self.data.batch, max(1, round(_CHANGE_SPAN_S / self.data.step))
        piece_of_sample = np.concatenate([np.full(piece.samples.size, k) for k, piece in enumerate(self.pieces)])
        at = np.concatenate([piece.samples for piece in self.pieces])
        earlier = np.maximum(at - width, 0)
        is_compared = (at >= width) & used[at] & used[earlier] & (batch[at] == batch[earlier])
        at, piece_of_sample = at[is_compared], piece_of_sample[is_compared]
        if at.size < _FEWEST_SAMPLES:
            available = f"{format_count(at.size, 'change')} of T_sup over {_CHANGE_SPAN_S:g} s"
            raise InputError(
                f"{self.data.name}: {available} to compare: give at least {_FEWEST_SAMPLES}, with fewer gaps"
            )
        block = (self.data.seconds_since_batch_start()[at] // _BLOCK_LENGTH_S).astype(np.int64)
        first = np.flatnonzero(np.diff(block, prepend=-1) | np.diff(piece_of_sample, prepend=-1))
        _, piece = np.unique(piece_of_sample[first], return_inverse=True)
        y, m = (series[at] - series[at - width] for series in (self.T_sup, modelled))
        columns = (np.ones(y.size), y, y * y, m, m * m, y[:, np.newaxis] * m)
        return BlockSums(piece, *(np.add.reduceat(column, first, axis=0) for column in columns))

    def candidates(self) -> tuple[Array, Array]:
        """A grid refined near the best, and ``modelled``; a moving command runs held or straight, as fits better."""
        coarse = np.arange(0.0, LARGEST_CANDIDATE + _COARSE_STEP / 2, _COARSE_STEP)
        courses = ("held", "straight") if self.moving_share > _LEAST_MOVING_SHARE else ("held",)
        rss_by_course = {
            best_course: fit_correction(self.sum_blocks(self.simulate_temperature(coarse, best_course))).rss
            for best_course in courses
        }
        best_course = min(rss_by_course, key=lambda course: float(rss_by_course[course].min()))
        best_backlash = float(coarse[rss_by_course[best_course].argmin()])
        fine = np.arange(
            max(best_backlash - _FINE_RANGE, 0.0),
            min(best_backlash + _FINE_RANGE, LARGEST_CANDIDATE) + _FINE_STEP / 2,
            _FINE_STEP,
        )
        grid = np.unique(np.round(np.concatenate([coarse, fine]), 6))
        return grid, self.simulate_temperature(grid, best_course)

    def correct_temperature(self, modelled: Array, correction: Correction, k: int) -> Array:
        """Corrected temperature of a candidate at every sample; a piece held back gets the mean correction."""
        batch, used, n = self.data.batch, self.used, self.data.n_batches
        slope = np.full(n, correction.slope[:, k].mean())
        fitted = np.unique(batch[used])
        if fitted.size == correction.slope.shape[0]:
            slope[fitted] = correction.slope[:, k]
        scaled = slope[batch] * modelled[:, k]
        times = np.bincount(batch[used], minlength=n)
        offset = np.bincount(batch[used], (self.T_sup - scaled)[used], n) / np.maximum(times, 1)
        offset[times == 0] = offset[times > 0].mean()
        return np.asarray(scaled + offset[batch])


def fit_correction(sums: BlockSums) -> Correction:
    """The least squares of y on slope · m and a drift in each piece, for each candidate.

    The coil of the model is not quite the one of the log; a factor takes out most of what that does to the
    temperature, and nothing of what a gap does to its turns.
    """
    is_of_piece = np.zeros((int(sums.piece[-1]) + 1, sums.n.size))
    is_of_piece[sums.piece, np.arange(sums.n.size)] = 1.0
    n, y, yy, m, mm, my = (is_of_piece @ values for values in sums[1:])
    n = np.maximum(n, 1.0)  # a piece that no resampled block is of
    n, y, yy = n[:, np.newaxis], y[:, np.newaxis], yy[:, np.newaxis]
    var_y, var_m, cov = yy - y * y / n, mm - m * m / n, my - m * y / n
    slope = np.maximum(cov / np.maximum(var_m, 1e-12), _LEAST_SLOPE)
    return Correction(slope, np.sum(var_y - 2.0 * slope * cov + slope * slope * var_m, axis=0), float(var_y.sum()))


def _resample_blocks(sums: BlockSums) -> Iterator[BlockSums]:
    """The sums with as many blocks, drawn with replacement (Künsch 1989)."""
    rng = np.random.default_rng(0)
    for _ in range(_N_RESAMPLES):
        times = np.bincount(rng.integers(0, sums.n.size, sums.n.size), minlength=sums.n.size).astype(float)
        yield BlockSums(sums.piece, *(times * v if v.ndim == 1 else times[:, np.newaxis] * v for v in sums[1:]))

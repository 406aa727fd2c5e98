"""``fit_loop``: the backlash of a valve from recorded commands and supply temperatures, with a model of its coil.

The grey-box problem: the emulator behind the logged command with each candidate backlash, and which fits.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import checking, instance_of, number_of
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, shown
from fastcoil.logs import Log
from fastcoil.logs.columns import Wanted, checked_reading, log_of
from fastcoil.logs.pieces import require_whole_seconds
from fastcoil.logs.series import HUMIDITIES, counted
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.measured.fit import Fit, finished, profile_of
from fastcoil.measured.fit_coil import in_operation, of_pieces, on_seconds, require_temperatures
from fastcoil.measured.identify import GOOD, TOLERANCE
from fastcoil.measured.part import Part, checked_part, unbroken
from fastcoil.measured.valve_problem import reversals, why_unidentified
from fastcoil.model.metric_table import WARM_UP

FEWEST_BLOCKS = 6
LEAST_EXPLAINED = 0.8  # share of the changes of T_sup below which the model is one of another coil
_WANTED = Wanted(
    needed=("command", "m_a", "T_w_in", "T_a_in", HUMIDITIES, "T_sup"), optional=("enabled",), measured=("T_sup",)
)

LARGEST = 0.25  # candidate, fraction of stroke
_COARSE, _FINE, _NEAR = 0.005, 0.0005, 0.01
"""Steps of the candidates, over the whole range and this near to the best, fractions of stroke."""
_BLOCK = 1800.0  # seconds whose residuals are taken to belong together
_RESAMPLES = 400
_FEWEST_SAMPLES = 60
_APART = 120.0  # seconds between the temperatures whose difference is compared
_LEAST_SLOPE = 0.02  # of measured over modelled changes
_CONFIDENCE, _WIDER = 0.95, 0.005
"""Of the interval, and by how much it is widened on both sides for what the model gets wrong, fraction of stroke."""
_COARSE_LOG = 90.0  # above so many seconds between samples, turns of a command that moves are missed
_HELD, _MOVES = 2e-3, 0.25
"""A command that changes by more than the first in more than this share of the samples also moves between them."""
_NEUTRAL: dict[str, Any] = {"noise_std": 0.0, "sensor_resolution": 0.0, "backlash_estimate": 0.0, "learning_step": 0.0,
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
    warm_up: float = WARM_UP,
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
        How the log is read: see ``fastcoil.logs.Reading``.

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
    started = time.perf_counter()
    with checking() as check:
        log = check(log_of, "log", log)
        check(instance_of, "loop", loop, Loop, "give a fastcoil.Loop")
        warm_up = check(number_of, "warm_up", warm_up, "give a number of seconds, 0 or more", least=0.0)
        how = checked_reading(check, columns=columns, units=units, constants=constants, drop=drop, jumps=jumps,
                              max_gap=max_gap, time_format=time_format, has_command=True)  # fmt: skip
        part = checked_part(check, split, validation)
        for name, values in loop.swept.items() if isinstance(loop, Loop) else ():
            if name != "backlash":
                check.problems.append(f"loop has {name} = {shown(values.values.tolist())}: give one value")
        if isinstance(loop, Loop) and (loop["slip_jump"] or 0.0) != 0.0:
            check.problems.append("loop has a slip_jump: give it none, a backlash without one is fitted")

    problem = LoopProblem(part.read(log, _WANTED, how, in_operation), loop, warm_up, part)
    return _fit_of(problem, started)


def _fit_of(problem: LoopProblem, started: float) -> Fit:
    """The best candidate, how far it moves when blocks of the log are resampled, and what a user may ask beside it."""
    data, measured = problem.data, problem.T_sup
    grid, modelled = problem.candidates()
    sums = problem.sums(modelled)
    best = corrected(sums)
    k = int(best.rss.argmin())
    x = float(grid[k])
    draws = grid[[int(corrected(drawn).rss.argmin()) for drawn in _resampled(sums)]]
    low, high = np.quantile(draws, (0.5 - _CONFIDENCE / 2, 0.5 + _CONFIDENCE / 2))
    interval = max(float(low) - _WIDER, 0.0), min(float(high) + _WIDER, LARGEST)
    explained = 1.0 - float(best.rss[k]) / max(best.total, 1e-12)
    why = _why_unidentified(problem, x, interval, sums.n.size, explained)
    with_it, without = (problem.shown(modelled, best, one) for one in (k, 0))
    seen = np.where(problem.compared, measured, np.nan)
    series = {
        "T_sup": (measured, "degC"),
        "modelled": (with_it, "degC"),
        "modelled_without_backlash": (without, "degC"),
        "residual": (measured - with_it, "K"),
        "command": (data.values["command"], "1"),
    }
    known = {} if why else {"backlash": x}
    return finished(
        data, started, problem.compared, problem.fitting, {"": with_it - seen, "_without_backlash": without - seen},
        series, list(known), np.full((len(known), len(known)), float(draws.std()) ** 2),
        kind="loop", parameters=known, intervals=dict.fromkeys(known, interval), held={"backlash": why} if why else {},
        profile=profile_of(grid, np.sqrt(np.maximum(best.rss, 0.0) / sums.n.sum()), "K", x, interval),
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
    elif problem.data.step > _COARSE_LOG and problem.moves > _MOVES:
        why = (
            f"not identified: samples are {problem.data.step:.4g} s apart and the command moves between them; "
            f"reversals are missed, so the best fit, {x:.3g}, is too small: log every 60 s or faster"
        )
    elif not explained > LEAST_EXPLAINED:
        why = (
            f"not identified: the model explains {100 * max(explained, 0.0):.0f} % of the changes of T_sup: fit the "
            "coil first, or check units and columns"
        )
    is_wide = not why and (high >= LARGEST or max(high - x, x - low) > max(TOLERANCE * x, GOOD))
    return why_unidentified(problem.n_reversals, interval, is_wide=is_wide) or why


class Sums(NamedTuple):
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


class _Piece(NamedTuple):
    """An unbroken piece that has something to compare."""

    samples: Index
    day: Boundary
    commands: dict[str, Array]  # by how they run between samples
    at: Index  # second of each sample


class LoopProblem:
    """A log, the emulator that is run behind its command, and which samples are compared."""

    def __init__(self, data: Log, loop: Loop, warm_up: float, part: Part) -> None:
        require_whole_seconds(data.name, data.step)
        self.data, self.notes = data, [*data.notes, *of_pieces(data, loop, warm_up)]
        self.loop = loop.assign(**_NEUTRAL)
        self.T_sup, command = data.values["T_sup"], data.values["command"]
        self.fitting = part.fitted(data)
        self.compared = (data.since_batch() >= warm_up) & np.isfinite(self.T_sup)
        self.used = self.compared & self.fitting
        require_temperatures(data, self.used, _FEWEST_SAMPLES, warm_up, self.notes)
        self.n_reversals = reversals(command[self.used], data.batch[self.used])
        self.moves = float(np.mean(np.abs(np.diff(command)) > _HELD))
        self.pieces = self._pieces()

    def _pieces(self) -> list[_Piece]:
        data, found = self.data, []
        values = {name: data.values[name] for name in ("m_a", "T_a_in", "T_w_in")}
        values |= dict.fromkeys(("held", "straight"), data.values["command"])
        values["W_a_in"] = data.humidity_ratio(self.loop["pressure"])
        for samples in unbroken(data.batch):
            if not self.compared[samples].any():
                continue
            of_piece = {name: series[samples] for name, series in values.items()}
            series, at = on_seconds(data.time[samples], of_piece, ("held",))
            commands = {runs: series.pop(runs) for runs in ("held", "straight")}
            found.append(_Piece(samples, Boundary(**series, T_set=0.0, enabled=1.0), commands, at))
        return found

    def modelled(self, backlash: Array, runs: str) -> Array:
        """T_sup at the samples, (n, candidates), °C, if the command is ``held`` or ``straight``; NaN where left out."""
        found = np.full((self.data.time.size, backlash.size), np.nan)
        sweep = self.loop.assign(backlash=("candidate", backlash))
        for piece in self.pieces:
            every = int(np.gcd.reduce(piece.at))
            ds = simulate(
                sweep, piece.day, command=piece.commands[runs], traces=["T_measured"], trace_interval=every,
                warm_up=0, progress=False,
            )  # fmt: skip
            found[piece.samples] = ds["T_measured"].transpose("elapsed_time", "candidate").values[piece.at // every]
        return found

    def sums(self, modelled: Array) -> Sums:
        """Sums over the fitted changes of each block.

        Changes over ``_APART`` s are compared, not temperatures: what a coil that is not quite the right one gets wrong
        changes slowly, and a command that follows the temperature would be blamed for it.
        """
        used, batch, width = self.used, self.data.batch, max(1, round(_APART / self.data.step))
        own = np.concatenate([np.full(piece.samples.size, k) for k, piece in enumerate(self.pieces)])
        at = np.concatenate([piece.samples for piece in self.pieces])
        earlier = np.maximum(at - width, 0)
        both = (at >= width) & used[at] & used[earlier] & (batch[at] == batch[earlier])
        at, own = at[both], own[both]
        if at.size < _FEWEST_SAMPLES:
            seen = f"{counted(at.size, 'change')} of T_sup over {_APART:g} s"
            raise InputError(f"{self.data.name}: {seen} to compare: give at least {_FEWEST_SAMPLES}, with fewer gaps")
        block = (self.data.since_batch()[at] // _BLOCK).astype(np.int64)
        first = np.flatnonzero(np.diff(block, prepend=-1) | np.diff(own, prepend=-1))
        _, piece = np.unique(own[first], return_inverse=True)
        y, m = (series[at] - series[at - width] for series in (self.T_sup, modelled))
        columns = (np.ones(y.size), y, y * y, m, m * m, y[:, np.newaxis] * m)
        return Sums(piece, *(np.add.reduceat(column, first, axis=0) for column in columns))

    def candidates(self) -> tuple[Array, Array]:
        """A grid refined near the best, and ``modelled``; a moving command runs held or straight, as fits better."""
        coarse = np.arange(0.0, LARGEST + _COARSE / 2, _COARSE)
        ways = ("held", "straight") if self.moves > _MOVES else ("held",)
        tried = {runs: corrected(self.sums(self.modelled(coarse, runs))).rss for runs in ways}
        runs = min(tried, key=lambda way: float(tried[way].min()))
        near = float(coarse[tried[runs].argmin()])
        fine = np.arange(max(near - _NEAR, 0.0), min(near + _NEAR, LARGEST) + _FINE / 2, _FINE)
        grid = np.unique(np.round(np.concatenate([coarse, fine]), 6))
        return grid, self.modelled(grid, runs)

    def shown(self, modelled: Array, by: Correction, k: int) -> Array:
        """Corrected temperature of a candidate at every sample; a piece held back gets the mean correction."""
        batch, used, n = self.data.batch, self.used, self.data.n_batches
        slope = np.full(n, by.slope[:, k].mean())
        fitted = np.unique(batch[used])
        if fitted.size == by.slope.shape[0]:
            slope[fitted] = by.slope[:, k]
        found = slope[batch] * modelled[:, k]
        times = np.bincount(batch[used], minlength=n)
        offset = np.bincount(batch[used], (self.T_sup - found)[used], n) / np.maximum(times, 1)
        offset[times == 0] = offset[times > 0].mean()
        return np.asarray(found + offset[batch])


def corrected(sums: Sums) -> Correction:
    """The least squares of y on slope · m and a drift in each piece, for each candidate.

    The coil of the model is not quite the one of the log; a factor takes out most of what that does to the
    temperature, and nothing of what a gap does to its turns.
    """
    of_pieces = np.zeros((int(sums.piece[-1]) + 1, sums.n.size))
    of_pieces[sums.piece, np.arange(sums.n.size)] = 1.0
    n, y, yy, m, mm, my = (of_pieces @ values for values in sums[1:])
    n = np.maximum(n, 1.0)  # a piece that no resampled block is of
    n, y, yy = n[:, np.newaxis], y[:, np.newaxis], yy[:, np.newaxis]
    var_y, var_m, cov = yy - y * y / n, mm - m * m / n, my - m * y / n
    slope = np.maximum(cov / np.maximum(var_m, 1e-12), _LEAST_SLOPE)
    return Correction(slope, np.sum(var_y - 2.0 * slope * cov + slope * slope * var_m, axis=0), float(var_y.sum()))


def _resampled(sums: Sums) -> Iterator[Sums]:
    """The sums with as many blocks, drawn with replacement (Künsch 1989)."""
    draw = np.random.default_rng(0)
    for _ in range(_RESAMPLES):
        times = np.bincount(draw.integers(0, sums.n.size, sums.n.size), minlength=sums.n.size).astype(float)
        yield Sums(sums.piece, *(times * v if v.ndim == 1 else times[:, np.newaxis] * v for v in sums[1:]))

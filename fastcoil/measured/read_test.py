"""``read_test``: the backlash of a valve from the log of a valve test, and whether it is why the loop hunts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, number_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, shown
from fastcoil.base.figures import BLUE, FAINT, GREY, RED, YELLOW, apply_style, wrapped
from fastcoil.base.results import Result, as_toml, toml_table
from fastcoil.logs import read_log
from fastcoil.logs.columns import Wanted, checked_reading, log_of
from fastcoil.logs.series import COLUMNS
from fastcoil.measured.cause import UNKNOWN, Cause, after_hold, cause_of
from fastcoil.measured.diagnose import as_measured, seconds_of
from fastcoil.measured.fitted_loop import fit_loop_model
from fastcoil.measured.grid import Grid, held, motor_positions, on_grid
from fastcoil.measured.identify import CANDIDATES, GOOD, USUAL_STROKE_TIME, Identification, judged
from fastcoil.measured.measures import measures_of
from fastcoil.measured.part import runs, turns
from fastcoil.measured.valve_response import Response, response

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WANTED = Wanted(
    needed=("command", "T_sup"),
    optional=("test", "T_set", "m_a", "T_a_in", "T_w_in", "enabled"),
    measured=("T_sup", "T_set", "m_a", "T_a_in", "T_w_in"),
)
INPUTS = ("m_a", "T_a_in", "T_w_in")
LONGEST_INTERVAL, ENOUGH = 15.0, 10.0  # s between samples, in a log and in what is compared
BEFORE, AFTER = 600.0, 600.0
"""Seconds before the test that the lags of the coil reach back, and after it that tell of the gap as well."""
LEAST_TURNS, LEAST_TURN = 1, 0.005  # of the command in the test, and the fraction of stroke that counts as one
MOST_MISSING = 0.05  # share of the temperatures
WEIGHT = 0.65
"""Share of the log-likelihood that counts: residuals are neither independent nor normal."""
LEAST_EXPLAINED = 0.5  # share of the variance of the temperature that the command has to explain
LEAST_BEFORE = 3600.0  # seconds of normal operation by which the cause is judged


@dataclass(frozen=True, repr=False)
class ValveReading(Result):
    """What a valve test shows of its valve and loop.

    Attributes
    ----------
    source
        Name of the log.
    backlash, interval
        Most probable backlash and its 95 % interval, fractions of stroke.
    identified, reason
        Whether the backlash is right, to 20 % of itself or 1 % of the stroke, with 95 % probability; why not, and what
        to do, else empty.
    gain, lag, dead_time
        Change of the temperature per stroke of the stem where the test was made, K, sum of the lags and dead time, s,
        of the most probable model.
    held_swing, held_for
        Highest less lowest temperature in the second half of the hold at the start of the test, K; that half, s.
    cause, because
        Why the loop hunted before the test, as in a ``Diagnosis``, and a sentence; ``unknown`` where less than an hour
        before the test is logged.
    explained
        Share of the variance of the temperature that the command explains.
    minutes
        How long the test took.
    profile
        Dataset over ``backlash``: the ``probability`` of each size.
    signals
        Dataset over ``elapsed_time``, from ten minutes before the test to ten after it: ``T_sup``, ``command``,
        ``stem`` (its place behind the most probable gap), ``model`` (temperature without drift) and ``test``.
    notes
        How the log was read, and what was assumed.
    """

    source: str
    backlash: float
    interval: tuple[float, float]
    identified: bool
    reason: str
    gain: float
    lag: float
    dead_time: float
    held_swing: float
    held_for: float
    cause: str
    because: str
    explained: float
    minutes: float
    profile: xr.Dataset
    signals: xr.Dataset
    notes: list[str]

    def summary(self) -> list[str]:
        """The reading in words, line by line."""
        low, high = (100 * bound for bound in self.interval)
        within = f"{100 * self.backlash:.3g} % of the stroke (95 %: {low:.3g} to {high:.3g} %)"
        gap = "Gap: none to speak of, " if self.backlash <= GOOD else "Gap: "
        lines = [f"{self.source}: a valve test of {self.minutes:.0f} min"]
        lines.append(gap + within if self.identified else f"Gap: not identified, most probable {within}: {self.reason}")
        lines.append(
            f"Plant: {self.gain:.3g} K per stroke, lags of {self.lag:.0f} s, dead time {self.dead_time:.0f} s; "
            f"the temperature moved by {self.held_swing:.2g} K while the command was held"
        )
        lines.append(f"Cause of the swing before the test: {self.cause}: {self.because}")
        return lines + [f"Note: {note}" for note in self.notes]

    def plot(self) -> Figure:
        """The reading on one page, as a matplotlib ``Figure``."""
        return _page(self)

    def to_toml(self, path: str | Path | None = None) -> str:
        """The backlash as TOML, written to ``path`` if one is given; for ``include`` in the ``[loop]`` of a study file.

        ``[loop]`` has the backlash if it is identified, and nothing else; ``[fit]`` is for readers.
        """
        numbers = {
            name: getattr(self, name) for name in ("gain", "lag", "dead_time", "held_swing", "held_for", "minutes")
        }
        of_fit = {"kind": "valve test", "source": self.source, "identified": self.identified, "reason": self.reason,
                  "cause": self.cause, "because": self.because, **numbers, "notes": self.notes}  # fmt: skip
        lines = [f"# backlash fitted to {self.source} by fastcoil valve-test", *(f"# {s}" for s in self.summary()[1:])]
        lines += toml_table("loop", {"backlash": self.backlash} if self.identified else {})
        lines += toml_table("fit", of_fit) + toml_table("fit.interval_95", {"backlash": list(self.interval)})
        return as_toml(lines, path)


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
        How the log is read: see ``fastcoil.logs.Reading``.

    Raises
    ------
    InputError
        With one sentence for each mistake in the log or the arguments.
    """
    with checking() as check:
        source = check(log_of, "log", log)
        stroke_time = check.unless_none(seconds_of, "stroke_time", stroke_time, 0.0)
        between = check.unless_none(_between_of, "between", between)
        how = checked_reading(check, columns=columns, units=units, drop=drop, jumps=jumps,
                              max_gap=max_gap, time_format=time_format, has_command=True)  # fmt: skip
    data = read_log(as_measured(source) if "T_sup" not in (columns or {}) else source, WANTED, how)
    grid, notes = on_grid(data)
    grid, notes = _thinned(data.name, grid), [*data.notes, *notes]
    seconds = USUAL_STROKE_TIME if stroke_time is None else stroke_time
    if stroke_time is None:
        notes.append(f"the motor is taken to need {seconds:g} s for its stroke: give stroke_time if it is known")
    first, last = _rows_of_test(data.name, grid, between, notes)
    window = slice(max(first - round(BEFORE / grid.interval), 0), last + round(AFTER / grid.interval))
    command = held(grid.values["command"][: window.stop])
    positions = motor_positions(command, grid.interval, seconds)[:-1]
    found, answer = _gap_of(grid, positions, first, last, window)
    swing, held_for = _held(grid, command, first, last)
    cause = _cause(grid, seconds, first, found, (swing, held_for))
    attrs = {"units": "1", "long_name": "backlash, fraction of stroke"}
    return ValveReading(
        source=data.name, backlash=found.backlash, interval=(found.low, found.high), identified=found.identified,
        reason=found.reason, gain=answer.gain, lag=answer.lag, dead_time=answer.dead_time,
        held_swing=swing, held_for=held_for,
        cause=cause.name, because=cause.because, explained=answer.explained,
        minutes=(last - first) * grid.interval / 60.0,
        profile=xr.Dataset(
            {"probability": ("backlash", found.probability, {"long_name": "probability of each size"})},
            {"backlash": ("backlash", found.candidates, attrs)},
        ),
        signals=_signals(grid, command, answer, first, last, window), notes=notes,
    )  # fmt: skip


def _between_of(name: str, value: Any) -> tuple[float, float]:
    cure = "give start and end in seconds from the start of the log, such as (5400, 6600)"
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise InputError(f"{name} = {shown(value)}: {cure}")
    start, end = (number_of(name, one, cure, least=0.0, most=1e9) for one in value)
    if end <= start:
        raise InputError(f"{name} = {shown(value)}: the end is not after the start, {cure}")
    return start, end


def _thinned(name: str, grid: Grid) -> Grid:
    """A row every 10 s, which shows the gap as well as more do."""
    if grid.interval > LONGEST_INTERVAL:
        raise InputError(
            f"{name}: a sample every {grid.interval:.4g} s: log the test every 5 s, {LONGEST_INTERVAL:g} s at most"
        )
    every = max(1, round(ENOUGH / grid.interval))
    values = {column: series[::every] for column, series in grid.values.items()}
    return Grid(every * grid.interval, grid.time[::every], values, grid.on[::every], grid.increment)


def _rows_of_test(name: str, grid: Grid, between: tuple[float, float] | None, notes: list[str]) -> tuple[int, int]:
    """First row of the test, and the first after it."""
    if between is not None:
        inside = (grid.time >= between[0]) & (grid.time <= between[1])
    elif "test" in grid.values:
        inside = np.nan_to_num(grid.values["test"]) > 0.0
    else:
        raise InputError(f"{name}: no column test: say when the test ran (between, --between START END)")
    found = runs(inside)
    if not len(found):
        raise InputError(f"{name}: the log holds no test: the column test is 0 throughout, or between is outside of it")
    if len(found) > 1:
        notes.append(f"the log has {len(found)} tests: the last is read, for another give between, --between")
    first, last = (int(row) for row in found[-1])
    return first, last


def _gap_of(
    grid: Grid, positions: Array, first: int, last: int, window: slice
) -> tuple[Identification, Response]:  # fmt: skip
    T = grid.values["T_sup"][: window.stop]
    known = [grid.values[name][: window.stop] for name in INPUTS if name in grid.values]
    inputs = [held(series) for series in known if np.isfinite(series).any()]
    missing = float(np.mean(~np.isfinite(T[window])))
    made = turns(positions[first:last], LEAST_TURN)
    doubt = ""
    if missing > MOST_MISSING:
        doubt = f"{100 * missing:.0f} % of the temperatures are missing: test again, and log all"
    elif made < LEAST_TURNS:
        doubt = "the command does not turn back in the test, and a gap shows at turns only: test again, for longer"
    answer = response(held(T), positions, window.start, first, grid.interval, inputs, CANDIDATES)
    if not doubt and answer.explained < LEAST_EXPLAINED:
        doubt = (
            f"the command explains {100 * max(answer.explained, 0.0):.0f} % of what the temperature did: something "
            "else moves it, test again when water and air are calm"
        )
    weighed = WEIGHT * answer.likelihood
    cure = "test again, for 30 minutes or more, or log m_a, T_a_in and T_w_in too"
    return judged(np.exp(weighed - np.logaddexp.reduce(weighed)), True, doubt, cure), answer


def _held(grid: Grid, command: Array, first: int, last: int) -> tuple[float, float]:
    """Highest less lowest temperature, K, in the second half of the time before the first move, and that half, s."""
    moved = np.flatnonzero(command[first + 1 : last] != command[first + 1])
    end = first + 1 + (int(moved[0]) if moved.size else last - first - 1)
    rest = grid.values["T_sup"][(first + end) // 2 : end]
    seconds, rest = rest.size * grid.interval, rest[np.isfinite(rest)]
    return (float(np.ptp(rest)) if rest.size > 1 else math.nan), seconds


def _cause(grid: Grid, stroke_time: float, first: int, found: Identification, held: tuple[float, float]) -> Cause:
    """Why the loop swung before the test."""
    values = {name: series[:first] for name, series in grid.values.items()}
    if "T_set" not in values or first * grid.interval < LEAST_BEFORE:
        return Cause(UNKNOWN, "log T_set, and an hour or more of normal operation before the test")
    before = Grid(grid.interval, grid.time[:first], values, grid.on[:first], grid.increment)
    measures, gap = measures_of(before, stroke_time), found.backlash if np.isfinite(found.backlash) else 0.0
    fitted = fit_loop_model(
        values["command"], values["T_sup"], values["T_set"], grid.interval, gap, stroke_time, None, before.on, None
    )
    return after_hold(cause_of(measures, fitted, identified=found.identified), measures, *held)


def _signals(grid: Grid, command: Array, answer: Response, first: int, last: int, window: slice) -> xr.Dataset:
    rows = np.arange(window.start, command.size)
    model = np.full(rows.size, np.nan)
    model[first - window.start :] = answer.model + grid.values["T_sup"][first]
    series = {"T_sup": grid.values["T_sup"][window], "command": command[window], "stem": answer.stem, "model": model}
    ds = xr.Dataset(
        {name: ("elapsed_time", values, {"units": COLUMNS["T_sup" if name == "model" else name].unit
                if name in ("T_sup", "model", "command") else "1"}) for name, values in series.items()},
        {"elapsed_time": ("elapsed_time", grid.time[window], {"units": "s"})},
    )  # fmt: skip
    return ds.assign(test=("elapsed_time", ((rows >= first) & (rows < last)).astype(float)))


_SIZE = (7.5, 6.4)


@apply_style()
def _page(r: ValveReading) -> Figure:
    from matplotlib.figure import Figure

    fig = Figure(figsize=_SIZE, layout="constrained")
    above, middle, below = fig.subplots(3, 1, height_ratios=(1.2, 1.0, 1.0))
    minutes = (r.signals["elapsed_time"] - r.signals["elapsed_time"].values[r.signals["test"].values > 0][0]) / 60.0
    above.plot(minutes, r.signals["T_sup"], color=BLUE, lw=1.0, label="supply air")
    above.plot(minutes, r.signals["model"], color=YELLOW, lw=1.0, label="model, without drift")
    middle.plot(minutes, 100 * r.signals["command"], color=RED, lw=1.0, label="command")
    middle.plot(minutes, 100 * r.signals["stem"], color=GREY, lw=1.0, label="stem behind the gap")
    for axes in (above, middle):
        axes.axvspan(0.0, r.minutes, color=FAINT, lw=0)
        axes.legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False, borderaxespad=0.2)
        axes.margins(x=0.01)
    above.set(ylabel="temperature [°C]")
    above.tick_params(labelbottom=False)
    middle.set(xlabel="minutes from the start of the test", ylabel="of the stroke [%]")
    sizes, probability = 100 * r.profile["backlash"].values, 100 * r.profile["probability"].values
    below.axvspan(100 * r.interval[0], 100 * r.interval[1], color=FAINT, lw=0)
    below.bar(sizes, probability, width=0.8 * (sizes[1] - sizes[0]), color=BLUE if r.identified else GREY)
    below.set(xlabel="backlash [% of stroke]", ylabel="probability [%]")
    below.set_xlim(-0.5, max(100 * r.interval[1], 8.0) * 1.15)
    fig.suptitle("\n".join(wrapped(line, _SIZE[0], 9) for line in _headline(r)), x=0.01, ha="left", fontsize=9)
    return fig


def _headline(r: ValveReading) -> Sequence[str]:
    return [line for line in r.summary() if not line.startswith("Note: ")]

"""Properties of a log of commands and flows before the fit: holds, reversals, the flow meter's floor."""

from __future__ import annotations

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs import Log

_STILL = 2e-3
"""Commands within this of each other are one hold, fraction of stroke."""
_TURN = 0.01
"""A reversal goes back by more than this, fraction of stroke."""
_HOLD_SAMPLES = 4
"""If a typical hold has at least this many samples, the command is taken to be held."""
_FLOOR_SHARE, _FLOOR_SAMPLES = 0.02, 5
_SURELY_OPEN = 0.25
"""A valve this much further open than one that passes water passes water too, whatever its backlash."""
_BIN, _BIN_SAMPLES = 0.05, 3
_FEWEST_REVERSALS = 2
_MANY_PIECES = ", or bridge the gaps, between which it is in {n:,} pieces, with max_gap, --max-gap"
_SMALL = 0.02
"""An interval from 0 to less than this means no backlash."""


def settled(log: Log, fitting: Mask, settle: float | None, notes: list[str]) -> Mask:
    """Where the flow has settled after the last change of the command, (n,); ``fitting``: rows that say how long."""
    command, step = log.values["command"], step_of(log, fitting)
    since, lengths, first, held = np.zeros(command.size), [], 0, command[0]
    for t in range(1, command.size):
        if abs(command[t] - held) > _STILL or log.batch[t] != log.batch[t - 1]:
            lengths.append(t - first)
            first, held = t, command[t]
        since[t] = log.time[t] - log.time[first]
    lengths.append(command.size - first)
    last_fitted = int(np.flatnonzero(fitting)[-1])
    lengths = np.diff(np.minimum(np.cumsum([0, *lengths]), last_fitted + 1))
    lengths = lengths[lengths > 0]
    typical = float(np.median(lengths))
    if settle is None and typical < _HOLD_SAMPLES:
        return np.ones(command.size, dtype=bool)
    wait = settle if settle is not None else 0.5 * typical * step
    good = since >= wait
    good[:1] = wait == 0.0
    if not good.all():
        notes.append(
            f"{int((~good).sum()):,} of {good.size:,} flows not compared: less than {wait:g} s after the command "
            f"changed ({lengths.size:,} holds, typically {typical * step:g} s)"
        )
    return np.asarray(good)


def step_of(log: Log, fitting: Mask) -> float:
    """Median time between the rows of the part to fit, s."""
    return float(np.median(np.diff(log.time[fitting]))) if fitting.sum() > 1 else log.step


def reversals(command: Array, batch: Index) -> int:
    """How often the command turns by more than 1 % of stroke."""
    n, extreme, way = 0, command[0], 0
    for t in range(1, command.size):
        if batch[t] != batch[t - 1]:
            extreme, way = command[t], 0
        moved = command[t] - extreme
        if way * moved > 0.0:
            extreme = command[t]
        elif abs(moved) > _TURN:
            n += way != 0
            way, extreme = int(np.sign(moved)), command[t]
    return n


def lowest_reading(flow: Array, notes: list[str]) -> float:
    """The flow meter's floor: its lowest reading above 0 if that is frequent, else 0."""
    above = flow[np.isfinite(flow) & (flow > 0.0)]
    if above.size == 0:
        return 0.0
    lowest = float(above.min())
    times = int((above == lowest).sum())
    if times < max(_FLOOR_SAMPLES, _FLOOR_SHARE * above.size):
        return 0.0
    notes.append(f"the flow meter reads {lowest:.4g} kg/s {times:,} times and never less: taken as its floor")
    return lowest


def sensor_off(command: Array, flow: Array, floor: float, fitting: Mask) -> Mask:
    """Where the valve does not explain that no flow is measured: the sensor or the pump is off.

    That is a reading of 0 below the meter's floor; and 0, or the floor, with the valve much further open than where
    most samples of the part to fit show flow.
    """
    still = flow <= floor
    flows_from = 1.0
    for low in np.arange(0.0, 1.0, _BIN):
        here = (command >= low) & (command < low + _BIN) & np.isfinite(flow) & fitting
        if here.sum() >= _BIN_SAMPLES and still[here].mean() < 0.5:
            flows_from = low
            break
    off = still & (command > flows_from + _SURELY_OPEN)
    return np.asarray(off | (flow == 0.0) if floor > 0.0 else off)


def why_unidentified(
    n_reversals: int, x_BL: float, interval: tuple[float, float], most: float, n_pieces: int = 1
) -> str:
    """Why the data do not identify the backlash; empty if they do.  n_pieces: in which the log is, reversals within.

    They do if its interval is no wider than ``x_BL`` itself, or below ``_SMALL``.  An interval that just misses 0 can
    be chance, and its middle is then too large.
    """
    low, high = interval
    if n_reversals < _FEWEST_REVERSALS:
        return (
            f"not identified: the command turns {n_reversals} times by more than {100 * _TURN:.0f} % of stroke, and "
            "only reversals show backlash; give a log in which it goes up and down"
            + _MANY_PIECES.format(n=n_pieces)
            * (n_pieces > 1)
        )
    if high >= most or high - low > max(x_BL, _SMALL):
        tried = " (the largest value tried)" if high >= most else ""
        return (
            f"not identified: anything from {low:.3g} to {high:.3g}{tried} fits as well (95 %): the flow's noise is "
            "larger than the effect of the backlash, or no reversal ends within it; give a longer log, with small "
            "reversals too, where the curve is steep"
        )
    return ""

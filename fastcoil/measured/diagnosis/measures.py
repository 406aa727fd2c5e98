"""What a log shows of its loop before any model: the error, how it swings, and what the motor does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.diagnosis.fitted_loop import FittedLoop
from fastcoil.measured.diagnosis.grid import Grid
from fastcoil.measured.diagnosis.identify import USUAL_STROKE_TIME
from fastcoil.measured.diagnosis.indices import (
    Index,
    hagglund_gap,
    harris_index,
    in_control,
    oscillation_index,
    rms,
    settled,
    travel,
)
from fastcoil.measured.diagnosis.motion import motor_positions
from fastcoil.measured.diagnosis.swing import REGULAR, Swing, longest_run, median_swing, swing_of

COARSE = 60.0
"""Interval beyond which a log misses the swings of most loops, s."""
USUAL_PERIOD = 600.0
"""Seconds, where the temperature shows no swing."""
LEAST_WATCHED, LEAST_PIECE = 3600.0, 600.0
"""Seconds of settled operation, and of its longest piece, after which a loop that does not swing may be called calm."""
WIDE = 0.5
"""Peak to peak of a swing above which nobody calls a loop calm, K, although it does not come back regularly."""


class Measures(NamedTuple):
    """What a log shows of its loop.

    error: control error where it is known, K, (n,); else of the temperature, °C.  has_error: which of the two.
    calm: where the plant was on, in control and settled, (n,).  swing: of the error there.  position: of the motor,
    (n,).  command_swing: median of highest less lowest command in a period.  indices: by name.  blind: why the log
    could not show a swing; empty if it could.
    """

    error: Array
    has_error: bool
    calm: Mask
    swing: Swing
    position: Array
    command_swing: float
    indices: dict[str, Index]
    blind: str


def measures_of(grid: Grid, stroke_time: float | None) -> Measures:
    """Measure a log; ``stroke_time``: of the motor, s, the usual one if None."""
    T, command = grid.values["T_sup"], grid.values["command"]
    T_set = grid.values.get("T_set")
    error = T if T_set is None else T - T_set
    good = grid.on & np.isfinite(error) & np.isfinite(command)
    calm = in_control(command, good, grid.interval)
    if T_set is not None:
        calm &= settled(T_set, good, grid.interval)
    error = np.where(good, error, 0.0)
    swing = swing_of(error, calm, grid.interval)
    seconds = USUAL_STROKE_TIME if stroke_time is None else stroke_time
    known = np.where(np.isfinite(command), command, 0.0)
    positions = motor_positions(known, grid.interval / seconds if seconds > 0.0 else 1.0)
    strokes, turns = travel(positions, good, grid.interval)
    length = swing.period if np.isfinite(swing.period) else USUAL_PERIOD
    moved = median_swing(known, calm, max(2, round(length / grid.interval)))
    nothing = np.nan
    indices = {
        "error_rms": Index(rms(error, good) if T_set is not None else nothing, "K", "RMS control error"),
        "error_rms_settled": Index(
            rms(error, calm) if T_set is not None else nothing, "K", "RMS control error, settled and in control"
        ),
        "peak_to_peak": Index(swing.peak_to_peak, "K", "swing of the supply temperature, peak to peak"),
        "period": Index(swing.period, "s", "period of the swing"),
        "regularity": Index(swing.regularity, "1", "regularity of the swing after Thornhill: regular above 1"),
        "periodic_share": Index(swing.share, "1", "share of the variance that comes back after a period"),
        "oscillation": Index(
            oscillation_index(error, calm, grid.interval, swing.period) if T_set is not None else nothing,
            "1",
            "oscillation index after Hägglund: oscillates above 1",
        ),
        "harris": Index(
            harris_index(error, calm, grid.interval) if T_set is not None else nothing,
            "1",
            "normalised Harris index: 0 is the best that feedback can do, 1 the worst",
        ),
        "command_swing": Index(moved, "1", "median swing of the command in a period, peak to peak"),
        "motor_travel": Index(strokes, "d-1", "strokes of the motor in a day"),
        "reversals": Index(turns, "d-1", "turns of the motor in a day"),
    }
    return Measures(error, T_set is not None, calm, swing, positions[:-1], moved, indices, _blind(grid, calm, swing))


def loop_indices(measures: Measures, interval: float, loop: FittedLoop | str, *, trusted: bool) -> dict[str, Index]:
    """Indices of the controller, and of a plant that is ``trusted``: NaN where the loop could not be modelled."""
    kp, ti, every, gain, margin, size = (np.nan,) * 6
    if not isinstance(loop, str):
        kp, ti, every = loop.kp, loop.ti, loop.sample_time
        if trusted:
            gain, margin = loop.gain, loop.margin
            size = hagglund_gap(measures.error, measures.calm, interval, kp, ti, abs(gain))
    return {
        "hagglund_backlash": Index(size, "1", "backlash after Hägglund, fraction of stroke"),
        "kp": Index(kp, "K-1", "gain of the controller"),
        "ti": Index(ti, "s", "integral time of the controller"),
        "sample_time": Index(every, "s", "time between samples of the controller"),
        "plant_gain": Index(gain, "K", "change of the temperature over the stroke"),
        "margin": Index(margin, "1", "margin max |L||N| of the describing function: above 0.8 a gap makes it hunt"),
    }


def _blind(grid: Grid, calm: Mask, swing: Swing) -> str:
    if grid.interval > COARSE:
        return f"a log with a sample every {grid.interval:g} s misses swings of minutes: log every 30 s or faster"
    watched, piece = float(calm.sum()) * grid.interval, longest_run(calm) * grid.interval
    if watched < LEAST_WATCHED:
        return (
            f"the loop is settled and in control for {watched / 60:.0f} min only: log an hour or more with the "
            "set-point held"
        )
    if piece < LEAST_PIECE:
        return f"the log has no more than {piece / 60:.0f} min in one piece: log without gaps, or bridge them (max_gap)"
    if "T_set" not in grid.values:
        return "the log has no set-point (T_set), and its changes hide a swing: log it, too"
    if swing.peak_to_peak > WIDE and swing.regularity > REGULAR:
        return (
            f"the temperature swings by ± {swing.peak_to_peak / 2:.2g} K about every {swing.period / 60:.0f} min, but "
            "not evenly enough to be sure: log every 10 s, some hours with the set-point held"
        )
    return ""

"""What lies between the u of a PI and the opening, as one describing function: all in it that is not linear."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.design.theory.curve_of_plant import Swings
from fastcoil.design.theory.describing_function import Complex, describing_function, rate_limited
from fastcoil.design.theory.plants import Columns

SMALLEST = 2e-4
"""Least amplitude of u, fraction of stroke, that is looked at where nothing waits after a turn."""
_ROUND_OFF = 1e-6
"""A buffer up to this size is against round-off only."""
_SURE_OF_SMOOTH = 4.0
"""The smooth compensation counts as the inverse where u moves so many times faster than its rate."""


class Elements(NamedTuple):
    """Of each loop, (n, 1): what a turn of u meets on its way to the opening, fractions of stroke.

    width, wait: of ``describing_function``, in u.  slope: of the compensation; 1 without one.  offset: of the middle
    of u above that of the stem.  late: seconds after a
    turn until the valve may move, whatever the amplitude: an inverse sees a turn half a sample late, and its jump takes
    the motor a while.  backlash, stroke_time, sample_time: the parameters.
    """

    width: Array
    wait: Array
    slope: Array
    offset: Array
    late: Array
    backlash: Array
    stroke_time: Array
    sample_time: Array

    @classmethod
    def of(cls, columns: Columns) -> Elements:
        """Of loops with these parameters, (n,) each."""
        x_bl, stroke = (np.asarray(columns[name], float) for name in ("backlash", "stroke_time"))
        x_hat = _assumed(columns)
        is_additive = np.asarray(columns["compensation"]) == "additive"
        is_smooth = np.asarray(columns["compensation"]) == "smooth"
        slope = np.where(is_additive, 1.0, 1.0 - x_hat)
        width = (x_bl - x_hat) / slope
        buffer = np.where(is_smooth, 0.0, _buffer(columns))
        period = np.asarray(columns["sample_time"], float)
        late = np.where(x_hat > 0.0, 0.5 * period + np.minimum(x_hat, x_bl) * stroke, 0.0)
        offset = 0.5 * np.where(is_additive, x_bl, (x_bl - x_hat) / slope)
        parts = (width, np.maximum(width, buffer), slope, offset, late, x_bl, stroke, period)
        return cls(*(np.asarray(part, float)[:, None] for part in parts))

    def part(self, some: Index) -> Elements:
        """Those of some loops."""
        return Elements(*(value[some] for value in self))

    def amplitudes(self, most: float, n: int) -> Array:
        """Amplitudes of u, (n_loops, n): from where the first movement passes to ``most``, by equal ratios."""
        least = np.maximum(0.5005 * self.wait, SMALLEST)
        return np.asarray(least * (most / least) ** np.linspace(0.0, 1.0, n))

    def mean(self, amplitude: Array, swings: Swings) -> Array:
        """Mean of u, (n, n_amplitudes), that holds the set-point."""
        gap = np.abs(describing_function(amplitude, self.width, self.wait))
        return np.asarray(swings.at(amplitude * gap)[0] * (1.0 - self.backlash) / self.slope + self.offset)

    def describe(self, amplitude: Array, w: Array, swings: Swings, passed: Array | Complex) -> Complex:
        """N, per (1 - X) of opening and relative to the plant's gain at rest, so that L N is the loop.

        Limits of u, of the motor's speed, gap and the plant's curve change the sine one after the other, each as if
        what comes out of the one before were a sine again.

        amplitude, w: of u without limits, (n, n_amplitudes), fraction of stroke and rad/s.  passed: what the limits of
        u let through.
        """
        faster = amplitude * np.abs(passed) * w * self.stroke_time
        # a motor that reaches each target before the next sample is on its way for a part of the time
        on_its_way = np.exp(-1j / np.pi * w * self.sample_time * np.minimum(faster, 1.0))
        moved = passed * rate_limited(faster)
        turned = amplitude * np.abs(moved)
        wait = np.maximum(self.wait, turned * (1.0 - np.cos(np.minimum(w * self.late, np.pi))))
        stem = self.slope * describing_function(turned, np.minimum(self.width, wait), wait)
        gain = swings.at(turned * np.abs(stem) / (1.0 - self.backlash))[1]
        return np.asarray(moved * on_its_way * stem * gain)


def unknown(columns: Columns) -> dict[str, Mask]:
    """Why the theory says nothing about a loop, and of which loops that is so, (n,)."""

    def above(name: str, least: float = 0.0) -> Mask:
        return np.asarray(np.asarray(columns[name], float) > least)

    learns = (np.asarray(columns["estimator"]) != "none") & above("estimate_share")
    jumps = (_assumed(columns) > np.asarray(columns["backlash"], float)) & (_buffer(columns) > _ROUND_OFF)
    small_cycles = "makes small cycles of its own: give 0, or simulate it"
    return {
        "a control law of your own has no describing function: simulate it": np.asarray(columns["law"]) != "pi",
        "an estimator changes the estimate as it goes: give estimator = 'none' and the backlash_estimate that you want "
        "to know about": learns,
        "an estimate above the backlash with a buffer cannot be told well enough: give buffer = 1e-9, or simulate it": (
            jumps & ~learns & (np.asarray(columns["compensation"]) != "smooth")
        ),
        f"a stem that sticks and slips (slip_jump) {small_cycles}": above("slip_jump"),
        f"a neutral_zone {small_cycles}": above("neutral_zone"),
        f"a resolution (of sensor or command) {small_cycles}": above("sensor_resolution") | above("command_resolution"),
        "a gap that wears has no one size: give wear_rate = 0 and the backlash that you mean": above("wear_rate"),
        "an error_dead_band stops small cycles and starts others: give 0, or simulate it": above("error_dead_band"),
    }


def too_smooth(columns: Columns, amplitude: Array, w: Array) -> Mask:
    """Whether the smooth compensation crosses the gap too slowly, at this cycle of u, to be taken for the inverse."""
    is_smooth = (np.asarray(columns["compensation"]) == "smooth") & (_assumed(columns) > 0.0)
    rate = np.asarray(columns["smooth_rate"], float)
    return np.asarray(is_smooth & (amplitude * w < _SURE_OF_SMOOTH * rate))


def _assumed(columns: Columns) -> Array:
    """The estimate that the compensation assumes, where nothing changes it."""
    ratio, x_bl, estimate, share = (
        np.asarray(columns[name], float)
        for name in ("estimate_ratio", "backlash", "backlash_estimate", "estimate_share")
    )
    return np.asarray(share * np.where(ratio >= 0.0, ratio * x_bl, estimate))


def _buffer(columns: Columns) -> Array:
    """The buffer that counts, as ``control/buffer.py`` derives it; measured noise is taken to be the given one."""
    ratio, kp, sigma, swing, gain, least = (
        np.asarray(columns[name], float)
        for name in ("buffer_ratio", "kp", "noise_std", "buffer_swing", "plant_gain", "buffer")
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        highest = np.where(swing > 0.0, swing / gain, np.inf)
    return np.asarray(np.maximum(np.minimum(ratio * np.abs(kp) * sigma, highest), least))

"""What lies between the u of a PI and the opening, as one describing function: all in it that is not linear."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.arrays import Array, Mask
from fastcoil.theory.curve_of_plant import Swings
from fastcoil.theory.describing_function import Complex, describing_function, limited, rate_limited
from fastcoil.theory.plants import Columns

SMALLEST = 2e-4
"""Least amplitude of u, fraction of stroke, that is looked at where nothing waits after a turn."""
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
        names = ("backlash", "backlash_estimate", "neutral_zone", "stroke_time")
        x_bl, estimate, zone, stroke = (np.asarray(columns[name], float) for name in names)
        x_hat = np.where(np.asarray(columns["estimate_share"]) > 0.0, estimate, 0.0)
        is_additive = np.asarray(columns["compensation"]) == "additive"
        is_smooth = np.asarray(columns["compensation"]) == "smooth"
        slope = np.where(is_additive, 1.0, 1.0 - x_hat)
        # a motor with a neutral zone follows half the zone late either way, as behind a gap of that size
        width = (x_bl + zone - x_hat) / slope
        buffer = np.where((x_hat > 0.0) & ~is_smooth, _buffer(columns), 0.0)
        period = np.asarray(columns["sample_time"], float)
        late = np.where(x_hat > 0.0, 0.5 * period + np.minimum(x_hat, x_bl) * stroke, 0.0)
        offset = 0.5 * np.where(is_additive, x_bl, (x_bl - x_hat) / slope)
        parts = (width, np.maximum(width, buffer), slope, offset, late, x_bl, stroke, period)
        return cls(*(np.asarray(part, float)[:, None] for part in parts))

    def part(self, some: slice | Mask) -> Elements:
        """Those of some loops."""
        return Elements(*(value[some] for value in self))

    def amplitudes(self, most: float, n: int) -> Array:
        """Amplitudes of u, (n_loops, n): from where the first movement passes to ``most``, by equal ratios."""
        least = np.maximum(0.5005 * self.wait, SMALLEST)
        return np.asarray(least * (most / least) ** np.linspace(0.0, 1.0, n))

    def describe(self, amplitude: Array, w: Array, swings: Swings) -> Complex:
        """N, per (1 - X) of opening and relative to the plant's gain at rest, so that L N is the loop.

        u is limited to 0–1, then the motor's speed, then the gap, then the plant's curve change the sinus, each as if
        what comes out of the one before were a sinus again.

        amplitude, w: (n, n_amplitudes), fraction of stroke and rad/s.
        """
        gap = np.abs(describing_function(amplitude, self.width, self.wait))
        mean = swings.at(amplitude * gap)[0] * (1.0 - self.backlash) / self.slope + self.offset
        passed = limited(amplitude, -mean, 1.0 - mean)
        faster = amplitude * passed * w * self.stroke_time
        # a motor that reaches each target before the next sample is on its way for a part of the time
        on_its_way = np.exp(-1j / np.pi * w * self.sample_time * np.minimum(faster, 1.0))
        moved = passed * rate_limited(faster)
        turned = amplitude * np.abs(moved)
        wait = np.maximum(self.wait, turned * (1.0 - np.cos(np.minimum(w * self.late, np.pi))))
        stem = self.slope * describing_function(turned, np.minimum(self.width, wait), wait)
        gain = swings.at(turned * np.abs(stem) / (1.0 - self.backlash))[1]
        return np.asarray(moved * on_its_way * stem * gain)


def unknown(columns: Columns) -> dict[str, Mask]:
    """Why a describing function says nothing about a loop, and of which loops that is so, (n,)."""
    learns = (np.asarray(columns["estimator"]) != "none") & (np.asarray(columns["estimate_share"], float) > 0.0)
    return {
        "a control law of your own has no describing function: simulate it": np.asarray(columns["law"]) != "pi",
        "an estimator changes the estimate as it goes: give estimator = 'none' and the backlash_estimate that you want "
        "to know about": learns,
        "a stem that sticks and slips (slip_jump > 0) has another describing function: simulate it": np.asarray(
            columns["slip_jump"], float
        )
        > 0.0,
        "an error_dead_band stops small cycles and starts others: give 0, or simulate it": np.asarray(
            columns["error_dead_band"], float
        )
        > 0.0,
    }


def too_smooth(columns: Columns, amplitude: Array, w: Array) -> Mask:
    """Whether the smooth compensation crosses the gap too slowly, at this cycle of u, to be taken for the inverse."""
    is_smooth = (np.asarray(columns["compensation"]) == "smooth") & (np.asarray(columns["backlash_estimate"]) > 0.0)
    return is_smooth & (amplitude * w < _SURE_OF_SMOOTH * np.asarray(columns["smooth_rate"], float))


def _buffer(columns: Columns) -> Array:
    """The buffer that counts, as ``control/buffer.py`` derives it; measured noise is taken to be the given one."""
    ratio, kp, sigma, swing, gain, least = (
        np.asarray(columns[name], float)
        for name in ("buffer_ratio", "kp", "noise_std", "buffer_swing", "plant_gain", "buffer")
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        highest = np.where(swing > 0.0, swing / gain, np.inf)
    return np.maximum(np.minimum(ratio * np.abs(kp) * sigma, highest), least)

"""Describing function of everything between the u of a PI and T_sup that is not linear."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.design.plants import Columns, Complex, Plants, distinct, frequency_response


def describing_function(amplitude: Array, width: Array, wait: Array) -> Complex:
    """N(A) of an element that follows its input at a distance and waits after each turn.

    Rising, the output is the input less half the ``width``; falling, the input plus half of it.  After a turn it holds
    until the input has come back by ``wait``, and then jumps to where it belongs.  A play of gap b is width = wait = b:
    there is nothing to jump, and N is the textbook's (Gelb and Vander Velde 1968, appendix B; Slotine and Li 1991, eq
    5.21), here with h = b/2, k = h/A::

        Re N = (π/2 + asin(1 - 2k) + 2 (1 - 2k) √(k (1 - k)))/π,   Im N = -4k (1 - k)/π

    A width below 0 is an inverse that takes the gap for larger than it is: the output is ahead.

    amplitude, width, wait: in one unit, of shapes that broadcast; wait at least 0 and at least the width.

    Returns N, complex; 0 where the input swings less than ``wait`` from peak to peak: then nothing ever moves.
    """
    amplitude, width, wait = np.broadcast_arrays(amplitude, width, wait)
    moves = 2.0 * amplitude > wait
    A = np.where(moves, amplitude, 1.0)
    g, s = np.where(moves, width, 0.0) / A, 1.0 - np.where(moves, wait, 0.0) / A
    root = np.sqrt(1.0 - s * s)
    # Fourier coefficients over half a period, from a peak: held at 1 - g/2 while sin > s, then sin + g/2
    in_phase = (1.0 - g) * root + 0.25 * np.pi + 0.5 * np.arcsin(s) - 0.5 * s * root
    ahead = -0.5 * (1.0 - s) ** 2 - g * s
    return np.where(moves, (in_phase + 1j * ahead) * (2.0 / np.pi), 0.0)


def limited(amplitude: Array, low: Array, high: Array) -> Array:
    """N(A), real, of a limiter whose limits lie ``low`` and ``high`` beside the mean of its input.

    With low = -high it is the saturation of the textbooks (Slotine and Li 1991, eq 5.9).

    amplitude, low, high: in one unit, of shapes that broadcast; low at most high.
    """

    def up_to(limit: Array) -> Array:
        share = np.clip(limit / amplitude, -1.0, 1.0)
        return np.asarray((np.arcsin(share) + share * np.sqrt(1.0 - share * share)) / np.pi)

    return up_to(high) - up_to(low)


_SINE_STEPS, _PERIODS, _FASTEST = 1000, 3, 100.0


@cache
def _rate_limits() -> tuple[Array, Array, Array]:
    """Logarithm of how much faster a sine would move than it may, ln |N|, and lag of N in rad, (n,) each."""
    faster = np.geomspace(1.0, _FASTEST, 120)
    phase = 2.0 * np.pi * np.arange(_SINE_STEPS) / _SINE_STEPS
    most = 2.0 * np.pi / _SINE_STEPS / faster
    # where the triangle of a motor that never catches up is at phase 0
    height = np.minimum(0.5 * np.pi / faster, 1.0)
    position, path = -height * np.arccos(height) / (0.5 * np.pi), np.empty((_SINE_STEPS, faster.size))
    for _ in range(_PERIODS):
        for k, target in enumerate(np.sin(phase)):
            position = position + np.clip(target - position, -most, most)
            path[k] = position
    N = 2j * np.mean(path * np.exp(-1j * phase)[:, None], axis=0)
    return np.log(faster), np.log(np.abs(N)), -np.angle(N)


def rate_limited(faster: Array) -> Complex:
    """N of a motor of limited speed, beside ``faster``: the largest speed of its target over its own, A ω stroke_time.

    Up to 1 it follows at once.  Above, it follows a triangle in the end; N is found by moving it along a sine.
    """
    log_faster, log_size, lag = _rate_limits()
    at = np.log(np.clip(faster, 1.0, _FASTEST))
    return np.asarray(np.exp(np.interp(at, log_faster, log_size) - 1j * np.interp(at, log_faster, lag)))


STEPS = 32
"""Of a period."""
_PHASE = 2.0 * np.pi * (np.arange(STEPS) + 0.5) / STEPS
_SINE = np.sin(_PHASE)
_BIAS_HALVINGS = 9


def driven(proportional: Array, integral: Array, bias: Array) -> Array:
    """u over a period of the error, (STEPS, n, m).

    proportional, integral: amplitudes of the two parts without ends, (n, m).  bias: mean error over its amplitude; one
    below 0 brings the integral to 0 in every period.
    """
    error = _SINE[:, None, None] + bias
    steps, integrals = integral * (2.0 * np.pi / STEPS) * error, np.empty(error.shape)
    now = np.where(bias < 0.0, 0.0, 1.0)
    for _ in range(2):
        for step, after in zip(steps, integrals, strict=True):
            now = np.add(now, step, out=after)
            np.minimum(np.maximum(now, 0.0, out=now), 1.0, out=now)
    return np.clip(proportional * error + integrals, 0.0, 1.0)


_HARMONICS = np.arange(1, 7)
_LOWEST, _FREQUENCIES = 1e-4, 64


def between(curves: Array, place: Array) -> Array:
    """Values of curves (n, n_w) at places (n, m), straight between their points."""
    n = curves.shape[1]
    first = np.clip(place.astype(np.int64), 0, n - 2)
    share = place - first
    first += np.arange(0, curves.size, n)[:, None]
    return np.asarray(curves.take(first) * (1.0 - share) + curves.take(first + 1) * share)


def amplitude_of(u: Array, mean: Array, w: Array, elements: Elements, plants: Plants) -> Array:
    """Half of peak to peak of T_sup, K, (n,).

    u, mean: amplitude of u without limits, and its mean, fraction of stroke; w: rad/s; (n, 1) each.
    """
    period = np.linspace(0.0, 2.0 * np.pi, STEPS, endpoint=False)
    driving = np.clip(mean + u * np.sin(period), 0.0, 1.0).T[:, :, None]
    proportional, integral = elements.parts(u, w)
    ends = integral > np.minimum(mean, 1.0 - mean)
    if ends.any():
        some = np.flatnonzero(ends)
        bias = elements.some(some).passed(u[some], w[some], plants.some(some))[1]
        driving[:, some] = driven(proportional[some], integral[some], bias)
    opening = elements.opening(_followed(_held(driving, w * elements.sample_time), w, elements))
    at_rest = temperature(plants.curve, opening.transpose(1, 2, 0))[:, 0]
    return np.asarray(0.5 * np.ptp(_filtered(at_rest, w, plants), axis=1))


def _held(driving: Array, angle: Array) -> Array:
    """The wave as a sampled controller holds it, by ``angle`` of a period, (n, 1), from sample to sample."""
    step = np.maximum(angle[:, 0] * STEPS / (2.0 * np.pi), 1.0)
    k = np.arange(STEPS)[:, None]
    sampled = np.round(np.floor(k / step + 1e-9) * step).astype(np.int64) % STEPS
    return driving[sampled, np.arange(step.size)]


def _followed(driving: Array, w: Array, elements: Elements) -> Array:
    """Where motor and gap bring the stem, in u: (STEPS, n, 1)."""
    with np.errstate(divide="ignore"):
        most = 2.0 * np.pi / STEPS / (w * elements.stroke_time)
    half, ahead = 0.5 * np.maximum(elements.width, 0.0), 0.5 * np.maximum(-elements.width, 0.0)
    motor, stem, way = driving[0], driving[0], np.zeros(w.shape)
    path = np.empty(driving.shape)
    for _ in range(_PERIODS):
        for k, target in enumerate(driving):
            moved = motor + np.clip(target - motor, -most, most)
            way = np.where(moved > motor, 1.0, np.where(moved < motor, -1.0, way))
            motor = moved
            stem = np.clip(stem, motor - half, motor + half)
            path[k] = stem + ahead * way
    return path


def _filtered(at_rest: Array, w: Array, plants: Plants) -> Array:
    """The wave (n, n_points) that a plant makes of a wave of the temperatures at rest, (n, STEPS)."""
    first, which = distinct(plants.same)
    known = np.geomspace(_LOWEST, np.pi, _FREQUENCIES)
    G = frequency_response(plants.response[first], known) / plants.gain[first, None]
    place = np.log(np.minimum(_HARMONICS * w, np.pi) / _LOWEST) / np.log(known[1] / known[0])
    size = between(np.log(np.maximum(np.abs(G), 1e-300))[which], place)
    phase = between(np.unwrap(np.angle(G), axis=1)[which], place)
    parts = np.fft.rfft(at_rest, axis=1)[:, _HARMONICS] * np.exp(size + 1j * phase)
    spectrum = np.zeros((w.size, 2 * STEPS + 1), complex)
    spectrum[:, _HARMONICS] = parts
    return np.asarray(np.fft.irfft(spectrum, 4 * STEPS, axis=1) * 4.0)


AMPLITUDES = np.geomspace(2e-3, 3.0, 28)
"""Of the opening, before it ends at 0 and 1."""
_NODES = np.sin(np.pi * ((np.arange(8) + 0.5) / 8.0 - 0.5))  # A sine at equal steps of its phase, from trough to peak
_MEAN_HALVINGS, _FINER = 12, 8


def refined(curve: Array) -> Array:
    """A curve (n, n_openings) with ``_FINER`` times as many steps: cubic between its points, with the slopes there.

    Valve curves bend so much that straight lines between the points are up to a third off in slope.
    """
    slope = np.gradient(curve, axis=1)
    t = np.arange(_FINER) / _FINER
    left, right = curve[:, :-1, None], curve[:, 1:, None]
    rise = right - left
    bend = t * (1.0 - t) * ((slope[:, :-1, None] - rise) * (1.0 - t) - (slope[:, 1:, None] - rise) * t)
    return np.column_stack([(left + rise * t + bend).reshape(curve.shape[0], -1), curve[:, -1]])


def temperature(curve: Array, opening: Array) -> Array:
    """T_sup at rest, °C, at openings (n, m, k), ended at 0 and 1.  curve: the same, from 0 to 1 by equal steps."""
    place = np.clip(opening, 0.0, 1.0) * (curve.shape[1] - 1)
    return between(curve, place.reshape(len(curve), -1)).reshape(opening.shape)


def swings_of(plants: Plants) -> tuple[Array, Array]:
    """Mean opening that holds T_sup, and gain over that at rest, where the opening swings by AMPLITUDES: (n, 28)."""
    curve, T_sup = plants.curve, plants.T_sup[:, None]
    sign = np.sign(curve[:, -1] - curve[:, 0])[:, None]
    low = np.broadcast_to(-AMPLITUDES, (curve.shape[0], AMPLITUDES.size))
    high = np.broadcast_to(1.0 + AMPLITUDES, low.shape)
    swing = AMPLITUDES[:, None] * _NODES
    for _ in range(_MEAN_HALVINGS):
        mean = 0.5 * (low + high)
        below = sign * (temperature(curve, mean[:, :, None] + swing).mean(axis=2) - T_sup) < 0.0
        low, high = np.where(below, mean, low), np.where(below, high, mean)
    mean = 0.5 * (low + high)
    over = (temperature(curve, mean[:, :, None] + swing) * _NODES).mean(axis=2) * 2.0 / AMPLITUDES
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = over / plants.gain[:, None]
    return mean, np.where(np.isfinite(relative), relative, 0.0)


SMALLEST = 2e-4
"""Least amplitude of u, fraction of stroke, that is looked at where nothing waits after a turn."""
_ROUND_OFF = 1e-6  # A buffer up to this size is against round-off only
_SURE_OF_SMOOTH = 4.0  # the smooth compensation counts as the inverse where u moves so many times faster than its rate


class Elements(NamedTuple):
    """Of each loop, (n, 1): its PI, and what u meets on its way to the temperature, fractions of stroke.

    kp, ti, sample_time, backlash, stroke_time: the parameters.  sign: of the error per K of T_sup.
    width, wait: of ``describing_function``, in u.  slope: of the compensation; 1 without one.  offset: of the middle
    of u above that of the stem.  late: seconds after a turn until the valve may move, whatever the amplitude: an
    inverse sees a turn half a sample late, and its jump takes the motor a while.
    swing_mean, swing_gain: of ``swings_of``, (n, 28).
    """

    kp: Array
    ti: Array
    sample_time: Array
    backlash: Array
    stroke_time: Array
    sign: Array
    width: Array
    wait: Array
    slope: Array
    offset: Array
    late: Array
    swing_mean: Array
    swing_gain: Array

    @classmethod
    def of(cls, columns: Columns, plants: Plants) -> Elements:
        """Of loops with these parameters, (n,) each, and plants."""
        given = tuple(np.asarray(columns[name], float) for name in cls._fields[:5])
        _, _, period, x_bl, stroke = given
        sign = np.where(np.asarray(columns["action"]) == "heating", -1.0, 1.0)
        x_hat = _assumed(columns)
        is_additive = np.asarray(columns["compensation"]) == "additive"
        is_smooth = np.asarray(columns["compensation"]) == "smooth"
        slope = np.where(is_additive, 1.0, 1.0 - x_hat)
        width = (x_bl - x_hat) / slope
        buffer = np.where(is_smooth, 0.0, _buffer(columns))
        late = np.where(x_hat > 0.0, 0.5 * period + np.minimum(x_hat, x_bl) * stroke, 0.0)
        offset = 0.5 * np.where(is_additive, x_bl, width)
        parts = (*given, sign, width, np.maximum(width, buffer), slope, offset, late)
        first, which = distinct(plants.same)
        swings = (swing[which] for swing in swings_of(plants.some(first)))
        return cls._make([*(np.asarray(part, float)[:, None] for part in parts), *swings])

    def some(self, members: Index) -> Elements:
        """Those of the loops ``members``."""
        return Elements._make(field[members] for field in self)

    def at_swing(self, values: Array, amplitude: Array) -> Array:
        """``swing_mean`` or ``swing_gain`` at amplitudes of the opening, (n, n_amplitudes)."""
        ratio = np.log(AMPLITUDES[1] / AMPLITUDES[0])
        place = np.clip(np.log(np.maximum(amplitude, AMPLITUDES[0]) / AMPLITUDES[0]) / ratio, 0.0, AMPLITUDES.size - 1)
        return between(values, place)

    def parts(self, amplitude: Array, w: Array) -> tuple[Array, Array]:
        """Amplitudes of the proportional and the integral part that together would swing u by ``amplitude``."""
        ratio = self.sample_time / self.ti / (1.0 - np.exp(-1j * w * self.sample_time))
        return amplitude / np.abs(1.0 + ratio), amplitude * np.abs(ratio / (1.0 + ratio))

    def passed(self, amplitude: Array, w: Array, plants: Plants) -> tuple[Complex, Array]:
        """Fundamental of u over that of a PI without ends, and the mean error over its amplitude: (n, m) each."""
        proportional, integral = self.parts(amplitude, w)
        low, high = -np.ones(amplitude.shape), np.ones(amplitude.shape)
        for _ in range(_BIAS_HALVINGS):
            bias = 0.5 * (low + high)
            opening = self.opening(driven(proportional, integral, bias))
            mean = temperature(plants.curve, opening.reshape(STEPS, -1).T.reshape(*amplitude.shape, STEPS)).mean(axis=2)
            # the colder the air, the smaller the error that a cooling valve sees
            above = self.sign * (mean - plants.T_sup[:, None]) > bias * proportional / self.kp
            low, high = np.where(above, bias, low), np.where(above, high, bias)
        bias = 0.5 * (low + high)
        u = driven(proportional, integral, bias)
        fundamental = 2j / STEPS * np.tensordot(np.exp(-1j * _PHASE), u, axes=1)
        return fundamental / (proportional - 1j * integral), bias

    def opening(self, u: Array) -> Array:
        """Opening at rest that belongs to u, behind a gap in whose middle the motor stands."""
        return np.asarray((u - self.offset) * self.slope / (1.0 - self.backlash))

    def amplitudes(self, most: float, n: int) -> Array:
        """Amplitudes of u, (n_loops, n): from where the first movement passes to ``most``, by equal ratios."""
        least = np.maximum(0.5005 * self.wait, SMALLEST)
        return np.asarray(least * (most / least) ** np.linspace(0.0, 1.0, n))

    def mean(self, amplitude: Array) -> Array:
        """Mean of u, (n, n_amplitudes), that holds the set-point."""
        gap = np.abs(describing_function(amplitude, self.width, self.wait))
        mean = self.at_swing(self.swing_mean, amplitude * gap)
        return np.asarray(mean * (1.0 - self.backlash) / self.slope + self.offset)

    def described(self, amplitude: Array, passed: Array | Complex) -> Callable[[Array], Complex]:
        """N at frequencies, per (1 - X) of opening and relative to the plant's gain at rest, so that L N is the loop.

        Limits of u, of the motor's speed, gap and the plant's curve change the sine one after the other, each as if
        what comes out of the one before were a sine again.

        amplitude: of u without limits, (n, n_amplitudes), fraction of stroke.  passed: what the limits of u let
        through.  The frequencies: rad/s, (n, n_amplitudes).
        """
        driven = amplitude * np.abs(passed)

        def moved(w: Array) -> tuple[Complex, Array]:
            faster = driven * w * self.stroke_time
            # a motor that reaches each target before the next sample is on its way for a part of the time
            on_its_way = np.exp(-1j / np.pi * w * self.sample_time * np.minimum(faster, 1.0))
            moved = passed * rate_limited(faster)
            return moved * on_its_way, amplitude * np.abs(moved)

        def turned(w: Array, turned: Array) -> tuple[Complex, Array]:
            wait = np.maximum(self.wait, turned * (1.0 - np.cos(np.minimum(w * self.late, np.pi))))
            stem = self.slope * describing_function(turned, np.minimum(self.width, wait), wait)
            return stem, self.at_swing(self.swing_gain, turned * np.abs(stem) / (1.0 - self.backlash))

        # what does not depend on the frequency is computed once
        at_once = None if self.stroke_time.any() else moved(np.ones(1))
        same = None if at_once is None or self.late.any() else turned(np.ones(1), at_once[1])

        def N(w: Array) -> Complex:
            motor, swing = at_once or moved(w)
            stem, gain = same or turned(w, swing)
            return np.asarray(motor * stem * gain)

        return N


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
        "an estimate above the backlash with a buffer is beyond prediction: give buffer = 1e-9, or simulate it": (
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

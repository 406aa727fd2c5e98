"""Describing function of everything between the u of a PI and T_sup that is not linear."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.design.plants import Columns, Complex, Plants, floats, frequency_response, unique_columns
from fastcoil.model.parameter_table import PARAMETERS


def describing_function(amplitude: Array, width: Array, reversal_band: Array) -> Complex:
    """N(A) of an element that follows its input at a distance and waits after each turn.

    Rising, the output is the input less half the ``width``; falling, the input plus half of it.  After a turn it holds
    until the input has come back by ``reversal_band``, and then jumps to where it belongs.  For a play of gap b both
    are b: there is nothing to jump, and N is the textbook's (Gelb and Vander Velde 1968, appendix B; Slotine and Li
    1991, eq 5.21), here with h = b/2, k = h/A::

        Re N = (π/2 + asin(1 - 2k) + 2 (1 - 2k) √(k (1 - k)))/π,   Im N = -4k (1 - k)/π

    A width below 0 is an inverse that takes the gap for larger than it is: the output is ahead.

    amplitude, width, reversal_band: in one unit, of shapes that broadcast; the last at least 0 and at least the width.

    Returns N, complex; 0 where the input swings less than ``reversal_band`` from peak to peak: then nothing ever moves.
    """
    amplitude, width, reversal_band = np.broadcast_arrays(amplitude, width, reversal_band)
    moves = 2.0 * amplitude > reversal_band
    A = np.where(moves, amplitude, 1.0)
    g, s = np.where(moves, width, 0.0) / A, 1.0 - np.where(moves, reversal_band, 0.0) / A
    root = np.sqrt(1.0 - s * s)
    # Fourier coefficients over half a period, from a peak: held at 1 - g/2 while sin > s, then sin + g/2
    in_phase = (1.0 - g) * root + 0.25 * np.pi + 0.5 * np.arcsin(s) - 0.5 * s * root
    ahead = -0.5 * (1.0 - s) ** 2 - g * s
    return np.where(moves, (in_phase + 1j * ahead) * (2.0 / np.pi), 0.0)


def limiter_gain(amplitude: Array, low: Array, high: Array) -> Array:
    """N(A), real, of a limiter with limits ``low`` to ``high`` from its input's mean (Slotine and Li 1991, eq 5.9)."""

    def gain_up_to(limit: Array) -> Array:
        share = np.clip(limit / amplitude, -1.0, 1.0)
        return np.asarray((np.arcsin(share) + share * np.sqrt(1.0 - share * share)) / np.pi)

    return gain_up_to(high) - gain_up_to(low)


_SETTLING_PERIODS = 3  # of a sine, after which motor and gap repeat their path
_LARGEST_SPEED_RATIO = 100.0  # of the target over the motor; above, N is that of this ratio


@cache
def _rate_limiter_table() -> tuple[Array, Array, Array]:
    """Logarithm of the speed ratio, ln |N|, and lag of N in rad, (n,) each."""
    speed_ratio, n_steps = np.geomspace(1.0, _LARGEST_SPEED_RATIO, 120), 1000
    phase = 2.0 * np.pi * np.arange(n_steps) / n_steps
    most_step = 2.0 * np.pi / n_steps / speed_ratio
    # where the triangle of a motor that never catches up is at phase 0
    height = np.minimum(0.5 * np.pi / speed_ratio, 1.0)
    position, path = -height * np.arccos(height) / (0.5 * np.pi), np.empty((n_steps, speed_ratio.size))
    for _ in range(_SETTLING_PERIODS):
        for k, target in enumerate(np.sin(phase)):
            position = position + np.clip(target - position, -most_step, most_step)
            path[k] = position
    N = 2j * np.mean(path * np.exp(-1j * phase)[:, None], axis=0)
    return np.log(speed_ratio), np.log(np.abs(N)), -np.angle(N)


def rate_limiter_gain(speed_ratio: Array) -> Complex:
    """N of a motor of limited speed; speed_ratio: largest speed of its target over its own, A ω stroke_time.

    Up to 1 it follows without lag.  Far above, it follows a triangle; N results from moving it along a sine.
    """
    log_ratios, log_size, lag = _rate_limiter_table()
    log_ratio = np.log(np.clip(speed_ratio, 1.0, _LARGEST_SPEED_RATIO))
    return np.asarray(np.exp(np.interp(log_ratio, log_ratios, log_size) - 1j * np.interp(log_ratio, log_ratios, lag)))


STEPS_PER_PERIOD = 32  # of u, opening and temperature in a cycle
_PHASE = 2.0 * np.pi * (np.arange(STEPS_PER_PERIOD) + 0.5) / STEPS_PER_PERIOD  # rad, of these steps


def pi_output(proportional: Array, integral: Array, bias: Array) -> Array:
    """u of a PI with limits over a period of its error, (STEPS_PER_PERIOD, n, m).

    proportional, integral: amplitudes of the two parts without limits, (n, m).  bias: mean error over its amplitude; if
    it is negative, the integral falls to 0 in every period.
    """
    error = np.sin(_PHASE)[:, None, None] + bias
    increments, integrals = integral * (2.0 * np.pi / STEPS_PER_PERIOD) * error, np.empty(error.shape)
    running = np.where(bias < 0.0, 0.0, 1.0)
    for _ in range(2):
        for increment, integral_row in zip(increments, integrals, strict=True):
            running = np.add(running, increment, out=integral_row)
            np.minimum(np.maximum(running, 0.0, out=running), 1.0, out=running)
    return np.clip(proportional * error + integrals, 0.0, 1.0)


def interpolate(curves: Array, place: Array) -> Array:
    """Interpolate curves (n, n_w) linearly at places (n, m), indices with a fraction."""
    n = curves.shape[1]
    left = np.clip(place.astype(np.int64), 0, n - 2)
    fraction = place - left
    left += np.arange(0, curves.size, n)[:, None]
    return np.asarray(curves.take(left) * (1.0 - fraction) + curves.take(left + 1) * fraction)


def swing_amplitude(u: Array, mean: Array, w: Array, elements: Elements, plants: Plants) -> Array:
    """Half of peak to peak of T_sup, K, (n,), from amplitude and mean of u without limits, at w, rad/s, (n, 1) each."""
    phase = np.linspace(0.0, 2.0 * np.pi, STEPS_PER_PERIOD, endpoint=False)
    u_wave = np.clip(mean + u * np.sin(phase), 0.0, 1.0).T[:, :, None]
    proportional, integral = elements.pi_amplitudes(u, w)
    is_limited = integral > np.minimum(mean, 1.0 - mean)
    if is_limited.any():
        k = np.flatnonzero(is_limited)
        bias = elements.select(k).pi_limit_gain(u[k], w[k], plants.select(k))[1]
        u_wave[:, k] = pi_output(proportional[k], integral[k], bias)
    opening = elements.rest_opening(_follow_stem(_hold_wave(u_wave, w * elements.sample_time), w, elements))
    rest_wave = temperature(plants.curve, opening.transpose(1, 2, 0))[:, 0]
    return np.asarray(0.5 * np.ptp(_filter_wave(rest_wave, w, plants), axis=1))


def _hold_wave(wave: Array, angle: Array) -> Array:
    """Return the wave as a sampled controller holds it; angle: from sample to sample, rad, (n, 1)."""
    step, k = np.maximum(angle[:, 0] * STEPS_PER_PERIOD / (2.0 * np.pi), 1.0), np.arange(STEPS_PER_PERIOD)[:, None]
    sample = np.round(np.floor(k / step + 1e-9) * step).astype(np.int64) % STEPS_PER_PERIOD
    return wave[sample, np.arange(step.size)]


def _follow_stem(wave: Array, w: Array, elements: Elements) -> Array:
    """Path of the stem behind motor and gap, in u: (STEPS_PER_PERIOD, n, 1)."""
    with np.errstate(divide="ignore"):
        most_step = 2.0 * np.pi / STEPS_PER_PERIOD / (w * elements.stroke_time)
    half_gap, ahead = 0.5 * np.maximum(elements.width, 0.0), 0.5 * np.maximum(-elements.width, 0.0)
    motor, stem, direction = wave[0], wave[0], np.zeros(w.shape)
    path = np.empty(wave.shape)
    for _ in range(_SETTLING_PERIODS):
        for k, target in enumerate(wave):
            moved = motor + np.clip(target - motor, -most_step, most_step)
            direction = np.where(moved > motor, 1.0, np.where(moved < motor, -1.0, direction))
            motor = moved
            stem = np.clip(stem, motor - half_gap, motor + half_gap)
            path[k] = stem + ahead * direction
    return path


def _filter_wave(rest_wave: Array, w: Array, plants: Plants) -> Array:
    """T_sup over a period (n, n_points), from the temperatures at rest for each opening, (n, STEPS_PER_PERIOD)."""
    first, kind = unique_columns(plants.kind)
    order, lowest = np.arange(1, 7), 1e-4  # of the harmonics; of the frequencies, rad/s
    frequencies = np.geomspace(lowest, np.pi, 64)
    G = frequency_response(plants.response[first], frequencies) / plants.gain[first, None]
    place = np.log(np.minimum(order * w, np.pi) / lowest) / np.log(frequencies[1] / frequencies[0])
    log_size = interpolate(np.log(np.maximum(np.abs(G), 1e-300))[kind], place)
    phase = interpolate(np.unwrap(np.angle(G), axis=1)[kind], place)
    spectrum = np.zeros((w.size, 2 * STEPS_PER_PERIOD + 1), complex)
    spectrum[:, order] = np.fft.rfft(rest_wave, axis=1)[:, order] * np.exp(log_size + 1j * phase)
    return np.asarray(np.fft.irfft(spectrum, 4 * STEPS_PER_PERIOD, axis=1) * 4.0)


OPENING_AMPLITUDES = np.geomspace(2e-3, 3.0, 28)  # fraction of stroke, before the opening is limited to 0–1
_SINE_NODES = np.sin(np.pi * ((np.arange(8) + 0.5) / 8.0 - 0.5))  # at equal steps of the phase, from trough to peak


def refine_curve(curve: Array) -> Array:
    """Return a curve (n, n_openings) with 8 times as many steps: cubic, as straight lines are too wrong in slope."""
    slope, t = np.gradient(curve, axis=1), np.arange(8) / 8
    left, right = curve[:, :-1, None], curve[:, 1:, None]
    rise = right - left
    bend = t * (1.0 - t) * ((slope[:, :-1, None] - rise) * (1.0 - t) - (slope[:, 1:, None] - rise) * t)
    return np.column_stack([(left + rise * t + bend).reshape(curve.shape[0], -1), curve[:, -1]])


def temperature(curve: Array, opening: Array) -> Array:
    """T_sup at rest, °C, at openings (n, m, k), limited to 0–1.  curve: the same, from 0 to 1 by equal steps."""
    place = np.clip(opening, 0.0, 1.0) * (curve.shape[1] - 1)
    return interpolate(curve, place.reshape(len(curve), -1)).reshape(opening.shape)


def mean_openings_and_gains(plants: Plants) -> tuple[Array, Array]:
    """Mean opening that holds T_sup, and gain over that at rest, where it swings by ``OPENING_AMPLITUDES``: (n, 28)."""
    curve, T_sup = plants.curve, plants.T_sup[:, None]
    sign = np.sign(curve[:, -1] - curve[:, 0])[:, None]
    low = np.broadcast_to(-OPENING_AMPLITUDES, (curve.shape[0], OPENING_AMPLITUDES.size))
    high = np.broadcast_to(1.0 + OPENING_AMPLITUDES, low.shape)
    swing = OPENING_AMPLITUDES[:, None] * _SINE_NODES
    for _ in range(12):  # halvings: to 2e-4 of the range
        mean = 0.5 * (low + high)
        is_below = sign * (temperature(curve, mean[:, :, None] + swing).mean(axis=2) - T_sup) < 0.0
        low, high = np.where(is_below, mean, low), np.where(is_below, high, mean)
    mean = 0.5 * (low + high)
    swing_gain = (temperature(curve, mean[:, :, None] + swing) * _SINE_NODES).mean(axis=2) * 2.0 / OPENING_AMPLITUDES
    with np.errstate(divide="ignore", invalid="ignore"):
        relative_gain = swing_gain / plants.gain[:, None]
    return mean, np.where(np.isfinite(relative_gain), relative_gain, 0.0)


_ROUND_OFF_BUFFER = 1e-6  # fraction of stroke; a buffer up to this size is against round-off only


class Elements(NamedTuple):
    """The PI of each loop, and what lies between its u and the temperature, (n, 1) each, fractions of stroke."""

    kp: Array
    ti: Array
    sample_time: Array
    backlash: Array
    stroke_time: Array
    sign: Array  # of the error per K of T_sup
    width: Array  # of ``describing_function``, in u
    reversal_band: Array  # the same
    slope: Array  # of the compensation; 1 without one
    offset: Array  # of the middle of u above that of the stem
    # s after a turn until the valve may move: an inverse sees it half a sample late, and its jump takes a while
    turn_delay: Array
    swing_mean: Array  # of ``mean_openings_and_gains``
    swing_gain: Array  # the same

    @classmethod
    def from_columns(cls, columns: Columns, plants: Plants) -> Elements:
        """Return the elements of loops with these parameters, (n,) each, and plants."""
        parameters = tuple(floats(columns, *cls._fields[:5]))
        _, _, period, x_bl, stroke = parameters
        sign = np.where(np.asarray(columns["action"]) == "heating", -1.0, 1.0)
        x_hat = _assumed_backlash(columns)
        is_additive = np.asarray(columns["compensation"]) == "additive"
        is_smooth = np.asarray(columns["compensation"]) == "smooth"
        slope = np.where(is_additive, 1.0, 1.0 - x_hat)
        width = (x_bl - x_hat) / slope
        buffer = np.where(is_smooth, 0.0, _effective_buffer(columns))
        turn_delay = np.where(x_hat > 0.0, 0.5 * period + np.minimum(x_hat, x_bl) * stroke, 0.0)
        offset = 0.5 * np.where(is_additive, x_bl, width)
        fields = (*parameters, sign, width, np.maximum(width, buffer), slope, offset, turn_delay)
        first, kind = unique_columns(plants.kind)
        swings = (swing[kind] for swing in mean_openings_and_gains(plants.select(first)))
        return cls._make([*(np.asarray(field, float)[:, None] for field in fields), *swings])

    def select(self, members: Index) -> Elements:
        """Return the elements of the loops ``members``."""
        return Elements._make(field[members] for field in self)

    def interpolate_over_swing(self, values: Array, amplitude: Array) -> Array:
        """Interpolate ``swing_mean`` or ``swing_gain`` at amplitudes of the opening, (n, n_amplitudes)."""
        least, ratio = OPENING_AMPLITUDES[0], OPENING_AMPLITUDES[1] / OPENING_AMPLITUDES[0]
        place = np.log(np.maximum(amplitude, least) / least) / np.log(ratio)
        return interpolate(values, np.clip(place, 0.0, OPENING_AMPLITUDES.size - 1))

    def pi_amplitudes(self, amplitude: Array, w: Array) -> tuple[Array, Array]:
        """Amplitudes of the proportional and the integral part that together would swing u by ``amplitude``."""
        ratio = self.sample_time / self.ti / (1.0 - np.exp(-1j * w * self.sample_time))
        return amplitude / np.abs(1.0 + ratio), amplitude * np.abs(ratio / (1.0 + ratio))

    def pi_limit_gain(self, amplitude: Array, w: Array, plants: Plants) -> tuple[Complex, Array]:
        """Fundamental of u over that of a PI without limits, and the mean error over its amplitude: (n, m) each."""
        proportional, integral = self.pi_amplitudes(amplitude, w)
        low, high = -np.ones(amplitude.shape), np.ones(amplitude.shape)
        for _ in range(9):  # halvings: the bias is right to 0.4 %
            bias = 0.5 * (low + high)
            opening = np.moveaxis(self.rest_opening(pi_output(proportional, integral, bias)), 0, 2)
            mean = temperature(plants.curve, opening).mean(axis=2)
            # the colder the air, the smaller the error that a cooling valve sees
            is_above = self.sign * (mean - plants.T_sup[:, None]) > bias * proportional / self.kp
            low, high = np.where(is_above, bias, low), np.where(is_above, high, bias)
        bias = 0.5 * (low + high)
        u = pi_output(proportional, integral, bias)
        fundamental = 2j / STEPS_PER_PERIOD * np.tensordot(np.exp(-1j * _PHASE), u, axes=1)
        return fundamental / (proportional - 1j * integral), bias

    def rest_opening(self, u: Array) -> Array:
        """Opening at rest that belongs to u, behind a gap in whose middle the motor stands."""
        return np.asarray((u - self.offset) * self.slope / (1.0 - self.backlash))

    def amplitudes(self, largest: float, n: int) -> Array:
        """Amplitudes of u, (n_loops, n): from where the first movement passes to ``largest``, by equal ratios."""
        smallest = np.maximum(0.5005 * self.reversal_band, 2e-4)  # where nothing waits after a turn
        return np.asarray(smallest * (largest / smallest) ** np.linspace(0.0, 1.0, n))

    def mean_u(self, amplitude: Array) -> Array:
        """Mean of u, (n, n_amplitudes), that holds the set-point."""
        gap = np.abs(describing_function(amplitude, self.width, self.reversal_band))
        mean = self.interpolate_over_swing(self.swing_mean, amplitude * gap)
        return np.asarray(mean * (1.0 - self.backlash) / self.slope + self.offset)

    def make_describing_function(self, amplitude: Array, limit_gain: Array | Complex) -> Callable[[Array], Complex]:
        """Return N over frequencies, per (1 - X) of opening, relative to the plant's gain at rest: L N is the loop.

        Limits, gap and curve change the sine one after the other, each as if the output of the one before were a sine.

        amplitude: of u without limits, (n, n_amplitudes).  limit_gain: of the limits of u.
        """
        limited_amplitude = amplitude * np.abs(limit_gain)

        def motor_stage(w: Array) -> tuple[Complex, Array]:
            speed_ratio = limited_amplitude * w * self.stroke_time
            # a motor that reaches each target before the next sample is on its way for a part of the time
            travel_delay = np.exp(-1j / np.pi * w * self.sample_time * np.minimum(speed_ratio, 1.0))
            gain = limit_gain * rate_limiter_gain(speed_ratio)
            return gain * travel_delay, amplitude * np.abs(gain)

        def gap_stage(w: Array, motor_amplitude: Array) -> tuple[Complex, Array]:
            passed = motor_amplitude * (1.0 - np.cos(np.minimum(w * self.turn_delay, np.pi)))  # until the valve moves
            band = np.maximum(self.reversal_band, passed)
            stem = self.slope * describing_function(motor_amplitude, np.minimum(self.width, band), band)
            opening = motor_amplitude * np.abs(stem) / (1.0 - self.backlash)
            return stem, self.interpolate_over_swing(self.swing_gain, opening)

        # what does not depend on the frequency is computed once
        fixed_motor = None if self.stroke_time.any() else motor_stage(np.ones(1))
        fixed_stem = None if fixed_motor is None or self.turn_delay.any() else gap_stage(np.ones(1), fixed_motor[1])

        def N(w: Array) -> Complex:
            motor, swing = fixed_motor or motor_stage(w)
            stem, gain = fixed_stem or gap_stage(w, swing)
            return np.asarray(motor * stem * gain)

        return N


def unpredictable_loops(columns: Columns) -> dict[str, Mask]:
    """Return why theory says nothing about a loop, and of which loops that is so, (n,): see ``Parameter.theory``."""
    reasons: dict[str, Mask] = {}
    for p in PARAMETERS.values():
        nearest, clause, other = p.theory
        if clause:
            # NaN, for a parameter that is not given, is neither below nor above
            values = np.asarray(columns[p.name], str if p.is_word else float)
            differs = values != nearest if p.is_word else (values < nearest) | (values > nearest)
            is_uncovered = differs & (np.asarray(columns[other], float) > 0.0) if other else differs
            reasons[clause] = reasons.get(clause, False) | is_uncovered
    jumps = _assumed_backlash(columns) > np.asarray(columns["backlash"], float)
    jumps &= (_effective_buffer(columns) > _ROUND_OFF_BUFFER) & ~reasons[PARAMETERS["estimator"].theory.clause]
    clause = "an estimate above the backlash with a buffer is beyond prediction: give buffer = 1e-9, or simulate it"
    return reasons | {clause: jumps & (np.asarray(columns["compensation"]) != "smooth")}


def is_too_smooth(columns: Columns, amplitude: Array, w: Array) -> Mask:
    """Whether the smooth compensation crosses the gap too slowly, at this cycle of u, to be taken for the inverse."""
    is_smooth = (np.asarray(columns["compensation"]) == "smooth") & (_assumed_backlash(columns) > 0.0)
    (rate,) = floats(columns, "smooth_rate")
    return np.asarray(is_smooth & (amplitude * w < 4.0 * rate))  # above, it counts as the inverse


def _assumed_backlash(columns: Columns) -> Array:
    """Backlash that the compensation assumes, where nothing changes the estimate."""
    names = ("estimate_ratio", "backlash", "backlash_estimate", "estimate_share")
    ratio, x_bl, estimate, share = floats(columns, *names)
    return np.asarray(share * np.where(ratio >= 0.0, ratio * x_bl, estimate))


def _effective_buffer(columns: Columns) -> Array:
    """Buffer in effect, as the controller derives it; measured noise is taken to be ``noise_std``."""
    names = ("buffer_ratio", "kp", "noise_std", "buffer_swing", "plant_gain", "buffer")
    ratio, kp, sigma, swing, gain, least = floats(columns, *names)
    with np.errstate(divide="ignore", invalid="ignore"):
        highest = np.where(swing > 0.0, swing / gain, np.inf)
    return np.asarray(np.maximum(np.minimum(ratio * np.abs(kp) * sigma, highest), least))

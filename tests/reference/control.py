"""The PI controller, the backlash inverse, and what may stand in for it."""

import math

from reference.rounding import clip

RISING, FALLING = 1, -1


def pi_controller(error, integral, kp, ti, sample_time):
    """One sample of the PI law: (u, integral), both fractions.

    error [K] is positive when the valve should open; kp in 1/K, ti and sample_time in s.
    """
    integral = clip(integral + kp * sample_time / ti * error, 0.0, 1.0)
    u = clip(kp * error + integral, 0.0, 1.0)
    return u, integral


def backlash_inverse(u, estimate, buffer, mode, u_extreme, command):
    """Inverse of Eq (1) with a buffer on the change of direction: (command, mode, u_extreme).

    u is the desired opening; estimate, buffer, u_extreme (the furthest u in the present direction) and
    command are fractions of stroke; mode is RISING or FALLING.  Unless u_extreme changes, the command holds.
    """
    changed = True
    if mode == RISING and u > u_extreme:
        u_extreme = u
    elif mode == RISING and u < u_extreme - buffer:
        mode, u_extreme = FALLING, u
    elif mode == FALLING and u < u_extreme:
        u_extreme = u
    elif mode == FALLING and u > u_extreme + buffer:
        mode, u_extreme = RISING, u
    else:
        changed = False
    if changed:
        offset = estimate if mode == RISING else 0.0
        command = clip((1.0 - estimate) * u_extreme + offset, 0.0, 1.0)
    return command, mode, u_extreme


def additive_compensation(u, estimate, mode):
    """u and half the estimate in the direction of u (literature, Eq 5 with delta = estimate)."""
    return clip(u + estimate / 2.0 * mode, 0.0, 1.0)


def smooth_inverse(u, u_before, sample_time, estimate, smooth_rate):
    """Inverse whose jump is a hyperbolic tangent of du/dt; 98 % of it at ``smooth_rate`` [1/s]."""
    k = 2.0 / smooth_rate
    return clip((1.0 - estimate) * u + estimate * 0.5 * (1.0 + math.tanh(k * (u - u_before) / sample_time)), 0.0, 1.0)


class NoiseMeter:
    """Standard deviation [K] of the noise in readings, by the running median of their second differences.

    Half of all |N(0, 1)| lie below 0.67449; second differences of white noise have six times its variance.
    """

    def __init__(self):
        self.readings = []
        self.median = 0.1

    def read(self, reading):
        """Take one more reading [K]."""
        self.readings.append(reading)
        if len(self.readings) < 3:
            return
        older, previous, now = self.readings[-3:]
        share = max(1.0 / len(self.readings), 0.01)
        self.median *= 1.0 + share if abs((now - previous) - (previous - older)) > self.median else 1.0 - share
        self.median = max(self.median, 0.001)

    @property
    def deviation(self):
        """Standard deviation [K] so far."""
        return self.median / 0.6744897501960817 / math.sqrt(6.0)


class Controller:
    """PI with its dead band, then the inverse or what stands in for it; at rest and closed at the start."""

    def __init__(self, parameters):
        self.p = parameters
        self.meter = NoiseMeter()
        self.u = self.integral = self.u_extreme = self.command = 0.0
        self.mode = FALLING

    @property
    def buffer(self):
        """Buffer in use, fraction of stroke."""
        p = self.p
        deviation = self.meter.deviation if p["buffer_noise"] == "measured" else p["noise_std"]
        limit = p["buffer_swing"] / p["plant_gain"] if p["buffer_swing"] > 0.0 else math.inf
        return max(min(p["buffer_ratio"] * abs(p["kp"]) * deviation, limit), p["buffer"])

    def act(self, error, is_sample, enabled, estimate):
        """Second by second: update u, mode and command for a control error [K] and an estimate of the backlash."""
        p, u_before = self.p, self.u
        if is_sample:
            self.meter.read(error)
        if not enabled:
            self.u = self.integral = 0.0
        elif is_sample and not abs(error) <= p["error_dead_band"] > 0.0:
            self.u, self.integral = pi_controller(error, self.integral, p["kp"], p["ti"], p["sample_time"])

        waives_buffer = p["estimator"] == "identify" and estimate == 0.0
        extreme_before, command_before = self.u_extreme, self.command
        self.command, self.mode, self.u_extreme = backlash_inverse(
            self.u, estimate, 0.0 if waives_buffer else self.buffer, self.mode, self.u_extreme, self.command
        )
        if p["compensation"] == "additive":
            holds = self.u_extreme == extreme_before
            self.command = command_before if holds else additive_compensation(self.u_extreme, estimate, self.mode)
        elif p["compensation"] == "smooth":
            holds = not is_sample and self.u == u_before
            smooth = smooth_inverse(self.u, u_before, p["sample_time"], estimate, p["smooth_rate"])
            self.command = command_before if holds else smooth

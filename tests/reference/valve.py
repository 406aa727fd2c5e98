"""Eqs (1) and (2): actuator and valve."""

import math

from reference.rounding import round_half_up


def actuator_position(command, position, resolution, stroke_time):
    """Position of the motor [strokes] one second after `position`, driven to `command` [strokes].

    The command is rounded to `resolution` [strokes] (0: off); the motor then moves at most
    1/stroke_time per second (stroke_time in s, 0: immediately).
    """
    target = min(round_half_up(command, resolution), 1.0) if resolution > 0.0 else command
    if stroke_time <= 0.0:
        return target
    limit = 1.0 / stroke_time
    if target - position > limit:
        return position + limit
    if target - position < -limit:
        return position - limit
    return target


def backlash(cmd, cmd_previous, x_previous, x_bl, commissioned=None):
    """Eq (1), the three branches as printed.  Returns the state x [strokes] and the opening [fraction].

    cmd and cmd_previous are the motor positions of this step and the one before, x_previous the state of
    the step before and x_bl the backlash, all in strokes.  alpha lets the opening span 0..1 with the backlash
    as commissioned (None: x_bl); a backlash that has changed since leaves alpha, and the stops of the valve.
    """
    alpha = 1.0 / (1.0 - (x_bl if commissioned is None else commissioned))
    change = cmd - cmd_previous
    if change >= x_bl - x_previous:  # on the increasing curve
        x, opening = x_bl, alpha * (cmd - x_bl)
    elif change < x_bl - x_previous and change >= -x_previous:  # inside the gap: the stem stands still
        x, opening = x_previous + change, alpha * (cmd_previous - x_previous)
    else:  # on the decreasing curve
        x, opening = 0.0, alpha * cmd
    return x, min(opening, 1.0)


def richards_valve(opening, m_max, a, b, c):
    """Eq (2): water flow [kg/s] at an opening [fraction]; m_max in kg/s, a, b, c dimensionless."""
    return m_max / (1.0 + a * math.exp(-b * (opening - c))) ** (1.0 / a)


def valve_from_authority(rangeability, authority, m_full):
    """Eq (2) parameters (m_max [kg/s], a, b, c) of an installed equal-percentage valve.

    With rangeability R, authority N (both dimensionless) and m_full [kg/s] the flow at full opening, the
    installed curve m/m_full = ((1 - N) + N R^(2(1 - opening)))^(-1/2) is exactly Eq (2) with a = 2.
    """
    b = 2.0 * math.log(rangeability)
    c = 1.0 + math.log(authority / (2.0 * (1.0 - authority))) / (2.0 * math.log(rangeability))
    return m_full / math.sqrt(1.0 - authority), 2.0, b, c


class NeutralZone:
    """A motor [strokes] that starts where its target is further away than `zone` [strokes]."""

    def __init__(self, zone):
        self.zone, self.position, self.running = zone, 0.0, False

    def move(self, command, resolution, stroke_time):
        """Position one second on; arguments as those of `actuator_position`."""
        target = min(round_half_up(command, resolution), 1.0) if resolution > 0.0 else command
        if self.running or abs(target - self.position) > self.zone:
            self.position = actuator_position(command, self.position, resolution, stroke_time)
            self.running = self.position != target
        return self.position


class StickSlip:
    """The flow chart of Kano et al. (2004), for an input u in strokes: stick band S, slip jump J, both in strokes.

    The stem starts stuck at u = 0, as if it had come down.
    """

    def __init__(self, S, J):
        self.S, self.J = S, J
        self.u_old = self.du_old = self.u_s = 0.0
        self.stp, self.d, self.y = 1, -1, (S - J) / 2.0

    def move(self, u):
        """Valve position y and the opening [fraction] that spans 0..1."""
        S, J = self.S, self.J
        du = u - self.u_old
        if du * self.du_old <= 0.0 and self.stp == 0:
            self.u_s, self.stp = self.u_old, 1
        if self.stp == 0:
            self.y = u - self.d * (S - J) / 2.0
        elif -self.d * (u - self.u_s) > S:
            self.d = -self.d
            self.y = u - self.d * (S - J) / 2.0
            self.stp = 0
        elif self.d * (u - self.u_s) > J:
            self.y = u - self.d * (S - J) / 2.0
            self.stp = 0
        self.u_old, self.du_old = u, du
        opening = (self.y - (S - J) / 2.0) / (1.0 - S + J)
        return self.y, min(max(opening, 0.0), 1.0)


class Positioner:
    """A motor [strokes] that runs while the stem, on the scale of the command, is off its target by over `band`."""

    def __init__(self, band):
        self.band, self.position = band, 0.0

    def move(self, command, resolution, stroke_time, stem):
        """Position one second on; other arguments as those of `actuator_position`."""
        target = min(round_half_up(command, resolution), 1.0) if resolution > 0.0 else command
        if target - stem > self.band:
            self.position = min(self.position + 1.0 / stroke_time, 1.0)
        elif stem - target > self.band:
            self.position = max(self.position - 1.0 / stroke_time, 0.0)
        return self.position


def flow_at_pressure(m_w, dp_ratio, pressure_independent):
    """Water flow [kg/s] where the pressure difference is `dp_ratio` times that of m_w."""
    if pressure_independent and dp_ratio > 1.0:
        return m_w
    return m_w * math.sqrt(dp_ratio)


def leaking_valve(opening, leakage, m_max, a, b, c, curve="richards"):
    """Water flow [kg/s] of the curve, stretched to `leakage` of the full flow at opening 0; None: as it is."""

    def flow(opening):
        return m_max * opening if curve == "linear" else richards_valve(opening, m_max, a, b, c)

    m_w = flow(opening)
    if leakage is None:
        return m_w
    closed, full = flow(0.0), flow(1.0)
    return full * (leakage + (1.0 - leakage) * (m_w - closed) / (full - closed))

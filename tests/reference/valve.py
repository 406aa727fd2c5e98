"""Eqs (1) and (2): actuator and valve."""

import math

from reference.rounding import round_half_up


def actuator_position(command, position, resolution, stroke_time):
    """Position of the motor [strokes] one second after `position`, driven to `command` [strokes].

    The command is rounded to `resolution` [strokes] (0: off); the motor then moves at most
    1/stroke_time per second (stroke_time in s, 0: at once).
    """
    target = command
    if resolution > 0.0:
        target = min(round_half_up(command, resolution), 1.0)
    if stroke_time <= 0.0:
        return target
    limit = 1.0 / stroke_time
    if target - position > limit:
        return position + limit
    if target - position < -limit:
        return position - limit
    return target


def backlash(cmd, cmd_previous, x_previous, x_bl):
    """Eq (1), the three branches as printed.  Returns the state x [strokes] and the opening [fraction].

    cmd and cmd_previous are the motor positions of this step and the one before, x_previous the state of
    the step before and x_bl the backlash, all in strokes.  alpha = 1/(1 - x_bl) lets the opening span 0..1.
    """
    alpha = 1.0 / (1.0 - x_bl)
    change = cmd - cmd_previous
    if change >= x_bl - x_previous:  # on the increasing curve
        x = x_bl
        opening = alpha * (cmd - x_bl)
    elif change < x_bl - x_previous and change >= -x_previous:  # inside the gap: the stem stands still
        x = x_previous + change
        opening = alpha * (cmd_previous - x_previous)
    else:  # on the decreasing curve
        x = 0.0
        opening = alpha * cmd
    return x, opening


def richards_valve(opening, m_max, a, b, c):
    """Eq (2): water flow [kg/s] at an opening [fraction]; m_max in kg/s, a, b, c dimensionless."""
    return m_max / (1.0 + a * math.exp(-b * (opening - c))) ** (1.0 / a)


def valve_from_authority(rangeability, authority, m_full):
    """Eq (2) parameters (m_max [kg/s], a, b, c) of an installed equal-percentage valve.

    With rangeability R, authority N (both dimensionless) and m_full [kg/s] the flow at full opening, the
    installed curve m/m_full = ((1 - N) + N R^(2(1 - opening)))^(-1/2) is exactly Eq (2) with a = 2.
    """
    m_max = m_full / math.sqrt(1.0 - authority)
    a = 2.0
    b = 2.0 * math.log(rangeability)
    c = 1.0 + math.log(authority / (2.0 * (1.0 - authority))) / (2.0 * math.log(rangeability))
    return m_max, a, b, c

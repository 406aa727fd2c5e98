"""The valve: gearbox backlash, Eq (1), also with stick-slip, and flow curve, Eq (2), also with leakage.

Section 2.1 of the paper.
"""

from __future__ import annotations

import numpy as np

from fastcoil.model.numerics.elementary import exp, log
from fastcoil.model.numerics.jit import scalar

LARGEST_GAP = 0.9
"""Backlash, fraction of stroke, that nothing exceeds: the largest that a loop may have, too."""


@scalar
def backlash(q, position, x_bl):
    """Stem position q behind the play of the gearbox, Eq (1).

    The paper carries x, the place within the play, through three branches::

        if   Δcmd >= x_BL - x[t-1]:   x = x_BL;           open = α (cmd - x_BL)            rising
        elif Δcmd >= -x[t-1]:         x = x[t-1] + Δcmd;  open = α (cmd[t-1] - x[t-1])     in the gap: held
        else:                         x = 0;              open = α cmd                     falling

    With q = cmd - x all three are one clamp: the stem stays where it is unless a flank of the gear moves it.

    q, position, x_bl: fractions of stroke; position is the motor's (the paper's cmd).
    """
    pushed = position - x_bl if q < position - x_bl else q
    return position if pushed > position else pushed


@scalar
def started(position, x_bl, x):
    """Stem position q of a gearbox first seen at ``position``, Eq (1): x = 0 on the falling flank, 1 on the rising.

    Only that part of the gap is possible which keeps the opening within 0–1: the stem stops where the valve does.
    """
    highest = 1.0 - x_bl if position > 1.0 - x_bl else position
    lowest = 0.0 if position < x_bl else position - x_bl
    return highest - x * (highest - lowest)


@scalar
def opening(q, x_bl):
    """Valve opening α q with α = 1/(1 - x_BL), so that a full command opens fully.  Eq (1)."""
    return q / (1.0 - x_bl)


@scalar
def worn(x_bl, wear_rate, travel):
    """Backlash after the stem has travelled so many strokes more; it wears by ``wear_rate`` a stroke."""
    return x_bl + wear_rate * travel


@scalar
def gap(x_bl, scale):
    """Backlash of this second, ``scale`` times as large as by itself, at most LARGEST_GAP."""
    x = x_bl * scale
    return LARGEST_GAP if x > LARGEST_GAP else x


@scalar
def slipped(q, direction, position, previous, x_bl, slip_jump):
    """Stem position q and direction of a stem that sticks and slips, after Kano et al. (2004).

    A stem at rest stays until the motor has pushed it by the stick band S, which is x_BL; then it jumps by J.  It moves
    with the motor until that stops or turns.  The chart's u_s and d are in q: y = q + (S - J)/2, and a stem that stuck
    at the motor position u_s is let go where the motor leaves the interval from q - J to q + S.  J = 0 is ``backlash``,
    to the bit.

    q, position, previous (of the second before), x_bl, slip_jump: fractions of stroke, slip_jump J at most x_bl.
    direction: 1 rising, -1 falling, 0 stuck.  M. Kano, H. Maruta, H. Kugemoto, K. Shimizu: Practical model and
    detection algorithm for valve stiction.  IFAC DYCOPS 2004.
    """
    rises = (direction > 0.0) & (position > previous) | (position - x_bl > q)
    falls = (direction < 0.0) & (position < previous) | (position < q - slip_jump)
    risen, direction = position - (x_bl - slip_jump), -1.0 if falls else 0.0
    risen = q if risen < q else risen  # a gap that grows takes no stem back
    q = position if falls else q
    return risen if rises else q, 1.0 if rises else direction


@scalar
def growth(open, b, c):
    """The exponential of Eq (2), e^(-b (open - c))."""
    return exp(-b * (open - c))


@scalar
def log_flow(log_m_max, a, growth):
    """Eq (2) as ln m_w, from which Eq (4) takes powers."""
    return log_m_max - log(1.0 + a * growth) / a


@scalar
def water_flow(open, m_max, a, b, c):
    """Water flow m_w = m_max (1 + a e^(-b (open - c)))^(-1/a) at an opening, Eq (2), kg/s.

    open: fraction; m_max: kg/s, the asymptote; a: asymmetry; b: growth rate per unit opening; c: opening of
    steepest growth.
    """
    return exp(log_flow(log(m_max), a, growth(open, b, c)))


@scalar
def leaking(m_w, m_0, m_1, leakage):
    """Water flow, kg/s, of a valve with the curve of Eq (2) that lets ``leakage`` of its full flow pass when closed.

    m_w: flow of Eq (2) at the opening; m_0, m_1: the same closed and fully open, kg/s.  Eq (2) as printed leaks m_0.
    """
    return m_1 * (leakage + (1.0 - leakage) * ((m_w - m_0) / (m_1 - m_0)))


@scalar
def installed_valve(rangeability, authority, m_full):
    """(m_max, a, b, c) of Eq (2) for an equal-percentage valve of given authority.

    The installed flow m_full [(1 - N) + N R^(2(1 - open))]^(-1/2) at a constant total pressure difference
    is Eq (2) with a = 2, exactly.  rangeability R > 1; authority 0 < N < 1; m_full: flow at full opening, kg/s.
    """
    b = 2.0 * log(rangeability)
    c = 1.0 + log(authority / (2.0 * (1.0 - authority))) / b
    return m_full / np.sqrt(1.0 - authority), 2.0, b, c

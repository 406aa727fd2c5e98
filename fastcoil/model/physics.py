"""The paper's plant as scalar functions: gearbox Eq (1), valve Eq (2), motor, sensor, air, coil Eqs (3) and (4)."""

import numpy as np

from fastcoil.model.numerics.elementary import exp, log, polynomial
from fastcoil.model.numerics.jit import scalar


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
    pushed_up = position - x_bl if q < position - x_bl else q
    return position if pushed_up > position else pushed_up


@scalar
def initial_stem_position(position, x_bl, x):
    """Stem position q of a gearbox first seen at ``position``, Eq (1): x = 0 on the falling flank, 1 on the rising.

    Only that part of the gap is possible which keeps the opening within 0–1: the stem stops where the valve does.
    """
    highest = 1.0 - x_bl if position > 1.0 - x_bl else position
    lowest = 0.0 if position < x_bl else position - x_bl
    return highest - x * (highest - lowest)


@scalar
def opening(q, x_bl):
    """Valve opening α q with α = 1/(1 - x_BL), so that a full command opens fully, Eq (1).

    x_bl: the backlash that the valve was commissioned with.  A gap that has grown since leaves α as it is: it moves no
    stem that stands still, and a full command no longer opens fully.  With a smaller gap the stem meets its stop early.
    """
    open = q / (1.0 - x_bl)
    return 1.0 if open > 1.0 else open


@scalar
def scaled_backlash(x_bl, scale):
    """Backlash of this second, ``scale`` times x_bl, at most 0.9, the largest that a loop may have."""
    x = x_bl * scale
    return 0.9 if x > 0.9 else x


@scalar
def stick_slip(q, direction, position, previous_position, x_bl, slip_jump):
    """Stem position q and direction of a stem that sticks and slips, after Kano et al. (2004).

    A stem at rest stays until the motor has pushed it by the stick band S, which is x_BL; then it jumps by J.  It moves
    with the motor until that stops or turns.  The chart's u_s and d are in q: y = q + (S - J)/2, and a stem that stuck
    at the motor position u_s is let go where the motor leaves the interval from q - J to q + S.  J = 0 is ``backlash``,
    to the bit.

    q, position, previous_position (one second before), x_bl, slip_jump J (at most x_bl): fractions of stroke.
    direction: 1 rising, -1 falling, 0 stuck.  M. Kano, H. Maruta, H. Kugemoto, K. Shimizu: Practical model and
    detection algorithm for valve stiction.  IFAC DYCOPS 2004.
    """
    rises = (direction > 0.0) & (position > previous_position) | (position - x_bl > q)
    falls = (direction < 0.0) & (position < previous_position) | (position < q - slip_jump)
    risen_stem, direction = position - (x_bl - slip_jump), -1.0 if falls else 0.0
    risen_stem = q if risen_stem < q else risen_stem  # a gap that grows takes no stem back
    q = position if falls else q
    return risen_stem if rises else q, 1.0 if rises else direction


@scalar
def flow_exponential(open, b, c):
    """The exponential of Eq (2), e^(-b (open - c))."""
    return exp(-b * (open - c))


@scalar
def log_flow(log_m_max, a, exponential):
    """Eq (2) as ln m_w, from which Eq (4) takes powers."""
    return log_m_max - log(1.0 + a * exponential) / a


@scalar
def water_flow(open, m_max, a, b, c):
    """Water flow m_w = m_max (1 + a e^(-b (open - c)))^(-1/a) at an opening, Eq (2), kg/s.

    open: fraction; m_max: kg/s, the asymptote; a: asymmetry; b: growth rate per unit opening; c: opening of
    steepest growth.
    """
    return exp(log_flow(log(m_max), a, flow_exponential(open, b, c)))


@scalar
def leaky_flow(m_w, m_0, m_1, leakage):
    """Water flow, kg/s, as m_w of Eq (2) from m_0 to m_1, but with ``leakage`` of its full flow when closed."""
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


@scalar
def actuator_input(command, resolution):
    """Command as the actuator's input sees it, fraction of stroke, at most 1."""
    target = round_to_resolution(command, resolution)
    return 1.0 if target > 1.0 else target


@scalar
def motor_position(position, target, max_travel):
    """Motor position one step on: ``target``, or as near as ``max_travel`` (inf: no limit) lets it come."""
    low, high = position - max_travel, position + max_travel
    nearest = low if target < low else target
    return high if nearest > high else nearest


@scalar
def move_with_dead_zone(position, target, max_travel, neutral_zone, is_running):
    """Motor position one step on, and whether the motor still runs, with a neutral zone around the target.

    A motor at rest starts where the target is further away than ``neutral_zone`` (fraction of stroke), and then runs
    until it reaches the target.  0: it follows every target.
    """
    is_running |= abs(target - position) > neutral_zone
    next_position = motor_position(position, target, max_travel)
    next_position = next_position if is_running else position
    return next_position, is_running & (next_position != target)


@scalar
def position_stem(position, stem, target, max_travel, band):
    """Motor position one step on under a positioner: it runs towards the target while the stem is beyond the band.

    position: of the motor; stem: measured, on the scale of the command; target, band: fractions of stroke.
    """
    step = max_travel if target > stem else -max_travel
    next_position = position + (step if abs(target - stem) > band else 0.0)
    next_position = 0.0 if next_position < 0.0 else next_position
    return 1.0 if next_position > 1.0 else next_position


@scalar
def next_room_temperature(T_room, T_sup, C_air, T_out, UA, Q_room, capacity):
    """T_room[t+1], °C: a room as one capacity, kJ/K, with supply air C_air = m_a c_p,a and its envelope UA, kW/K.

    capacity dT_room/dt = C_air (T_sup - T_room) + UA (T_out - T_room) + Q_room (kW), by Euler's step of a second.
    """
    return T_room + (C_air * (T_sup - T_room) + UA * (T_out - T_room) + Q_room) / capacity


@scalar
def sensor_temperature(y_s, T, decay):
    """Sensor temperature after one step, decay = e^(-dt/τ).

    The usual y_s + (1 - decay)(T - y_s), written so that decay = 0 gives T to the bit.
    """
    return T + decay * (y_s - T)


@scalar
def round_to_resolution(y, resolution):
    """r floor(y/r + 1/2), or y itself where the resolution r is 0."""
    r = 1.0 if resolution <= 0.0 else resolution
    return y if resolution <= 0.0 else r * np.floor(y / r + 0.5)


@scalar
def sensor_reading(y_s, noise, resolution):
    """What the controller reads, °C."""
    return round_to_resolution(y_s + noise, resolution)


T_FROST = 0.01  # °C, triple point: over ice below it, where Eqs 5 and 6 meet to 6e-9 of p_ws
T_HOT = 50.0  # °C: another polynomial above; a coil is rarely as warm
T_SATURATION_MIN = -20.0  # °C, end of the polynomial over ice
T_SATURATION_MAX = 60.0  # °C, end of the hot polynomial
MASS_RATIO = 0.621945  # molar mass of water over that of dry air

# p_ws, Pa, interpolated at Chebyshev nodes, without the logarithm, division and exponential of Eqs 5 and 6.
_MILD_CENTRE_C = 25.0
_MILD_COEFFICIENTS = (
    6.337648701247726e-19, 4.843596783206397e-16, -5.599997570513241e-14, -3.0331269952404774e-11,
    2.8276007599474568e-09, 2.8250279786507624e-06, 0.0006149997625258774, 0.07159297906653218, 4.91264330714873,
    188.9310647032762, 3169.2164701436113,
)  # fmt: skip
"""In T - 25 °C on 0–50 °C: within 3.3e-11 relative."""
_FROST_CENTRE_C = -10.0
_FROST_COEFFICIENTS = (
    2.166482455294341e-13, 1.364296417216959e-10, 3.0164038582249346e-08, 4.057612631985733e-06,
    0.00036773757795715217, 0.022801634494503644, 0.9359654830054085, 23.07378361055915, 259.902864952159,
)  # fmt: skip
"""In T + 10 °C on -20–0.01 °C, over ice: within 4.4e-11."""
_HOT_CENTRE_C = 55.0
_HOT_COEFFICIENTS = (
    -3.804957288664999e-09, 2.726680428272405e-06, 0.001046644188296657, 0.17144009348699968, 15.457900310573544,
    755.1027089840052, 15759.706943242232,
)  # fmt: skip
"""In T - 55 °C on 50–60 °C: within 2.8e-12."""


@scalar
def saturation_pressure_mild(T):
    """Saturation pressure p_ws over liquid water, Pa; T is clamped to 0.01–50 °C."""
    T = T_FROST if T < T_FROST else T
    # each limit on a variable of its own becomes one instruction; both on T would become masks
    x = T - _MILD_CENTRE_C
    x = T_HOT - _MILD_CENTRE_C if x > T_HOT - _MILD_CENTRE_C else x
    return polynomial(x, _MILD_COEFFICIENTS)


@scalar
def saturation_pressure_frost(T):
    """Saturation pressure p_ws over ice, Pa, below 0.01 °C; T is clamped to -20 °C."""
    x = T - _FROST_CENTRE_C
    x = T_SATURATION_MIN - _FROST_CENTRE_C if x < T_SATURATION_MIN - _FROST_CENTRE_C else x
    return polynomial(x, _FROST_COEFFICIENTS)


@scalar
def saturation_pressure_hot(T):
    """Saturation pressure p_ws over liquid water, Pa, above 50 °C; T is clamped to 60 °C."""
    x = T - _HOT_CENTRE_C
    x = T_SATURATION_MAX - _HOT_CENTRE_C if x > T_SATURATION_MAX - _HOT_CENTRE_C else x
    return polynomial(x, _HOT_COEFFICIENTS)


@scalar
def saturation_pressure(T):
    """Saturation pressure p_ws, Pa: over ice below 0.01 °C, over liquid water above; T is clamped to -20–60 °C."""
    p_ws = saturation_pressure_frost(T) if T < T_FROST else saturation_pressure_mild(T)
    return saturation_pressure_hot(T) if T > T_HOT else p_ws


@scalar
def humidity_ratio(p_w, pressure):
    """W, kg/kg, at a partial pressure of vapour (ASHRAE Fundamentals 2017, ch. 1, Eq 20)."""
    return MASS_RATIO * p_w / (pressure - p_w)


@scalar
def saturation_humidity_ratio(T, pressure):
    """W_s, kg/kg (ASHRAE Fundamentals 2017, ch. 1, Eq 21)."""
    return humidity_ratio(saturation_pressure(T), pressure)


# enthalpy is 1.006 T + W (2501 + 1.86 T), kJ/kg of dry air (ASHRAE Fundamentals 2017, ch. 1, Eq 30); the kernel
# needs only its differences


@scalar
def vapour_enthalpy(T):
    """Enthalpy of water vapour, kJ/kg of water: what W multiplies in Eq 30."""
    return 2501.0 + 1.86 * T


@scalar
def heat_capacity(W):
    """c_p of moist air, kJ/K per kg of dry air: what T multiplies in Eq 30."""
    return 1.006 + 1.86 * W


@scalar
def enthalpy_difference(T, W, T_s, W_s):
    """h(T, W) - h(T_s, W_s), kJ/kg of dry air: first cooled to T_s as it is, then dried to W_s."""
    return heat_capacity(W) * (T - T_s) + vapour_enthalpy(T_s) * (W - W_s)


LEAST_WATER_FLOW_KG_S = 1e-9
"""Least water flow at which Eq (4) holds: below, whatever the exponent, the conductance goes to 0 with the flow."""


@scalar
def transfer_units(factor, exponent, log_m):
    """Number of transfer units β m^β' of Eq (4), from ln m."""
    return factor * exp(exponent * log_m)


@scalar
def effectiveness_from_ntu(ntu):
    """Effectiveness ε = 1 - e^(-NTU), Eq (4)."""
    return 1.0 - exp(-ntu)


@scalar
def effectiveness(factor, exponent, m):
    """ε = 1 - exp(-β m^β'), Eq (4); 1 without flow, whatever the exponent."""
    eps = effectiveness_from_ntu(transfer_units(factor, exponent, log(m)))
    return 1.0 if m <= 0.0 else eps


@scalar
def air_heat(wet, m_a, dT, dh, cp_a):
    """Heat from the air into the metal, kW, Eq (3); dT = ε_a (T_in - T_c), K, and, when wet, dh = ε_a* (h_in - h_s)."""
    return m_a * (dh if wet else cp_a * dT)


@scalar
def condensed_water(wet, W_in, dT, dh, T_out):
    """Water that the air loses, W_in - W_out: its fall in enthalpy less that of cooling, as vapour at T_out.

    ε_a* and ε_a are fitted separately, so a barely wet volume could add moisture: it then condenses nothing.
    """
    dW = (dh - heat_capacity(W_in) * dT) / vapour_enthalpy(T_out)
    dW = 0.0 if dW < 0.0 else dW
    return dW if wet else 0.0


@scalar
def water_heat(G_w, T_c, T_w_in):
    """Heat from the metal into the water, kW; G_w = ε_w m_w c_p,w."""
    return G_w * (T_c - T_w_in)


@scalar
def next_metal_temperature(T_c, Q_a, Q_w, dt_C_c):
    """T_c[t+1], Eq (3), second line and its wet form, from the heats of air and water, kW."""
    return T_c + dt_C_c * (Q_a - Q_w)


@scalar
def next_water_temperature(T_w, T_w_in, Q_w, C_flow, dt_C_w):
    """T_w[t+1], Eq (3), first line; C_flow = m_w c_p,w, kW/K."""
    return T_w + dt_C_w * (C_flow * (T_w_in - T_w) + Q_w)


@scalar
def implicit_half_step(dt_C, G):
    """Temperature change, K/kW, in half a step of a capacity C that loses G kW/K on the way: h/(1 + h G), h = dt/2C."""
    return dt_C / (2.0 + dt_C * G)

"""The paper in plain Python: an independent reference for the closed loop of a coil valve with backlash.

Source: J. Cai and J. E. Braun, "Self-learning Backlash Inverse Control of Cooling or Heating Coil Valves
Having Backlash Hysteresis", International Refrigeration and Air Conditioning Conference at Purdue, 2016,
paper 1801, docs.lib.purdue.edu/iracc/1801.  Equation numbers (1) to (4) are the paper's.

It computes one scenario at a time with lists and floats, and shares no code with the package it checks.
Where the package is clever, this file is literal: Eq (1) is the paper's three branches, saturation is the
Hyland-Wexler formula with math.exp and math.log, and the metrics are taken from the whole recorded run
instead of being accumulated in the loop.

Units: degC, kg/s, kJ, kW, s; commands, openings and backlash are fractions of stroke; humidity ratios are
kg of water per kg of dry air.  The time step is 1 s.  CV = control volume, CV 1..N along the water: water
enters CV 1, air enters CV N, supply air leaves CV 1; in per-volume lists, index 0 is CV 1.
"""

import math
from itertools import pairwise

PAPER_LIKE = {
    # Coil, Eqs (3) and (4); C_w, C_c, beta1, beta3 and beta5 are those of one of 8 volumes.
    "C_w": 8.8,
    "C_c": 30.0,
    "beta1": 0.32,
    "beta2": -0.20,
    "beta3": 0.40,
    "beta4": -0.45,
    "beta5": 0.42,
    "beta6": -0.42,
    "cp_w": 4.186,
    "cp_a": 1.02,
    "pressure": 101325.0,
    "n_volumes": 8,
    "air_march": "lagged",
    "T_initial": 20.0,
    # Valve, Eq (2).
    "m_max": 2.0,
    "valve_a": 0.7,
    "valve_b": 9.0,
    "valve_c": 0.38,
    # Actuator, Eq (1).
    "backlash": 0.07,
    "stroke_time": 0.0,
    "command_resolution": 0.0,
    # Sensor.
    "sensor_time_constant": 0.0,
    "noise_std": 0.0,
    "sensor_resolution": 0.0,
    # PI controller and backlash inverse.
    "kp": 0.03,
    "ti": 8.0,
    "sample_time": 30.0,
    "action": "cooling",
    "backlash_estimate": 0.0,
    "buffer": 1e-9,
    # Learner.
    "learning_step": 0.0,
    "learning_interval": 1800.0,
    "learning_ratio": 2.0,
    "learning_floor": 0.0,
    "learning_cap": 0.25,
    "learning_min_switches": 0.0,
    "learning_max_reference": 1.0,
    "learning_early_trip": 0,
    "learning_growth": 1.0,
    "learning_shrink": 1.0,
    "learning_final": 1.0,
    "learning_stop": "never",
}

SCALAR_TRACES = (
    "T_sup",
    "T_measured",
    "u",
    "integral",
    "command",
    "position",
    "opening",
    "m_w",
    "estimate",
    "mode",
    "T_w_out",
    "W_sup",
    "wet_volumes",
    "power",
)
VOLUME_TRACES = ("T_w", "T_c", "T_a", "W_a")
METRICS = (
    "rmse",
    "rmse_settled",
    "iae",
    "hunting_amplitude",
    "hunting_period",
    "stem_travel",
    "motor_travel",
    "reversals",
    "switch_frequency",
    "estimate_final",
    "estimate_settled",
    "learn_time_reached",
    "learn_time_confirmed",
    "learn_time_first_down",
    "estimate_first_down",
    "learning_status",
    "coil_energy",
    "coil_peak_power",
    "water_volume",
    "condensate",
)

RISING, FALLING = 1, -1
SETTLING_TIME = 600  # s since the last set-point change
SWITCH_BLOCK = 600  # s
POWER_BLOCK = 900  # s
ESTIMATE_WINDOW = 7200  # s
MOVEMENT_THRESHOLD = 1e-9  # strokes


# Psychrometrics


def saturation_pressure(T):
    """Hyland-Wexler saturation pressure over liquid water [Pa] at T [degC]."""
    T_K = T + 273.15
    return math.exp(
        -5.8002206e3 / T_K
        + 1.3914993
        - 4.8640239e-2 * T_K
        + 4.1764768e-5 * T_K**2
        - 1.4452093e-8 * T_K**3
        + 6.5459673 * math.log(T_K)
    )


def saturation_humidity_ratio(T, pressure):
    """Saturation humidity ratio W_s [kg/kg] at T [degC], clamped to 0.01..50 degC, and pressure [Pa]."""
    p_ws = saturation_pressure(clip(T, 0.01, 50.0))
    return 0.621945 * p_ws / (pressure - p_ws)


def enthalpy(T, W):
    """Enthalpy of moist air [kJ/kg dry air] at T [degC] and humidity ratio W [kg/kg]."""
    return 1.006 * T + W * (2501.0 + 1.86 * T)


def humidity_ratio(h, T):
    """Humidity ratio [kg/kg] of moist air of enthalpy h [kJ/kg] at T [degC]: enthalpy() solved for W."""
    return (h - 1.006 * T) / (2501.0 + 1.86 * T)


# Eqs (1) and (2): actuator and valve


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


# Eqs (3) and (4): coil


def effectiveness(flow, factor, exponent):
    """Eq (4): effectiveness [-] of one volume at a mass flow [kg/s]; 1 without flow."""
    if flow <= 0.0:
        return 1.0
    return 1.0 - math.exp(-factor * flow**exponent)


def exchange(parameters, m_w, m_a):
    """Eq (4) for one of N volumes: (eps_a, eps_star, G_w, G_a, G_star).

    Effectivenesses are dimensionless; the conductances, 1/R_w and 1/R_a in kW/K and 1/R_a* in kg/s, replace
    the printed resistances because these are infinite without flow.
    """
    p = parameters
    scale = 8.0 / p["n_volumes"]
    eps_w = effectiveness(m_w, p["beta1"] * scale, p["beta2"])
    eps_a = effectiveness(m_a, p["beta3"] * scale, p["beta4"])
    eps_star = effectiveness(m_a, p["beta5"] * scale, p["beta6"])
    water_flow = max(m_w, 0.0)
    air_flow = max(m_a, 0.0)
    G_w = eps_w * water_flow * p["cp_w"]
    G_a = eps_a * air_flow * p["cp_a"]
    G_star = eps_star * air_flow
    return eps_a, eps_star, G_w, G_a, G_star


def coil_step(parameters, T_w, T_c, T_a, W_a, m_w, m_a, T_w_in, T_a_in, W_a_in, saturation=None):
    """Eq (3) and the wet balance that follows it: all volumes from second t to t+1.

    T_w, T_c, T_a [degC] and W_a [kg/kg] are the per-volume states at t: water, metal and air leaving each
    volume.  m_w, m_a [kg/s], T_w_in, T_a_in [degC] and W_a_in [kg/kg] are the flows and entering conditions
    at t.  Returns the four state lists at t+1, the number of wet volumes, and the condensate [kg].
    """
    p = parameters
    if saturation is None:
        saturation = saturation_humidity_ratio
    pressure = p["pressure"]
    n_volumes = p["n_volumes"]
    C_w = p["C_w"] * 8.0 / n_volumes
    C_c = p["C_c"] * 8.0 / n_volumes
    eps_a, eps_star, G_w, G_a, G_star = exchange(p, m_w, m_a)
    water_capacity_rate = m_w * p["cp_w"]

    T_w_next = [0.0] * n_volumes
    T_c_next = [0.0] * n_volumes
    T_a_next = [0.0] * n_volumes
    W_a_next = [0.0] * n_volumes
    wet_volumes = 0
    condensate = 0.0

    if p["air_march"] == "lagged":
        T_upstream, W_upstream = T_a, W_a
    else:
        # The march runs from the air inlet, so the entry of the volume upstream is already this step's.
        T_upstream, W_upstream = T_a_next, W_a_next

    for i in range(n_volumes - 1, -1, -1):
        if i == n_volumes - 1:
            T_in, W_in = T_a_in, W_a_in
        else:
            T_in, W_in = T_upstream[i + 1], W_upstream[i + 1]
        T_water = T_w_in if i == 0 else T_w[i - 1]
        T_coil = T_c[i]
        W_s = saturation(T_coil, pressure)

        T_out = T_in + eps_a * (T_coil - T_in)
        if W_in > W_s:
            wet_volumes += 1
            h_in = enthalpy(T_in, W_in)
            h_s = enthalpy(T_coil, W_s)
            h_out = h_in + eps_star * (h_s - h_in)
            # Temperature and enthalpy have different effectivenesses, so a barely wet volume would
            # otherwise humidify the air.
            W_out = min(humidity_ratio(h_out, T_out), W_in)
            Q_air = G_star * (h_in - h_s)
        else:
            W_out = W_in
            Q_air = G_a * (T_in - T_coil)
        condensate += max(m_a, 0.0) * (W_in - W_out)

        Q_water = G_w * (T_coil - T_water)
        T_w_next[i] = T_w[i] + (water_capacity_rate * (T_water - T_w[i]) + Q_water) / C_w
        T_c_next[i] = T_coil + (Q_air - Q_water) / C_c
        T_a_next[i] = T_out
        W_a_next[i] = W_out
    return T_w_next, T_c_next, T_a_next, W_a_next, wet_volumes, condensate


def steady_state_dry(parameters, m_w, m_a, T_w_in, T_a_in):
    """Closed-form steady state of Eq (3) for a dry coil: (T_sup, T_w_out) [degC].

    m_w, m_a > 0 in kg/s, entering temperatures in degC.  The difference between the air and the water
    entering a volume grows by the ratio r from each volume to the next, hence a geometric sum.
    """
    p = parameters
    _, _, G_w, G_a, _ = exchange(p, m_w, m_a)
    C_air = m_a * p["cp_a"]
    C_water = m_w * p["cp_w"]
    G_s = G_a * G_w / (G_a + G_w)
    a = G_s / C_air
    w = G_s / C_water
    r = (1.0 - w) / (1.0 - a)
    S = sum(r**k for k in range(p["n_volumes"]))
    T_sup = T_a_in - (T_a_in - T_w_in) * a * S / (1.0 + a * (S - 1.0))
    T_w_out = T_w_in + C_air / C_water * (T_a_in - T_sup)
    return T_sup, T_w_out


# Sensor noise


def philox4x32(counter, key):
    """Philox4x32-10 of Random123: four 32-bit words from a counter of four and a key of two."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for _ in range(10):
        product0 = 0xD2511F53 * c0
        product1 = 0xCD9E8D57 * c2
        c0, c1, c2, c3 = (
            (product1 >> 32) ^ c1 ^ k0,
            product1 & 0xFFFFFFFF,
            (product0 >> 32) ^ c3 ^ k1,
            product0 & 0xFFFFFFFF,
        )
        k0 = (k0 + 0x9E3779B9) & 0xFFFFFFFF
        k1 = (k1 + 0xBB67AE85) & 0xFFFFFFFF
    return c0, c1, c2, c3


def standard_normal(seed, sample_index, channel, replicate, day):
    """Draw the standard normal number [-] of one controller sample: one half of a Box-Muller pair.

    seed is an unsigned 64-bit integer, the other arguments are unsigned 32-bit integers.
    """
    counter = (sample_index // 2, channel, replicate, day)
    key = (seed & 0xFFFFFFFF, seed >> 32)
    r0, r1, r2, r3 = philox4x32(counter, key)
    u1 = (((r0 | r1 << 32) >> 12) + 0.5) * 2.0**-52
    u2 = (((r2 | r3 << 32) >> 12) + 0.5) * 2.0**-52
    radius = math.sqrt(-2.0 * math.log(u1))
    angle = 2.0 * math.pi * u2
    return radius * (math.cos(angle) if sample_index % 2 == 0 else math.sin(angle))


# Control


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


class Learner:
    """The self-learning rule of section 3.3 of the paper, and what can be changed in it.

    An interval that is no evidence is as if it had not been: no step, and no reference frequency from it.
    """

    def __init__(self, parameters, open_loop):
        p = parameters
        self.is_off = p["learning_step"] <= 0.0 or open_loop
        self.growth = p["learning_growth"]
        self.step = p["learning_step"] / self.growth  # as if one step up had been made before
        self.interval = int(p["learning_interval"])
        self.interval_end = self.interval
        self.ratio = p["learning_ratio"]
        self.floor = p["learning_floor"]
        self.least_switches = p["learning_min_switches"]
        self.highest_reference = p["learning_max_reference"] * 600.0 / p["sample_time"]
        self.trips_early = p["learning_early_trip"] == 1
        self.sample_time = int(p["sample_time"])
        self.shrink = p["learning_shrink"]
        self.final = p["learning_final"]
        self.lowest = p["backlash_estimate"]
        self.highest = p["learning_cap"]
        self.stops_at_first_down = p["learning_stop"] == "first_step_down"
        self.reached_from = p["backlash"] - p["learning_step"] / 2.0 - 1e-12
        self.estimate = p["backlash_estimate"]
        self.reference_frequency = None
        self.missing = None
        self.time_reached = math.nan
        self.time_confirmed = math.nan
        self.time_first_down = math.nan
        self.estimate_first_down = math.nan

    @property
    def has_stopped(self):
        """Whether learning is over."""
        return self.stops_at_first_down and not math.isnan(self.time_first_down)

    @property
    def status(self):
        """What became of the learner: its number among the flags of learning_status."""
        if self.is_off:
            return 0.0
        if self.has_stopped:
            return 3.0
        if not math.isnan(self.time_first_down):
            return 2.0
        if self.reference_frequency is None and self.missing is not None:
            return {"no_evidence": 4.0, "not_identifiable": 5.0}[self.missing]
        return 1.0

    def is_due(self, t, switches):
        """Whether the estimate is looked at in second t, after so many mode switches in the interval so far."""
        if self.is_off or self.has_stopped or t == 0:
            return False
        if t == self.interval_end:
            return True
        may_trip = self.trips_early and t % self.sample_time == 0 and self.reference_frequency is not None
        return may_trip and self.is_chatter(switches)

    def is_chatter(self, switches):
        """Whether so many switches are too many for a whole interval."""
        threshold = self.ratio * max(self.reference_frequency, self.floor)
        return switches / (self.interval / 600.0) > threshold

    def update(self, t, switches):
        """End the interval at second t, given its mode switches; the next one begins there."""
        self.interval_end = t + self.interval
        frequency = switches / (self.interval / 600.0)
        if switches < self.least_switches:
            self.missing = "no_evidence"
            return
        if self.reference_frequency is None:
            if frequency > self.highest_reference:
                self.missing = "not_identifiable"
                return
            self.reference_frequency = frequency
        self.missing = None
        if self.is_chatter(switches):
            self.step_down(t)
        else:
            self.step_up(t)

    def step_up(self, t):
        """One step up, longer than the last one if none went down yet."""
        if math.isnan(self.time_first_down):
            self.step *= self.growth
        self.move_by(self.step, t)

    def step_down(self, t):
        """One step down, as long as the last one up, and shorter ones after it; the first one may be the end."""
        self.move_by(-self.step, t)
        self.step *= self.shrink
        if math.isnan(self.time_confirmed) and not math.isnan(self.time_reached):
            self.time_confirmed = float(t)
        if math.isnan(self.time_first_down):
            self.time_first_down = float(t)
            self.estimate_first_down = self.estimate
            if self.stops_at_first_down:
                self.estimate = max(self.estimate * self.final, self.lowest)

    def move_by(self, distance, t):
        """Move the estimate within its limits."""
        self.estimate = clip(self.estimate + distance, self.lowest, self.highest)
        if math.isnan(self.time_reached) and self.estimate >= self.reached_from:
            self.time_reached = float(t)


# The loop


def simulate(
    parameters,
    boundary,
    *,
    command=None,
    warm_up=1800,
    seed=0,
    replicate=0,
    day=0,
    saturation=None,
):
    """Run one scenario; returns (traces, metrics).

    parameters: a dict with the keys and units of PAPER_LIKE.
    boundary: 1-s series of one length, m_a [kg/s], T_a_in [degC], W_a_in [kg/kg], T_w_in [degC], T_set [degC]
    and, if wanted, noise [K] and enabled [0 or 1].
    command: an open-loop command series [strokes] in place of the controller.
    warm_up: seconds left out of the metrics; seed, replicate, day: select the noise.
    saturation: a function (T [degC], pressure [Pa]) -> W_s [kg/kg] in place of saturation_humidity_ratio.

    traces: lists with one entry per second; for T_w, T_c, T_a and W_a each entry is a list over volumes.
    metrics: floats, and the integer status (0 ok, 1 non-finite, 2 out of range); unless it is 0 they are NaN.
    """
    p = parameters
    n_volumes = p["n_volumes"]
    m_a = floats(boundary["m_a"])
    T_a_in = floats(boundary["T_a_in"])
    W_a_in = floats(boundary["W_a_in"])
    T_w_in = floats(boundary["T_w_in"])
    T_set = floats(boundary["T_set"])
    n_steps = len(T_set)
    recorded_noise = floats(boundary.get("noise", [0.0] * n_steps))
    enabled = [value != 0 for value in boundary.get("enabled", [1] * n_steps)]
    open_loop = command is not None
    commands = floats(command) if open_loop else None

    sample_time = int(p["sample_time"])
    sign = -1.0 if p["action"] == "heating" else 1.0
    tau = p["sensor_time_constant"]

    T_w = [p["T_initial"]] * n_volumes
    T_c = [p["T_initial"]] * n_volumes
    T_a = [p["T_initial"]] * n_volumes
    W_a = [W_a_in[0]] * n_volumes
    T_sensor = drawn_noise = 0.0
    learner = Learner(p, open_loop)
    switches_in_interval = 0
    u = integral = u_extreme = cmd = 0.0
    mode = FALLING
    position = x = 0.0

    traces = {name: [] for name in SCALAR_TRACES + VOLUME_TRACES}
    switches = []
    condensates = []
    out_of_range = not temperatures_in_range(T_w, T_c, T_a)

    for t in range(n_steps):
        # Measure
        if t == 0 or tau <= 0.0:
            T_sensor = T_a[0]
        else:
            T_sensor += (1.0 - math.exp(-1.0 / tau)) * (T_a[0] - T_sensor)
        if p["noise_std"] > 0.0 and t % sample_time == 0:
            drawn_noise = p["noise_std"] * standard_normal(seed, t // sample_time, 0, replicate, day)
        T_measured = T_sensor + drawn_noise + recorded_noise[t]
        if p["sensor_resolution"] > 0.0:
            T_measured = round_half_up(T_measured, p["sensor_resolution"])

        switched = False
        if open_loop:
            cmd = commands[t]
        else:
            # Learner
            if learner.is_due(t, switches_in_interval):
                learner.update(t, switches_in_interval)
                switches_in_interval = 0

            # PI
            if not enabled[t]:
                u = integral = 0.0
            elif t % sample_time == 0:
                error = sign * (T_measured - T_set[t])
                u, integral = pi_controller(error, integral, p["kp"], p["ti"], sample_time)

            # Inverse
            mode_previous = mode
            cmd, mode, u_extreme = backlash_inverse(u, learner.estimate, p["buffer"], mode, u_extreme, cmd)
            switched = mode != mode_previous
            switches_in_interval += switched

        # Actuator, Eq (1), Eq (2)
        position_previous = position
        position = actuator_position(cmd, position, p["command_resolution"], p["stroke_time"])
        x, opening = backlash(position, position_previous, x, p["backlash"])
        m_w = richards_valve(opening, p["m_max"], p["valve_a"], p["valve_b"], p["valve_c"])

        # Eqs (3) and (4)
        T_w_next, T_c_next, T_a_next, W_a_next, wet_volumes, condensate = coil_step(
            p, T_w, T_c, T_a, W_a, m_w, m_a[t], T_w_in[t], T_a_in[t], W_a_in[t], saturation
        )

        # Record the states the step started from, beside the signals of the step
        traces["T_sup"].append(T_a[0])
        traces["T_measured"].append(T_measured)
        traces["u"].append(math.nan if open_loop else u)
        traces["integral"].append(math.nan if open_loop else integral)
        traces["command"].append(cmd)
        traces["position"].append(position)
        traces["opening"].append(opening)
        traces["m_w"].append(m_w)
        traces["estimate"].append(math.nan if open_loop else learner.estimate)
        traces["mode"].append(0 if open_loop else mode)
        traces["T_w_out"].append(T_w[-1])
        traces["W_sup"].append(W_a[0])
        traces["wet_volumes"].append(wet_volumes)
        traces["power"].append(sign * m_w * p["cp_w"] * (T_w[-1] - T_w_in[t]))
        traces["T_w"].append(T_w)
        traces["T_c"].append(T_c)
        traces["T_a"].append(T_a)
        traces["W_a"].append(W_a)
        switches.append(int(switched))
        condensates.append(condensate)

        T_w, T_c, T_a, W_a = T_w_next, T_c_next, T_a_next, W_a_next
        out_of_range = out_of_range or not temperatures_in_range(T_w, T_c, T_a)

    finite = all(math.isfinite(value) for state in (T_w, T_c, T_a, W_a) for value in state)
    status = 1 if not finite else 2 if out_of_range else 0
    if status != 0:
        return traces, dict.fromkeys(METRICS, math.nan) | {"status": status}

    counted = [t >= warm_up and enabled[t] for t in range(n_steps)]
    metrics = tracking_metrics(traces["T_sup"], T_set, counted)
    metrics.update(movement_metrics(traces["opening"], traces["position"], counted))
    metrics.update(switching_metrics(switches, traces["estimate"], learner, counted, warm_up, open_loop))
    metrics.update(coil_metrics(traces["power"], traces["m_w"], condensates, counted, warm_up))
    metrics["status"] = status
    return traces, metrics


# Metrics


def tracking_metrics(T_sup, T_set, counted):
    """Tracking of the set point [degC] by the true supply temperature [degC], over counted seconds."""
    n_steps = len(T_sup)
    error = [T_sup[t] - T_set[t] for t in range(n_steps)]
    settled = []
    last_change = 0
    for t in range(n_steps):
        if t > 0 and T_set[t] != T_set[t - 1]:
            last_change = t
        settled.append(counted[t] and t - last_change >= SETTLING_TIME)

    ranges = []
    crossings = 0
    for start, stop in windows(settled):
        ranges.append(max(T_sup[start:stop]) - min(T_sup[start:stop]))
        crossings += sum(error[t - 1] < 0.0 <= error[t] for t in range(start + 1, stop))

    return {
        "rmse": math.sqrt(mean([e * e for e in select(error, counted)])),
        "rmse_settled": math.sqrt(mean([e * e for e in select(error, settled)])),
        "iae": math.fsum(abs(e) for e in select(error, counted)) / 3600.0,
        "hunting_amplitude": mean(ranges),
        "hunting_period": sum(settled) / crossings if crossings >= 2 else math.nan,
    }


def movement_metrics(opening, position, counted):
    """Travel [strokes] of stem and motor and reversals of the stem, over counted seconds."""
    stem_moves = select(moves(opening), counted)
    motor_moves = select(moves(position), counted)
    directions = [move > 0.0 for move in stem_moves if abs(move) > MOVEMENT_THRESHOLD]
    return {
        "stem_travel": math.fsum(abs(move) for move in stem_moves),
        "motor_travel": math.fsum(abs(move) for move in motor_moves),
        "reversals": float(sum(now != before for before, now in pairwise(directions))),
    }


def switching_metrics(switches, estimate, learner, counted, warm_up, open_loop):
    """Mode switches per 10 min, the estimate [strokes] and the learning times [s]; NaN in open loop."""
    n_steps = len(estimate)
    recent = [counted[t] and t >= n_steps - ESTIMATE_WINDOW for t in range(n_steps)]
    switches_per_block = [] if open_loop else block_sums(switches, counted, warm_up, SWITCH_BLOCK)
    return {
        "switch_frequency": mean(switches_per_block),
        "estimate_final": estimate[-1],
        "estimate_settled": mean(select(estimate, recent)),
        "learn_time_reached": learner.time_reached,
        "learn_time_confirmed": learner.time_confirmed,
        "learn_time_first_down": learner.time_first_down,
        "estimate_first_down": learner.estimate_first_down,
        "learning_status": learner.status,
    }


def coil_metrics(power, m_w, condensates, counted, warm_up):
    """Energy [kWh], peak power [kW], water [m3] and condensate [kg], over counted seconds."""
    peaks = [total / POWER_BLOCK for total in block_sums(power, counted, warm_up, POWER_BLOCK)]
    return {
        "coil_energy": math.fsum(select(power, counted)) / 3600.0,
        "coil_peak_power": max(peaks, default=math.nan),
        "water_volume": math.fsum(select(m_w, counted)) / 1000.0,
        "condensate": math.fsum(select(condensates, counted)),
    }


# Small helpers


def clip(value, low, high):
    """Value limited to low..high; a NaN stays NaN."""
    if value < low:
        return low
    if value > high:
        return high
    return value


def round_half_up(value, resolution):
    """Value rounded to a multiple of resolution, halves upwards; what is not finite stays as it is."""
    if not math.isfinite(value):
        return value
    return resolution * math.floor(value / resolution + 0.5)


def floats(series):
    """The series as a list of Python floats."""
    return [float(value) for value in series]


def temperatures_in_range(*states):
    """Whether every temperature [degC] of the per-volume lists lies in -50..150 degC."""
    return all(min(state) >= -50.0 and max(state) <= 150.0 for state in states)


def mean(values):
    """Arithmetic mean; NaN of nothing."""
    return math.fsum(values) / len(values) if values else math.nan


def select(values, flags):
    """The values whose flag is set."""
    return [value for value, flag in zip(values, flags, strict=True) if flag]


def moves(positions):
    """Change of each second against the one before; everything stands at 0 before the run."""
    return [now - before for before, now in pairwise([0.0, *positions])]


def windows(flags):
    """Maximal runs of set flags, as (start, stop) with stop excluded."""
    runs = []
    start = None
    for t, flag in enumerate([*flags, False]):
        if flag and start is None:
            start = t
        elif not flag and start is not None:
            runs.append((start, t))
            start = None
    return runs


def block_sums(values, counted, first, length):
    """Sums over the blocks of `length` seconds aligned at `first` that fit the run and count throughout."""
    starts = range(first, len(values) - length + 1, length)
    blocks = [slice(start, start + length) for start in starts]
    return [math.fsum(values[block]) for block in blocks if all(counted[block])]

"""The closed loop over time."""

import math
from collections import defaultdict
from types import SimpleNamespace

from reference import metrics
from reference.coil import euler_step, pass_air, runge_kutta_second, trapezoidal_step
from reference.control import Controller
from reference.fixed import FixedEstimate
from reference.gradient import Gradient
from reference.hagglund import Hagglund
from reference.identify import Identify
from reference.learner import Learner
from reference.noise import standard_normal
from reference.psychrometrics import saturation_humidity_ratio
from reference.rounding import round_half_up
from reference.swing import swing_metrics
from reference.valve import NeutralZone, Positioner, StickSlip, backlash, flow_at_pressure, leaking_valve

ESTIMATORS = {
    "none": FixedEstimate, "learner": Learner, "hagglund": Hagglund, "gradient": Gradient, "identify": Identify,
}  # fmt: skip


INPUTS = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")


def simulate(parameters, boundary, *, command=None, warm_up=1800, seed=0, replicate=0, day=0, saturation=None):
    """Run one scenario; return (traces, metrics).

    parameters: a dict with the keys and units of PAPER_LIKE; its air_march may also be "runge_kutta".
    boundary: 1-s series of one length, m_a [kg/s], T_a_in [degC], W_a_in [kg/kg], T_w_in [degC], T_set [degC]
    and, if wanted, noise [K], enabled [0 or 1], backlash_scale [-], T_out [degC], Q_room [kW] and dp_ratio [-].
    command: an open-loop command series [strokes] in place of the controller.
    warm_up: seconds left out of the metrics; seed, replicate, day: select the noise.
    saturation: a function (T [degC], pressure [Pa]) -> W_s [kg/kg] in place of saturation_humidity_ratio.

    traces: lists with one entry per second; for T_w, T_c, T_a and W_a each entry is a list over volumes.
    metrics: floats, and the integer status (0 ok, 1 non-finite, 2 out of range); unless it is 0 they are NaN.
    """
    p = parameters
    n_volumes = p["n_volumes"]
    m_a, T_a_in, W_a_in, T_w_in, T_set = (to_floats(boundary[name]) for name in INPUTS)
    n_steps = len(T_set)
    recorded_noise = to_floats(boundary.get("noise", [0.0] * n_steps))
    enabled = [value != 0 for value in boundary.get("enabled", [1] * n_steps)]
    scale = to_floats(boundary.get("backlash_scale", [1.0] * n_steps))
    T_out, Q_room = (to_floats(boundary.get(name, [0.0] * n_steps)) for name in ("T_out", "Q_room"))
    dp_ratio = to_floats(boundary.get("dp_ratio", [1.0] * n_steps))
    controls_room, capacity = p["controlled"] == "T_room", p["room_capacity"]
    open_loop = command is not None
    commands = to_floats(command) if open_loop else None

    sample_time = int(p["sample_time"])
    sign = -1.0 if p["action"] == "heating" else 1.0
    tau = p["sensor_time_constant"]

    T_w = T_c = T_a = [p["T_initial"]] * n_volumes
    W_a = [W_a_in[0]] * n_volumes
    T_room = math.nan if capacity is None else p["T_initial"]
    T_sensor = drawn_noise = 0.0
    default = "learner" if p["learning_step"] > 0.0 else "none"
    estimator = ESTIMATORS["none" if open_loop else p["estimator"] or default](p)
    switches_so_far = 0
    T_seen = error_seen = 0.0
    controller = Controller(p)
    motor = NeutralZone(p["neutral_zone"])
    positioner = Positioner(p["positioner_band"])
    stem = StickSlip(p["backlash"], p["slip_jump"])
    position = x = 0.0
    opening_before, travelled, gaps = 0.0, 0.0, []

    traces, switches, condensates = defaultdict(list), [], []
    out_of_range = not are_temperatures_in_range(T_w, T_c, T_a)
    frost_time, freeze_time, last_look = 0.0, 0.0, -1

    for t in range(n_steps):
        state = T_w, T_c
        if p["air_march"] != "lagged":
            T_a, W_a, Q, wet_volumes, vapour = pass_air(p, T_c, m_a[t], T_a_in[t], W_a_in[t], saturation)

        # Measure
        T_controlled = T_room if controls_room else T_a[0]
        if t == 0 or tau <= 0.0:
            T_sensor = T_controlled
        else:
            T_sensor += (1.0 - math.exp(-1.0 / tau)) * (T_controlled - T_sensor)
        if p["noise_std"] > 0.0 and t % sample_time == 0:
            drawn_noise = p["noise_std"] * standard_normal(seed, t // sample_time, 0, replicate, day)
        T_measured = T_sensor + drawn_noise + recorded_noise[t]
        if p["sensor_resolution"] > 0.0:
            T_measured = round_half_up(T_measured, p["sensor_resolution"])

        switched = False
        if open_loop:
            cmd = commands[t]
        else:
            # Estimator
            sample = SimpleNamespace(T_set=T_set[t], m_a=m_a[t], enabled=enabled[t], T=T_seen, e=error_seen)
            sample.u, sample.mode, sample.switches = controller.u, controller.mode, switches_so_far
            sample.command = controller.command
            if t > 0:
                estimator.observe(t, sample)

            # PI, inverse
            mode_previous = controller.mode
            error = sign * (T_measured - T_set[t])
            controller.act(error, t % sample_time == 0, enabled[t], p["estimate_share"] * estimator.estimate)
            if t % sample_time == 0:
                T_seen, error_seen = T_measured, error
            cmd = controller.command
            switched = controller.mode != mode_previous
            switches_so_far += switched

        # Actuator, Eq (1), Eq (2)
        position_previous = position
        if p["positioner_band"] > 0.0:
            stem_position = (position - x) / (1.0 - p["backlash"])
            position = positioner.move(cmd, p["command_resolution"], p["stroke_time"], stem_position)
        else:
            position = motor.move(cmd, p["command_resolution"], p["stroke_time"])
        gaps.append(gap_after(p, travelled, scale[t]))
        # a stem in a gap that has become smaller is at its flank
        x, opening = backlash(position, position_previous, min(x, gaps[t]), gaps[t], p["backlash"])
        if p["slip_jump"] > 0.0:
            opening = stem.move(position)[1]
        travelled += abs(opening - opening_before)
        opening_before = opening
        curve = p["m_max"], p["valve_a"], p["valve_b"], p["valve_c"], p["curve"]
        m_w = flow_at_pressure(leaking_valve(opening, p["leakage"], *curve), dp_ratio[t], p["pressure_independent"])

        # Eqs (3) and (4)
        condensate, air, dt = 0.0, (T_a, W_a), 1.0 / p["substeps"]
        if p["air_march"] == "runge_kutta":
            T_w, T_c = runge_kutta_second(p, T_w, T_c, m_w, m_a[t], T_w_in[t], T_a_in[t], W_a_in[t], saturation)
        elif p["air_march"] == "quasistatic":
            for substep in range(int(p["substeps"])):
                if substep > 0:
                    *air, Q, _, vapour = pass_air(p, T_c, m_a[t], T_a_in[t], W_a_in[t], saturation)
                T_w, T_c = trapezoidal_step(p, T_w, T_c, Q, m_w, m_a[t], T_w_in[t], dt)
                condensate += vapour * dt
        else:
            for substep in range(int(p["substeps"])):
                *air, Q, wet, vapour = pass_air(p, T_c, m_a[t], T_a_in[t], W_a_in[t], saturation, lagged=air)
                T_w, T_c = euler_step(p, T_w, T_c, Q, m_w, T_w_in[t], dt)
                wet_volumes = wet if substep == 0 else wet_volumes
                condensate += vapour * dt

        # Record the states the step started from, beside the signals of the step
        signals = {
            "T_sup": T_a[0], "T_measured": T_measured, "T_room": T_room, "command": cmd, "position": position,
            "opening": opening,
            "u": math.nan if open_loop else controller.u, "integral": math.nan if open_loop else controller.integral,
            "estimate": math.nan if open_loop else estimator.estimate, "mode": 0 if open_loop else controller.mode,
            "m_w": m_w, "T_w_out": state[0][-1], "power": sign * m_w * p["cp_w"] * (state[0][-1] - T_w_in[t]),
            "W_sup": W_a[0], "wet_volumes": wet_volumes, "T_w": state[0], "T_c": state[1], "T_a": T_a, "W_a": W_a,
            "test": 0,  # the valve test has a reference apart, ``valve_test``
        }  # fmt: skip
        for name, value in signals.items():
            traces[name].append(value)
        switches.append(int(switched))
        condensates.append(condensate)

        if capacity is not None:
            heat = m_a[t] * p["cp_a"] * (traces["T_sup"][t] - T_room) + p["room_ua"] * (T_out[t] - T_room) + Q_room[t]
            T_room += heat / capacity
        T_a, W_a = air
        if t % metrics.FROST_INTERVAL_S == 0 or t == n_steps - 1:
            frosts, freezes = has_frost_and_ice(p, T_w, T_c, [*W_a[1:], W_a_in[t]], m_w)
            frost_time += (t - last_look) * frosts
            freeze_time += (t - last_look) * freezes
            last_look = t
        out_of_range = out_of_range or not are_temperatures_in_range(T_w, T_c, T_a)

    is_finite = all(math.isfinite(value) for state in (T_w, T_c, T_a, W_a) for value in state)
    status = 1 if not is_finite else 2 if out_of_range else 0
    if status != 0:
        return traces, dict.fromkeys(metrics.METRICS, math.nan) | {"status": status}

    counted = [t >= warm_up and enabled[t] for t in range(n_steps)]
    since = metrics.seconds_since_disturbance(T_set, enabled)
    values = metrics.tracking_metrics(traces["T_room" if controls_room else "T_sup"], T_set, counted, since)
    inputs = list(zip(m_a, T_a_in, W_a_in, T_w_in, T_set, strict=True))
    values.update(swing_metrics(traces["T_sup"], traces["W_sup"], inputs, since, enabled, warm_up, sample_time))
    values.update(metrics.air_metrics(traces["T_sup"], T_set, m_a, p["cp_a"], counted))
    if controls_room:
        values.update(reheat_energy=math.nan, recool_energy=math.nan)
    values.update(metrics.movement_metrics(traces["opening"], traces["position"], counted))
    has_estimate = p["backlash_estimate"] > 0.0 or not estimator.is_off
    values.update(metrics.switching_metrics(switches, traces["estimate"], gaps, estimator, counted, warm_up, open_loop))
    values["backlash_final"] = gap_after(p, travelled, scale[-1])
    values["size_error"] = values["estimate_settled"] - values["backlash_final"] if has_estimate else math.nan
    values.update(metrics.coil_metrics(traces["power"], traces["m_w"], condensates, counted, warm_up))
    values.update(frost_time=frost_time, freeze_time=freeze_time, status=status, test_aborted=0)
    return traces, values


def gap_after(p, travelled, scale):
    """True backlash [strokes] after the stem has travelled so far [strokes], scaled by the boundary."""
    return min(0.9, (p["backlash"] + p["wear_rate"] * travelled) * scale)


def to_floats(series):
    """Convert a series to a list of floats."""
    return [float(value) for value in series]


def has_frost_and_ice(p, T_w, T_c, W_in, m_w):
    """Whether frost forms on a volume, and water freezes in one; W_in [kg/kg] enters each volume from upstream."""
    frosts = any(T < 0.0 and W > saturation_humidity_ratio(T, p["pressure"]) for T, W in zip(T_c, W_in, strict=True))
    still = T_w if m_w > 1e-9 else T_c
    return frosts, min(still) <= 0.0


def are_temperatures_in_range(*states):
    """Whether every temperature [degC] of the per-volume lists lies in -50..150 degC."""
    return all(min(state) >= -50.0 and max(state) <= 150.0 for state in states)

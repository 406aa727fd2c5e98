"""An air handler in steps of 5 s: mixing dampers, heating coil, cooling coil, fan, ducts, zone and their control loops.

Valves have the curve of Eq (2) and the gap of Eq (1); a coil is a counterflow exchanger with one lag of its metal.
Whatever a fault or a schedule changes over time is a series, so that one loop over time serves all units.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.model.control import clip01, desired_opening, integral_part
from fastcoil.model.numerics.jit import kernel
from fastcoil.model.physics import backlash, installed_valve, leaky_flow, motor_position, opening, water_flow

STEP = 5.0  # s
LOG_STEPS = 12  # steps from row to row of a log
CP_AIR, CP_WATER = 1.02, 4.19  # kJ/(kg K)
STILL_AIR_SECONDS = 2400.0  # lag of the sensors while the fan is off
REHEAT_BELOW = 21.0  # zone temperature below which its boxes reheat, °C
SIGNALS = (
    "T_out", "T_return", "T_mixed", "T_heated", "T_cooled", "T_sup", "T_reading", "T_set_cooling", "T_set_heating",
    "cooling_command", "heating_command", "cooling_flow", "heating_flow", "m_a", "damper", "T_zone",
)  # fmt: skip
"""Recorded signals.  T_heated, T_cooled: air behind each coil; flows of water are shares of the full flow."""


class Coil(NamedTuple):
    """Coil and valve: design flows, kg/s; conductance at them, kW/K; lag, s; valve curve; travel per step."""

    m_a: float
    m_w: float
    UA: float
    lag: float
    sensible_share: float
    rangeability: float
    authority: float
    travel: float


class CoilSeries(NamedTuple):
    """Series of a coil and its loop.

    T_w: entering water, °C; capacity: share of conductance and flow left; leakage: share of the full flow that passes
    when shut; stuck: stem position of a stuck valve, -1 where it moves; gap: backlash; kp, 1/K; ti, s.
    """

    T_w: np.ndarray
    capacity: np.ndarray
    leakage: np.ndarray
    stuck: np.ndarray
    gap: np.ndarray
    kp: np.ndarray
    ti: np.ndarray


class Series(NamedTuple):
    """Weather, schedule, loads and faults.

    load: heat of people, sun and devices, kW; fan: 0 or 1; flow: factor on the air flow; swing: added to set-points, K;
    overlap: heating above cooling set-point, K, or 0; frozen: whether the supply sensor stands still.
    """

    T_out: np.ndarray
    load: np.ndarray
    occupied: np.ndarray
    fan: np.ndarray
    flow: np.ndarray
    noise: np.ndarray
    swing: np.ndarray
    overlap: np.ndarray
    frozen: np.ndarray


class Plant(NamedTuple):
    """What does not change: air side, zone, and outer loop."""

    m_a: float  # greatest air flow, kg/s
    least_flow: float  # share of it; 1: constant air volume
    fan_heat: float  # K at the greatest flow
    outdoor_share: float  # least while occupied
    has_economiser: bool
    damper_lag: float  # s
    duct_lag: float  # from coil to sensor at the greatest air flow, s; longer with less air
    sensor_lag: float  # s
    supply_offset: float  # of the supply sensor, K
    mixed_offset: float  # of the mixed-air sensor, K
    zone_capacity: float  # kJ/K
    zone_UA: float  # to outdoors, kW/K
    is_cascade: bool  # set-points from the zone; otherwise one set-point
    T_set: float  # the one set-point, °C
    reset: float  # by which it falls per K of outdoor temperature
    band: float  # from the one set-point down to that of heating, K
    zone_kp: float  # 1/K
    zone_ti: float  # s
    sample_steps: int


@kernel
def coil_heat(coil: Coil, m_w: float, m_a: float, T_a: float, T_w: float, capacity: float) -> float:
    """Sensible heat from water to air, kW, of a counterflow coil by its effectiveness."""
    C_a, C_w = CP_AIR * m_a, CP_WATER * m_w
    if C_a < 1e-6 or C_w < 1e-6:
        return 0.0
    resistance = 0.6 * (coil.m_a / m_a) ** 0.65 + 0.4 * (coil.m_w / m_w) ** 0.8
    C_min, C_max = min(C_a, C_w), max(C_a, C_w)
    ntu, ratio = coil.UA * capacity / resistance / C_min, min(C_min / C_max, 0.999)
    exponential = np.exp(-ntu * (1.0 - ratio))
    return coil.sensible_share * (1.0 - exponential) / (1.0 - ratio * exponential) * C_min * (T_w - T_a)


@kernel
def valve_flow(coil: Coil, open: float, leakage: float) -> float:
    """Share of the full water flow at an opening."""
    m_max, a, b, c = installed_valve(coil.rangeability, coil.authority, 1.0)
    m_0, m_1 = water_flow(0.0, m_max, a, b, c), water_flow(1.0, m_max, a, b, c)
    return leaky_flow(water_flow(open, m_max, a, b, c), m_0, m_1, leakage)


@kernel
def simulate_plant(plant: Plant, cooling: Coil, heating: Coil, c: CoilSeries, h: CoilSeries, s: Series) -> np.ndarray:
    """Simulate an air handler; return ``SIGNALS``, (rows of the log, signals), as they are and not as sensors say."""
    n = s.T_out.size
    record = np.empty((n // LOG_STEPS, len(SIGNALS)))
    T_zone = T_sup = T_duct = T_sensor = T_reading = 21.0
    damper, is_free, request_c, request_h, share = 0.0, False, 0.0, 0.0, plant.least_flow
    motor, stem, effect, integral, command = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    flow = np.zeros(2)
    for k in range(n):
        is_occupied, is_on = s.occupied[k] > 0.5, s.fan[k] > 0.5
        # outer loop: set-points and air flow
        e_c, e_h = T_zone - (23.5 if is_occupied else 29.0), (21.5 if is_occupied else 17.0) - T_zone
        request_c = integral_part(request_c, e_c, plant.zone_kp * STEP / plant.zone_ti)
        request_h = integral_part(request_h, e_h, plant.zone_kp * STEP / plant.zone_ti)
        u_zone = desired_opening(e_c, request_c, plant.zone_kp)
        T_set_c = plant.T_set - plant.reset * min(max(s.T_out[k] - 10.0, 0.0), 14.0)
        T_set_h = T_set_c - plant.band
        if plant.is_cascade:
            T_set_c = 30.0 - (30.0 - plant.T_set) * u_zone
            T_set_h = min(10.0 + 25.0 * desired_opening(e_h, request_h, plant.zone_kp), T_set_c - 1.0)
        T_set_c, T_set_h = T_set_c + s.swing[k], T_set_h + s.swing[k]
        if s.overlap[k] > 0.0:
            T_set_h = T_set_c + s.overlap[k]
        share += ((plant.least_flow + (1.0 - plant.least_flow) * u_zone) - share) * STEP / 180.0
        m_a = plant.m_a * share * s.flow[k] * s.fan[k]
        # mixing dampers; the economiser mixes to the set-point by the mixed-air sensor, errors included
        T_return = T_zone + 0.5
        target = plant.outdoor_share if is_occupied else 0.0
        is_free = plant.has_economiser and s.T_out[k] < T_return - (0.5 if is_free else 1.5)
        if is_free:
            T_wanted = T_set_c - plant.fan_heat - plant.mixed_offset
            target = max(target, min((T_return - T_wanted) / (T_return - s.T_out[k]), 1.0))
        damper += ((target if is_on else 0.0) - damper) * STEP / plant.damper_lag
        T_mixed = T_return + (0.02 + 0.98 * damper) * (s.T_out[k] - T_return)
        # loops, heating first; with one set-point only one of them acts
        for i in range(2):
            own, e = (h, T_set_h - T_reading) if i == 0 else (c, T_reading - T_set_c)
            if not is_on or (not plant.is_cascade and s.overlap[k] == 0.0 and command[1 - i] > 0.0):
                integral[i], command[i] = 0.0, 0.0
            elif k % plant.sample_steps == 0:
                ki = own.kp[k] * STEP * plant.sample_steps / own.ti[k]
                integral[i] = integral_part(integral[i], e, ki)
                command[i] = desired_opening(e, integral[i], own.kp[k])
        # valves and coils; their effect on the air lags
        T_coil = T_mixed
        for i in range(2):
            own, coil = (h, heating) if i == 0 else (c, cooling)
            position = command[i] if own.stuck[k] < 0.0 else own.stuck[k]
            motor[i] = motor_position(motor[i], position, coil.travel)
            stem[i] = backlash(stem[i], motor[i], own.gap[k])
            open = motor[i] if own.stuck[k] >= 0.0 else opening(stem[i], own.gap[k])
            flow[i] = valve_flow(coil, open, own.leakage[k]) * min(own.capacity[k], 1.0)
            heat = coil_heat(coil, coil.m_w * flow[i], m_a, T_coil, own.T_w[k], own.capacity[k])
            change = heat / (CP_AIR * m_a) if is_on else 0.0
            effect[i] += (change - effect[i]) * STEP / coil.lag
            T_coil = T_coil + effect[i]
        T_heated = T_mixed + effect[0]
        # supply air, its sensor, and the zone; in still air the sensor drifts to its surroundings
        if is_on:
            T_sup = T_coil + plant.fan_heat * share
            T_duct += (T_sup - T_duct) * STEP * share / plant.duct_lag
            T_sensor += (T_duct - T_sensor) * STEP / plant.sensor_lag
        else:
            T_sup = T_zone + 0.2 * (flow[0] * (h.T_w[k] - T_zone) + flow[1] * (c.T_w[k] - T_zone))
            T_sensor += (T_sup - T_sensor) * STEP / STILL_AIR_SECONDS
            T_duct = T_sensor
        if s.frozen[k] < 0.5:
            T_reading = T_sensor + plant.supply_offset + s.noise[k]
        reheat = 0.0 if plant.is_cascade else clip01(REHEAT_BELOW - T_zone) * 15.0 * CP_AIR * m_a
        heat = s.load[k] + reheat + plant.zone_UA * (s.T_out[k] - T_zone) + CP_AIR * m_a * (T_sup - T_zone)
        T_zone += heat * STEP / plant.zone_capacity
        if k % LOG_STEPS == 0:
            row = (
                s.T_out[k], T_return, T_mixed, T_heated, T_coil, T_sensor, T_reading, T_set_c, T_set_h,
                command[1], command[0], flow[1], flow[0], m_a, damper, T_zone,
            )  # fmt: skip
            for j in range(len(SIGNALS)):
                record[k // LOG_STEPS, j] = row[j]
    return record

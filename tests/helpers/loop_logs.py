"""Trend logs of a loop in plain Python: PI, motor, play, a plant with two lags and a delay, what swings outside."""

import math

import numpy as np
import xarray as xr

STEP = 5.0
GAIN = -20.0


def make_loop_log(
    hours=4.0, backlash=0.08, kp=0.02, ti=90.0, sample_time=15.0, stroke_time=90.0, steps=True, swing=0.0, period=900.0,
    noise=0.01, interval=10.0, seed=1,
):  # fmt: skip
    """Simulate a log: command, T_sup, T_set along elapsed_time; ``swing``: of the air outside, ± K."""
    draw, n = np.random.default_rng(seed), int(hours * 3600 / STEP)
    levels = draw.permutation(np.linspace(12.5, 16.5, max(int(hours * 2), 1)))
    T_set = np.repeat(levels if steps else np.full(levels.size, 14.5), math.ceil(n / levels.size))[:n]
    drift = np.cumsum(draw.normal(0.0, 0.004, n))
    air = 24.0 + drift + swing * np.sin(2 * np.pi * np.arange(n) * STEP / period)
    errors = noise * draw.standard_normal(n)
    position = q = command = integral = 0.5
    slow = fast = GAIN * 0.5
    waiting = [slow] * 3
    steps_per_sample, log = round(sample_time / STEP), []
    for k in range(n):
        T = air[k] + fast
        if k % steps_per_sample == 0:
            e = T + errors[k] - T_set[k]
            integral = min(max(integral + kp * sample_time / ti * e, 0.0), 1.0)
            command = min(max(kp * e + integral, 0.0), 1.0)
        log.append((command, T + errors[k], T_set[k]))
        position += min(max(command - position, -STEP / stroke_time), STEP / stroke_time)
        q = min(max(q, position - backlash), position)
        waiting.append(GAIN * q / (1.0 - backlash))
        slow += (waiting[-3] - slow) * (1.0 - math.exp(-STEP / 60.0))
        fast += (slow - fast) * (1.0 - math.exp(-STEP / 20.0))
    rows = np.array(log)[:: round(interval / STEP)]
    units = {"command": "1", "T_sup": "degC", "T_set": "degC"}
    columns = {name: ("elapsed_time", rows[:, i], {"units": unit}) for i, (name, unit) in enumerate(units.items())}
    seconds = np.arange(rows.shape[0]) * interval
    return xr.Dataset(columns, coords={"elapsed_time": ("elapsed_time", seconds, {"units": "s"})})


def write_log(ds, path):
    """Write the log as a CSV file, command in per cent; return the path."""
    table = np.stack([ds.elapsed_time, 100 * ds.command, ds.T_sup, ds.T_set], axis=1)
    header = "elapsed_time [s],command [%],T_sup [degC],T_set [degC]"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.4f", encoding="utf-8")
    return path

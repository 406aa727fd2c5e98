"""Simulated logs: valves and coils of known parameters, with noise, to fit models to."""

import math

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.logs.columns import ColumnSpec
from fastcoil.measured.fit_coil import COIL_PARAMETERS, CoilProblem, build_record
from fastcoil.measured.part import fitting_mask, require_split

VALVE_TRUTH = {"backlash": 0.07, "m_max": 2.0, "valve_a": 0.7, "valve_b": 9.0, "valve_c": 0.38}
COIL_TRUTH = {name: fc.parameters()[name].default for name in COIL_PARAMETERS}
INPUTS = ["m_a", "T_a_in", "W_a_in", "T_w_in"]
COIL_SERIES = ColumnSpec(required=("m_w", *INPUTS, "T_sup"), optional=("T_w_out",), measured=("T_sup", "T_w_out"))


def valve_flows(command, start=0.0, **truth):
    """Evaluate Eqs (1) and (2) in plain Python; ``start``: place within the backlash, 1 on the rising flank."""
    p = VALVE_TRUTH | truth
    x_bl = p["backlash"]
    low, high = max(command[0] - x_bl, 0.0), min(command[0], 1.0 - x_bl)
    q, flow_values = high - start * (high - low), []
    for position in command:
        q = min(max(q, position - x_bl), position)
        growth = math.exp(-p["valve_b"] * (q / (1.0 - x_bl) - p["valve_c"]))
        flow_values.append(p["m_max"] * (1.0 + p["valve_a"] * growth) ** (-1.0 / p["valve_a"]))
    return np.array(flow_values)


def random_walk(rng, n=400, top=1.0, largest=0.3):
    """Draw a random walk of the command in steps small enough for the backlash to matter."""
    command = [rng.uniform(0.2, 0.8) * top]
    while len(command) < n:
        command.append(min(max(command[-1] + rng.normal(0.0, largest / 2), 0.0), top))
    return np.array(command)


def make_valve_log(command, flow, interval=60.0, **others):
    """Make a valve's log as a Dataset."""
    t = ("elapsed_time", np.arange(command.size) * interval, {"units": "s"})
    variables = {"command": ("elapsed_time", command, {"units": "1"}), "m_w": ("elapsed_time", flow, {"units": "kg/s"})}
    variables |= {name: ("elapsed_time", values) for name, values in others.items()}
    return xr.Dataset(variables, {"elapsed_time": t})


def noisy_valve_log(rng, command, sd, phi=0.0, interval=60.0, **truth):
    """A valve's log of a command, with AR(1) noise on its flows."""
    return make_valve_log(command, add_noise(rng, valve_flows(command, **truth), sd, phi), interval)


def add_noise(rng, flow, sd, phi=0.0):
    """Add AR(1) noise of standard deviation ``sd`` to a flow."""
    return np.maximum(flow + ar1_noise(rng, flow.size, sd, phi), 1e-3)


def ar1_noise(rng, n, sd, phi=0.0):
    """Draw AR(1) noise of standard deviation ``sd``, (n,)."""
    e = rng.normal(0.0, sd, n)
    for t in range(1, n if phi else 0):
        e[t] = phi * e[t - 1] + math.sqrt(1 - phi**2) * e[t]
    return e


def random_steps(rng, low, high, seconds, n):
    """Draw random values, each held for ``seconds``."""
    return np.repeat(rng.uniform(low, high, n // seconds + 1), seconds)[:n]


def coil_log(hours=2.0, seed=0, sd=0.05, phi=0.0, every=1, air=True, dry=False, **truth):
    """Simulate a log of a coil with perturbed flows in open loop, with AR(1) noise on the supply air."""
    rng, n = np.random.default_rng(seed), int(hours * 3600)
    day = {name: values[0] for name, values in fc.paper_day(hours=hours, seed=1).series.items()}
    day["m_a"] = day["m_a"] * random_steps(rng, 0.4, 1.1, 600, n) if air else 1.0
    day["W_a_in"] = 0.003 if dry else day["W_a_in"]
    boundary = fc.Boundary(**day)
    command, traces = random_steps(rng, 0.1, 0.9, 300, n), ["m_w", "T_sup", "T_w_out"]
    loop = fc.Loop(**{"air_march": "quasistatic"} | truth)
    log = fc.simulate(loop, boundary, command=command, traces=traces, warm_up=0)[traces]
    for name in INPUTS:
        log[name] = boundary.to_dataset()[name]
    log["T_sup"] = (log["T_sup"] + ar1_noise(rng, n, sd, phi)).assign_attrs(units="degC")
    return log.isel(elapsed_time=slice(None, None, every))


def build_coil_problem(log, warm_up, share=1.0, **truth):
    """Build the problem that ``fit_coil`` solves."""
    data = read_checked_log(log, COIL_SERIES)
    fitting = fitting_mask(data, require_split(share))
    record = build_record(data, fc.Loop(**{"air_march": "quasistatic"} | truth), (), fitting)
    return CoilProblem(data, record, warm_up, fitting)


def join_logs(*logs):
    """Join logs, each with its own times."""
    return xr.concat(logs, "elapsed_time", combine_attrs="override")


def shift_log(log, seconds):
    """Shift a log by some seconds."""
    return log.assign_coords(elapsed_time=(log["elapsed_time"] + seconds).assign_attrs(units="s"))


def assert_covered(fit, names=None):
    """Assert that the true values lie in the 95 % intervals of a fit."""
    truth = COIL_TRUTH if fit.kind == "coil" else VALVE_TRUTH
    for name in names or fit.intervals:
        low, high = fit.intervals[name]
        assert low <= truth[name] <= high, f"{name} = {truth[name]} is not in {low:.4g} to {high:.4g}"

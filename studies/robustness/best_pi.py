"""The best plain PI of each plant: what a remedy has to beat.

A preset or a tuning found in the field says little about a PI.  This script looks for the best gains of each preset's
plant on a grid, on some days, and tries the choice on fresh days; beside it stand the gains that SIMC gives from a step
of the open loop.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import change_in_words, concat_along, write_table
from studies.days import HEATING, HEATING_T_SET, T_SET, kinds, loop_settings, make_days

PRESETS = ("paper_like", "paper_like_fast", "lbnl", "g36")
SEARCH_DAYS, FRESH_DAYS = range(3101, 3106), range(3201, 3206)
KP, TI = np.geomspace(0.002, 0.4, 18), np.geomspace(5.0, 600.0, 14)
NOISE_STD = 0.02  # measurement noise, K: without any, the fastest gains look better than they are
STEP_SIZE = 0.1  # size of the open-loop step, fraction of stroke
REST_SECONDS, RESPONSE_SECONDS = 3600, 1800
"""Seconds at rest before the step, and of the response."""
LEAST_GAIN = 0.2
"""Smallest plant gain that a step is taken to show, K per stroke: 0.1 K over it, a buffer, must stay below 1."""
RESPONSE_INTERVAL = 2  # seconds between the samples of the response


def best_gains(loop: fc.Loop, day_kinds: Sequence[str], seeds: Sequence[int] = SEARCH_DAYS) -> xr.Dataset:
    """kp and ti for every scenario of ``loop`` with the lowest cost on the search days of these kinds.

    The cost is the mean, over the kinds, of the RMSE relative to the lowest one of that kind.  Gains that are best on
    one kind of day alone may lie at the edge of what another kind makes unstable.
    """
    cost: xr.DataArray | float = 0.0
    for kind in day_kinds:
        swept = loop.assign(kp=("kp", KP), ti=("ti", TI), **loop_settings(kind))
        error = fc.simulate(swept, make_days(kind, seeds)).rmse.mean("day").reset_coords(drop=True).fillna(np.inf)
        cost = cost + error / error.min(["kp", "ti"])
    stacked = xr.DataArray(cost).stack(gains=("kp", "ti"))
    other_dims = [d for d in stacked.dims if d != "gains"]
    pairs = np.array(list(stacked.gains.values))[stacked.argmin("gains").values]
    return xr.Dataset({"kp": (other_dims, pairs[..., 0]), "ti": (other_dims, pairs[..., 1])})


def fit_first_order(loop: fc.Loop, kind: str) -> xr.Dataset:
    """Gain (K per stroke), time constant and dead time (s) of the plant, from a step of the command upwards.

    The step starts where the valve, coming from below, holds the set-point most nearly; so the gap of the gears is
    closed.  Two points of the response, at 35.3 and 85.3 % of its end, give the model: Sundaresan and Krishnaswamy
    (1978).  Half a sample time counts as dead time, since a sampled controller acts that much later on average.
    """
    is_heating, T_set = kind == HEATING, HEATING_T_SET if kind == HEATING else T_SET
    quiet_loop = loop.assign(noise_std=0.0, **loop_settings(kind))
    levels = np.linspace(0.05, 0.85, 17)
    responses = [_step_response(quiet_loop, kind, level) for level in levels]
    T_start = xr.concat([T.isel(elapsed_time=0, drop=True) for T in responses], "level")
    T = xr.concat(responses, "level").isel(level=abs(T_start - T_set).argmin("level"))
    change = (T - T.isel(elapsed_time=0, drop=True)) * (1.0 if is_heating else -1.0)
    end = change.isel(elapsed_time=-1, drop=True)

    def time_reached(share: float) -> xr.DataArray:
        return float(RESPONSE_INTERVAL) * (change >= share * end).argmax("elapsed_time")

    t1, t2 = time_reached(0.353), time_reached(0.853)
    tau, theta = 0.67 * (t2 - t1), np.maximum(1.3 * t1 - 0.29 * t2, 0.0)
    theta = np.maximum(theta + 0.5 * _parameter(loop, "sample_time"), 1.0)
    return xr.Dataset({"gain": end / STEP_SIZE, "tau": np.maximum(tau, 1.0), "theta": theta})


def _step_response(loop: fc.Loop, kind: str, level: float) -> xr.DataArray:
    """Measured temperature from the second of a step from ``level`` on, with constant air and water."""
    command = np.full(REST_SECONDS + RESPONSE_SECONDS, level)
    command[REST_SECONDS:] += STEP_SIZE
    day = make_days(kind, [0])
    mean = {name: float(day.series[name].mean()) for name in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
    boundary = fc.Boundary(**mean, T_set=np.full(command.size, T_SET))
    ds = fc.simulate(
        loop, boundary, command=command, traces=["T_measured"], trace_interval=RESPONSE_INTERVAL, warm_up=0
    )
    response = ds.T_measured.isel(
        elapsed_time=slice(REST_SECONDS // RESPONSE_INTERVAL, None)
    ).drop_attrs()  # arithmetic would keep the unit
    return response.assign_coords(elapsed_time=response.elapsed_time - REST_SECONDS).reset_coords(drop=True)


def simc_gains(loop: fc.Loop, kind: str) -> xr.Dataset:
    """kp and ti after SIMC with the closed-loop time constant equal to the dead time: Skogestad (2003); and the gain.

    plant_gain: K per stroke, of the same step.
    kp = tau / (K (tau_c + theta)), ti = min(tau, 4 (tau_c + theta)), tau_c = theta; J. Process Control 13, 291-309.
    """
    return gains_from_model(fit_first_order(loop, kind))


def gains_from_model(model: xr.Dataset) -> xr.Dataset:
    """Compute the gains of ``simc_gains`` from a model of ``fit_first_order``."""
    kp = model.tau / (model.gain * 2.0 * model.theta)
    gain = model.gain.clip(LEAST_GAIN)  # a valve that changes nothing still needs a number
    ti = np.minimum(model.tau, 8.0 * model.theta)
    return xr.Dataset({"kp": kp.clip(1e-4, 1.0), "ti": ti, "plant_gain": gain})


def _parameter(loop: fc.Loop, name: str) -> xr.DataArray:
    return xr.DataArray(loop[name])


def with_tunings(loop: fc.Loop, kind: str, best: xr.Dataset) -> fc.Loop:
    """The loop with its own gains, the best and those of SIMC, along a dim ``tuning``."""
    preset_gains = xr.Dataset({"kp": _parameter(loop, "kp"), "ti": _parameter(loop, "ti")})
    tunings = {"preset": preset_gains, "best": best, "SIMC": simc_gains(loop, kind)}
    gains = concat_along("tuning", tunings, coords="minimal", compat="override")
    return loop.assign(kp=gains.kp, ti=gains.ti, **loop_settings(kind))


def preset_rows(preset: str) -> list[list[str]]:
    """A row for each kind of day and tuning of a preset's plant: one tuning for cooling, one for heating."""
    loop, table = fc.Loop.preset(preset).assign(converged=True, noise_std=NOISE_STD), []
    for group in ([k for k in kinds() if k != HEATING], [HEATING]):
        best = best_gains(loop, group)
        for kind in group:
            table += _fresh_day_rows(preset, with_tunings(loop, kind, best), kind)
    return table


def _fresh_day_rows(preset: str, loop: fc.Loop, kind: str) -> list[list[str]]:
    ds = fc.simulate(loop, make_days(kind, FRESH_DAYS))
    table = []
    for name in ds.tuning.values:
        tuning_ds = ds.sel(tuning=name)
        table.append(
            [
                f"`{preset}`",
                kind,
                str(name),
                f"{float(tuning_ds.kp):.3g}, {float(tuning_ds.ti):.3g}",
                f"{float(tuning_ds.rmse.mean()):.3f}",
                "—" if name == "preset" else change_in_words(ds, name, "preset", "tuning"),
                f"{float(tuning_ds.rmse_settled.mean()):.3f}",
                f"{float(tuning_ds.motor_travel.mean()):.1f}",
                f"{float(tuning_ds.reversals.mean()):.0f}",
                f"{float(tuning_ds.hunts.mean()):.0%}",
            ]
        )
    return table


def main() -> None:
    """Write the table."""
    write_table(
        "robustness/best_pi",
        f"The plain PI of each preset: its own gains, the best of {KP.size * TI.size} pairs on {len(SEARCH_DAYS)} "
        f"other days, and SIMC gains; {len(FRESH_DAYS)} fresh days, backlash 7 %, noise {NOISE_STD:g} K",
        ["plant", "days", "tuning", "kp in 1/K, ti in s", "RMSE, K", "change of RMSE (95 % over days)",
         "settled RMSE, K", "motor travel, strokes", "reversals", "hunting"],
        (row for preset in PRESETS for row in preset_rows(preset)),
    )  # fmt: skip
